"""A cortex on a core from a file of tetrahedra: layers by depth or by label, thickness direction, white surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from skfem import MeshTet

from morphofold.arrays import Array, Bools, Ints
from morphofold.errors import DoesNotApply, ImpossibleBody, NoCortex
from morphofold.geometry import morton_codes
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.streamlines import descend
from morphofold.sim.mesh.tetmesh import TET_FACES, TetMesh, read_tets
from morphofold.sim.scene import MeshFile

STRIDE_IN_EDGES = 0.25  # step towards the white surface, in mean edges of the pial surface


class Layers(NamedTuple):
    """Which tetrahedra are cortex (E,). For each node the pial point above it, the direction there (N, 3), and a level
    (N,): 1 on the pial surface, 0 on the white surface, negative below."""

    cortex: Bools
    foot: Array
    radial: Array
    level: Array


def bilayer_from_file(geometry: MeshFile) -> Bilayer:
    """The body of a scene whose shape is ``mesh``.

    Parameters
    ----------
    geometry : MeshFile
        Its ``file`` is a path, or the name of a sample (``data_samples``). Triangles, lines, and points that no
        tetrahedron uses are ignored.

    Returns
    -------
    Bilayer
        Elements and nodes in the order of a space-filling curve; those of the cortex and of the pial surface come
        first. The pial surface is the part of the boundary that encloses the others; depth is the exact distance to it.
        ``radial`` is the normal at the nearest pial point, a smoothed form of minus the gradient of depth. ``share`` is
        1 - depth / cortex_thickness; with a label it is the distance to the cortex's inner boundary over the sum of
        this distance and the depth. The white vertex of a pial vertex is where the path along -radial reaches share 0,
        or the smallest share: a crown may be thinner than the cortex. Where a label puts no cortex at the surface,
        white and pial coincide.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file does not hold such a body (:func:`morphofold.sim.mesh.tetmesh.read_tets`), or there is no cortex,
        no core, or no inner surface to hold.
    """
    name, body = geometry.file, read_tets(geometry)
    if geometry.held == "inner" and not len(body.inner):
        raise DoesNotApply(f"{name}: has no inner surface to hold (geometry.held = 'inner'); set held to 'nothing'.")
    pial = _DistanceToSurface(body.points, body.pial)
    thickness = geometry.cortex_thickness
    layers = (
        _layers_by_depth(name, body, pial, thickness)
        if body.cortex is None
        else _layers_by_label(name, body, body.cortex, pial)
    )

    surface, n_cortex = np.unique(body.pial), int(layers.cortex.sum())
    node, element = _morton_order(body, surface, layers.cortex)
    rank, n_surface = _inverse_permutation(node), len(surface)
    points, tets = body.points[node], rank[body.tets[element]]
    across = np.append(_inverse_permutation(element), -1)[body.across[element]]
    faces = tets[:, TET_FACES][(across < 0) & (tets[:, TET_FACES] < n_surface).all(axis=2)]
    edge = np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2)
    radial, level = layers.radial[node], layers.level[node]
    white = _white_surface_matrix(points, tets, across, radial, level, n_surface, STRIDE_IN_EDGES * float(edge.mean()))
    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T), validate=False).with_subdomains(
        {"cortex": np.arange(n_cortex), "core": np.arange(n_cortex, len(tets))}
    )
    held = np.unique(rank[body.inner]) if geometry.held == "inner" else np.empty(0, dtype=np.int64)
    return Bilayer(
        mesh,
        faces,
        n_surface,
        white,
        radial,
        layers.foot[node],
        np.clip(level, 0.0, 1.0),
        held,
        (),
        (),
        float(edge.max()),
    )


class Nearest(NamedTuple):
    """For points (P, 3): distance to a sheet (P,), nearest point of the sheet and normal there (P, 3)."""

    distance: Array
    foot: Array
    normal: Array


class _DistanceToSurface:
    """Distances to a surface of triangles (F, 3) over the ``points`` of a mesh.

    Normals at the vertices are weighted by angle, and linear in a triangle, because the gradient of the distance
    itself is constant below each triangle.
    """

    def __init__(self, points: Array, faces: Ints):
        import pyvista
        import trimesh

        self._nodes, local = np.unique(faces, return_inverse=True)
        corners = points[self._nodes]
        self._shape = trimesh.Trimesh(corners, local.reshape(-1, 3), process=False)
        self._tree = cKDTree(corners)
        self._locator = pyvista.PolyData.from_regular_faces(corners, self._shape.faces)
        #: the nearest vertex is at most this much farther away than the surface
        self.reach = float(self._shape.edges_unique_length.max()) / 3**0.5

    def measure(self, points: Array, exactly: Ints) -> Nearest:
        """Distances of the mesh's points to the nearest vertex; for the points ``exactly``, to the surface."""
        distance, vertex = self._tree.query(points)
        found = Nearest(distance, np.array(self._shape.vertices)[vertex], self._shape.vertex_normals[vertex])
        exactly = np.setdiff1d(exactly, self._nodes)  # the distance of the surface's own nodes is exactly 0 already
        for all_, own in zip(found, self.nearest(points[exactly])):
            all_[exactly] = own
        return found

    def nearest(self, points: Array) -> Nearest:
        """Exact distances of points to the surface."""
        import trimesh

        if not len(points):
            return Nearest(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
        face, foot = self._locator.find_closest_cell(points, return_closest_point=True)
        weights = trimesh.triangles.points_to_barycentric(self._shape.triangles[face], foot)
        normal = np.einsum("ik,ikr->ir", weights, self._shape.vertex_normals[self._shape.faces[face]])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return Nearest(np.linalg.norm(points - foot, axis=1), foot, normal)

    def nodes_above(self, points: Array, tets: Ints, depth: float) -> Ints:
        """Nodes of all tetrahedra that come closer to the surface than ``depth``, and possibly of some more."""
        rough = self._tree.query(points)[0]
        return np.unique(tets[(rough[tets] <= depth + self.reach).any(axis=1)])


def _layers_by_depth(name: str, body: TetMesh, pial: _DistanceToSurface, thickness: float) -> Layers:
    """The cortex by depth: tetrahedra whose centroid is less than ``thickness`` below the pial surface."""
    points, tets = body.points, body.tets
    under = pial.measure(points, pial.nodes_above(points, tets, thickness))
    depth = under.distance
    centroid = points[tets].mean(axis=1)
    arm = np.linalg.norm(points[tets] - centroid[:, None], axis=2)
    cortex = (depth[tets] + arm).min(axis=1) < thickness  # depth changes by no more than the distance moved
    open_ = np.flatnonzero(~cortex & ((depth[tets] - arm).max(axis=1) < thickness))
    cortex[open_] = pial.nearest(centroid[open_]).distance < thickness
    cure = "or set geometry.scale if lengths aren't in mm."
    if cortex.all():
        raise ImpossibleBody(
            f"{name}: a cortex of {thickness:g} mm leaves no core in a body {depth.max():.3g} mm deep; reduce "
            f"geometry.cortex_thickness, {cure}"
        )
    bare = int((~cortex & ((body.across < 0) & (depth[tets[:, TET_FACES]] == 0).all(axis=2)).any(axis=1)).sum())
    if bare:
        raise ImpossibleBody(
            f"{name}: {bare:,} tetrahedra at the pial surface have their centroid below a cortex of {thickness:g} mm; "
            f"refine the mesh, increase geometry.cortex_thickness, {cure}"
        )
    return Layers(cortex, under.foot, under.normal, 1 - depth / thickness)


def _layers_by_label(name: str, body: TetMesh, cortex: Bools, pial: _DistanceToSurface) -> Layers:
    """The cortex by label; its inner boundary is where it meets other tetrahedra."""
    points, tets = body.points, body.tets
    inside = cortex[:, None] & (body.across >= 0) & ~cortex[body.across]
    border, grey = _DistanceToSurface(points, tets[:, TET_FACES][inside]), np.unique(tets[cortex])
    under = pial.measure(points, grey)
    if not (under.distance[grey] == 0).any():
        raise NoCortex(f"{name}: the cortex (geometry.cortex_label) is not at the outer surface; use another label.")
    above = border.measure(points, grey).distance
    level = -above / border.reach
    total = above + under.distance
    level[grey] = np.divide(above, total, out=np.zeros(len(points)), where=total > 0)[grey]
    return Layers(cortex, under.foot, under.normal, level)


def _morton_order(body: TetMesh, surface: Ints, cortex: Bools) -> tuple[Ints, Ints]:
    """Nodes and elements along a Morton curve; those of the pial surface and of the cortex first."""
    low, size = body.points.min(axis=0), np.ptp(body.points, axis=0).max()
    below = np.ones(len(body.points), dtype=bool)
    below[surface] = False
    centroid = body.points[body.tets].mean(axis=1)
    return (
        np.lexsort((morton_codes((body.points - low) / size), below)),
        np.lexsort((morton_codes((centroid - low) / size), ~cortex)),
    )


def _inverse_permutation(order: Ints) -> Ints:
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return rank


def _white_surface_matrix(
    points: Array, tets: Ints, across: Ints, radial: Array, level: Array, n_surface: int, stride: float
) -> sparse.csr_matrix:
    """Matrix (S, N) from nodes to the white surface: the point below each pial vertex at which the level is 0."""
    start = np.zeros(n_surface, dtype=np.int64)
    for k in range(4):
        at = np.flatnonzero(tets[:, k] < n_surface)
        start[tets[at, k]] = at
    where, weights = np.empty(n_surface, dtype=np.int64), np.empty((n_surface, 4))
    longest = float(np.linalg.norm(np.ptp(points, axis=0)))
    descend(points, tets, across, start, radial, level, stride, int(longest / stride), where, weights)
    weights = np.clip(weights, 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(n_surface), 4)
    return sparse.csr_matrix((weights.ravel(), (rows, tets[where].ravel())), (n_surface, len(points)))
