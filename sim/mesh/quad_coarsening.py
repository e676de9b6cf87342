"""Every second vertex of a mesh of quads in both directions, and the interpolation from these to all vertices."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel


class Halved(NamedTuple):
    """A mesh of quads at half the resolution.

    Attributes
    ----------
    vertices : (C,) int
        Those of the finer mesh that are kept.
    quads : (K, 4) int
        Cells between them. At the rim cells of the finer mesh may be left over, which none of these covers.
    interpolation : (n, C) csr_matrix
        Bilinear, from the kept vertices to all. Each row sums to 1.
    """

    vertices: Ints
    quads: Ints
    interpolation: sparse.csr_matrix


def halve(quads: Ints, n_vertices: int) -> Halved | None:
    """A mesh of quads at half the resolution; None if this mesh has none.

    Parameters
    ----------
    quads : (Q, 4) int
        Counter-clockwise corners of a connected mesh.
    n_vertices : int

    Notes
    -----
    In each quad one corner is kept, and the opposite one becomes the centre of a coarse cell. One choice fixes those of
    all quads, from neighbour to neighbour. They agree on a cubed sphere if a side of its faces has an even number of
    cells. The first choice is far from vertices with three quads, so a sphere and its octants are halved alike.
    """
    neighbours = quad_neighbours(quads, n_vertices)
    first_vertex = _first_vertex(quads, n_vertices, neighbours)
    retained_corner = np.full(len(quads), -1)
    first_quad, first_corner = np.argwhere(quads == first_vertex)[0].tolist()
    retained_corner[first_quad] = first_corner
    _spread(neighbours, retained_corner, first_quad)
    corner, left, centre, right = (quads[np.arange(len(quads)), (retained_corner + turn) % 4] for turn in range(4))
    vertex_role = np.zeros(n_vertices, dtype=np.int8)
    vertex_role[corner], vertex_role[left], vertex_role[right], vertex_role[centre] = 1, 2, 2, 3
    if (vertex_role[corner] != 1).any() or (vertex_role[left] != 2).any() or (vertex_role[right] != 2).any():
        return None
    vertices, coarse_number = np.flatnonzero(vertex_role == 1), np.cumsum(vertex_role == 1) - 1
    row = np.concatenate([vertices, left, centre, right])
    column = coarse_number[np.concatenate([vertices, corner, corner, corner])]
    interpolation = sparse.csr_matrix((np.ones(len(row)), (row, column)), shape=(n_vertices, len(vertices)))
    interpolation.data[:] = 1.0  # a kept vertex that two quads share counts once
    interpolation = sparse.csr_matrix(sparse.diags(1 / np.asarray(interpolation.sum(axis=1)).ravel()) @ interpolation)
    return Halved(vertices, coarse_number[_cells_around(corner, centre, right, left)], interpolation)


def quad_neighbours(quads: Ints, n_vertices: int) -> Ints:
    """For edge k of each quad, from corner k to k + 1: 4 times the quad across it plus that one's edge; -1: none."""
    tail, head = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    return positions(tail * n_vertices + head, head * n_vertices + tail).reshape(-1, 4)


def positions(keys: Ints, sought_keys: Ints) -> Ints:
    """Where each of the numbers ``sought_keys`` is among ``keys``, which differ; -1 if nowhere."""
    key_order = np.argsort(keys)
    candidates = key_order[np.minimum(np.searchsorted(keys[key_order], sought_keys), len(keys) - 1)]
    return np.where(keys[candidates] == sought_keys, candidates, -1)


def _first_vertex(quads: Ints, n_vertices: int, neighbours: Ints) -> int:
    """The vertex farthest along edges from inner vertices with other than four quads; 0 if there are none."""
    tail, head = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    is_rim = np.zeros(n_vertices, dtype=bool)
    is_rim[tail[neighbours.ravel() < 0]] = is_rim[head[neighbours.ravel() < 0]] = True
    irregular = np.flatnonzero((np.bincount(tail, minlength=n_vertices) != 4) & ~is_rim)
    if not irregular.size:
        return int(quads[0, 0])
    edges = sparse.csr_matrix((np.ones(len(tail)), (tail, head)), shape=(n_vertices, n_vertices))
    return int(np.argmax(dijkstra(edges, directed=False, unweighted=True, indices=irregular, min_only=True)))


@kernel
def _spread(neighbours, retained_corner, first_quad):
    """Fill ``retained_corner`` (Q,), the one that is kept, from ``first_quad`` to all others."""
    stack = [first_quad]
    while len(stack) > 0:
        quad = stack.pop()
        for edge in range(4):
            neighbour_edge = neighbours[quad, edge]
            if neighbour_edge < 0 or retained_corner[neighbour_edge // 4] >= 0:
                continue
            other_edge = neighbour_edge % 4  # its corner other_edge + 1 is our corner edge
            turn = (retained_corner[quad] - edge) % 4
            retained_corner[neighbour_edge // 4] = (other_edge + (1, 0, 3, 2)[turn]) % 4
            stack.append(neighbour_edge // 4)


def _cells_around(corner: Ints, centre: Ints, right: Ints, left: Ints) -> Ints:
    """The kept vertices (K, 4) around the centres of whole coarse cells, counter-clockwise."""
    n = int(max(right.max(), left.max())) + 1
    next_quad = positions(centre * n + right, centre * n + left)  # from the centre, a quad lies from right to left
    quads_around = [np.arange(len(corner))]
    for _ in range(4):
        quads_around.append(np.where(quads_around[-1] >= 0, next_quad[quads_around[-1]], -1))
    rings = np.stack(quads_around, axis=1)
    is_whole = (rings >= 0).all(axis=1) & (rings[:, 4] == rings[:, 0]) & (rings[:, 0] == rings[:, :4].min(axis=1))
    return corner[rings[is_whole, :4]]


def depths_kept(depth: Array, n_cortex: int, spacing: float) -> Ints:
    """Levels of nodes that are kept below each other: pial, white, then each at least ``spacing`` deeper, and the last.

    ``depth`` (L,) is that of all levels, the first is the pial surface; level ``n_cortex`` is the white surface [mm].
    """
    levels = [0, n_cortex]
    for level in range(n_cortex + 1, len(depth)):
        if depth[level] - depth[levels[-1]] >= (1 - 1e-9) * spacing or level == len(depth) - 1:
            levels.append(level)
    return np.array(levels)
