"""Hinges and crests of a gyral graph over the cortex: rows of tables, amounts by region, and maps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from morphofold.analysis.geodesics import path_graph, shorten
from morphofold.analysis.graph.hinges import LEAST_STRICT_CONFIDENCE, as_rows, counts, hinges
from morphofold.arrays import Ints
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
    n, found = cortex.n_vertices, amounts(graph, cortex.n_vertices)
    paths, everywhere = path_graph(cortex.white.verts, cortex.faces), np.ones(n, dtype=bool)
    for name, amount in (("hinge_distance", found["hinges"]), ("crest_distance", found["crest_length"])):
        way = np.full(n, np.inf)
        shorten(paths, way, np.flatnonzero(amount), everywhere)
        found[name] = np.where(np.isfinite(way), way, np.nan)
    return found


def amounts(graph: nx.MultiGraph, n: int) -> dict[str, PerVertex]:
    """``hinges`` and ``crest_length`` of :func:`landmark_maps`, of a graph on ``n`` vertices."""
    at = [node["vertex"] for _, node in graph.nodes(data=True) if node["degree"] > 2 and counts(node)]
    length = np.zeros(n)
    for *_, crest in graph.edges(data=True):
        along = arc_length(crest["polyline"])
        steps = np.diff(along) * (crest["length"] / along[-1] if along[-1] > 0 else 0.0)
        for end in (crest["vertices"][:-1], crest["vertices"][1:]):
            np.add.at(length, end, 0.5 * steps)
    hinges = np.bincount(np.array(at, dtype=np.int64), minlength=n).astype(np.float64)
    return {"hinges": hinges, "crest_length": length}


Row = dict[str, Any]


class GyralTables(NamedTuple):
    """Rows of crests, hinges and arms, and the scalars that ``measure`` reports for them."""

    crests: list[Row]
    hinges: list[Row]
    arms: list[Row]
    scalars: dict[str, float | int]


def gyral_tables(cortex: Cortex, graph: nx.MultiGraph, maps: Mapping[str, PerVertex]) -> GyralTables:
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
    GyralTables
        For a crest: the median gyral and the mean cortical thickness over its vertices, the mean of H, and the region
        of most of its vertices; None where there is none. Ends of crests that are not hinges also have numbers. All
        hinges have a row. ``n_hinges``, ``n_hinges_3`` and ``n_hinges_4`` count hinges with a confidence of 0.25 or
        more, ``n_hinges_low`` those with 0.5 or more, and ``n_hinges_high`` all.
    """
    crest_rows = []
    for a, b, crest in graph.edges(data=True):
        at = np.unique(crest["vertices"])
        crest_rows.append(
            {
                "hemi": cortex.hemi,
                "crest": crest["number"],
                "from_hinge": a,
                "to_hinge": b,
                "length_mm": crest["length"],
                "gyral_thickness_mm": _mean_or_none(np.median, maps.get("gyral_thickness"), at),
                "cortical_thickness_mm": _mean_or_none(np.mean, maps.get("cortical_thickness"), at),
                "mean_H_per_mm": _mean_or_none(np.mean, maps.get("H"), at),
                "region": _most_common_region(cortex, at),
                "altitude_mm": crest["altitude"],
                "strength_mm": crest["strength"],
                "blind": int(crest["blind"]),
            }
        )
    found = hinges(graph)
    hinge_rows, arm_rows = as_rows(found)
    for row in hinge_rows:
        row.update(hemi=cortex.hemi, region=_most_common_region(cortex, np.array([row["vertex"]])))
        row["persistence_mm"] = None if np.isnan(row["persistence_mm"]) else row["persistence_mm"]
    for row in arm_rows:
        row.update(hemi=cortex.hemi)
    degrees = [row["degree"] for row in hinge_rows if counts(row)]
    scalars: dict[str, float | int] = {
        "n_hinges": len(degrees),
        "n_hinges_3": degrees.count(3),
        "n_hinges_4": degrees.count(4),
        "n_hinges_low": sum(hinge.confidence >= LEAST_STRICT_CONFIDENCE for hinge in found),
        "n_hinges_high": len(found),
        "n_crests": graph.number_of_edges(),
        "crest_length_mm": float(sum(crest["length"] for *_, crest in graph.edges(data=True))),
    }
    return GyralTables(crest_rows, hinge_rows, arm_rows, scalars)


def region_columns(cortex: Cortex, graph: nx.MultiGraph) -> dict[str, tuple[int, float]]:
    """For each region the number of its hinges without doubtful ones, and the length of the crests in it [mm]."""
    if cortex.regions is None:
        return {}
    known = np.flatnonzero(cortex.regions.labels >= 0)
    sums = [
        np.bincount(cortex.regions.labels[known], amount[known], minlength=len(cortex.regions.names)).tolist()
        for amount in amounts(graph, cortex.n_vertices).values()
    ]
    return {name: (int(count), length) for name, count, length in zip(cortex.regions.names, *sums)}


def _mean_or_none(mean: Any, values: PerVertex | None, at: Ints) -> float | None:
    if values is None:
        return None
    known = values[at][np.isfinite(values[at])]
    return float(mean(known)) if len(known) else None


def _most_common_region(cortex: Cortex, at: Ints) -> str | None:
    """The region of most of the vertices ``at``; None if they have none."""
    if cortex.regions is None:
        return None
    labels = cortex.regions.labels[at]
    labels = labels[labels >= 0]
    return cortex.regions.names[int(np.bincount(labels).argmax())] if len(labels) else None
