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
from morphofold.sim.elements.lanes import FAST_MATH, LANES, ROW, UINT, deliver, fetch, inlined
from morphofold.sim.elements.tensor3 import (
    cofactor,
    combination,
    det,
    dot,
    halley_step,
    inner,
    left_cauchy_green,
    less_turned,
    product,
    read3,
    read9,
    refined_inverse_cube_root,
    scaled,
    second_invariant,
    times,
    write3,
    write9,
)
from morphofold.sim.materials import energy_of, slopes_of, stiffness_bound, uses_i2

PATCH_TETS = 6  # most tetrahedra of a patch; a smaller patch repeats its first one, with zero weight
PATCH_NODES = 8  # most nodes of a patch
OWN_GRADIENT_SHARE = 0.5  # share of the volume-preserving energy that depends on each tetrahedron's own gradient
CRUSHED_BELOW_J = 0.03  # volume ratio below which U is continued with tangents

_TINY = 1e-300

_sum = inlined(combination.py_func)


@njit(forceinline=True)
def nodes_to_edges(near, corner, d):
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

    It is nodes_to_edges transposed.
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


@inlined
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.02 < J < 50, without a branch."""
    y = halley_step(J)
    return refined_inverse_cube_root(J, y * halley_step(J * y * y * y))


@inlined
def _elastic_tensor(d, e):
    """A = d e^-1, the cofactors of e, and the grown volume det e / 6."""
    k = cofactor(e)
    six_volumes = dot(e, k)
    a = scaled(1.0 / six_volumes, times(d, k[0::3]) + times(d, k[1::3]) + times(d, k[2::3]))
    return a, k, six_volumes * (1.0 / 6.0)


@inlined
def _isochoric_energy(a, material):
    """Cofactors c of A, J; f, h, s in dU/dA = mu (f A - h b A + s c); u, and i1 times a measure of its stiffness."""
    c = cofactor(a)
    J = dot(a, c)
    clamped = max(J, CRUSHED_BELOW_J)
    y, per = _inverse_cube_root(clamped), 1.0 / clamped
    y *= y
    I1 = inner(a, a)
    phi = y + (2.0 / 3.0) * y * (clamped - J) * per
    i1 = phi * I1
    if uses_i2(material):
        z, I2 = y * y, second_invariant(I1, left_cauchy_green(a, a, 1.0))
        psi = z + (4.0 / 3.0) * z * (clamped - J) * per
        i2 = psi * I2
        u1, u2 = slopes_of(material, i1, i2)
        f, h = 2.0 * (u1 * phi + u2 * psi * I1), 2.0 * u2 * psi
        s = -(2.0 / 3.0) * per * (u1 * y * I1 + 2.0 * u2 * z * I2)
        return c, J, f, h, s, energy_of(material, i1, i2), stiffness_bound(material, i1, i2) * i1
    u1, _ = slopes_of(material, i1, 3.0)
    s = 2.0 * u1 * (-(1.0 / 3.0)) * y * per * I1
    return c, J, 2.0 * u1 * phi, 0.0, s, energy_of(material, i1, 3.0), stiffness_bound(material, i1, 3.0) * i1


@inlined
def _less_b_times(P, h, a, material):
    """P - h b A; P if the material does not depend on the second invariant."""
    return less_turned(P, h, left_cauchy_green(a, a, 1.0), a) if uses_i2(material) else P


@inlined
def _weighted_sum(a, w):
    """Sum of w A over the six tetrahedra."""
    s = combination(1.0, combination(w[0], a[0], w[1], a[1]), w[2], a[2])
    return combination(1.0, combination(1.0, combination(1.0, s, w[3], a[3]), w[4], a[4]), w[5], a[5])


@inlined
def _tet_gradient(q, l, a, k, mean, p, mu, weight, material):
    """Write the gradient by the edges of one tetrahedron into the nine rows from ``l``; weight 1/6 or 0."""
    c, _, f, h, s, _, _ = _isochoric_energy(a, material)
    P = _less_b_times(_sum(weight * mu * f, a, weight * (mu * s + p), c), weight * mu * h, a, material)
    write9(q, l, product(_sum(1.0, P, weight, mean), k))


@inlined
def patch_gradient(d, e, m, q, l, material):
    """Write the gradient of a patch's energy by all edges of its tetrahedra into ``q`` (54 rows)."""
    mu, kappa, count = read3(m, l)
    b, c, g = l + UINT(9) * ROW, l + UINT(18) * ROW, l + UINT(27) * ROW
    h, i = l + UINT(36) * ROW, l + UINT(45) * ROW
    r1, r2, r3 = 1.0 if count > 1.0 else 0.0, 1.0 if count > 2.0 else 0.0, 1.0 if count > 3.0 else 0.0
    r4, r5 = 1.0 if count > 4.0 else 0.0, 1.0 if count > 5.0 else 0.0
    a0, k0, w0 = _elastic_tensor(read9(d, l), read9(e, l))
    a1, k1, w1 = _elastic_tensor(read9(d, b), read9(e, b))
    a2, k2, w2 = _elastic_tensor(read9(d, c), read9(e, c))
    a3, k3, w3 = _elastic_tensor(read9(d, g), read9(e, g))
    a4, k4, w4 = _elastic_tensor(read9(d, h), read9(e, h))
    a5, k5, w5 = _elastic_tensor(read9(d, i), read9(e, i))
    a, w = (a0, a1, a2, a3, a4, a5), (w0, r1 * w1, r2 * w2, r3 * w3, r4 * w4, r5 * w5)
    s = 1.0 / (w[0] + w[1] + w[2] + w[3] + w[4] + w[5])
    v = w[0] * det(a0) + w[1] * det(a1) + w[2] * det(a2) + w[3] * det(a3) + w[4] * det(a4) + w[5] * det(a5)
    p = kappa * (v * s - 1.0)
    am = scaled(s, _weighted_sum(a, w))
    cm, _, fm, hm, sm, _, _ = _isochoric_energy(am, material)
    rest = (1.0 - OWN_GRADIENT_SHARE) * mu
    mean = _less_b_times(_sum(rest * fm, am, rest * sm, cm), rest * hm, am, material)
    sixth = 1.0 / 6.0
    _tet_gradient(q, l, a0, k0, mean, p, OWN_GRADIENT_SHARE * mu, sixth, material)
    _tet_gradient(q, b, a1, k1, mean, p, OWN_GRADIENT_SHARE * mu, r1 * sixth, material)
    _tet_gradient(q, c, a2, k2, mean, p, OWN_GRADIENT_SHARE * mu, r2 * sixth, material)
    _tet_gradient(q, g, a3, k3, mean, p, OWN_GRADIENT_SHARE * mu, r3 * sixth, material)
    _tet_gradient(q, h, a4, k4, mean, p, OWN_GRADIENT_SHARE * mu, r4 * sixth, material)
    _tet_gradient(q, i, a5, k5, mean, p, OWN_GRADIENT_SHARE * mu, r5 * sixth, material)


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_forces(x, nodes, start, local, corner, edges, modulus, force, material):
    """Write forces (minus the energy gradient) of the patches, summed per block and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local: see ``Blocks``, for the eight nodes of each patch; corner (block, 24 LANES) uint8,
    row 4 t + i: which of these nodes is corner i of tetrahedron t; edges (block, 54 LANES), row 9 t + 3 i + r, after
    free growth; modulus (block, 3 LANES): mu, kappa, number of tetrahedra; material: see ``sim.materials``.
    """
    for b in prange(len(local)):
        nodal, near, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, m = edges[b], np.empty(54 * LANES), modulus[b]
        ahead = edges[min(b + 1, len(local) - 1)]
        fetch(x, nodes[start[b] : start[b + 1]], local[b], PATCH_NODES, ahead, nodal, near)
        nodes_to_edges(near, corner[b], d)
        for l in range(ROW):
            patch_gradient(d, e, m, q, l, material)  # into another array than d, else LLVM would not vectorise
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
        nodal, near, n = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(24 * LANES)
        e, own = edges[b], nodes[start[b] : start[b + 1]]
        fetch(X, own, local[b], PATCH_NODES, e, nodal, near)
        fetch(normal, own, local[b], PATCH_NODES, e, nodal, n)
        nodes_to_edges(near, corner[b], e)
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


@inlined
def _length(u):
    return np.sqrt(dot(u, u))


@inlined
def _weighted(r, u, v):
    return r[0] * u[0] * v[0] + r[1] * u[1] * v[1] + r[2] * u[2] * v[2] + r[3] * u[3] * v[3]


@inlined
def _length_at_node(near, l, c):
    """Length of the vector at node c."""
    return _length(read3(near, l + UINT(3 * c) * ROW))


@inlined
def _corner_stiffness(q):
    """Four numbers m_i with sum_i m_i |u_i|^2 >= |sum_i u_i q_i^T|^2, from the volume gradients q at corners 1 to 3.

    m_i = |q_i| |sum_j q_j q_j^T / |q_j||: equal for a single corner, close to equal for a tetrahedron of good shape.
    """
    first = -(q[0] + q[3] + q[6]), -(q[1] + q[4] + q[7]), -(q[2] + q[5] + q[8])
    n0, n1 = _length(first) + _TINY, _length(q) + _TINY
    n2, n3 = _length(q[3:6]) + _TINY, _length(q[6:9]) + _TINY
    r = 1.0 / n0, 1.0 / n1, 1.0 / n2, 1.0 / n3
    x, y, z = (first[0],) + q[0::3], (first[1],) + q[1::3], (first[2],) + q[2::3]
    xx, yy, zz = _weighted(r, x, x), _weighted(r, y, y), _weighted(r, z, z)
    xy, yz, zx = _weighted(r, x, y), _weighted(r, y, z), _weighted(r, z, x)
    m = np.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))
    return m * n0, m * n1, m * n2, m * n3


@inlined
def _measure_tet(d, e, mu, real, material):
    """J, grown volume w, energy, w A, volume gradient by the edges, and a stiffness of one tetrahedron.

    All but J and the last are 0 if ``real`` is 0. The stiffness is that of the volume-preserving energy per square of
    the volume gradient, 2/3 mu i1 / (w J^2) for a neo-Hookean material.
    """
    a, k, w = _elastic_tensor(d, e)
    c, J, _, _, _, energy, stiff = _isochoric_energy(a, material)
    clamped = max(J, CRUSHED_BELOW_J)
    stiffness = (2.0 / 3.0) * mu * stiff / (w * clamped * clamped)
    w *= real
    dv = scaled(real * (1.0 / 6.0), product(c, k))
    return J, w, OWN_GRADIENT_SHARE * mu * w * energy, scaled(w, a), dv, stiffness


@inlined
def _measure_patch(sums, near, m, l, state, bound, material):
    """Write volume ratio and energy of a patch into ``state``, stiffness of its pressure into ``bound``.

    ``sums`` are sums over its tetrahedra, ``near`` holds the volume gradient g at its nodes. The stiffness of the
    pressure has rank one: kappa/V (sum g_c u_c)^2 <= kappa/V (sum |g_b|) sum |g_c| |u_c|^2.
    """
    mu, kappa, V = m[l], m[l + ROW], sums[l]
    p = kappa * (sums[l + ROW] / V - 1.0)
    energy = _isochoric_energy(scaled(1.0 / V, read9(sums, l + UINT(3) * ROW)), material)[5]
    state[l] = sums[l + ROW] / V
    state[l + ROW] = (
        sums[l + UINT(2) * ROW] + (1.0 - OWN_GRADIENT_SHARE) * mu * V * energy + 0.5 * p * (sums[l + ROW] - V)
    )
    n0, n1, n2 = _length_at_node(near, l, 0), _length_at_node(near, l, 1), _length_at_node(near, l, 2)
    n3, n4, n5 = _length_at_node(near, l, 3), _length_at_node(near, l, 4), _length_at_node(near, l, 5)
    n6, n7 = _length_at_node(near, l, 6), _length_at_node(near, l, 7)
    s = kappa / V * (n0 + n1 + n2 + n3 + n4 + n5 + n6 + n7)
    write3(bound, l, (s * n0, s * n1, s * n2))
    write3(bound, l + UINT(3) * ROW, (s * n3, s * n4, s * n5))
    bound[l + UINT(6) * ROW], bound[l + UINT(7) * ROW] = s * n6, s * n7


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_state(x, nodes, start, local, corner, edges, modulus, J, state, stiffness, material):
    """Write J of each tetrahedron (block, 6 LANES); per patch, its volume ratio and energy into ``state`` (block, 2
    LANES); per row, the sum of a bound on the stiffness of its patches into ``stiffness`` (R,).

    The bound is rigorous for the stiffness of the pressure, and close to the largest eigenvalue for that of each
    tetrahedron alone; the contribution of the pressure to the latter is left out. Tests check that the sum is enough.
    """
    for b in prange(len(local)):
        nodal, near, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, m, ratio = edges[b], np.empty(54 * LANES), modulus[b], J[b]
        sums, bound, own = np.zeros(12 * LANES), np.empty(PATCH_NODES * LANES), np.empty(PATCH_TETS * LANES)
        ahead = edges[min(b + 1, len(local) - 1)]
        fetch(x, nodes[start[b] : start[b + 1]], local[b], PATCH_NODES, ahead, nodal, near)
        nodes_to_edges(near, corner[b], d)
        for t in range(UINT(PATCH_TETS)):
            row = UINT(9) * t * ROW
            for l in range(ROW):
                real = 1.0 if m[l + UINT(2) * ROW] > t else 0.0
                tet = _measure_tet(read9(d, row + l), read9(e, row + l), m[l], real, material)
                r, w, energy, wa, dv, stiff = tet
                ratio[t * ROW + l], own[t * ROW + l] = r, stiff
                write9(q, row + l, dv)
                sums[l] += w
                sums[l + ROW] += w * r
                sums[l + UINT(2) * ROW] += energy
                first = l + UINT(3) * ROW
                write9(sums, first, _sum(1.0, read9(sums, first), 1.0, wa))
        _edges_to_nodes(q, corner[b], near)
        for l in range(ROW):
            _measure_patch(sums, near, m, l, state[b], bound, material)
        for t in range(UINT(PATCH_TETS)):
            for l in range(ROW):
                o, s = UINT(9) * t * ROW + l, own[t * ROW + l]
                s0, s1, s2, s3 = _corner_stiffness(read9(q, o))
                # the four values overwrite the gradient from which they are computed
                q[o], q[o + ROW], q[o + UINT(2) * ROW], q[o + UINT(3) * ROW] = s * s0, s * s1, s * s2, s * s3
        for t in range(PATCH_TETS):
            for l in range(LANES):
                for i in range(4):
                    bound[np.int64(corner[b, (4 * t + i) * LANES + l]) * LANES + l] += q[(9 * t + i) * LANES + l]
        rows = stiffness[start[b] : start[b + 1]]
        rows[:] = 0.0
        for i in range(PATCH_NODES * LANES):
            rows[local[b, i]] += bound[i]
