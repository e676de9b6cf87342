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
from morphofold.studies.accuracy.accuracy_measuring import of_mesh, point
from morphofold.studies.accuracy.error_points import LONG, Case, Point, Timing, timed
from morphofold.studies.accuracy.known_fold_errors import VOXELS, f1, gyrification_over_voxels, local_index
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.timing import Stages

THINNED = (80_000, 40_000, 20_000, 10_000)
VERTEX_COUNTS = (120_000, 80_000, 60_000)  # curvature within 3 mm is just possible on these
COARSE = 10_000  # vertices of the coarse person, on which the accuracies are also compared
FINEST = 25.0  # voxels in the radius of the closing
#: scalar -> the stage of ``measure`` that computes it
SCALARS = {
    "mean_cortical_thickness_mm": "cortical thickness",
    "median_gyral_thickness_mm": "gyral thickness",
    "wavelength_mm": "gyral thickness",
    "spectral_wavelength_mm": "gyral graph",
    "crest_length_mm": "gyral graph",
}


def cases() -> list[Case]:
    """The cases of this file."""
    return [
        Case("person-measures", partial(measures_of_person, THINNED)),
        Case("person-coarse", partial(coarse_person, COARSE)),
        Case("person-curvature", partial(curvature_of_person, VERTEX_COUNTS)),
        Case("person-gyrification", gyrification_of_person),
    ]


@cache
def person() -> Cortex:
    """The sample S1: a left hemisphere of 152,893 vertices."""
    return read_cortex(sample_path("S1"))


def measures_of_person(sizes: tuple[int, ...], cortex: Cortex | None = None) -> list[Point]:
    """Presets and thinned meshes, compared with the triangles cut in four."""
    cortex = cortex or person()
    truth = measure(split(cortex))
    points = _presets("S1", cortex, truth, "split surface")
    for size in sizes:
        thinned = resampled(cortex, Preset(size, 0, 12.0))
        mesh_keys = of_mesh(thinned.cortex.pial.verts, thinned.cortex.faces)
        points += _of_measures("S1", *staged(thinned.cortex), truth, axis="mesh", against="split surface", **mesh_keys)
    return points


def coarse_person(size: int, cortex: Cortex | None = None) -> list[Point]:
    """Presets on a thinned mesh, as coarse as fsaverage5, compared with the measures of the whole mesh."""
    cortex = cortex or person()
    true_measures = measure(cortex)
    coarse = resampled(cortex, Preset(size, 0, 12.0)).cortex
    return _presets(f"S1 at {size:,} vertices", coarse, true_measures, "whole mesh")


def _presets(subject: str, cortex: Cortex, truth: Measures, against: str) -> list[Point]:
    points: list[Point] = []
    for name, accuracy in PRESETS.items():
        axis_keys: dict[str, Any] = {
            "axis": "accuracy",
            "setting": name,
            "value": resampled(cortex, accuracy).cortex.n_vertices,
            "preset": name,
            "size": cortex.n_vertices,
            "against": against,
        }
        points += _of_measures(subject, *staged(cortex, name), truth, **axis_keys)
    return points


def staged(cortex: Cortex, accuracy: str = "standard") -> tuple[Measures, dict[str, Timing]]:
    """All measures, and the times of each stage and of the whole; repeated as in ``timed``, without a warm-up."""
    timings: list[dict[str, float]] = []
    while not timings or (len(timings) < 3 and timings[0]["all measures"] < 2 * LONG):
        clock = Stages()
        measures = measure(cortex, accuracy=accuracy, clock=clock)
        timings.append({**clock.seconds, "all measures": sum(clock.seconds.values())})
    times_of_stage = {stage: [row[stage] for row in timings] for stage in timings[0]}
    return measures, {stage: Timing.of(column) for stage, column in times_of_stage.items()}


def _of_measures(
    subject: str, measures: Measures, times: dict[str, Timing], truth: Measures, **about: Any
) -> Iterator[Point]:
    """A point per quantity with the time of its stage, and one of the median error with the time of the whole."""
    errors = {name: abs(_scalar(measures, name) / _scalar(truth, name) - 1) for name in SCALARS}
    errors["hinges"] = 1 - f1(_hinges(measures), _hinges(truth), 0.5 * truth.parameters["graph_width_mm"])
    for name, error in errors.items():
        label = name.removesuffix("_mm").replace("_", " ")
        yield point(subject, label, error, times[SCALARS.get(name, "gyral graph")], **about)
    median = statistics.median(errors.values())
    yield point(subject, "all measures, median error", median, times["all measures"], **about)


def _hinges(measures: Measures) -> NDArray[np.float64]:
    """Positions (P, 3) of the hinges."""
    return np.array([[row[k] for k in "xyz"] for row in measures.hinges], dtype=np.float64).reshape(-1, 3)


def _scalar(measures: Measures, name: str) -> float:
    """A scalar; 0, a relative error of 1, if it is missing."""
    return float(measures.scalars[name] or 0.0)


def curvature_of_person(sizes: tuple[int, ...], cortex: Cortex | None = None, scale: float = 3.0) -> list[Point]:
    """Mean curvature within 3 mm on white and pial, thinned, unchanged and split once, compared with split twice."""
    cortex = cortex or person()
    n = cortex.n_vertices
    thinned = [resampled(cortex, Preset(size, 0, 12.0)) for size in sizes]
    meshes = [*((copy.cortex, copy.target) for copy in thinned), (cortex, np.arange(n)), (split(cortex), np.arange(n))]
    points = []
    for kind in ("white", "pial"):
        surface = getattr(cortex, kind)
        areas = geometry.vertex_areas(surface.verts, surface.faces)
        finest = getattr(split(split(cortex)), kind)
        true_curvature = curvature(finest.verts, finest.faces, scale).H[:n]
        for body, vertex_map in meshes:
            mesh = getattr(body, kind)
            H, timing = timed(partial(_mean_curvature, mesh, scale))
            error = median_error(H[vertex_map], true_curvature, areas)
            error_fields = f"S1, {kind}", "mean curvature", error, timing, "split surface"
            mesh_keys = {
                "axis": "mesh",
                "preset": "standard" if body is cortex else "",
                **of_mesh(mesh.verts, mesh.faces),
            }
            points.append(point(*error_fields, **mesh_keys))
    return points


def _mean_curvature(surface: Surface, scale: float) -> PerVertex:
    return curvature(surface.verts, surface.faces, scale).H


def median_error(values: PerVertex, truth: PerVertex, areas: PerVertex) -> float:
    """The error of a map (N,), as defined at the top of this file."""
    error_and_size = [weighted_quantile(np.abs(field), areas, 0.5) for field in (values - truth, truth)]
    return error_and_size[0] / error_and_size[1]


def gyrification_of_person(cortex: Cortex | None = None, voxels: tuple[float, ...] = VOXELS) -> list[Point]:
    """Local gyrification over voxel sizes, compared with the smallest."""
    pial = (cortex or person()).pial
    areas, true_indices = geometry.vertex_areas(pial.verts, pial.faces), local_index(pial, FINEST)
    error_of = lambda index: median_error(index, true_indices, areas)
    return gyrification_over_voxels("S1", pial, voxels, error_of, "smallest voxels")


def split(cortex: Cortex) -> Cortex:
    """The cortex with every triangle cut in four: the same surfaces."""
    white, pial = (Surface(*geometry.split(s.verts, s.faces), name=s.name) for s in (cortex.white, cortex.pial))
    return Cortex(white, pial, cortex.hemi, cortex.name, units=cortex.units)
