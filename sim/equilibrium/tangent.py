"""Second derivative of a body's energy: the stiffness matrix at any positions, exact, from the elements' own data.

Both elements have the energy of :mod:`morphofold.sim.elements.brick_kernels` and its twin for tets in one form. At a
point D = sum_a x_a g_a^T, with g_a the gradient of node a's shape function in coordinates in which the grown
material has the metric C, w tr(A^T A) = D : D C, and the volume w, J = det D / w. Per point and per element,

    w mu/2 (phi(J) I1 - 3) + w local/2 (J - 1)^2,    I1 = tr(A^T A),    and    kappa/2 V (v/V - 1)^2,    v = sum w J,

with phi = J^-2/3, or what stands for it where an element is crushed. With k_a = cof(D) g_a, P_a = D C g_a and
s = local (J - 1) + mu/2 phi' I1 + kappa (v/V - 1) the gradient is sum mu phi P_a + s k_a, and

    d2W/dx_a dx_b = mu phi (g_a . C g_b) I + s [D (g_a x g_b)]_x
                    + (local + mu/2 phi'' I1) / w k_a k_b^T + mu phi' / w (P_a k_b^T + k_a P_b^T)

summed over the points, where [v]_x t = v x t, and kappa/V (sum k_a) (sum k_b)^T. All is a handful of products of small
matrices per element, and never a sum over pairs of shape functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import sparse
from skfem import ElementHex1

from morphofold.arrays import Array, Ints
from morphofold.sim.body import Body
from morphofold.sim.elements.blocks import from_lanes
from morphofold.sim.elements.brick_kernels import J_MIN, POINT
from morphofold.sim.elements.bricks import BINARY_CORNERS, GAUSS, Bricks
from morphofold.sim.elements.tet_kernels import BLEND, CRUSHED, NODES, TETS
from morphofold.sim.elements.tets import Tets
from morphofold.sim.material import cofactor

CHUNK = 2048            # elements at once: their matrices stay in the cache
FILTER_STEPS = 4.0      # through the mesh, from a node of the surface to the farthest that the filter couples it to
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])     # where the six numbers of C stand

#: gradients of the brick's shape functions in [-1, 1]^3: (8 Gauss points, 8 corners, 3), both in the kernels' order
BRICK_GRADIENTS: Array = np.stack([ElementHex1().lbasis(GAUSS, int(i))[1].T / 2 for i in BINARY_CORNERS], axis=1)

#: phi of J, and its first and second derivative
Phi = Callable[[Array], tuple[Array, Array, Array]]


class Points(NamedTuple):
    """Some elements of a body, E of them with K nodes and Q points each.

    Attributes
    ----------
    nodes : (E, K) int
    g : (Q, K, 3) or (E, Q, K, 3) float64
        Gradients of the shape functions.
    C : (E, Q, 3, 3), w : (E, Q) float64
        Grown metric and volume [mm^3] of the points.
    mu, local : (E, Q) float64
        Shear modulus, and modulus of the local volumetric term [Pa].
    bears : (Q,) float64
        1 for the points whose volume v counts, 0 for others.
    kappa, V : (E,) float64
        Modulus of the mean pressure [Pa], grown volume [mm^3].
    phi : callable
    """

    nodes: Ints
    g: Array
    C: Array
    w: Array
    mu: Array
    local: Array
    bears: Array
    kappa: Array
    V: Array
    phi: Phi


def points(body: Body) -> Iterator[Points]:
    """All elements of a body at its present growth, ``CHUNK`` at a time; patches are the elements of tetrahedra."""
    elements, blocks = body.elements, body.elements.blocks
    nodes = blocks.nodes[blocks.start[:-1, None] + blocks.local].astype(np.int64)
    if isinstance(elements, Bricks):
        yield from _bricks(elements, from_lanes(nodes, elements.n), body.mu, body.kappa)
    else:
        assert isinstance(elements, Tets)
        yield from _patches(elements, from_lanes(nodes, len(elements.patches)), body.mu, body.kappa)


def _bricks(bricks: Bricks, nodes: Ints, mu: Array, kappa: Array) -> Iterator[Points]:
    data = from_lanes(bricks.point, bricks.n).reshape(-1, 8, POINT)
    V = 1 / from_lanes(bricks.modulus, bricks.n)[:, 2]
    for part in _parts(bricks.n):
        shear = np.repeat(mu[part, None], 8, axis=1)
        yield Points(
            nodes[part], BRICK_GRADIENTS, data[part, :, SYMMETRIC], 1 / data[part, :, 6], shear, bricks.LOCAL * shear,
            np.ones(8), kappa[part], V[part], _frozen,
        )  # fmt: skip


def _parts(n: int) -> Iterator[slice]:
    return (slice(start, start + CHUNK) for start in range(0, n, CHUNK))


def _frozen(J: Array) -> tuple[Array, Array, Array]:
    """J^-2/3 of bricks, constant below ``J_MIN``."""
    held = np.maximum(J, J_MIN)
    phi, falls = held ** (-2 / 3), J > J_MIN
    return phi, np.where(falls, -2 / 3 * phi / held, 0.0), np.where(falls, 10 / 9 * phi / held**2, 0.0)


def _patches(tets: Tets, nodes: Ints, mu: Array, kappa: Array) -> Iterator[Points]:
    """The tetrahedra of a patch are its points, and a last one is their mean gradient."""
    count, first = len(tets.patches), tets.patches[:, 0]
    edges = from_lanes(tets.edges, count).reshape(-1, TETS, 3, 3)
    corner = from_lanes(tets.corner, count).reshape(-1, TETS, 4).astype(np.int64)
    for part in _parts(count):
        real = tets.patches[part] >= 0
        to_edges = np.linalg.inv(edges[part].swapaxes(-1, -2)) * real[..., None, None]
        g = np.zeros((len(real), TETS + 1, NODES, 3))
        slopes = np.concatenate([-to_edges.sum(axis=-2, keepdims=True), to_edges], axis=-2)
        np.put_along_axis(g[:, :TETS], corner[part, :, :, None], slopes, axis=2)
        w = np.linalg.det(edges[part]) / 6 * real
        V = w.sum(axis=1)
        g[:, TETS] = np.einsum("et,etai->eai", w, g[:, :TETS]) / V[:, None, None]
        w = np.column_stack([np.where(real, w, 1.0), V])                # any number where there is none
        scale = np.cbrt(w)[..., None, None]                             # turns A into D of metric w^(1/3) I
        share = np.column_stack([BLEND * real, np.full(len(real), 1 - BLEND)])
        yield Points(
            nodes[part], g * scale, scale * np.eye(3), w, share * mu[first[part], None], np.zeros(w.shape),
            np.repeat([1.0, 0.0], [TETS, 1]), kappa[first[part]], V, _continued,
        )  # fmt: skip


def _continued(J: Array) -> tuple[Array, Array, Array]:
    """J^-2/3 of tetrahedra, with a tangent below ``CRUSHED``."""
    held = np.maximum(J, CRUSHED)
    phi = held ** (-2 / 3)
    falls = -2 / 3 * phi / held
    return phi + falls * (J - held), falls, np.where(J > CRUSHED, 10 / 9 * phi / held**2, 0.0)


class Tangent:
    """The stiffness matrix of a body; its pattern is laid out once.

    Parameters
    ----------
    body : Body
    """

    def __init__(self, body: Body):
        self.body = body
        nodes = np.concatenate([part.nodes for part in points(body)])
        n, k = len(body.X), nodes.shape[1]
        inside = (np.repeat(nodes, k, axis=1) * n + np.tile(nodes, (1, k))).ravel()
        wide = [self._filter(axis) for axis in range(3)]
        beside = [B.row.astype(np.int64) * n + B.col for B in wide]
        keys = np.unique(np.concatenate([inside, *beside]))             # of pairs of nodes, row by row
        self._place = np.searchsorted(keys, inside).reshape(-1, k, k)
        self._filter_place = [np.searchsorted(keys, pairs) for pairs in beside]
        self._indices = (keys % n).astype(np.int32)
        self._indptr = np.searchsorted(keys, n * np.arange(n + 1)).astype(np.int32)

    def _filter(self, axis: int) -> sparse.coo_matrix:
        return sparse.coo_matrix(self.body.filter.matrix(axis))

    def graph(self) -> sparse.csr_matrix:
        """Steps through the mesh (N, N) between nodes with a common entry: 1 in an element, 4 in the filter alone."""
        steps = np.full(len(self._indices), FILTER_STEPS)
        steps[self._place] = 1.0
        n = len(self.body.X)
        return sparse.csr_matrix((steps, self._indices, self._indptr), shape=(n, n))

    def at(self, x: Array) -> sparse.csr_matrix:
        """Stiffness (3 N, 3 N) at positions ``x`` (N, 3) and the present growth: minus the derivative of the forces.

        Coordinate r of node i has number 3 i + r. The surface filter is in it, at its present cell size, the supports
        are not. The pattern is the same for all x: entries that happen to be 0 stay.
        """
        blocks = np.zeros((len(self._indices), 3, 3))
        for i, part in enumerate(points(self.body)):
            _add(stiffness(x, part), self._place[CHUNK * i :], blocks)
        for axis, place in enumerate(self._filter_place):
            blocks[place, axis, axis] += self._filter(axis).data
        size = x.size
        return sparse.bsr_matrix((blocks, self._indices, self._indptr), shape=(size, size)).tocsr()


class _Stress(NamedTuple):
    """At the points: D, its cofactors, D C (E, Q, 3, 3); mu phi, s, and the factors of k k^T, P k^T + k P^T (E, Q)."""

    D: Array
    cof: Array
    DC: Array
    m: Array
    s: Array
    kk: Array
    Pk: Array


def _stress(x: Array, at: Points) -> _Stress:
    D = x[at.nodes].swapaxes(-1, -2)[:, None] @ at.g
    cof = cofactor(D)
    volume = np.einsum("eqi,eqi->eq", D[..., 0], cof[..., 0])
    J = volume / at.w
    phi, d_phi, d2_phi = at.phi(J)
    DC = D @ at.C
    half_I1 = 0.5 * at.mu * np.einsum("eqri,eqri->eq", D, DC) / at.w
    pressure = at.kappa * (volume @ at.bears / at.V - 1)
    s = at.local * (J - 1) + d_phi * half_I1 + pressure[:, None] * at.bears
    return _Stress(D, cof, DC, at.mu * phi, s, (at.local + d2_phi * half_I1) / at.w, at.mu * d_phi / at.w)


def stiffness(x: Array, at: Points) -> Array:
    """Second derivative (E, K, 3, K, 3) of the energy of elements in the positions of their nodes [Pa mm].

    ``x`` (N, 3) are the positions of all nodes [mm].
    """
    D, cof, DC, m, s, kk, Pk = _stress(x, at)
    n, corners = at.nodes.shape
    g_rows = np.moveaxis(at.g, -2, -3).reshape(*at.g.shape[:-3], corners, -1)       # (..., K, 3 Q)
    g_columns = np.ascontiguousarray(at.g.swapaxes(-1, -2))                         # (..., Q, 3, K)

    def between(M: Array) -> Array:
        """sum_q g_a . M g_b (E, K, K) for M (E, Q, 3, 3)."""
        return g_rows @ (M @ g_columns).reshape(n, -1, corners)

    out = np.empty((n, corners, 3, corners, 3))
    same = between(m[..., None, None] * at.C)
    for r, t, u in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        turn = between(_cross(s[..., None] * D[:, :, r]))
        out[:, :, r, :, r], out[:, :, t, :, u], out[:, :, u, :, t] = same, turn, -turn

    k, P = ((M @ g_columns).swapaxes(-1, -2).reshape(n, -1, 3 * corners) for M in (cof, DC))        # (E, Q, 3 K)
    mean = np.einsum("eqk,q->ek", k, at.bears)[:, None]
    left = np.concatenate([k, P, mean], axis=1)
    right = np.concatenate(
        [kk[..., None] * k + Pk[..., None] * P, Pk[..., None] * k, (at.kappa / at.V)[:, None, None] * mean], axis=1
    )
    return out + (left.swapaxes(-1, -2) @ right).reshape(out.shape)


def cauchy_stress(body: Body, x: Array) -> Array:
    """Mean Cauchy stress (E, 3, 3) of each brick, or patch of tetrahedra, at positions ``x`` (N, 3) [Pa].

    Over the deformed volume v: sum_q (dW/dD) D^T / v, which is the virial of the nodal forces. Tension is positive.
    """
    out = []
    for part in points(body):
        D, cof, DC, m, s, _, _ = _stress(x, part)
        virial = m[..., None, None] * DC + s[..., None, None] * cof
        volume = np.einsum("eqi,eqi,q->e", D[..., 0], cof[..., 0], part.bears)
        out.append((virial @ D.swapaxes(-1, -2)).sum(axis=1) / volume[:, None, None])
    return np.concatenate(out)


def stress_of_elements(body: Body, x: Array) -> Array:
    """:func:`cauchy_stress` of each element (n, 6), xx, yy, zz, xy, yz, xz [Pa]; of tetrahedra that of their patch."""
    stress = cauchy_stress(body, x)[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    if isinstance(body.elements, Bricks):
        return stress
    assert isinstance(body.elements, Tets)
    patch, slot = np.nonzero(body.elements.patches >= 0)
    out = np.empty((body.elements.n, 6))
    out[body.elements.patches[patch, slot]] = stress[patch]
    return out


def _cross(v: Array) -> Array:
    """Matrices (..., 3, 3) with a . M b = v . (a x b)."""
    zero = np.zeros(v.shape[:-1])
    rows = [[zero, v[..., 2], -v[..., 1]], [-v[..., 2], zero, v[..., 0]], [v[..., 1], -v[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@njit(cache=True)
def _add(matrices, place, blocks):
    """Add the 3x3 blocks of element matrices (e, K, 3, K, 3) to ``blocks`` (B, 3, 3) at ``place`` (e, K, K)."""
    for e in range(len(matrices)):
        for a in range(matrices.shape[1]):
            for b in range(matrices.shape[1]):
                block = blocks[place[e, a, b]]
                for r in range(3):
                    for s in range(3):
                        block[r, s] += matrices[e, a, r, b, s]
