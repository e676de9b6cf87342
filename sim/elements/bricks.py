"""The bricks of a body in the layout of the kernels: grown geometry at the Gauss points, moduli, state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import ElementHex1, MappingIsoparametric, MeshHex
from skfem.refdom import RefHex

from morphofold.arrays import Array, Bools
from morphofold.errors import ImpossibleBody
from morphofold.sim.elements import brick_kernels
from morphofold.sim.elements.blocks import Blocks, from_lanes, to_lanes
from morphofold.sim.elements.brick_kernels import LANES, ROWS_PER_POINT
from morphofold.sim.materials import Material
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN

#: skfem's corner numbers in the order 4 i + 2 j + k of the kernels
CORNERS_IN_KERNEL_ORDER = np.argsort(RefHex.p[0] * 4 + RefHex.p[1] * 2 + RefHex.p[2])

#: Gauss points of skfem's brick [0, 1]^3 in the kernels' order 4 i + 2 j + k, and their common weight
GAUSS_POINTS = np.stack(np.meshgrid(*[[0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5]] * 3, indexing="ij")).reshape(3, 8)
GAUSS_WEIGHT = 0.125

BRICKS_PER_CHUNK = 1 << 16  # bricks set up at once, to limit the memory of scikit-fem's mapping


class Bricks:
    """Eight-node Q1P0 bricks; see :mod:`morphofold.sim.elements.brick_kernels` for the energy.

    Parameters
    ----------
    mesh : skfem.MeshHex
    X : (N, 3) float64
        Reference positions of its nodes [mm].
    radial : (N, 3) float64
        Unit thickness direction at the nodes; tangential growth adds nothing along it.
    cortex : (E,) bool
        The bricks of the cortex; they come first.
    mu, kappa : (E,) float64
        Shear modulus, and modulus of the pressure; the bulk modulus of a brick is kappa + 2 mu.
    law : {"isotropic", "tangential"}
    material : Material

    Raises
    ------
    ImpossibleBody
        If bricks are inside out.
    """

    LOCAL = 2.0  # modulus of the local volumetric term over mu; see the energy in kernels
    LARGEST_J = 8.0

    def __init__(
        self,
        mesh: MeshHex,
        X: Array,
        radial: Array,
        cortex: Bools,
        mu: Array,
        kappa: Array,
        law: str,
        material: Material = NEO_HOOKEAN,
    ):
        self.n, self.n_cortex, self.law, self.material = mesh.nelements, int(cortex.sum()), law, material
        corners = mesh.t[CORNERS_IN_KERNEL_ORDER].T
        self.blocks = Blocks(corners, len(X))
        n_blocks = self.blocks.count
        self._grown = -(-self.n_cortex // LANES)  # leading blocks that hold cortex
        self.point = np.empty((n_blocks, 8 * ROWS_PER_POINT * LANES))
        self._radial = np.empty((self._grown, 24 * LANES)) if law == "tangential" else np.empty((0, 0))
        self.volume = np.empty(self.n)
        moved = MeshHex(np.ascontiguousarray(X.T), mesh.t, validate=False)
        mapping = MappingIsoparametric(moved, ElementHex1())
        for start in range(0, self.n, BRICKS_PER_CHUNK):
            tind = np.arange(start, min(start + BRICKS_PER_CHUNK, self.n))
            self._set_up(mapping, tind, radial[mesh.t[:, tind]])
        self._point0 = self.point[: self._grown].copy()
        moduli = to_lanes(np.column_stack([mu, kappa, 1 / self.volume]), n_blocks)
        moduli.reshape(n_blocks, 3, LANES)[-1, :2, self.n - (n_blocks - 1) * LANES :] = 0.0
        self.modulus = moduli
        self._state = np.zeros((n_blocks, 4 * LANES))
        self._stiffness = np.zeros(len(self.blocks.nodes))

    def _set_up(self, mapping: MappingIsoparametric, tind: NDArray[np.int64], radial: Array) -> None:
        """Compute point data of the bricks ``tind``; ``radial`` (8, chunk, 3): directions at their corners."""
        inv = mapping.invDF(GAUSS_POINTS, tind)  # (3, 3, chunk, 8): dxi_i/dX_j in [0, 1]^3
        det = mapping.detDF(GAUSS_POINTS, tind)  # (chunk, 8)
        if det.min() <= 0:
            bad = np.flatnonzero(det.min(axis=1) <= 0)
            raise ImpossibleBody(
                f"at least {len(bad)} of {self.n:,} bricks are inside out before growth, the first is "
                f"{tind[bad[0]]}; reduce effects.perturbation.amplitude or effects.notch.depth."
            )
        w = det * GAUSS_WEIGHT
        C = np.einsum("ijeq,kjeq,eq->eqik", inv, inv, 4 * w)  # 4: parent brick [-1, 1]^3
        data = np.empty((len(tind), 8, ROWS_PER_POINT))
        data[..., :3], data[..., 3:5], data[..., 5] = C[..., 0, :], C[..., 1, 1:], C[..., 2, 2]
        data[..., 6] = 1 / w
        self.volume[tind] = w.sum(axis=1)
        block = slice(tind[0] // LANES, -(-(tind[-1] + 1) // LANES))
        self.point[block] = to_lanes(data.reshape(len(tind), -1), block.stop - block.start)
        if self.law == "tangential" and block.start < self._grown:
            shape = np.stack([ElementHex1().lbasis(GAUSS_POINTS, i)[0] for i in range(8)])
            normal = np.einsum("iq,iej->jeq", shape, radial)
            normal /= np.linalg.norm(normal, axis=0)
            n = np.einsum("ijeq,jeq,eq->eqi", inv, normal, 2 * np.sqrt(w))
            lanes = to_lanes(n.reshape(len(n), -1), block.stop - block.start)
            self._radial[block] = lanes[: self._grown - block.start]

    def grow(self, cortex: Array, core: float = 1.0) -> None:
        """Set the growth stretch of each brick of the cortex (n_cortex,), and the isotropic growth of the core."""
        if core != 1.0 and len(self._point0) < self.blocks.count:  # ungrown data are kept only if the core grows
            self._point0 = np.concatenate([self._point0, self.point[self._grown :]])
        blocks = len(self._point0)
        flat = np.full(blocks * LANES, core)
        flat[: self.n_cortex] = cortex
        stretch = flat.reshape(blocks, LANES)
        tangential, k = self.law == "tangential", self._grown
        brick_kernels.grow(self.point[:k], self._point0[:k], self._radial, self.modulus[:k], stretch[:k], tangential)
        if blocks > k:
            brick_kernels.grow(self.point[k:], self._point0[k:], self._radial[:0], self.modulus[k:], stretch[k:], False)
            mixed = self.n_cortex % LANES
            if tangential and mixed:  # the core's lanes in the last cortex block
                last = slice(k - 1, k)
                point, modulus = self.point[last].copy(), self.modulus[last].copy()
                brick_kernels.grow(point, self._point0[last], self._radial[:0], modulus, stretch[last], False)
                for mine, core_s in ((self.point, point), (self.modulus, modulus)):
                    mine[k - 1].reshape(-1, LANES)[:, mixed:] = core_s.reshape(-1, LANES)[:, mixed:]

    def make_single(self) -> None:
        """Compute forces in 32 bits from now on: ``point`` and ``modulus`` get 32 bits; positions and sums keep 64."""
        self.point, self.modulus = self.point.astype(np.float32), self.modulus.astype(np.float32)

    def compute_forces(self, x: Array) -> None:
        """Write forces at positions ``x`` (N, 3) into ``blocks.force``."""
        b = self.blocks
        brick_kernels.element_forces(x, b.nodes, b.start, b.local, self.point, self.modulus, b.force, self.material)

    def measure(self, x: Array) -> Array:
        """Measure the bricks at ``x``; returns nodal sums (N,) of a bound on their stiffness."""
        b = self.blocks
        brick_kernels.element_state(
            x, b.nodes, b.start, b.local, self.point, self.modulus, self._state, self._stiffness, self.material
        )
        return b.nodal_sums(self._stiffness)

    def state(self) -> dict[str, Array]:
        """Per brick, from the last ``measure``: energy, J_min, J_max, volume_ratio; (E,) each."""
        columns = from_lanes(self._state, self.n)
        return {"energy": columns[:, 0], "J_min": columns[:, 1], "J_max": columns[:, 2], "volume_ratio": columns[:, 3]}
