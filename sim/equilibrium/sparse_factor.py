"""Symmetric factorisation of a body's stiffness by nested dissection: L D L^T in dense fronts, and its inertia.

The graph of the nodes is halved recursively, each time by the thinnest of a few cuts. The nodes along the cut are
eliminated after both halves. The elimination of a set of nodes is then work on one dense matrix, its front, at the
speed of LAPACK (Duff and Reid 1983, ACM TOMS 9, 302; George 1973, SIAM J. Numer. Anal. 10, 345). Positive definite
fronts are factorised by Cholesky's method, others by that of Bunch and Kaufman. The number of negative eigenvalues of
the matrix is the sum of those of all fronts (Sylvester, Haynsworth).

scipy's ``splu`` could be used, too: with ``permc_spec="MMD_AT_PLUS_A"``, ``diag_pivot_thresh=0`` and ``SymmetricMode``
its pivots stay on the diagonal, and the number of negative pivots of U is the same. But it does not use the positions
of the nodes, nor that L is the transpose of U. Seconds of one thread for a plan and a factor here, and for ``splu``,
and memory [MB]:

==============================  ======  ============  =====  ===========  ==============
matrix of the tangent           rows    plan, factor  splu   memory here  memory of splu
==============================  ======  ============  =====  ===========  ==============
``strip``                       8,320   0.33, 0.03    0.04   0            0
octant of ``demo``, edge 3.5    7,992   0.20, 0.24    0.46   36           27
octant of ``demo``              21,960  0.60, 1.33    3.10   274          256
``patch`` at draft              34,153  0.94, 2.58    10.5   433          583
octant of ``fig5`` at draft     69,300  2.25, 10.9    47.7   1,037        1,536
==============================  ======  ============  =====  ===========  ==============

A path of equilibria needs one plan. COLAMD takes 0.78 s where MMD takes 0.46.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import blas, lapack
from scipy.sparse import csgraph

from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.threads import one_blas_thread

MOST_LEAF_NODES = 60  # number of nodes up to which a set is not halved any more
CUT_SHARES = (0.42, 0.46, 0.5, 0.54, 0.58)  # shares of the nodes on one side of a cut that are tried


@dataclass(frozen=True)
class Front:
    """Rows ``start:stop`` of the reordered matrix, to be eliminated; the later rows that they couple to; the places of
    their entries in the matrix and in the front; the fronts that add to this one, and the places of their rows."""

    start: int
    stop: int
    border: Ints
    entries: Ints
    front_places: Ints
    children: tuple[tuple[int, Ints], ...]


class Dissection:
    """Order of elimination, and its fronts, for matrices of one pattern.

    Parameters
    ----------
    points : (N, 3) float64
        Positions of the nodes, used to halve the graph.
    graph : (N, N) csr_matrix
        For nodes that share an entry of the matrix, the number of steps from one to the other through the mesh.
    rows : (n,) int
        Rows 3 i + r (coordinate r of node i) of the full matrix to solve for, ascending.
    pattern : (n, n) csr_matrix
        Any matrix with the pattern to factorise, including entries that are 0.
    """

    def __init__(self, points: Array, graph: sparse.csr_matrix, rows: Ints, pattern: sparse.csr_matrix):
        node_sets, parents = _nested_dissection(points, graph)
        node_order = np.concatenate(node_sets)
        ranks = np.argsort(node_order)
        self.order = np.lexsort((rows, ranks[rows // 3]))  # reordered row i is row order[i]
        row_ends = np.searchsorted(np.sort(ranks[rows // 3]), np.arange(len(points) + 1))  # of nodes, in reordered rows
        entries = sparse.csr_matrix((np.arange(1, pattern.nnz + 1), pattern.indices, pattern.indptr), pattern.shape)
        self._places = sparse.csr_matrix(entries[self.order][:, self.order])
        self._places.sort_indices()
        self.fronts = self._fronts(node_sets, parents, graph[node_order][:, node_order], row_ends)

    def _fronts(self, node_sets: list[Ints], parents: list[int], graph: sparse.csr_matrix, ends: Ints) -> list[Front]:
        received: list[list[tuple[int, Ints, Ints]]] = [[] for _ in node_sets]  # front, nodes and rows of what is added
        fronts = []
        for i, stop in enumerate(np.cumsum([len(node_set) for node_set in node_sets])):
            neighbours = graph.indices[graph.indptr[stop - len(node_sets[i])] : graph.indptr[stop]]
            nodes = np.unique(np.concatenate([neighbours, *(sent_nodes for _, sent_nodes, _ in received[i])]))
            nodes = nodes[nodes >= stop]
            border = np.concatenate([np.arange(ends[n], ends[n + 1]) for n in nodes] + [np.empty(0, dtype=np.int64)])
            first_row, end_row = int(ends[stop - len(node_sets[i])]), int(ends[stop])
            front_rows = np.concatenate([np.arange(first_row, end_row), border])
            children = tuple((child, np.searchsorted(front_rows, rows)) for child, _, rows in received[i])
            fronts.append(Front(first_row, end_row, border, *self._entries(first_row, end_row, front_rows), children))
            if parents[i] >= 0:
                received[parents[i]].append((i, nodes, border))
        return fronts

    def _entries(self, first_row: int, end_row: int, front_rows: Ints) -> tuple[Ints, Ints]:
        """Entries of the rows of a front, and their places in the front."""
        entry_slice = slice(self._places.indptr[first_row], self._places.indptr[end_row])
        rows = np.repeat(np.arange(end_row - first_row), np.diff(self._places.indptr[first_row : end_row + 1]))
        is_active = self._places.indices[entry_slice] >= first_row
        columns = np.searchsorted(front_rows, self._places.indices[entry_slice][is_active])
        return self._places.data[entry_slice][is_active] - 1, rows[is_active] * len(front_rows) + columns


def _nested_dissection(points: Array, graph: sparse.csr_matrix) -> tuple[list[Ints], list[int]]:
    """Sets of nodes in the order of elimination, and for each the set that receives its remainder, -1 for the last."""
    node_sets: list[Ints] = []
    parents: list[int] = []
    is_other_side = np.zeros(len(points), dtype=bool)

    def cut(nodes: Ints) -> tuple[Ints, Ints, Ints]:
        """Two parts that are not connected, and the thinnest separator found between them."""
        best_cut: tuple[Ints, Ints, Ints] = (nodes[:0], nodes[:0], nodes)
        for coordinate in _cut_coordinates(points[nodes], graph[nodes][:, nodes]):
            sorted_nodes = nodes[np.argsort(coordinate, kind="stable")]
            for cut_share in CUT_SHARES:
                halves = np.split(sorted_nodes, [int(cut_share * len(nodes))])
                for this_half, other_half in zip(halves, halves[::-1]):
                    is_other_side[other_half] = True
                    is_linked = graph[this_half] @ is_other_side > 0
                    is_other_side[other_half] = False
                    if is_linked.sum() < len(best_cut[2]):
                        best_cut = other_half, this_half[~is_linked], this_half[is_linked]
        return best_cut

    def visit(nodes: Ints) -> int:
        child_sets = []
        if len(nodes) > MOST_LEAF_NODES:
            left_part, right_part, nodes = cut(nodes)
            child_sets = [visit(part) for part in (left_part, right_part) if len(part)]
        node_sets.append(nodes)
        parents.append(-1)
        for child in child_sets:
            parents[child] = len(node_sets) - 1
        return len(node_sets) - 1

    visit(np.arange(len(points)))
    return node_sets, parents


def _cut_coordinates(points: Array, graph: sparse.csr_matrix) -> list[Array]:
    """Coordinates for cuts: along the two longest axes; graph steps from both ends, and their difference."""
    centred_points = points - points.mean(axis=0)
    axis_coordinates = (centred_points @ np.linalg.eigh(centred_points.T @ centred_points)[1])[:, 1:]
    steps = _graph_distances(graph, int(np.argmax(axis_coordinates[:, 1])))
    steps_back = _graph_distances(graph, int(np.argmax(steps)))
    return [axis_coordinates[:, 1], axis_coordinates[:, 0], steps, steps_back, steps - steps_back]


def _graph_distances(graph: sparse.csr_matrix, start_node: int) -> Array:
    """Length of the shortest path from a node to each (n,); one more than the largest where there is no path."""
    steps = csgraph.dijkstra(graph, indices=start_node)
    steps[np.isinf(steps)] = steps[np.isfinite(steps)].max() + 1
    return steps


class Factor:
    """A factorised matrix.

    Parameters
    ----------
    dissection : Dissection
    matrix : (n, n) csr_matrix
        Symmetric matrix with exactly the pattern of the dissection.

    Attributes
    ----------
    negative : int
        Number of negative eigenvalues; 0 means positive definite.

    Raises
    ------
    ZeroDivisionError
        If a front is singular.
    """

    @one_blas_thread()
    def __init__(self, dissection: Dissection, matrix: sparse.csr_matrix):
        self._dissection = dissection
        self._pivots: list[_Pivot] = []
        remainders: dict[int, Array] = {}
        for i, front in enumerate(self._dissection.fronts):
            n_eliminated = front.stop - front.start
            front_size = n_eliminated + len(front.border)
            F = np.zeros((front_size, front_size))  # rows to eliminate, then the remainder
            F.ravel()[front.front_places] = matrix.data[front.entries]
            for child, rows in front.children:
                _extend_add(F, remainders.pop(child), rows)
            F11, F21 = F[:n_eliminated, :n_eliminated].T, F[:n_eliminated, n_eliminated:].T  # in the order of LAPACK
            pivot, product = _definite(F11, F21) or _indefinite(F11, F21)
            self._pivots.append(pivot)
            remainders[i] = np.subtract(F[n_eliminated:, n_eliminated:], product, out=product)
        self.negative = sum(pivot.negative for pivot in self._pivots)

    def solve(self, b: Array) -> Array:
        """The solution x (n,) of A x = b."""
        order, fronts = self._dissection.order, self._dissection.fronts
        y = b[order].astype(np.float64)
        for front, pivot in zip(fronts, self._pivots):
            y[front.start : front.stop], update = pivot.forward(y[front.start : front.stop])
            y[front.border] -= update
        for front, pivot in zip(fronts[::-1], self._pivots[::-1]):
            y[front.start : front.stop] = pivot.backward(y[front.start : front.stop], y[front.border])
        x = np.empty_like(y)
        x[order] = y
        return x


@kernel
def _extend_add(F, addend, rows):
    """F[rows, rows] += addend."""
    for i in range(len(rows)):
        front_row, added_row = F[rows[i]], addend[i]
        for j in range(len(rows)):
            front_row[rows[j]] += added_row[j]


class _Pivot(NamedTuple):
    """An eliminated front: its number of negative eigenvalues, and its steps of forward and backward substitution."""

    negative: int
    forward: Callable[[Array], tuple[Array, Array]]
    backward: Callable[[Array, Array], Array]


def _definite(F11: Array, F21: Array) -> tuple[_Pivot, Array] | None:
    """A front by Cholesky's method, F11 = L L^T, B = F21 L^-T, and F21 F11^-1 F12; None if F11 is not positive
    definite."""
    L, cholesky_status = lapack.dpotrf(F11, lower=1) if len(F11) else (F11, 0)
    if cholesky_status:
        return None
    B = blas.dtrsm(1.0, L, F21, side=1, lower=1, trans_a=1) if F21.size else F21.copy()

    def forward(b: Array) -> tuple[Array, Array]:
        y = blas.dtrsv(L, b, lower=1) if len(b) else b
        return y, B @ y

    def backward(y: Array, border_x: Array) -> Array:
        y = y - border_x @ B
        return blas.dtrsv(L, y, lower=1, trans=1) if len(y) else y

    return _Pivot(0, forward, backward), B @ B.T


def _indefinite(F11: Array, F21: Array) -> tuple[_Pivot, Array]:
    """A front by the method of Bunch and Kaufman, if F11 is not positive definite; X = F11^-1 F12."""
    work_size = int(lapack.dsytrf_lwork(len(F11), lower=1)[0])
    factor, row_swaps, status = lapack.dsytrf(F11, lower=1, lwork=work_size)
    if status:
        raise ZeroDivisionError("the matrix is singular.")
    is_paired = row_swaps < 0  # 2x2 blocks have one eigenvalue of each sign
    n_negative = int(is_paired.sum()) // 2 + int(np.sum(np.diag(factor)[~is_paired] < 0))
    solve = lambda b: lapack.dsytrs(factor, row_swaps, b, lower=1)[0] if b.size else b
    X = solve(np.asfortranarray(F21.T))
    return _Pivot(n_negative, lambda b: (b, b @ X), lambda y, border_x: solve(y) - X @ border_x), F21.copy() @ X
