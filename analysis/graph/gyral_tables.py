"""Hinges and crests of a gyral graph over the cortex: rows of tables, amounts by region, and maps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis.graph.hinges import LEAST_STRICT_CONFIDENCE, as_rows, counts, hinges, row_of, table_columns
from morphofold.analysis.shortest_paths import path_graph, shorten
from morphofold.frozen_arrays import Ints
from morphofold.geometry import arc_length
from morphofold.surface import Cortex, PerVertex
from morphofold.validators import check_kind

if TYPE_CHECKING:
    import networkx as nx


def landmark_maps(cortex: Cortex, graph: nx.MultiGraph) -> dict[str, PerVertex]:
    """Hinges and crests of a gyral graph as maps of its cortex.

    Parameters
    ----------
    cortex : Cortex
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph` of that cortex.

    Returns
    -------
    dict of str to (N,) float64
        ``hinges``: their number at each vertex, without doubtful ones. ``crest_length`` [mm]: half of each step of a
        crest is at the vertex of each of its ends. ``hinge_distance``, ``crest_distance`` [mm]: shortest paths along
        the white surface, about 4 % too long, to the nearest vertex with one; NaN if there is none.
    """
    check_kind(cortex, Cortex, "landmark_maps: cortex")
    n_vertices, maps = cortex.n_vertices, amounts(graph, cortex.n_vertices)
    path_lengths, all_allowed = path_graph(cortex.white.verts, cortex.faces), np.ones(n_vertices, dtype=bool)
    for name, amount in (("hinge_distance", maps["hinges"]), ("crest_distance", maps["crest_length"])):
        distance = np.full(n_vertices, np.inf)
        shorten(path_lengths, distance, np.flatnonzero(amount), all_allowed)
        maps[name] = np.where(np.isfinite(distance), distance, np.nan)
    return maps


def amounts(graph: nx.MultiGraph, n_vertices: int) -> dict[str, PerVertex]:
    """``hinges`` and ``crest_length`` of :func:`landmark_maps`, of a graph on ``n_vertices`` vertices."""
    hinge_vertices = [node["vertex"] for _, node in graph.nodes(data=True) if node["degree"] > 2 and counts(node)]
    crest_length = np.zeros(n_vertices)
    for *_, crest in graph.edges(data=True):
        arc_lengths = arc_length(crest["polyline"])
        step_length = np.diff(arc_lengths) * (crest["length"] / arc_lengths[-1] if arc_lengths[-1] > 0 else 0.0)
        for end_vertices in (crest["vertices"][:-1], crest["vertices"][1:]):
            np.add.at(crest_length, end_vertices, 0.5 * step_length)
    hinge_counts = np.bincount(np.array(hinge_vertices, dtype=np.int64), minlength=n_vertices).astype(np.float64)
    return {"hinges": hinge_counts, "crest_length": crest_length}


Row = dict[str, Any]

CREST_COLUMNS = table_columns(
    "hemi crest=number from_hinge=from to_hinge=to length_mm=length gyral_thickness_mm=gyral_thickness "
    "cortical_thickness_mm=cortical_thickness mean_H_per_mm=H region altitude_mm=altitude strength_mm=strength blind"
)
CREST_MEANS = {"gyral_thickness": np.median, "cortical_thickness": np.mean, "H": np.mean}  # of maps, over a crest


def gyral_tables(cortex: Cortex, graph: nx.MultiGraph, maps: Mapping[str, PerVertex]) -> dict[str, Any]:
    """Tables of the gyral graph of a cortex.

    Parameters
    ----------
    cortex : Cortex
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph` of that cortex.
    maps : mapping of str to (N,) float64
        ``gyral_thickness``, ``cortical_thickness`` [mm] and ``H`` [1/mm]; NaN where undefined. If a map is missing, its
        column of the crests is None.

    Returns
    -------
    dict
        The tables ``crests``, ``hinges`` and ``arms``, lists of rows, and the scalars of hinges and crests. For a
        crest: the median gyral and the mean cortical thickness over its vertices, the mean of H, and the region of most
        of its vertices; None where there is none. Ends of crests that are not hinges also have numbers. All hinges have
        a row. ``n_hinges``, ``n_hinges_3`` and ``n_hinges_4`` count hinges with a confidence of 0.25 or more,
        ``n_hinges_low`` those with 0.5 or more, and ``n_hinges_high`` all.
    """
    crest_rows = []
    for a, b, crest in graph.edges(data=True):
        vertices = np.unique(crest["vertices"])
        values = {**crest, "hemi": cortex.hemi, "from": a, "to": b, "region": _most_common_region(cortex, vertices)}
        values |= {name: mean_or_none(mean_of, maps.get(name), vertices) for name, mean_of in CREST_MEANS.items()}
        crest_rows.append(row_of(CREST_COLUMNS, values))
    all_hinges = hinges(graph)
    hinge_rows, arm_rows = as_rows(all_hinges)
    for row in hinge_rows:
        row["region"] = _most_common_region(cortex, np.array([row["vertex"]]))
        near = _crest_vertices_near(cortex, graph, row["hinge"])
        row["cortical_thickness_mm"] = mean_or_none(np.mean, maps.get("cortical_thickness"), near)
    for row in (*hinge_rows, *arm_rows):
        row["hemi"] = cortex.hemi
    degrees = [row["degree"] for row in hinge_rows if counts(row)]
    return {
        "crests": crest_rows,
        "hinges": hinge_rows,
        "arms": arm_rows,
        "n_hinges": len(degrees),
        "n_hinges_3": degrees.count(3),
        "n_hinges_4": degrees.count(4),
        "n_hinges_low": sum(hinge.confidence >= LEAST_STRICT_CONFIDENCE for hinge in all_hinges),
        "n_hinges_high": len(all_hinges),
        "n_crests": graph.number_of_edges(),
        "crest_length_mm": float(sum(crest["length"] for *_, crest in graph.edges(data=True))),
    }


def region_columns(cortex: Cortex, graph: nx.MultiGraph) -> dict[str, tuple[int, float]]:
    """For each region the number of its hinges without doubtful ones, and the length of the crests in it [mm]."""
    if cortex.regions is None:
        return {}
    in_region = np.flatnonzero(cortex.regions.labels >= 0)
    region_sums = [
        np.bincount(cortex.regions.labels[in_region], values[in_region], minlength=len(cortex.regions.names)).tolist()
        for values in amounts(graph, cortex.n_vertices).values()
    ]
    return {name: (int(n_hinges), length) for name, n_hinges, length in zip(cortex.regions.names, *region_sums)}


def _crest_vertices_near(cortex: Cortex, graph: nx.MultiGraph, node: int) -> Ints:
    """Vertices of the crests that meet in a node, within half a crown width of it."""
    vertices = np.unique(np.concatenate([edge["vertices"] for *_, edge in graph.edges(node, data=True)]))
    distance = np.linalg.norm(cortex.white.verts[vertices] - graph.nodes[node]["position"], axis=1)
    near: Ints = vertices[distance <= 0.5 * graph.graph["scales"].width]
    return near


def mean_or_none(mean_of: Any, values: PerVertex | None, vertices: Ints) -> float | None:
    """A mean of the finite values at some vertices; None if there are none."""
    if values is None:
        return None
    finite_values = np.asarray(values, dtype=np.float64)[vertices]
    finite_values = finite_values[np.isfinite(finite_values)]
    return float(mean_of(finite_values)) if len(finite_values) else None


def _most_common_region(cortex: Cortex, vertices: Ints) -> str | None:
    """The region of most of some vertices; None if they have none."""
    if cortex.regions is None:
        return None
    labels = cortex.regions.labels[vertices]
    labels = labels[labels >= 0]
    return cortex.regions.names[int(np.bincount(labels).argmax())] if len(labels) else None
