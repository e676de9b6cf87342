"""Clusters of a statistic on a mesh, and threshold-free cluster enhancement (TFCE), both by area."""

import numpy as np
from scipy.sparse.csgraph import connected_components

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import adjacency
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces
from morphofold.validators import same_length

#: E and H for surfaces (Winkler and others 2014; PALM's defaults in two dimensions)
EXTENT_POWER, HEIGHT_POWER = 1.0, 2.0


class Mesh:
    """Neighbours and areas of the vertices of a mesh on which clusters are formed.

    Parameters
    ----------
    faces : (M, 3) int64
    areas : (N,) float64
        Area that each vertex stands for [mm^2].
    """

    def __init__(self, faces: Faces, areas: Array):
        self.areas = np.asarray(areas, dtype=np.float64)
        self.ring = adjacency(len(self.areas), faces)

    def __repr__(self) -> str:
        return f"Mesh({len(self.areas):,} vertices, {self.areas.sum():.0f} mm2)"


def tfce(values: Array, mesh: Mesh) -> Array:
    """Threshold-free cluster enhancement of a map (N,): ``int_0^t e(h)^E h^H dh`` at a vertex of value t.

    e(h) is the area [mm^2] of the cluster of values above h that holds the vertex; E = 1, H = 2. Negative values are
    enhanced as their negatives, and are negative. NaN counts as 0.

    Notes
    -----
    Smith and Nichols 2009 (NeuroImage 44). Between two values of the map e(h) is constant, so the integral is exact:
    vertices are added from the highest value down, and clusters that meet are joined (union-find).
    """
    same_length(values, len(mesh.areas), "the map")
    filled_values = np.nan_to_num(values)
    enhancement: Array = enhanced(*reading(filled_values, by_size(filled_values), mesh.ring, mesh.areas), np.inf)[0]
    return enhancement


def by_size(values: Array) -> Ints:
    """The order of values (..., N), the largest in size first."""
    return np.argsort(-np.abs(values), axis=-1, kind="stable")


def clusters(values: Array, threshold: float, mesh: Mesh) -> tuple[Ints, Array]:
    """Connected clusters of vertices whose values (N,) are above a threshold.

    Returns
    -------
    cluster_of : (N,) int64
        Number of the cluster of each vertex, -1 where the value is not above; in the order of their first vertices.
    areas : (C,) float64
        Area of each [mm^2].
    """
    same_length(values, len(mesh.areas), "the map")
    rows_above = np.flatnonzero(values > threshold)
    cluster_of: Ints = np.full(len(values), -1)
    n_clusters, cluster_of[rows_above] = connected_components(mesh.ring[rows_above][:, rows_above], directed=False)
    return cluster_of, np.bincount(cluster_of[rows_above], mesh.areas[rows_above], n_clusters).astype(np.float64)


@kernel
def _root(parent, excess, vertex):
    """The root of a vertex; on the way, parents are shortened and ``excess`` stays the sum to the root."""
    root = vertex
    while parent[root] != root:
        root = parent[root]
    sum_to_root, node = 0.0, vertex  # the sum from v to the root, excluding the root's own
    while node != root:
        sum_to_root += excess[node]
        node = parent[node]
    node = vertex
    while node != root and parent[node] != root:
        next_node, node_excess = parent[node], excess[node]
        parent[node], excess[node] = root, sum_to_root
        sum_to_root -= node_excess
        node = next_node
    return root


@kernel
def enhanced(values, order, indptr, indices, areas, threshold):
    """TFCE (N,) of values whose ``order`` is that of :func:`by_size`, and the largest area of a cluster whose values
    are all above a threshold, or all below its negative.

    ``excess`` of a root is the integral of its cluster so far; of others, what they have more than their parent.
    """
    n_vertices = len(values)
    parent, excess = np.arange(n_vertices), np.zeros(n_vertices)
    extent, level, tree_rank = areas.copy(), np.abs(values), np.zeros(n_vertices, np.int32)
    is_added, largest_area = np.zeros(n_vertices, np.bool_), 0.0
    for node in order:
        node_height = level[node]
        if node_height == 0.0:
            break
        is_added[node] = True
        if node_height > threshold:
            largest_area = max(largest_area, areas[node])
        for edge in range(indptr[node], indptr[node + 1]):
            neighbour = np.int64(indices[edge])
            if not is_added[neighbour] or (values[node] > 0.0) != (values[neighbour] > 0.0):
                continue
            root, other_root = _root(parent, excess, node), _root(parent, excess, neighbour)
            if root == other_root:
                continue
            for either_root in (root, other_root):
                excess[either_root] += _gained(extent[either_root], node_height, level[either_root])
                level[either_root] = node_height
            if tree_rank[root] < tree_rank[other_root]:
                root, other_root = other_root, root
            tree_rank[root] += tree_rank[root] == tree_rank[other_root]
            parent[other_root], excess[other_root] = root, excess[other_root] - excess[root]
            extent[root] += extent[other_root]
            if node_height > threshold:
                largest_area = max(largest_area, extent[root])
    enhancement = np.zeros(n_vertices)
    for node in order:
        top = _root(parent, excess, node)
        enhancement[node] = excess[top] + _gained(extent[top], 0.0, level[top]) + (excess[node] if node != top else 0.0)
        if values[node] < 0.0:
            enhancement[node] = -enhancement[node]
    return enhancement, largest_area


@kernel
def _gained(extent, low, high):
    """The integral between two heights over a cluster of constant extent."""
    return extent**EXTENT_POWER * (high ** (HEIGHT_POWER + 1) - low ** (HEIGHT_POWER + 1)) / (HEIGHT_POWER + 1)
