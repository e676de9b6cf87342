"""Bilayer geometries as scikit-fem meshes: a layered cubed sphere of bricks, whole or cut by symmetry planes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex
from skfem.refdom import RefHex

#: coordinates that each portion keeps at or above zero
PLANES = {"full": (), "half": (2,), "quarter": (1, 2), "octant": (0, 1, 2)}

#: skfem's corner numbers in the order 4 i + 2 j + k of the kernels
BINARY_CORNERS = np.argsort(RefHex.p[0] * 4 + RefHex.p[1] * 2 + RefHex.p[2])

CORE_RATIO = 1.4        # each core layer is this much thicker than the one outside it,
CORE_CAP = 4.0          # up to this many surface edges


@dataclass(frozen=True, eq=False)
class Bilayer:
    """A cortex on a core, in layers of bricks that follow the surface inwards.

    Attributes
    ----------
    mesh : skfem.MeshHex
        Subdomains ``cortex`` and ``core``; boundaries ``pial``, ``hole`` and, where cut, ``plane0`` .. ``plane2``.
    quads : (Q, 4) int
        Outer quads, counter-clockwise from outside, as indices into one layer of ``n_surface`` nodes.
    n_surface : int
        Nodes per layer. Node s of layer l is ``l * n_surface + s``; layer 0 is the pial surface.
    cortex_layers : int
        Brick layers in the cortex: the white surface is node layer ``cortex_layers``.
    planes : tuple of int
        Axes of the symmetry planes (coordinate 0, body on the positive side).
    edge : float
        A quarter of a great circle over its cells [mm]; the mean edge is some 7 % shorter.
    """

    mesh: MeshHex
    quads: NDArray[np.int64]
    n_surface: int
    cortex_layers: int
    planes: tuple[int, ...]
    edge: float
    radii: NDArray[np.float64] = field(repr=False)

    @property
    def portion(self) -> float:
        """Share of the closed body that the mesh covers: 1, 1/2, 1/4 or 1/8."""
        return 0.5 ** len(self.planes)

    def layer(self, level: int) -> slice:
        """Node numbers of node layer ``level`` (0 outermost)."""
        return slice(level * self.n_surface, (level + 1) * self.n_surface)


def _cube_surface(n: int, planes: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lattice points (S, 3) in -n/2..n/2 and quads (Q, 4) of the surface of a cube, cut by the planes."""
    half = n // 2
    points, start = [], 0
    quads = []
    grid = np.arange(-half, half + 1)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    for axis in range(3):
        for side in (-1, 1):
            p = np.empty((n + 1, n + 1, 3), dtype=np.int64)
            p[..., axis] = side * half
            p[..., (axis + 1) % 3], p[..., (axis + 2) % 3] = u, v
            points.append(p.reshape(-1, 3))
            quads.append(start + (corners if side > 0 else corners[:, [0, 3, 2, 1]]))
            start += p.shape[0] * p.shape[1]
    all_points, all_quads = np.concatenate(points), np.concatenate(quads)
    keep = np.ones(len(all_quads), dtype=bool)
    for axis in planes:
        keep &= all_points[all_quads][:, :, axis].min(axis=1) >= 0
    used, first, inverse = np.unique(
        all_points[all_quads[keep].ravel()], axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)                   # number nodes as the quads come to them: neighbours lie close in memory
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return used[order], rank[inverse].reshape(-1, 4)


def layer_radii(outer: float, interface: float, hole: float, cortex_layers: int, edge: float) -> NDArray[np.float64]:
    """Radii of the node layers from outside in: even through the cortex, growing geometrically in the core [mm]."""
    step = (outer - interface) / cortex_layers
    steps: list[float] = []
    while sum(steps) < interface - hole:
        step = min(step * CORE_RATIO, CORE_CAP * edge)
        steps.append(step)
    scaled = np.array(steps) * (interface - hole) / sum(steps)
    return np.concatenate([np.linspace(outer, interface, cortex_layers + 1), interface - np.cumsum(scaled)])


def bilayer_sphere(
    radius: float, cortex_thickness: float, hole_radius: float, portion: str, n: int, cortex_layers: int = 3
) -> Bilayer:
    """Layered cubed sphere: a cortex of given thickness on a core with a hole (Razavi et al. 2015, Fig. 2).

    Parameters
    ----------
    radius, cortex_thickness, hole_radius : float
        C, T = C - B, and A of the paper [mm]; 0 < A < C - T.
    portion : {"full", "half", "quarter", "octant"}
        Symmetry planes cut away the negative side of no, one, two or three axes.
    n : even int
        Surface cells along a quarter of a great circle (an edge of the cube).
    cortex_layers : int
        Brick layers through the cortex; fewer than 3 fold with other wavelengths.

    Raises
    ------
    ValueError
        If the radii leave no core or no cortex, or n is odd or below 4.
    """
    interface = radius - cortex_thickness
    if not 0 < hole_radius < interface < radius:
        raise ValueError(
            f"the hole (radius {hole_radius:g}) must lie inside the core (radius {interface:g} = {radius:g} - cortex "
            f"thickness {cortex_thickness:g}); make hole_radius smaller than {interface:g}."
        )
    if n < 4 or n % 2:
        raise ValueError(f"n must be an even number of cells, at least 4, got {n}.")
    if portion not in PLANES:
        raise ValueError(f"portion must be one of {', '.join(PLANES)}, got {portion!r}.")
    planes = PLANES[portion]
    lattice, quads = _cube_surface(n, planes)
    edge = 0.5 * np.pi * radius / n
    radii = layer_radii(radius, interface, hole_radius, cortex_layers, edge)
    direction = np.tan(lattice * (0.5 * np.pi / n))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    n_surface, n_layers = len(lattice), len(radii) - 1
    nodes = (radii[:, None, None] * direction).reshape(-1, 3)

    # corner (i, j, k): (i, j) along the quad, k outwards; then into the order of skfem's reference brick
    quad_corner = quads[:, [0, 3, 1, 2]]                                # (i, j) = 00, 01, 10, 11
    level = np.arange(n_layers)[:, None, None]
    below = quad_corner[None] + (level + 1) * n_surface
    above = quad_corner[None] + level * n_surface
    binary = np.stack([below, above], axis=-1).reshape(-1, 8)           # 4 i + 2 j + k
    t = np.empty_like(binary)
    t[:, BINARY_CORNERS] = binary
    mesh = MeshHex(nodes.T.copy(), t.T.astype(np.int64).copy())
    on_plane = {f"plane{a}": mesh.facets_satisfying(lambda x, a=a: np.abs(x[a]) < 1e-9 * radius, True) for a in planes}
    r = lambda x: np.linalg.norm(x, axis=0)
    facets = mesh.boundary_facets()
    facet_radius = r(mesh.p[:, mesh.facets[:, facets]]).min(axis=0), r(mesh.p[:, mesh.facets[:, facets]]).max(axis=0)
    mesh = mesh.with_boundaries(
        {
            "pial": facets[facet_radius[0] > radius * (1 - 1e-9)],
            "hole": facets[facet_radius[1] < hole_radius * (1 + 1e-9)],
            **on_plane,
        }
    ).with_subdomains(
        {
            "cortex": np.arange(cortex_layers * len(quads)),
            "core": np.arange(cortex_layers * len(quads), n_layers * len(quads)),
        }
    )
    return Bilayer(mesh, quads, n_surface, cortex_layers, planes, float(edge), radii)
