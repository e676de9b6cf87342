"""Numba loops that let each element of the core grow by its own stress: bricks, and patches of tetrahedra.

An element has one growth tensor G. With H = dX'/dxi the map from its parent coordinates to the grown material (G dX/dxi
of a brick, the grown edges of a tetrahedron) and D = dx/dxi, A = D H^-1, so

    sum_q w_q A^T dW/dA = H^-T Q H^T,    Q = sum_q D^T dE/dD,

with E the energy of the element. Over its grown volume V this is the mean Mandel stress M. For an isotropic material
it is symmetric at a point; of the mean the symmetric part is taken.
"""

import math

import numpy as np
from numba import njit, prange

from morphofold.kernels import kernel
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.lanes import _FAST_MATH, _LANES, _UINT, LANES, fetch, read_level
from morphofold.sim.elements.tet_kernels import (
    PATCH_NODES,
    PATCH_TETS,
    _linear_combination,
    _nodes_to_edges,
    _patch_gradient,
    _read_matrix,
    _write_matrix,
    product,
)


@njit
def _sum(a, b, s):
    """a + s b."""
    return _linear_combination(1.0, a, s, b)


@njit
def _transposed(a):
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@njit
def _det(a):
    k = brick_kernels._cofactor(*a)
    return a[0] * k[0] + a[1] * k[1] + a[2] * k[2]


_ZERO = (0.0,) * 9
_ONE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@njit
def _turned_into_grown(Q, H):
    """H^-T Q H^T."""
    k = brick_kernels._cofactor(*H)
    return _sum(_ZERO, product(product(k, Q), _transposed(H)), 1.0 / (H[0] * k[0] + H[1] * k[1] + H[2] * k[2]))


@njit
def _mean_decay(decay):
    """Mean of exp(-t) for t from 0 to ``decay``."""
    return -math.expm1(-decay) / decay if decay > 0.0 else 1.0


@njit
def _grow(G, M, per_mu, rate, kappa, volume):
    """Replace G (3, 3) by (1 + L + L^2/2) G, with L = ``rate`` times the mean of M / mu while it relaxes.

    M: nine numbers, of which the symmetric part is taken; ``per_mu`` M is the mean stress before, over mu. At fixed
    positions small shear stress falls by exp(-2 rate), pressure by exp(-3 rate kappa), with kappa over mu. So small
    growth is exact however fast stress relaxes. The factor is the exponential of L to second order; it is positive
    definite for any L. Without ``volume``, L has no trace and the factor has the determinant 1.
    """
    shear = _mean_decay(2.0 * rate)
    L = _sum(_ZERO, _sum(M, _transposed(M), 1.0), 0.5 * per_mu * rate * shear)
    share = _mean_decay(3.0 * rate * kappa) / shear - 1.0 if volume else -1.0
    L = _sum(L, _ONE, share * (L[0] + L[4] + L[8]) / 3.0)
    factor = _sum(_sum(_ONE, L, 1.0), product(L, L), 0.5)
    if not volume:
        factor = _sum(_ZERO, factor, _det(factor) ** (-1.0 / 3.0))
    new = product(factor, _columns(G))
    for r in range(3):
        for s in range(3):
            G[r, s] = new[3 * s + r]


@njit
def _columns(G):
    return G[0, 0], G[1, 0], G[2, 0], G[0, 1], G[1, 1], G[2, 1], G[0, 2], G[1, 2], G[2, 2]


@njit(fastmath=_FAST_MATH, error_model="numpy")
def _grow_brick(now, first, point, m, l, G, rate, volume, material):
    """Grow the brick in lane ``l`` of a block; ``now``, ``first``: corners deformed and before growth, in eighths."""
    d, d0 = brick_kernels._gauss_point_jacobians(now, l), brick_kernels._gauss_point_jacobians(first, l)
    c, mu, per_volume = brick_kernels._data_of_all_points(point, l), m[l], m[l + _UINT(2) * _LANES]
    p = m[l + _LANES] * (brick_kernels._brick_volume(now, l) * per_volume - 1.0)
    Q, middle = _ZERO, _ZERO
    for q in range(8):
        Q = _sum(Q, product(_transposed(d[q]), brick_kernels._point_stress(d[q], c[q], mu, p, material)), 1.0)
        middle = _sum(middle, d0[q], 0.125)
    kappa = m[l + _LANES] / mu + 2.0  # with the local term
    _grow(G, _turned_into_grown(Q, product(_columns(G), middle)), per_volume / mu, rate, kappa, volume)
    grown = 0.0
    for q in range(8):
        H = product(_columns(G), d0[q])
        k = brick_kernels._cofactor(*H)
        w = H[0] * k[0] + H[1] * k[1] + H[2] * k[2]
        row = l + _UINT(q * brick_kernels.ROWS_PER_POINT) * _LANES
        for i in range(3):
            for j in range(i, 3):  # C = w H^-1 H^-T
                point[row] = (k[3 * i] * k[3 * j] + k[3 * i + 1] * k[3 * j + 1] + k[3 * i + 2] * k[3 * j + 2]) / w
                row += _LANES
        point[row] = 1.0 / w
        grown += w
    m[l + _UINT(2) * _LANES] = 1.0 / grown


@kernel(parallel=True, fastmath=_FAST_MATH)
def grow_bricks(
    x, X, nodes, start, local, layers, cortex_layers, element, n_cortex, point, modulus, G, rate, volume, material
):
    """Grow the bricks below the cortex by ``rate`` M / mu: their G (n_core, 3, 3), point data and 1/V, in place.

    x, X (N, 3): positions, deformed and before growth; element (block, LANES): brick in each lane; the others as for
    ``brick_kernels.element_forces``.
    """
    for g in prange(len(local)):
        now, first, at, origin = (
            np.zeros(24 * LANES),
            np.zeros(24 * LANES),
            np.empty((4 * LANES, 3)),
            np.zeros(3 * LANES),
        )
        origin0, moved = np.zeros(3 * LANES), np.empty(3 * LANES)
        width = (start[g + 1] - start[g]) // (layers + 1)
        for k in range(layers + 1):
            level = nodes[start[g] + k * width : start[g] + (k + 1) * width]
            read_level(x, level, local[g], at, origin, moved, now)
            read_level(X, level, local[g], at, origin0, moved, first)
            b = g * layers + k - 1
            if k > cortex_layers:
                for l in range(_LANES):
                    if modulus[b, l] > 0.0:  # not a lane that only fills the last block
                        e = element[b, l] - n_cortex
                        _grow_brick(now, first, point[b], modulus[b], l, G[e], rate, volume, material)


@kernel(parallel=True, fastmath=_FAST_MATH)
def grow_patches(x, X, nodes, start, local, corner, element, n_cortex, edges, modulus, G, rate, volume, material):
    """Grow the patches from number ``n_cortex`` on by ``rate`` M / mu: their G (n_core, 3, 3) and ``edges``, in place.

    x, X (N, 3): positions, deformed and before growth; element (block, LANES): patch in each lane; the others as for
    ``tet_kernels.patch_forces``.
    """
    for b in prange(n_cortex // LANES, len(local)):
        at, near, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, d0, q, m = edges[b], np.empty(54 * LANES), np.empty(54 * LANES), modulus[b]
        mine = nodes[start[b] : start[b + 1]]
        fetch(x, mine, local[b], PATCH_NODES, e, at, near)
        _nodes_to_edges(near, corner[b], d)
        fetch(X, mine, local[b], PATCH_NODES, e, at, near)
        _nodes_to_edges(near, corner[b], d0)
        for l in range(_LANES):
            if element[b, l] < n_cortex or not m[l] > 0.0:
                continue
            _patch_gradient(d, e, m, q, l, material)
            M, grown, mine_G = _ZERO, 0.0, G[element[b, l] - n_cortex]
            for t in range(_UINT(PATCH_TETS)):
                row = _UINT(9) * t * _LANES + l
                H, Q = _read_matrix(e, row), product(_transposed(_read_matrix(d, row)), _read_matrix(q, row))
                if m[l + _UINT(2) * _LANES] > t:  # a patch of fewer tetrahedra repeats its first one
                    M, grown = _sum(M, _turned_into_grown(Q, H), 1.0), grown + _det(H) / 6.0
            _grow(mine_G, M, 1.0 / (grown * m[l]), rate, m[l + _LANES] / m[l], volume)
            for t in range(_UINT(PATCH_TETS)):
                row = _UINT(9) * t * _LANES + l
                _write_matrix(e, row, product(_columns(mine_G), _read_matrix(d0, row)))
