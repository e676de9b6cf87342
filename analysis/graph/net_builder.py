"""The net of gyral crests as curves and junctions, from a depth potential and lengths in mm, and what these change."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from morphofold.analysis.graph.curve_net import Arc, Net, Node, borders, resampled, smoothed
from morphofold.analysis.graph.depth_potential import (
    REACH_IN_WIDTHS,
    SMOOTHING_IN_WIDTHS,
    SurfaceOperators,
    persistence,
)
from morphofold.analysis.graph.net_refinement import refine
from morphofold.analysis.graph.watershed import Watershed
from morphofold.analysis.shortest_paths import cheapest_path, path_graph, shorten, step_prices
from morphofold.errors import OptionsClash, OutOfRange
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import arc_length
from morphofold.mesh_quality import cortex_checks
from morphofold.progress_callbacks import Progress, logged
from morphofold.surface import Cortex, PerVertex, Surface
from morphofold.threads import run_parallel
from morphofold.validators import check_kind, one_of, positive

LOWEST_CROWN_QUANTILE = 0.1  # quantile of the depth potential along the net, below which there is no crown
# cost of a path exp(-4 c) + 0.03 per mm, c the distance to the flank in half widths
COST_DECAY, LEAST_COST_PER_MM = 4.0, 0.03
MOST_HALF_WIDTHS_FROM_FLANK = 1.3  # half widths from the flank, beyond which the cost stays the same
END_TRIM_IN_WIDTHS = 0.5  # widths between the end of a crest and the flank of its gyrus


def add_dead_ends(
    net: Net, operators: SurfaceOperators, paths: sparse.csr_array, D: PerVertex, crown: Bools, width: float, tip: float
) -> None:
    """Add crests to the tips of crowns that reach farther than ``tip`` [mm] from the net, the farthest first.

    ``crown`` (N,): candidate vertices. They count as crown if their depth potential D (N,) is also above the lowest
    tenth of the net. The path back to the net follows the middle of the crown (Sato and others 2000, the skeletons
    called TEASAR).
    """
    if not net.arcs:
        return
    vertex_tree = cKDTree(operators.verts)
    net_points = np.concatenate([resampled(arc.points, operators.mean_edge) for arc in net.arcs.values()])
    is_on_net = np.zeros(len(D), dtype=bool)
    is_on_net[vertex_tree.query(net_points)[1]] = True
    crown = crown & (D > np.quantile(D[is_on_net], LOWEST_CROWN_QUANTILE))
    flank_mm = np.where(crown, np.inf, 0.0)
    border_vertices = np.unique(operators.edges[crown[operators.edges[:, 0]] != crown[operators.edges[:, 1]]])
    shorten(paths, flank_mm, border_vertices[crown[border_vertices]], crown)
    cost = LEAST_COST_PER_MM + np.exp(-COST_DECAY * np.minimum(flank_mm / (0.5 * width), MOST_HALF_WIDTHS_FROM_FLANK))
    price_graph = step_prices(paths, cost)
    net_distance = np.full(len(D), np.inf)
    shorten(paths, net_distance, np.flatnonzero(is_on_net & crown), crown)
    while True:
        reached_distance = np.where(np.isfinite(net_distance), net_distance, 0.0)
        far_vertex = int(reached_distance.argmax())
        if reached_distance[far_vertex] <= tip:
            return
        path = cheapest_path(price_graph, far_vertex, is_on_net, crown)
        shorten(paths, net_distance, path, crown)
        path_points = operators.verts[path]
        path_points = path_points[arc_length(path_points) >= END_TRIM_IN_WIDTHS * width]
        is_on_net[path] = True
        if len(path_points) > 1:
            tip_node = net.add_node(Node(path_points[0]))
            root = _node_at_point(net, path_points[-1])
            net.add_arc(Arc(tip_node, root, np.concatenate([path_points, net.nodes[root].at[None]]), blind=True))


def _node_at_point(net: Net, point: Array) -> int:
    """The node of the net at a point, or a new node on the nearest curve."""
    arc_distances = {arc_id: np.linalg.norm(arc.points - point, axis=1) for arc_id, arc in net.arcs.items()}
    nearest_id = min(arc_distances, key=lambda arc_id: arc_distances[arc_id].min())
    arc, point_index = net.arcs[nearest_id], int(arc_distances[nearest_id].argmin())
    if point_index == 0 or point_index == len(arc.points) - 1:
        return arc.a if point_index == 0 else arc.b
    return net.split(nearest_id, point_index)


EQUAL_DISTANCE_TOLERANCE = 1e-2  # relative: where a border of basins crosses an edge, both ends are as near as that
STRONG_CREST_QUANTILE = 0.9  # quantile of strength, over the length of the net, taken as that of a true crest,
LEAST_STRENGTH_SHARE = 0.15  # and the share of it below which a crest is dropped


@dataclass(frozen=True)
class GyralScales:
    """The lengths of a gyral graph [mm]; :meth:`of_width` derives them from the crown width.

    Attributes
    ----------
    width : float
        Width of the gyri, from inflection to inflection.
    reach : float
        Reach of the depth potential. Features several times as wide count as the shape of the body.
    smoothing : float
        Standard deviation of the smoothing of the depth potential, and along the net.
    persistence : float
        Least height of the pass between two basins above the shallower one.
    merge : float
        A crest between two hinges that is shorter than this is contracted to one hinge.
    prune : float
        A crest with a free end that is shorter than this is dropped.
    tip : float
        A crown that reaches farther from the net than this gets its own crest.
    """

    width: float
    reach: float
    smoothing: float
    persistence: float
    merge: float
    prune: float
    tip: float

    @classmethod
    def of_width(cls, width: float) -> "GyralScales":
        """The lengths for a crown width: 1.5, 0.2, 0.25, 0.5, 1 and 1.5 widths."""
        return cls(*(widths * width for widths in (1, REACH_IN_WIDTHS, SMOOTHING_IN_WIDTHS, 0.25, 0.5, 1, 1.5)))


class Fields(NamedTuple):
    """Depth potential ``D`` (N,) [mm]; ``local_D`` (N,) [mm], D less D smoothed over a crown width; mean curvature
    ``H`` (N,) [1/mm]; ``watershed``, the basins of D."""

    D: PerVertex
    local_D: PerVertex
    H: PerVertex
    watershed: Watershed


class CrestNetBuilder:
    """Builds crest nets of one surface for any lengths. For a cortex it uses the white surface and the mask."""

    def __init__(self, surface: Cortex | Surface):
        check_kind(surface, (Cortex, Surface), "gyral_graph: surface")
        if isinstance(surface, Cortex):
            self.surface, self.is_inside = surface.white, cortex_checks.cortex_mask(surface)
        else:
            self.surface, self.is_inside = surface, np.ones(len(surface.verts), dtype=bool)
        self.operators = SurfaceOperators(self.surface.verts, self.surface.faces)
        self.tree = cKDTree(self.surface.verts)

    @cached_property
    def path_lengths(self) -> sparse.csr_array:
        """Graph of path lengths between vertices, for shortest paths."""
        return path_graph(self.surface.verts, self.surface.faces)

    def scales(self, width: float | None, scales: GyralScales | None) -> GyralScales | None:
        """The given lengths, or those for the given or measured width; None if there are no gyri."""
        if width is not None and scales is not None:
            raise OptionsClash("pass width or scales, not both: scales already contains the width.")
        if scales is None:
            width = self.operators.gyral_width(self.is_inside) if width is None else float(width)
            if math.isnan(width):
                return None
            scales = GyralScales.of_width(width)
        for name, value in asdict(scales).items():
            positive(value, name)
        least_width, largest_width = 0.1 * self.operators.mean_edge, 10 * self.operators.area**0.5
        if not least_width <= scales.width <= largest_width:
            raise OutOfRange(
                f"{self.surface.name}: a crown width of {scales.width:.4g} does not fit a surface with a mean edge of "
                f"{self.operators.mean_edge:.4g}. Pass a width of {least_width:.4g} to {largest_width:.4g}."
            )
        return scales

    def fields(self, scales: GyralScales) -> Fields:
        operators = self.operators

        def compute() -> Fields:
            D, H = operators.depth_and_curvature(scales.reach, scales.smoothing)
            return Fields(D, D - operators.smooth(D, scales.width), H, operators.watershed(D))

        return run_parallel(compute, lambda: self.path_lengths)[0]  # which the net needs next

    def net(self, fields: Fields, scales: GyralScales) -> Net:
        """Steps 1 to 4 of :func:`morphofold.analysis.gyral_graph`."""
        operators, width = self.operators, scales.width
        basin = fields.watershed.basins(persistence(fields.D, scales.persistence))
        net = borders(operators.verts, operators.faces, operators.edges, basin, fields.watershed.finest, fields.D)
        if not self.is_inside.all():
            net.keep(lambda points: np.all(self.is_inside[_nearest_vertices(self.tree, points)], axis=1))
        least_strength = _drop_weak_crests(net, fields.local_D, self.tree)
        for arc in net.arcs.values():
            arc.points = smoothed(arc.points, scales.smoothing)
        net.tidy_up(scales.merge, scales.prune, width)
        is_on_crown = (fields.H > 0) & (fields.local_D > least_strength) & self.is_inside
        add_dead_ends(net, operators, self.path_lengths, fields.D, is_on_crown, width, scales.tip)
        net.tidy_up(scales.merge, scales.prune, width)
        refine(net, operators, fields.D, width, rounds=1)
        net.tidy_up(scales.merge, scales.prune, width)
        return net


def _nearest_vertices(tree: cKDTree, points: Array) -> Ints:
    """The vertex (P, 2) nearest to each point, and the second one where two are equally near, else the first again.

    Borders of basins run midway between vertices, and which of the two is found first depends on their numbers.
    """
    dist, vertices = tree.query(points, k=2)
    vertices[:, 1] = np.where(dist[:, 1] <= (1 + EQUAL_DISTANCE_TOLERANCE) * dist[:, 0], vertices[:, 1], vertices[:, 0])
    return vertices.astype(np.int64)


def _drop_weak_crests(net: Net, band: PerVertex, tree: cKDTree) -> float:
    """Remove weak crests from the net; returns the least strength that is kept."""
    strengths = {
        name: float(np.median(band[_nearest_vertices(tree, arc.points)].mean(axis=1))) for name, arc in net.arcs.items()
    }
    if not strengths:
        return 0.0
    arc_ids = sorted(strengths, key=lambda name: strengths[name])
    totals = np.cumsum([net.arcs[name].length for name in arc_ids])
    least = LEAST_STRENGTH_SHARE * strengths[arc_ids[int(np.searchsorted(totals, STRONG_CREST_QUANTILE * totals[-1]))]]
    net.drop(*(name for name in arc_ids if strengths[name] < least))
    return least


#: lengths that are varied: those of the net, and those of its depth potential, which take longer
NET_LENGTHS = ("persistence", "merge", "prune", "tip")
POTENTIAL_LENGTHS = ("smoothing", "reach")
LENGTH_FACTORS = (0.5, 0.75, 1.5, 2.0)


def hinge_sensitivity(
    surface: Cortex | Surface,
    *,
    width: float | None = None,
    lengths: Sequence[str] = NET_LENGTHS + POTENTIAL_LENGTHS,
    factors: Sequence[float] = LENGTH_FACTORS,
    progress: Progress = logged,
) -> list[dict[str, Any]]:
    """Number of hinges when one length at a time is changed.

    Parameters
    ----------
    surface, width
        As in :func:`morphofold.analysis.gyral_graph`.
    lengths : sequence of str
        Fields of ``GyralScales``.
    factors : sequence of float
        Factors by which each length is multiplied.
    progress : callable
        Called with the share done and a short text.

    Returns
    -------
    list of dict
        ``length`` (its name; empty in the first row, which is the unchanged net), ``factor``, ``mm``, ``n_hinges``,
        ``n_hinges_3``, ``n_hinges_4``, ``n_ends``; ``crest_length_mm`` of the net before its curves move onto the
        crowns, 0.6 to 0.8 % more than that of ``measure``; ``kept``, the share of hinges of the unchanged net within
        half a crown width of a hinge of the changed net; ``old``, the share of hinges of the changed net within half a
        crown width of a hinge of the unchanged net. Empty if the surface has no folds.

    Raises
    ------
    ValueError
        If a name is not one of the lengths, or a factor is not positive.
    """
    for length_name in lengths:
        one_of(length_name, NET_LENGTHS + POTENTIAL_LENGTHS, "a length to vary")
    for factor in factors:
        positive(factor, "a factor", "number")
    builder = CrestNetBuilder(surface)
    scales = builder.scales(width, None)
    if scales is None:
        return []
    fields = builder.fields(scales)
    base_net = builder.net(fields, scales)
    rows = [_sensitivity_row("", 1.0, np.nan, base_net, base_net, scales)]
    variations = [(length_name, factor) for length_name in lengths for factor in factors]
    for k, (length_name, factor) in enumerate(variations):
        progress(k / len(variations), f"{length_name} x {factor:g}")
        length_mm = factor * getattr(scales, length_name)
        changed_scales = replace(scales, **{length_name: length_mm})
        net = builder.net(fields if length_name in NET_LENGTHS else builder.fields(changed_scales), changed_scales)
        rows.append(_sensitivity_row(length_name, factor, length_mm, net, base_net, scales))
    return rows


def _sensitivity_row(name: str, factor: float, mm: float, net: Net, base: Net, scales: GyralScales) -> dict[str, Any]:
    degrees = list(net.degrees().values())
    return {
        "length": name,
        "factor": factor,
        "mm": mm,
        "n_hinges": sum(degree > 2 for degree in degrees),
        "n_hinges_3": degrees.count(3),
        "n_hinges_4": degrees.count(4),
        "n_ends": degrees.count(1),
        "crest_length_mm": float(sum(arc.length for arc in net.arcs.values())),
        "kept": _share_of_hinges_near(base, net, scales),
        "old": _share_of_hinges_near(net, base, scales),
    }


def _share_of_hinges_near(net: Net, other: Net, scales: GyralScales) -> float:
    """Share of the hinges of one net within half a crown width of a hinge of the other; NaN if there are none."""
    points, others = ([n.nodes[node].at for node, degree in n.degrees().items() if degree > 2] for n in (net, other))
    if not (points and others):
        return 0.0 if points else np.nan
    return float((cKDTree(others).query(points)[0] < 0.5 * scales.width).mean())
