"""The subject whose cortex grows, and maps on the sphere of a body: read from files, smoothed by their harmonics."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from morphofold.digests_and_json import sha256_of
from morphofold.errors import Mismatch, MissingPart, NotFinite
from morphofold.frozen_arrays import Array, Bools
from morphofold.geometry import vertex_areas
from morphofold.io import read_morph, read_surface
from morphofold.io.cortices import folded_files, read_folded
from morphofold.io.files import existing_file
from morphofold.mesh_quality.cortex_checks import cortex_label
from morphofold.mesh_quality.repair import Mended, unfoldable
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene.geometries import MeshFile, UnfoldedCortex, map_file, map_files, path_or_sample
from morphofold.sim.scene.table_bases import SphereMap
from morphofold.unfolding.harmonics import Expansion, fit
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import Unfolding, points_on_sphere, unfold
from morphofold.validators import finite, one_of

AREA_RATIO = "area_ratio"  # the name of the subject's own map of areas, folded over unfolded
HARMONIC_PENALTY = 1e-3  # of the harmonics of a map, times l (l + 1): it bounds them where a map has no values
THINNEST, THICKEST = 0.6, 1.5  # of a cortex with a thickness map, over its mean
_OF_THE_BODY_ONLY = {"held": "hole", "thickness_map": None, "cortex_thickness": 1.0, "hole_share": 0.25}


class Subject(NamedTuple):
    """The hemisphere of a subject as it was read and repaired, what it unfolds to, where it is cortex (N,), and what
    says so: a word of :func:`~morphofold.mesh_quality.cortex_checks.cortex_label`."""

    mended: Mended
    unfolding: Unfolding
    cortex: Bools
    marked_by: str

    def vertices(self) -> tuple[Array, Array]:
        """Points (N, 3) of the unit sphere, and areas (N,) of the smooth surface that weight them, 0 outside cortex."""
        smooth_surface = self.unfolding.smooth()
        return self.unfolding.points, vertex_areas(smooth_surface.verts, smooth_surface.faces) * self.cortex


def files_of_subject(geometry: UnfoldedCortex) -> dict[str, Path]:
    """The files of the subject, by content."""
    return folded_files(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere)


def subject_of_cortex(geometry: UnfoldedCortex) -> Subject:
    """The hemisphere that a body is made of, as it was read, and what it unfolds to.

    Raises
    ------
    MissingPart
        If the medial wall is to be held, and nothing marks it; before the surface is unfolded.
    """
    cache_key = geometry.model_copy(update=_OF_THE_BODY_ONLY), digests_of(files_of_subject(geometry))
    if geometry.held == "medial wall" and cortex_label(_read(*cache_key).cortex)[0].all():
        raise MissingPart(
            f"{geometry.subject}: has no medial wall: neither label/{geometry.hemi}.cortex.label nor "
            f"{geometry.hemi}.aparc.annot marks one, surf/{geometry.hemi}.sphere.reg is missing, and white and pial "
            "meet on no large patch. Add the label, or set geometry.held = 'hole'."
        )
    return _subject(*cache_key)


def digests_of(files: Mapping[str, Path]) -> tuple[str, ...]:
    return tuple(map(sha256_of, files.values()))


@lru_cache(maxsize=8)
def _read(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Mended:
    """The repaired cortex of a geometry; ``digests`` are those of its files, so that a changed file is read again."""
    return unfoldable(read_folded(geometry.place(), geometry.hemi, surface=geometry.surface, sphere=geometry.sphere))


@lru_cache(maxsize=8)
def _subject(geometry: UnfoldedCortex, digests: tuple[str, ...]) -> Subject:
    mended = _read(geometry, digests)
    white = mended.cortex.white
    unfolding = unfold(white, mended.cortex.sphere or sphere_of(white), geometry.unfold, radius=geometry.radius)
    return Subject(mended, unfolding, *cortex_label(mended.cortex))


class SmoothMap(NamedTuple):
    """A map on the unit sphere: harmonics, the range of the values that they were fitted to, and their mean."""

    shape: Expansion
    least: float
    most: float
    mean: float

    def __call__(self, sphere_points: Array) -> Array:
        """Values (P,) at points (P, 3) of the unit sphere, within the range of the map."""
        return np.clip(self.shape(sphere_points)[:, 0], self.least, self.most)


def read_map(table: SphereMap, geometry: Any, *, positive: bool = False) -> SmoothMap:
    """Read a map and smooth it; with ``positive``, values of 0 and less do not count (FreeSurfer's for no value).

    Raises
    ------
    MissingPart
        If the map names no sphere, and the body is not made of a subject with one.
    Mismatch, NotFinite
        If the map does not fit its sphere, or has no values.
    """
    map_path = map_file(table, geometry)
    values = read_morph(map_path)
    if table.sphere is not None:
        sphere, sphere_name = read_surface(existing_file(path_or_sample(table.sphere), "sphere")), table.sphere
        points = points_on_sphere(sphere, sphere)
        points_areas = points, vertex_areas(points, sphere.faces)
    elif isinstance(geometry, UnfoldedCortex):
        subject = subject_of_cortex(geometry)
        points_areas, sphere_name = subject.vertices(), f"the surface of {geometry.subject}"
        if len(values) == subject.mended.original.n_vertices:
            values = values[subject.mended.source]
    else:
        raise MissingPart(f"{map_path}: is a map on a sphere, but names none. Add sphere = FILE to its table.")
    if len(values) != len(points_areas[0]):
        raise Mismatch(
            f"{map_path}: has {len(values):,} values, {sphere_name} {len(points_areas[0]):,} vertices: name the sphere "
            "of the map as sphere in its table."
        )
    values = np.where(values > 0, values, np.nan) if positive else values
    return smooth_map(values, points_areas, table.degree, str(map_path))


def smooth_map(values: Array, weighted_points: tuple[Array, Array], degree: int, name: str) -> SmoothMap:
    """The harmonics of values (N,) up to ``degree``; values that are not finite do not count.

    ``weighted_points``: points (N, 3) of the unit sphere, and areas (N,) that weight them.
    """
    points, areas = weighted_points
    weights = np.where(np.isfinite(values), areas, 0.0)
    has_value = weights > 0
    if not has_value.any():
        raise NotFinite(
            f"{name}: none of its {len(values):,} values counts where the cortex is (finite, and positive if it is a "
            "thickness or a stiffness). Name another map."
        )
    filled_values = np.where(has_value, values, 0.0)
    expansion, used = fit(points, filled_values[:, None], weights, degree, HARMONIC_PENALTY), filled_values[has_value]
    return SmoothMap(expansion, float(used.min()), float(used.max()), float(np.average(filled_values, weights=weights)))


def thickness_factor(table: SphereMap, geometry: Any) -> SmoothMap:
    """Factor on the thickness of the cortex by a map: 1 in the mean, ``THINNEST`` to ``THICKEST``."""
    shape, least, most, mean = read_map(table, geometry, positive=True)
    return SmoothMap(Expansion(shape.coefficients / mean), max(least / mean, THINNEST), min(most / mean, THICKEST), 1.0)


@dataclass
class MapAtNodes:
    """The map of a table of a scene at the nodes of its body; it is read when it is needed.

    Parameters
    ----------
    table : SphereMap
        A map on a sphere, or the name of point data of a mesh file.
    geometry
        That of the scene.
    name : str
        Of the table, for messages.
    positive : bool
        Whether values of 0 and less on a sphere are no values.
    """

    table: SphereMap
    geometry: Any
    name: str
    positive: bool = False

    @property
    def _is_own_areas(self) -> bool:
        return isinstance(self.geometry, UnfoldedCortex) and self.table.file == AREA_RATIO

    @property
    def files(self) -> dict[str, Path]:
        """The files to read, by content; those of the subject or the mesh aside."""
        if isinstance(self.geometry, MeshFile) or self._is_own_areas:
            return {}
        return map_files(self.table, self.geometry, self.name)

    @cached_property
    def on_sphere(self) -> SmoothMap | None:
        """The map on the unit sphere; None if it is point data of a mesh."""
        if isinstance(self.geometry, MeshFile):
            return None
        if not self._is_own_areas:
            return read_map(self.table, self.geometry, positive=self.positive)
        subject = subject_of_cortex(self.geometry)
        return smooth_map(subject.unfolding.area_ratio(), subject.vertices(), self.table.degree, AREA_RATIO)

    @property
    def mean(self) -> float:
        """Mean over the cortex; 1 for point data."""
        return 1.0 if self.on_sphere is None else self.on_sphere.mean

    def at(self, bilayer: Bilayer) -> Array:
        """Values at the nodes (N,): the same at all depths, unless they are point data."""
        if self.on_sphere is not None:
            if bilayer.sphere is None:
                raise MissingPart(f"{self.table.file}: is a map on a sphere, but this body has none. Leave it out.")
            return np.tile(self.on_sphere(bilayer.sphere), len(bilayer.share) // bilayer.n_surface)
        one_of(self.table.file, sorted(bilayer.point_data), f"{self.name}: point data of the mesh")
        node_values = bilayer.point_data[self.table.file]
        finite(node_values, f"{self.name}: {self.table.file!r}", "Give every node a number.")
        return node_values
