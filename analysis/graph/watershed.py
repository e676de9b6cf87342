"""Basins of a function on a surface, how they join when the passes between them are flooded."""

from collections.abc import Collection, Sequence

import numpy as np

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import connected, symmetric
from morphofold.kernels import kernel, reading
from morphofold.surface import PerVertex

# slopes (relative) and passes (of the range of values) that are the same up to the error of the solver
EQUAL_SLOPE_TOLERANCE, EQUAL_PASS_TOLERANCE = 1e-4, 1e-5


class Watershed:
    """Basins of a function by steepest descent. Basins of low persistence can be joined.

    Parameters
    ----------
    edges, lengths : (E, 2) int64, (E,) float64
        Edges of the surface and their lengths.
    values : (N,) float64
        The function; equal values are ordered by vertex number.
    tie_values : (N,) float64
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
    filled : (J,) int64
        Basin of that point: it ends there, while the deeper one goes on.
    """

    def __init__(self, edges: Ints, lengths: Array, values: PerVertex, tie_values: PerVertex):
        graph = symmetric(len(values), edges, lengths)
        vertex_order = np.argsort(values, kind="stable")
        self.finest, self.lowest = _basins_by_descent(*reading(values, vertex_order, tie_values, graph))
        end_basins = self.finest[edges]
        crossing_edges = np.flatnonzero(end_basins[:, 0] != end_basins[:, 1])
        heights = values[edges[crossing_edges]].max(axis=1)
        pass_rank = np.round(heights / max(EQUAL_PASS_TOLERANCE * np.ptp(values), 1e-300))
        order = np.lexsort((tie_values[edges[crossing_edges]].max(axis=1), pass_rank))
        crossings, depths = crossing_edges[order], values[self.lowest]
        self.joins, self.heights, self.filled = _join_basins(*reading(end_basins[crossings], heights[order], depths))

    def basins(self, persistence: float) -> Ints:
        """Basin (N,) of each vertex, numbered from 0, after basins of less persistence are joined to a neighbour."""
        return self.merged(persistence)[self.finest]

    def separation(self, groups: Sequence[Collection[int]], n_least: int, least_height: float) -> Array:
        """For each group of finest basins, the persistence up to which ``n_least`` of them stay separate, if that is
        more than ``least_height``; else NaN."""
        persistences = np.full(len(groups), np.nan)
        open_groups = list(range(len(groups)))
        for height in np.sort(self.heights[self.heights >= least_height]):
            basin_labels = self.merged(height).tolist()
            open_groups = [k for k in open_groups if len({basin_labels[basin] for basin in groups[k]}) >= n_least]
            persistences[open_groups] = height
        return persistences

    def merged(self, persistence: float) -> Ints:
        """For each of the finest basins (B,), the basin to which it then belongs, numbered from 0."""
        return connected(len(self.lowest), self.joins[self.heights < persistence])


@kernel
def _basins_by_descent(values, vertex_order, tie_values, indptr, indices, lengths):
    """Basin (N,) of each vertex and the lowest vertex of each basin (B,); ``vertex_order`` is from the lowest up."""
    n = len(values)
    rank, basin, lowest_vertex = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        rank[vertex_order[k]] = k
    n_basins = 0
    for k in range(n):
        vertex = vertex_order[k]
        steepest_slope, next_vertex = 0.0, -1
        for e in range(indptr[vertex], indptr[vertex + 1]):
            neighbour = indices[e]
            if rank[neighbour] < k:
                slope = (values[vertex] - values[neighbour]) / max(lengths[e], 1e-300)
                if next_vertex >= 0 and abs(slope - steepest_slope) <= EQUAL_SLOPE_TOLERANCE * steepest_slope:
                    next_vertex = neighbour if tie_values[neighbour] > tie_values[next_vertex] else next_vertex
                elif next_vertex < 0 or slope > steepest_slope:
                    steepest_slope, next_vertex = slope, neighbour
        if next_vertex < 0:
            basin[vertex], lowest_vertex[n_basins] = n_basins, vertex
            n_basins += 1
        else:
            basin[vertex] = basin[next_vertex]
    return basin, lowest_vertex[:n_basins].copy()


@kernel
def _join_basins(end_basins, pass_heights, lowest_values):
    """Kruskal's forest over passes from the lowest up: pairs of basins (J, 2) that join, their persistence (J,), and
    the basin (J,) that ends. Basins are numbered from the deepest up, so each root is the deepest of its tree."""
    parent, joins = np.arange(len(lowest_values)), np.empty((len(lowest_values), 2), np.int64)
    heights, ended_basin = np.empty(len(lowest_values)), np.empty(len(lowest_values), np.int64)
    n_joins = 0
    for k in range(len(pass_heights)):
        root_a, root_b = _find_tree_root(parent, end_basins[k, 0]), _find_tree_root(parent, end_basins[k, 1])
        if root_a == root_b:
            continue
        deep, shallow = min(root_a, root_b), max(root_a, root_b)
        joins[n_joins, 0], joins[n_joins, 1] = end_basins[k, 0], end_basins[k, 1]
        heights[n_joins], ended_basin[n_joins] = pass_heights[k] - lowest_values[shallow], shallow
        n_joins += 1
        parent[shallow] = deep
    return joins[:n_joins].copy(), heights[:n_joins].copy(), ended_basin[:n_joins].copy()


@kernel
def _find_tree_root(parent, basin):
    while parent[basin] != basin:
        parent[basin] = parent[parent[basin]]
        basin = parent[basin]
    return basin
