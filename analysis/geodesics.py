"""Shortest paths on a surface, along edges and straight across pairs of triangles."""

import numpy as np
from scipy import sparse

from morphofold import geometry
from morphofold.arrays import Bools, Ints
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Verts


def path_graph(verts: Verts, faces: Faces) -> sparse.csr_array:
    """Symmetric (N, N) lengths [mm] of the edges, and of the straight lines between the far corners of two triangles.

    Lines that leave their two triangles are left out. On even meshes shortest paths are about 4 % too long, and along
    edges alone 10 %, at any resolution.
    """
    half = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])  # edge, far corner
    key = geometry.edges_of_faces(faces).T.ravel()
    order = geometry.grouped(key, int(key.max()) + 1)
    paired = key[order[1:]] == key[order[:-1]]
    one, two = half[order[:-1][paired]], half[order[1:][paired]]
    base = verts[one[:, 0]]
    along = verts[one[:, 1]] - base
    length = np.linalg.norm(along, axis=1)
    along = along / np.maximum(length, 1e-300)[:, None]

    def unfolded(corner: Verts) -> tuple[PerVertex, PerVertex]:
        x = np.sum((corner - base) * along, axis=1)
        return x, np.linalg.norm(corner - base - x[:, None] * along, axis=1)

    (x, y), (u, v) = unfolded(verts[one[:, 2]]), unfolded(verts[two[:, 2]])
    meets = x + (u - x) * y / np.maximum(y + v, 1e-300)
    inside = (meets > 0) & (meets < length)
    lengths = np.maximum(np.r_[geometry.edge_lengths(verts, faces), np.hypot(x - u, y + v)[inside]], 1e-300)
    ends = np.concatenate([geometry.edges(faces), np.column_stack([one[inside, 2], two[inside, 2]])])
    return geometry.symmetric(len(verts), ends, lengths)


def shorten(graph: sparse.csr_array, way: PerVertex, sources: Ints, within: Bools) -> None:
    """Lower ``way`` (N,) [mm], in place, to the shortest paths to ``sources`` (S,) through the vertices ``within``.

    It visits only vertices whose path gets shorter: on 152,893 vertices 20 more sources take 0.015 s. A new run of
    scipy's ``dijkstra`` takes 0.16 s.
    """
    _shorten_path_lengths(*reading(graph, sources, within), way)


def cheapest_path(graph: sparse.csr_array, cost: PerVertex, start: int, goals: Bools, within: Bools) -> Ints:
    """Path from ``start`` to the cheapest of ``goals`` (N,), with the least integral of ``cost`` (N,) along it.

    The path runs through the vertices ``within`` (N,); it is empty if there is none. scipy's ``dijkstra`` does not stop
    at a goal: with many goals it takes 0.12 s on 152,893 vertices, and this function 0.00004 s.
    """
    path: Ints = _cheapest_path_vertices(*reading(graph, cost, start, goals, within))
    return path


@kernel
def _shorten_path_lengths(indptr, indices, lengths, sources, within, way):
    # Paths are shortened until none can be, by a queue: compiled in a third of the time of a heap.
    n = len(way)
    queue, queued = np.empty(n, np.int64), np.zeros(n, np.bool_)
    at, waiting = 0, 0
    for s in sources:
        if way[s] > 0:
            way[s] = 0.0
            queue[waiting], queued[s] = s, True
            waiting += 1
    while waiting > 0:
        v = queue[at]
        at = at + 1 if at + 1 < n else 0
        waiting -= 1
        queued[v] = False
        for e in range(indptr[v], indptr[v + 1]):
            w = indices[e]
            if within[w] and way[v] + lengths[e] < way[w]:
                way[w] = way[v] + lengths[e]
                if not queued[w]:
                    queued[w] = True
                    queue[at + waiting if at + waiting < n else at + waiting - n] = w
                    waiting += 1


@kernel
def _cheapest_path_vertices(indptr, indices, lengths, cost, start, goals, within):
    n = len(cost)
    best, before = np.full(n, np.inf), np.full(n, -1, np.int64)
    queue, queued = np.empty(n, np.int64), np.zeros(n, np.bool_)
    best[start], queue[0] = 0.0, start
    at, waiting, end = 0, 1, -1
    while waiting > 0:
        v = queue[at]
        at = at + 1 if at + 1 < n else 0
        waiting -= 1
        queued[v] = False
        if goals[v]:
            end = v if end < 0 or best[v] < best[end] else end
            continue
        for e in range(indptr[v], indptr[v + 1]):
            w = indices[e]
            price = best[v] + 0.5 * (cost[v] + cost[w]) * lengths[e]
            if within[w] and price < best[w] and (end < 0 or price < best[end]):
                best[w], before[w] = price, v
                if not queued[w]:
                    queued[w] = True
                    queue[at + waiting if at + waiting < n else at + waiting - n] = w
                    waiting += 1
    count = 0
    v = end
    while v >= 0:
        count += 1
        v = before[v]
    path = np.empty(count, np.int64)
    v = end
    for k in range(count - 1, -1, -1):
        path[k] = v
        v = before[v]
    return path
