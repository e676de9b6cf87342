"""A cortex on a core from a file of tetrahedra: layers by depth or by label, thickness direction, white surface."""

from typing import NamedTuple

import numpy as np
import pyvista
import trimesh
from scipy import sparse
from scipy.spatial import cKDTree
from skfem import MeshTet

from morphofold.errors import ImpossibleBody, NoCortex
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import morton_codes
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.checked_tets import (
    CUT,
    PIAL,
    TET_FACES,
    TetMesh,
    held_nodes,
    read_tets,
    regions_of,
    thickness_excess,
)
from morphofold.sim.mesh.streamlines import descend
from morphofold.sim.scene import MeshFile

STRIDE_IN_EDGES = 0.25  # step towards the white surface, in mean edges of the pial surface


class Nearest(NamedTuple):
    """For points (P, 3): distance to a sheet (P,), nearest point and normal there (P, 3), value of a map there."""

    distance: Array
    foot: Array
    normal: Array
    value: Array


class DistanceToSurface:
    """Distances to a surface of triangles over the points of a mesh.

    Normals at the vertices are weighted by angle, and linear in a triangle, because the gradient of the distance
    itself is constant below each triangle. At symmetry planes they are those of the whole surface.

    Parameters
    ----------
    points : (N, 3) float64
        [mm]
    faces : (F, 3) int
    on_plane : (N, 3) bool
        Whether a point lies on the symmetry plane of each axis.
    values : (N,) float64, optional
        A map of the points, linear in a triangle; 0 if not given. ``values`` are those at the vertices of the surface.
    """

    def __init__(self, points: Array, faces: Ints, on_plane: Bools, values: Array | None = None):
        self._nodes, local_faces = np.unique(faces, return_inverse=True)
        vertices = points[self._nodes]
        self._shape = trimesh.Trimesh(vertices, local_faces.reshape(-1, 3), process=False)
        self._tree = cKDTree(vertices)
        self._normals = within_planes(self._shape.vertex_normals, on_plane[self._nodes])
        self.values = np.zeros(len(vertices)) if values is None else values[self._nodes]
        self._locator = pyvista.PolyData.from_regular_faces(vertices, self._shape.faces)
        #: the nearest vertex is at most this much farther away than the surface
        self.reach = float(self._shape.edges_unique_length.max()) / 3**0.5

    def measure(self, points: Array, exact_nodes: Ints) -> Nearest:
        """Distances of the mesh's points to the nearest vertex; for ``exact_nodes``, to the surface."""
        distance, vertex = self._tree.query(points)
        nearest = Nearest(distance, np.array(self._shape.vertices)[vertex], self._normals[vertex], self.values[vertex])
        exact_nodes = np.setdiff1d(exact_nodes, self._nodes)  # the surface's own nodes have the distance 0
        for values, exact_values in zip(nearest, self.nearest(points[exact_nodes])):
            values[exact_nodes] = exact_values
        return nearest

    def nearest(self, points: Array) -> Nearest:
        """Exact distances of points to the surface."""
        if not len(points):
            return Nearest(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
        face, foot = self._locator.find_closest_cell(points, return_closest_point=True)
        weights = trimesh.triangles.points_to_barycentric(self._shape.triangles[face], foot)
        corners = self._shape.faces[face]
        normal = np.einsum("ik,ikr->ir", weights, self._normals[corners])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        value = np.einsum("ik,ik->i", weights, self.values[corners])
        return Nearest(np.linalg.norm(points - foot, axis=1), foot, normal, value)

    def nodes_above(self, points: Array, tets: Ints, depth: float) -> Ints:
        """Nodes of all tetrahedra that come closer to the surface than ``depth``, and possibly of some more."""
        vertex_distance = self._tree.query(points)[0]
        return np.unique(tets[(vertex_distance[tets] <= depth + self.reach).any(axis=1)])


def within_planes(directions: Array, on_plane: Bools) -> Array:
    """Unit directions (N, 3), those at symmetry planes turned into the plane; 0 where the planes leave no direction.

    This is the mean of a direction and its mirror images. ``on_plane`` (N, 3): see ``DistanceToSurface``.
    """
    at_plane, unit_directions = on_plane.any(axis=1), np.array(directions)
    in_plane = np.where(on_plane[at_plane], 0.0, unit_directions[at_plane])
    length = np.linalg.norm(in_plane, axis=1, keepdims=True)
    unit_directions[at_plane] = np.divide(in_plane, length, out=np.zeros(in_plane.shape), where=length > 1e-9)
    return unit_directions


#: which tetrahedra are cortex (E,); for each node the pial point above it, the direction there (N, 3), and a level (N,)
#: that is 1 on the pial surface, 0 on the white surface, negative below
Layers = tuple[Bools, Array, Array, Array]


def bilayer_from_file(geometry: MeshFile) -> Bilayer:
    """The body of a scene whose shape is ``mesh``.

    Parameters
    ----------
    geometry : MeshFile
        Its ``file`` is a path, or the name of a sample (``data_samples``). Lines, points that no tetrahedron uses, and
        triangles without a label of the scene are ignored.

    Returns
    -------
    Bilayer
        Elements and nodes in the order of a space-filling curve; those of the cortex and of the pial surface come
        first. The pial surface is the part of the boundary that encloses the others, without symmetry planes; depth is
        the exact distance to it. Its facets that are cut are no cortex: depth is not counted from them, and
        ``Bilayer.cortex`` is False there. ``radial`` is the normal at the nearest pial point, a smoothed form of minus
        the gradient of depth; on a symmetry plane it lies in the plane. ``share`` is 1 - depth / thickness; with a
        label it is the distance to the cortex's inner boundary over the sum of this distance and the depth. The white
        vertex of a pial vertex is where the path along -radial reaches share 0, or the smallest share: a crown may be
        thinner than the cortex. Where there is no cortex at the surface, white and pial coincide.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file does not hold such a body, part or map (:mod:`morphofold.sim.mesh.checked_tets`), or there is no
        cortex or no core.
    """
    name, body = geometry.file, read_tets(geometry)
    held_node = held_nodes(geometry, body)
    on_plane = body.on_plane
    pial = DistanceToSurface(body.points, body.faces(PIAL), on_plane, thickness_excess(geometry, body))
    is_cortex, foot, radial, level = (
        _layers_by_depth(name, body, pial, geometry.cortex_thickness)
        if body.cortex is None
        else _layers_by_label(name, body, body.cortex, pial)
    )

    surface_nodes, n_cortex = np.unique(body.faces(PIAL, CUT)), int(is_cortex.sum())
    node_order, element_order = _morton_order(body, surface_nodes, is_cortex)
    new_node, n_surface = np.argsort(node_order), len(surface_nodes)
    points, tets, on_plane = body.points[node_order], new_node[body.tets[element_order]], on_plane[node_order]
    neighbours = np.append(np.argsort(element_order), -1)[body.across[element_order]]
    faces = tets[:, TET_FACES][np.isin(body.kind[element_order], (PIAL, CUT))]
    edge_lengths = np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2)
    radial, level = within_planes(radial[node_order], on_plane), level[node_order]
    stride = STRIDE_IN_EDGES * float(edge_lengths.mean())
    white = _white_surface_matrix(points, tets, neighbours, radial, level, on_plane, n_surface, stride)
    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T), validate=False).with_subdomains(
        {"cortex": np.arange(n_cortex), "core": np.arange(n_cortex, len(tets))}
    )
    return Bilayer(
        mesh,
        faces,
        n_surface,
        white,
        radial,
        foot[node_order],
        np.clip(level, 0.0, 1.0),
        np.sort(new_node[held_node]),
        body.planes,
        tuple(plane.axis for plane in body.planes),
        float(edge_lengths.max()),
        regions=regions_of(geometry, body, node_order[:n_surface]),
        cortex=np.isin(node_order[:n_surface], body.faces(PIAL)) if geometry.cut_facets else None,
        point_data={map_name: values[body.used[node_order]] for map_name, values in body.file.point_maps().items()},
    )


def _layers_by_depth(name: str, body: TetMesh, pial: DistanceToSurface, thickness: float) -> Layers:
    """The cortex by depth: tetrahedra whose centroid is less deep below the pial surface than the cortex is thick.

    Its thickness is ``thickness`` times 1 + the map of ``pial`` at the nearest pial point [mm].
    """
    points, tets = body.points, body.tets
    thinnest, thickest = (thickness * (1 + float(excess)) for excess in (pial.values.min(), pial.values.max()))
    pial_below = pial.measure(points, pial.nodes_above(points, tets, thickest))
    depth = pial_below.distance
    centroid = points[tets].mean(axis=1)
    corner_distance = np.linalg.norm(points[tets] - centroid[:, None], axis=2)
    is_cortex = (depth[tets] + corner_distance).min(axis=1) < thinnest  # depth changes by at most the distance moved
    unsure_tets = np.flatnonzero(~is_cortex & ((depth[tets] - corner_distance).max(axis=1) < thickest))
    centroid_pial = pial.nearest(centroid[unsure_tets])
    is_cortex[unsure_tets] = centroid_pial.distance < thickness * (1 + centroid_pial.value)
    advice = "or set geometry.scale if lengths aren't in mm."
    if is_cortex.all():
        raise ImpossibleBody(
            f"{name}: a cortex of {thickest:g} mm leaves no core in a body {depth.max():.3g} mm deep; reduce "
            f"geometry.cortex_thickness, {advice}"
        )
    n_uncovered = int((~is_cortex & (body.kind == PIAL).any(axis=1)).sum())
    if n_uncovered:
        raise ImpossibleBody(
            f"{name}: {n_uncovered:,} tetrahedra at the pial surface have their centroid below a cortex of "
            f"{thinnest:g} mm; refine the mesh, increase geometry.cortex_thickness, {advice}"
        )
    return is_cortex, pial_below.foot, pial_below.normal, 1 - depth / (thickness * (1 + pial_below.value))


def _layers_by_label(name: str, body: TetMesh, is_cortex: Bools, pial: DistanceToSurface) -> Layers:
    """The cortex by label; its inner boundary is where it meets other tetrahedra."""
    points, tets = body.points, body.tets
    is_inner = is_cortex[:, None] & (body.across >= 0) & ~is_cortex[body.across]
    inner, nodes = DistanceToSurface(points, tets[:, TET_FACES][is_inner], body.on_plane), np.unique(tets[is_cortex])
    pial_nearest = pial.measure(points, nodes)
    if not (pial_nearest.distance[nodes] == 0).any():
        raise NoCortex(f"{name}: the cortex (geometry.cortex_label) is not at the outer surface; use another label.")
    inner_distance = inner.measure(points, nodes).distance
    level = -inner_distance / inner.reach
    thickness = inner_distance + pial_nearest.distance
    level[nodes] = np.divide(inner_distance, thickness, out=np.zeros(len(points)), where=thickness > 0)[nodes]
    return is_cortex, pial_nearest.foot, pial_nearest.normal, level


def _morton_order(body: TetMesh, surface_nodes: Ints, is_cortex: Bools) -> tuple[Ints, Ints]:
    """Nodes and elements along a Morton curve; those of the pial surface and of the cortex first."""
    lower_corner, body_size = body.points.min(axis=0), np.ptp(body.points, axis=0).max()
    is_below = np.isin(np.arange(len(body.points)), surface_nodes, invert=True)
    centroid = body.points[body.tets].mean(axis=1)
    return (
        np.lexsort((morton_codes((body.points - lower_corner) / body_size), is_below)),
        np.lexsort((morton_codes((centroid - lower_corner) / body_size), ~is_cortex)),
    )


def _white_surface_matrix(
    points: Array, tets: Ints, neighbours: Ints, radial: Array, level: Array, on_plane: Bools, n_pial: int, step: float
) -> sparse.csr_matrix:
    """Matrix (S, N) from nodes to the white surface: the point below each pial vertex at which the level is 0.

    Below a vertex on a symmetry plane it is exactly in the plane.
    """
    start_tets = np.zeros(n_pial, dtype=np.int64)
    corner, tet = np.nonzero(tets.T < n_pial)
    start_tets[tets[tet, corner]] = tet
    end_tets, weights = np.empty(n_pial, dtype=np.int64), np.empty((n_pial, 4))
    body_diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    descend(points, tets, neighbours, start_tets, radial, level, step, int(body_diagonal / step), end_tets, weights)
    weights = np.clip(weights, 0.0, 1.0)
    weights[(on_plane[:n_pial, None] & ~on_plane[tets[end_tets]]).any(axis=2)] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(n_pial), 4)
    return sparse.csr_matrix((weights.ravel(), (rows, tets[end_tets].ravel())), (n_pial, len(points)))
