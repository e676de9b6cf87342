"""How far a hinge may be trusted: how near it is to not being one."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from morphofold.analysis.graph.depth_potential import LOW
from morphofold.analysis.graph.hinges import Hinge, hinges
from morphofold.surface import PerVertex

if TYPE_CHECKING:
    import networkx as nx


def label_hinges(graph: nx.MultiGraph, D: PerVertex, least: float) -> None:
    """Give each node of a gyral graph its ``confidence``, 0 to 1; NaN for one that is no hinge.

    Parameters
    ----------
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph`, complete but for this.
    D : (N,) float64
        Of the surface [mm].
    least : float
        Persistence that basins were asked for [mm].

    Notes
    -----
    The least of these margins, each cut off at 0 and 1:

    - how far the lowest point of its arms lies above the bottom of the sulci (quantile 0.05 of D), over how
      far the crests do (the median along the net): an arm over a buried bridge, or through a sulcus, is low;
    - how far its two nearest arms have parted a gyral width from it, over that width, ``2 sin(angle / 2)``: two gyri
      cannot be nearer than they are wide;
    - its persistence over ``least``, less 1;
    - the length of its shortest arm with a free end over ``prune``, below which there would be none, less 1. The mask
      and the border of a surface end an arm without making it a spur.

    Hence 0.25 is a hinge that would be none with a persistence or a shortest gyrus by a quarter larger, or whose arm
    dips three quarters of the way to the bottom of the sulci, or with two arms 14 degrees apart.
    """
    for _, node in graph.nodes(data=True):
        node["confidence"] = math.nan
    if graph.number_of_edges() == 0:
        return
    along = np.concatenate([crest["vertices"] for *_, crest in graph.edges(data=True)])
    bottom, top = float(np.quantile(D, LOW)), float(np.median(D[along]))
    for hinge in hinges(graph):
        graph.nodes[hinge.node]["confidence"] = _confidence(graph, hinge, bottom, top, least)


def _confidence(graph: nx.MultiGraph, hinge: Hinge, bottom: float, top: float, least: float) -> float:
    prune = graph.graph["scales"].prune
    free = [arm for arm in hinge.arms if graph.degree[arm.to] == 1 and not graph.nodes[arm.to]["cut"]]
    margins = [
        (min(arm.lowest for arm in hinge.arms) - bottom) / (top - bottom),
        2 * math.sin(math.radians(min(hinge.smallest, 180.0) / 2)),
        *(arm.length / prune - 1 for arm in free),
    ]
    if not math.isnan(hinge.persistence):  # else dead ends make it: their lengths count
        margins.append(hinge.persistence / least - 1)
    return float(np.clip(min(margins), 0, 1))
