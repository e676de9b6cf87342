"""Basins of a function on a surface, and how they join when the passes between them are flooded."""

from collections.abc import Collection, Sequence

import numpy as np

from morphofold.analysis.graph.prominence import _find_tree_root
from morphofold.arrays import Array, Ints
from morphofold.geometry import connected, symmetric
from morphofold.kernels import kernel, reading
from morphofold.surface import PerVertex

# slopes (relative) and passes (of the range of values) that are the same up to the error of the solver
EQUAL_SLOPE_TOLERANCE, EQUAL_PASS_TOLERANCE = 1e-4, 1e-5


class Watershed:
    """Basins of a function by steepest descent. Basins of low persistence can be joined.

    Parameters
    ----------
    pairs, lengths : (E, 2) int64, (E,) float64
        Edges of the surface and their lengths.
    values : (N,) float64
        The function; equal values are ordered by vertex number.
    side : (N,) float64
        Any other function. It decides where two ways down are equally steep, or two passes equally high, as on the two
        sides of a plane of symmetry.

    Attributes
    ----------
    finest : (N,) int64
        Basin of each vertex before any are joined.
    lowest : (B,) int64
        Lowest vertex of each of those basins.
    joins, heights : (J, 2) int64, (J,) float64
        Pairs of basins that touch at a pass (a forest), and the persistence up to which they stay separate: the height
        of the pass above the higher of the two deepest points that meet there (Edelsbrunner, Letscher, Zomorodian
        2002).
    """

    def __init__(self, pairs: Ints, lengths: Array, values: PerVertex, side: PerVertex):
        graph = symmetric(len(values), pairs, lengths)
        order = np.argsort(values, kind="stable")
        self.finest, self.lowest = _basins_by_descent(*reading(values, order, side, graph))
        ends = self.finest[pairs]
        crossing = np.flatnonzero(ends[:, 0] != ends[:, 1])
        passes = values[pairs[crossing]].max(axis=1)
        equal = np.round(passes / max(EQUAL_PASS_TOLERANCE * np.ptp(values), 1e-300))
        flood = np.lexsort((side[pairs[crossing]].max(axis=1), equal))
        self.joins, self.heights = _join_basins(*reading(ends[crossing[flood]], passes[flood], values[self.lowest]))

    def basins(self, persistence: float) -> Ints:
        """Basin (N,) of each vertex, numbered from 0, after basins of less persistence are joined to a neighbour."""
        return self.together(persistence)[self.finest]

    def apart(self, groups: Sequence[Collection[int]], least: int, above: float) -> Array:
        """For each group of finest basins, the persistence up to which ``least`` of them stay separate, if that is
        more than ``above``; else NaN."""
        held = np.full(len(groups), np.nan)
        open_ = list(range(len(groups)))
        for height in np.sort(self.heights[self.heights >= above]):
            label = self.together(height).tolist()
            open_ = [k for k in open_ if len({label[basin] for basin in groups[k]}) >= least]
            held[open_] = height
        return held

    def together(self, persistence: float) -> Ints:
        """For each of the finest basins (B,), the basin to which it then belongs, numbered from 0."""
        return connected(len(self.lowest), self.joins[self.heights < persistence])


@kernel
def _basins_by_descent(values, order, side, indptr, indices, lengths):
    """Basin (N,) of each vertex and the lowest vertex of each basin (B,); ``order``: vertices from the lowest up."""
    n = len(values)
    rank, basin, lowest = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        rank[order[k]] = k
    count = 0
    for k in range(n):
        v = order[k]
        steepest, down = 0.0, -1
        for e in range(indptr[v], indptr[v + 1]):
            w = indices[e]
            if rank[w] < k:
                slope = (values[v] - values[w]) / max(lengths[e], 1e-300)
                if down >= 0 and abs(slope - steepest) <= EQUAL_SLOPE_TOLERANCE * steepest:
                    down = w if side[w] > side[down] else down
                elif down < 0 or slope > steepest:
                    steepest, down = slope, w
        if down < 0:
            basin[v], lowest[count] = count, v
            count += 1
        else:
            basin[v] = basin[down]
    return basin, lowest[:count].copy()


@kernel
def _join_basins(ends, passes, deepest):
    """Kruskal's forest over passes from the lowest up: pairs of basins (J, 2) that join, and their persistence (J,)."""
    parent, low = np.arange(len(deepest)), deepest.copy()
    joins, heights = np.empty((len(deepest), 2), np.int64), np.empty(len(deepest))
    count = 0
    for k in range(len(passes)):
        a, b = _find_tree_root(parent, ends[k, 0]), _find_tree_root(parent, ends[k, 1])
        if a == b:
            continue
        if low[a] > low[b]:
            a, b = b, a
        joins[count, 0], joins[count, 1] = ends[k, 0], ends[k, 1]
        heights[count] = passes[k] - low[b]
        count += 1
        parent[b] = a
    return joins[:count].copy(), heights[:count].copy()
