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
from morphofold.sim.elements.lanes import FAST_MATH, LANES, ROW, UINT, fetch, inlined, read_level
from morphofold.sim.elements.tensor3 import cofactor, combination, dot, product, read3, read9, transposed, write9
from morphofold.sim.elements.tet_kernels import PATCH_NODES, PATCH_TETS, nodes_to_edges, patch_gradient

_ZERO = (0.0,) * 9
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

_combination = inlined(combination.py_func)


@njit
def _sum(a, b, s):
    """A + s B."""
    return _combination(1.0, a, s, b)


@njit
def _det(a):
    return dot(a, cofactor(a))


@njit
def _turned_into_grown(Q, H):
    """H^-T Q H^T."""
    cofactors = cofactor(H)
    return _sum(_ZERO, product(product(cofactors, Q), transposed(H)), 1.0 / dot(H, cofactors))


@njit
def _mean_decay(decay):
    """Mean of exp(-t) for t from 0 to ``decay``."""
    return -math.expm1(-decay) / decay if decay > 0.0 else 1.0


@njit
def _grow(G, M, per_mu, rate, kappa, swells):
    """Replace G (3, 3) by (1 + L + L^2/2) G, with L = ``rate`` times the mean of M / mu while it relaxes.

    M: nine numbers, of which the symmetric part is taken; ``per_mu`` M is the mean stress before, over mu. At fixed
    positions small shear stress falls by exp(-2 rate), pressure by exp(-3 rate kappa), with kappa over mu. So small
    growth is exact however fast stress relaxes. The factor is the exponential of L to second order; it is positive
    definite for any L. Unless it ``swells``, L has no trace and the factor has the determinant 1.
    """
    shear_decay = _mean_decay(2.0 * rate)
    L = _sum(_ZERO, _sum(M, transposed(M), 1.0), 0.5 * per_mu * rate * shear_decay)
    trace_factor = _mean_decay(3.0 * rate * kappa) / shear_decay - 1.0 if swells else -1.0
    L = _sum(L, _IDENTITY, trace_factor * (L[0] + L[4] + L[8]) / 3.0)
    growth_factor = _sum(_sum(_IDENTITY, L, 1.0), product(L, L), 0.5)
    if not swells:
        growth_factor = _sum(_ZERO, growth_factor, _det(growth_factor) ** (-1.0 / 3.0))
    grown_G = product(growth_factor, _columns(G))
    for r in range(3):
        for s in range(3):
            G[r, s] = grown_G[3 * s + r]


@njit
def _columns(G):
    return G[0, 0], G[1, 0], G[2, 0], G[0, 1], G[1, 1], G[2, 1], G[0, 2], G[1, 2], G[2, 2]


@njit(fastmath=FAST_MATH, error_model="numpy")
def _grow_brick(x, X, points, moduli, lane, G, rate, swells, material):
    """Grow the brick in ``lane`` of a block; ``x``, ``X``: corners deformed and before growth, in eighths."""
    d, d0 = brick_kernels.gauss_point_jacobians(x, lane), brick_kernels.gauss_point_jacobians(X, lane)
    data, mu, per_volume = brick_kernels.data_of_points(points, lane), moduli[lane], moduli[lane + UINT(2) * ROW]
    pressure = moduli[lane + ROW] * (brick_kernels.brick_volume(x, lane) * per_volume - 1.0)
    Q, mean_jacobian = _ZERO, _ZERO
    for q in range(8):
        Q = _sum(Q, product(transposed(d[q]), brick_kernels.point_stress(d[q], data[q], mu, pressure, material)), 1.0)
        mean_jacobian = _sum(mean_jacobian, d0[q], 0.125)
    kappa = moduli[lane + ROW] / mu + 2.0  # with the local term
    _grow(G, _turned_into_grown(Q, product(_columns(G), mean_jacobian)), per_volume / mu, rate, kappa, swells)
    grown_volume = 0.0
    for q in range(8):
        H = product(_columns(G), d0[q])
        k = cofactor(H)
        w = dot(H, k)
        row = lane + UINT(q * brick_kernels.ROWS_PER_POINT) * ROW
        for i in range(3):
            for j in range(i, 3):  # C = w H^-1 H^-T
                points[row] = (k[3 * i] * k[3 * j] + k[3 * i + 1] * k[3 * j + 1] + k[3 * i + 2] * k[3 * j + 2]) / w
                row += ROW
        points[row] = 1.0 / w
        grown_volume += w
    moduli[lane + UINT(2) * ROW] = 1.0 / grown_volume


@kernel(parallel=True, fastmath=FAST_MATH)
def grow_bricks(
    x, X, nodes, start, local_row, layers, cortex_layers, brick, n_cortex, points, moduli, G, rate, swells, material
):
    """Grow the bricks below the cortex by ``rate`` M / mu: their G (n_core, 3, 3), point data and 1/V, in place.

    x, X (N, 3): positions, deformed and before growth; brick (block, LANES): that in each lane; the others as for
    ``brick_kernels.element_forces``.
    """
    for group in prange(len(local_row)):
        brick_x, brick_X, nodal_x = np.zeros(24 * LANES), np.zeros(24 * LANES), np.empty((4 * LANES, 3))
        origin, ungrown_origin, shift = np.zeros(3 * LANES), np.zeros(3 * LANES), np.empty(3 * LANES)
        n_rows = (start[group + 1] - start[group]) // (layers + 1)
        for level in range(layers + 1):
            level_nodes = nodes[start[group] + level * n_rows : start[group] + (level + 1) * n_rows]
            read_level(x, level_nodes, local_row[group], nodal_x, origin, shift, brick_x)
            read_level(X, level_nodes, local_row[group], nodal_x, ungrown_origin, shift, brick_X)
            block = group * layers + level - 1
            if level > cortex_layers:
                for lane in range(ROW):
                    if moduli[block, lane] > 0.0:  # not a lane that only fills the last block
                        e = brick[block, lane] - n_cortex
                        _grow_brick(brick_x, brick_X, points[block], moduli[block], lane, G[e], rate, swells, material)


@kernel(parallel=True, fastmath=FAST_MATH)
def grow_patches(x, X, nodes, start, local_row, corner, patch, n_cortex, edges, moduli, G, rate, swells, material):
    """Grow the patches from number ``n_cortex`` on by ``rate`` M / mu: their G (n_core, 3, 3) and ``edges``, in place.

    x, X (N, 3): positions, deformed and before growth; patch (block, LANES): that in each lane; the others as for
    ``tet_kernels.patch_forces``.
    """
    for block in prange(n_cortex // LANES, len(local_row)):
        nodal_x, patch_x, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, ungrown, gradient, block_moduli = edges[block], np.empty(54 * LANES), np.empty(54 * LANES), moduli[block]
        block_nodes = nodes[start[block] : start[block + 1]]
        fetch(x, block_nodes, local_row[block], PATCH_NODES, e, nodal_x, patch_x)
        nodes_to_edges(patch_x, corner[block], d)
        fetch(X, block_nodes, local_row[block], PATCH_NODES, e, nodal_x, patch_x)
        nodes_to_edges(patch_x, corner[block], ungrown)
        for lane in range(ROW):
            if patch[block, lane] < n_cortex or not block_moduli[lane] > 0.0:
                continue
            patch_gradient(d, e, block_moduli, gradient, lane, material)
            mu, kappa, n_tets = read3(block_moduli, lane)
            M, grown_volume, G_of_patch = _ZERO, 0.0, G[patch[block, lane] - n_cortex]
            for tet in range(UINT(PATCH_TETS)):
                row = UINT(9) * tet * ROW + lane
                H = read9(e, row)
                if n_tets > tet:  # a patch of fewer tetrahedra repeats its first one
                    Q = product(transposed(read9(d, row)), read9(gradient, row))
                    M, grown_volume = _sum(M, _turned_into_grown(Q, H), 1.0), grown_volume + _det(H) / 6.0
            _grow(G_of_patch, M, 1.0 / (grown_volume * mu), rate, kappa / mu, swells)
            for tet in range(UINT(PATCH_TETS)):
                row = UINT(9) * tet * ROW + lane
                write9(e, row, product(_columns(G_of_patch), read9(ungrown, row)))
