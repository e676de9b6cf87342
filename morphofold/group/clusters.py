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
    known_values = np.nan_to_num(values)
    enhancement: Array = enhanced(*reading(known_values, by_size(known_values), mesh.ring, mesh.areas), np.inf)[0]
    return enhancement


def by_size(values: Array) -> Ints:
    """The order of values (..., N), the largest in size first."""
    return np.argsort(-np.abs(values), axis=-1, kind="stable")


def clusters(values: Array, threshold: float, mesh: Mesh) -> tuple[Ints, Array]:
    """Connected clusters of vertices whose values (N,) are above a threshold.

    Returns
    -------
    cluster : (N,) int64
        Number of the cluster of each vertex, -1 where the value is not above; in the order of their first vertices.
    areas : (C,) float64
        Area of each [mm^2].
    """
    same_length(values, len(mesh.areas), "the map")
    above = np.flatnonzero(values > threshold)
    cluster: Ints = np.full(len(values), -1)
    n_clusters, cluster[above] = connected_components(mesh.ring[above][:, above], directed=False)
    return cluster, np.bincount(cluster[above], mesh.areas[above], n_clusters).astype(np.float64)


@kernel
def _root(parent, more, v):
    """The root of v; on the way, parents are shortened and ``more`` stays the sum to the root."""
    root = v
    while parent[root] != root:
        root = parent[root]
    sum_to_root, node = 0.0, v  # the sum from v to the root, excluding the root's own
    while node != root:
        sum_to_root += more[node]
        node = parent[node]
    node = v
    while node != root and parent[node] != root:
        next_vertex, own_excess = parent[node], more[node]
        parent[node], more[node] = root, sum_to_root
        sum_to_root -= own_excess
        node = next_vertex
    return root


@kernel
def enhanced(values, order, indptr, indices, areas, threshold):
    """TFCE (N,) of values whose ``order`` is that of :func:`by_size`, and the largest area of a cluster whose values
    are all above a threshold, or all below its negative.

    ``more`` of a root is the integral of its cluster so far; of other vertices, what they have more than their parent.
    """
    n = len(values)
    parent, more = np.arange(n), np.zeros(n)
    area, height, rank = areas.copy(), np.abs(values), np.zeros(n, np.int32)
    is_added, largest_area = np.zeros(n, np.bool_), 0.0
    for v in order:
        h = height[v]
        if h == 0.0:
            break
        is_added[v] = True
        if h > threshold:
            largest_area = max(largest_area, areas[v])
        for edge in range(indptr[v], indptr[v + 1]):
            w = np.int64(indices[edge])
            if not is_added[w] or (values[v] > 0.0) != (values[w] > 0.0):
                continue
            a, b = _root(parent, more, v), _root(parent, more, w)
            if a == b:
                continue
            for r in (a, b):
                more[r] += _gained(area[r], h, height[r])
                height[r] = h
            if rank[a] < rank[b]:
                a, b = b, a
            rank[a] += rank[a] == rank[b]
            parent[b], more[b] = a, more[b] - more[a]
            area[a] += area[b]
            if h > threshold:
                largest_area = max(largest_area, area[a])
    integral = np.zeros(n)
    for v in order:
        root = _root(parent, more, v)
        integral[v] = more[root] + _gained(area[root], 0.0, height[root]) + (more[v] if v != root else 0.0)
    return np.where(values < 0.0, -integral, integral), largest_area


@kernel
def _gained(extent, low, high):
    """The integral between two heights over a cluster of constant extent."""
    return extent**EXTENT_POWER * (high ** (HEIGHT_POWER + 1) - low ** (HEIGHT_POWER + 1)) / (HEIGHT_POWER + 1)
