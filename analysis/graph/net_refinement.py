"""Refinement of a net: curves move onto the crown, and junctions to the point where their arms meet."""

import math

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.curvatures import _collect_neighbourhood, _solve_cholesky
from morphofold.analysis.graph.curve_net import Net, moved, resampled, smoothed
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.frozen_arrays import Array
from morphofold.geometry import adjacency, arc_length, cross, dot, less, position
from morphofold.kernels import kernel, reading
from morphofold.surface import PerVertex
from morphofold.threads import in_blocks

N_ROUNDS = 3
FIT_RADIUS_IN_EDGES = 1.6  # radius in edges within which there are enough vertices for a fit
# in widths: step of a curve, radius of a fit, largest move per round
STEP_IN_WIDTHS, FIT_RADIUS_IN_WIDTHS, LARGEST_MOVE_IN_WIDTHS = 0.05, 0.3, 1 / 6
# in widths: stretch at a junction that does not move, smoothing along a curve
FIXED_STRETCH_IN_WIDTHS, SMOOTHING_IN_WIDTHS = 0.2, 0.2
# distances in widths from a junction between which the direction of an arm is taken,
ARM_START_IN_WIDTHS, ARM_STOP_IN_WIDTHS = 0.5, 1.5
LARGEST_ARM_SHARE = 0.6  # and the largest share of the arm that is used
MEETING_RANGE_IN_WIDTHS = (0.3, 1.0)  # distances in widths at which the arms locate a junction: farther
# out they bend, and the junction would be less exact
# largest move of a junction per round, in widths; weight of its old position
LARGEST_JUNCTION_MOVE_IN_WIDTHS, OLD_POSITION_WEIGHT = 0.25, 0.3
LARGEST_STRAIGHT_SHARE = 0.3  # largest share of an arm that is made straight


def refine(net: Net, operators: SurfaceOperators, D: PerVertex, width: float, rounds: int = N_ROUNDS) -> None:
    """Move the curves of a net onto the crowns of the depth potential ``D`` (N,), and its junctions to where arms meet.

    Each point moves across its curve to the top of a parabola fitted to ``D``. Curves are smoothed over a fifth of a
    width. A junction moves towards the point nearest to the lines along its arms. These lines are fitted between 0.3
    and 1 width from the junction, or between 0.5 and 1.5 if it was merged from several, because closer arms are those
    of its parts. Within 0.5 widths the arms become straight, because on this last stretch there is no crest to follow.
    The arms themselves do not move with their junction. Otherwise, nearly parallel arms would let it drift along them.
    """
    neighbours = adjacency(len(operators.verts), operators.faces)
    tree = cKDTree(operators.verts)
    fit_radii = np.maximum(FIT_RADIUS_IN_WIDTHS * width, FIT_RADIUS_IN_EDGES * operators.local_edges)
    for _ in range(rounds):
        for arc in net.arcs.values():
            arc.points = resampled(arc.points, max(STEP_IN_WIDTHS * width, 0.3 * operators.mean_edge))
        _move_curves_onto_crown(net, operators, D, neighbours, tree, fit_radii, width)
        for arc in net.arcs.values():
            arc.points = smoothed(arc.points, SMOOTHING_IN_WIDTHS * width)
        _move_junctions(net, operators, tree, width)


def _move_curves_onto_crown(net, operators, D, neighbours, tree, radii, width):
    """Move the points of all curves across their curve, onto the crown."""
    if not net.arcs:
        return
    degrees = net.degrees()
    curves = []
    for arc in net.arcs.values():
        arc_lengths = arc_length(arc.points)
        is_fixed = np.zeros(len(arc_lengths), dtype=bool)
        for end_node, end_distance in ((arc.a, arc_lengths), (arc.b, arc_lengths[-1] - arc_lengths)):
            if degrees[end_node] > 2:
                is_fixed |= end_distance < FIXED_STRETCH_IN_WIDTHS * width
        curves.append((arc.points, np.gradient(arc.points, axis=0), ~is_fixed))
    points, directions, is_free = (np.concatenate(arrays) for arrays in zip(*curves))
    nearest = tree.query(points)[1]
    shift = np.zeros_like(points)
    fit_arrays = reading(points, directions, nearest, operators.verts, operators.normals, neighbours, D, radii[nearest])
    in_blocks(_shift_onto_crown, len(points), *fit_arrays, LARGEST_MOVE_IN_WIDTHS * width, shift)
    points = points + np.where(is_free[:, None], shift, 0.0)
    for arc, shifted in zip(net.arcs.values(), np.split(points, np.cumsum([len(curve[0]) for curve in curves])[:-1])):
        if arc.a == arc.b and degrees[arc.a] == 2:  # a ring
            shifted[0] = shifted[-1] = net.nodes[arc.a].at = 0.5 * (shifted[0] + shifted[-1])
        arc.points = moved(shifted, net.nodes[arc.a].at, net.nodes[arc.b].at)


def _move_junctions(net, operators, tree, width):
    """Move junctions to the point nearest to the lines of their arms; the arms follow, and start straight."""
    arcs_of_node = net.ends()
    for node, arc_ids in arcs_of_node.items():
        if len(arc_ids) < 3:
            continue
        junction = net.nodes[node]
        normal = upright(operators, tree, junction.at, width)
        tangent_projection = np.eye(3) - np.outer(normal, normal)
        old_weight = OLD_POSITION_WEIGHT * len(arc_ids)
        matrix = old_weight * np.eye(3) + np.outer(normal, normal)
        right_side = old_weight * junction.at + normal * (normal @ junction.at)
        near, far = MEETING_RANGE_IN_WIDTHS if junction.merged == 1 else (ARM_START_IN_WIDTHS, ARM_STOP_IN_WIDTHS)
        for line in _arm_curves(net, node, arc_ids):
            arc_lengths = arc_length(line)
            outer_distance = min(far * width, LARGEST_ARM_SHARE * arc_lengths[-1])
            window = line[(arc_lengths >= min(near * width, 0.5 * outer_distance)) & (arc_lengths <= outer_distance)]
            if len(window) < 2:
                continue
            arm_middle = window.mean(axis=0)
            flat_points = (window - arm_middle) @ tangent_projection
            direction = np.linalg.svd(flat_points, full_matrices=False)[2][0]
            across_line = tangent_projection - np.outer(direction, direction)  # projects across the line, in the plane
            matrix, right_side = matrix + across_line, right_side + across_line @ arm_middle
        shift = np.linalg.solve(matrix, right_side) - junction.at
        shift_length, largest_move = np.linalg.norm(shift), LARGEST_JUNCTION_MOVE_IN_WIDTHS * width
        junction.at = junction.at + shift * min(1.0, largest_move / shift_length if shift_length > 0 else 1.0)
    for arc in net.arcs.values():
        degree_a, degree_b = len(arcs_of_node[arc.a]), len(arcs_of_node[arc.b])
        old_points = arc.points.copy()
        old_points[0], old_points[-1] = net.nodes[arc.a].at, net.nodes[arc.b].at
        straight_start = _with_straight_start(old_points, width) if degree_a > 2 else old_points
        straight_end = _with_straight_start(old_points[::-1], width)[::-1] if degree_b > 2 else old_points
        arc.points = straight_start + (straight_end - old_points)  # both less the old, so that neither end comes first


def upright(operators: SurfaceOperators, tree: cKDTree, point: Array, width: float) -> Array:
    """Unit normal (3,) at a point: the mean over vertices within half a width that face the same way."""
    normal = operators.normals[tree.query(point)[1]]
    near_normals = operators.normals[tree.query_ball_point(point, 0.5 * width)]
    normal_sum = normal + near_normals[near_normals @ normal > 0.2].sum(axis=0)
    unit_normal: Array = normal_sum / np.linalg.norm(normal_sum)
    return unit_normal


def _arm_curves(net, node, arc_ids):
    """The curves of a junction, each directed away from it; a loop in both directions."""
    for arc_id in dict.fromkeys(arc_ids):
        arc = net.arcs[arc_id]
        if arc.a == node:
            yield arc.points
        if arc.b == node:
            yield arc.points[::-1]


def _with_straight_start(line, width):
    """An arm with its first stretch replaced by a chord."""
    arc_lengths = arc_length(line)
    last = int(np.searchsorted(arc_lengths, min(ARM_START_IN_WIDTHS * width, LARGEST_STRAIGHT_SHARE * arc_lengths[-1])))
    if 0 < last < len(line):
        fraction = (arc_lengths[: last + 1] / arc_lengths[last])[:, None]
        line = line.copy()
        line[: last + 1] = (1 - fraction) * line[0] + fraction * line[last]
    return line


@kernel
def _shift_onto_crown(start, stop, points, along, nearest, verts, normals, indptr, indices, D, radii, max_shift, shift):
    """Write the shift (P, 3) of each point across its curve to the top of ``D ~ a + b s + c s^2 + e u`` (s across, u
    along), fitted within ``radii`` (P,); where the fit has no top nothing is written."""
    seen, queue = np.zeros(len(verts), np.int32), np.empty(len(verts), np.int32)
    A, right_side, monomials = np.empty((4, 4)), np.empty(4), np.empty(4)
    stamp = 0
    for i in range(start, stop):
        vertex, radius = nearest[i], radii[i]
        stamp += 1
        n_points = _collect_neighbourhood(vertex, verts, normals, indptr, indices, 1.5 * radius, seen, stamp, queue)
        n, tangent = position(normals, vertex), position(along, i)
        normal_part = dot(tangent, n)
        tangent = tangent[0] - normal_part * n[0], tangent[1] - normal_part * n[1], tangent[2] - normal_part * n[2]
        length = math.sqrt(dot(tangent, tangent))
        if length == 0.0:
            continue
        tangent = tangent[0] / length, tangent[1] / length, tangent[2] / length
        across = cross(n, tangent)
        for row in range(4):
            right_side[row] = 0.0
            for column in range(4):
                A[row, column] = 0.0
        for q in range(n_points):
            neighbour = queue[q]
            offset = less(position(verts, neighbour), position(points, i))
            s, u = dot(offset, across) / radius, dot(offset, tangent) / radius
            weight = 1.0 - dot(offset, offset) / radius**2
            if weight <= 0.0:
                continue
            monomials[0], monomials[1], monomials[2], monomials[3] = 1.0, s, s * s, u
            for row in range(4):
                right_side[row] += weight * monomials[row] * (D[neighbour] - D[vertex])
                for column in range(4):
                    A[row, column] += weight * monomials[row] * monomials[column]
        if _solve_cholesky(A, right_side, len(right_side)) == 4 and right_side[2] < 0.0:
            step = -0.5 * right_side[1] / right_side[2] * radius
            step = min(max(step, -max_shift), max_shift)
            for k in range(3):
                shift[i, k] = step * across[k]
