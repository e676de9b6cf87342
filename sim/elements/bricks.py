"""The bricks of a body in the layout of the kernels: grown geometry at the Gauss points, moduli, state."""

import numpy as np
from numpy.typing import NDArray
from skfem import ElementHex1, MappingIsoparametric, MeshHex
from skfem.refdom import RefHex

from morphofold.errors import ImpossibleBody
from morphofold.frozen_arrays import Array, Bools
from morphofold.sim.elements import brick_kernels, growth_by_stress
from morphofold.sim.elements.blocks import Columns, Summary, lanes_of, summary_of
from morphofold.sim.elements.brick_kernels import ROWS_PER_POINT
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.materials import Material
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN

#: skfem's corner numbers in the order 4 i + 2 j + k of the kernels
CORNERS_IN_KERNEL_ORDER = np.argsort(RefHex.p[0] * 4 + RefHex.p[1] * 2 + RefHex.p[2])

#: Gauss points of skfem's brick [0, 1]^3 in the kernels' order 4 i + 2 j + k, and their common weight
GAUSS_POINTS = np.stack(np.meshgrid(*[[0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5]] * 3, indexing="ij")).reshape(3, 8)
GAUSS_WEIGHT = 0.125

BLOCKS_PER_CHUNK = 1 << 11  # blocks set up at once, to limit the memory of scikit-fem's mapping


class Bricks:
    """Eight-node Q1P0 bricks; see :mod:`morphofold.sim.elements.brick_kernels` for the energy.

    Parameters
    ----------
    mesh : skfem.MeshHex
        Layers of bricks under a surface of quads, as :class:`morphofold.sim.elements.blocks.Columns` numbers them.
    X : (N, 3) float64
        Reference positions of its nodes [mm].
    radial : (N, 3) float64
        Unit thickness direction at the nodes; tangential growth adds nothing along it.
    cortex : (E,) bool
        The bricks of the cortex: the first layers.
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
    MODULUS_RATIO = 2.0  # kappa over the modulus that acts at once, once it is split

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
        self.corners = mesh.t[CORNERS_IN_KERNEL_ORDER].T
        self.blocks = blocks = Columns(self.corners, len(X))
        self._layout = blocks.nodes, blocks.start, blocks.local, blocks.layers
        in_cortex = cortex[blocks.element[:, 0]]
        self._cortex, self._core = np.flatnonzero(in_cortex), np.flatnonzero(~in_cortex)
        self.point = np.empty((blocks.count, 8 * ROWS_PER_POINT * LANES))
        radials = np.empty((blocks.count if law == "tangential" else 0, 24 * LANES))
        self.volume = np.empty(self.n)
        reference_mesh = MeshHex(np.ascontiguousarray(X.T), mesh.t, validate=False)
        mapping = MappingIsoparametric(reference_mesh, ElementHex1())
        for start in range(0, blocks.count, BLOCKS_PER_CHUNK):
            self._set_up(mapping, slice(start, min(start + BLOCKS_PER_CHUNK, blocks.count)), radial, mesh.t, radials)
        self._cortex0 = self.point[self._cortex]
        self._core0: Array | None = None
        self._radial = radials[self._cortex] if law == "tangential" else radials
        self.modulus = np.column_stack([blocks.moduli(mu, kappa, 1 / self.volume), np.zeros((blocks.count, LANES))])
        self._rest_ratio = 0.0  # modulus whose pressure follows, over the one that acts at once
        self._state = np.ones((blocks.count, 4 * LANES))
        self._stiffness = np.zeros(len(blocks.nodes))

    def _set_up(
        self, mapping: MappingIsoparametric, blocks: slice, radial: Array, nodes: NDArray[np.int64], radials: Array
    ) -> None:
        """Compute the point data of ``blocks`` and, for tangential growth, the radial directions at their points."""
        bricks = self.blocks.element[blocks].ravel()
        inverse_jacobian = mapping.invDF(GAUSS_POINTS, bricks)  # (3, 3, chunk, 8): dxi_i/dX_j in [0, 1]^3
        det_jacobian = mapping.detDF(GAUSS_POINTS, bricks)  # (chunk, 8)
        if det_jacobian.min() <= 0:
            inverted = np.unique(bricks[det_jacobian.min(axis=1) <= 0])
            raise ImpossibleBody(
                f"at least {len(inverted)} of {self.n:,} bricks are inside out before growth, the first is "
                f"{inverted[0]}; reduce effects.perturbation.amplitude or effects.notch.depth."
            )
        dV = det_jacobian * GAUSS_WEIGHT
        C = np.einsum("ijeq,kjeq,eq->eqik", inverse_jacobian, inverse_jacobian, 4 * dV)  # 4: parent brick [-1, 1]^3
        point_data = np.empty((len(bricks), 8, ROWS_PER_POINT))
        row, column = np.triu_indices(3)
        point_data[..., :6], point_data[..., 6] = C[..., row, column], 1 / dV
        self.volume[bricks] = dV.sum(axis=1)
        self.point[blocks] = lanes_of(point_data.reshape(-1, LANES, 8 * ROWS_PER_POINT))
        if self.law == "tangential":
            shape_values = np.stack([ElementHex1().lbasis(GAUSS_POINTS, i)[0] for i in range(8)])
            point_normals = np.einsum("iq,iej->jeq", shape_values, radial[nodes[:, bricks]])
            point_normals /= np.linalg.norm(point_normals, axis=0)
            point_n = np.einsum("ijeq,jeq,eq->eqi", inverse_jacobian, point_normals, 2 * np.sqrt(dV))
            radials[blocks] = lanes_of(point_n.reshape(-1, LANES, 24))

    def grow(self, g: Array, core_g: float = 1.0, thickness: Array | None = None) -> None:
        """Set the growth stretch ``g`` of each brick of the cortex (n_cortex,), and the isotropic growth of the core.

        ``thickness`` (n_cortex,): growth stretch along the thickness, if the law is tangential; 1 by default.
        """
        is_tangential, empty = self.law == "tangential", np.empty((0, LANES))
        stretch = g[self.blocks.element[self._cortex]]
        along_stretch = empty if thickness is None else thickness[self.blocks.element[self._cortex]]
        brick_kernels.grow(
            self.point, self._cortex0, self._radial, self.modulus, stretch, self._cortex, is_tangential, along_stretch
        )
        if core_g != 1.0 and self._core0 is None:  # ungrown data are kept only if the core grows
            self._core0 = self.point[self._core]
        if self._core0 is not None:
            stretch = np.full((len(self._core), LANES), core_g)
            brick_kernels.grow(self.point, self._core0, self._radial, self.modulus, stretch, self._core, False, empty)

    @property
    def core_volumes(self) -> Array:
        """Reference volume of each part of the core that has a growth tensor of its own: its bricks [mm^3]."""
        return self.volume[self.n_cortex :]

    def grow_by_stress(self, x: Array, X: Array, G: Array, rate: float, grows_volume: bool = True) -> None:
        """Let the bricks of the core grow by their stress, and set them to their growth tensors.

        Parameters
        ----------
        x, X : (N, 3) float64
            Positions, deformed and before growth [mm].
        G : (n_core, 3, 3) float64
            Growth tensors; each becomes exp(L) G, to second order in L = ``rate`` M / mu; M is its mean Mandel stress.
        rate : float
            0 to set the bricks to G as it is.
        grows_volume : bool
            Whether the volume grows too; if not, L is without its trace.
        """
        layers = len(self._cortex) // len(self.blocks.local)
        core_layout = layers, self.blocks.element, self.n_cortex, self.point, self.modulus
        growth_by_stress.grow_bricks(x, X, *self._layout, *core_layout, G, rate, grows_volume, self.material)

    def make_single(self) -> None:
        """Compute forces in 32 bits from now on: points and moduli get 32 bits; positions and sums keep 64."""
        self.point, self.modulus = self.point.astype(np.float32), self.modulus.astype(np.float32)
        self._cortex0, self._radial = self._cortex0.astype(np.float32), self._radial.astype(np.float32)

    @property
    def is_split(self) -> bool:
        """Whether only a part of kappa acts at once, 1 over ``MODULUS_RATIO``, and the pressure of the rest follows.

        Volume waves are slower then, so steps are longer. Nothing changes at rest. See :meth:`compute_forces`.
        """
        return self._rest_ratio > 0

    def split_bulk(self, split: bool) -> None:
        """Change whether the bulk modulus is split; the pressures are those of the last ``measure``."""
        self.modulus[:, LANES : 2 * LANES] *= 1 / self.MODULUS_RATIO if split else self.MODULUS_RATIO
        self._rest_ratio = self.MODULUS_RATIO - 1 if split else 0.0
        self.set_pressures(self._state[:, 3 * LANES :])

    @property
    def pressures(self) -> Array:
        """The pressures that follow, (block, LANES): a view."""
        return self.modulus[:, 3 * LANES :]

    def set_pressures(self, volume_ratio: Array) -> None:
        """Set the pressures that follow to those of the volume ratios v/V of the bricks (block, LANES)."""
        self.pressures[:] = self._rest_ratio * self.modulus[:, LANES : 2 * LANES] * (volume_ratio - 1)

    def compute_forces(self, x: Array, follow: float = 0.0) -> None:
        """Write forces at positions ``x`` (N, 3) into ``blocks.force``; then move the pressures that follow by a share
        ``follow`` towards their values at x."""
        data = self.point, self.modulus, *np.array([self._rest_ratio, follow], self.modulus.dtype)
        brick_kernels.element_forces(x, *self._layout, *data, self.blocks.force, self.material)

    def measure(self, x: Array) -> Array:
        """Measure the bricks at ``x``; returns nodal sums (N,) of a bound on their stiffness."""
        data, outputs = (self.point, self.modulus, self._rest_ratio), (self._state, self._stiffness)
        brick_kernels.element_state(x, *self._layout, *data, *outputs, self.material)
        return self.blocks.nodal_sums(self._stiffness)

    def lagging_energy(self) -> float:
        """What the energy of the last ``measure`` lacks of that of which the forces are the gradient, while the
        pressures that follow stay as they are."""
        strain = self._state[:, 3 * LANES :] - 1
        lag = self.pressures - 0.5 * self._rest_ratio * self.modulus[:, LANES : 2 * LANES] * strain
        return float(np.sum(lag * strain / self.modulus[:, 2 * LANES : 3 * LANES], where=~self.blocks.filler))

    def summary(self) -> Summary:
        """Numbers of all bricks, from the last ``measure``."""
        energy, J_min, J_max, volume_ratio = self._state.reshape(-1, 4, LANES).swapaxes(0, 1)
        return summary_of(energy, J_min, J_max, volume_ratio, ~self.blocks.filler)

    def state(self) -> dict[str, Array]:
        """Per brick, from the last ``measure``: energy, J_min, J_max, volume_ratio; (E,) each."""
        return dict(zip(("energy", "J_min", "J_max", "volume_ratio"), self.blocks.from_lanes(self._state).T))
