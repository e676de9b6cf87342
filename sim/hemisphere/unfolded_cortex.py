"""The body of a scene whose shape is ``cortex``: a person's cortex, unfolded, with what is known of its vertices."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Bools, Ints
from morphofold.sim.hemisphere.smooth_body import SmoothBody, smooth_body
from morphofold.sim.hemisphere.sphere_maps import thickness_factor
from morphofold.sim.hemisphere.subject import Subject, digests_of, files_of_subject, subject_of_cortex
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene.geometries import UnfoldedCortex, map_files

FADE_OVER_RADIUS = 0.12  # distance from the medial wall at which the cortex grows fully, over the radius of the body


def bilayer_of_cortex(geometry: UnfoldedCortex, n: int, cortex_layers: int) -> Bilayer:
    """The body of a subject with ``n`` cells along an edge of the cube.

    Its pial surface is the unfolded surface; regions and cortex are those of the nearest vertex on the sphere. With
    ``held = "medial wall"`` columns of nodes below the wall are held at all depths, and growth rises from 0 at its rim
    to its full value at ``FADE_OVER_RADIUS`` from it.

    Raises
    ------
    FileNotFoundError, ValueError
        If the subject cannot be read or unfolded, has no medial wall to hold, or the cortex does not fit.
    """
    subject, files = subject_of_cortex(geometry), files_of_subject(geometry)
    if geometry.thickness_map is not None:
        files |= map_files(geometry.thickness_map, geometry, "thickness_map")
    body = _smooth_body(geometry.model_copy(update={"held": "hole"}), digests_of(files))
    wall = geometry.held == "medial wall"
    tree = cKDTree(subject.unfolding.points)
    nearest: Callable[[Array], Ints] = lambda s: tree.query(s)[1]
    bilayer = body.bricks(n, cortex_layers, (lambda s: ~subject.cortex[nearest(s)]) if wall else None)
    assert bilayer.sphere is not None
    vertex, regions = nearest(bilayer.sphere), subject.mended.cortex.regions
    cortex = subject.cortex[vertex]
    growing = _growing(subject, cortex, bilayer, FADE_OVER_RADIUS * geometry.radius) if wall else None
    return replace(
        bilayer,
        hemi=geometry.hemi,
        cortex=cortex,
        growing=growing,
        regions=None if regions is None else replace(regions, labels=regions.labels[vertex]),
    )


@lru_cache(maxsize=8)
def _smooth_body(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> SmoothBody:
    surface, T = subject_of_cortex(geometry).unfolding.surface, geometry.cortex_thickness
    if geometry.thickness_map is None:
        return smooth_body(surface, T, T, geometry.hole_share)
    factor = thickness_factor(geometry.thickness_map, geometry)
    return smooth_body(surface, lambda s: T * factor(s), T, geometry.hole_share)


def _growing(subject: Subject, cortex: Bools, bilayer: Bilayer, fade: float) -> Array:
    """Share of the growth at each node (N,): 0 below the medial wall, 1 below what is ``fade`` [mm] away from it."""
    unfolding, n = subject.unfolding, bilayer.n_surface
    wall = cKDTree(unfolding.surface(unfolding.points[~subject.cortex]))
    away = np.minimum(wall.query(bilayer.mesh.p.T[:n])[0] / fade, 1.0)
    share = np.where(cortex, 0.5 - 0.5 * np.cos(np.pi * away), 0.0)
    return np.tile(share, len(bilayer.share) // n)
