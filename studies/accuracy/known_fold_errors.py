"""The cost of accuracy for gyri: widths, hinges and crests of constructed folds with known answers."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis import gyral_thickness, local_gyrification_index
from morphofold.analysis.gyrification.local_gyrification import CLOSING_RADIUS_MM
from morphofold.analysis.resampled_cortex import PRESETS, Preset, resampled
from morphofold.frozen_arrays import Array
from morphofold.shapes.spherical_nets import SphericalNet, irregular_net
from morphofold.studies.accuracy.error_points import Case, Point, Timing, timed
from morphofold.studies.accuracy.measuring_errors import point
from morphofold.studies.folded_ball import (
    RIDGE_HEIGHT_MM,
    RIDGE_NET_CELLS,
    RIDGE_WIDTH_MM,
    SPHERE_RADIUS_MM,
    folded_ball,
)
from morphofold.studies.known_shapes import corrugated_sheet, ridged_sphere, sphere
from morphofold.studies.ridged_nets import from_arc
from morphofold.surface import Cortex, PerVertex, Surface

SHORTEST_ARC = 0.07  # [rad], shortest arc of the net: the ends of a shorter arc are one hinge by definition
VERTEX_COUNTS = (2_500, 10_000, 40_000, 160_000)
SCALES_MM = (3.0, 4.0, 6.0, 8.0, 10.0)  # [mm], scales of gyral thickness
VOXEL_COUNTS = (3.0, 4.0, 6.0, 8.0, 12.0, 20.0)  # in the radius of the closing


def cases() -> list[Case]:
    """The cases of this file."""
    return [
        Case("gyral-thickness-ridges", partial(width_of_ridges, (4, 5, 6, 7))),
        Case("gyral-thickness-sheet", partial(width_of_sheet, (3.0, 2.0, 1.5, 1.0, 0.75, 0.5))),
        Case("gyral-net", partial(net_over_meshes, VERTEX_COUNTS)),
        Case("local-gyrification", partial(gyrification_of_sphere, VOXEL_COUNTS)),
    ]


def width_of_ridges(ico_levels: Iterable[int]) -> list[Point]:
    """Median of gyral thickness over meshes and accuracies, and on the middle level also over scales."""
    ico_levels = list(ico_levels)
    points = []
    for level in ico_levels:
        cortex, width = ridged_sphere(level, 8.0, ridges=8, rng=0)
        n = cortex.n_vertices
        mesh_info: dict[str, Any] = {"size": n, "value": geometry.mean_edge_length(cortex.pial.verts, cortex.faces)}
        for name, median, timing in _at_accuracies(cortex, _median):
            points += [
                _width("ridged sphere", width, median, timing, **mesh_info, **axis_info) for axis_info in _axes(name, n)
            ]
    cortex, width = ridged_sphere(ico_levels[len(ico_levels) // 2], 8.0, ridges=8, rng=0)
    for scale in SCALES_MM:
        median, timing = timed(partial(_median, cortex, PRESETS["standard"], scale))
        entry: dict[str, Any] = {"axis": "scale", "setting": f"{scale:g} mm", "value": scale, "size": cortex.n_vertices}
        points.append(_width("ridged sphere", width, median, timing, **entry))
    return points


def width_of_sheet(edge_lengths: Iterable[float]) -> list[Point]:
    """Median of gyral thickness of a sheet over meshes with these edge lengths [mm]."""
    points = []
    for edge in edge_lengths:
        sheet, width = corrugated_sheet(edge, rng=0)
        median, timing = timed(lambda sheet=sheet: gyral_thickness(sheet).median)  # type: ignore[misc]
        n = len(sheet.verts)
        points.append(_width("corrugated sheet", width, median, timing, setting=f"{n:,} vertices", value=edge, size=n))
    return points


def _median(cortex: Cortex, preset: Preset, scale: float | None = None) -> float:
    return resampled(cortex, preset).gyral_thickness(scale=scale).median


def _width(subject: str, exact: float, median: float, timing: Timing, *, axis: str = "mesh", **fields: Any) -> Point:
    """The point of a median width; NaN, if no folds were resolved, counts as an error of 1."""
    error = abs(median / exact - 1) if np.isfinite(median) else 1.0
    return point(subject, "gyral thickness", error, timing, axis=axis, **fields)


def _at_accuracies(cortex: Cortex, compute: Callable[[Cortex, Preset], Any]) -> Iterator[tuple[str, Any, Timing]]:
    """Result and time of the work on a cortex at each accuracy; done once for accuracies that do not resample it."""
    standard = timed(partial(compute, cortex, PRESETS["standard"]))
    for preset_name, preset in PRESETS.items():
        yield preset_name, *(timed(partial(compute, cortex, preset)) if resampled(cortex, preset).changed else standard)


def _axes(preset: str, n_vertices: int) -> list[dict[str, Any]]:
    """Axes of a result at an accuracy; the standard result is also that of the unchanged mesh."""
    mesh_axes = [{"axis": "mesh", "setting": f"{n_vertices:,} vertices"}] if preset == "standard" else []
    return [*mesh_axes, {"axis": "accuracy", "setting": f"{preset}, {n_vertices:,} vertices", "preset": preset}]


def net_over_meshes(vertex_counts: Iterable[int]) -> list[Point]:
    """Hinges and crests of a net of ridges, on unchanged meshes and at the accuracies that resample them."""
    net = irregular_net(RIDGE_NET_CELLS, shortest=SHORTEST_ARC)
    points = []
    for n_vertices in vertex_counts:
        cortex = folded_ball(n_vertices, net)
        mean_edge = geometry.mean_edge_length(cortex.white.verts, cortex.faces)
        for preset_name, graph, timing in _at_accuracies(cortex, _graph):
            mesh_info: dict[str, Any] = {"size": n_vertices, "value": mean_edge}
            points += [
                point("ridged net", quantity, error, timing, **mesh_info, **axis_info)
                for quantity, error in net_errors(graph, net).items()
                for axis_info in _axes(preset_name, n_vertices)
            ]
    return points


def _graph(cortex: Cortex, preset: Preset) -> Any:
    return resampled(cortex, preset).gyral_graph(None)


def net_errors(graph: Any, net: SphericalNet) -> dict[str, float]:
    """Errors of a graph, with directions compared at the radius of the crests: ``hinges`` is 1 less the F1 score within
    half a crown width; ``hinge places`` and ``crest lines`` are median distances to the true ones over the width."""
    crown_radius = SPHERE_RADIUS_MM + RIDGE_HEIGHT_MM
    hinges = [attributes["position"] for _, attributes in graph.nodes(data=True) if attributes["degree"] > 2]
    if not hinges:
        return dict.fromkeys(("hinges", "hinge places", "crest lines"), 1.0)
    positions = crown_radius * geometry.unit(np.array(hinges))
    hinge_distances = cKDTree(positions).query(crown_radius * net.nodes)[0]
    line_points = geometry.unit(np.concatenate([polyline for *_, polyline in graph.edges(data="polyline")]))
    crest_offsets = np.min([from_arc(line_points, net.nodes[i], net.nodes[j])[0] for i, j in net.arcs.tolist()], axis=0)
    return {
        "hinges": 1 - f1(positions, crown_radius * net.nodes, RIDGE_WIDTH_MM / 2),
        "hinge places": float(np.median(hinge_distances)) / RIDGE_WIDTH_MM,
        "crest lines": float(np.median(crest_offsets)) * crown_radius / RIDGE_WIDTH_MM,
    }


def f1(positions: Array, true_positions: Array, max_distance: float) -> float:
    """F1 score of positions (P, 3), (Q, 3): twice the number of mutual nearest pairs within a distance, over P + Q."""
    if not len(positions):
        return 0.0
    distance, nearest_true = cKDTree(true_positions).query(positions)
    nearest_found = cKDTree(positions).query(true_positions)[1]
    n_pairs = np.count_nonzero((distance < max_distance) & (nearest_found[nearest_true] == np.arange(len(positions))))
    return 2 * n_pairs / (len(positions) + len(true_positions))


def local_index(surface: Surface, n_voxels: float) -> PerVertex:
    """Local gyrification index (N,) with this number of voxels in the radius of the closing."""
    return local_gyrification_index(surface.verts, surface.faces, voxel=CLOSING_RADIUS_MM / n_voxels)


def gyrification_of_sphere(voxel_counts: Iterable[float]) -> list[Point]:
    """Local gyrification index of a sphere the size of a hemisphere, which is 1 everywhere."""
    surface = sphere(6, 60.0, rng=0).surface
    rms_error = lambda index: float(np.sqrt(np.mean((index - 1) ** 2)))
    return gyrification_over_voxels("sphere", surface, voxel_counts, rms_error)


def gyrification_over_voxels(
    subject: str, mesh: Surface, counts: Iterable[float], error_of: Callable[[PerVertex], float], against: str = "exact"
) -> list[Point]:
    """Local gyrification index over numbers of voxels in the radius of the closing, of presets or others."""
    name_by_voxels = {preset.radius_voxels: preset_name for preset_name, preset in PRESETS.items()}
    points = []
    for n_voxels in counts:
        local_indices, timing = timed(partial(local_index, mesh, n_voxels))
        voxel_size = CLOSING_RADIUS_MM / n_voxels
        axis_info: dict[str, Any] = {"axis": "voxel", "setting": f"{voxel_size:g} mm", "value": voxel_size}
        axis_info["preset"] = name_by_voxels.get(n_voxels, "")
        error_fields = subject, "local gyrification", error_of(local_indices), timing, against
        points.append(point(*error_fields, size=len(mesh.verts), **axis_info))
    return points
