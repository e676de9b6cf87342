"""Implicit diffusion on a surface: ``(M + t L) x = b`` for any t, in a time proportional to the number of vertices.

Conjugate gradients with a multigrid preconditioner of smoothed aggregation (Vanek, Mandel, Brezina 1996, Computing 56).
The coarse levels belong to L alone, so one hierarchy serves every t.
"""

from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from morphofold import geometry
from morphofold.frozen_arrays import Array, memoized
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, Verts
from morphofold.threads import run_parallel

MOST_ITERATIONS = 300
LEAST_STRENGTH = 0.08  # of a coupling between neighbours, relative to their diagonals, to join them in an aggregate
PROLONGATION_SMOOTHING = 2 / 3  # of a Jacobi step
COARSEST_SIZE = 60  # vertices of the coarsest level
N_COARSE_SWEEPS = 4  # Gauss-Seidel sweeps there, forward and back


class Diffusion:
    """Solves ``(M + t L) x = b`` with the vertex areas M (N,) [mm^2] and a stiffness L (N, N) whose rows sum to zero.

    A vertex without area and neighbours keeps its start value.

    Attributes
    ----------
    mass, stiffness : (N,) float64, (N, N) csr_array
    """

    def __init__(self, mass: Array, stiffness: sparse.csr_array):
        self.mass, self.stiffness = mass, stiffness
        matrices, prolongations = [stiffness], []
        while matrices[-1].shape[0] > COARSEST_SIZE:
            P = _prolongation(matrices[-1])
            if P.shape[1] > 0.7 * P.shape[0]:  # only vertices without strong neighbours are left
                break
            prolongations.append(P)
            matrices.append((P.T @ (matrices[-1] @ P)).tocsr())
        level_masses = [mass]
        for P in prolongations:
            level_masses.append(np.maximum(P.T @ level_masses[-1], 0.0))
        lower_upper = [(sparse.tril(matrix, -1, "csr"), sparse.triu(matrix, 1, "csr")) for matrix in matrices]
        ptr, col, val = _joined([lower + upper for lower, upper in lower_upper])
        self._levels = (
            np.cumsum([0, *map(len, level_masses)]),
            ptr,
            ptr[:-1] + np.concatenate([np.diff(lower.indptr) for lower, _ in lower_upper]).astype(np.uint32),
            col,
            val,
            np.concatenate([matrix.diagonal() for matrix in matrices]),
            np.concatenate(level_masses),
            *_joined([*prolongations, sparse.csr_array((len(level_masses[-1]), 0))]),
        )

    def solve(self, time: float, right: Array, x: Array, rtol: float) -> Array:
        """Solve ``(M + time L) x = right``.

        Parameters
        ----------
        time : float
            [mm^2].
        right, x : (N,) or (N, K) float64
            The iteration starts at ``x``, which is not changed.
        rtol : float
            Norm of the residual at the end, relative to ``right``, in each column.

        Raises
        ------
        RuntimeError
            If that takes more than 300 iterations. The mesh is then too irregular.
        """
        n_cols = np.shape(x)[1] if np.ndim(x) == 2 else 1
        rhs, iterate = (np.zeros((len(x), n_cols + n_cols % 2)) for _ in range(2))  # solved in pairs
        rhs[:, :n_cols], iterate[:, :n_cols] = np.reshape(right, (len(x), n_cols)), np.reshape(x, (len(x), n_cols))
        pairs = [np.ascontiguousarray(iterate[:, k : k + 2]) for k in range(0, n_cols, 2)]
        levels = reading(*self._levels)
        tasks = [
            partial(_iterate, *levels, float(time), *reading(rhs[:, 2 * k : 2 * k + 2]), pair, rtol, MOST_ITERATIONS)
            for k, pair in enumerate(pairs)
        ]
        if not all(n_iterations >= 0 for n_iterations in run_parallel(*tasks)):
            raise RuntimeError(
                f"conjugate gradients did not converge in {MOST_ITERATIONS} iterations on {len(x)} vertices; the mesh "
                "has extreme triangles. Remesh it, or use a shorter scale."
            )
        return np.concatenate(pairs, axis=1)[:, :n_cols].reshape(np.shape(x))


@memoized
def diffusion(verts: Verts, faces: Faces, clip: tuple[float, float]) -> Diffusion:
    """Diffusion on a surface, with the cotangents of its Laplacian bounded by ``clip``."""
    return Diffusion(geometry.vertex_areas(verts, faces), geometry.cotangent_laplacian(verts, faces, clip=clip))


def _joined(matrices: list[sparse.csr_array]) -> tuple[NDArray[np.uint32], NDArray[np.uint32], Array]:
    """Row starts, columns and values of matrices below each other, each with columns of its own from 0."""
    row_sizes = np.concatenate([np.diff(matrix.indptr) for matrix in matrices])
    return (
        np.cumsum(np.concatenate([[0], row_sizes]), dtype=np.uint32),
        np.concatenate([matrix.indices for matrix in matrices]).astype(np.uint32),
        np.concatenate([matrix.data for matrix in matrices]).astype(np.float64),
    )


def _prolongation(L: sparse.csr_array) -> sparse.csr_array:
    """From aggregates to the vertices of L: the constant on each aggregate, smoothed by a Jacobi step."""
    diagonal = L.diagonal()
    diagonal_root = np.sqrt(np.maximum(diagonal, 0.0))
    aggregate = _aggregates(*reading(L, diagonal_root))
    members = np.flatnonzero(aggregate >= 0)
    shape = (len(diagonal), int(aggregate.max(initial=-1)) + 1)
    tentative = sparse.csr_array((np.ones(len(members)), (members, aggregate[members])), shape=shape)
    jacobi_step = geometry.ratio(PROLONGATION_SMOOTHING, diagonal)
    return (tentative - sparse.diags_array(jacobi_step) @ (L @ tentative)).tocsr()


@kernel
def _aggregates(indptr, indices, values, root_diag):
    """Aggregate (N,) of each vertex, from 0; -1 where it has no strong neighbour."""
    n = len(root_diag)
    aggregate, n_aggregates = np.full(n, -1, np.int64), 0
    for i in range(n):  # a vertex and all its strong neighbours, if none of them is taken
        is_free, has_strong = aggregate[i] < 0, False
        for e in range(indptr[i], indptr[i + 1]):
            j = indices[e]
            if j != i and abs(values[e]) > LEAST_STRENGTH * root_diag[i] * root_diag[j]:
                has_strong, is_free = True, is_free and aggregate[j] < 0
        if is_free and has_strong:
            for e in range(indptr[i], indptr[i + 1]):
                if abs(values[e]) > LEAST_STRENGTH * root_diag[i] * root_diag[indices[e]]:
                    aggregate[indices[e]] = n_aggregates
            aggregate[i] = n_aggregates
            n_aggregates += 1
    for i in range(n):  # the rest joins a neighbour that was taken then
        if aggregate[i] < 0:
            for e in range(indptr[i], indptr[i + 1]):
                j = indices[e]
                if j != i and abs(values[e]) > LEAST_STRENGTH * root_diag[i] * root_diag[j] and aggregate[j] >= 0:
                    aggregate[i] = -2 - aggregate[j]
                    break
    for i in range(n):
        if aggregate[i] < -1:
            aggregate[i] = -2 - aggregate[i]
    return aggregate


@kernel
def _iterate(level_starts, ptr, upper_ptr, col, val, L_diagonal, mass, pptr, pcol, pval, time, right, x, rtol, limit):
    """Iterate two columns x (N, 2) in place; returns the number of iterations, -1 if it needs more than ``limit``.

    Two columns take a quarter more time than one, because both use each number of the matrix. ``upper_ptr``: where the
    columns behind the diagonal begin in each row.
    """
    n, size = level_starts[1], level_starts[-1]
    p, q, z, b = np.zeros((n, 2)), np.empty((n, 2)), np.empty((size, 2)), np.empty((size, 2))
    r = b[:n]  # the residual is the right side of the cycle
    diag, inv_diag = np.empty(size), np.empty(size)  # the diagonal of the matrix and its inverse; 0 where nothing holds
    for i in range(size):
        diag[i] = mass[i] + time * L_diagonal[i]
        inv_diag[i] = 1.0 / diag[i] if diag[i] > 0.0 else 0.0
    squared_goal, rr, pq, rz = np.zeros(2), np.zeros(2), np.zeros(2), (0.0, 0.0)
    for i in range(n):
        product, has_diag = _row_product(ptr[i], ptr[i + 1], col, val, x), 1.0 if diag[i] > 0.0 else 0.0
        for k in range(2):
            r[i, k] = has_diag * (right[i, k] - diag[i] * x[i, k] - time * product[k])
            squared_goal[k] += rtol * rtol * right[i, k] * right[i, k]
            rr[k] += r[i, k] * r[i, k]
    for iteration in range(limit + 1):
        if rr[0] <= squared_goal[0] and rr[1] <= squared_goal[1]:
            return iteration
        _cycle(level_starts, ptr, upper_ptr, col, val, inv_diag, pptr, pcol, pval, time, b, z)
        sum_0, sum_1 = 0.0, 0.0
        for i in range(n):
            sum_0, sum_1 = sum_0 + r[i, 0] * z[i, 0], sum_1 + r[i, 1] * z[i, 1]
        rz_old, rz = rz, (sum_0, sum_1)
        beta = _ratios(rz, rz_old)
        for i in range(n):
            for k in range(2):
                p[i, k] = z[i, k] + beta[k] * p[i, k]
        pq[:] = 0.0
        for i in range(n):
            product = _row_product(ptr[i], ptr[i + 1], col, val, p)
            for k in range(2):
                q[i, k] = diag[i] * p[i, k] + time * product[k]
                pq[k] += p[i, k] * q[i, k]
        step = _ratios(rz, pq)
        rr[:] = 0.0
        for i in range(n):
            for k in range(2):
                x[i, k] += step[k] * p[i, k]
                r[i, k] -= step[k] * q[i, k]
                rr[k] += r[i, k] * r[i, k]
    return -1


@njit(inline="always")
def _row_product(begin, end, col, val, x):
    """Product of a row of a matrix, the entries ``begin`` to ``end``, with both columns of x (N, 2)."""
    sum_0, sum_1 = 0.0, 0.0
    for e in range(begin, end):
        sum_0, sum_1 = sum_0 + val[e] * x[col[e], 0], sum_1 + val[e] * x[col[e], 1]
    return sum_0, sum_1


@kernel
def _ratios(top, bottom):
    return (top[0] / bottom[0] if bottom[0] > 0.0 else 0.0), (top[1] / bottom[1] if bottom[1] > 0.0 else 0.0)


@kernel
def _cycle(starts, ptr, upper_ptr, col, val, inv_diag, pptr, pcol, pval, time, b, z):
    """One V cycle for the right sides ``b`` on the finest level, from 0: ``z``. Both have room for all levels."""
    coarsest, ends = len(starts) - 2, ptr[1:]
    for level in range(coarsest):
        start, stop = starts[level], starts[level + 1]
        z_level, coarse_b = z[start:stop], b[stop : starts[level + 2]]
        # forward Gauss-Seidel, from 0: what is behind the diagonal does not count
        _relax(start, start, stop - 1, ptr, upper_ptr, col, val, inv_diag, time, b, z)
        coarse_b[:] = 0.0
        for i in range(start, stop):  # its residual is what is behind the diagonal
            product = _row_product(upper_ptr[i], ends[i], col, val, z_level)
            for e in range(pptr[i], pptr[i + 1]):
                for k in range(2):
                    coarse_b[pcol[e], k] -= pval[e] * time * product[k]
    start, stop = starts[coarsest], starts[coarsest + 1]
    z[start:stop] = 0.0
    for _ in range(N_COARSE_SWEEPS):
        _relax(start, start, stop - 1, ptr, ends, col, val, inv_diag, time, b, z)
        _relax(start, stop - 1, start, ptr, ends, col, val, inv_diag, time, b, z)
    for level in range(coarsest - 1, -1, -1):
        start, stop = starts[level], starts[level + 1]
        coarse_z = z[stop : starts[level + 2]]
        for i in range(start, stop):
            for e in range(pptr[i], pptr[i + 1]):
                for k in range(2):
                    z[i, k] += pval[e] * coarse_z[pcol[e], k]
        _relax(start, stop - 1, start, ptr, ends, col, val, inv_diag, time, b, z)


@kernel
def _relax(start, first, last, row_begin, row_end, col, val, inv_diag, time, b, z):
    """A Gauss-Seidel sweep over a level that begins at ``start``, from its first vertex to its last or back, with the
    entries from ``row_begin`` to ``row_end`` of each row."""
    z_level, step = z[start:], 1 if last > first else -1
    for i in range(first, last + step, step):
        product_0, product_1 = _row_product(row_begin[i], row_end[i], col, val, z_level)
        z[i, 0], z[i, 1] = (b[i, 0] - time * product_0) * inv_diag[i], (b[i, 1] - time * product_1) * inv_diag[i]
