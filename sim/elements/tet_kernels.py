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
    for tet in range(PATCH_TETS):
        for l in range(LANES):
            offset = 3 * LANES * np.int64(corner[4 * tet * LANES + l]) + l
            x0, x1, x2 = near[offset], near[offset + LANES], near[offset + 2 * LANES]
            for i in range(3):
                offset = 3 * LANES * np.int64(corner[(4 * tet + i + 1) * LANES + l]) + l
                row = (9 * tet + 3 * i) * LANES + l
                d[row] = near[offset] - x0
                d[row + LANES] = near[offset + LANES] - x1
                d[row + 2 * LANES] = near[offset + 2 * LANES] - x2


@njit(forceinline=True)
def _edges_to_nodes(q, corner, f):
    """Write minus the gradient by the nodes of each patch into ``f``, from that by the edges.

    It is nodes_to_edges transposed.
    """
    f[:] = 0.0
    for tet in range(PATCH_TETS):
        for l in range(LANES):
            s0, s1, s2 = 0.0, 0.0, 0.0
            for i in range(3):
                offset = 3 * LANES * np.int64(corner[(4 * tet + i + 1) * LANES + l]) + l
                row = (9 * tet + 3 * i) * LANES + l
                q0, q1, q2 = q[row], q[row + LANES], q[row + 2 * LANES]
                f[offset] -= q0
                f[offset + LANES] -= q1
                f[offset + 2 * LANES] -= q2
                s0 += q0
                s1 += q1
                s2 += q2
            offset = 3 * LANES * np.int64(corner[4 * tet * LANES + l]) + l
            f[offset] += s0
            f[offset + LANES] += s1
            f[offset + 2 * LANES] += s2


@inlined
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.02 < J < 50, without a branch."""
    y = halley_step(J)
    return refined_inverse_cube_root(J, y * halley_step(J * y * y * y))


@inlined
def _elastic_tensor(d, e):
    """A = d e^-1, the cofactors of e, and the grown volume det e / 6."""
    cofactors = cofactor(e)
    six_volumes = dot(e, cofactors)
    a = scaled(1.0 / six_volumes, times(d, cofactors[0::3]) + times(d, cofactors[1::3]) + times(d, cofactors[2::3]))
    return a, cofactors, six_volumes * (1.0 / 6.0)


@inlined
def _isochoric_energy(a, material):
    """Cofactors c of A, J; f, h, s in dU/dA = mu (f A - h b A + s c); u, and i1 times a measure of its stiffness."""
    c = cofactor(a)
    J = dot(a, c)
    clamped_J = max(J, CRUSHED_BELOW_J)
    y, per_J = _inverse_cube_root(clamped_J), 1.0 / clamped_J
    y *= y
    I1 = inner(a, a)
    phi = y + (2.0 / 3.0) * y * (clamped_J - J) * per_J
    i1 = phi * I1
    if uses_i2(material):
        z, I2 = y * y, second_invariant(I1, left_cauchy_green(a, a, 1.0))
        psi = z + (4.0 / 3.0) * z * (clamped_J - J) * per_J
        i2 = psi * I2
        u1, u2 = slopes_of(material, i1, i2)
        f, h = 2.0 * (u1 * phi + u2 * psi * I1), 2.0 * u2 * psi
        s = -(2.0 / 3.0) * per_J * (u1 * y * I1 + 2.0 * u2 * z * I2)
        return c, J, f, h, s, energy_of(material, i1, i2), stiffness_bound(material, i1, i2) * i1
    u1, _ = slopes_of(material, i1, 3.0)
    s = 2.0 * u1 * (-(1.0 / 3.0)) * y * per_J * I1
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
def _tet_gradient(q, l, a, cofactors, mean_gradient, p, mu, weight, material):
    """Write the gradient by the edges of one tetrahedron into the nine rows from ``l``; weight 1/6 or 0."""
    c, _, f, h, s, _, _ = _isochoric_energy(a, material)
    P = _less_b_times(_sum(weight * mu * f, a, weight * (mu * s + p), c), weight * mu * h, a, material)
    write9(q, l, product(_sum(1.0, P, weight, mean_gradient), cofactors))


@inlined
def patch_gradient(d, e, m, q, l, material):
    """Write the gradient of a patch's energy by all edges of its tetrahedra into ``q`` (54 rows)."""
    mu, kappa, n_tets = read3(m, l)
    b, c, g = l + UINT(9) * ROW, l + UINT(18) * ROW, l + UINT(27) * ROW
    h, i = l + UINT(36) * ROW, l + UINT(45) * ROW
    r1, r2, r3 = 1.0 if n_tets > 1.0 else 0.0, 1.0 if n_tets > 2.0 else 0.0, 1.0 if n_tets > 3.0 else 0.0
    r4, r5 = 1.0 if n_tets > 4.0 else 0.0, 1.0 if n_tets > 5.0 else 0.0
    a0, k0, w0 = _elastic_tensor(read9(d, l), read9(e, l))
    a1, k1, w1 = _elastic_tensor(read9(d, b), read9(e, b))
    a2, k2, w2 = _elastic_tensor(read9(d, c), read9(e, c))
    a3, k3, w3 = _elastic_tensor(read9(d, g), read9(e, g))
    a4, k4, w4 = _elastic_tensor(read9(d, h), read9(e, h))
    a5, k5, w5 = _elastic_tensor(read9(d, i), read9(e, i))
    a, w = (a0, a1, a2, a3, a4, a5), (w0, r1 * w1, r2 * w2, r3 * w3, r4 * w4, r5 * w5)
    per_volume = 1.0 / (w[0] + w[1] + w[2] + w[3] + w[4] + w[5])
    volume = w[0] * det(a0) + w[1] * det(a1) + w[2] * det(a2) + w[3] * det(a3) + w[4] * det(a4) + w[5] * det(a5)
    pressure = kappa * (volume * per_volume - 1.0)
    am = scaled(per_volume, _weighted_sum(a, w))
    cm, _, fm, hm, sm, _, _ = _isochoric_energy(am, material)
    modulus = (1.0 - OWN_GRADIENT_SHARE) * mu
    mean_gradient = _less_b_times(_sum(modulus * fm, am, modulus * sm, cm), modulus * hm, am, material)
    sixth = 1.0 / 6.0
    _tet_gradient(q, l, a0, k0, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, sixth, material)
    _tet_gradient(q, b, a1, k1, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, r1 * sixth, material)
    _tet_gradient(q, c, a2, k2, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, r2 * sixth, material)
    _tet_gradient(q, g, a3, k3, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, r3 * sixth, material)
    _tet_gradient(q, h, a4, k4, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, r4 * sixth, material)
    _tet_gradient(q, i, a5, k5, mean_gradient, pressure, OWN_GRADIENT_SHARE * mu, r5 * sixth, material)


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_forces(x, nodes, start, local, corner, edges, modulus, force, material):
    """Write forces (minus the energy gradient) of the patches, summed per block and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local: see ``Blocks``, for the eight nodes of each patch; corner (block, 24 LANES) uint8,
    row 4 t + i: which of these nodes is corner i of tetrahedron t; edges (block, 54 LANES), row 9 t + 3 i + r, after
    free growth; modulus (block, 3 LANES): mu, kappa, number of tetrahedra; material: see ``sim.materials``.
    """
    for block in prange(len(local)):
        nodal_x, patch_nodal, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, moduli = edges[block], np.empty(54 * LANES), modulus[block]
        next_edges = edges[min(block + 1, len(local) - 1)]
        fetch(x, nodes[start[block] : start[block + 1]], local[block], PATCH_NODES, next_edges, nodal_x, patch_nodal)
        nodes_to_edges(patch_nodal, corner[block], d)
        for l in range(ROW):
            patch_gradient(d, e, moduli, q, l, material)  # into another array than d, else LLVM would not vectorise
        _edges_to_nodes(q, corner[block], patch_nodal)
        block_force = force[start[block] : start[block + 1]]
        block_force[:] = 0.0
        deliver(patch_nodal, local[block], PATCH_NODES, block_force)


@kernel(parallel=True)
def grow_edges(X, normal, nodes, start, local, corner, across, along, edges):
    """Compute the edges of the leading blocks after free growth: G (X_i - X_0), from reference positions X (N, 3).

    G = across (I - N N) + along N N, with N the normalised mean of ``normal`` (N, 3) at the corners of a tetrahedron;
    across and along (block, 6 LANES).
    """
    for block in prange(len(across)):
        nodal_x, patch_x, normals = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(24 * LANES)
        e, block_nodes = edges[block], nodes[start[block] : start[block + 1]]
        fetch(X, block_nodes, local[block], PATCH_NODES, e, nodal_x, patch_x)
        fetch(normal, block_nodes, local[block], PATCH_NODES, e, nodal_x, normals)
        nodes_to_edges(patch_x, corner[block], e)
        for tet in range(PATCH_TETS):
            for l in range(LANES):
                g, h, row = across[block, tet * LANES + l], along[block, tet * LANES + l], 9 * tet * LANES + l
                for offset in range(row, row + 9 * LANES, LANES):
                    e[offset] *= g
                if h == g:
                    continue
                n0, n1, n2 = 0.0, 0.0, 0.0
                for i in range(4):
                    offset = 3 * LANES * np.int64(corner[block, (4 * tet + i) * LANES + l]) + l
                    n0, n1, n2 = n0 + normals[offset], n1 + normals[offset + LANES], n2 + normals[offset + 2 * LANES]
                h = (h / g - 1.0) / (n0 * n0 + n1 * n1 + n2 * n2)
                for offset in range(row, row + 9 * LANES, 3 * LANES):
                    projection = h * (n0 * e[offset] + n1 * e[offset + LANES] + n2 * e[offset + 2 * LANES])
                    e[offset] += projection * n0
                    e[offset + LANES] += projection * n1
                    e[offset + 2 * LANES] += projection * n2


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
    first_gradient = -(q[0] + q[3] + q[6]), -(q[1] + q[4] + q[7]), -(q[2] + q[5] + q[8])
    n0, n1 = _length(first_gradient) + _TINY, _length(q) + _TINY
    n2, n3 = _length(q[3:6]) + _TINY, _length(q[6:9]) + _TINY
    per_length = 1.0 / n0, 1.0 / n1, 1.0 / n2, 1.0 / n3
    x, y, z = (first_gradient[0],) + q[0::3], (first_gradient[1],) + q[1::3], (first_gradient[2],) + q[2::3]
    xx, yy, zz = _weighted(per_length, x, x), _weighted(per_length, y, y), _weighted(per_length, z, z)
    xy, yz, zx = _weighted(per_length, x, y), _weighted(per_length, y, z), _weighted(per_length, z, x)
    tensor_norm = np.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))
    return tensor_norm * n0, tensor_norm * n1, tensor_norm * n2, tensor_norm * n3


@inlined
def _measure_tet(d, e, mu, real, material):
    """J, grown volume w, energy, w A, volume gradient by the edges, and a stiffness of one tetrahedron.

    All but J and the last are 0 if ``real`` is 0. The stiffness is that of the volume-preserving energy per square of
    the volume gradient, 2/3 mu i1 / (w J^2) for a neo-Hookean material.
    """
    a, cofactors, w = _elastic_tensor(d, e)
    c, J, _, _, _, energy, energy_stiffness = _isochoric_energy(a, material)
    clamped_J = max(J, CRUSHED_BELOW_J)
    stiffness = (2.0 / 3.0) * mu * energy_stiffness / (w * clamped_J * clamped_J)
    w *= real
    volume_gradient = scaled(real * (1.0 / 6.0), product(c, cofactors))
    return J, w, OWN_GRADIENT_SHARE * mu * w * energy, scaled(w, a), volume_gradient, stiffness


@inlined
def _measure_patch(sums, gradient, moduli, l, state, bound, material):
    """Write volume ratio and energy of a patch into ``state``, stiffness of its pressure into ``bound``.

    ``sums`` are sums over its tetrahedra, ``gradient`` holds the volume gradient g at its nodes. The stiffness of the
    pressure has rank one: kappa/V (sum g_c u_c)^2 <= kappa/V (sum |g_b|) sum |g_c| |u_c|^2.
    """
    mu, kappa, V = moduli[l], moduli[l + ROW], sums[l]
    pressure = kappa * (sums[l + ROW] / V - 1.0)
    energy = _isochoric_energy(scaled(1.0 / V, read9(sums, l + UINT(3) * ROW)), material)[5]
    state[l] = sums[l + ROW] / V
    state[l + ROW] = (
        sums[l + UINT(2) * ROW] + (1.0 - OWN_GRADIENT_SHARE) * mu * V * energy + 0.5 * pressure * (sums[l + ROW] - V)
    )
    n0, n1, n2 = _length_at_node(gradient, l, 0), _length_at_node(gradient, l, 1), _length_at_node(gradient, l, 2)
    n3, n4, n5 = _length_at_node(gradient, l, 3), _length_at_node(gradient, l, 4), _length_at_node(gradient, l, 5)
    n6, n7 = _length_at_node(gradient, l, 6), _length_at_node(gradient, l, 7)
    pressure_stiffness = kappa / V * (n0 + n1 + n2 + n3 + n4 + n5 + n6 + n7)
    write3(bound, l, (pressure_stiffness * n0, pressure_stiffness * n1, pressure_stiffness * n2))
    write3(bound, l + UINT(3) * ROW, (pressure_stiffness * n3, pressure_stiffness * n4, pressure_stiffness * n5))
    bound[l + UINT(6) * ROW], bound[l + UINT(7) * ROW] = pressure_stiffness * n6, pressure_stiffness * n7


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_state(x, nodes, start, local, corner, edges, modulus, J, state, stiffness, material):
    """Write J of each tetrahedron (block, 6 LANES); per patch, its volume ratio and energy into ``state`` (block, 2
    LANES); per row, the sum of a bound on the stiffness of its patches into ``stiffness`` (R,).

    The bound is rigorous for the stiffness of the pressure, and close to the largest eigenvalue for that of each
    tetrahedron alone; the contribution of the pressure to the latter is left out. Tests check that the sum is enough.
    """
    for block in prange(len(local)):
        nodal_x, patch_nodal, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, moduli, block_J = edges[block], np.empty(54 * LANES), modulus[block], J[block]
        sums, bounds, own = np.zeros(12 * LANES), np.empty(PATCH_NODES * LANES), np.empty(PATCH_TETS * LANES)
        next_edges = edges[min(block + 1, len(local) - 1)]
        fetch(x, nodes[start[block] : start[block + 1]], local[block], PATCH_NODES, next_edges, nodal_x, patch_nodal)
        nodes_to_edges(patch_nodal, corner[block], d)
        for t in range(UINT(PATCH_TETS)):
            row = UINT(9) * t * ROW
            for l in range(ROW):
                real = 1.0 if moduli[l + UINT(2) * ROW] > t else 0.0
                measured = _measure_tet(read9(d, row + l), read9(e, row + l), moduli[l], real, material)
                tet_J, w, energy, wa, volume_gradient, stiffness_of_tet = measured
                block_J[t * ROW + l], own[t * ROW + l] = tet_J, stiffness_of_tet
                write9(q, row + l, volume_gradient)
                sums[l] += w
                sums[l + ROW] += w * tet_J
                sums[l + UINT(2) * ROW] += energy
                mean_row = l + UINT(3) * ROW
                write9(sums, mean_row, _sum(1.0, read9(sums, mean_row), 1.0, wa))
        _edges_to_nodes(q, corner[block], patch_nodal)
        for l in range(ROW):
            _measure_patch(sums, patch_nodal, moduli, l, state[block], bounds, material)
        for t in range(UINT(PATCH_TETS)):
            for l in range(ROW):
                o, s = UINT(9) * t * ROW + l, own[t * ROW + l]
                s0, s1, s2, s3 = _corner_stiffness(read9(q, o))
                # the four values overwrite the gradient from which they are computed
                q[o], q[o + ROW], q[o + UINT(2) * ROW], q[o + UINT(3) * ROW] = s * s0, s * s1, s * s2, s * s3
        for t in range(PATCH_TETS):
            for l in range(LANES):
                for i in range(4):
                    bounds[np.int64(corner[block, (4 * t + i) * LANES + l]) * LANES + l] += q[(9 * t + i) * LANES + l]
        block_stiffness = stiffness[start[block] : start[block + 1]]
        block_stiffness[:] = 0.0
        for i in range(PATCH_NODES * LANES):
            block_stiffness[local[block, i]] += bounds[i]
