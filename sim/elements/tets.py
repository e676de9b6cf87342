"""Linear tetrahedra of any mesh, in patches, in the layout of the kernels: grown edges, moduli, state."""

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTet

from morphofold.errors import BadMesh, OutOfRange
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.sim.elements import growth_by_stress, tet_kernels
from morphofold.sim.elements.blocks import Blocks, Summary, distinct_nodes, lanes_of, summary_of
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.elements.tet_grouping import cluster
from morphofold.sim.elements.tet_kernels import PATCH_NODES, PATCH_TETS
from morphofold.sim.growth_laws import check_law
from morphofold.sim.materials import Material
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN

FLAT_VOLUME_RATIO = 1e-10  # a volume below this share of the cube of the longest edge counts as zero


class Tets:
    """Tetrahedra in patches; see :mod:`morphofold.sim.elements.tet_kernels` for the energy.

    Parameters
    ----------
    mesh : skfem.MeshTet
        Corners of an element in any order.
    X : (N, 3) float64
        Reference positions of its nodes [mm].
    radial : (N, 3) float64
        Unit thickness direction at the nodes; tangential growth adds nothing along the normalised mean of the four.
    cortex : (E,) bool
        The tetrahedra of the cortex; ``grow`` sets the stretch of each.
    mu, kappa : (E,) float64
        Shear modulus, and modulus of the pressure. All tetrahedra of a patch have the same mu, kappa and value of
        ``cortex``. If the moduli of all neighbours differ, patches are single tetrahedra, which are too stiff.
    law : {"isotropic", "tangential"}
    material : Material

    Attributes
    ----------
    patches : (P, 6) int
        Tetrahedra of each patch, -1 where it has fewer. Those of the cortex come first.
    volume : (E,) float64
        Reference volumes [mm^3].
    corner : (block, 24 LANES) uint8
        Which of its patch's eight nodes are the corners of each tetrahedron, in lanes: four for each of six tetrahedra.
        Missing tetrahedra of a patch have the corners of its first one.

    Raises
    ------
    BadMesh
        If tetrahedra are flat at ``X``, or inside out relative to the mesh's own positions; if the thickness
        directions at the corners of a tetrahedron that grows tangentially cancel out.
    """

    LOCAL = 0.0  # modulus of a local volumetric term over mu: there is none
    LARGEST_J = 50.0

    def __init__(
        self,
        mesh: MeshTet,
        X: Array,
        radial: Array,
        cortex: Bools,
        mu: Array,
        kappa: Array,
        law: str,
        material: Material = NEO_HOOKEAN,
    ):
        check_law(law)
        self.n, self.n_cortex, self.law, self.material = mesh.nelements, int(cortex.sum()), law, material
        tets, self.volume = _right_handed_corners(mesh, X)
        if law == "tangential":
            _check_thickness_directions(radial[tets].mean(axis=1), np.flatnonzero(cortex))
        material_numbers = np.unique(np.column_stack([cortex, mu, kappa]), axis=0, return_inverse=True)[1].ravel()
        patches = cluster(mesh, X, material_numbers)
        self.patches = patches[np.argsort(~cortex[patches[:, 0]], kind="stable")]
        patch_nodes, corner = _nodes_of_patches(self.patches, tets)
        self.corners, self.blocks = patch_nodes, (blocks := Blocks(patch_nodes, len(X)))
        n_blocks, first_tets = blocks.count, self.patches[:, 0]
        self.corner = lanes_of(corner[blocks.element])
        self._layout = blocks.nodes, blocks.start, blocks.local, self.corner
        self.modulus = blocks.moduli(mu[first_tets], kappa[first_tets], (self.patches >= 0).sum(axis=1))

        patch, slot = np.nonzero(self.patches >= 0)
        self._place = np.empty(self.n, dtype=np.int64)  # of each tetrahedron in (block, 6 LANES)
        tet = self.patches[patch, slot]
        self._place[tet] = (patch // LANES * PATCH_TETS + slot) * LANES + patch % LANES
        self._share = np.empty(self.n)  # of the patch's volume
        self._share[tet] = self.volume[tet] / np.bincount(patch, self.volume[tet])[patch]
        self._cortex = self._place[np.flatnonzero(cortex)]
        self._n_cortex_patches = int(cortex[first_tets].sum())
        self._grown = -(-self._n_cortex_patches // LANES)  # leading blocks that hold cortex; the last may hold core too
        self._core_lanes = np.tile(np.arange(LANES) >= (self._n_cortex_patches - 1) % LANES + 1, 9 * PATCH_TETS)
        self._X, self._radial, self._core = X, radial, np.nan
        self.edges = np.empty((n_blocks, 9 * PATCH_TETS * LANES))
        self.grow(np.ones(self.n_cortex))
        self._J, self._state = np.zeros((n_blocks, PATCH_TETS * LANES)), np.zeros((n_blocks, 2 * LANES))
        self._stiffness = np.zeros(len(blocks.nodes))

    def grow(self, g: Array, core_g: float = 1.0, thickness: Array | None = None) -> None:
        """Set the growth stretch ``g`` of each tetrahedron of the cortex (n_cortex,), and isotropic growth of the core.

        ``thickness`` (n_cortex,): growth stretch along the thickness, if the law is tangential; 1 by default.
        """
        if not (np.min(g, initial=core_g) > 0 and np.max(g, initial=core_g) < np.inf):
            raise OutOfRange(f"growth stretches must be positive and finite, got {g} and {core_g:g} in the core.")
        is_same_core = core_g == self._core
        n_blocks = self._grown if is_same_core else self.blocks.count
        last_block = slice(n_blocks - 1, n_blocks) if is_same_core else slice(0)
        old_edges = self.edges[last_block].copy()
        stretch_across = np.full((n_blocks, PATCH_TETS * LANES), core_g)
        stretch_along = stretch_across.copy()
        stretch_across.ravel()[self._cortex] = g
        if self.law == "tangential":
            g = np.array(1.0) if thickness is None else thickness
        stretch_along.ravel()[self._cortex] = g
        tet_kernels.grow_edges(self._X, self._radial, *self._layout, stretch_across, stretch_along, self.edges)
        self.edges[last_block] = np.where(self._core_lanes, old_edges, self.edges[last_block])  # grown by stress
        self._core = core_g

    @property
    def core_volumes(self) -> Array:
        """Reference volume of each part of the core that has a growth tensor of its own: its patches [mm^3]."""
        core_patches = self.patches[self._n_cortex_patches :]
        return np.where(core_patches >= 0, self.volume[core_patches], 0.0).sum(axis=1)

    def grow_by_stress(self, x: Array, X: Array, G: Array, rate: float, grows_volume: bool = True) -> None:
        """Let the patches of the core grow by their stress: as :meth:`.bricks.Bricks.grow_by_stress`."""
        core_layout = self.blocks.element, self._n_cortex_patches, self.edges, self.modulus
        growth_by_stress.grow_patches(x, X, *self._layout, *core_layout, G, rate, grows_volume, self.material)

    def compute_forces(self, x: Array, follow: float = 0.0) -> None:
        """Write forces at positions ``x`` (N, 3) into ``blocks.force``; ``follow`` is for bricks."""
        tet_kernels.patch_forces(x, *self._layout, self.edges, self.modulus, self.blocks.force, self.material)

    def measure(self, x: Array) -> Array:
        """Measure the patches at ``x``; returns nodal sums (N,) of a bound on their stiffness."""
        outputs = self._J, self._state, self._stiffness
        tet_kernels.patch_state(x, *self._layout, self.edges, self.modulus, *outputs, self.material)
        return self.blocks.nodal_sums(self._stiffness)

    def summary(self) -> Summary:
        """Numbers of all tetrahedra, from the last ``measure``."""
        state = self.state()
        return summary_of(state["energy"], state["J_min"], state["J_max"], state["volume_ratio"])

    def state(self) -> dict[str, Array]:
        """Per tetrahedron, from the last ``measure``: energy (share of the patch's energy, by reference volume), J_min
        and J_max (both its J), volume_ratio (of its patch); (E,) each."""
        block, lane = self._place // (PATCH_TETS * LANES), self._place % LANES
        volume_ratio, energy = self._state.reshape(-1, 2, LANES)[block, :, lane].T
        J = self._J.ravel()[self._place]
        return {"energy": energy * self._share, "J_min": J, "J_max": J, "volume_ratio": volume_ratio}


def _check_thickness_directions(mean_normals: Array, cortex: Ints) -> None:
    """Raise ``BadMesh`` if mean thickness directions (E, 3) are shorter than 0.1, or NaN."""
    mean_lengths = np.linalg.norm(mean_normals[cortex], axis=1)
    bad_tets = cortex[~(mean_lengths > 0.1)]
    if bad_tets.size:
        raise BadMesh(
            f"the thickness directions at the corners of {len(bad_tets)} of {len(cortex):,} tetrahedra of the cortex "
            f"cancel out; the first is {bad_tets[0]} with mean {mean_normals[bad_tets[0]].round(3).tolist()}. Refine "
            "the mesh there, or let it grow isotropically."
        )


def _right_handed_corners(mesh: MeshTet, X: Array) -> tuple[Ints, Array]:
    """Corners (E, 4) in right-handed order at ``X``, and reference volumes (E,)."""
    tets = mesh.t.T
    volumes = [np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) / 6 for points in (mesh.p.T, X)]
    is_mirrored = volumes[0] < 0
    volume = np.where(is_mirrored, -volumes[1], volumes[1])
    longest_edge = np.linalg.norm(X[mesh.edges[0]] - X[mesh.edges[1]], axis=1)[mesh.t2e].max(axis=0)
    flat_tets = np.flatnonzero(~(volume > FLAT_VOLUME_RATIO * longest_edge**3))
    if flat_tets.size:
        raise BadMesh(
            f"{len(flat_tets)} of {len(tets):,} tetrahedra are flat or inside out before growth; the first is "
            f"{flat_tets[0]} with volume {volume[flat_tets[0]]:.3g} and longest edge "
            f"{longest_edge[flat_tets[0]]:.3g}. Repair the mesh, or reduce effects.perturbation.amplitude."
        )
    return np.where(is_mirrored[:, None], tets[:, [1, 0, 2, 3]], tets), volume


def _nodes_of_patches(patches: Ints, tets: Ints) -> tuple[Ints, NDArray[np.uint8]]:
    """Nodes (P, 8) of each patch, the first repeated where it has fewer, and the numbers of its 24 corners among them.

    Missing tetrahedra of a patch have the corners of its first one.
    """
    patch_corners = tets[np.where(patches >= 0, patches, patches[:, :1])]
    all_nodes, node_start, local_number = distinct_nodes(patch_corners.reshape(len(patches), -1))
    patch_number = np.repeat(np.arange(len(patches)), np.diff(node_start))
    patch_nodes = np.repeat(all_nodes[node_start[:-1], None], PATCH_NODES, axis=1)
    patch_nodes[patch_number, np.arange(len(all_nodes)) - node_start[patch_number]] = all_nodes
    return patch_nodes, local_number.astype(np.uint8)
