"""Meshes (scikit-fem) of a cortex on a core: layers of bricks under a surface of quads.

Sphere and ellipsoid are layered cubed spheres, whole or cut by symmetry planes. A patch is a block with a flat surface
between four symmetry planes. A strip is a patch one brick deep, in plane strain. A part between symmetry planes is
mirrored to the whole.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from skfem import MeshHex, MeshTet

from morphofold.errors import ImpossibleBody
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
from morphofold.surface import Regions

#: axes along which each portion keeps only coordinates at or above zero
SYMMETRY_AXES = {"full": (), "half": (2,), "quarter": (1, 2), "octant": (0, 1, 2)}

CORE_LAYER_RATIO = 1.6  # each core layer is this much thicker than the one outside it,
THICKEST_CORE_LAYER_IN_EDGES = 8.0  # up to this many surface edges
TILE_SHAPE = (4, 8)  # surface cells are numbered tile by tile, so that a block of 32 bricks shares most of its nodes


class Plane(NamedTuple):
    """A symmetry plane ``x[axis] = at``; the body lies where ``side * (x[axis] - at) >= 0``."""

    axis: int
    at: float
    side: int


@dataclass(frozen=True, eq=False)
class Bilayer:
    """A cortex on a core.

    Attributes
    ----------
    mesh : skfem.MeshHex or skfem.MeshTet
        Subdomains ``cortex`` and ``core``; the elements of the cortex come first, the nodes of the pial surface too.
    faces : (Q, 4) or (Q, 3) int
        Cells of the pial surface, counter-clockwise from outside, over the first ``n_surface`` nodes.
    n_surface : int
    white : (S, N) csr_matrix
        White surface from the nodes: ``white @ x`` (S, 3); vertex i belongs to pial vertex i.
    radial, foot : (N, 3) float64
        At each node, the unit thickness direction outwards, and the pial point above it [mm].
    share : (N,) float64
        1 on the pial surface, falling to 0 on the white surface; 0 below.
    held : (H,) int
        Nodes that never move.
    planes : tuple of Plane
    mirrored : tuple of int
        Axes at whose planes the body is mirrored to the closed whole.
    edge : float
        Largest edge of the pial surface [mm].
    hemi : {"lh", "rh"}
        By which its surfaces are named.
    sphere : (S, 3) float64, optional
        Point of the unit sphere of each pial vertex, if the body has a sphere.
    growing : (N,) float64, optional
        Share of the growth of the cortex at each node; 1 everywhere if not given.
    regions : Regions, optional
        Of the pial vertices.
    cortex : (S,) bool, optional
        Where a pial vertex is cortex: False on the medial wall.
    grids : tuple of (K + 1, L + 1) int
        Pial nodes along the lines of each logically rectangular piece of the surface; none if it is not made of such.
    point_data : mapping of str to (N,) float64
        Maps that came with the mesh, by name.
    """

    mesh: MeshHex | MeshTet
    faces: Ints
    n_surface: int
    white: sparse.csr_matrix
    radial: Array
    foot: Array
    share: Array
    held: Ints
    planes: tuple[Plane, ...]
    mirrored: tuple[int, ...]
    edge: float
    hemi: str = "lh"
    sphere: Array | None = None
    growing: Array | None = None
    regions: Regions | None = None
    cortex: Bools | None = None
    grids: tuple[Ints, ...] = ()
    point_data: Mapping[str, Array] = field(default_factory=dict)

    @property
    def closed(self) -> bool:
        """Whether the surfaces, mirrored, enclose the body; those of a patch end at its sides."""
        return len(self.planes) == len(self.mirrored)

    @property
    def portion(self) -> float:
        """Share of the closed body that the mesh covers: 1, 1/2, 1/4 or 1/8."""
        return 0.5 ** len(self.mirrored)


class Whole(NamedTuple):
    """A surface and its mirror images as one; the vertices and faces of the part come first.

    Attributes
    ----------
    faces : (F, k) int
        Images have the reverse order of corners.
    node : (V,) int
        The vertex of the part of which each is the image; ``values[node]`` are its values.
    sign : (V, 3) float64
        -1 along the axes at whose planes it is mirrored, else 1.
    shift : (3,) float64
        Twice the coordinates of the planes [mm].
    """

    faces: Ints
    node: Ints
    sign: Array
    shift: Array

    def positions(self, x: Array) -> Array:
        """Positions (V, 3) of the whole from those of the part [mm]."""
        return x[self.node] * self.sign + np.where(self.sign < 0, self.shift, 0.0)


def mirror(faces: Ints, on_plane: Bools, planes: Sequence[Plane]) -> Whole:
    """Mirror ``faces`` (F, k) at planes, one after the other; both sides share the vertices on a plane.

    ``on_plane`` (N, 3): whether a vertex of the part lies on the plane of each axis.
    """
    node, sign, shift = np.arange(len(on_plane)), np.ones(on_plane.shape), np.zeros(3)
    for axis, plane_position, _ in planes:
        off_plane = np.flatnonzero(~on_plane[node, axis])
        image_vertex = np.arange(len(node))
        image_vertex[off_plane] = len(node) + np.arange(len(off_plane))
        image_sign = sign[off_plane]
        image_sign[:, axis] = -1
        node, sign = np.concatenate([node, node[off_plane]]), np.concatenate([sign, image_sign])
        faces = np.concatenate([faces, image_vertex[faces][:, ::-1]])
        shift[axis] = 2 * plane_position
    return Whole(faces, node, sign, shift)


def cube_surface(n_cells: int, axes: tuple[int, ...]) -> tuple[Ints, Ints]:
    """Lattice points (S, 3) within n_cells/2 and quads (Q, 4) of the surface of a cube, where no axis is negative."""
    half_n = n_cells // 2
    u, v = np.indices((n_cells + 1, n_cells + 1)).reshape(2, -1) - half_n
    faces, quads = [], _grid_quads(n_cells, n_cells)
    for axis in range(3):
        for side in (-1, 1):
            face_points = np.roll(np.column_stack([np.full_like(u, side * half_n), u, v]), axis, axis=1)
            faces.append(face_points[quads if side > 0 else quads[:, [0, 3, 2, 1]]])
    quad_corners = np.concatenate(faces)
    quad_corners = quad_corners[(quad_corners[..., list(axes)] >= 0).all(axis=(1, 2))].reshape(-1, 3)
    lattice_points, first_use, corner_points = np.unique(quad_corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first_use)  # number nodes in the order of the quads, so that neighbours are close in memory
    return lattice_points[order], np.argsort(order)[corner_points].reshape(-1, 4)


def cube_grids(n_cells: int, axes: tuple[int, ...] = ()) -> tuple[Ints, ...]:
    """The points of :func:`cube_surface` along the lines of each face of the cube."""
    lattice_points, _ = cube_surface(n_cells, axes)
    point_at = np.full((n_cells + 1,) * 3, -1)
    point_at[tuple(lattice_points.T + n_cells // 2)] = np.arange(len(lattice_points))
    block = point_at[tuple(slice(n_cells // 2 if axis in axes else 0, None) for axis in range(3))]
    return tuple(block.take(side, axis) for axis in range(3) for side in ((-1,) if axis in axes else (0, -1)))


def cube_directions(n: int, axes: tuple[int, ...] = ()) -> tuple[Array, Ints]:
    """Directions (S, 3) and quads (Q, 4) of a cubed sphere with ``n`` cells along an edge of the cube, an even number.

    Angles between the lines of a face are equal. Where coordinates along one of the ``axes`` are negative, it is cut.
    """
    lattice, quads = cube_surface(n, axes)
    direction = np.tan(lattice * (0.5 * np.pi / n))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True), quads


def _grid_quads(nu: int, nv: int) -> Ints:
    """Quads (nu nv, 4) of a grid of (nu + 1) (nv + 1) points, tile by tile, counter-clockwise in (u, v)."""
    points = np.arange((nu + 1) * (nv + 1)).reshape(nu + 1, nv + 1)
    quads = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=-1).reshape(-1, 4)
    (i, j), (tile_u, tile_v) = np.divmod(np.arange(nu * nv), nv), TILE_SHAPE
    return quads[np.lexsort((j % tile_v, i % tile_u, j // tile_v, i // tile_u))]


def core_layer_fractions(first_step: float, depth: float, edge: float) -> Array:
    """Depths of the node layers of the core over its depth, from 0 to 1, with steps that grow by ``CORE_LAYER_RATIO``.

    ``first_step`` is the thickness of a layer of the cortex, ``depth`` that of the core [mm]; no step exceeds
    ``THICKEST_CORE_LAYER_IN_EDGES`` surface edges.
    """
    steps = [first_step]
    while sum(steps[1:]) < depth:
        steps.append(min(steps[-1] * CORE_LAYER_RATIO, THICKEST_CORE_LAYER_IN_EDGES * edge))
    depths = np.cumsum(steps[1:])  # ends at the base to the last bit; Python 3.12 sums floats otherwise than 3.11
    return np.concatenate([[0.0], depths / depths[-1]])


def _levels(pial: Array, white: Array, base: Array, cortex_layers: int, edge: float, planes: Sequence[Plane]) -> Array:
    """Levels (L + 1, S, 3) of nodes between three surfaces (S, 3)."""
    thickness, depth = (float(np.linalg.norm(top - low, axis=1).mean()) for top, low in ((pial, white), (white, base)))
    cortex_fractions = np.arange(cortex_layers) / cortex_layers
    core_fractions = core_layer_fractions(thickness / cortex_layers, depth, edge)
    cortex_nodes = pial + cortex_fractions[:, None, None] * (white - pial)
    levels = np.concatenate([cortex_nodes, white + core_fractions[:, None, None] * (base - white)])
    for plane in planes:  # exactly on the plane, so that mirrored parts join
        on_plane = np.abs(levels[..., plane.axis] - plane.at) < 1e-9 * edge
        levels[on_plane, plane.axis] = plane.at
    return levels


def layered_bricks(
    levels: Array,
    quads: Ints,
    normal: Array,
    cortex_layers: int,
    edge: float,
    planes: tuple[Plane, ...] = (),
    mirrored: tuple[int, ...] = (),
) -> Bilayer:
    """Bricks between levels (L + 1, S, 3) of nodes with the same quads, the pial surface first; the last is held.

    ``normal`` (S, 3) is the thickness direction of each column.
    """
    n_layers, n_surface = len(levels) - 1, levels.shape[1]
    node_positions, pial = levels.reshape(-1, 3), levels[0]

    # corner (i, j, k): (i, j) along the quad, k outwards; then reordered as in skfem's reference brick
    upper_corners = quads[:, [0, 3, 1, 2]] + n_surface * np.arange(n_layers)[:, None, None]  # (i, j) = 00, 01, 10, 11
    kernel_corners = np.stack([upper_corners + n_surface, upper_corners], axis=-1).reshape(-1, 8)  # 4 i + 2 j + k
    skfem_corners = np.ascontiguousarray(kernel_corners[:, np.argsort(CORNERS_IN_KERNEL_ORDER)].T)
    n_cortex = cortex_layers * len(quads)
    mesh = MeshHex(np.ascontiguousarray(node_positions.T), skfem_corners, validate=False).with_subdomains(
        {"cortex": np.arange(n_cortex), "core": np.arange(n_cortex, len(kernel_corners))}
    )
    surface_nodes = np.arange(n_surface)
    white_entries = (np.ones(n_surface), (surface_nodes, cortex_layers * n_surface + surface_nodes))
    return Bilayer(
        mesh,
        quads,
        n_surface,
        sparse.csr_matrix(white_entries, (n_surface, len(node_positions))),
        np.tile(normal, (n_layers + 1, 1)),
        np.tile(pial, (n_layers + 1, 1)),
        np.repeat(np.maximum(1 - np.arange(n_layers + 1) / cortex_layers, 0.0), n_surface),
        n_layers * n_surface + surface_nodes,
        planes,
        mirrored,
        edge,
    )


def bilayer_ellipsoid(
    semi_axes: ArrayLike, thickness: ArrayLike, hole_share: float, portion: str, n: int, cortex_layers: int = 3
) -> Bilayer:
    """Layered cubed ellipsoid: a cortex of given thickness on a core with a hole of the same shape.

    Parameters
    ----------
    semi_axes : (3,) float
        Semi-axes of the pial surface along x, y, z [mm].
    thickness : float or callable
        Thickness of the cortex [mm] along the surface normal, or a function that returns it (S,) at pial points (S, 3).
    hole_share : float
        Size of the held hole over that of the pial surface.
    portion : {"full", "half", "quarter", "octant"}
        Symmetry planes cut away the negative side of no axis, one (z), two (y, z) or three.
    n : int
        Surface cells along a quarter of a great circle (an edge of the cube): an even number, at least 4.
    cortex_layers : int
        Brick layers through the cortex; scenes use two where edges are longer than T/2, else three, unless they set it.

    Raises
    ------
    ImpossibleBody
        If the layers leave no core or no cortex.
    """
    axis_lengths = np.asarray(semi_axes, dtype=np.float64)
    direction, quads = cube_directions(n, SYMMETRY_AXES[portion])
    pial = direction * axis_lengths
    normal = direction / axis_lengths
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    thicknesses = np.broadcast_to(thickness(pial) if callable(thickness) else thickness, len(pial))
    white = pial - thicknesses[:, None] * normal
    white_size = np.sqrt(np.sum((white / axis_lengths) ** 2, axis=1))  # size of the ellipsoid through each point
    if not 0 < hole_share < white_size.min() or thicknesses.min() <= 0 or thicknesses.max() >= axis_lengths.min():
        raise ImpossibleBody(
            f"the hole ({hole_share:g} of the body size) must lie inside the core, which ends at {white_size.min():g} "
            f"of it under a cortex of {thicknesses.max():g} mm; make the hole smaller or the cortex thinner."
        )
    planes = tuple(Plane(axis, 0.0, 1) for axis in SYMMETRY_AXES[portion])
    edge = 0.5 * np.pi * float(axis_lengths.max()) / n
    levels = _levels(pial, white, hole_share * pial, cortex_layers, edge, planes)
    bilayer = layered_bricks(levels, quads, normal, cortex_layers, edge, planes, SYMMETRY_AXES[portion])
    return replace(bilayer, sphere=direction, grids=cube_grids(n, SYMMETRY_AXES[portion]))


def bilayer_sphere(
    radius: float, cortex_thickness: ArrayLike, hole_radius: float, portion: str, n: int, cortex_layers: int = 3
) -> Bilayer:
    """Layered cubed sphere: a cortex of given thickness on a core with a hole (Razavi et al. 2015, Fig. 2).

    ``radius``, ``cortex_thickness`` and ``hole_radius`` are C, T = C - B, and A of the paper [mm]; the rest is as in
    :func:`bilayer_ellipsoid`.
    """
    return bilayer_ellipsoid([radius] * 3, cortex_thickness, hole_radius / radius, portion, n, cortex_layers)


def bilayer_patch(
    size: tuple[float, float], depth: float, thickness: float, edge: float, cortex_layers: int = 3
) -> Bilayer:
    """A flat block: pial surface at z = 0, base held at z = -depth, symmetry planes on all four sides.

    Parameters
    ----------
    size : (2,) float
        Width along x and y [mm]; a width along y of 0 makes a strip one brick deep, in plane strain.
    depth, thickness : float
        Depth of the block, and thickness of the cortex, 0 < thickness < depth [mm].
    edge : float
        Largest surface edge [mm].
    cortex_layers : int
    """
    is_strip = size[1] == 0
    n_x, n_y = (max(1, int(np.ceil(width / edge - 1e-9))) for width in size)
    width = size[0] / n_x if is_strip else size[1]
    quads = _grid_quads(n_x, n_y)
    x, y = np.meshgrid(np.linspace(0, size[0], n_x + 1), np.linspace(0, width, n_y + 1), indexing="ij")
    pial = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    inwards, normals = np.array([0.0, 0.0, -1.0]), np.tile([0.0, 0.0, 1.0], (len(pial), 1))
    planes = (Plane(0, 0.0, 1), Plane(0, float(size[0]), -1), Plane(1, 0.0, 1), Plane(1, float(width), -1))
    edge = max(size[0] / n_x, width / n_y)
    levels = _levels(pial, pial + thickness * inwards, pial + depth * inwards, cortex_layers, edge, planes)
    bilayer = layered_bricks(levels, quads, normals, cortex_layers, edge, planes)
    bilayer = replace(bilayer, grids=(np.arange(len(pial)).reshape(n_x + 1, n_y + 1),))
    if is_strip:
        bilayer.foot[:, 1] = 0.0  # the same imperfection on both sides
    return bilayer


def spot_factors(points: Array, spots) -> Array:
    """Product (P,) of the factors of spots at points (P, 3).

    The factor of a spot (centre, radius, factor) is full at its centre and 1 beyond its radius [mm, straight line],
    with half a cosine in between.
    """
    factors = np.ones(len(points))
    for centre, radius, factor in spots:
        relative_distance = np.minimum(np.linalg.norm(points - np.asarray(centre), axis=1) / radius, 1.0)
        factors *= 1 + (factor - 1) * 0.5 * (1 + np.cos(np.pi * relative_distance))
    return factors
