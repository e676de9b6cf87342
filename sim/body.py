"""The body in the form that the kernels read: blocks of bricks, their grown geometry, and who gathers what."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import ElementHex1, MappingIsoparametric

from morphofold.sim import kernels
from morphofold.sim.kernels import POINT, WIDTH
from morphofold.sim.mesh import BINARY_CORNERS, Bilayer

Array = NDArray[np.float64]

#: Gauss points of skfem's brick [0, 1]^3 in the kernels' order 4 i + 2 j + k, and their common weight
GAUSS = np.stack(np.meshgrid(*[[0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5]] * 3, indexing="ij")).reshape(3, 8)
GAUSS_WEIGHT = 0.125

FILTER = 3.0            # strength of the surface filter, in units of mu times edge length
SAFETY = 1.5            # nodal mass over the least that keeps a step of one stable


def to_lanes(values: NDArray, n_blocks: int) -> NDArray:
    """(E, rows) per element to (block, rows * WIDTH) with the lane fastest; the last lanes repeat an element."""
    padded = np.concatenate([values, np.repeat(values[-1:], n_blocks * WIDTH - len(values), axis=0)])
    return np.ascontiguousarray(padded.reshape(n_blocks, WIDTH, -1).transpose(0, 2, 1).reshape(n_blocks, -1))


def from_lanes(values: NDArray, n_elements: int) -> NDArray:
    """(block, rows * WIDTH) back to (E, rows)."""
    n_blocks = len(values)
    return values.reshape(n_blocks, -1, WIDTH).transpose(0, 2, 1).reshape(n_blocks * WIDTH, -1)[:n_elements]


class Body:
    """A bilayer under growth: reference positions ``X``, forces, energy, and the mass that makes a step stable.

    Parameters
    ----------
    bilayer : Bilayer
        Geometry; its first elements are the cortex, its first nodes the pial surface.
    mu_cortex, mu_core, kappa : float
        Shear moduli, and one bulk modulus for both layers [Pa, or units of mu_core].
    law : {"isotropic", "tangential"}
        Growth law of the cortex.
    X : (N, 3) float64, optional
        Reference positions when they are not the mesh's own (a perturbed body) [mm].
    """

    def __init__(
        self, bilayer: Bilayer, *, mu_cortex: float, mu_core: float, kappa: float, law: str, X: Array | None = None
    ):
        self.bilayer, self.law = bilayer, law
        mesh = bilayer.mesh
        self.X: Array = np.ascontiguousarray(mesh.p.T if X is None else X, dtype=np.float64)
        n_elements, n_nodes = mesh.nelements, mesh.nvertices
        self.n_elements, self.n_cortex = n_elements, len(mesh.subdomains["cortex"])
        n_blocks = -(-n_elements // WIDTH)
        binary = mesh.t[BINARY_CORNERS].T
        self.conn = to_lanes(binary.astype(np.int32), n_blocks)

        moved = mesh if X is None else type(mesh)(np.ascontiguousarray(self.X.T), mesh.t)
        mapping = MappingIsoparametric(moved, ElementHex1())
        inv = mapping.invDF(GAUSS)                                     # (3, 3, E, 8): dxi_i/dX_j in [0, 1]^3
        det = mapping.detDF(GAUSS)                                      # (E, 8)
        if det.min() <= 0:
            raise ValueError(
                f"{(det.min(axis=1) <= 0).sum()} of {n_elements} bricks are inside out before anything grows; "
                "make effects.perturbation.amplitude smaller."
            )
        volume = det * GAUSS_WEIGHT
        C = 4 * np.einsum("ijeq,kjeq->eqik", inv, inv)                 # 4: parent brick [-1, 1]^3
        data = np.empty((n_elements, 8, POINT))
        data[..., :3], data[..., 3:5], data[..., 5] = C[..., 0, :], C[..., 1, 1:], C[..., 2, 2]
        data[..., 6] = volume
        self.point0 = to_lanes(data.reshape(n_elements, -1), n_blocks)
        self.point = self.point0.copy()
        self._grown_blocks = -(-self.n_cortex // WIDTH)
        at = mapping.F(GAUSS)[:, : self._grown_blocks * WIDTH]
        normal = at / np.linalg.norm(at, axis=0)
        n = 2 * np.einsum("ijeq,jeq->eqi", inv[:, :, : self._grown_blocks * WIDTH], normal)
        self.radial = to_lanes(n.reshape(len(n), -1), self._grown_blocks)

        mu = np.full(n_elements, mu_core)
        mu[: self.n_cortex] = mu_cortex
        self.mu, self.kappa = mu, np.full(n_elements, kappa)
        moduli = to_lanes(np.column_stack([self.mu, self.kappa]), n_blocks)
        moduli.reshape(n_blocks, 2, WIDTH)[-1, :, n_elements - (n_blocks - 1) * WIDTH :] = 0.0
        self.modulus = moduli

        self.force, self.state = np.zeros((n_blocks, 24 * WIDTH)), np.zeros((n_blocks, 5 * WIDTH))
        order = np.argsort(binary.ravel(), kind="stable")              # (element, corner) pairs, node by node
        element, corner = np.divmod(order, 8)
        block, lane = np.divmod(element, WIDTH)
        self.first = np.concatenate([[0], np.cumsum(np.bincount(binary.ravel(), minlength=n_nodes))])
        self.slots = block * 24 * WIDTH + 3 * corner * WIDTH + lane
        self.state_slots = block * 5 * WIDTH + 4 * WIDTH + lane

        self.free = np.ones((n_nodes, 3))
        self.free[np.unique(mesh.facets[:, mesh.boundaries["hole"]])] = 0.0
        self.on_plane = np.zeros((n_nodes, 3), dtype=bool)
        for axis in bilayer.planes:
            self.on_plane[np.unique(mesh.facets[:, mesh.boundaries[f"plane{axis}"]]), axis] = True
        self.free[self.on_plane] = 0.0

        self.mass = np.ones(n_nodes)
        self.growth = 1.0
        self.rest = np.zeros((n_nodes, 3))
        self.rest = self.forces(self.X)                                # round-off only; see kernels.advance
        self.filter = SurfaceFilter(self, FILTER * mu_cortex)

    @property
    def n_surface(self) -> int:
        return self.bilayer.n_surface

    def grow(self, g: float) -> None:
        """Set the growth stretch of the whole cortex to ``g``."""
        stretch = np.ones((self._grown_blocks, WIDTH))
        stretch.ravel()[: self.n_cortex] = g
        kernels.grow(self.point, self.point0, self.radial, stretch, self.law == "tangential")
        self.growth = g

    def element_forces(self, x: Array) -> None:
        """Element forces at positions ``x`` (N, 3) into ``self.force``."""
        kernels.element_forces(x, self.conn, self.point, self.modulus, self.force)

    def forces(self, x: Array) -> Array:
        """Nodal forces (N, 3) of the elements at positions ``x``: minus the energy gradient."""
        self.element_forces(x)
        out = np.empty_like(x)
        kernels.gather(self.force.ravel(), self.first, self.slots, out)
        return out - self.rest

    def update_state(self, x: Array) -> None:
        """Measure energies, volume ratios and stiffness of the elements at ``x``, and from them the nodal mass."""
        kernels.element_state(x, self.conn, self.point, self.modulus, self.state)
        kernels.gather_scalar(self.state.ravel(), self.first, self.state_slots, self.mass)
        self.mass *= 0.25 * SAFETY                                     # a step of one is stable if K <= 4 M
        self.filter.update(x)
        self.mass[: self.n_surface] += 0.25 * SAFETY * self.filter.stiffness

    def element_state(self) -> dict[str, Array]:
        """Per element, from the last ``update_state``: energy, J_min, J_max, volume_ratio; (E,) each."""
        columns = from_lanes(self.state, self.n_elements)
        return {"energy": columns[:, 0], "J_min": columns[:, 1], "J_max": columns[:, 2], "volume_ratio": columns[:, 3]}


class SurfaceFilter:
    """A weak fourth-order stiffness of the pial surface against zigzags of the size of one cell.

    Energy ``c h/2 sum_i |(L L u)_i|^2`` with u = x - X, L u the mean of the grid neighbours minus the node and h the
    present cell size. It is of order h^4 for a smooth surface and stops the saw-teeth that bricks under
    extreme compression fall into. Rows at and beside symmetry planes are left out.
    """

    def __init__(self, body: Body, strength: float):
        quads, n = body.bilayer.quads, body.n_surface
        pairs = np.concatenate([quads[:, [0, 1]], quads[:, [1, 2]], quads[:, [2, 3]], quads[:, [3, 0]]])
        pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
        adjacency = sparse.csr_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
        L = sparse.diags(1 / adjacency.sum(axis=1).A1) @ adjacency - sparse.identity(n)
        cut = body.on_plane[:n].any(axis=1)
        keep = ~(cut | (adjacency @ cut > 0))
        self._LL = sparse.csr_matrix(sparse.diags(keep.astype(float)) @ L @ L)
        B = sparse.csr_matrix(self._LL.T @ self._LL)
        self._matrix = B.indptr, B.indices, B.data
        self._row_sum = np.asarray(abs(B).sum(axis=1)).ravel()
        self._quads, self._strength = quads, strength
        self._X = body.X[:n].copy()
        self._out = np.zeros((n, 3))
        self.update(self._X)

    def update(self, x: Array) -> None:
        """Refresh the cell size h from positions ``x`` (N, 3)."""
        p = x[self._quads]
        area = 0.5 * np.linalg.norm(np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]), axis=1).sum()
        self.h = float(np.sqrt(area / len(self._quads)))

    @property
    def stiffness(self) -> Array:
        """Row sums of the filter's stiffness matrix (S,), an upper bound of its eigenvalues."""
        return self._strength * self.h * self._row_sum

    def forces(self, x: Array) -> Array:
        """Forces (S, 3) on the surface nodes at positions ``x`` (N, 3)."""
        n = len(self._X)
        kernels.sparse_rows(*self._matrix, x[:n] - self._X, self._out)
        self._out *= -self._strength * self.h
        return self._out

    def energy(self, x: Array) -> float:
        """Energy of the filter at positions ``x``."""
        bent = self._LL @ (x[: len(self._X)] - self._X)
        return 0.5 * self._strength * self.h * float(np.sum(bent**2))
