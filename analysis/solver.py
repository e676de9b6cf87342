"""Conjugate gradients for one right side, in parallel, the same to the bit for any number of threads."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

BLOCKS = 64             # stretches of rows whose partial sums are added in order
MOST_STEPS = 3000


def solve(matrix: sparse.csr_array, right: Array, x: Array, rtol: float) -> Array:
    """Solve ``matrix @ x = right`` for a symmetric positive definite matrix; Jacobi preconditioner, from ``x``.

    Parameters
    ----------
    matrix : (N, N) csr_array
    right, x : (N,) float64
        ``x`` is where the iteration starts; it is not changed.
    rtol : float
        Residual at the end, relative to ``right``.

    Raises
    ------
    RuntimeError
        If that takes more than 3000 iterations; the mesh behind the matrix is then too irregular.
    """
    diagonal = matrix.diagonal()
    jacobi = np.divide(1, diagonal, out=np.ones_like(diagonal), where=diagonal > 0)
    x = np.array(x, dtype=np.float64)
    if not _iterate(matrix.indptr, matrix.indices, matrix.data, jacobi, right, x, rtol, MOST_STEPS):
        raise RuntimeError(
            f"conjugate gradients did not converge in {MOST_STEPS} iterations on {len(x)} vertices; the mesh has "
            "extreme triangles. Remesh it."
        )
    return x


@njit(cache=True)
def _sum(parts):
    """In order: within a parallel kernel numba would share the sum among its threads."""
    total = 0.0
    for part in parts:
        total += part
    return total


@njit(cache=True, parallel=True)
def _iterate(indptr, indices, data, jacobi, right, x, rtol, steps):
    # Not scipy's cg: BLAS threads spin on its short sums, and add them in an order that depends on their number.
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
    rr, rz, goal = _sum(one), _sum(two), rtol * rtol * _sum(three)
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
        alpha, old = rz / _sum(one), rz
        for b in prange(BLOCKS):
            part, weighed = 0.0, 0.0
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                x[i] += alpha * p[i]
                r[i] -= alpha * q[i]
                part += r[i] * r[i]
                weighed += r[i] * r[i] * jacobi[i]
            one[b], two[b] = part, weighed
        rr, rz = _sum(one), _sum(two)
        beta = rz / old
        for b in prange(BLOCKS):
            for i in range(b * n // BLOCKS, (b + 1) * n // BLOCKS):
                p[i] = jacobi[i] * r[i] + beta * p[i]
    return False
