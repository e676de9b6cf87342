"""The body of a scene whose shape is ``cortex``: a person's cortex, unfolded, with what is known of its vertices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import MissingPart, OutOfRange
from morphofold.geometry import vertex_areas
from morphofold.io.folded import Folded, folded_files, read_folded
from morphofold.provenance import sha256_of
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.smooth_body import SmoothBody, smooth_body
from morphofold.sim.mesh.sphere_maps import Vertices, map_file, smooth_map
from morphofold.sim.scene.geometries import UnfoldedCortex, path_or_sample
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import Unfolding, unfold

#: names of regions that are not cortex
WALL_NAMES = ("unknown", "medial_wall", "medialwall", "corpuscallosum", "???")
FADE_OVER_RADIUS = 0.12  # distance from the medial wall at which the cortex grows fully, over the radius of the body
THINNEST, THICKEST = 0.6, 1.5  # of a cortex with a thickness map, over its mean


class Subject(NamedTuple):
    """The hemisphere of a subject as it was read, what it unfolds to, and where it is cortex (N,)."""

    folded: Folded
    unfolding: Unfolding
    cortex: Bools

    def vertices(self, folder: Path | None) -> Vertices:
        points = self.unfolding.points
        areas = vertex_areas(points, self.folded.surface.faces)
        return Vertices(points, areas, self.cortex, folder, self.folded.hemi)


def files_of_cortex(geometry: UnfoldedCortex) -> dict[str, Path]:
    """All files that the body of a scene is made of, by content."""
    place = geometry.place()
    files = dict(folded_files(place, geometry.hemi, surface=geometry.surface, sphere=geometry.sphere))
    if geometry.thickness_map is not None:
        files["thickness_map"] = map_file(geometry.thickness_map, place if place.is_dir() else None, geometry.hemi)
        if geometry.thickness_map.sphere is not None:
            files["sphere of thickness_map"] = path_or_sample(geometry.thickness_map.sphere)
    return files


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
    digests = _digests(geometry)
    subject = subject_of_cortex(geometry)
    body = _smooth_body(geometry.model_copy(update={"held": "hole"}), digests)
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
    plain = geometry.model_copy(update={"held": "hole", "thickness_map": None, "cortex_thickness": 1.0})
    return _subject(plain, _digests(plain))


def _digests(geometry: UnfoldedCortex) -> tuple[str, ...]:
    return tuple(sha256_of(path) for path in files_of_cortex(geometry).values())


@lru_cache(maxsize=2)
def _subject(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Subject:
    """The subject of a geometry; ``digests`` are those of its files, so that a changed file is read again."""
    folded = read_folded(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)
    sphere = folded.sphere or sphere_of(folded.surface)
    return Subject(folded, unfold(folded.surface, sphere, geometry.unfold, radius=geometry.radius), _cortex(folded))


@lru_cache(maxsize=2)
def _smooth_body(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> SmoothBody:
    subject, T = subject_of_cortex(geometry), geometry.cortex_thickness
    thickness = T if geometry.thickness_map is None else _mapped_thickness(geometry, subject)
    return smooth_body(subject.unfolding.surface, thickness, T, geometry.hole_share)


def _mapped_thickness(geometry: UnfoldedCortex, subject: Subject) -> Callable[[Array], Array]:
    """Thickness of the cortex [mm] by a map, with the mean ``cortex_thickness`` over the area of the smooth cortex."""
    assert geometry.thickness_map is not None
    place = geometry.place()
    found = smooth_map(geometry.thickness_map, subject.vertices(place if place.is_dir() else None))
    smooth = subject.unfolding.smooth()
    weights = vertex_areas(smooth.verts, smooth.faces) * subject.cortex
    mean = float(np.average(found(subject.unfolding.points), weights=weights))
    if not (mean > 0 and found.least >= 0):
        raise OutOfRange(
            f"{geometry.thickness_map.file}: is {found.least:.3g} to {found.most:.3g} where the cortex is; a "
            "thickness must be positive."
        )
    return lambda s: geometry.cortex_thickness * np.clip(found(s) / mean, THINNEST, THICKEST)


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
