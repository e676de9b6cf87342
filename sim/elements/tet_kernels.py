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
    minus_product,
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
def nodes_to_edges(node_x, corner, edges):
    """Write edge vectors: coordinate r of edge i of tetrahedron t into row 9 t + 3 i + r; node c has rows 3 c + r."""
    for tet in range(PATCH_TETS):
        for lane in range(LANES):
            offset = 3 * LANES * np.int64(corner[4 * tet * LANES + lane]) + lane
            x0, x1, x2 = node_x[offset], node_x[offset + LANES], node_x[offset + 2 * LANES]
            for i in range(3):
                offset = 3 * LANES * np.int64(corner[(4 * tet + i + 1) * LANES + lane]) + lane
                row = (9 * tet + 3 * i) * LANES + lane
                edges[row] = node_x[offset] - x0
                edges[row + LANES] = node_x[offset + LANES] - x1
                edges[row + 2 * LANES] = node_x[offset + 2 * LANES] - x2


@njit(forceinline=True)
def _edges_to_nodes(gradient, corner, node_force):
    """Write minus the gradient by the nodes of each patch into ``node_force``, from that by the edges.

    It is nodes_to_edges transposed.
    """
    node_force[:] = 0.0
    for tet in range(PATCH_TETS):
        for lane in range(LANES):
            sum0, sum1, sum2 = 0.0, 0.0, 0.0
            for i in range(3):
                offset = 3 * LANES * np.int64(corner[(4 * tet + i + 1) * LANES + lane]) + lane
                row = (9 * tet + 3 * i) * LANES + lane
                g0, g1, g2 = gradient[row], gradient[row + LANES], gradient[row + 2 * LANES]
                node_force[offset] -= g0
                node_force[offset + LANES] -= g1
                node_force[offset + 2 * LANES] -= g2
                sum0 += g0
                sum1 += g1
                sum2 += g2
            offset = 3 * LANES * np.int64(corner[4 * tet * LANES + lane]) + lane
            node_force[offset] += sum0
            node_force[offset + LANES] += sum1
            node_force[offset + 2 * LANES] += sum2


@inlined
def _inverse_cube_root(J):
    """J^-1/3 to round-off for 0.02 < J < 50, without a branch."""
    root = halley_step(J)
    return refined_inverse_cube_root(J, root * halley_step(J * root * root * root))


@inlined
def _elastic_tensor(d, e):
    """A = d e^-1, the cofactors of e, and the grown volume det e / 6."""
    cofactors = cofactor(e)
    six_volumes = dot(e, cofactors)
    a = scaled(1.0 / six_volumes, times(d, cofactors[0::3]) + times(d, cofactors[1::3]) + times(d, cofactors[2::3]))
    return a, cofactors, six_volumes * (1.0 / 6.0)


@inlined
def _isochoric_energy(a, material):
    """Cofactors of A, J; f, h, s in dU/dA = mu (f A - h b A + s cof A); u, and i1 times a measure of its stiffness."""
    cofactors = cofactor(a)
    J = dot(a, cofactors)
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
        return cofactors, J, f, h, s, energy_of(material, i1, i2), stiffness_bound(material, i1, i2) * i1
    u1, _ = slopes_of(material, i1, 3.0)
    s = 2.0 * u1 * (-(1.0 / 3.0)) * y * per_J * I1
    return cofactors, J, 2.0 * u1 * phi, 0.0, s, energy_of(material, i1, 3.0), stiffness_bound(material, i1, 3.0) * i1


@inlined
def _less_b_times(P, h, a, material):
    """P - h b A; P if the material does not depend on the second invariant."""
    return minus_product(P, h, left_cauchy_green(a, a, 1.0), a) if uses_i2(material) else P


@inlined
def _weighted_sum(a, w):
    """Sum of w A over the six tetrahedra."""
    partial = combination(1.0, combination(w[0], a[0], w[1], a[1]), w[2], a[2])
    return combination(1.0, combination(1.0, combination(1.0, partial, w[3], a[3]), w[4], a[4]), w[5], a[5])


@inlined
def _tet_gradient(gradient, start, a, cofactors, mean_P, pressure, mu, weight, material):
    """Write the gradient by the edges of one tetrahedron into the nine rows from ``start``; weight 1/6 or 0."""
    cof_A, _, f, h, s, _, _ = _isochoric_energy(a, material)
    P = _less_b_times(_sum(weight * mu * f, a, weight * (mu * s + pressure), cof_A), weight * mu * h, a, material)
    write9(gradient, start, product(_sum(1.0, P, weight, mean_P), cofactors))


@inlined
def patch_gradient(d, e, moduli, gradient, lane, material):
    """Write the gradient of a patch's energy by all edges of its tetrahedra into ``gradient`` (54 rows)."""
    mu, kappa, n_tets = read3(moduli, lane)
    row1, row2, row3 = lane + UINT(9) * ROW, lane + UINT(18) * ROW, lane + UINT(27) * ROW
    row4, row5 = lane + UINT(36) * ROW, lane + UINT(45) * ROW
    real1, real2, real3 = 1.0 if n_tets > 1.0 else 0.0, 1.0 if n_tets > 2.0 else 0.0, 1.0 if n_tets > 3.0 else 0.0
    real4, real5 = 1.0 if n_tets > 4.0 else 0.0, 1.0 if n_tets > 5.0 else 0.0
    a0, cof0, w0 = _elastic_tensor(read9(d, lane), read9(e, lane))
    a1, cof1, w1 = _elastic_tensor(read9(d, row1), read9(e, row1))
    a2, cof2, w2 = _elastic_tensor(read9(d, row2), read9(e, row2))
    a3, cof3, w3 = _elastic_tensor(read9(d, row3), read9(e, row3))
    a4, cof4, w4 = _elastic_tensor(read9(d, row4), read9(e, row4))
    a5, cof5, w5 = _elastic_tensor(read9(d, row5), read9(e, row5))
    a, w = (a0, a1, a2, a3, a4, a5), (w0, real1 * w1, real2 * w2, real3 * w3, real4 * w4, real5 * w5)
    per_volume = 1.0 / (w[0] + w[1] + w[2] + w[3] + w[4] + w[5])
    volume = w[0] * det(a0) + w[1] * det(a1) + w[2] * det(a2) + w[3] * det(a3) + w[4] * det(a4) + w[5] * det(a5)
    pressure = kappa * (volume * per_volume - 1.0)
    mean_A = scaled(per_volume, _weighted_sum(a, w))
    mean_c, _, mean_f, mean_h, mean_s, _, _ = _isochoric_energy(mean_A, material)
    mean_mu = (1.0 - OWN_GRADIENT_SHARE) * mu
    mean_P = _less_b_times(_sum(mean_mu * mean_f, mean_A, mean_mu * mean_s, mean_c), mean_mu * mean_h, mean_A, material)
    sixth = 1.0 / 6.0
    _tet_gradient(gradient, lane, a0, cof0, mean_P, pressure, OWN_GRADIENT_SHARE * mu, sixth, material)
    _tet_gradient(gradient, row1, a1, cof1, mean_P, pressure, OWN_GRADIENT_SHARE * mu, real1 * sixth, material)
    _tet_gradient(gradient, row2, a2, cof2, mean_P, pressure, OWN_GRADIENT_SHARE * mu, real2 * sixth, material)
    _tet_gradient(gradient, row3, a3, cof3, mean_P, pressure, OWN_GRADIENT_SHARE * mu, real3 * sixth, material)
    _tet_gradient(gradient, row4, a4, cof4, mean_P, pressure, OWN_GRADIENT_SHARE * mu, real4 * sixth, material)
    _tet_gradient(gradient, row5, a5, cof5, mean_P, pressure, OWN_GRADIENT_SHARE * mu, real5 * sixth, material)


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_forces(x, nodes, start, local_row, corner, edges, moduli, force, material):
    """Write forces (minus the energy gradient) of the patches, summed per block and node, into ``force`` (R, 3).

    x (N, 3); nodes, start, local_row: see ``Blocks``, for the eight nodes of each patch; corner (block, 24 LANES)
    uint8, row 4 t + i: which of these nodes is corner i of tetrahedron t; edges (block, 54 LANES), row 9 t + 3 i + r,
    after free growth; moduli (block, 3 LANES): mu, kappa, number of tetrahedra; material: see ``sim.materials``.
    """
    for block in prange(len(local_row)):
        node_x, patch_nodal, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, gradient, block_moduli = edges[block], np.empty(54 * LANES), moduli[block]
        next_edges = edges[min(block + 1, len(local_row) - 1)]
        fetch(x, nodes[start[block] : start[block + 1]], local_row[block], PATCH_NODES, next_edges, node_x, patch_nodal)
        nodes_to_edges(patch_nodal, corner[block], d)
        for lane in range(ROW):
            patch_gradient(d, e, block_moduli, gradient, lane, material)  # not into d: LLVM would not vectorise
        _edges_to_nodes(gradient, corner[block], patch_nodal)
        block_force = force[start[block] : start[block + 1]]
        block_force[:] = 0.0
        deliver(patch_nodal, local_row[block], PATCH_NODES, block_force)


@kernel(parallel=True)
def grow_edges(X, normal, nodes, start, local_row, corner, across, along, edges):
    """Compute the edges of the leading blocks after free growth: G (X_i - X_0), from reference positions X (N, 3).

    G = across (I - N N) + along N N, with N the normalised mean of ``normal`` (N, 3) at the corners of a tetrahedron;
    across and along (block, 6 LANES).
    """
    for block in prange(len(across)):
        node_x, patch_x, normals = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(24 * LANES)
        e, block_nodes = edges[block], nodes[start[block] : start[block + 1]]
        fetch(X, block_nodes, local_row[block], PATCH_NODES, e, node_x, patch_x)
        fetch(normal, block_nodes, local_row[block], PATCH_NODES, e, node_x, normals)
        nodes_to_edges(patch_x, corner[block], e)
        for tet in range(PATCH_TETS):
            for lane in range(LANES):
                g, h, row = across[block, tet * LANES + lane], along[block, tet * LANES + lane], 9 * tet * LANES + lane
                for offset in range(row, row + 9 * LANES, LANES):
                    e[offset] *= g
                if h == g:
                    continue
                n0, n1, n2 = 0.0, 0.0, 0.0
                for i in range(4):
                    offset = 3 * LANES * np.int64(corner[block, (4 * tet + i) * LANES + lane]) + lane
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
def _weighted(weights, u, v):
    return weights[0] * u[0] * v[0] + weights[1] * u[1] * v[1] + weights[2] * u[2] * v[2] + weights[3] * u[3] * v[3]


@inlined
def _node_length(node_x, lane, node):
    """Length of the vector at a node."""
    return _length(read3(node_x, lane + UINT(3 * node) * ROW))


@inlined
def _corner_stiffness(q):
    """Four numbers m_i with sum_i m_i |u_i|^2 >= |sum_i u_i q_i^T|^2, from the volume gradients q at corners 1 to 3.

    m_i = |q_i| |sum_j q_j q_j^T / |q_j||: equal for a single corner, close to equal for a tetrahedron of good shape.
    """
    first_gradient = -(q[0] + q[3] + q[6]), -(q[1] + q[4] + q[7]), -(q[2] + q[5] + q[8])
    len0, len1 = _length(first_gradient) + _TINY, _length(q) + _TINY
    len2, len3 = _length(q[3:6]) + _TINY, _length(q[6:9]) + _TINY
    per_length = 1.0 / len0, 1.0 / len1, 1.0 / len2, 1.0 / len3
    x, y, z = (first_gradient[0],) + q[0::3], (first_gradient[1],) + q[1::3], (first_gradient[2],) + q[2::3]
    xx, yy, zz = _weighted(per_length, x, x), _weighted(per_length, y, y), _weighted(per_length, z, z)
    xy, yz, zx = _weighted(per_length, x, y), _weighted(per_length, y, z), _weighted(per_length, z, x)
    norm = np.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))
    return norm * len0, norm * len1, norm * len2, norm * len3


@inlined
def _measure_tet(d, e, mu, is_real, material):
    """J, grown volume w, energy, w A, volume gradient by the edges, and a stiffness of one tetrahedron.

    All but J and the last are 0 if ``is_real`` is 0. The stiffness is that of the volume-preserving energy per square
    of the volume gradient, 2/3 mu i1 / (w J^2) for a neo-Hookean material.
    """
    a, cofactors, w = _elastic_tensor(d, e)
    cof_A, J, _, _, _, energy, energy_stiffness = _isochoric_energy(a, material)
    clamped_J = max(J, CRUSHED_BELOW_J)
    stiffness = (2.0 / 3.0) * mu * energy_stiffness / (w * clamped_J * clamped_J)
    w *= is_real
    volume_gradient = scaled(is_real * (1.0 / 6.0), product(cof_A, cofactors))
    return J, w, OWN_GRADIENT_SHARE * mu * w * energy, scaled(w, a), volume_gradient, stiffness


@inlined
def _measure_patch(sums, gradient, moduli, lane, state, bounds, material):
    """Write volume ratio and energy of a patch into ``state``, stiffness of its pressure into ``bounds``.

    ``sums`` are sums over its tetrahedra, ``gradient`` holds the volume gradient g at its nodes. The stiffness of the
    pressure has rank one: kappa/V (sum g_c u_c)^2 <= kappa/V (sum |g_b|) sum |g_c| |u_c|^2.
    """
    mu, kappa, V = moduli[lane], moduli[lane + ROW], sums[lane]
    pressure = kappa * (sums[lane + ROW] / V - 1.0)
    u = _isochoric_energy(scaled(1.0 / V, read9(sums, lane + UINT(3) * ROW)), material)[5]
    state[lane] = sums[lane + ROW] / V
    mean_energy = (1.0 - OWN_GRADIENT_SHARE) * mu * V * u
    state[lane + ROW] = sums[lane + UINT(2) * ROW] + mean_energy + 0.5 * pressure * (sums[lane + ROW] - V)
    len0, len1, len2 = _node_length(gradient, lane, 0), _node_length(gradient, lane, 1), _node_length(gradient, lane, 2)
    len3, len4, len5 = _node_length(gradient, lane, 3), _node_length(gradient, lane, 4), _node_length(gradient, lane, 5)
    len6, len7 = _node_length(gradient, lane, 6), _node_length(gradient, lane, 7)
    stiffness = kappa / V * (len0 + len1 + len2 + len3 + len4 + len5 + len6 + len7)
    write3(bounds, lane, (stiffness * len0, stiffness * len1, stiffness * len2))
    write3(bounds, lane + UINT(3) * ROW, (stiffness * len3, stiffness * len4, stiffness * len5))
    bounds[lane + UINT(6) * ROW], bounds[lane + UINT(7) * ROW] = stiffness * len6, stiffness * len7


@kernel(parallel=True, fastmath=FAST_MATH)
def patch_state(x, nodes, start, local_row, corner, edges, moduli, J, state, stiffness, material):
    """Write J of each tetrahedron (block, 6 LANES); per patch, its volume ratio and energy into ``state`` (block, 2
    LANES); per row, the sum of a bound on the stiffness of its patches into ``stiffness`` (R,).

    The bound is rigorous for the stiffness of the pressure, and close to the largest eigenvalue for that of each
    tetrahedron alone; the contribution of the pressure to the latter is left out. Tests check that the sum is enough.
    """
    for block in prange(len(local_row)):
        node_x, patch_nodal, d = np.empty((PATCH_NODES * LANES, 3)), np.empty(24 * LANES), np.empty(54 * LANES)
        e, q, block_moduli, block_J = edges[block], np.empty(54 * LANES), moduli[block], J[block]
        sums, bounds, tet_bound = np.zeros(12 * LANES), np.empty(PATCH_NODES * LANES), np.empty(PATCH_TETS * LANES)
        next_edges = edges[min(block + 1, len(local_row) - 1)]
        fetch(x, nodes[start[block] : start[block + 1]], local_row[block], PATCH_NODES, next_edges, node_x, patch_nodal)
        nodes_to_edges(patch_nodal, corner[block], d)
        for t in range(UINT(PATCH_TETS)):
            row = UINT(9) * t * ROW
            for l in range(ROW):
                is_real = 1.0 if block_moduli[l + UINT(2) * ROW] > t else 0.0
                measured = _measure_tet(read9(d, row + l), read9(e, row + l), block_moduli[l], is_real, material)
                tet_J, w, energy, w_times_A, volume_gradient, bound = measured
                block_J[t * ROW + l], tet_bound[t * ROW + l] = tet_J, bound
                write9(q, row + l, volume_gradient)
                sums[l] += w
                sums[l + ROW] += w * tet_J
                sums[l + UINT(2) * ROW] += energy
                mean_row = l + UINT(3) * ROW
                write9(sums, mean_row, _sum(1.0, read9(sums, mean_row), 1.0, w_times_A))
        _edges_to_nodes(q, corner[block], patch_nodal)
        for l in range(ROW):
            _measure_patch(sums, patch_nodal, block_moduli, l, state[block], bounds, material)
        for t in range(UINT(PATCH_TETS)):
            for l in range(ROW):
                o, s = UINT(9) * t * ROW + l, tet_bound[t * ROW + l]
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
            block_stiffness[local_row[block, i]] += bounds[i]
