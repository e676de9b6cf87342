"""Tree of boxes around the triangles of a surface, and the hits of a ray, none of which is lost or doubled at an edge.

The triangles are sorted along a Morton curve. Blocks of four are the leaves of a complete binary tree, whose boxes are
joined from below. The tree has at most one box per triangle, for any shape: a long triangle widens only the boxes
above it. A walk needs no stack::

    node = 1
    while node > 0:
        if meets(bounds[node], box):
            if node < n_leaves:
                node *= 2
                continue
            ...                                                 # look at the triangles of this leaf
        node = following(node)
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import corners, cross, dot, less, morton_codes
from morphofold.intersections.signs import TIE_BREAKING_DIRECTION, plane_sign
from morphofold.kernels import kernel, reading

LEAF_SIZE = 4  # triangles in a leaf

# margin of boxes around their triangles, as a share of the largest coordinate: safe against rounding
_BOX_MARGIN = 1e-12


class BoxTree(NamedTuple):
    """Boxes of the triangles of a surface.

    ``bounds`` (2 L, 6) float64 holds lower and upper corners [mm]; box 1 is the root, k has the children 2 k and
    2 k + 1, the last L are leaves. Leaf k holds the triangles
    ``order[LEAF_SIZE (k - L) : LEAF_SIZE (k - L + 1)]``.
    """

    bounds: Array
    order: Ints
    face_boxes: Array  # (M, 6), the box of each triangle


def box_tree(verts: Array, faces: Ints) -> BoxTree:
    """Tree of the boxes of the triangles ``faces`` (M, 3) of ``verts`` (N, 3) [mm]."""
    triangle_boxes = _triangle_boxes(*reading(verts, faces), _BOX_MARGIN * np.abs(verts).max())
    low, high = triangle_boxes[:, :3].min(axis=0), triangle_boxes[:, 3:].max(axis=0)
    centres = (triangle_boxes[:, :3] + triangle_boxes[:, 3:]) / 2
    order = np.argsort(morton_codes((centres - low) / max((high - low).max(), 1e-300)), kind="stable")
    n_leaves = 1
    while n_leaves * LEAF_SIZE < len(faces):
        n_leaves *= 2
    return BoxTree(_tree_bounds(*reading(triangle_boxes, order), n_leaves), order, triangle_boxes)


@kernel
def _triangle_boxes(verts, faces, margin):
    boxes = np.empty((len(faces), 6))
    for face in range(len(faces)):
        for axis in range(3):
            a, b, c = verts[faces[face, 0], axis], verts[faces[face, 1], axis], verts[faces[face, 2], axis]
            boxes[face, axis], boxes[face, 3 + axis] = min(a, b, c) - margin, max(a, b, c) + margin
    return boxes


@kernel
def _tree_bounds(triangle_boxes, order, n_leaves):
    bounds = np.empty((2 * n_leaves, 6))
    for node in range(2 * n_leaves):
        for axis in range(3):
            bounds[node, axis], bounds[node, 3 + axis] = np.inf, -np.inf  # meets nothing
    for slot in range(len(order)):
        _widen_box(bounds[n_leaves + slot // LEAF_SIZE], triangle_boxes[order[slot]])
    for node in range(n_leaves - 1, 0, -1):
        _widen_box(bounds[node], bounds[2 * node])
        _widen_box(bounds[node], bounds[2 * node + 1])
    return bounds


@njit(inline="always")
def _widen_box(box, other_box):
    for axis in range(3):
        box[axis] = min(box[axis], other_box[axis])
        box[3 + axis] = max(box[3 + axis], other_box[3 + axis])


@njit(inline="always")
def meets(box, other_box):
    """Whether two boxes (6,) have a point in common."""
    return (
        box[0] <= other_box[3]
        and box[3] >= other_box[0]
        and box[1] <= other_box[4]
        and box[4] >= other_box[1]
        and box[2] <= other_box[5]
        and box[5] >= other_box[2]
    )


@njit(inline="always")
def meets_ray(box, origin, direction):
    """Whether a box (6,) has a point in common with the ray from ``origin`` along ``direction``, both (3,)."""
    entry_distance, exit_distance = 0.0, np.inf
    for axis in range(3):
        if direction[axis] == 0.0:
            if box[axis] > origin[axis] or box[3 + axis] < origin[axis]:
                return False
        else:
            near_face, far_face = (axis, 3 + axis) if direction[axis] > 0.0 else (3 + axis, axis)
            entry_distance = max(entry_distance, (box[near_face] - origin[axis]) / direction[axis])
            exit_distance = min(exit_distance, (box[far_face] - origin[axis]) / direction[axis])
    return entry_distance <= exit_distance


@njit(inline="always")
def following(node):
    """The next box after box k and all boxes below it; 0 at the end."""
    while node % 2 == 1:
        node //= 2
    return node + 1 if node > 0 else 0


@kernel
def ray_hits(verts, faces, bounds, order, origin, direction, distances, signs):
    """Where and in which direction a ray crosses a surface: exact, also through edges and vertices.

    If it meets an edge or a vertex, the ray counts as turned towards TIE_BREAKING_DIRECTION by an infinitely small
    angle: it crosses the faces that a ray beside it would cross. A face that holds the origin is not crossed.

    Parameters
    ----------
    verts, faces, bounds, order
        The surface and its tree of boxes.
    origin, direction : tuple of three float
        Unit direction.
    distance, sign : (S,) float64
        Output: distance [mm] and sign of each hit, 1 outwards and -1 inwards, unsorted, as many as fit.

    Returns
    -------
    hits, winding : int
        How many hits there are, and the sum of their signs: the winding number at the origin of a closed surface.
    """
    n_hits, winding = 0, 0
    node, n_leaves = 1, len(bounds) // 2
    while node > 0:
        if meets_ray(bounds[node], origin, direction):
            if node < n_leaves:
                node *= 2
                continue
            for slot in range(LEAF_SIZE * (node - n_leaves), min(LEAF_SIZE * (node - n_leaves + 1), len(order))):
                face = order[slot]
                a, b, c = corners(verts, faces, face)
                hit_sign = _ray_sign(a, b, c, origin, direction)
                if hit_sign != 0:
                    if n_hits < len(distances):
                        distances[n_hits], signs[n_hits] = _ray_distance(a, b, c, origin, direction), hit_sign
                    n_hits += 1
                    winding += hit_sign
        node = following(node)
    return n_hits, winding


@kernel
def ray_winding(verts, faces, origin, direction):
    """The winding as from ``ray_hits``, for few faces: each face is tested, so no tree is needed."""
    winding = 0
    for face in range(len(faces)):
        a, b, c = corners(verts, faces, face)
        winding += _ray_sign(a, b, c, origin, direction)
    return winding


@kernel
def _ray_sign(a, b, c, origin, direction):
    """1 if the ray leaves through the front of the triangle abc, -1 if it enters, 0 if it misses."""
    side = _edge_sign(a, b, origin, direction)
    if side == 0 or _edge_sign(b, c, origin, direction) != side or _edge_sign(c, a, origin, direction) != side:
        return 0
    return side if plane_sign(a, b, c, origin, 1.0) == -side else 0


@kernel
def _edge_sign(a, b, origin, direction):
    """The side of the line along a ray on which the edge ab passes."""
    sign = plane_sign(a, b, origin, direction, 0.0)
    return sign if sign != 0 else plane_sign(a, b, origin, TIE_BREAKING_DIRECTION, 0.0)


@kernel
def _ray_distance(a, b, c, origin, direction):
    """Distance along the ray to the point where it meets a triangle; the point is always in the triangle."""
    to_a, to_b, to_c = less(a, origin), less(b, origin), less(c, origin)
    along_a, along_b, along_c = dot(to_a, direction), dot(to_b, direction), dot(to_c, direction)
    weight_a, weight_b = abs(dot(cross(to_b, to_c), direction)), abs(dot(cross(to_c, to_a), direction))
    weight_c = abs(dot(cross(to_a, to_b), direction))
    weight_sum = weight_a + weight_b + weight_c
    if weight_sum == 0.0:  # the ray runs in the triangle's plane
        return (along_a + along_b + along_c) / 3
    return (weight_a * along_a + weight_b * along_b + weight_c * along_c) / weight_sum
