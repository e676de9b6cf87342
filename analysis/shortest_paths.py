"""Shortest paths on a surface, along edges and straight across pairs of triangles."""

import numpy as np
from scipy import sparse

from morphofold import geometry
from morphofold.frozen_arrays import Bools, Ints
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Verts


def path_graph(verts: Verts, faces: Faces) -> sparse.csr_array:
    """Symmetric (N, N) lengths [mm] of the edges, and of the straight lines between the far corners of two triangles.

    Lines that leave their two triangles are left out. On even meshes shortest paths are about 4 % too long, and along
    edges alone 10 %, at any resolution.
    """
    sides = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])  # edge, far corner
    side_edge, side_index = geometry.edges_of_faces(faces).T.ravel(), np.arange(len(sides))
    first_side, last_side = np.empty((2, int(side_edge.max()) + 1), dtype=np.int64)  # side of each edge
    last_side[side_edge], first_side[side_edge[::-1]] = side_index, side_index[::-1]
    first_side, second_side = sides[first_side[first_side != last_side]], sides[last_side[first_side != last_side]]
    edge_start = verts[first_side[:, 0]]
    edge_direction = verts[first_side[:, 1]] - edge_start
    edge_length = np.linalg.norm(edge_direction, axis=1)
    edge_direction = edge_direction / np.maximum(edge_length, 1e-300)[:, None]

    def unfolded(corners: Verts) -> tuple[PerVertex, PerVertex]:
        x = np.sum((corners - edge_start) * edge_direction, axis=1)
        return x, np.linalg.norm(corners - edge_start - x[:, None] * edge_direction, axis=1)

    (x, y), (u, v) = unfolded(verts[first_side[:, 2]]), unfolded(verts[second_side[:, 2]])
    crossing_point = x + (u - x) * y / np.maximum(y + v, 1e-300)
    crosses = (crossing_point > 0) & (crossing_point < edge_length)
    lengths = np.maximum(np.r_[geometry.edge_lengths(verts, faces), np.hypot(x - u, y + v)[crosses]], 1e-300)
    pairs = np.concatenate([geometry.edges(faces), np.column_stack([first_side[crosses, 2], second_side[crosses, 2]])])
    return geometry.symmetric(len(verts), pairs, lengths)


def shorten(graph: sparse.csr_array, path_mm: PerVertex, sources: Ints, within: Bools) -> None:
    """Lower ``path_mm`` (N,) [mm], in place, to the shortest paths to ``sources`` (S,) through the vertices ``within``.

    It visits only vertices whose path gets shorter: on 152,893 vertices 20 more sources take 0.015 s. A new run of
    scipy's ``dijkstra`` takes 0.16 s.
    """
    _shorten_paths(*reading(graph, sources, within, np.zeros(0, dtype=bool)), path_mm, np.empty(len(path_mm), np.int64))


def step_prices(graph: sparse.csr_array, cost: PerVertex) -> sparse.csr_array:
    """The lengths of a graph (N, N), each times the mean of the ``cost`` (N,) at its two ends."""
    prices = graph.copy()
    prices.data = 0.5 * (np.repeat(cost, np.diff(graph.indptr)) + cost[graph.indices]) * graph.data
    return prices


def cheapest_path(prices: sparse.csr_array, start: int, goals: Bools, within: Bools) -> Ints:
    """Path from ``start`` to the cheapest of ``goals`` (N,), with the least sum of ``prices`` (N, N) of its steps.

    The path runs through the vertices ``within`` (N,); it is empty if there is none. scipy's ``dijkstra`` does not stop
    at a goal: with many goals it takes 0.12 s on 152,893 vertices, and this function 0.0004 s.
    """
    path_sums, previous = np.full(len(goals), np.inf), np.full(len(goals), -1)
    vertex, path = _shorten_paths(*reading(prices, np.array([start]), within, goals), path_sums, previous), list[int]()
    while vertex >= 0:
        path.append(vertex)
        vertex = previous[vertex]
    return np.array(path[::-1], dtype=np.int64)


@kernel
def _shorten_paths(indptr, indices, lengths, sources, within, is_goal, path_sums, previous):
    """Lower ``path_sums`` (N,) to the lengths of paths from sources, and write the vertex ``previous`` (N,) each. A
    path ends at the first of ``is_goal`` (N,), if any; returns the one with the shortest path, or -1."""
    # Paths are shortened until none can be, by a queue: compiled in a third of the time of a heap.
    n = len(path_sums)
    queue, is_queued = np.empty(n, np.int64), np.zeros(n, np.bool_)
    head, n_waiting, cheapest_goal = 0, 0, -1
    for source in sources:
        if path_sums[source] > 0:
            path_sums[source] = 0.0
            queue[n_waiting], is_queued[source] = source, True
            n_waiting += 1
    while n_waiting > 0:
        node = queue[head]
        head = head + 1 if head + 1 < n else 0
        n_waiting -= 1
        is_queued[node] = False
        if len(is_goal) > 0 and is_goal[node]:
            cheapest_goal = node if cheapest_goal < 0 or path_sums[node] < path_sums[cheapest_goal] else cheapest_goal
            continue
        for e in range(indptr[node], indptr[node + 1]):
            other = indices[e]
            length = path_sums[node] + lengths[e]
            if within[other] and length < path_sums[other] and (cheapest_goal < 0 or length < path_sums[cheapest_goal]):
                path_sums[other], previous[other] = length, node
                if not is_queued[other]:
                    is_queued[other] = True
                    queue[head + n_waiting if head + n_waiting < n else head + n_waiting - n] = other
                    n_waiting += 1
    return cheapest_goal
