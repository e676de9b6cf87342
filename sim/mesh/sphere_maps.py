"""Maps on the sphere of a body: read from files, and smoothed by their spherical harmonics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from morphofold.arrays import Array, Bools
from morphofold.errors import Mismatch, MissingPart, NotFinite
from morphofold.geometry import vertex_areas
from morphofold.io import read_morph, read_surface
from morphofold.io.files import existing_file
from morphofold.sim.scene.geometries import path_or_sample
from morphofold.sim.scene.tables import SphereMap
from morphofold.unfolding.harmonics import Expansion, fit

PENALTY = 1e-3  # of the harmonics of a map, times l (l + 1): it bounds them where a map has no values


class SmoothMap(NamedTuple):
    """A map on the unit sphere: harmonics, and the range of the values that they were fitted to."""

    shape: Expansion
    least: float
    most: float

    def __call__(self, s: Array) -> Array:
        """Values (P,) at points (P, 3) of the unit sphere, within the range of the map."""
        return np.clip(self.shape(s)[:, 0], self.least, self.most)


class Vertices(NamedTuple):
    """The vertices of a subject: points (N, 3) of the unit sphere, their shares of it (N,), where they are cortex (N,),
    and the folder with its surfaces and maps, if it has one."""

    points: Array
    areas: Array
    cortex: Bools
    folder: Path | None
    hemi: str


def map_file(table: SphereMap, folder: Path | None, hemi: str) -> Path:
    """The file of a map; ``folder`` is that of a subject, if there is one."""
    if folder is not None and re.fullmatch(r"[\w.-]+", table.file):
        own = folder / "surf" / f"{hemi}.{table.file}"
        if own.is_file():
            return own
    return existing_file(path_or_sample(table.file), "map")


def smooth_map(table: SphereMap, own: Vertices | None) -> SmoothMap:
    """Read a map and smooth it.

    Parameters
    ----------
    table : SphereMap
    own : Vertices or None
        Those of the subject of the body, on whose sphere the map is unless it names another.

    Raises
    ------
    MissingPart
        If the body has no subject, and the map names no sphere.
    Mismatch, NotFinite
        If the map does not fit its sphere, or has no values.
    """
    file = map_file(table, own and own.folder, own.hemi if own else "lh")
    values = read_morph(file)
    if table.sphere is not None:
        sphere = read_surface(path_or_sample(table.sphere))
        length = np.linalg.norm(sphere.verts, axis=1, keepdims=True)
        points, use = sphere.verts / np.maximum(length, 1e-300), np.ones(len(length), dtype=bool)
        areas, name = vertex_areas(points, sphere.faces), table.sphere
    elif own is not None:
        points, areas, use, name = own.points, own.areas, own.cortex, "the subject"
    else:
        raise MissingPart(f"{file}: is a map on a sphere, but names none. Add sphere = FILE to its table.")
    if len(values) != len(points):
        raise Mismatch(
            f"{file} has {len(values):,} values, {name} {len(points):,} vertices: they do not belong together."
        )
    use = use & np.isfinite(values)
    if not use.any():
        raise NotFinite(f"{file}: has no finite value where the cortex is.")
    weights = np.where(use, areas, 0.0)
    shape = fit(points, np.where(use, values, 0.0)[:, None], weights, table.degree, PENALTY)
    return SmoothMap(shape, float(values[use].min()), float(values[use].max()))
