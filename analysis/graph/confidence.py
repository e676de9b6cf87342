"""Confidence of a hinge: how far it is from not being a hinge."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.graph.depth_potential import LOW_QUANTILE
from morphofold.analysis.graph.hinges import Hinge, hinges
from morphofold.surface import PerVertex

if TYPE_CHECKING:
    import networkx as nx


def label_hinges(graph: nx.MultiGraph, D: PerVertex, least: float) -> None:
    """Set the ``confidence`` of each node of a gyral graph, 0 to 1; NaN for a node that is not a hinge.

    Parameters
    ----------
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph`, complete except for the confidence.
    D : (N,) float64
        Depth potential of the surface [mm].
    least : float
        Least persistence of the basins [mm].

    Notes
    -----
    The confidence is the least of these margins, each limited to 0 to 1:

    - the height of the lowest point of its arms above the bottom of the sulci (quantile 0.05 of D), divided by the
      height of the crests (the median along the net): an arm over a buried bridge, or through a sulcus, is low;
    - the distance between its two closest arms at one crown width from the hinge, divided by that width,
      ``2 sin(angle / 2)``: two gyri cannot be closer than their width;
    - its persistence divided by ``least``, less 1;
    - the length of its shortest arm with a free end divided by ``prune``, the length below which the arm would be
      removed, less 1. An arm that ends at the mask or the border of a surface is not a spur.

    A hinge therefore has 0.25 if it would vanish with a persistence or a shortest gyrus larger by a quarter, if its arm
    dips three quarters of the way to the bottom of the sulci, or if two arms are 14 degrees apart.
    """
    for _, node in graph.nodes(data=True):
        node["confidence"] = math.nan
    if graph.number_of_edges() == 0:
        return
    along = np.concatenate([crest["vertices"] for *_, crest in graph.edges(data=True)])
    bottom, top = float(np.quantile(D, LOW_QUANTILE)), float(np.median(D[along]))
    for hinge in hinges(graph):
        graph.nodes[hinge.node]["confidence"] = _hinge_confidence(graph, hinge, bottom, top, least)


def _hinge_confidence(graph: nx.MultiGraph, hinge: Hinge, bottom: float, top: float, least: float) -> float:
    prune = graph.graph["scales"].prune
    free = [arm for arm in hinge.arms if graph.degree[arm.to] == 1 and not graph.nodes[arm.to]["cut"]]
    margins = [
        (min(arm.lowest for arm in hinge.arms) - bottom) / (top - bottom),
        2 * math.sin(math.radians(min(hinge.smallest, 180.0) / 2)),
        *(arm.length / prune - 1 for arm in free),
    ]
    if not math.isnan(hinge.persistence):  # else it is a hinge by its dead ends, whose lengths count
        margins.append(hinge.persistence / least - 1)
    return float(np.clip(min(margins), 0, 1))
