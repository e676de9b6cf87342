"""Numba loops of the hexahedral Q1P0 element: nodal forces, growth, stiffness bound, and the explicit step.

The element is the eight-node brick with 2x2x2 Gauss points, the pressure taken from the mean volume ratio of
the element, and a weak local volumetric term: with A = F G^-1, J = det A, and w the grown volume of a point,

    W = sum_q w_q [ mu/2 (J^-2/3 tr(A^T A) - 3) + mu (J - 1)^2 ] + kappa/2 V (v/V - 1)^2,   V = sum w, v = sum w J.

Everything is written in the parent coordinates of the brick, [-1, 1]^3. With D = dx/dxi and
C = dxi/dX G^-1 G^-T (dxi/dX)^T one has tr(A^T A) = D : D C and J = det D / w, so a point needs only the six numbers of
C and w, and growth of any kind is a change of these seven. The derivative with respect to D is
w mu J^-2/3 D C + s cof D.

Elements lie in blocks of ``WIDTH`` lanes, arrays as (block, rows * WIDTH) with the lane running fastest, so that
each loop over lanes becomes vector instructions (unsigned indices and constant row offsets: otherwise LLVM can't
rule out overlap and stays scalar, six times slower). Forces are stored per element and gathered per node in a
fixed order, so that results are bitwise the same for any number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

WIDTH = 32              # lanes per block
POINT = 7               # rows per Gauss point: C00 C01 C02 C11 C12 C22 w
J_MIN = 0.1             # below this volume ratio the isochoric factor J^-2/3 is frozen, so that it stays finite

_FAST = {"contract", "nsz", "arcp", "nnan", "ninf"}
_U = np.uint64
_W = np.uint64(WIDTH)
_A = 0.5 - 0.5 / np.sqrt(3.0)   # shape functions of an edge at its Gauss points
_B = 0.5 + 0.5 / np.sqrt(3.0)


@njit(forceinline=True, fastmath=_FAST)
def _between(p, q, r, s):
    """Half the values at the 2x2 Gauss points of a face, from its corners 00, 01, 10, 11. Its own transpose."""
    p0, p1 = _B * p + _A * q, _A * p + _B * q
    r0, r1 = _B * r + _A * s, _A * r + _B * s
    return (0.5 * (_B * p0 + _A * r0), 0.5 * (_B * p1 + _A * r1),
            0.5 * (_A * p0 + _B * r0), 0.5 * (_A * p1 + _B * r1))  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.03 < J < 30, without a branch: two Halley steps, then four of Newton."""
    y = (J + 2.0) / (2.0 * J + 1.0)
    r = J * y * y * y
    y *= (r + 2.0) / (2.0 * r + 1.0)
    for _ in range(4):
        y *= (4.0 - J * y * y * y) * (1.0 / 3.0)
    return y


@njit(forceinline=True, fastmath=_FAST)
def _cofactor(a0, a1, a2, b0, b1, b2, c0, c1, c2):
    """Cofactors of the matrix with columns a, b, c: the columns b x c, c x a, a x b."""
    return (b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0,
            c1 * a2 - c2 * a1, c2 * a0 - c0 * a2, c0 * a1 - c1 * a0,
            a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0)  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _det(a0, a1, a2, b0, b1, b2, c0, c1, c2):
    return a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)


@njit(forceinline=True, fastmath=_FAST)
def _times(d, c):
    """The three columns of D C for symmetric C."""
    return ((d[0] * c[0] + d[3] * c[1] + d[6] * c[2], d[1] * c[0] + d[4] * c[1] + d[7] * c[2],
             d[2] * c[0] + d[5] * c[1] + d[8] * c[2]),
            (d[0] * c[1] + d[3] * c[3] + d[6] * c[4], d[1] * c[1] + d[4] * c[3] + d[7] * c[4],
             d[2] * c[1] + d[5] * c[3] + d[8] * c[4]),
            (d[0] * c[2] + d[3] * c[4] + d[6] * c[5], d[1] * c[2] + d[4] * c[4] + d[7] * c[5],
             d[2] * c[2] + d[5] * c[4] + d[8] * c[5]))  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _point(d, c, mu, p):
    """dW/dD of one Gauss point, nine numbers; ``p`` is the element's pressure kappa (v/V - 1)."""
    k = _cofactor(*d)
    w = c[6]
    J = (d[0] * k[0] + d[1] * k[1] + d[2] * k[2]) / w
    held = max(J, J_MIN)
    y = _inverse_cube_root(held)
    u, v, z = _times(d, c)
    I1 = (d[0] * u[0] + d[1] * u[1] + d[2] * u[2] + d[3] * v[0] + d[4] * v[1] + d[5] * v[2]
          + d[6] * z[0] + d[7] * z[1] + d[8] * z[2])  # fmt: skip
    iso = mu * y * y
    f = iso * w
    s = p + 2.0 * mu * (J - 1.0) - (iso * I1 / (3.0 * held) if J > J_MIN else 0.0)
    return (f * u[0] + s * k[0], f * u[1] + s * k[1], f * u[2] + s * k[2],
            f * v[0] + s * k[3], f * v[1] + s * k[4], f * v[2] + s * k[5],
            f * z[0] + s * k[6], f * z[1] + s * k[7], f * z[2] + s * k[8])  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _edges(x, l):
    """dx_r/dxi at the Gauss points for the coordinate r that ``x`` starts with, in three groups of four.

    Along i at (j, k), along j at (i, k), along k at (i, j). Row 3 c of ``x`` belongs to corner c = 4 i + 2 j + k.
    """
    n0, n1, n2, n3 = x[l], x[l + _U(3) * _W], x[l + _U(6) * _W], x[l + _U(9) * _W]
    n4, n5, n6, n7 = x[l + _U(12) * _W], x[l + _U(15) * _W], x[l + _U(18) * _W], x[l + _U(21) * _W]
    return (_between(n4 - n0, n5 - n1, n6 - n2, n7 - n3),
            _between(n2 - n0, n3 - n1, n6 - n4, n7 - n5),
            _between(n1 - n0, n3 - n2, n5 - n4, n7 - n6))  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _gauss(xs, l):
    """D at the eight Gauss points p = 4 i + 2 j + k, nine numbers each, column by column."""
    (a0, a1, a2, a3), (b0, b1, b2, b3), (c0, c1, c2, c3) = _edges(xs, l)
    (d0, d1, d2, d3), (e0, e1, e2, e3), (f0, f1, f2, f3) = _edges(xs, l + _W)
    (g0, g1, g2, g3), (h0, h1, h2, h3), (i0, i1, i2, i3) = _edges(xs, l + _U(2) * _W)
    return ((a0, d0, g0, b0, e0, h0, c0, f0, i0), (a1, d1, g1, b1, e1, h1, c0, f0, i0),
            (a2, d2, g2, b0, e0, h0, c1, f1, i1), (a3, d3, g3, b1, e1, h1, c1, f1, i1),
            (a0, d0, g0, b2, e2, h2, c2, f2, i2), (a1, d1, g1, b3, e3, h3, c2, f2, i2),
            (a2, d2, g2, b2, e2, h2, c3, f3, i3), (a3, d3, g3, b3, e3, h3, c3, f3, i3))  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _seven(g, l):
    """C (six numbers) and w of the Gauss point whose rows start at ``l``."""
    return (g[l], g[l + _W], g[l + _U(2) * _W], g[l + _U(3) * _W], g[l + _U(4) * _W], g[l + _U(5) * _W],
            g[l + _U(6) * _W])  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _points(g, l):
    """The data of the eight Gauss points of lane ``l``."""
    return (_seven(g, l), _seven(g, l + _U(7) * _W), _seven(g, l + _U(14) * _W), _seven(g, l + _U(21) * _W),
            _seven(g, l + _U(28) * _W), _seven(g, l + _U(35) * _W), _seven(g, l + _U(42) * _W),
            _seven(g, l + _U(49) * _W))  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _volume_ratio(d, c):
    """Grown volume V, and volume ratio v/V, of an element."""
    v = (_det(*d[0]) + _det(*d[1]) + _det(*d[2]) + _det(*d[3])
         + _det(*d[4]) + _det(*d[5]) + _det(*d[6]) + _det(*d[7]))  # fmt: skip
    V = c[0][6] + c[1][6] + c[2][6] + c[3][6] + c[4][6] + c[5][6] + c[6][6] + c[7][6]
    return V, v / V


@njit(forceinline=True, fastmath=_FAST)
def _corners(q, r):
    """Minus the gradient for coordinate r of the corners, from dW/dD of the eight points: _edges transposed."""
    a, b, c = r, 3 + r, 6 + r
    s0, s1, s2, s3 = _between(q[0][a] + q[4][a], q[1][a] + q[5][a], q[2][a] + q[6][a], q[3][a] + q[7][a])
    t0, t1, t2, t3 = _between(q[0][b] + q[2][b], q[1][b] + q[3][b], q[4][b] + q[6][b], q[5][b] + q[7][b])
    u0, u1, u2, u3 = _between(q[0][c] + q[1][c], q[2][c] + q[3][c], q[4][c] + q[5][c], q[6][c] + q[7][c])
    return (s0 + t0 + u0, s1 + t1 - u0, s2 - t0 + u1, s3 - t1 - u1,
            t2 - s0 + u2, t3 - s1 - u2, u3 - s2 - t2, -s3 - t3 - u3)  # fmt: skip


@njit(forceinline=True, fastmath=_FAST)
def _store(f, l, n):
    """The eight corner values of one coordinate into every third row from ``l``."""
    f[l], f[l + _U(3) * _W], f[l + _U(6) * _W], f[l + _U(9) * _W] = n[0], n[1], n[2], n[3]
    f[l + _U(12) * _W], f[l + _U(15) * _W], f[l + _U(18) * _W], f[l + _U(21) * _W] = n[4], n[5], n[6], n[7]


@njit(forceinline=True)
def _fetch(x, conn, xs):
    """Corner positions of a block: coordinate r of corner c into row 3 c + r."""
    for c in range(8):
        for l in range(WIDTH):
            n = conn[c * WIDTH + l]
            for r in range(3):
                xs[(3 * c + r) * WIDTH + l] = x[n, r]


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def element_forces(x, conn, point, modulus, force):
    """Nodal forces (minus the energy gradient) of every element into ``force`` (block, 24 WIDTH), row 3 c + r.

    x (N, 3); conn (block, 8 WIDTH) int32; point (block, 56 WIDTH); modulus (block, 2 WIDTH): mu, kappa.
    """
    for b in prange(len(conn)):
        xs, g, m, f = np.empty(24 * WIDTH), np.empty(56 * WIDTH), modulus[b], force[b]
        _fetch(x, conn[b], xs)
        g[:] = point[b]                     # one stream into the cache; read row by row, memory is half as fast
        for l in range(_W):
            d, c, mu = _gauss(xs, l), _points(g, l), m[l]
            ratio = _volume_ratio(d, c)[1]
            p = m[l + _W] * (ratio - 1.0)
            q = (_point(d[0], c[0], mu, p), _point(d[1], c[1], mu, p), _point(d[2], c[2], mu, p),
                 _point(d[3], c[3], mu, p), _point(d[4], c[4], mu, p), _point(d[5], c[5], mu, p),
                 _point(d[6], c[6], mu, p), _point(d[7], c[7], mu, p))  # fmt: skip
            _store(f, l, _corners(q, 0))
            _store(f, l + _W, _corners(q, 1))
            _store(f, l + _U(2) * _W, _corners(q, 2))


@njit(forceinline=True, fastmath=_FAST)
def _point_state(d, c, mu):
    """Energy, J, and a bound on the largest stiffness of one Gauss point (without the element's pressure)."""
    k = _cofactor(*d)
    w = c[6]
    J = (d[0] * k[0] + d[1] * k[1] + d[2] * k[2]) / w
    y = _inverse_cube_root(max(J, J_MIN))
    u, v, z = _times(d, c)
    I1 = y * y * (d[0] * u[0] + d[1] * u[1] + d[2] * u[2] + d[3] * v[0] + d[4] * v[1] + d[5] * v[2]
                  + d[6] * z[0] + d[7] * z[1] + d[8] * z[2])  # fmt: skip
    energy = w * mu * (0.5 * (I1 - 3.0) + (J - 1.0) * (J - 1.0))
    cc = (k[0] * k[0] + k[1] * k[1] + k[2] * k[2] + k[3] * k[3] + k[4] * k[4] + k[5] * k[5]
          + k[6] * k[6] + k[7] * k[7] + k[8] * k[8])  # fmt: skip
    # |sum_a grad N_a grad N_a^T| is at most 1/3 at a Gauss point of the parent brick; cc / 3: the mean square cofactor
    return energy, J, mu * (4.0 + I1) * (1.0 / 9.0) * cc / w


@njit(forceinline=True, fastmath=_FAST)
def _square(n):
    return (n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3]
            + n[4] * n[4] + n[5] * n[5] + n[6] * n[6] + n[7] * n[7])  # fmt: skip


@njit(parallel=True, cache=True, fastmath=_FAST, error_model="numpy")
def element_state(x, conn, point, modulus, state):
    """Per element into ``state`` (block, 5 WIDTH): energy, smallest J, largest J, v/V, stiffness bound.

    The bound is near the largest eigenvalue of the element's stiffness: exact for the pressure of the mean volume
    (rank one, kappa |dv/dx|^2 / V), an estimate for the rest. Together it can fall short by a fifth in strongly
    deformed stiff elements; the safety factor on the mass covers that.
    """
    for b in prange(len(conn)):
        xs, g, m, out = np.empty(24 * WIDTH), np.empty(56 * WIDTH), modulus[b], state[b]
        _fetch(x, conn[b], xs)
        g[:] = point[b]
        for l in range(_W):
            d, c, mu, kappa = _gauss(xs, l), _points(g, l), m[l], m[l + _W]
            V, ratio = _volume_ratio(d, c)
            s = (_point_state(d[0], c[0], mu), _point_state(d[1], c[1], mu), _point_state(d[2], c[2], mu),
                 _point_state(d[3], c[3], mu), _point_state(d[4], c[4], mu), _point_state(d[5], c[5], mu),
                 _point_state(d[6], c[6], mu), _point_state(d[7], c[7], mu))  # fmt: skip
            q = (_cofactor(*d[0]), _cofactor(*d[1]), _cofactor(*d[2]), _cofactor(*d[3]),
                 _cofactor(*d[4]), _cofactor(*d[5]), _cofactor(*d[6]), _cofactor(*d[7]))  # fmt: skip
            dv = _square(_corners(q, 0)) + _square(_corners(q, 1)) + _square(_corners(q, 2))
            out[l] = (s[0][0] + s[1][0] + s[2][0] + s[3][0] + s[4][0] + s[5][0] + s[6][0] + s[7][0]
                      + 0.5 * kappa * V * (ratio - 1.0) * (ratio - 1.0))  # fmt: skip
            out[l + _W] = min(s[0][1], s[1][1], s[2][1], s[3][1], s[4][1], s[5][1], s[6][1], s[7][1])
            out[l + _U(2) * _W] = max(s[0][1], s[1][1], s[2][1], s[3][1], s[4][1], s[5][1], s[6][1], s[7][1])
            out[l + _U(3) * _W] = ratio
            out[l + _U(4) * _W] = (kappa * dv / V + s[0][2] + s[1][2] + s[2][2] + s[3][2]
                                   + s[4][2] + s[5][2] + s[6][2] + s[7][2])  # fmt: skip


@njit(parallel=True, cache=True, fastmath=_FAST)
def grow(point, point0, radial, stretch, tangential):
    """Grown point data of the leading blocks: C and w at growth ``stretch`` (block, WIDTH) from those at growth 1.

    Isotropic, G = g I: C = C0 / g^2, w = g^3 w0. Tangential, G = g (I - N N) + N N with N the reference radial
    direction: C = C0 / g^2 + (1 - 1/g^2) n n, w = g^2 w0, where ``radial`` (block, 24 WIDTH) holds n = dxi/dX N.
    """
    for b in prange(len(stretch)):
        for l in range(WIDTH):
            g = stretch[b, l]
            s = 1.0 / (g * g)
            t = 1.0 - s if tangential else 0.0
            det = g * g if tangential else g * g * g
            for q in range(8):
                row = q * POINT * WIDTH + l
                n = 3 * q * WIDTH + l
                n0, n1, n2 = radial[b, n], radial[b, n + WIDTH], radial[b, n + 2 * WIDTH]
                nn = (n0 * n0, n0 * n1, n0 * n2, n1 * n1, n1 * n2, n2 * n2)
                for k in range(6):
                    point[b, row + k * WIDTH] = s * point0[b, row + k * WIDTH] + t * nn[k]
                point[b, row + 6 * WIDTH] = det * point0[b, row + 6 * WIDTH]


@njit(forceinline=True)
def _gather(force, first, slots, n):
    """Sum of the element forces at node n, in the fixed order of its slots."""
    f0, f1, f2 = 0.0, 0.0, 0.0
    for k in range(first[n], first[n + 1]):
        s = slots[k]
        f0 += force[s]
        f1 += force[s + WIDTH]
        f2 += force[s + 2 * WIDTH]
    return f0, f1, f2


@njit(parallel=True, cache=True)
def gather(force, first, slots, out):
    """Nodal sums (N, 3) of element forces; ``force`` is flat, node n owns ``slots[first[n]:first[n + 1]]``."""
    for n in prange(len(out)):
        out[n, 0], out[n, 1], out[n, 2] = _gather(force, first, slots, n)


@njit(parallel=True, cache=True)
def gather_scalar(values, first, slots, out):
    """Nodal sums (N,) of one value per element; ``slots`` are positions in the flat ``values``."""
    for n in prange(len(out)):
        total = 0.0
        for k in range(first[n], first[n + 1]):
            total += values[slots[k]]
        out[n] = total


@njit(parallel=True, cache=True)
def advance(x, v, force, first, slots, rest, extra, mass, free, keep):
    """One step of unit length: v <- keep v + f/m on the free coordinates, x <- x + v.

    ``rest`` (N, 3) is the round-off of the kernel in the reference state, subtracted so that a body that does not
    grow stays bitwise at rest; ``extra`` (S, 3) are the surface forces of effects on the first S nodes; ``free``
    (N, 3) is 1 or 0.
    """
    for n in prange(len(x)):
        f = _gather(force, first, slots, n)
        for r in range(3):
            total = f[r] - rest[n, r]
            if n < len(extra):
                total += extra[n, r]
            v[n, r] = free[n, r] * (keep * v[n, r] + total / mass[n])
            x[n, r] += v[n, r]


@njit(parallel=True, cache=True)
def sparse_rows(start, column, value, x, out):
    """out = B x for the CSR matrix (start, column, value) and x (n, 3), one thread per row."""
    for i in prange(len(out)):
        s0, s1, s2 = 0.0, 0.0, 0.0
        for k in range(start[i], start[i + 1]):
            j, b = column[k], value[k]
            s0 += b * x[j, 0]
            s1 += b * x[j, 1]
            s2 += b * x[j, 2]
        out[i, 0], out[i, 1], out[i, 2] = s0, s1, s2
