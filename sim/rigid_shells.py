"""Rigid shells at a distance from the body's first surface: how deep a node is outside, and what the shell holds.

A plane leaves some nodes alone. An ellipsoid, and a sphere, has a formula. Around any other body the shell lies at a
distance from the convex hull of the pial surface: a skull bridges the hollows of a brain and does not follow its
surface into the Sylvian fossa. Outside of a convex body the distance is smooth (normals are unique, and they turn
continuously at any distance above 0), and the shell of any gap is a level surface of it.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull

from morphofold.frozen_arrays import Array, Bools
from morphofold.geometry import distance_from_triangle, dot, less
from morphofold.intersections.box_tree import LEAF_SIZE, box_tree, following
from morphofold.kernels import kernel
from morphofold.sim.mesh.brick_mesh import Plane

SPACING_SHARE = 1 / 24  # spacing of the grid over the radius of the ball of the hull's volume
MARGIN_IN_CELLS = 3.0  # of the grid around the widest shell


class PlaneShell(NamedTuple):
    """A plane, which leaves the nodes that ``is_held`` (S,) marks alone."""

    plane: Plane
    is_held: Bools

    def measure(self, x: Array, gap: float, depth: Array, normal: Array) -> None:
        beyond_plane(x, *self.plane, self.is_held, gap, depth, normal)


class EllipsoidShell(NamedTuple):
    """Ellipsoids whose semi-axes are those of the first surface (3,) plus the gap [mm].

    The depth is taken along the gradient of the level function |x / a| - 1: exact on a sphere, first order otherwise.
    """

    semi_axes: Array

    def measure(self, x: Array, gap: float, depth: Array, normal: Array) -> None:
        beyond_ellipsoid(x, self.semi_axes + gap, depth, normal)

    def volume(self, gap: float) -> float:
        """Volume inside of the shell [mm^3]."""
        return 4 / 3 * np.pi * float(np.prod(self.semi_axes + gap))


class HullShell:
    """Shells around the convex hull of points (P, 3): level surfaces of the distance from it.

    Exact distances from the triangles of the hull, on a grid, are interpolated trilinearly; normals are the gradients
    of the interpolant, so that a force is exactly the slope of its energy. Distance is convex, so that its interpolant
    is never too small. Where the spacing is h and the shell has the radii R1 and R2, it is too large by about
    h^2 (1/R1 + 1/R2) / 8 at most. Outside of the grid the distance to the grid is added.

    Parameters
    ----------
    points : (P, 3) float64
        [mm]
    reach : float
        Largest gap of a shell [mm].
    least_spacing : float
        Of the grid [mm]; it is ``SPACING_SHARE`` of the radius of the ball with the volume of the hull, unless that is
        less.
    """

    def __init__(self, points: Array, max_gap: float, least_spacing: float = 0.0):
        hull = ConvexHull(points)
        radius = float(3 * hull.volume / (4 * np.pi)) ** (1 / 3)
        self.spacing = max(SPACING_SHARE * radius, least_spacing)
        grid_margin = max_gap + MARGIN_IN_CELLS * self.spacing
        self.origin = points.min(axis=0) - grid_margin
        grid_size = np.ceil((points.max(axis=0) + grid_margin - self.origin) / self.spacing).astype(int) + 1
        grid_points = self.origin + self.spacing * np.moveaxis(np.indices(grid_size), 0, -1).reshape(-1, 3)
        faces = hull.simplices.astype(np.int64)
        tree = box_tree(points, faces)
        max_depth = MARGIN_IN_CELLS * self.spacing
        distances = distances_from_hull(grid_points, points, faces, hull.equations, tree.bounds, tree.order, max_depth)
        self.values = distances.reshape(grid_size)

    def measure(self, x: Array, gap: float, depth: Array, normal: Array) -> None:
        beyond_level(x, self.values, self.origin, self.spacing, gap, depth, normal)

    def volume(self, gap: float, plane: Plane | None = None) -> float:
        """Volume inside of the shell [mm^3], on the body's side of a plane if one is given."""
        inside_share = np.clip(0.5 + (gap - self.values) / self.spacing, 0, 1)
        if plane is not None:
            grid_coordinates = self.origin[plane.axis] + self.spacing * np.arange(self.values.shape[plane.axis])
            body_side_share = np.clip(0.5 + plane.side * (grid_coordinates - plane.at) / self.spacing, 0, 1)
            inside_share *= np.expand_dims(body_side_share, [axis for axis in range(3) if axis != plane.axis])
        return float(inside_share.sum()) * self.spacing**3


#: a family of shells: ``measure`` gives the depth (S,) [mm] of the first S of the nodes ``x`` (N, 3) outside of the one
#: at a gap from the first surface, 0 or less inside, and outward normals (S, 3), where they are outside
Shell = PlaneShell | EllipsoidShell | HullShell


@njit(inline="always")
def _squared_distance_from_box(point, box):
    squared_distance = 0.0
    for axis in range(3):
        squared_distance += max(box[axis] - point[axis], point[axis] - box[3 + axis], 0.0) ** 2
    return squared_distance


@kernel
def distances_from_hull(points, verts, faces, face_planes, box_bounds, order, greatest_depth):
    """Distance (P,) of points (P, 3) from a convex surface, negative inside; ``greatest_depth`` may stand for more.

    ``face_planes`` (M, 4) are those of the triangles, as of ``ConvexHull``. The distance at the point before, and that
    between the two, bound the search. A point outside is above the plane of at least one of the nearest triangles.
    """
    distances, n_leaves = np.empty(len(points)), len(box_bounds) // 2
    for i in range(len(points)):
        p, nearest, is_outside = points[i], np.inf, False
        if i > 0:
            from_last = less(p, points[i - 1])
            step = np.sqrt(dot(from_last, from_last))
            nearest = (1.0 + 1e-9) * (abs(distances[i - 1]) + step)
            if distances[i - 1] <= -step:  # then this one is inside, too
                nearest = min(nearest, greatest_depth)
        box = 1
        while box > 0:
            if _squared_distance_from_box(p, box_bounds[box]) <= nearest * nearest:
                if box < n_leaves:
                    box *= 2
                    continue
                first_triangle = LEAF_SIZE * (box - n_leaves)
                for f in order[first_triangle : first_triangle + LEAF_SIZE]:
                    plane = face_planes[f]
                    is_outside |= plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3] > 0.0
                    nearest = min(
                        nearest, distance_from_triangle(p, verts[faces[f, 0]], verts[faces[f, 1]], verts[faces[f, 2]])
                    )
            box = following(box)
        distances[i] = nearest if is_outside else -nearest
    return distances


@kernel
def beyond_plane(x, axis, plane_position, side, is_held, gap, depth, normal):
    """Depth beyond a plane, except of the nodes that are held, and its normal."""
    for i in range(len(depth)):
        depth[i] = 0.0 if is_held[i] else -side * (x[i, axis] - plane_position) - gap
        normal[i, axis] = -side


@kernel
def beyond_ellipsoid(x, semi_axes, depth, normal):
    """Depth outside of an ellipsoid, and its normal there."""
    for i in range(len(depth)):
        scaled_radius, gradient_size = 0.0, 0.0
        for axis in range(3):
            scaled_radius += (x[i, axis] / semi_axes[axis]) ** 2
            gradient_size += (x[i, axis] / semi_axes[axis] ** 2) ** 2
        scaled_radius, gradient_size = np.sqrt(scaled_radius), np.sqrt(gradient_size)
        depth[i] = 0.0
        if scaled_radius > 1.0:
            depth[i] = (scaled_radius - 1.0) * scaled_radius / gradient_size
            for axis in range(3):
                normal[i, axis] = x[i, axis] / semi_axes[axis] ** 2 / gradient_size


@kernel
def beyond_level(x, grid_distances, origin, spacing, gap, depth, normal):
    """Depth outside of a level surface of a distance on a grid, and the gradient of the distance."""
    cell, cell_fraction, outside_offset = np.empty(3, dtype=np.int64), np.empty(3), np.empty(3)
    for i in range(len(depth)):
        outside_distance = 0.0
        for axis in range(3):
            grid_coordinate = (x[i, axis] - origin[axis]) / spacing
            clamped_coordinate = min(max(grid_coordinate, 0.0), grid_distances.shape[axis] - 1.0)
            cell[axis] = min(int(clamped_coordinate), grid_distances.shape[axis] - 2)
            cell_fraction[axis] = clamped_coordinate - cell[axis]
            outside_offset[axis] = (grid_coordinate - clamped_coordinate) * spacing
            outside_distance += outside_offset[axis] ** 2
        outside_distance, distance = np.sqrt(outside_distance), 0.0
        normal[i] = 0.0
        for dx in range(2):
            x_weight = cell_fraction[0] if dx else 1.0 - cell_fraction[0]
            for dy in range(2):
                y_weight = cell_fraction[1] if dy else 1.0 - cell_fraction[1]
                for dz in range(2):
                    z_weight = cell_fraction[2] if dz else 1.0 - cell_fraction[2]
                    corner_distance = grid_distances[cell[0] + dx, cell[1] + dy, cell[2] + dz]
                    distance += x_weight * y_weight * z_weight * corner_distance
                    normal[i, 0] += (2 * dx - 1) * y_weight * z_weight * corner_distance / spacing
                    normal[i, 1] += (2 * dy - 1) * x_weight * z_weight * corner_distance / spacing
                    normal[i, 2] += (2 * dz - 1) * x_weight * y_weight * corner_distance / spacing
        for axis in range(3):
            if outside_offset[axis] != 0.0:
                normal[i, axis] = outside_offset[axis] / outside_distance
        depth[i] = distance + outside_distance - gap
