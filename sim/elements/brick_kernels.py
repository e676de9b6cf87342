"""Numba loops of the hexahedral Q1P0 element: forces, growth, stiffness bound.

The element is the eight-node brick with 2x2x2 Gauss points, a pressure from the mean volume ratio of the element, and
a weak local volumetric term: with A = F G^-1, J = det A, and w the grown volume of a point,

    W = sum_q w_q [ mu u(i1, i2) + mu (J - 1)^2 ] + kappa/2 V (v/V - 1)^2,   V = sum w, v = sum w J,

where i1 = J^-2/3 I1 and i2 = J^-4/3 I2, with the invariants I1 = tr(A^T A), I2 = (I1^2 - tr((A^T A)^2)) / 2, and u is
the material's (:mod:`morphofold.sim.materials`); neo-Hookean, (i1 - 3) / 2.

Everything is computed in the parent coordinates of the brick, [-1, 1]^3. With D = dx/dxi and
C = w dxi/dX G^-1 G^-T (dxi/dX)^T one has w tr(A^T A) = D : D C and J = det D / w. So a point needs only the six numbers
of C and 1/w, and any growth changes only these seven. The derivative with respect to D is f D C + s cof D, minus
h b D C if the material depends on i2, with b = A A^T = D C D^T / w: nothing else of A is needed.

The pressure is kappa (v/V - 1) + p, with p = 0 unless the bulk modulus is split (``bricks.Bricks.split_bulk``).

Elements are stored in lanes (:mod:`morphofold.sim.elements.lanes`), in columns of blocks from the pial surface down:
``blocks.Columns`` connects them with the nodes.
"""

import numpy as np
from numba import njit, prange

from morphofold.kernels import kernel
from morphofold.sim.elements import tensor3
from morphofold.sim.elements.lanes import (
    CORNER_SCALE,
    FAST_MATH,
    LANES,
    ROW,
    UINT,
    add_level,
    inlined,
    prefetch,
    read_level,
)
from morphofold.sim.elements.tensor3 import dot, in_precision_of, inner, minus, plus, read3, spelled_out, times
from morphofold.sim.materials import energy_of, slopes_of, stiffness_bound, uses_i2

ROWS_PER_POINT = 7  # rows per Gauss point: C00 C01 C02 C11 C12 C22 1/w
FROZEN_BELOW_J = 0.1  # below this volume ratio the factors J^-2/3, J^-4/3 are constant, so that they stay finite

_P_ROW = UINT(3) * ROW  # of the pressure that follows, in the moduli
_GAUSS_COORDINATE = 1.0 / np.sqrt(3.0)  # Gauss points along an edge are at minus and plus this


@inlined
def _face_gauss_values(v00, v01, v10, v11):
    """Four times the values at the 2x2 Gauss points of a face, from its corners 00, 01, 10, 11. It is symmetric."""
    xi = in_precision_of(v00, _GAUSS_COORDINATE)
    sum0, diff0, sum1, diff1 = v00 + v01, v00 - v01, v10 + v11, v10 - v11
    high0, low0, high1, low1 = sum0 + xi * diff0, sum0 - xi * diff0, sum1 + xi * diff1, sum1 - xi * diff1
    sum0, diff0, sum1, diff1 = high0 + high1, high0 - high1, low0 + low1, low0 - low1
    return sum0 + xi * diff0, sum1 + xi * diff1, sum0 - xi * diff0, sum1 - xi * diff1


@inlined
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.1 < J < 8, without a branch; in 32 bits the error is 1e-6 beyond J = 6."""
    return tensor3.refined_inverse_cube_root(J, tensor3.halley_step(J))


@inlined
def _times_symmetric(d, c):
    """The three columns of D C for symmetric C."""
    return times(d, c), times(d, (c[1], c[3], c[4])), times(d, (c[2], c[4], c[5]))


@inlined
def point_stress(d, c, mu, pressure, material):
    """dW/dD at one Gauss point, nine numbers; ``pressure`` is the element's, kappa (v/V - 1)."""
    cofactors = tensor3.cofactor(d)
    J = dot(d, cofactors) * c[6]
    frozen_J, one, two = in_precision_of(J, FROZEN_BELOW_J), in_precision_of(J, 1.0), in_precision_of(J, 2.0)
    y = _inverse_cube_root(max(J, frozen_J))
    col0, col1, col2 = _times_symmetric(d, c)
    dc = col0 + col1 + col2
    I1 = inner(d, dc) * c[6]
    if uses_i2(material):
        b = tensor3.left_cauchy_green(dc, d, c[6])
        I2 = tensor3.second_invariant(I1, b)
        u1, u2 = slopes_of(material, y * y * I1, y * y * y * y * I2)
        f, h = two * in_precision_of(J, u1) * mu * y * y, two * in_precision_of(J, u2) * mu * y * y * y * y
        s = pressure + two * mu * (J - one)
        factor_slope = (f * I1 + two * h * I2) * y * y * y * in_precision_of(J, 1.0 / 3.0)
        s -= factor_slope if J > frozen_J else in_precision_of(J, 0.0)
        return tensor3.minus_product(tensor3.combination(f + h * I1, dc, s, cofactors), h, b, dc)
    u1, _ = slopes_of(material, y * y * I1, in_precision_of(J, 3.0))
    f = two * in_precision_of(J, u1) * mu * y * y
    s = pressure + two * mu * (J - one)
    s -= f * I1 * y * y * y * in_precision_of(J, 1.0 / 3.0) if J > frozen_J else in_precision_of(J, 0.0)
    return tensor3.combination(f, dc, s, cofactors)


@spelled_out
def _quad_values(x, start):
    return x[start], x[start + UINT(3) * ROW], x[start + UINT(6) * ROW], x[start + UINT(9) * ROW]


@spelled_out
def corner_values(x, start):
    """One coordinate of the eight corners, in every third row from ``start``."""
    return _quad_values(x, start) + _quad_values(x, start + UINT(12) * ROW)


@inlined
def _natural_derivatives(x, start):
    """dx_r/dxi at the Gauss points for the first coordinate r in ``x`` (in eighths), in three groups of four.

    Along i at (j, k), along j at (i, k), along k at (i, j). Row 3 c of ``x`` belongs to corner c = 4 i + 2 j + k.
    """
    x0, x1, x2, x3, x4, x5, x6, x7 = corner_values(x, start)
    return (
        _face_gauss_values(x4 - x0, x5 - x1, x6 - x2, x7 - x3),
        _face_gauss_values(x2 - x0, x3 - x1, x6 - x4, x7 - x5),
        _face_gauss_values(x1 - x0, x3 - x2, x5 - x4, x7 - x6),
    )


@inlined
def gauss_point_jacobians(corner_x, lane):
    """D at the eight Gauss points p = 4 i + 2 j + k, nine numbers each, column by column."""
    (a0, a1, a2, a3), (b0, b1, b2, b3), (c0, c1, c2, c3) = _natural_derivatives(corner_x, lane)
    (d0, d1, d2, d3), (e0, e1, e2, e3), (f0, f1, f2, f3) = _natural_derivatives(corner_x, lane + ROW)
    (g0, g1, g2, g3), (h0, h1, h2, h3), (i0, i1, i2, i3) = _natural_derivatives(corner_x, lane + UINT(2) * ROW)
    return (
        (a0, d0, g0, b0, e0, h0, c0, f0, i0),
        (a1, d1, g1, b1, e1, h1, c0, f0, i0),
        (a2, d2, g2, b0, e0, h0, c1, f1, i1),
        (a3, d3, g3, b1, e1, h1, c1, f1, i1),
        (a0, d0, g0, b2, e2, h2, c2, f2, i2),
        (a1, d1, g1, b3, e3, h3, c2, f2, i2),
        (a2, d2, g2, b2, e2, h2, c3, f3, i3),
        (a3, d3, g3, b3, e3, h3, c3, f3, i3),
    )


@inlined
def _point_data(point_data, start, point):
    start += UINT(ROWS_PER_POINT * point) * ROW
    return read3(point_data, start) + read3(point_data, start + UINT(3) * ROW) + (point_data[start + UINT(6) * ROW],)


@inlined
def data_of_points(point_data, lane):
    """C (six numbers) and 1/w of the eight Gauss points of the brick in ``lane``."""
    return (
        _point_data(point_data, lane, 0),
        _point_data(point_data, lane, 1),
        _point_data(point_data, lane, 2),
        _point_data(point_data, lane, 3),
        _point_data(point_data, lane, 4),
        _point_data(point_data, lane, 5),
        _point_data(point_data, lane, 6),
        _point_data(point_data, lane, 7),
    )


@spelled_out
def _at_points(function, jacobians, data, mu, pressure, material):
    """``function`` of D and the data of each Gauss point."""
    return (
        function(jacobians[0], data[0], mu, pressure, material),
        function(jacobians[1], data[1], mu, pressure, material),
        function(jacobians[2], data[2], mu, pressure, material),
        function(jacobians[3], data[3], mu, pressure, material),
        function(jacobians[4], data[4], mu, pressure, material),
        function(jacobians[5], data[5], mu, pressure, material),
        function(jacobians[6], data[6], mu, pressure, material),
        function(jacobians[7], data[7], mu, pressure, material),
    )


@spelled_out
def _corner(corner_x, lane, corner):
    return read3(corner_x, lane + UINT(3 * corner) * ROW)


@inlined
def brick_volume(corner_x, lane):
    """Volume v of the trilinear brick from its corners in eighths: by three determinants (Grandy 1997), not eight."""
    x0, x7 = read3(corner_x, lane), _corner(corner_x, lane, 7)
    a, b = minus(x7, _corner(corner_x, lane, 2)), minus(_corner(corner_x, lane, 5), x0)
    c, d = minus(x7, _corner(corner_x, lane, 1)), minus(_corner(corner_x, lane, 3), x0)
    e, f = minus(_corner(corner_x, lane, 6), x0), minus(x7, _corner(corner_x, lane, 4))
    det_sum = tensor3.det(plus(a, b) + c + d) + tensor3.det(b + plus(c, e) + f) + tensor3.det(a + e + plus(f, d))
    return in_precision_of(det_sum, 512.0 / 12.0) * det_sum


@inlined
def corner_forces(P, axis):
    """Minus the gradient by coordinate ``axis`` of the corners in eighths, from dW/dD at the points.

    It is _natural_derivatives transposed.
    """
    i, j, k = axis, 3 + axis, 6 + axis
    s0, s1, s2, s3 = _face_gauss_values(P[0][i] + P[4][i], P[1][i] + P[5][i], P[2][i] + P[6][i], P[3][i] + P[7][i])
    t0, t1, t2, t3 = _face_gauss_values(P[0][j] + P[2][j], P[1][j] + P[3][j], P[4][j] + P[6][j], P[5][j] + P[7][j])
    u0, u1, u2, u3 = _face_gauss_values(P[0][k] + P[1][k], P[2][k] + P[3][k], P[4][k] + P[5][k], P[6][k] + P[7][k])
    return (
        s0 + t0 + u0,
        s1 + t1 - u0,
        s2 - t0 + u1,
        s3 - t1 - u1,
        t2 - s0 + u2,
        t3 - s1 - u2,
        u3 - s2 - t2,
        -s3 - t3 - u3,
    )


@inlined
def store_corner_values(array, start, values):
    """Write the eight corner values of one coordinate, times the scale, into every third row from ``start``."""
    for corner in range(8):
        array[start + UINT(3) * UINT(corner) * ROW] = in_precision_of(values[corner], CORNER_SCALE) * values[corner]


@njit(forceinline=True)
def prefetch_block(data, block, part):
    """Prefetch one of three parts, 0 to 2, of the data of ``block``: at once, they would wait for each other."""
    block_data = data[min(block, len(data) - 1)]
    part_length = len(block_data) // 3
    for i in range(part * part_length, (part + 1) * part_length, 64 // data.itemsize):  # a cache line holds 64 bytes
        prefetch(block_data, i)


@kernel(parallel=True, fastmath=FAST_MATH)
def element_forces(x, nodes, start, local_row, n_layers, point_data, moduli, rest_ratio, follow, force, material):
    """Write forces (minus the energy gradient) of the bricks, summed per column and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local_row, n_layers: see ``Columns``; point_data (block, 56 LANES); moduli (block, 4
    LANES): mu, kappa, 1/V, p; material: see ``sim.materials``. Positions and sums have 64 bits; the computation between
    them has the precision of ``point_data`` and ``moduli``, 64 or 32 bits. p moves by the share ``follow`` towards
    ``rest_ratio`` kappa (v/V - 1); both have the precision of ``moduli``.
    """
    for group in prange(len(local_row)):
        corner_x, block_force = np.zeros(24 * LANES, point_data.dtype), np.zeros(24 * LANES, point_data.dtype)
        shared_forces = np.zeros(12 * LANES, point_data.dtype)
        nodal_x, origin, shift = np.empty((4 * LANES, 3)), np.zeros(3 * LANES), np.empty(3 * LANES)
        corner_row, n_rows = local_row[group], (start[group + 1] - start[group]) // (n_layers + 1)
        force[start[group] : start[group + 1]] = 0.0
        for level in range(n_layers + 1):
            level_row, block = start[group] + level * n_rows, group * n_layers + level - 1
            prefetch_block(point_data, block + 1, 0)
            read_level(x, nodes[level_row : level_row + n_rows], corner_row, nodal_x, origin, shift, corner_x)
            if level > 0:
                prefetch_block(point_data, block + 1, 1)
                _block_forces(corner_x, point_data[block], moduli[block], rest_ratio, follow, block_force, material)
                prefetch_block(point_data, block + 2, 2)
                add_level(block_force, shared_forces, corner_row, force[level_row - n_rows : level_row])
        block_force[:] = 0.0
        add_level(block_force, shared_forces, corner_row, force[start[group + 1] - n_rows : start[group + 1]])


@njit(fastmath=FAST_MATH, error_model="numpy")
def _block_forces(corner_x, point_data, moduli, rest_ratio, follow, force, material):
    """Forces on the corners of the bricks of a block into ``force``, laid out as their positions ``corner_x``."""
    for lane in range(ROW):
        jacobians, data = gauss_point_jacobians(corner_x, lane), data_of_points(point_data, lane)
        mu, kappa, per_volume = read3(moduli, lane)
        pressure = kappa * (brick_volume(corner_x, lane) * per_volume - in_precision_of(mu, 1.0))
        p = moduli[lane + _P_ROW]
        moduli[lane + _P_ROW] = p + follow * (rest_ratio * pressure - p)
        pressure += p
        stresses = _at_points(point_stress, jacobians, data, mu, pressure, material)
        store_corner_values(force, lane, corner_forces(stresses, 0))
        store_corner_values(force, lane + ROW, corner_forces(stresses, 1))
        store_corner_values(force, lane + UINT(2) * ROW, corner_forces(stresses, 2))


@inlined
def _point_state(d, c, mu, pressure, material):
    """Energy, J, a bound on the largest stiffness (without the ``pressure``), and cofactors at one Gauss point."""
    cofactors = tensor3.cofactor(d)
    J = dot(d, cofactors) * c[6]
    y = _inverse_cube_root(max(J, FROZEN_BELOW_J))
    col0, col1, col2 = _times_symmetric(d, c)
    dc = col0 + col1 + col2
    i1 = c[6] * y * y * inner(d, dc)
    i2 = 3.0
    if uses_i2(material):
        i2 = y * y * y * y * tensor3.second_invariant(i1 / (y * y), tensor3.left_cauchy_green(dc, d, c[6]))
    energy = mu * (energy_of(material, i1, i2) + (J - 1.0) * (J - 1.0)) / c[6]
    # |sum_a grad N_a grad N_a^T| is at most 1/3 at a Gauss point of the parent brick; k : k / 3 is the mean of k^2
    bound = stiffness_bound(material, i1, i2) * mu * (4.0 + i1) * (1.0 / 9.0) * inner(cofactors, cofactors) * c[6]
    return energy, J, bound, cofactors


@spelled_out
def _entry(state, i):
    """Entry i at the eight points."""
    return state[0][i], state[1][i], state[2][i], state[3][i], state[4][i], state[5][i], state[6][i], state[7][i]


@spelled_out
def _sum(start_value, terms):
    return start_value + terms[0] + terms[1] + terms[2] + terms[3] + terms[4] + terms[5] + terms[6] + terms[7]


@inlined
def _sum_of_squares(n):
    return n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3] + n[4] * n[4] + n[5] * n[5] + n[6] * n[6] + n[7] * n[7]


@njit(forceinline=True, fastmath=FAST_MATH, error_model="numpy")
def _block_state(corner_x, point_data, moduli, rest_ratio, state, bounds, material):
    """Numbers of the bricks of a block into ``state`` (4 LANES), bounds on their stiffness into ``bounds`` (LANES)."""
    for lane in range(ROW):
        jacobians, data = gauss_point_jacobians(corner_x, lane), data_of_points(point_data, lane)
        mu, kappa, per_volume = read3(moduli, lane)
        volume_ratio = brick_volume(corner_x, lane) * per_volume
        states = _at_points(_point_state, jacobians, data, mu, kappa, material)
        energies, J, stiffness, cofactors = _entry(states, 0), _entry(states, 1), _entry(states, 2), _entry(states, 3)
        dv0, dv1, dv2 = corner_forces(cofactors, 0), corner_forces(cofactors, 1), corner_forces(cofactors, 2)
        dv_squared = _sum_of_squares(dv0) + _sum_of_squares(dv1) + _sum_of_squares(dv2)
        strain, whole_kappa = volume_ratio - 1.0, (1.0 + rest_ratio) * kappa
        state[lane] = _sum(0.0, energies) + 0.5 * whole_kappa * strain * strain / per_volume
        tensor3.write3(state, lane + ROW, (min(J), max(J), volume_ratio))
        bounds[lane] = _sum(CORNER_SCALE**2 * kappa * dv_squared * per_volume, stiffness)


@kernel(parallel=True, fastmath=FAST_MATH)
def element_state(x, nodes, start, local_row, n_layers, point_data, moduli, rest_ratio, state, stiffness, material):
    """Write, per element, energy, smallest J, largest J and v/V into ``state`` (block, 4 LANES); per row, the sum of
    its elements' stiffness bounds into ``stiffness`` (R,). The energy is that of the whole modulus, 1 + ``rest_ratio``
    times kappa; the bounds are those of kappa.

    The bound is close to the largest eigenvalue of the element's stiffness: exact for the pressure of the mean volume
    (rank one, kappa |dv/dx|^2 / V), an estimate for the rest. The sum can be too small by a fifth in strongly deformed
    stiff elements; the safety factor on the mass covers that.
    """
    for group in prange(len(local_row)):
        corner_x, nodal_x, bounds = np.zeros(24 * LANES), np.empty((4 * LANES, 3)), np.empty(LANES)
        origin, shift = np.zeros(3 * LANES), np.empty(3 * LANES)
        corner_row, n_rows = local_row[group], (start[group + 1] - start[group]) // (n_layers + 1)
        stiffness[start[group] : start[group + 1]] = 0.0
        for level in range(n_layers + 1):
            level_row, block = start[group] + level * n_rows, group * n_layers + level - 1
            prefetch_block(point_data, block + 1, 0)
            read_level(x, nodes[level_row : level_row + n_rows], corner_row, nodal_x, origin, shift, corner_x)
            if level > 0:
                prefetch_block(point_data, block + 1, 1)
                prefetch_block(point_data, block + 1, 2)
                _block_state(corner_x, point_data[block], moduli[block], rest_ratio, state[block], bounds, material)
                for i in range(4 * LANES):
                    stiffness[level_row - n_rows + corner_row[i]] += bounds[i % LANES]
                    stiffness[level_row + corner_row[i]] += bounds[i % LANES]


@kernel(parallel=True, fastmath=FAST_MATH)
def grow(point_data, data_0, radial, moduli, stretch, blocks, is_tangential, along_stretch):
    """Compute point data and 1/V of ``blocks`` at growth ``stretch`` (B, LANES) from those at growth 1, ``data_0``.

    Isotropic, G = g I: C = g C0, w = g^3 w0. Tangential, G = g (I - N N) + N N with N the reference thickness
    direction: C = C0 + (g^2 - 1) n n, w = g^2 w0, where ``radial`` (B, 24 LANES) holds n = sqrt(w0) dxi/dX N. With a
    stretch h along the thickness too, ``along_stretch`` (B or 0, LANES), G is h times that with g / h for g.
    """
    for i in prange(len(blocks)):
        grown, ungrown, volume, thickens = point_data[blocks[i]], data_0[i], np.zeros(LANES), len(along_stretch) > 0
        h = along_stretch[i] if thickens else np.ones(LANES)
        g = stretch[i] / h
        for point in range(8):
            row = point * ROWS_PER_POINT * LANES
            if is_tangential:
                n = radial[i, 3 * point * LANES : 3 * (point + 1) * LANES].reshape(3, LANES)
                k = row
                for r in range(3):
                    for s in range(r, 3):
                        for lane in range(LANES):
                            grown[k + lane] = ungrown[k + lane] + (g[lane] * g[lane] - 1.0) * n[r, lane] * n[s, lane]
                        k += LANES
            else:
                for k in range(row, row + 6 * LANES, LANES):
                    for lane in range(LANES):
                        grown[k + lane] = g[lane] * ungrown[k + lane]
            row += 6 * LANES
            for lane in range(LANES):
                det_G = g[lane] * g[lane] * (1.0 if is_tangential else g[lane]) * (h[lane] * h[lane] * h[lane])
                grown[row + lane] = ungrown[row + lane] / det_G
                volume[lane] += det_G / ungrown[row + lane]
            if thickens:
                for k in range(row - 6 * LANES, row, LANES):
                    for lane in range(LANES):
                        grown[k + lane] *= h[lane]
        for lane in range(LANES):
            moduli[blocks[i], 2 * LANES + lane] = 1.0 / volume[lane]
