"""Distances of points to a surface of triangles, with the nearest point, the normal and a map there."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Bools, Ints


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
        A map of the points, linear in a triangle; 0 if not given.
    """

    def __init__(self, points: Array, faces: Ints, on_plane: Bools, values: Array | None = None):
        import pyvista
        import trimesh

        self._nodes, local = np.unique(faces, return_inverse=True)
        corners = points[self._nodes]
        self._shape = trimesh.Trimesh(corners, local.reshape(-1, 3), process=False)
        self._tree = cKDTree(corners)
        self._normals = within_planes(self._shape.vertex_normals, on_plane[self._nodes])
        self._values = np.zeros(len(corners)) if values is None else values[self._nodes]
        self._locator = pyvista.PolyData.from_regular_faces(corners, self._shape.faces)
        #: the nearest vertex is at most this much farther away than the surface
        self.reach = float(self._shape.edges_unique_length.max()) / 3**0.5

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest value of the map."""
        return float(self._values.min()), float(self._values.max())

    def measure(self, points: Array, exactly: Ints) -> Nearest:
        """Distances of the mesh's points to the nearest vertex; for the points ``exactly``, to the surface."""
        distance, vertex = self._tree.query(points)
        found = Nearest(distance, np.array(self._shape.vertices)[vertex], self._normals[vertex], self._values[vertex])
        exactly = np.setdiff1d(exactly, self._nodes)  # the distance of the surface's own nodes is exactly 0 already
        for all_, own in zip(found, self.nearest(points[exactly])):
            all_[exactly] = own
        return found

    def nearest(self, points: Array) -> Nearest:
        """Exact distances of points to the surface."""
        import trimesh

        if not len(points):
            return Nearest(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
        face, foot = self._locator.find_closest_cell(points, return_closest_point=True)
        weights = trimesh.triangles.points_to_barycentric(self._shape.triangles[face], foot)
        corners = self._shape.faces[face]
        normal = np.einsum("ik,ikr->ir", weights, self._normals[corners])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        value = np.einsum("ik,ik->i", weights, self._values[corners])
        return Nearest(np.linalg.norm(points - foot, axis=1), foot, normal, value)

    def nodes_above(self, points: Array, tets: Ints, depth: float) -> Ints:
        """Nodes of all tetrahedra that come closer to the surface than ``depth``, and possibly of some more."""
        rough = self._tree.query(points)[0]
        return np.unique(tets[(rough[tets] <= depth + self.reach).any(axis=1)])


def within_planes(directions: Array, on_plane: Bools) -> Array:
    """Unit directions (N, 3), those at symmetry planes turned into the plane; 0 where the planes leave no direction.

    This is the mean of a direction and its mirror images. ``on_plane`` (N, 3): see ``DistanceToSurface``.
    """
    at = np.flatnonzero(on_plane.any(axis=1))
    found = np.array(directions)
    inside = np.where(on_plane[at], 0.0, found[at])
    length = np.linalg.norm(inside, axis=1, keepdims=True)
    found[at] = np.divide(inside, length, out=np.zeros(inside.shape), where=length > 1e-9)
    return found
