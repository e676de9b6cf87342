"""The subject whose cortex grows: its files, its folded surface with what it unfolds to, and where it is cortex."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from morphofold.arrays import Array, Bools
from morphofold.geometry import vertex_areas
from morphofold.io.folded import Folded, folded_files, read_folded
from morphofold.provenance import sha256_of
from morphofold.sim.scene.geometries import UnfoldedCortex
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import Unfolding, unfold

#: names of regions that are not cortex
WALL_NAMES = ("unknown", "medial_wall", "medialwall", "corpuscallosum", "???")
_OF_THE_BODY_ONLY = {"held": "hole", "thickness_map": None, "cortex_thickness": 1.0, "hole_share": 0.25}


class Vertices(NamedTuple):
    """Vertices of a sphere: points (N, 3) of the unit sphere, and areas (N,) that weight them; 0 where they are not
    cortex."""

    points: Array
    areas: Array


class Subject(NamedTuple):
    """The hemisphere of a subject as it was read, what it unfolds to, and where it is cortex (N,)."""

    folded: Folded
    unfolding: Unfolding
    cortex: Bools

    def vertices(self) -> Vertices:
        """Its vertices on the sphere, weighted by the area of the smooth surface."""
        smooth = self.unfolding.smooth()
        return Vertices(self.unfolding.points, vertex_areas(smooth.verts, smooth.faces) * self.cortex)


def files_of_subject(geometry: UnfoldedCortex) -> dict[str, Path]:
    """The files of the subject, by content."""
    return folded_files(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)


def subject_of_cortex(geometry: UnfoldedCortex) -> Subject:
    """The hemisphere that a body is made of, as it was read, and what it unfolds to."""
    return _subject(geometry.model_copy(update=_OF_THE_BODY_ONLY), digests_of(files_of_subject(geometry)))


def digests_of(files: Mapping[str, Path]) -> tuple[str, ...]:
    return tuple(sha256_of(path) for path in files.values())


@lru_cache(maxsize=8)
def _subject(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Subject:
    """The subject of a geometry; ``digests`` are those of its files, so that a changed file is read again."""
    folded = read_folded(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)
    sphere = folded.sphere or sphere_of(folded.surface)
    return Subject(folded, unfold(folded.surface, sphere, geometry.unfold, radius=geometry.radius), _cortex(folded))


def _cortex(folded: Folded) -> Bools:
    """Where a subject is cortex (N,): in its label, or else in a region; everywhere if it has neither."""
    if folded.cortex is not None:
        return folded.cortex
    regions, n = folded.regions, len(folded.surface.verts)
    if regions is None:
        return np.ones(n, dtype=bool)
    walls = [k for k, name in enumerate(regions.names) if name.lower() in WALL_NAMES]
    return (regions.labels >= 0) & ~np.isin(regions.labels, walls)
