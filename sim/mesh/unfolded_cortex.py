"""The body of a scene whose shape is ``cortex``: a person's cortex, unfolded, with what is known of its vertices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import MissingPart
from morphofold.geometry import vertex_areas
from morphofold.io.folded import Folded, folded_files, read_folded
from morphofold.provenance import sha256_of
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.smooth_body import SmoothBody, smooth_body
from morphofold.sim.mesh.sphere_maps import Vertices, thickness_factor
from morphofold.sim.scene.geometries import UnfoldedCortex, map_files
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import Unfolding, unfold

#: names of regions that are not cortex
WALL_NAMES = ("unknown", "medial_wall", "medialwall", "corpuscallosum", "???")
FADE_OVER_RADIUS = 0.12  # distance from the medial wall at which the cortex grows fully, over the radius of the body
_OF_THE_BODY_ONLY = {"held": "hole", "thickness_map": None, "cortex_thickness": 1.0, "hole_share": 0.25}


class Subject(NamedTuple):
    """The hemisphere of a subject as it was read, what it unfolds to, and where it is cortex (N,)."""

    folded: Folded
    unfolding: Unfolding
    cortex: Bools

    def vertices(self) -> Vertices:
        """Its vertices on the sphere, weighted by the area of the smooth surface."""
        smooth = self.unfolding.smooth()
        return Vertices(self.unfolding.points, vertex_areas(smooth.verts, smooth.faces) * self.cortex)


def files_of_cortex(geometry: UnfoldedCortex) -> dict[str, Path]:
    """The files of the subject, by content."""
    return folded_files(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)


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
    subject, files = subject_of_cortex(geometry), files_of_cortex(geometry)
    if geometry.thickness_map is not None:
        files |= map_files(geometry.thickness_map, geometry, "thickness_map")
    body = _smooth_body(geometry.model_copy(update={"held": "hole"}), _digests(files))
    wall = geometry.held == "medial wall"
    if wall and subject.cortex.all():
        raise MissingPart(
            f"{geometry.subject}: has no medial wall: neither label/{geometry.hemi}.cortex.label nor "
            f"{geometry.hemi}.aparc.annot marks one. Add the label, or set geometry.held = 'hole'."
        )
    tree = cKDTree(subject.unfolding.points)
    nearest: Callable[[Array], Ints] = lambda s: tree.query(s)[1]
    bilayer = body.bricks(n, cortex_layers, (lambda s: ~subject.cortex[nearest(s)]) if wall else None)
    assert bilayer.sphere is not None
    vertex, regions = nearest(bilayer.sphere), subject.folded.regions
    cortex = subject.cortex[vertex]
    growing = _growing(subject, cortex, bilayer, FADE_OVER_RADIUS * geometry.radius) if wall else None
    return replace(
        bilayer,
        hemi=geometry.hemi,
        cortex=cortex,
        growing=growing,
        regions=None if regions is None else replace(regions, labels=regions.labels[vertex]),
    )


def subject_of_cortex(geometry: UnfoldedCortex) -> Subject:
    """The hemisphere that a body is made of, as it was read, and what it unfolds to."""
    return _subject(geometry.model_copy(update=_OF_THE_BODY_ONLY), _digests(files_of_cortex(geometry)))


def _digests(files: Mapping[str, Path]) -> tuple[str, ...]:
    return tuple(sha256_of(path) for path in files.values())


@lru_cache(maxsize=2)
def _subject(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Subject:
    """The subject of a geometry; ``digests`` are those of its files, so that a changed file is read again."""
    folded = read_folded(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)
    sphere = folded.sphere or sphere_of(folded.surface)
    return Subject(folded, unfold(folded.surface, sphere, geometry.unfold, radius=geometry.radius), _cortex(folded))


@lru_cache(maxsize=2)
def _smooth_body(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> SmoothBody:
    surface, T = subject_of_cortex(geometry).unfolding.surface, geometry.cortex_thickness
    if geometry.thickness_map is None:
        return smooth_body(surface, T, T, geometry.hole_share)
    factor = thickness_factor(geometry.thickness_map, geometry)
    return smooth_body(surface, lambda s: T * factor(s), T, geometry.hole_share)


def _cortex(folded: Folded) -> Bools:
    """Where a subject is cortex (N,): in its label, or else in a region; everywhere if it has neither."""
    if folded.cortex is not None:
        return folded.cortex
    regions, n = folded.regions, len(folded.surface.verts)
    if regions is None:
        return np.ones(n, dtype=bool)
    walls = [k for k, name in enumerate(regions.names) if name.lower() in WALL_NAMES]
    return (regions.labels >= 0) & ~np.isin(regions.labels, walls)


def _growing(subject: Subject, cortex: Bools, bilayer: Bilayer, fade: float) -> Array:
    """Share of the growth at each node (N,): 0 below the medial wall, 1 below what is ``fade`` [mm] away from it."""
    unfolding, n = subject.unfolding, bilayer.n_surface
    wall = cKDTree(unfolding.surface(unfolding.points[~subject.cortex]))
    away = np.minimum(wall.query(bilayer.mesh.p.T[:n])[0] / fade, 1.0)
    share = np.where(cortex, 0.5 - 0.5 * np.cos(np.pi * away), 0.0)
    return np.tile(share, len(bilayer.share) // n)
