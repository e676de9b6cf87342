"""Hinges and crests as maps: how much of them is at each vertex, and how far it is to the nearest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.geodesics import path_graph, shorten
from morphofold.analysis.graph.hinges import counts
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
