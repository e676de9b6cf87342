"""Conjugate gradients for one or three right sides, in parallel, bitwise the same for any number of threads."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from scipy import sparse

from morphofold.arrays import Array
from morphofold.errors import WrongShape
from morphofold.threads import BLOCKS

MOST_ITERATIONS = 3000


def solve(matrix: sparse.csr_array, right: Array, x: Array, rtol: float) -> Array:
    """Solve ``matrix @ x = right`` for a symmetric positive definite matrix, with Jacobi preconditioner, from ``x``.

    Parameters
    ----------
    matrix : (N, N) csr_array
    right, x : (N,) or (N, 3) float64
        The iteration starts at ``x``, which is not changed. Three columns take half the time of three calls. One kernel
        for any number of columns would take 1.2 to 2 times as long.
    rtol : float
        Residual at the end, relative to ``right``, in each column.

    Raises
    ------
    WrongShape
        If ``right`` or ``x`` has another shape.
    RuntimeError
        If that takes more than 3000 iterations. The mesh of the matrix is then too irregular.
    """
    if np.shape(right) != np.shape(x) or np.shape(x) not in ((matrix.shape[0],), (matrix.shape[0], 3)):
        raise WrongShape(f"right {np.shape(right)} and x {np.shape(x)} must be (N,) or (N, 3), N = {matrix.shape[0]}.")
    diagonal = matrix.diagonal()
    jacobi = np.divide(1, diagonal, out=np.ones_like(diagonal), where=diagonal > 0)
    x = np.array(x, dtype=np.float64)
    iterate = _iterate_one_column if x.ndim == 1 else _iterate_three_columns
    if not iterate(matrix.indptr, matrix.indices, matrix.data, jacobi, right, x, rtol, MOST_ITERATIONS):
        raise RuntimeError(
            f"conjugate gradients did not converge in {MOST_ITERATIONS} iterations on {len(x)} vertices; the mesh has "
            "extreme triangles. Remesh it, or use a shorter scale."
        )
    return x


@njit(cache=True)
def _sum_in_order(parts):
    """Sum in order: within a parallel kernel numba would divide the sum among its threads."""
    total = 0.0
    for part in parts:
        total += part
    return total


@njit(cache=True, parallel=True)
def _iterate_one_column(indptr, indices, data, jacobi, right, x, rtol, steps):
    # Not scipy's cg: BLAS threads wait on its short sums, and add them in an order that depends on the thread count.
    n = len(x)
    r, p, q = np.empty(n), np.empty(n), np.empty(n)
    one, two, three = np.zeros(BLOCKS), np.zeros(BLOCKS), np.zeros(BLOCKS)
    for b in prange(BLOCKS):
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            total = right[i]
            for e in range(indptr[i], indptr[i + 1]):
                total -= data[e] * x[indices[e]]
            r[i], p[i] = total, jacobi[i] * total
            one[b] += total * total
            two[b] += total * p[i]
            three[b] += right[i] * right[i]
    rr, rz, goal = _sum_in_order(one), _sum_in_order(two), rtol * rtol * _sum_in_order(three)
    for _ in range(steps):
        if rr <= goal:
            return True
        for b in prange(BLOCKS):
            part = 0.0
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                total = 0.0
                for e in range(indptr[i], indptr[i + 1]):
                    total += data[e] * p[indices[e]]
                q[i] = total
                part += total * p[i]
            one[b] = part
        alpha, old = rz / _sum_in_order(one), rz
        for b in prange(BLOCKS):
            part, weighed = 0.0, 0.0
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                x[i] += alpha * p[i]
                r[i] -= alpha * q[i]
                part += r[i] * r[i]
                weighed += r[i] * r[i] * jacobi[i]
            one[b], two[b] = part, weighed
        rr, rz = _sum_in_order(one), _sum_in_order(two)
        beta = rz / old
        for b in prange(BLOCKS):
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                p[i] = jacobi[i] * r[i] + beta * p[i]
    return False


@njit(cache=True)
def _sum_columns_in_order(parts):
    total = np.zeros(3)
    for part in parts:
        total += part
    return total


@njit(cache=True, parallel=True)
def _iterate_three_columns(indptr, indices, data, jacobi, right, x, rtol, steps):
    n = len(x)
    r, p, q = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    one, two, three = np.zeros((BLOCKS, 3)), np.zeros((BLOCKS, 3)), np.zeros((BLOCKS, 3))
    for b in prange(BLOCKS):
        for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
            for k in range(3):
                total = right[i, k]
                for e in range(indptr[i], indptr[i + 1]):
                    total -= data[e] * x[indices[e], k]
                r[i, k], p[i, k] = total, jacobi[i] * total
                one[b, k] += total * total
                two[b, k] += total * p[i, k]
                three[b, k] += right[i, k] * right[i, k]
    rr, rz, goal = _sum_columns_in_order(one), _sum_columns_in_order(two), rtol * rtol * _sum_columns_in_order(three)
    alpha, beta = np.zeros(3), np.zeros(3)
    for _ in range(steps):
        if (rr <= goal).all():
            return True
        for b in prange(BLOCKS):
            pa, pb, pc = 0.0, 0.0, 0.0
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                a, c, d = 0.0, 0.0, 0.0
                for e in range(indptr[i], indptr[i + 1]):
                    w, j = data[e], indices[e]
                    a += w * p[j, 0]
                    c += w * p[j, 1]
                    d += w * p[j, 2]
                q[i, 0], q[i, 1], q[i, 2] = a, c, d
                pa += a * p[i, 0]
                pb += c * p[i, 1]
                pc += d * p[i, 2]
            one[b, 0], one[b, 1], one[b, 2] = pa, pb, pc
        pq, old = _sum_columns_in_order(one), rz
        for k in range(3):  # a column may converge before the others
            alpha[k] = rz[k] / pq[k] if pq[k] > 0 else 0.0
        for b in prange(BLOCKS):
            one[b], two[b] = 0.0, 0.0
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                for k in range(3):
                    x[i, k] += alpha[k] * p[i, k]
                    r[i, k] -= alpha[k] * q[i, k]
                    square = r[i, k] * r[i, k]
                    one[b, k] += square
                    two[b, k] += square * jacobi[i]
        rr, rz = _sum_columns_in_order(one), _sum_columns_in_order(two)
        for k in range(3):
            beta[k] = rz[k] / old[k] if old[k] > 0 else 0.0
        for b in prange(BLOCKS):
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                for k in range(3):
                    p[i, k] = jacobi[i] * r[i, k] + beta[k] * p[i, k]
    return False
