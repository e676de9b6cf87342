"""Second derivative of a body's energy: the exact stiffness matrix at any positions, from the elements' own data.

The energies of both elements (:mod:`morphofold.sim.elements.brick_kernels` and its counterpart for tets) have one form.
At a point D = sum_a x_a g_a^T, with g_a the gradient of node a's shape function in coordinates in which the grown
material has the metric C, w tr(A^T A) = D : D C, and the volume w, J = det D / w. Per point and per element,

    w mu u(i1, i2) + w local/2 (J - 1)^2    and    kappa/2 V (v/V - 1)^2,    v = sum w J,

with i1 = phi(J) I1, I1 = tr(A^T A), phi = J^-2/3, or its replacement where an element is crushed, and u of the
material. With k_a = cof(D) g_a and P_a = D C g_a the gradient is sum f P_a + s k_a, f = 2 mu u1 phi and
s = local (J - 1) + mu u1 phi' I1 + kappa (v/V - 1), and

    d2W/dx_a dx_b = f (g_a . C g_b) I + s [D (g_a x g_b)]_x
                    + (local + mu u1 phi'' I1) / w k_a k_b^T + 2 mu u1 phi' / w (P_a k_b^T + k_a P_b^T)
                    + mu u11 w di1_a di1_b^T,        w di1_a = 2 phi P_a + phi' I1 k_a,

summed over the points, where [v]_x t = v x t, plus kappa/V (sum k_a) (sum k_b)^T. This needs a few products of small
matrices per element, and no sum over pairs of shape functions. If the material depends on the second invariant,
i2 = psi(J) I2, :func:`_add_second_invariant` adds its terms.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse
from skfem import ElementHex1

from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.elements.brick_kernels import ROWS_PER_POINT
from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER, GAUSS_POINTS, Bricks
from morphofold.sim.elements.tet_kernels import OWN_GRADIENT_SHARE, PATCH_NODES, PATCH_TETS
from morphofold.sim.elements.tets import Tets
from morphofold.sim.materials import Material
from morphofold.sim.materials.elastic import Factor, cofactor, continued, frozen

ELEMENTS_PER_CHUNK = 2048  # elements at once, so that their matrices stay in the cache
#: steps through the mesh from a surface node to the farthest node that the filter couples to it
FILTER_REACH_IN_STEPS = 4.0
SYMMETRIC_INDEX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # places of the six numbers of C

#: gradients of the brick's shape functions in [-1, 1]^3: (8 Gauss points, 8 corners, 3), both in the kernels' order
BRICK_SHAPE_GRADIENTS: Array = np.stack(
    [ElementHex1().lbasis(GAUSS_POINTS, int(i))[1].T / 2 for i in CORNERS_IN_KERNEL_ORDER], axis=1
)

#: J to minus a power, or its replacement where an element is crushed: ``elastic.frozen`` or ``elastic.continued``
Power = Callable[[Array, float], Factor]


class ElementPoints(NamedTuple):
    """Some elements of a body, E of them with K nodes and Q points each.

    Attributes
    ----------
    nodes : (E, K) int
    g : (Q, K, 3) or (E, Q, K, 3) float64
        Gradients of the shape functions.
    C : (E, Q, 3, 3), w : (E, Q) float64
        Grown metric and volume [mm^3] of the points.
    mu, local_K : (E, Q) float64
        Shear modulus, and modulus of the local volumetric term [Pa].
    has_p : (Q,) float64
        1 for points with the mean pressure, whose volume counts in v, 0 for others.
    kappa, V : (E,) float64
        Modulus of the mean pressure [Pa], grown volume [mm^3].
    power : callable
    material : Material
    """

    nodes: Ints
    g: Array
    C: Array
    w: Array
    mu: Array
    local_K: Array
    has_p: Array
    kappa: Array
    V: Array
    power: Power
    material: Material


def points(body: Body) -> Iterator[ElementPoints]:
    """All elements of a body at its present growth, some at a time; for tetrahedra an element is a patch."""
    if isinstance(body.elements, Bricks):
        return _gauss_points_of_bricks(body.elements, body.mu, body.kappa)
    return _gauss_points_of_tet_patches(body.elements, body.mu, body.kappa)


def _gauss_points_of_bricks(bricks: Bricks, mu: Array, kappa: Array) -> Iterator[ElementPoints]:
    point_data = bricks.blocks.from_lanes(bricks.point).reshape(-1, 8, ROWS_PER_POINT)
    V = 1 / bricks.blocks.from_lanes(bricks.modulus)[:, 2]
    for chunk in _chunk_slices(bricks.n):
        shear_moduli = np.repeat(mu[chunk, None], 8, axis=1)
        yield ElementPoints(
            bricks.corners[chunk],
            BRICK_SHAPE_GRADIENTS,
            point_data[chunk, :, SYMMETRIC_INDEX],
            1 / point_data[chunk, :, 6],
            shear_moduli,
            bricks.LOCAL * shear_moduli,
            np.ones(8),
            kappa[chunk],
            V[chunk],
            frozen,
            bricks.material,
        )


def _chunk_slices(n_elements: int) -> Iterator[slice]:
    return (slice(start, start + ELEMENTS_PER_CHUNK) for start in range(0, n_elements, ELEMENTS_PER_CHUNK))


def _gauss_points_of_tet_patches(tets: Tets, mu: Array, kappa: Array) -> Iterator[ElementPoints]:
    """The points of a patch are its tetrahedra, and a last point for their mean gradient."""
    n_patches, first_tets = len(tets.patches), tets.patches[:, 0]
    edges = tets.blocks.from_lanes(tets.edges).reshape(-1, PATCH_TETS, 3, 3)
    corner_slots = tets.blocks.from_lanes(tets.corner).reshape(-1, PATCH_TETS, 4).astype(np.int64)
    for chunk in _chunk_slices(n_patches):
        is_real = tets.patches[chunk] >= 0
        edge_gradients = np.linalg.inv(edges[chunk].swapaxes(-1, -2)) * is_real[..., None, None]
        g = np.zeros((len(is_real), PATCH_TETS + 1, PATCH_NODES, 3))
        corner_gradients = np.concatenate([-edge_gradients.sum(axis=-2, keepdims=True), edge_gradients], axis=-2)
        np.put_along_axis(g[:, :PATCH_TETS], corner_slots[chunk, :, :, None], corner_gradients, axis=2)
        w = np.linalg.det(edges[chunk]) / 6 * is_real
        V = w.sum(axis=1)
        g[:, PATCH_TETS] = np.einsum("et,etai->eai", w, g[:, :PATCH_TETS]) / _wide(V)
        w = np.column_stack([np.where(is_real, w, 1.0), V])  # 1 for missing tetrahedra; any number would do
        scale = _wide(np.cbrt(w))  # turns A into D of metric w^(1/3) I
        modulus_shares = np.column_stack([OWN_GRADIENT_SHARE * is_real, np.full(len(is_real), 1 - OWN_GRADIENT_SHARE)])
        yield ElementPoints(
            tets.corners[chunk],
            g * scale,
            scale * np.eye(3),
            w,
            modulus_shares * mu[first_tets[chunk], None],
            np.zeros(w.shape),
            np.repeat([1.0, 0.0], [PATCH_TETS, 1]),
            kappa[first_tets[chunk]],
            V,
            continued,
            tets.material,
        )


class Tangent:
    """The stiffness matrix of a body; its pattern is computed once.

    Parameters
    ----------
    body : Body
    """

    def __init__(self, body: Body):
        self.body = body
        nodes = np.concatenate([chunk.nodes for chunk in points(body)]).astype(np.int64)  # products of 32 bits overflow
        n_nodes, n_corners = len(body.X), nodes.shape[1]
        element_pairs = (np.repeat(nodes, n_corners, axis=1) * n_nodes + np.tile(nodes, (1, n_corners))).ravel()
        filters = [sparse.coo_matrix(body.filter.matrix(axis)) for axis in range(3)]
        filter_pairs = [matrix.row.astype(np.int64) * n_nodes + matrix.col for matrix in filters]
        pair_keys = np.unique(np.concatenate([element_pairs, *filter_pairs]))  # of pairs of nodes, row by row
        self._place = np.searchsorted(pair_keys, element_pairs).reshape(-1, n_corners, n_corners)
        self._filter_place = [np.searchsorted(pair_keys, pairs) for pairs in filter_pairs]
        self._indices = (pair_keys % n_nodes).astype(np.int32)
        self._indptr = np.searchsorted(pair_keys, n_nodes * np.arange(n_nodes + 1)).astype(np.int32)

    def graph(self) -> sparse.csr_matrix:
        """Steps through the mesh (N, N) between nodes with a common entry: 1 in an element, 4 in the filter alone."""
        steps = np.full(len(self._indices), FILTER_REACH_IN_STEPS)
        steps[self._place] = 1.0
        n_nodes = len(self.body.X)
        return sparse.csr_matrix((steps, self._indices, self._indptr), shape=(n_nodes, n_nodes))

    def at(self, x: Array) -> sparse.csr_matrix:
        """Stiffness (3 N, 3 N) at positions ``x`` (N, 3) and the present growth: minus the derivative of the forces.

        Coordinate r of node i has number 3 i + r. The surface filter is included, at its present cell size, supports
        are not. The pattern is the same for all x: entries that happen to be 0 are kept.
        """
        node_blocks = np.zeros((len(self._indices), 3, 3))
        for chunk, element_points in enumerate(points(self.body)):
            _add_blocks(stiffness(x, element_points), self._place[ELEMENTS_PER_CHUNK * chunk :], node_blocks)
        for axis, block_indices in enumerate(self._filter_place):
            node_blocks[block_indices, axis, axis] += self.body.filter.matrix(axis).data
        return sparse.bsr_matrix((node_blocks, self._indices, self._indptr), shape=(x.size, x.size)).tocsr()


class _Stress(NamedTuple):
    """Stress at the points, (E, Q) and with trailing axes.

    D; in ``matrices`` its cofactors k, P = D C (3, 3), and R of the second invariant, w/2 dI2/dD (3, 3), if the
    material depends on it; the gradient f P + s k minus h b P, ``h_and_b`` are these two or None; and in
    ``pair_factors`` the factors of the products of two of the vectors.
    """

    D: Array
    matrices: dict[str, Array]
    f: Array
    s: Array
    h_and_b: tuple[Array, Array] | None
    pair_factors: dict[str, Array]


def _stress_at_points(x: Array, part: ElementPoints) -> _Stress:
    D = x[part.nodes].swapaxes(-1, -2)[:, None] @ part.g
    k = cofactor(D)
    deformed_volumes = np.einsum("eqi,eqi->eq", D[..., 0], k[..., 0])
    J = deformed_volumes / part.w
    P = D @ part.C
    I1 = np.einsum("eqri,eqri->eq", D, P) / part.w
    pressure = part.kappa * (deformed_volumes @ part.has_p / part.V - 1)
    phi = part.power(J, 2 / 3)
    uses_i2 = part.material.uses_i2
    b = P @ D.swapaxes(-1, -2) / _wide(part.w) if uses_i2 else None
    I2 = 0.5 * (I1**2 - np.einsum("eqij,eqij->eq", b, b)) if b is not None else 3.0
    psi = part.power(J, 4 / 3) if uses_i2 else Factor(np.array(1.0), np.array(0.0), np.array(0.0))
    i1, i2 = phi.value * I1, psi.value * I2
    (u1, u2), (u11, u12, u22) = part.material.slopes(i1, i2), part.material.curvatures(i1, i2)
    s = part.local_K * (J - 1) + part.mu * (u1 * phi.slope * I1 + u2 * psi.slope * I2) + pressure[:, None] * part.has_p
    # w di1 = p1 P + k1 k, w di2 = r2 R + k2 k
    p1, k1, r2, k2 = 2 * phi.value, phi.slope * I1, 2 * psi.value, psi.slope * I2
    mu_per_w = part.mu / part.w
    factors = {
        "kk": part.local_K / part.w
        + mu_per_w * (u1 * phi.curvature * I1 + u2 * psi.curvature * I2)
        + mu_per_w * (u11 * k1 * k1 + 2 * u12 * k1 * k2 + u22 * k2 * k2),
        "Pk": mu_per_w * (2 * u1 * phi.slope + u11 * p1 * k1 + u12 * p1 * k2),
    }
    if uses_i2 or np.any(u11):
        factors["PP"] = mu_per_w * (4 * u2 * psi.value + u11 * p1 * p1)
    f = 2 * part.mu * u1 * phi.value
    if b is None:
        return _Stress(D, {"k": k, "P": P}, f, s, None, factors)
    factors |= {
        "Rk": mu_per_w * (2 * u2 * psi.slope + u12 * r2 * k1 + u22 * r2 * k2),
        "PR": mu_per_w * u12 * p1 * r2,
        "RR": mu_per_w * u22 * r2 * r2,
    }
    h = 2 * part.mu * u2 * psi.value
    return _Stress(D, {"k": k, "P": P, "R": _wide(I1) * P - b @ P}, f + h * I1, s, (_wide(h), b), factors)


def _wide(factors: Array) -> Array:
    """Factors on matrices."""
    return factors[..., None, None]


def stiffness(x: Array, part: ElementPoints) -> Array:
    """Second derivative (E, K, 3, K, 3) of the energy of elements by the positions of their nodes [Pa mm].

    ``x`` (N, 3) are the positions of all nodes [mm].
    """
    stress = _stress_at_points(x, part)
    n_elements, n_corners = part.nodes.shape
    g_rows = np.moveaxis(part.g, -2, -3).reshape(*part.g.shape[:-3], n_corners, -1)  # (..., K, 3 Q)
    g_columns = np.ascontiguousarray(part.g.swapaxes(-1, -2))  # (..., Q, 3, K)

    def gradient_products(M: Array) -> Array:
        """sum_q g_a . M g_b (E, K, K) for M (E, Q, 3, 3)."""
        return g_rows @ (M @ g_columns).reshape(n_elements, -1, n_corners)

    hessian = np.empty((n_elements, n_corners, 3, n_corners, 3))
    same_axis = gradient_products(_wide(stress.f) * part.C)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        s_row = (stress.s[..., None] * stress.D[:, :, i])[..., None, :]
        s_block = gradient_products(np.cross(s_row, np.eye(3)))  # M = v x I: a . M b = v . (a x b)
        hessian[:, :, i, :, i], hessian[:, :, j, :, k], hessian[:, :, k, :, j] = same_axis, s_block, -s_block
    if stress.h_and_b is not None:
        _add_second_invariant(stress.matrices["P"], *stress.h_and_b, part, gradient_products, hessian)

    nodal_vectors = {
        letter: (M @ g_columns).swapaxes(-1, -2).reshape(n_elements, -1, 3 * n_corners)  # (E, Q, 3 K)
        for letter, M in stress.matrices.items()
    }
    mean_cofactors = np.einsum("eqk,q->ek", nodal_vectors["k"], part.has_p)[:, None]
    weighted = {letter: np.zeros(rows.shape) for letter, rows in nodal_vectors.items()}
    for (a, b), factor in ((tuple(pair), factor[..., None]) for pair, factor in stress.pair_factors.items()):
        weighted[a] += factor * nodal_vectors[b]
        if a != b:
            weighted[b] += factor * nodal_vectors[a]
    left_factors = np.concatenate([*nodal_vectors.values(), mean_cofactors], axis=1)
    right_factors = np.concatenate([*weighted.values(), (part.kappa / part.V)[:, None, None] * mean_cofactors], axis=1)
    return hessian + (left_factors.swapaxes(-1, -2) @ right_factors).reshape(hessian.shape)


def _add_second_invariant(
    P: Array, h: Array, b: Array, part: ElementPoints, gradient_products: Callable[[Array], Array], hessian: Array
) -> None:
    """Add the terms of the second derivative of the second invariant, except products of P with itself.

    With b = A A^T = P D^T / w: h/2 d2I2 w = h [I1 (g_a . C g_b) I + 2/w P_a P_b^T - (P_a . P_b) I / w - P_b P_a^T / w
    - (g_a . C g_b) b]; the first term is in f, the second in the pairs.
    """
    h_per_w = h / _wide(part.w)
    P_dot_P = gradient_products(h_per_w * (P.swapaxes(-1, -2) @ P))
    for r in range(3):
        for s in range(3):
            cross_terms = h_per_w * P[:, :, s, :, None] * P[:, :, r, None, :]  # g_a . M g_b = (P_a)_s (P_b)_r
            hessian[:, :, r, :, s] -= gradient_products(cross_terms + h * _wide(b[:, :, r, s]) * part.C)
        hessian[:, :, r, :, r] -= P_dot_P


def cauchy_stress(body: Body, x: Array) -> Array:
    """Mean Cauchy stress (E, 3, 3) of each brick, or patch of tetrahedra, at positions ``x`` (N, 3) [Pa].

    sum_q (dW/dD) D^T / v with the deformed volume v, which is the virial of the nodal forces. Tension is positive.
    With cofactors k of D, k D^T = det D.
    """
    stresses = []
    for element_points in points(body):
        stress = _stress_at_points(x, element_points)
        D, k, P = stress.D, stress.matrices["k"], stress.matrices["P"]
        f_P = _wide(stress.f) * P
        if stress.h_and_b is not None:
            h, b = stress.h_and_b
            f_P -= h * (b @ P)
        f_P, D_rows = (matrices.swapaxes(1, 2).reshape(len(D), 3, -1) for matrices in (f_P, D))
        det_D = np.einsum("eqi,eqi->eq", D[..., 0], k[..., 0])
        virial = f_P @ D_rows.swapaxes(-1, -2) + _wide(np.sum(stress.s * det_D, axis=1)) * np.eye(3)
        stresses.append(virial / _wide(det_D @ element_points.has_p))
    return np.concatenate(stresses)


def stress_of_elements(body: Body, x: Array) -> Array:
    """:func:`cauchy_stress` of each element (n, 6), xx, yy, zz, xy, yz, xz [Pa]; for tetrahedra that of their patch."""
    patch_stress = cauchy_stress(body, x)[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    if isinstance(body.elements, Bricks):
        return patch_stress
    patches, slots = np.nonzero(body.elements.patches >= 0)
    tet_stress = np.empty((body.elements.n, 6))
    tet_stress[body.elements.patches[patches, slots]] = patch_stress[patches]
    return tet_stress


@kernel
def _add_blocks(matrices, block_indices, blocks):
    """Add the 3x3 blocks of element matrices (e, K, 3, K, 3) to ``blocks`` (B, 3, 3) at ``block_indices`` (e, K, K)."""
    for e in range(len(matrices)):
        for a in range(matrices.shape[1]):
            for b in range(matrices.shape[1]):
                block = blocks[block_indices[e, a, b]]
                for r in range(3):
                    for s in range(3):
                        block[r, s] += matrices[e, a, r, b, s]
