"""The cost of accuracy on the hemisphere of a person: compared with its refinement, and thinned with itself.

The true numbers of a brain are unknown. Triangles cut in four do not change the surface, so changes are due to the mesh
alone. The loss of a thinned surface is known from the whole one. The error of a map is the area-weighted median of the
absolute difference over that of the absolute map: in a mean square, a few crushed vertices of a pial surface would
dominate.
"""

import statistics
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold import geometry
from morphofold.analysis import Measures, curvature, measure
from morphofold.analysis.resampled_cortex import PRESETS, Preset, resampled
from morphofold.analysis.thickness.gyral_thickness import weighted_quantile
from morphofold.io import read_cortex, sample_path
from morphofold.studies.accuracy.error_points import Case, Point, Timing, timed
from morphofold.studies.accuracy.known_fold_errors import VOXEL_COUNTS, f1, gyrification_over_voxels, local_index
from morphofold.studies.accuracy.measuring_errors import of_mesh, point
from morphofold.surface import Cortex, PerVertex, Surface

THINNED_COUNTS = (80_000, 40_000, 20_000, 10_000)
VERTEX_COUNTS = (120_000, 80_000, 60_000)  # curvature within 3 mm is just possible on these
COARSE_SIZE = 10_000  # vertices of the coarse person, on which the accuracies are also compared
FINEST_VOXELS = 25.0  # voxels in the radius of the closing
SCALARS = (
    "mean_cortical_thickness_mm",
    "median_gyral_thickness_mm",
    "wavelength_mm",
    "spectral_wavelength_mm",
    "crest_length_mm",
)


def cases() -> list[Case]:
    """The cases of this file."""
    return [
        Case("person-measures", partial(measures_of_person, THINNED_COUNTS)),
        Case("person-coarse", partial(coarse_person, COARSE_SIZE)),
        Case("person-curvature", partial(curvature_of_person, VERTEX_COUNTS)),
        Case("person-gyrification", gyrification_of_person),
    ]


@cache
def person() -> Cortex:
    """The sample S1: a left hemisphere of 152,893 vertices."""
    return read_cortex(sample_path("S1"))


def measures_of_person(mesh_sizes: tuple[int, ...], cortex: Cortex | None = None) -> list[Point]:
    """Presets and thinned meshes, compared with the triangles cut in four."""
    cortex = cortex or person()
    truth = measure(split(cortex))
    points = _presets("S1", cortex, truth, "split surface")
    for n_vertices in mesh_sizes:
        thinned = resampled(cortex, Preset(n_vertices, 0, 12.0))
        mesh_info = of_mesh(thinned.cortex.pial.verts, thinned.cortex.faces)
        axis_info = {"axis": "mesh", "against": "split surface", **mesh_info}
        points += _of_measures("S1", *timed_measures(thinned.cortex), truth, **axis_info)
    return points


def coarse_person(n_vertices: int, cortex: Cortex | None = None) -> list[Point]:
    """Presets on a thinned mesh, as coarse as fsaverage5, compared with the measures of the whole mesh."""
    cortex = cortex or person()
    true_measures = measure(cortex)
    coarse_cortex = resampled(cortex, Preset(n_vertices, 0, 12.0)).cortex
    return _presets(f"S1 at {n_vertices:,} vertices", coarse_cortex, true_measures, "whole mesh")


def _presets(subject: str, cortex: Cortex, truth: Measures, against: str) -> list[Point]:
    points: list[Point] = []
    for preset_name, preset in PRESETS.items():
        axis_info: dict[str, Any] = {
            "axis": "accuracy",
            "setting": preset_name,
            "value": resampled(cortex, preset).cortex.n_vertices,
            "preset": preset_name,
            "size": cortex.n_vertices,
            "against": against,
        }
        points += _of_measures(subject, *timed_measures(cortex, preset_name), truth, **axis_info)
    return points


def timed_measures(cortex: Cortex, accuracy: str = "standard") -> tuple[Measures, dict[str, Timing]]:
    """All measures, and the times of all (``"all measures"``) and of each scalar and the hinges measured alone."""
    timings = {
        name: timed(partial(measure, cortex, only=[name], accuracy=accuracy))[1] for name in (*SCALARS, "hinges")
    }
    measures, timings["all measures"] = timed(partial(measure, cortex, accuracy=accuracy))
    return measures, timings


def _of_measures(
    subject: str, measures: Measures, timings: dict[str, Timing], truth: Measures, **more_fields: Any
) -> Iterator[Point]:
    """A point per quantity with its time, and one of the median error with the time of all measures."""
    error_by_name = {name: abs(_scalar(measures, name) / _scalar(truth, name) - 1) for name in SCALARS}
    error_by_name["hinges"] = 1 - f1(_hinges(measures), _hinges(truth), 0.5 * truth.parameters["graph_width_mm"])
    for name, error in error_by_name.items():
        quantity = name.removesuffix("_mm").replace("_", " ")
        yield point(subject, quantity, error, timings[name], **more_fields)
    middle_error = statistics.median(error_by_name.values())
    yield point(subject, "all measures, median error", middle_error, timings["all measures"], **more_fields)


def _hinges(measures: Measures) -> NDArray[np.float64]:
    """Positions (P, 3) of the hinges."""
    return np.array([[hinge[axis] for axis in "xyz"] for hinge in measures.hinges], dtype=np.float64).reshape(-1, 3)


def _scalar(measures: Measures, name: str) -> float:
    """A scalar; 0, a relative error of 1, if it is missing."""
    return float(measures.scalars[name] or 0.0)


def curvature_of_person(mesh_sizes: tuple[int, ...], cortex: Cortex | None = None, scale: float = 3.0) -> list[Point]:
    """Mean curvature within 3 mm on white and pial, thinned, unchanged and split once, compared with split twice."""
    cortex = cortex or person()
    n = cortex.n_vertices
    thinned = [resampled(cortex, Preset(n_thinned, 0, 12.0)) for n_thinned in mesh_sizes]
    meshes = [*((thin.cortex, thin.target) for thin in thinned), (cortex, np.arange(n)), (split(cortex), np.arange(n))]
    points = []
    for surface_name in ("white", "pial"):
        surface = getattr(cortex, surface_name)
        areas = geometry.vertex_areas(surface.verts, surface.faces)
        finest_surface = getattr(split(split(cortex)), surface_name)
        true_curvature = curvature(finest_surface.verts, finest_surface.faces, scale).H[:n]
        for brain, vertex_map in meshes:
            mesh = getattr(brain, surface_name)
            H, timing = timed(partial(_mean_curvature, mesh, scale))
            error = median_error(H[vertex_map], true_curvature, areas)
            error_fields = f"S1, {surface_name}", "mean curvature", error, timing, "split surface"
            info = {"axis": "mesh", "preset": "standard" if brain is cortex else "", **of_mesh(mesh.verts, mesh.faces)}
            points.append(point(*error_fields, **info))
    return points


def _mean_curvature(surface: Surface, scale: float) -> PerVertex:
    return curvature(surface.verts, surface.faces, scale).H


def median_error(values: PerVertex, true_values: PerVertex, areas: PerVertex) -> float:
    """The error of a map (N,), as defined at the top of this file."""
    error_and_norm = [weighted_quantile(np.abs(field), areas, 0.5) for field in (values - true_values, true_values)]
    return error_and_norm[0] / error_and_norm[1]


def gyrification_of_person(cortex: Cortex | None = None, voxel_counts: tuple[float, ...] = VOXEL_COUNTS) -> list[Point]:
    """Local gyrification over voxel sizes, compared with the smallest."""
    pial = (cortex or person()).pial
    areas, true_indices = geometry.vertex_areas(pial.verts, pial.faces), local_index(pial, FINEST_VOXELS)
    error_of = lambda indices: median_error(indices, true_indices, areas)
    return gyrification_over_voxels("S1", pial, voxel_counts, error_of, "smallest voxels")


def split(cortex: Cortex) -> Cortex:
    """The cortex with every triangle cut in four: the same surfaces."""
    white, pial = (Surface(*geometry.split(old.verts, old.faces), name=old.name) for old in (cortex.white, cortex.pial))
    return Cortex(white, pial, cortex.hemi, cortex.name, units=cortex.units)
