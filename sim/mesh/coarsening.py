"""Every second vertex of a mesh of quads in both directions, and the interpolation from these to all vertices."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from morphofold.arrays import Array, Ints
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


def halve(quads: Ints, n: int) -> Halved | None:
    """A mesh of quads at half the resolution; None if this mesh has none.

    Parameters
    ----------
    quads : (Q, 4) int
        Counter-clockwise corners of a connected mesh.
    n : int
        Number of vertices.

    Notes
    -----
    In each quad one corner is kept, and the opposite one becomes the centre of a coarse cell. One choice fixes those of
    all quads, from neighbour to neighbour. They agree on a cubed sphere if a side of its faces has an even number of
    cells. The first choice is far from vertices with three quads, so a sphere and its octants are halved alike.
    """
    across = quad_neighbours(quads, n)
    first = _first_vertex(quads, n, across)
    retained = np.full(len(quads), -1)
    start = int(np.flatnonzero((quads == first).any(axis=1))[0])
    retained[start] = int(np.flatnonzero(quads[start] == first)[0])
    _spread(across, retained, start)
    corner, left, centre, right = (quads[np.arange(len(quads)), (retained + turn) % 4] for turn in range(4))
    role = np.zeros(n, dtype=np.int8)
    role[corner], role[left], role[right], role[centre] = 1, 2, 2, 3
    if (role[corner] != 1).any() or (role[left] != 2).any() or (role[right] != 2).any():
        return None
    vertices, number = np.flatnonzero(role == 1), np.cumsum(role == 1) - 1
    row = np.concatenate([vertices, left, centre, right])
    column = number[np.concatenate([vertices, corner, corner, corner])]
    P = sparse.csr_matrix((np.ones(len(row)), (row, column)), shape=(n, len(vertices)))
    P.data[:] = 1.0  # a kept vertex that two quads share counts once
    P = sparse.csr_matrix(sparse.diags(1 / np.asarray(P.sum(axis=1)).ravel()) @ P)
    return Halved(vertices, number[_cells_around(corner, centre, right, left)], P)


def quad_neighbours(quads: Ints, n: int) -> Ints:
    """For edge k of each quad, from corner k to k + 1: 4 times the quad across it plus that one's edge; -1: none."""
    a, b = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    return positions(a * n + b, b * n + a).reshape(-1, 4)


def positions(keys: Ints, sought: Ints) -> Ints:
    """Where each of the numbers ``sought`` is among ``keys``, which differ; -1 if nowhere."""
    order = np.argsort(keys)
    nearest = order[np.minimum(np.searchsorted(keys[order], sought), len(keys) - 1)]
    return np.where(keys[nearest] == sought, nearest, -1)


def _first_vertex(quads: Ints, n: int, across: Ints) -> int:
    """The vertex farthest along edges from inner vertices with other than four quads; 0 if there are none."""
    a, b = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    rim = np.zeros(n, dtype=bool)
    rim[a[across.ravel() < 0]] = rim[b[across.ravel() < 0]] = True
    odd = np.flatnonzero((np.bincount(a, minlength=n) != 4) & ~rim)
    if not odd.size:
        return int(quads[0, 0])
    edges = sparse.csr_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    return int(np.argmax(dijkstra(edges, directed=False, unweighted=True, indices=odd, min_only=True)))


@kernel
def _spread(across, retained, start):
    """Fill ``kept`` (Q,), the corner that is kept, from quad ``start`` to all others."""
    stack = [start]
    while len(stack) > 0:
        q = stack.pop()
        for k in range(4):
            other = across[q, k]
            if other < 0 or retained[other // 4] >= 0:
                continue
            m = other % 4  # corner m + 1 of the other quad is corner k of this one, its corner m is k + 1
            turn = (retained[q] - k) % 4
            retained[other // 4] = (m + (1, 0, 3, 2)[turn]) % 4
            stack.append(other // 4)


def _cells_around(corner: Ints, centre: Ints, right: Ints, left: Ints) -> Ints:
    """The kept vertices (K, 4) around the centres of whole coarse cells, counter-clockwise."""
    n = int(max(right.max(), left.max())) + 1
    following = positions(centre * n + right, centre * n + left)  # from the centre, a quad lies from right to left
    ring = [np.arange(len(corner))]
    for _ in range(4):
        ring.append(np.where(ring[-1] >= 0, following[ring[-1]], -1))
    cells = np.stack(ring, axis=1)
    whole = (cells >= 0).all(axis=1) & (cells[:, 4] == cells[:, 0]) & (cells[:, 0] == cells[:, :4].min(axis=1))
    return corner[cells[whole, :4]]


def depths_kept(depth: Array, n_cortex: int, spacing: float) -> Ints:
    """Levels of nodes that are kept below each other: pial, white, then each at least ``spacing`` deeper, and the last.

    ``depth`` (L,) is that of all levels, the first is the pial surface; level ``n_cortex`` is the white surface [mm].
    """
    levels = [0, n_cortex]
    for k in range(n_cortex + 1, len(depth)):
        if depth[k] - depth[levels[-1]] >= (1 - 1e-9) * spacing or k == len(depth) - 1:
            levels.append(k)
    return np.array(levels)
