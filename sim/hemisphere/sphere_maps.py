"""Maps on the sphere of a body: read from files, and smoothed by their spherical harmonics."""

from typing import Any, NamedTuple

import numpy as np

from morphofold.arrays import Array
from morphofold.errors import Mismatch, MissingPart, NotFinite
from morphofold.geometry import vertex_areas
from morphofold.io import read_morph, read_surface
from morphofold.io.files import existing_file
from morphofold.sim.hemisphere.subject import Vertices, subject_of_cortex
from morphofold.sim.scene import UnfoldedCortex
from morphofold.sim.scene.geometries import map_file, path_or_sample
from morphofold.sim.scene.tables import SphereMap
from morphofold.unfolding.harmonics import Expansion, fit
from morphofold.unfolding.unfold import points_on_sphere

PENALTY = 1e-3  # of the harmonics of a map, times l (l + 1): it bounds them where a map has no values
THINNEST, THICKEST = 0.6, 1.5  # of a cortex with a thickness map, over its mean


class SmoothMap(NamedTuple):
    """A map on the unit sphere: harmonics, the range of the values that they were fitted to, and their mean."""

    shape: Expansion
    least: float
    most: float
    mean: float

    def __call__(self, s: Array) -> Array:
        """Values (P,) at points (P, 3) of the unit sphere, within the range of the map."""
        return np.clip(self.shape(s)[:, 0], self.least, self.most)


def read_map(table: SphereMap, geometry: Any, *, positive: bool = False) -> SmoothMap:
    """Read a map and smooth it; with ``positive``, values of 0 and less do not count (FreeSurfer's for no value).

    Raises
    ------
    MissingPart
        If the map names no sphere, and the body is not made of a subject with one.
    Mismatch, NotFinite
        If the map does not fit its sphere, or has no values.
    """
    file = map_file(table, geometry)
    if table.sphere is not None:
        sphere, name = read_surface(existing_file(path_or_sample(table.sphere), "sphere")), table.sphere
        points = points_on_sphere(sphere, sphere)
        vertices = Vertices(points, vertex_areas(points, sphere.faces))
    elif isinstance(geometry, UnfoldedCortex):
        subject = subject_of_cortex(geometry)
        vertices, name = subject.vertices(), f"the surface of {geometry.subject}"
    else:
        raise MissingPart(f"{file}: is a map on a sphere, but names none. Add sphere = FILE to its table.")
    values = read_morph(file)
    if table.sphere is None and len(values) == subject.mended.of.n_vertices:
        values = values[subject.mended.source]
    if len(values) != len(vertices.points):
        raise Mismatch(
            f"{file}: has {len(values):,} values, {name} {len(vertices.points):,} vertices: name the sphere "
            "of the map as sphere in its table."
        )
    return smooth_map(np.where(values > 0, values, np.nan) if positive else values, vertices, table.degree, str(file))


def smooth_map(values: Array, vertices: Vertices, degree: int, name: str) -> SmoothMap:
    """The harmonics of values (N,) up to ``degree``; values that are not finite do not count."""
    weights = np.where(np.isfinite(values), vertices.areas, 0.0)
    use = weights > 0
    if not use.any():
        raise NotFinite(
            f"{name}: none of its {len(values):,} values counts where the cortex is (finite, and positive if it is a "
            "thickness or a stiffness). Name another map."
        )
    known = np.where(use, values, 0.0)
    shape = fit(vertices.points, known[:, None], weights, degree, PENALTY)
    return SmoothMap(shape, float(known[use].min()), float(known[use].max()), float(np.average(known, weights=weights)))


def thickness_factor(table: SphereMap, geometry: Any) -> SmoothMap:
    """Factor on the thickness of the cortex by a map: 1 in the mean, ``THINNEST`` to ``THICKEST``."""
    found = read_map(table, geometry, positive=True)
    shape = Expansion(found.shape.coefficients / found.mean)
    return SmoothMap(shape, max(found.least / found.mean, THINNEST), min(found.most / found.mean, THICKEST), 1.0)
