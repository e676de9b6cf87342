"""Clusters of a statistic on a mesh, and threshold-free cluster enhancement (TFCE), both by area."""

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.errors import WrongShape
from morphofold.geometry import adjacency
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces

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
        ring = adjacency(len(self.areas), faces)
        self.links = ring.indptr.astype(np.int64), ring.indices.astype(np.int64)

    def __repr__(self) -> str:
        return f"Mesh({len(self.areas):,} vertices, {self.areas.sum():.0f} mm2)"

    @property
    def arrays(self) -> tuple[Ints, Ints, Array]:
        """Starts of the neighbours of each vertex, neighbours, areas: as kernels take them."""
        return (*self.links, self.areas)


def tfce(values: Array, mesh: Mesh) -> Array:
    """Threshold-free cluster enhancement of a map (N,): ``int_0^t e(h)^E h^H dh`` at a vertex of value t.

    e(h) is the area [mm^2] of the cluster of values above h that holds the vertex; E = 1, H = 2. Negative values are
    enhanced as their negatives, and are negative. NaN counts as 0.

    Notes
    -----
    Smith and Nichols 2009 (NeuroImage 44). Between two values of the map e(h) is constant, so the integral is exact:
    vertices are added from the highest value down, and clusters that meet are joined (union-find).
    """
    found = np.zeros(len(mesh.areas))
    _check(values, mesh)
    known = np.nan_to_num(values)
    order = np.argsort(-np.abs(known), kind="stable")
    for sign in (1.0, -1.0):
        found += sign * enhanced(*reading(sign * known, order, *mesh.arrays))
    return found


def clusters(values: Array, threshold: float, mesh: Mesh) -> tuple[Ints, Array]:
    """Connected clusters of vertices whose values (N,) are above a threshold.

    Returns
    -------
    cluster : (N,) int64
        Number of the cluster of each vertex, -1 where the value is not above; in the order of their first vertices.
    areas : (C,) float64
        Area of each [mm^2].
    """
    _check(values, mesh)
    cluster: Ints = components(*reading(np.nan_to_num(values, nan=-np.inf) > threshold, *mesh.links))
    inside = cluster >= 0
    return cluster, np.bincount(cluster[inside], mesh.areas[inside]).astype(np.float64)


def _check(values: Array, mesh: Mesh) -> None:
    if np.shape(values) != mesh.areas.shape:
        raise WrongShape(f"the map has shape {np.shape(values)}, the mesh has {len(mesh.areas)} vertices.")


@kernel
def components(above, indptr, indices):
    """Number of the connected part (N,) of each vertex that is ``above``; -1 for others."""
    n = len(above)
    found, queue, count = np.full(n, -1, np.int64), np.empty(n, np.int64), 0
    for s in range(n):
        if not above[s] or found[s] >= 0:
            continue
        found[s], queue[0] = count, s
        at, last = 0, 1
        while at < last:
            v = queue[at]
            at += 1
            for e in range(indptr[v], indptr[v + 1]):
                w = indices[e]
                if above[w] and found[w] < 0:
                    found[w], queue[last] = count, w
                    last += 1
        count += 1
    return found


@kernel
def _root(parent, more, v):
    """The root of v; on the way, parents are shortened and ``more`` stays the sum to the root."""
    root = v
    while parent[root] != root:
        root = parent[root]
    total, at = 0.0, v  # the sum from v to the root, excluding the root's own
    while parent[at] != root and at != root:
        total += more[at]
        at = parent[at]
    if at != root:
        total += more[at]
    at = v
    while at != root and parent[at] != root:
        following, own = parent[at], more[at]
        parent[at], more[at] = root, total
        total -= own
        at = following
    return root


@kernel
def enhanced(height, order, indptr, indices, areas):
    """TFCE (N,) of heights, 0 where they are not positive; ``order`` from the highest down, others anywhere.

    ``more`` of a root is the integral of its cluster so far; of other vertices, what they have more than their parent.
    """
    n = len(height)
    parent, more = np.arange(n), np.zeros(n)
    extent, level, rank = areas.copy(), height.copy(), np.zeros(n, np.int32)
    seen = np.zeros(n, np.bool_)
    for v in order:
        h = height[v]
        if h <= 0.0:
            continue
        seen[v] = True
        for e in range(indptr[v], indptr[v + 1]):
            if not seen[indices[e]]:
                continue
            a, b = _root(parent, more, v), _root(parent, more, indices[e])
            if a == b:
                continue
            for r in (a, b):
                more[r] += (
                    extent[r] ** EXTENT_POWER
                    * (level[r] ** (HEIGHT_POWER + 1) - h ** (HEIGHT_POWER + 1))
                    / (HEIGHT_POWER + 1)
                )
                level[r] = h
            if rank[a] < rank[b]:
                a, b = b, a
            rank[a] += rank[a] == rank[b]
            parent[b], more[b] = a, more[b] - more[a]
            extent[a] += extent[b]
    found = np.zeros(n)
    for v in order:
        if height[v] <= 0.0:
            continue
        root = _root(parent, more, v)
        last = extent[root] ** EXTENT_POWER * level[root] ** (HEIGHT_POWER + 1) / (HEIGHT_POWER + 1)
        found[v] = more[root] + last + (more[v] if v != root else 0.0)
    return found
