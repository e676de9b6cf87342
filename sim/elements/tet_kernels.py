"""Numba loops of the tetrahedral element: nodal forces, growth and state of patches of linear tetrahedra.

The element is a patch of up to six tetrahedra of one material that share faces. Single linear tetrahedra are too stiff:
they lock if nearly incompressible, and a single one can't follow a shear that varies in space. A patch has one
pressure, from its mean volume ratio. A share 1 - OWN_GRADIENT_SHARE of its volume-preserving energy is that of its mean
gradient. With F the deformation gradient of a tetrahedron, A = F G^-1, J = det A, w its grown volume, V = sum w,
Am = sum w A / V, and U(A) = mu u(phi(J) I1, psi(J) I2), phi = J^-2/3, psi = J^-4/3, I1 and I2 the invariants of A^T A
and u the material's (:mod:`morphofold.sim.materials`),

    W = OWN_GRADIENT_SHARE sum w U(A) + (1 - OWN_GRADIENT_SHARE) V U(Am) + kappa/2 V (sum w J / V - 1)^2.

Only U keeps a single tetrahedron from collapsing while its patch keeps its volume, so U must keep rising: where J <
CRUSHED_BELOW_J, phi and psi are continued by their tangents. If they were constant there, as in bricks, tetrahedra
would snap through to J = 0.

The kernels use the edge vectors of a tetrahedron: ``d`` deformed, ``e`` after free growth, both as matrices whose
columns are three edges from its first corner. So A = d e^-1 and w = det e / 6, and with k the cofactors of e the
gradient of w U with respect to the edges d is dU/dA k / 6.

Patches are stored in blocks of ``LANES`` lanes, arrays as (block, rows * LANES), as in ``brick_kernels``. Positions are
read once per node of a patch and forces summed once per node, so a node gathers from patches, not from tetrahedra. The
map from corners of a tetrahedron to nodes of its patch is read lane by lane, so a patch may have any shape.
"""

import numpy as np
from numba import njit, prange

from morphofold.kernels import kernel
from morphofold.sim.elements.brick_kernels import _cofactor, second_invariant, turned
from morphofold.sim.elements.lanes import _FAST_MATH, _LANES, _UINT, LANES, deliver, fetch
from morphofold.sim.materials import energy_of, slopes_of, stiffness_bound, uses_i2

PATCH_TETS = 6  # most tetrahedra of a patch; a smaller patch repeats its first one, with zero weight
PATCH_NODES = 8  # most nodes of a patch
OWN_GRADIENT_SHARE = 0.5  # share of the volume-preserving energy that depends on each tetrahedron's own gradient
CRUSHED_BELOW_J = 0.03  # volume ratio below which U is continued with tangents

_TINY = 1e-300


@njit(forceinline=True)
def _nodes_to_edges(near, corner, d):
    """Write edge vectors: coordinate r of edge i of tetrahedron t into row 9 t + 3 i + r; node c has rows 3 c + r."""
    for t in range(PATCH_TETS):
        for l in range(LANES):
            o = 3 * LANES * np.int64(corner[4 * t * LANES + l]) + l
            x0, x1, x2 = near[o], near[o + LANES], near[o + 2 * LANES]
            for i in range(3):
                o = 3 * LANES * np.int64(corner[(4 * t + i + 1) * LANES + l]) + l
                row = (9 * t + 3 * i) * LANES + l
                d[row] = near[o] - x0
                d[row + LANES] = near[o + LANES] - x1
                d[row + 2 * LANES] = near[o + 2 * LANES] - x2


@njit(forceinline=True)
def _edges_to_nodes(q, corner, f):
    """Write minus the gradient by the nodes of each patch into ``f``, from that by the edges.

    It is _nodes_to_edges transposed.
    """
    f[:] = 0.0
    for t in range(PATCH_TETS):
        for l in range(LANES):
            s0, s1, s2 = 0.0, 0.0, 0.0
            for i in range(3):
                o = 3 * LANES * np.int64(corner[(4 * t + i + 1) * LANES + l]) + l
                row = (9 * t + 3 * i) * LANES + l
                q0, q1, q2 = q[row], q[row + LANES], q[row + 2 * LANES]
                f[o] -= q0
                f[o + LANES] -= q1
                f[o + 2 * LANES] -= q2
                s0 += q0
                s1 += q1
                s2 += q2
            o = 3 * LANES * np.int64(corner[4 * t * LANES + l]) + l
            f[o] += s0
            f[o + LANES] += s1
            f[o + 2 * LANES] += s2


@njit(forceinline=True, fastmath=_FAST_MATH)
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.02 < J < 50, without a branch: two Halley steps, then three of fourth order."""
    y = (J + 2.0) / (2.0 * J + 1.0)
    r = J * y * y * y
    y *= (r + 2.0) / (2.0 * r + 1.0)
    for _ in range(3):
        e = 1.0 - J * y * y * y
        y += y * e * (1.0 / 3.0 + e * (2.0 / 9.0 + e * (14.0 / 81.0)))
    return y


@njit(forceinline=True, fastmath=_FAST_MATH)
def _det(a):
    return a[0] * (a[4] * a[8] - a[5] * a[7]) + a[1] * (a[5] * a[6] - a[3] * a[8]) + a[2] * (a[3] * a[7] - a[4] * a[6])


@njit(forceinline=True, fastmath=_FAST_MATH)
def _read_matrix(m, l):
    """The 3x3 matrix in the nine rows from ``l``, column by column."""
    return (
        m[l],
        m[l + _LANES],
        m[l + _UINT(2) * _LANES],
        m[l + _UINT(3) * _LANES],
        m[l + _UINT(4) * _LANES],
        m[l + _UINT(5) * _LANES],
        m[l + _UINT(6) * _LANES],
        m[l + _UINT(7) * _LANES],
        m[l + _UINT(8) * _LANES],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _write_matrix(m, l, a):
    """The inverse of :func:`_read_matrix`: write a 3x3 matrix into the nine rows from ``l``."""
    m[l], m[l + _LANES], m[l + _UINT(2) * _LANES] = a[0], a[1], a[2]
    m[l + _UINT(3) * _LANES], m[l + _UINT(4) * _LANES], m[l + _UINT(5) * _LANES] = a[3], a[4], a[5]
    m[l + _UINT(6) * _LANES], m[l + _UINT(7) * _LANES], m[l + _UINT(8) * _LANES] = a[6], a[7], a[8]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _elastic_tensor(d, e):
    """A = d e^-1, the cofactors of e, and the grown volume det e / 6."""
    k = _cofactor(*e)
    det = e[0] * k[0] + e[1] * k[1] + e[2] * k[2]
    s = 1.0 / det
    return (
        (
            (d[0] * k[0] + d[3] * k[3] + d[6] * k[6]) * s,
            (d[1] * k[0] + d[4] * k[3] + d[7] * k[6]) * s,
            (d[2] * k[0] + d[5] * k[3] + d[8] * k[6]) * s,
            (d[0] * k[1] + d[3] * k[4] + d[6] * k[7]) * s,
            (d[1] * k[1] + d[4] * k[4] + d[7] * k[7]) * s,
            (d[2] * k[1] + d[5] * k[4] + d[8] * k[7]) * s,
            (d[0] * k[2] + d[3] * k[5] + d[6] * k[8]) * s,
            (d[1] * k[2] + d[4] * k[5] + d[7] * k[8]) * s,
            (d[2] * k[2] + d[5] * k[5] + d[8] * k[8]) * s,
        ),
        k,
        det * (1.0 / 6.0),
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _left_cauchy_green(a):
    """b = A A^T, six numbers."""
    return (
        a[0] * a[0] + a[3] * a[3] + a[6] * a[6],
        a[0] * a[1] + a[3] * a[4] + a[6] * a[7],
        a[0] * a[2] + a[3] * a[5] + a[6] * a[8],
        a[1] * a[1] + a[4] * a[4] + a[7] * a[7],
        a[1] * a[2] + a[4] * a[5] + a[7] * a[8],
        a[2] * a[2] + a[5] * a[5] + a[8] * a[8],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _isochoric_energy(a, material):
    """Cofactors c of A, J; f, h, s in dU/dA = mu (f A - h b A + s c); u, and i1 times a measure of its stiffness."""
    c = _cofactor(*a)
    J = a[0] * c[0] + a[1] * c[1] + a[2] * c[2]
    held = max(J, CRUSHED_BELOW_J)
    y, per = _inverse_cube_root(held), 1.0 / held
    y *= y
    I1 = (
        a[0] * a[0]
        + a[1] * a[1]
        + a[2] * a[2]
        + a[3] * a[3]
        + a[4] * a[4]
        + a[5] * a[5]
        + a[6] * a[6]
        + a[7] * a[7]
        + a[8] * a[8]
    )
    phi = y + (2.0 / 3.0) * y * (held - J) * per
    i1 = phi * I1
    if uses_i2(material):
        z, I2 = y * y, second_invariant(I1, _left_cauchy_green(a))
        psi = z + (4.0 / 3.0) * z * (held - J) * per
        i2 = psi * I2
        u1, u2 = slopes_of(material, i1, i2)
        f, h = 2.0 * (u1 * phi + u2 * psi * I1), 2.0 * u2 * psi
        s = -(2.0 / 3.0) * per * (u1 * y * I1 + 2.0 * u2 * z * I2)
        return c, J, f, h, s, energy_of(material, i1, i2), stiffness_bound(material, i1, i2) * i1
    u1, _ = slopes_of(material, i1, 3.0)
    return (
        c,
        J,
        2.0 * u1 * phi,
        0.0,
        2.0 * u1 * (-(1.0 / 3.0)) * y * per * I1,
        energy_of(material, i1, 3.0),
        stiffness_bound(material, i1, 3.0) * i1,
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _subtract_second_invariant(P, h, a, material):
    """P - h b A; P if the material does not depend on the second invariant."""
    if uses_i2(material):
        b = _left_cauchy_green(a)
        e, g, i = turned(b, h, a[0:3]), turned(b, h, a[3:6]), turned(b, h, a[6:9])
        return (
            P[0] - e[0],
            P[1] - e[1],
            P[2] - e[2],
            P[3] - g[0],
            P[4] - g[1],
            P[5] - g[2],
            P[6] - i[0],
            P[7] - i[1],
            P[8] - i[2],
        )
    return P


@njit(forceinline=True, fastmath=_FAST_MATH)
def _linear_combination(f, a, s, c):
    """f A + s C."""
    return (
        f * a[0] + s * c[0],
        f * a[1] + s * c[1],
        f * a[2] + s * c[2],
        f * a[3] + s * c[3],
        f * a[4] + s * c[4],
        f * a[5] + s * c[5],
        f * a[6] + s * c[6],
        f * a[7] + s * c[7],
        f * a[8] + s * c[8],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def product(P, k):
    """The matrix P k; both have nine numbers, column by column."""
    return (
        P[0] * k[0] + P[3] * k[1] + P[6] * k[2],
        P[1] * k[0] + P[4] * k[1] + P[7] * k[2],
        P[2] * k[0] + P[5] * k[1] + P[8] * k[2],
        P[0] * k[3] + P[3] * k[4] + P[6] * k[5],
        P[1] * k[3] + P[4] * k[4] + P[7] * k[5],
        P[2] * k[3] + P[5] * k[4] + P[8] * k[5],
        P[0] * k[6] + P[3] * k[7] + P[6] * k[8],
        P[1] * k[6] + P[4] * k[7] + P[7] * k[8],
        P[2] * k[6] + P[5] * k[7] + P[8] * k[8],
    )


@njit(forceinline=True, fastmath=_FAST_MATH)
def _weighted_sum(a, w, i):
    """Entry i of nine of the sum of w A over the six tetrahedra."""
    return w[0] * a[0][i] + w[1] * a[1][i] + w[2] * a[2][i] + w[3] * a[3][i] + w[4] * a[4][i] + w[5] * a[5][i]


@njit(forceinline=True, fastmath=_FAST_MATH)
def _tet_gradient(q, l, a, k, mean, p, mu, weight, material):
    """Write the gradient by the edges of one tetrahedron into the nine rows from ``l``; weight 1/6 or 0."""
    c, _, f, h, s, _, _ = _isochoric_energy(a, material)
    P = _subtract_second_invariant(
        _linear_combination(weight * mu * f, a, weight * (mu * s + p), c), weight * mu * h, a, material
    )
    _write_matrix(q, l, product(_linear_combination(1.0, P, weight, mean), k))


@njit(forceinline=True, fastmath=_FAST_MATH)
def _patch_gradient(d, e, m, q, l, material):
    """Write the gradient of a patch's energy by all edges of its tetrahedra into ``q`` (54 rows)."""
    mu, kappa, count = m[l], m[l + _LANES], m[l + _UINT(2) * _LANES]
    b, c, g, h, i = (
        l + _UINT(9) * _LANES,
        l + _UINT(18) * _LANES,
        l + _UINT(27) * _LANES,
        l + _UINT(36) * _LANES,
        l + _UINT(45) * _LANES,
    )
    r1, r2, r3 = 1.0 if count > 1.0 else 0.0, 1.0 if count > 2.0 else 0.0, 1.0 if count > 3.0 else 0.0
    r4, r5 = 1.0 if count > 4.0 else 0.0, 1.0 if count > 5.0 else 0.0
    a0, k0, w0 = _elastic_tensor(_read_matrix(d, l), _read_matrix(e, l))
    a1, k1, w1 = _elastic_tensor(_read_matrix(d, b), _read_matrix(e, b))
    a2, k2, w2 = _elastic_tensor(_read_matrix(d, c), _read_matrix(e, c))
    a3, k3, w3 = _elastic_tensor(_read_matrix(d, g), _read_matrix(e, g))
    a4, k4, w4 = _elastic_tensor(_read_matrix(d, h), _read_matrix(e, h))
    a5, k5, w5 = _elastic_tensor(_read_matrix(d, i), _read_matrix(e, i))
    a, w = (a0, a1, a2, a3, a4, a5), (w0, r1 * w1, r2 * w2, r3 * w3, r4 * w4, r5 * w5)
    s = 1.0 / (w[0] + w[1] + w[2] + w[3] + w[4] + w[5])
    v = w[0] * _det(a0) + w[1] * _det(a1) + w[2] * _det(a2) + w[3] * _det(a3) + w[4] * _det(a4) + w[5] * _det(a5)
    p = kappa * (v * s - 1.0)
    am = (
        s * _weighted_sum(a, w, 0),
        s * _weighted_sum(a, w, 1),
        s * _weighted_sum(a, w, 2),
        s * _weighted_sum(a, w, 3),
        s * _weighted_sum(a, w, 4),
        s * _weighted_sum(a, w, 5),
        s * _weighted_sum(a, w, 6),
        s * _weighted_sum(a, w, 7),
        s * _weighted_sum(a, w, 8),
    )
    cm, _, fm, hm, sm, _, _ = _isochoric_energy(am, material)
    rest = (1.0 - OWN_GRADIENT_SHARE) * mu
    mean = _subtract_second_invariant(_linear_combination(rest * fm, am, rest * sm, cm), rest * hm, am, material)
    sixth = 1.0 / 6.0
    _tet_gradient(q, l, a0, k0, mean, p, OWN_GRADIENT_SHARE * mu, sixth, material)
    _tet_gradient(q, b, a1, k1, mean, p, OWN_GRADIENT_SHARE * mu, r1 * sixth, material)
    _tet_gradient(q, c, a2, k2, mean, p, OWN_GRADIENT_SHARE * mu, r2 * sixth, material)
    _tet_gradient(q, g, a3, k3, mean, p, OWN_GRADIENT_SHARE * mu, r3 * sixth, material)
    _tet_gradient(q, h, a4, k4, mean, p, OWN_GRADIENT_SHARE * mu, r4 * sixth, material)
    _tet_gradient(q, i, a5, k5, mean, p, OWN_GRADIENT_SHARE * mu, r5 * sixth, material)


@kernel(parallel=True, fastmath=_FAST_MATH)
def patch_forces(x, nodes, start, local, corner, edges, modulus, force, material):
    """Write forces (minus the energy gradient) of the patches, summed per block and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local: see ``Blocks``, for the eight nodes of each patch; corner (block, 24 LANES) uint8,
    row 4 t + i: which of these nodes is corner i of tetrahedron t; edges (block, 54 LANES), row 9 t + 3 i + r, after
    free growth; modulus (block, 3 LANES): mu, kappa, number of tetrahedra; material: see ``sim.materials``.
    """
    for b in prange(len(local)):
        at, near, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, m = edges[b], np.empty(54 * LANES), modulus[b]
        ahead = edges[min(b + 1, len(local) - 1)]
        fetch(x, nodes[start[b] : start[b + 1]], local[b], PATCH_NODES, ahead, at, near)
        _nodes_to_edges(near, corner[b], d)
        for l in range(_LANES):
            _patch_gradient(
                d, e, m, q, l, material
            )  # into a separate array: if d were reused, LLVM would not vectorise
        _edges_to_nodes(q, corner[b], near)
        rows = force[start[b] : start[b + 1]]
        rows[:] = 0.0
        deliver(near, local[b], PATCH_NODES, rows)


@kernel(parallel=True)
def grow_edges(X, normal, nodes, start, local, corner, across, along, edges):
    """Compute the edges of the leading blocks after free growth: G (X_i - X_0), from reference positions X (N, 3).

    G = across (I - N N) + along N N, with N the normalised mean of ``normal`` (N, 3) at the corners of a tetrahedron;
    across and along (block, 6 LANES).
    """
    for b in prange(len(across)):
        at, near, n = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(24 * LANES)
        e, mine = edges[b], nodes[start[b] : start[b + 1]]
        fetch(X, mine, local[b], PATCH_NODES, e, at, near)
        fetch(normal, mine, local[b], PATCH_NODES, e, at, n)
        _nodes_to_edges(near, corner[b], e)
        for t in range(PATCH_TETS):
            for l in range(LANES):
                g, s, row = across[b, t * LANES + l], along[b, t * LANES + l], 9 * t * LANES + l
                for o in range(row, row + 9 * LANES, LANES):
                    e[o] *= g
                if s == g:
                    continue
                n0, n1, n2 = 0.0, 0.0, 0.0
                for i in range(4):
                    o = 3 * LANES * np.int64(corner[b, (4 * t + i) * LANES + l]) + l
                    n0, n1, n2 = n0 + n[o], n1 + n[o + LANES], n2 + n[o + 2 * LANES]
                s = (s / g - 1.0) / (n0 * n0 + n1 * n1 + n2 * n2)
                for o in range(row, row + 9 * LANES, 3 * LANES):
                    c = s * (n0 * e[o] + n1 * e[o + LANES] + n2 * e[o + 2 * LANES])
                    e[o] += c * n0
                    e[o + LANES] += c * n1
                    e[o + 2 * LANES] += c * n2


@njit(forceinline=True, fastmath=_FAST_MATH)
def _norm(a, b, c):
    return np.sqrt(a * a + b * b + c * c)


@njit(forceinline=True, fastmath=_FAST_MATH)
def _length_at_node(near, l, c):
    """Length of the vector at node c."""
    o = l + _UINT(3 * c) * _LANES
    return _norm(near[o], near[o + _LANES], near[o + _UINT(2) * _LANES])


@njit(forceinline=True, fastmath=_FAST_MATH)
def _corner_stiffness(q):
    """Four numbers m_i with sum_i m_i |u_i|^2 >= |sum_i u_i q_i^T|^2, from the volume gradients q at corners 1 to 3.

    m_i = |q_i| |sum_j q_j q_j^T / |q_j||: equal for a single corner, close to equal for a tetrahedron of good shape.
    """
    z0, z1, z2 = -(q[0] + q[3] + q[6]), -(q[1] + q[4] + q[7]), -(q[2] + q[5] + q[8])
    n0, n1 = _norm(z0, z1, z2) + _TINY, _norm(q[0], q[1], q[2]) + _TINY
    n2, n3 = _norm(q[3], q[4], q[5]) + _TINY, _norm(q[6], q[7], q[8]) + _TINY
    r0, r1, r2, r3 = 1.0 / n0, 1.0 / n1, 1.0 / n2, 1.0 / n3
    xx = r0 * z0 * z0 + r1 * q[0] * q[0] + r2 * q[3] * q[3] + r3 * q[6] * q[6]
    yy = r0 * z1 * z1 + r1 * q[1] * q[1] + r2 * q[4] * q[4] + r3 * q[7] * q[7]
    zz = r0 * z2 * z2 + r1 * q[2] * q[2] + r2 * q[5] * q[5] + r3 * q[8] * q[8]
    xy = r0 * z0 * z1 + r1 * q[0] * q[1] + r2 * q[3] * q[4] + r3 * q[6] * q[7]
    yz = r0 * z1 * z2 + r1 * q[1] * q[2] + r2 * q[4] * q[5] + r3 * q[7] * q[8]
    zx = r0 * z2 * z0 + r1 * q[2] * q[0] + r2 * q[5] * q[3] + r3 * q[8] * q[6]
    m = np.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))
    return m * n0, m * n1, m * n2, m * n3


@njit(forceinline=True, fastmath=_FAST_MATH)
def _measure_tet(d, e, mu, real, material):
    """J, grown volume w, energy, w A, volume gradient by the edges, and a stiffness of one tetrahedron.

    All but J and the last are 0 if ``real`` is 0. The stiffness is that of the volume-preserving energy per square of
    the volume gradient, 2/3 mu i1 / (w J^2) for a neo-Hookean material.
    """
    a, k, w = _elastic_tensor(d, e)
    c, J, _, _, _, energy, stiff = _isochoric_energy(a, material)
    held = max(J, CRUSHED_BELOW_J)
    stiffness = (2.0 / 3.0) * mu * stiff / (w * held * held)
    w *= real
    dv = _linear_combination(real * (1.0 / 6.0), product(c, k), 0.0, k)
    return J, w, OWN_GRADIENT_SHARE * mu * w * energy, _linear_combination(w, a, 0.0, c), dv, stiffness


@njit(forceinline=True, fastmath=_FAST_MATH)
def _measure_patch(sums, near, m, l, state, bound, material):
    """Write volume ratio and energy of a patch into ``state``, stiffness of its pressure into ``bound``.

    ``sums`` are sums over its tetrahedra, ``near`` holds the volume gradient g at its nodes. The stiffness of the
    pressure has rank one: kappa/V (sum g_c u_c)^2 <= kappa/V (sum |g_b|) sum |g_c| |u_c|^2.
    """
    mu, kappa, V = m[l], m[l + _LANES], sums[l]
    p = kappa * (sums[l + _LANES] / V - 1.0)
    am = _read_matrix(sums, l + _UINT(3) * _LANES)
    energy = _isochoric_energy(_linear_combination(1.0 / V, am, 0.0, am), material)[5]
    state[l] = sums[l + _LANES] / V
    state[l + _LANES] = (
        sums[l + _UINT(2) * _LANES] + (1.0 - OWN_GRADIENT_SHARE) * mu * V * energy + 0.5 * p * (sums[l + _LANES] - V)
    )
    n0, n1, n2, n3 = (
        _length_at_node(near, l, 0),
        _length_at_node(near, l, 1),
        _length_at_node(near, l, 2),
        _length_at_node(near, l, 3),
    )
    n4, n5, n6, n7 = (
        _length_at_node(near, l, 4),
        _length_at_node(near, l, 5),
        _length_at_node(near, l, 6),
        _length_at_node(near, l, 7),
    )
    s = kappa / V * (n0 + n1 + n2 + n3 + n4 + n5 + n6 + n7)
    bound[l], bound[l + _LANES], bound[l + _UINT(2) * _LANES], bound[l + _UINT(3) * _LANES] = (
        s * n0,
        s * n1,
        s * n2,
        s * n3,
    )
    bound[l + _UINT(4) * _LANES], bound[l + _UINT(5) * _LANES] = s * n4, s * n5
    bound[l + _UINT(6) * _LANES], bound[l + _UINT(7) * _LANES] = s * n6, s * n7


@kernel(parallel=True, fastmath=_FAST_MATH)
def patch_state(x, nodes, start, local, corner, edges, modulus, J, state, stiffness, material):
    """Write J of each tetrahedron (block, 6 LANES); per patch, its volume ratio and energy into ``state`` (block, 2
    LANES); per row, the sum of a bound on the stiffness of its patches into ``stiffness`` (R,).

    The bound is rigorous for the stiffness of the pressure, and close to the largest eigenvalue for that of each
    tetrahedron alone; the contribution of the pressure to the latter is left out. Tests check that the sum is enough.
    """
    for b in prange(len(local)):
        at, near, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, m, ratio = edges[b], np.empty(54 * LANES), modulus[b], J[b]
        sums, bound, own = np.zeros(12 * LANES), np.empty(PATCH_NODES * LANES), np.empty(PATCH_TETS * LANES)
        ahead = edges[min(b + 1, len(local) - 1)]
        fetch(x, nodes[start[b] : start[b + 1]], local[b], PATCH_NODES, ahead, at, near)
        _nodes_to_edges(near, corner[b], d)
        for t in range(_UINT(PATCH_TETS)):
            row = _UINT(9) * t * _LANES
            for l in range(_LANES):
                r, w, energy, wa, dv, stiff = _measure_tet(
                    _read_matrix(d, row + l),
                    _read_matrix(e, row + l),
                    m[l],
                    1.0 if m[l + _UINT(2) * _LANES] > t else 0.0,
                    material,
                )
                ratio[t * _LANES + l], own[t * _LANES + l] = r, stiff
                _write_matrix(q, row + l, dv)
                sums[l] += w
                sums[l + _LANES] += w * r
                sums[l + _UINT(2) * _LANES] += energy
                _write_matrix(
                    sums,
                    l + _UINT(3) * _LANES,
                    _linear_combination(1.0, _read_matrix(sums, l + _UINT(3) * _LANES), 1.0, wa),
                )
        _edges_to_nodes(q, corner[b], near)
        for l in range(_LANES):
            _measure_patch(sums, near, m, l, state[b], bound, material)
        for t in range(_UINT(PATCH_TETS)):
            for l in range(_LANES):
                o, s = _UINT(9) * t * _LANES + l, own[t * _LANES + l]
                s0, s1, s2, s3 = _corner_stiffness(_read_matrix(q, o))
                # the four values overwrite the gradient from which they are computed
                q[o], q[o + _LANES], q[o + _UINT(2) * _LANES], q[o + _UINT(3) * _LANES] = s * s0, s * s1, s * s2, s * s3
        for t in range(PATCH_TETS):
            for l in range(LANES):
                for i in range(4):
                    bound[np.int64(corner[b, (4 * t + i) * LANES + l]) * LANES + l] += q[(9 * t + i) * LANES + l]
        mine = stiffness[start[b] : start[b + 1]]
        mine[:] = 0.0
        for i in range(PATCH_NODES * LANES):
            mine[local[b, i]] += bound[i]
