"""A cortex on a core under growth: elements, supports, the surface filter, and the mass that makes a step stable."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import MeshHex

from morphofold.sim.elements import kernels
from morphofold.sim.elements.blocks import Blocks
from morphofold.sim.growth import check_law
from morphofold.sim.growth import volume as det_G
from morphofold.sim.meshes.bilayer import Bilayer

Array = NDArray[np.float64]

FILTER = {4: 3.0, 3: 1.0}  # strength of the surface filter in units of mu times edge length, for quads and triangles
SAFETY = 1.5               # nodal mass over the least that keeps a step of one stable


class Elements(Protocol):
    """What a body asks of its elements: ``bricks.Bricks`` or ``tets.Tets``."""

    LOCAL: float                    # modulus of the local volumetric term over mu
    LARGEST_J: float                # beyond it the kernels' cube root no longer holds, and no sound element gets there
    n: int
    n_cortex: int
    volume: Array                   # (n,) of the reference body [mm^3]
    modulus: Array                  # (block, rows * WIDTH) mu, kappa, 1/V
    blocks: Blocks

    def grow(self, cortex: Array, core: float = 1.0) -> None: ...
    def compute_forces(self, x: Array) -> None: ...
    def measure(self, x: Array) -> Array: ...
    def state(self) -> dict[str, Array]: ...


class Body:
    """A bilayer under growth.

    Parameters
    ----------
    bilayer : Bilayer
        Geometry; its first elements are the cortex, its first nodes the pial surface.
    mu_cortex, mu_core : float
        Shear moduli [Pa, or units of mu_core].
    kappa_ratio : float
        Bulk over shear modulus, in each layer; more than 2 (the share of the elements' local term).
    law : {"isotropic", "tangential"}
        Growth law of the cortex.
    X : (N, 3) float64, optional
        Reference positions when they are not the mesh's own (a perturbed body) [mm].
    single : bool
        Compute the forces of bricks in 32 bits (docs/solver.md, "Single precision"); tetrahedra have 64 only.

    Attributes
    ----------
    pattern : float or (n_cortex,) float64
        Share of the growth g - 1 that each element of the cortex takes; 1 unless an effect sets it.
    core_share : float
        Share of the growth that the core takes, isotropically; 0 unless an effect sets it.
    viscosity : float
        Damping ratio of the fastest waves that the mass leaves room for; 0 unless an effect sets it.
    mass : (N,) float64
        Nodal mass with which a step of length 1 is stable: ``SAFETY`` times what bounds on the stiffness ask for.
    crossing : float
        Steps in which a shear wave crosses the cortex, with such a mass, before growth. It is the clock by which the
        pace of growth and damping are the same on every mesh.
    """

    def __init__(
        self, bilayer: Bilayer, *, mu_cortex: float, mu_core: float, kappa_ratio: float, law: str,
        X: Array | None = None, single: bool = False,
    ):  # fmt: skip
        check_law(law)
        if not kappa_ratio > 2:
            raise ValueError(f"kappa_ratio must be more than 2, got {kappa_ratio:g}.")
        self.bilayer, self.law = bilayer, law
        mesh = bilayer.mesh
        self.single = single and isinstance(mesh, MeshHex)
        self.X: Array = np.ascontiguousarray(mesh.p.T if X is None else X, dtype=np.float64)
        cortex = np.zeros(mesh.nelements, dtype=bool)
        cortex[mesh.subdomains["cortex"]] = True
        self.mu = np.where(cortex, mu_cortex, mu_core)
        kind: Any
        if isinstance(mesh, MeshHex):
            from morphofold.sim.elements.bricks import Bricks as kind
        else:
            from morphofold.sim.elements.tets import Tets as kind
        self.kappa = (kappa_ratio - kind.LOCAL) * self.mu               # the local term bears the rest
        elements = kind(mesh, self.X, bilayer.radial, cortex, self.mu, self.kappa, law)
        if self.single:
            elements.make_single()
        self.elements: Elements = elements
        self.on_plane = np.zeros(self.X.shape, dtype=bool)
        for axis, at, _ in bilayer.planes:
            self.on_plane[:, axis] |= mesh.p[axis] == at
        self.free = ~self.on_plane
        self.free[bilayer.held] = False
        self.pattern: float | Array = 1.0
        self.core_share = 0.0
        self.growth = 1.0
        self.viscosity = 0.0
        self.rest = np.zeros(self.X.shape)
        self.rest = self.forces(self.X)                                # round-off only; see kernels.advance
        self.filter = SurfaceFilter(self, FILTER[bilayer.faces.shape[1]] * mu_cortex)
        self.update_state(self.X)
        above = bilayer.share > 0
        density = self.mass[above].sum() / self.nodal_volumes()[above].sum()
        thickness = self.elements.volume[: self.elements.n_cortex].sum() / self.filter.area
        self.crossing = float(thickness * np.sqrt(density / mu_cortex))

    @property
    def n_surface(self) -> int:
        return self.bilayer.n_surface

    def nodal_volumes(self) -> Array:
        """Share of the reference volume that each node carries (N,) [mm^3]."""
        t = self.bilayer.mesh.t
        shares = np.tile(self.elements.volume / len(t), len(t))
        return np.bincount(t.ravel(), shares, len(self.X)).astype(np.float64)

    def grow(self, g: float) -> None:
        """Set the growth stretch of the cortex to ``g``, weighed by ``pattern``; the core takes its share."""
        self.elements.grow(self._stretch(g), 1 + (g - 1) * self.core_share)
        self.growth = g

    def _stretch(self, g: float) -> Array:
        """Growth stretch of each element of the cortex."""
        return np.broadcast_to(1 + (g - 1) * np.asarray(self.pattern), self.elements.n_cortex)

    def grown_volumes(self) -> Array:
        """Volume of each element of the cortex after free growth, its reference volume times det G [mm^3]."""
        return self.elements.volume[: self.elements.n_cortex] * det_G(self._stretch(self.growth), self.law)

    def forces(self, x: Array) -> Array:
        """Nodal forces (N, 3) of the elements at positions ``x``: minus the energy gradient."""
        self.elements.compute_forces(x)
        return self.elements.blocks.nodal_forces() - self.rest

    def update_state(self, x: Array) -> None:
        """Measure energies, volume ratios and stiffness of the elements at ``x``, and from them the nodal mass."""
        self.mass = self.elements.measure(x)
        share = (1 + self.viscosity**2) ** 0.5 - self.viscosity         # of the step, left by a lagging dashpot
        factor = 0.25 * max(SAFETY, 1.25 / share**2)                    # a step of one is stable if K <= 4 M
        self.mass *= factor
        self.filter.update(x)
        self.mass[: self.n_surface] += factor * self.filter.stiffness


class SurfaceFilter:
    """A weak fourth-order stiffness of the pial surface against zigzags of the size of one cell.

    Energy ``c h/2 sum_i w_i |(L L u)_i|^2`` with u = x - X, L u the mean of the neighbours minus the node and h the
    present cell size. It is of order h^4 for a smooth surface and stops the saw-teeth that elements under
    extreme compression fall into. Beyond a symmetry plane stand the mirror images of the neighbours; w halves there.
    """

    def __init__(self, body: Body, strength: float):
        faces, n = body.bilayer.faces, body.n_surface
        ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
        pairs = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
        cut = body.on_plane[:n]
        beyond = cut[pairs[:, 0]] & ~cut[pairs[:, 1]]                   # (P, 3): the neighbour's image across a plane
        weight = 2.0 ** beyond.sum(axis=1)
        count = np.bincount(pairs[:, 0], weight, n)
        inside = sparse.diags(0.5 ** cut.sum(axis=1))

        def bending(values: Array) -> sparse.csr_matrix:
            shares = sparse.csr_matrix((values / count[pairs[:, 0]], (pairs[:, 0], pairs[:, 1])), shape=(n, n))
            L = shares - sparse.identity(n)
            return sparse.csr_matrix((L @ L).T @ inside @ (L @ L))

        even = bending(weight)
        self._B = [even] * 3
        for axis in {plane.axis for plane in body.bilayer.planes}:      # this component changes sign in the mirror
            self._B[axis] = bending(np.where(beyond[:, axis], 0.0, weight))
        self._row_sum = np.max([np.asarray(abs(B).sum(axis=1)).ravel() for B in self._B], axis=0)
        odd = [sparse.coo_matrix(B - even) for B in self._B]
        joined = [np.concatenate([getattr(D, name) for D in odd]) for name in ("row", "col", "data")]
        self._even = even.indptr, even.indices, even.data
        self._odd = np.repeat(np.arange(3), [D.nnz for D in odd]), joined[0], joined[1], joined[2]
        self._faces, self._strength = faces, strength
        self._X = body.X[:n].copy()
        self._u = np.zeros((n, 3))
        self.update(self._X)

    def update(self, x: Array) -> None:
        """Refresh the area, and the cell size h, the root of the mean area of a cell (two triangles), at ``x``."""
        p = x[self._faces]
        last = p[:, 3] if p.shape[1] == 4 else p[:, 0]
        self.area = 0.5 * float(np.linalg.norm(np.cross(p[:, 2] - p[:, 0], last - p[:, 1]), axis=1).sum())
        cells = len(self._faces) if p.shape[1] == 4 else len(self._faces) / 2
        self.h = float(np.sqrt(self.area / cells))

    @property
    def stiffness(self) -> Array:
        """Row sums of the filter's stiffness matrix (S,), an upper bound of its eigenvalues."""
        return self._strength * self.h * self._row_sum

    def forces(self, x: Array, out: Array | None = None) -> Array:
        """Forces (S, 3) on the surface nodes at positions ``x`` (N, 3), into ``out`` if that is given."""
        out = np.empty_like(self._X) if out is None else out
        kernels.filter_forces(*self._even, *self._odd, x, self._X, self._strength * self.h, self._u, out)
        return out

    def energy(self, x: Array) -> float:
        """Energy of the filter at positions ``x``: half the work of its forces on the way back, as it is quadratic."""
        forces = self.forces(x)
        return -0.5 * float(np.sum(forces * self._u))

    def matrix(self, axis: int) -> sparse.csr_matrix:
        """Stiffness (S, S) of one component at the present cell size."""
        return self._strength * self.h * self._B[axis]
