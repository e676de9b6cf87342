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

Elements are stored in lanes (:mod:`morphofold.sim.elements.lanes`), in columns of blocks from the pial surface down:
``blocks.Columns`` connects them with the nodes.
"""

import numpy as np
from numba import njit, prange

from morphofold.kernels import kernel
from morphofold.sim.elements.lanes import (
    _FAST_MATH,
    _LANES,
    _UINT,
    CORNER_SCALE,
    LANES,
    add_level,
    prefetch,
    read_level,
)
from morphofold.sim.materials import energy_of, slopes_of, stiffness_bound, uses_i2

ROWS_PER_POINT = 7  # rows per Gauss point: C00 C01 C02 C11 C12 C22 1/w
FROZEN_BELOW_J = 0.1  # below this volume ratio the factors J^-2/3, J^-4/3 are constant, so that they stay finite

_GAUSS_COORDINATE = 1.0 / np.sqrt(3.0)  # Gauss points along an edge are at minus and plus this


@njit(forceinline=True)
def _in_precision_of(like, number):
    """A constant in the precision of ``like``; a constant in 64 bits would widen all results."""
    return type(like)(number)


@njit(forceinline=True, fastmath=_FAST_MATH)
def _face_gauss_values(p, q, r, s):
    """Four times the values at the 2x2 Gauss points of a face, from its corners 00, 01, 10, 11. It is symmetric."""
    R = _in_precision_of(p, _GAUSS_COORDINATE)
    a, b, c, d = p + q, p - q, r + s, r - s
    p0, p1, r0, r1 = a + R * b, a - R * b, c + R * d, c - R * d
    a, b, c, d = p0 + r0, p0 - r0, p1 + r1, p1 - r1
    return a + R * b, c + R * d, a - R * b, c - R * d


@njit(forceinline=True, fastmath=_FAST_MATH)
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.1 < J < 8, without a branch: one Halley step, then steps of fourth order, three in 64
    bits and two in 32 (where the error is 1e-6 beyond J = 6).
    """
    one, two = _in_precision_of(J, 1.0), _in_precision_of(J, 2.0)
    y = (J + two) / (two * J + one)
    for _ in range(2 if one + _in_precision_of(J, 1e-12) == one else 3):
        e = one - J * y * y * y
        y += (
            y
            * e
            * (
                _in_precision_of(J, 1.0 / 3.0)
                + e * (_in_precision_of(J, 2.0 / 9.0) + e * _in_precision_of(J, 14.0 / 81.0))
            )
        )
    return y


@njit(forceinline=True, fastmath=_FAST_MATH)
def _cofactor(a0, a1, a2, b0, b1, b2, c0, c1, c2):
    """Cofactors of the matrix with columns a, b, c: the columns b x c, c x a, a x b."""
    return (
        b1 * c2 - b2 * c1,
        b2 * c0 - b0 * c2,
        b0 * c1 - b1 * c0,
        c1 * a2 - c2 * a1,
        c2 * a0 - c0 * a2,
        c0 * a1 - c1 * a0,
        a1 * b2 - a2 * b1,
        a2 * b0 - a0 * b2,
        a0 * b1 - a1 * b0,
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _det(a, b, c):
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


@njit(forceinline=True, fastmath=_FAST_MATH)
def _times_symmetric(d, c):
    """The three columns of D C for symmetric C."""
    return (
        (
            d[0] * c[0] + d[3] * c[1] + d[6] * c[2],
            d[1] * c[0] + d[4] * c[1] + d[7] * c[2],
            d[2] * c[0] + d[5] * c[1] + d[8] * c[2],
        ),
        (
            d[0] * c[1] + d[3] * c[3] + d[6] * c[4],
            d[1] * c[1] + d[4] * c[3] + d[7] * c[4],
            d[2] * c[1] + d[5] * c[3] + d[8] * c[4],
        ),
        (
            d[0] * c[2] + d[3] * c[4] + d[6] * c[5],
            d[1] * c[2] + d[4] * c[4] + d[7] * c[5],
            d[2] * c[2] + d[5] * c[4] + d[8] * c[5],
        ),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _left_cauchy_green(d, u, v, z, per_w):
    """b = A A^T = D C D^T / w, six numbers, from the columns u, v, z of D C."""
    return (
        per_w * (u[0] * d[0] + v[0] * d[3] + z[0] * d[6]),
        per_w * (u[0] * d[1] + v[0] * d[4] + z[0] * d[7]),
        per_w * (u[0] * d[2] + v[0] * d[5] + z[0] * d[8]),
        per_w * (u[1] * d[1] + v[1] * d[4] + z[1] * d[7]),
        per_w * (u[1] * d[2] + v[1] * d[5] + z[1] * d[8]),
        per_w * (u[2] * d[2] + v[2] * d[5] + z[2] * d[8]),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def second_invariant(I1, b):
    """I2 = (I1^2 - tr(b b)) / 2 for symmetric b, six numbers."""
    two = _in_precision_of(I1, 2.0)
    bb = b[0] * b[0] + b[3] * b[3] + b[5] * b[5] + two * (b[1] * b[1] + b[2] * b[2] + b[4] * b[4])
    return _in_precision_of(I1, 0.5) * (I1 * I1 - bb)


@njit(forceinline=True, fastmath=_FAST_MATH)
def turned(b, h, u):
    """h b u for symmetric b, six numbers, and a vector u."""
    return (
        h * (b[0] * u[0] + b[1] * u[1] + b[2] * u[2]),
        h * (b[1] * u[0] + b[3] * u[1] + b[4] * u[2]),
        h * (b[2] * u[0] + b[4] * u[1] + b[5] * u[2]),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _point_stress(d, c, mu, p, material):
    """dW/dD at one Gauss point, nine numbers; ``p`` is the element's pressure kappa (v/V - 1)."""
    k = _cofactor(*d)
    J = (d[0] * k[0] + d[1] * k[1] + d[2] * k[2]) * c[6]
    least = _in_precision_of(J, FROZEN_BELOW_J)
    y = _inverse_cube_root(max(J, least))
    u, v, z = _times_symmetric(d, c)
    I1 = (
        d[0] * u[0]
        + d[1] * u[1]
        + d[2] * u[2]
        + d[3] * v[0]
        + d[4] * v[1]
        + d[5] * v[2]
        + d[6] * z[0]
        + d[7] * z[1]
        + d[8] * z[2]
    ) * c[6]
    two, third = _in_precision_of(J, 2.0), _in_precision_of(J, 1.0 / 3.0)
    if uses_i2(material):
        b = _left_cauchy_green(d, u, v, z, c[6])
        I2 = second_invariant(I1, b)
        u1, u2 = slopes_of(material, y * y * I1, y * y * y * y * I2)
        f1, h = two * _in_precision_of(J, u1) * mu * y * y, two * _in_precision_of(J, u2) * mu * y * y * y * y
        s = p + two * mu * (J - _in_precision_of(J, 1.0))
        s -= (f1 * I1 + two * h * I2) * y * y * y * third if J > least else _in_precision_of(J, 0.0)
        f = f1 + h * I1
        e, g, i = turned(b, h, u), turned(b, h, v), turned(b, h, z)
        return (
            f * u[0] + s * k[0] - e[0],
            f * u[1] + s * k[1] - e[1],
            f * u[2] + s * k[2] - e[2],
            f * v[0] + s * k[3] - g[0],
            f * v[1] + s * k[4] - g[1],
            f * v[2] + s * k[5] - g[2],
            f * z[0] + s * k[6] - i[0],
            f * z[1] + s * k[7] - i[1],
            f * z[2] + s * k[8] - i[2],
        )
    u1, _ = slopes_of(material, y * y * I1, _in_precision_of(J, 3.0))
    f = two * _in_precision_of(J, u1) * mu * y * y
    s = (
        p
        + two * mu * (J - _in_precision_of(J, 1.0))
        - (f * I1 * y * y * y * third if J > least else _in_precision_of(J, 0.0))
    )
    return (
        f * u[0] + s * k[0],
        f * u[1] + s * k[1],
        f * u[2] + s * k[2],
        f * v[0] + s * k[3],
        f * v[1] + s * k[4],
        f * v[2] + s * k[5],
        f * z[0] + s * k[6],
        f * z[1] + s * k[7],
        f * z[2] + s * k[8],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _natural_derivatives(x, l):
    """dx_r/dxi at the Gauss points for the first coordinate r in ``x`` (in eighths), in three groups of four.

    Along i at (j, k), along j at (i, k), along k at (i, j). Row 3 c of ``x`` belongs to corner c = 4 i + 2 j + k.
    """
    n0, n1, n2, n3 = x[l], x[l + _UINT(3) * _LANES], x[l + _UINT(6) * _LANES], x[l + _UINT(9) * _LANES]
    n4, n5, n6, n7 = (
        x[l + _UINT(12) * _LANES],
        x[l + _UINT(15) * _LANES],
        x[l + _UINT(18) * _LANES],
        x[l + _UINT(21) * _LANES],
    )
    return (
        _face_gauss_values(n4 - n0, n5 - n1, n6 - n2, n7 - n3),
        _face_gauss_values(n2 - n0, n3 - n1, n6 - n4, n7 - n5),
        _face_gauss_values(n1 - n0, n3 - n2, n5 - n4, n7 - n6),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _gauss_point_jacobians(xs, l):
    """D at the eight Gauss points p = 4 i + 2 j + k, nine numbers each, column by column."""
    (a0, a1, a2, a3), (b0, b1, b2, b3), (c0, c1, c2, c3) = _natural_derivatives(xs, l)
    (d0, d1, d2, d3), (e0, e1, e2, e3), (f0, f1, f2, f3) = _natural_derivatives(xs, l + _LANES)
    (g0, g1, g2, g3), (h0, h1, h2, h3), (i0, i1, i2, i3) = _natural_derivatives(xs, l + _UINT(2) * _LANES)
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


@njit(forceinline=True, fastmath=_FAST_MATH)
def _gauss_point_data(g, l):
    """C (six numbers) and 1/w of the Gauss point with rows that start at ``l``."""
    return (
        g[l],
        g[l + _LANES],
        g[l + _UINT(2) * _LANES],
        g[l + _UINT(3) * _LANES],
        g[l + _UINT(4) * _LANES],
        g[l + _UINT(5) * _LANES],
        g[l + _UINT(6) * _LANES],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _data_of_all_points(g, l):
    """The data of the eight Gauss points of lane ``l``."""
    return (
        _gauss_point_data(g, l),
        _gauss_point_data(g, l + _UINT(7) * _LANES),
        _gauss_point_data(g, l + _UINT(14) * _LANES),
        _gauss_point_data(g, l + _UINT(21) * _LANES),
        _gauss_point_data(g, l + _UINT(28) * _LANES),
        _gauss_point_data(g, l + _UINT(35) * _LANES),
        _gauss_point_data(g, l + _UINT(42) * _LANES),
        _gauss_point_data(g, l + _UINT(49) * _LANES),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _corner_position(xs, l, c):
    l += _UINT(3 * c) * _LANES
    return xs[l], xs[l + _LANES], xs[l + _UINT(2) * _LANES]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _brick_volume(xs, l):
    """Volume v of the trilinear brick from its corners in eighths: by three determinants (Grandy 1997), not eight."""
    x0, x7 = _corner_position(xs, l, 0), _corner_position(xs, l, 7)
    a, b = _minus(x7, _corner_position(xs, l, 2)), _minus(_corner_position(xs, l, 5), x0)
    c, d = _minus(x7, _corner_position(xs, l, 1)), _minus(_corner_position(xs, l, 3), x0)
    e, f = _minus(_corner_position(xs, l, 6), x0), _minus(x7, _corner_position(xs, l, 4))
    return _in_precision_of(x0[0], 512.0 / 12.0) * (
        _det(_plus(a, b), c, d) + _det(b, _plus(c, e), f) + _det(a, e, _plus(f, d))
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _corner_forces(q, r):
    """Minus the gradient by coordinate r of the corners in eighths, from dW/dD at the points.

    It is _natural_derivatives transposed.
    """
    a, b, c = r, 3 + r, 6 + r
    s0, s1, s2, s3 = _face_gauss_values(q[0][a] + q[4][a], q[1][a] + q[5][a], q[2][a] + q[6][a], q[3][a] + q[7][a])
    t0, t1, t2, t3 = _face_gauss_values(q[0][b] + q[2][b], q[1][b] + q[3][b], q[4][b] + q[6][b], q[5][b] + q[7][b])
    u0, u1, u2, u3 = _face_gauss_values(q[0][c] + q[1][c], q[2][c] + q[3][c], q[4][c] + q[5][c], q[6][c] + q[7][c])
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


@njit(forceinline=True, fastmath=_FAST_MATH)
def _store_corner_values(f, l, n):
    """Write the eight corner values of one coordinate into every third row from ``l``."""
    for c in range(8):
        f[l + _UINT(3) * _UINT(c) * _LANES] = _in_precision_of(n[c], CORNER_SCALE) * n[c]


@njit(forceinline=True)
def prefetch_block(data, b, part):
    """Prefetch one of three parts, 0 to 2, of the data of block ``b``: at once, they would wait for each other."""
    ahead = data[min(b, len(data) - 1)]
    third = len(ahead) // 3
    for i in range(part * third, (part + 1) * third, 64 // data.itemsize):  # a cache line holds 64 bytes
        prefetch(ahead, i)


@kernel(parallel=True, fastmath=_FAST_MATH)
def element_forces(x, nodes, start, local, layers, point, modulus, force, material):
    """Write forces (minus the energy gradient) of the bricks, summed per column and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local, layers: see ``Columns``; point (block, 56 LANES); modulus (block, 3 LANES): mu,
    kappa, 1/V; material: see ``sim.materials``. Positions and sums have 64 bits; the computation between them has the
    precision of ``point`` and ``modulus``, 64 or 32 bits.
    """
    for g in prange(len(local)):
        xs, f, held = (
            np.zeros(24 * LANES, point.dtype),
            np.zeros(24 * LANES, point.dtype),
            np.zeros(12 * LANES, point.dtype),
        )
        at, origin, moved = np.empty((4 * LANES, 3)), np.zeros(3 * LANES), np.empty(3 * LANES)
        mine, width = local[g], (start[g + 1] - start[g]) // (layers + 1)
        force[start[g] : start[g + 1]] = 0.0
        for k in range(layers + 1):
            level, b = start[g] + k * width, g * layers + k - 1
            prefetch_block(point, b + 1, 0)
            read_level(x, nodes[level : level + width], mine, at, origin, moved, xs)
            if k > 0:
                prefetch_block(point, b + 1, 1)
                _block_forces(xs, point[b], modulus[b], f, material)
                prefetch_block(point, b + 2, 2)
                add_level(f, held, mine, force[level - width : level])
        f[:] = 0.0
        add_level(f, held, mine, force[start[g + 1] - width : start[g + 1]])


@njit(fastmath=_FAST_MATH, error_model="numpy")
def _block_forces(xs, g, m, f, material):
    """Forces on the corners of the bricks of a block into ``f``, laid out as their positions ``xs``."""
    for l in range(_LANES):
        d, c, mu = _gauss_point_jacobians(xs, l), _data_of_all_points(g, l), m[l]
        p = m[l + _LANES] * (_brick_volume(xs, l) * m[l + _UINT(2) * _LANES] - _in_precision_of(mu, 1.0))
        q = (
            _point_stress(d[0], c[0], mu, p, material),
            _point_stress(d[1], c[1], mu, p, material),
            _point_stress(d[2], c[2], mu, p, material),
            _point_stress(d[3], c[3], mu, p, material),
            _point_stress(d[4], c[4], mu, p, material),
            _point_stress(d[5], c[5], mu, p, material),
            _point_stress(d[6], c[6], mu, p, material),
            _point_stress(d[7], c[7], mu, p, material),
        )
        _store_corner_values(f, l, _corner_forces(q, 0))
        _store_corner_values(f, l + _LANES, _corner_forces(q, 1))
        _store_corner_values(f, l + _UINT(2) * _LANES, _corner_forces(q, 2))


@njit(forceinline=True, fastmath=_FAST_MATH)
def _point_state(d, c, mu, material):
    """Energy, J, and a bound on the largest stiffness at one Gauss point (without the element's pressure)."""
    k = _cofactor(*d)
    J = (d[0] * k[0] + d[1] * k[1] + d[2] * k[2]) * c[6]
    y = _inverse_cube_root(max(J, FROZEN_BELOW_J))
    u, v, z = _times_symmetric(d, c)
    i1 = (
        c[6]
        * y
        * y
        * (
            d[0] * u[0]
            + d[1] * u[1]
            + d[2] * u[2]
            + d[3] * v[0]
            + d[4] * v[1]
            + d[5] * v[2]
            + d[6] * z[0]
            + d[7] * z[1]
            + d[8] * z[2]
        )
    )
    i2 = 3.0
    if uses_i2(material):
        i2 = y * y * y * y * second_invariant(i1 / (y * y), _left_cauchy_green(d, u, v, z, c[6]))
    energy = mu * (energy_of(material, i1, i2) + (J - 1.0) * (J - 1.0)) / c[6]
    cc = (
        k[0] * k[0]
        + k[1] * k[1]
        + k[2] * k[2]
        + k[3] * k[3]
        + k[4] * k[4]
        + k[5] * k[5]
        + k[6] * k[6]
        + k[7] * k[7]
        + k[8] * k[8]
    )
    # |sum_a grad N_a grad N_a^T| is at most 1/3 at a Gauss point of the parent brick; cc / 3: the mean square cofactor
    return energy, J, stiffness_bound(material, i1, i2) * mu * (4.0 + i1) * (1.0 / 9.0) * cc * c[6]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _sum_of_squares(n):
    return n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3] + n[4] * n[4] + n[5] * n[5] + n[6] * n[6] + n[7] * n[7]


@njit(forceinline=True, fastmath=_FAST_MATH, error_model="numpy")
def _block_state(xs, g, m, out, bound, material):
    """Numbers of the bricks of a block into ``out`` (4 LANES), bounds on their stiffness into ``bound`` (LANES)."""
    for l in range(_LANES):
        d, c, mu, kappa = _gauss_point_jacobians(xs, l), _data_of_all_points(g, l), m[l], m[l + _LANES]
        per_volume = m[l + _UINT(2) * _LANES]
        ratio = _brick_volume(xs, l) * per_volume
        s = (
            _point_state(d[0], c[0], mu, material),
            _point_state(d[1], c[1], mu, material),
            _point_state(d[2], c[2], mu, material),
            _point_state(d[3], c[3], mu, material),
            _point_state(d[4], c[4], mu, material),
            _point_state(d[5], c[5], mu, material),
            _point_state(d[6], c[6], mu, material),
            _point_state(d[7], c[7], mu, material),
        )
        q = (
            _cofactor(*d[0]),
            _cofactor(*d[1]),
            _cofactor(*d[2]),
            _cofactor(*d[3]),
            _cofactor(*d[4]),
            _cofactor(*d[5]),
            _cofactor(*d[6]),
            _cofactor(*d[7]),
        )
        dv = (
            _sum_of_squares(_corner_forces(q, 0))
            + _sum_of_squares(_corner_forces(q, 1))
            + _sum_of_squares(_corner_forces(q, 2))
        )
        out[l] = (
            s[0][0]
            + s[1][0]
            + s[2][0]
            + s[3][0]
            + s[4][0]
            + s[5][0]
            + s[6][0]
            + s[7][0]
            + 0.5 * kappa * (ratio - 1.0) * (ratio - 1.0) / per_volume
        )
        out[l + _LANES] = min(s[0][1], s[1][1], s[2][1], s[3][1], s[4][1], s[5][1], s[6][1], s[7][1])
        out[l + _UINT(2) * _LANES] = max(s[0][1], s[1][1], s[2][1], s[3][1], s[4][1], s[5][1], s[6][1], s[7][1])
        out[l + _UINT(3) * _LANES] = ratio
        bound[l] = (
            CORNER_SCALE**2 * kappa * dv * per_volume
            + s[0][2]
            + s[1][2]
            + s[2][2]
            + s[3][2]
            + s[4][2]
            + s[5][2]
            + s[6][2]
            + s[7][2]
        )


@kernel(parallel=True, fastmath=_FAST_MATH)
def element_state(x, nodes, start, local, layers, point, modulus, state, stiffness, material):
    """Write, per element, energy, smallest J, largest J and v/V into ``state`` (block, 4 LANES); per row, the sum of
    its elements' stiffness bounds into ``stiffness`` (R,).

    The bound is close to the largest eigenvalue of the element's stiffness: exact for the pressure of the mean volume
    (rank one, kappa |dv/dx|^2 / V), an estimate for the rest. The sum can be too small by a fifth in strongly deformed
    stiff elements; the safety factor on the mass covers that.
    """
    for g in prange(len(local)):
        xs, at, origin, moved = np.zeros(24 * LANES), np.empty((4 * LANES, 3)), np.zeros(3 * LANES), np.empty(3 * LANES)
        bound = np.empty(LANES)
        mine, width = local[g], (start[g + 1] - start[g]) // (layers + 1)
        stiffness[start[g] : start[g + 1]] = 0.0
        for k in range(layers + 1):
            level, b = start[g] + k * width, g * layers + k - 1
            prefetch_block(point, b + 1, 0)
            read_level(x, nodes[level : level + width], mine, at, origin, moved, xs)
            if k > 0:
                prefetch_block(point, b + 1, 1)
                prefetch_block(point, b + 1, 2)
                _block_state(xs, point[b], modulus[b], state[b], bound, material)
                for i in range(4 * LANES):
                    stiffness[level - width + mine[i]] += bound[i % LANES]
                    stiffness[level + mine[i]] += bound[i % LANES]


@kernel(parallel=True, fastmath=_FAST_MATH)
def grow(point, point0, radial, modulus, stretch, blocks, tangential, thickness):
    """Compute point data and 1/V of ``blocks`` at growth ``stretch`` (B, LANES) from those at growth 1, ``point0``.

    Isotropic, G = g I: C = g C0, w = g^3 w0. Tangential, G = g (I - N N) + N N with N the reference thickness
    direction: C = C0 + (g^2 - 1) n n, w = g^2 w0, where ``radial`` (B, 24 LANES) holds n = sqrt(w0) dxi/dX N. With a
    stretch h along the thickness too, ``thickness`` (B, LANES) or (0, LANES), G is h times that with g / h for g.
    """
    for i in prange(len(blocks)):
        out, start, volume, thickens = point[blocks[i]], point0[i], np.zeros(LANES), len(thickness) > 0
        h = thickness[i] if thickens else np.ones(LANES)
        g = stretch[i] / h
        for q in range(8):
            row = q * ROWS_PER_POINT * LANES
            if tangential:
                n = radial[i, 3 * q * LANES : 3 * (q + 1) * LANES].reshape(3, LANES)
                k = row
                for r in range(3):
                    for s in range(r, 3):
                        for l in range(LANES):
                            out[k + l] = start[k + l] + (g[l] * g[l] - 1.0) * n[r, l] * n[s, l]
                        k += LANES
            else:
                for k in range(row, row + 6 * LANES, LANES):
                    for l in range(LANES):
                        out[k + l] = g[l] * start[k + l]
            row += 6 * LANES
            for l in range(LANES):
                det = g[l] * g[l] * (1.0 if tangential else g[l]) * (h[l] * h[l] * h[l])
                out[row + l] = start[row + l] / det
                volume[l] += det / start[row + l]
            if thickens:
                for k in range(row - 6 * LANES, row, LANES):
                    for l in range(LANES):
                        out[k + l] *= h[l]
        for l in range(LANES):
            modulus[blocks[i], 2 * LANES + l] = 1.0 / volume[l]
