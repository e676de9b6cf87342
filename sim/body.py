"""The growing body, a cortex on a core: elements, supports, surface filter, and the mass that keeps a step stable."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal
from skfem import MeshHex

from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.frozen_arrays import Array, Bools
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.surface_filter import SurfaceFilter
from morphofold.sim.elements.tets import Tets
from morphofold.sim.growth_laws import check_law, volume as det_G
from morphofold.sim.materials import Material
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.multilevel_acceleration import CoarseLevels

#: strength of the surface filter in units of mu times cell size, for quads and triangles
FILTER_STRENGTH = {4: 2.0, 3: 1.0}
#: stiffness over mass of the fastest wave before growth, in a step of one, in cortex and core; 4 is the limit of
#: stability. Folds raise it by a third in the cortex, and by a half in the core; near 3 runs burst (docs/solver.md).
CORTEX_WAVE, CORE_WAVE = 2.45, 1.65
#: nodal mass over the bound that is sufficient for any element: the least in cortex and core, and the largest
LEAST_CORTEX_MASS, LEAST_CORE_MASS, LARGEST_MASS = 0.8, 1.2, 1.5
PIAL_MASS_OVER_CORTEX = 1.125  # the filter adds its own waves
FASTEST_WAVE = 2.7  # before growth, with coarse levels: they add less if it is faster
#: largest mu ratio with a split bulk modulus: a patch with 30 wrinkles in waves 11 % too short with one; least kappa
#: ratio: with 12.5 the smallest J falls to half of what it is without; largest growth: a strip burst at 2.7
MOST_SPLIT_RATIO, LEAST_SPLIT_KAPPA, MOST_SPLIT_GROWTH = 5.0, 25.0, 2.25
WAVE_ITERATIONS = 20  # of the search for the fastest wave
MASS_ROUNDING = 0.05  # masses are rounded up to this: so a sphere and its octants, and a turned body, have the same


class Body:
    """A bilayer under growth.

    Parameters
    ----------
    bilayer : Bilayer
        Geometry; its first elements are the cortex, its first nodes the pial surface.
    mu_cortex, mu_core : float
        Shear moduli [Pa, or units of mu_core].
    kappa_ratio : float
        Bulk over shear modulus in each layer; more than 2 (the part of the elements' local term).
    law : {"isotropic", "tangential"}
        Growth law of the cortex.
    X : (N, 3) float64, optional
        Reference positions if they differ from the mesh's (a perturbed body) [mm].
    material : Material
        Material of both layers, each with its own moduli; neo-Hookean by default.
    stiffness : float or (E,) float64
        Factor on the moduli of each element.
    thickening : callable, optional
        Growth stretch along the thickness (n_cortex,) from that along the surface (n_cortex,), for tangential growth; 1
        by default.
    single : bool
        Compute the forces of bricks in 32 bits (docs/solver.md, "Single precision"); tetrahedra always use 64.
    split_bulk : bool
        Let half of the bulk modulus of bricks act at once, and the pressure of the rest follow (docs/solver.md, "Split
        bulk modulus"); not if the cortex is softer than the core anywhere, or more than ``MOST_SPLIT_RATIO`` times as
        stiff, or for a kappa ratio below ``LEAST_SPLIT_KAPPA``. Forces depend on more than positions then.

    Attributes
    ----------
    pattern : float or (n_cortex,) float64
        Share of the growth g - 1 of each element of the cortex; 1 unless an effect sets it.
    changing : list of callable
        Factors on ``pattern`` that depend on growth: each returns (n_cortex,) at a growth g.
    core_share : float
        Share of the growth of the core, which is isotropic; 0 unless an effect sets it.
    added_stiffness : list of callable
        Bounds on the stiffness that effects add inside the body: each returns nodal sums (N,) at a growth g.
    viscosity : float
        Damping ratio of the fastest waves for which the mass is computed; 0 unless an effect sets it.
    cell : float
        Size of a cell of the pial surface at the last measurement: the root of the mean cell area, with two triangles
        per cell [mm].
    mass : (N,) float64
        Nodal mass with which a step of length 1 is stable: a factor times what the bounds on the stiffness require,
        which are too large themselves. The cortex has less than the core, because its mass is the clock.
    levels : CoarseLevels
        Coarse levels, on which forces act once more; ``smooth_mass`` (N,) is the mass with which smooth motions move.
    thickness : float
        Thickness of the ungrown cortex: its volume over its area [mm].
    crossing : float
        Steps in which a shear wave crosses the cortex, with this mass, before growth. Growth rate and damping are
        measured in this unit of time (a tick), so they are the same on every mesh.
    """

    def __init__(
        self,
        bilayer: Bilayer,
        *,
        mu_cortex: float,
        mu_core: float,
        kappa_ratio: float,
        law: str,
        X: Array | None = None,
        single: bool = False,
        split_bulk: bool = False,
        material: Material = NEO_HOOKEAN,
        stiffness: Array | float = 1.0,
        thickening: Callable[[Array], Array] | None = None,
    ):
        check_law(law)
        if not kappa_ratio > 2:
            raise OutOfRange(f"kappa_ratio must be more than 2, got {kappa_ratio:g}.")
        if thickening is not None and law != "tangential":
            raise DoesNotApply(f"thickening applies to tangential growth only; the law is {law}.")
        self.bilayer, self.law, self.thickening = bilayer, law, thickening
        mesh = bilayer.mesh
        self.X = np.ascontiguousarray(mesh.p.T if X is None else X, dtype=np.float64)
        is_cortex = np.zeros(mesh.nelements, dtype=bool)
        is_cortex[mesh.subdomains["cortex"]] = True
        self.mu = np.where(is_cortex, mu_cortex, mu_core) * stiffness
        element_class = Bricks if isinstance(mesh, MeshHex) else Tets
        self.kappa = (kappa_ratio - element_class.LOCAL) * self.mu  # the local term contributes the rest
        self.elements = element_class(mesh, self.X, bilayer.radial, is_cortex, self.mu, self.kappa, law, material)
        is_compared = mu_core <= self.mu[is_cortex].min() and self.mu[is_cortex].max() <= MOST_SPLIT_RATIO * mu_core
        self._can_split, self.single = split_bulk and bool(is_compared) and kappa_ratio >= LEAST_SPLIT_KAPPA, False
        self.split_bulk(True)
        if single and isinstance(self.elements, Bricks):
            self.elements.make_single()
            self.single = True
        self.on_plane = np.zeros(self.X.shape, dtype=bool)
        for plane in bilayer.planes:
            self.on_plane[:, plane.axis] |= mesh.p[plane.axis] == plane.at
        self.free = ~self.on_plane
        self.free[bilayer.held] = False
        self.pattern: float | Array = 1.0
        if bilayer.growing is not None:
            self.pattern = bilayer.growing[mesh.t[:, : self.elements.n_cortex]].mean(axis=0)
        self.changing: list[Callable[[float], Array]] = []
        self.added_stiffness: list[Callable[[float], Array]] = []
        self.core_share, self.growth, self.viscosity = 0.0, 1.0, 0.0
        self.find_rest()
        pial_area = surface_area(self.X, bilayer.faces)
        filter_strength = FILTER_STRENGTH[bilayer.faces.shape[1]] * mu_cortex
        self.filter = SurfaceFilter(bilayer, self.X, filter_strength, self._cell_of(pial_area))
        self.thickness = float(self.elements.volume[: self.elements.n_cortex].sum() / pial_area)
        is_cortex_node = bilayer.share > 0
        self._ungrown_bound = self._bound = self._stiffness_bound(self.X)
        self._mass_factor = self._mass_factors(is_cortex_node)
        self.levels = CoarseLevels(bilayer, self.X, self.free, self.thickness)
        self.update_state(self.X)
        self._limit_levels()
        cortex_density = self.smooth_mass[is_cortex_node].sum() / self.nodal_volumes()[is_cortex_node].sum()
        self.crossing = float(self.thickness * np.sqrt(cortex_density / mu_cortex))

    def __repr__(self) -> str:
        return f"Body({len(self.X):,} nodes, {self.n_surface:,} on the pial surface, cortex {self.thickness:.3g} mm)"

    @property
    def n_surface(self) -> int:
        return self.bilayer.n_surface

    @property
    def smooth_mass(self) -> Array:
        """Mass (N,) with which smooth motions move."""
        return self.mass / self.levels.lightness

    def kinetic_energy(self, v: Array) -> float:
        """Kinetic energy of a smooth motion with velocities ``v`` (N, 3)."""
        return 0.5 * float(np.sum(self.smooth_mass * np.einsum("ij,ij->i", v, v)))

    def _mass_factors(self, cortex: Bools) -> Array:
        """Mass of each node (N,) over the bound: as little as the fastest waves of cortex and core allow."""
        mass_over_bound, mass_bound = np.empty(len(self.X)), 0.25 * self._ungrown_bound
        for layer, least, max_w2 in ((cortex, LEAST_CORTEX_MASS, CORTEX_WAVE), (~cortex, LEAST_CORE_MASS, CORE_WAVE)):
            needed_factor = MASS_ROUNDING * math.ceil(self.fastest_wave(layer, mass_bound) / max_w2 / MASS_ROUNDING)
            mass_over_bound[layer] = min(max(needed_factor, least), LARGEST_MASS)
        mass_over_bound[: self.n_surface] *= PIAL_MASS_OVER_CORTEX
        return mass_over_bound

    def _limit_levels(self) -> None:
        """Let the coarse levels add only so much that no wave is faster than ``FASTEST_WAVE``."""
        all_nodes = np.ones(len(self.X), dtype=bool)
        for level_scale in (1.0, 0.5, 0.5):
            self.levels.scale(level_scale)
            self.update_levels()
            if self.levels.lightness == 1 or self.fastest_wave(all_nodes, self.mass, self.levels) <= FASTEST_WAVE:
                return
        self.levels.remove()

    def fastest_wave(self, nodes: Bools, mass: Array, levels: CoarseLevels | None = None) -> float:
        """Stiffness over mass of the fastest wave that moves ``nodes`` (N,) alone, with ``mass`` (N,) [1/step^2].

        Of the ungrown body, with coarse levels if they are given; a step of one is stable below 4.

        By Lanczos's method, with differences of forces; from below, by less than 0.5 %. 0 if these nodes are held.
        """
        is_movable = self.free & nodes[:, None]
        if not is_movable.any():
            return 0.0
        v = np.random.default_rng(0).standard_normal((len(self.X), 1)) * self.bilayer.radial * is_movable
        previous_v, diagonal, off_diagonal = np.zeros(v.shape), [], []
        for _ in range(WAVE_ITERATIONS):
            trial_length = 1e-4 * self.filter.cell / float(np.abs(v).max())
            Kv = -self.all_forces(self.X + trial_length * v) * is_movable / trial_length  # X is without forces
            norm = float(np.sum(v * Kv)) ** 0.5  # the inner product is that of the stiffness
            v, Kv = v / norm, Kv / norm
            acceleration = (Kv / mass[:, None] if levels is None else levels.accelerations(Kv, mass)) * is_movable
            off_diagonal.append(norm)
            diagonal.append(float(np.sum(Kv * acceleration)))
            previous_v, v = v, acceleration - diagonal[-1] * v - (norm * previous_v if len(diagonal) > 1 else 0.0)
        return float(eigh_tridiagonal(diagonal, off_diagonal[1:], eigvals_only=True)[-1])

    def nodal_volumes(self) -> Array:
        """Reference volume of each node (N,) [mm^3]: equal parts of its elements' volumes."""
        t = self.bilayer.mesh.t
        return np.bincount(t.ravel(), np.tile(self.elements.volume / len(t), len(t)), len(self.X)).astype(np.float64)

    def grow(self, g: float) -> None:
        """Set the growth stretch of the cortex to ``g``, weighted by ``pattern``; the core grows by ``core_share``."""
        cortex_stretch = self._stretch(g)
        thickness_stretch = self.thickening(cortex_stretch) if self.thickening else None
        self.elements.grow(cortex_stretch, 1 + (g - 1) * self.core_share, thickness_stretch)
        self.filter.grow(float(np.mean(cortex_stretch)))
        self.growth = g

    def find_rest(self) -> None:
        """Measure ``rest``, the forces of the elements before growth, which are round-off only (see ``advance``)."""
        self.rest = np.zeros(self.X.shape)
        self.rest = self.forces(self.X)

    def _stretch(self, g: float) -> Array:
        """Growth stretch of each element of the cortex."""
        growth_shares = np.asarray(self.pattern)
        for factor_at in self.changing:
            growth_shares = growth_shares * factor_at(g)
        return np.broadcast_to(1 + (g - 1) * growth_shares, self.elements.n_cortex)

    def grown_volumes(self, g: float | None = None) -> Array:
        """Volume (n_cortex,) after free growth, to ``g`` or the present one: the first one times det G [mm^3]."""
        cortex_stretch = self._stretch(self.growth if g is None else g)
        volumes = self.elements.volume[: self.elements.n_cortex] * det_G(cortex_stretch, self.law)
        return volumes * self.thickening(cortex_stretch) if self.thickening else volumes

    @property
    def is_split(self) -> bool:
        """Whether the bulk modulus is split at present."""
        return isinstance(self.elements, Bricks) and self.elements.is_split

    def split_bulk(self, split: bool) -> bool:
        """Split the bulk modulus, if this body may, or let all of it act at once; returns whether that is a change,
        after which the mass must be measured."""
        if not isinstance(self.elements, Bricks) or split == self.is_split or not self._can_split:
            return False
        self.elements.split_bulk(split)
        return True

    def forces(self, x: Array) -> Array:
        """Nodal forces (N, 3) of the elements at positions ``x``: minus the energy gradient, of the part of the bulk
        modulus that acts at once."""
        self.elements.compute_forces(x)
        return self.elements.blocks.nodal_forces() - self.rest

    def all_forces(self, x: Array) -> Array:
        """:meth:`forces` plus the forces of the surface filter."""
        forces = self.forces(x)
        forces[: self.n_surface] += self.filter.forces(x)
        return forces

    def update_state(self, x: Array) -> None:
        """Measure energies, volume ratios and stiffness of the elements at ``x``, and compute the nodal mass."""
        step_share = math.hypot(1, self.viscosity) - self.viscosity  # of the stable step, that a lagging dashpot leaves
        min_scale = 1.25 / step_share**2 if self.viscosity else 0.0
        self._bound = self._stiffness_bound(x)
        self.mass = 0.25 * np.maximum(self._mass_factor, min_scale) * self._bound  # a step of one is stable if K <= 4 M
        self.cell = self._cell_of(surface_area(x, self.bilayer.faces))

    def acting_energy(self, x: Array, g: float) -> float:
        """Energy at ``x`` and growth ``g``, of which the forces are the gradient while pressures of a split bulk
        modulus stay; the body keeps this growth."""
        self.grow(g)
        self.elements.measure(x)
        energy = self.elements.summary().energy + self.filter.energy(x)
        return energy + (self.elements.lagging_energy() if isinstance(self.elements, Bricks) else 0.0)

    def set_pressures(self, volume_ratio: Array) -> None:
        """Set the pressures of a split bulk modulus to those of the volume ratios v/V of the elements (E,)."""
        if isinstance(self.elements, Bricks):
            self.elements.set_pressures(volume_ratio[self.elements.blocks.element])

    def save(self) -> dict[str, NDArray]:
        """Arrays for a checkpoint, beside positions and growth; ``load`` restores them."""
        if isinstance(self.elements, Bricks) and self._can_split:
            return {"pressures": self.elements.pressures.copy(), "is_split": np.array(self.is_split)}
        return {}

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Restore the arrays of ``save``."""
        if isinstance(self.elements, Bricks) and self._can_split:
            self.split_bulk(bool(arrays["is_split"]))
            self.elements.pressures[:] = arrays["pressures"]

    def update_levels(self, springs: Array | float = 0.0) -> None:
        """Compute the masses of the coarse levels; ``springs``: see :meth:`CoarseLevels.update`."""
        self.levels.update(self.mass, self._bound / self._ungrown_bound, np.broadcast_to(springs, self.n_surface))

    def _stiffness_bound(self, x: Array) -> Array:
        """Nodal sums (N,) of bounds on the stiffness of elements, surface filter and effects at ``x``."""
        stiffness_bound = self.elements.measure(x)
        stiffness_bound[: self.n_surface] += self.filter.stiffness
        for added_bound in self.added_stiffness:
            stiffness_bound += added_bound(self.growth)
        return stiffness_bound

    def _cell_of(self, area: float) -> float:
        faces = self.bilayer.faces
        return float(np.sqrt(area / (len(faces) if faces.shape[1] == 4 else len(faces) / 2)))


def surface_area(x: Array, faces: NDArray[np.int64]) -> float:
    """Area of quads (half the cross product of their diagonals) or triangles at positions ``x`` (N, 3) [mm^2]."""
    corners = x[faces]
    opposite = corners[:, 3] if corners.shape[1] == 4 else corners[:, 0]
    return 0.5 * float(np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], opposite - corners[:, 1]), axis=1).sum())
