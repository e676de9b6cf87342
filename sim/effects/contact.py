"""Self-contact of the pial surface: nodes against triangles.

For each node, find the nearest node whose surface faces it (opposed normals, far apart in the reference), then the
nearest triangle around that node. Triangles are chosen again every second step, and the search is repeated when the
surface has moved by a fifth of the search radius.
Until nodes face each other within that radius, a step costs one empty loop. The penalty acts within a gap of 0.17 cell
sizes. It is scaled by nodal mass, so it never needs a smaller step.
"""

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import sparse

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import (
    area_vector,
    corners,
    dot,
    incident_faces,
    less,
    nearest_weights,
    position,
    unit,
    vertex_normals,
)
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, joined_springs
from morphofold.sim.scene.table_bases import EffectOptions

GAP_IN_CELLS = 0.17  # contact acts below this distance, in cell sizes h
WAIT_DEPTH_IN_CELLS = 0.2  # growth slows down if nodes are pressed deeper than this into the gap [h]
PENALTY_STIFFNESS = 0.2  # penalty force per mass and penetration, at a step of one
SPLIT_PENALTY_RATIO = 1.5  # on that where the bulk modulus is split, so that nodes are 1.7 times as light
PENALTY_DAMPING = 0.1  # damping force per mass and approach speed: 0.25 would be unstable on coarse levels
SEARCH_RADIUS_IN_CELLS = 1.5  # search radius in h
STEPS_PER_PAIRING = 2  # a wall moves by up to a cell in twelve steps: nodes would slip past the triangles of then
DEEPEST_PENETRATION_SHARE = 0.7  # penetrations beyond this share of the search radius are not contact
#: pairs closer than this in the reference are neighbours, unless across a gap [longest edge at either node]
NEIGHBOUR_DISTANCE_IN_EDGES = 1.2
NEAR_PAIR_IN_NEIGHBOUR_DISTANCES = 2.5  # pairs closer than this in the reference are the flanks of one ridge
LARGEST_SLIDE_IN_CELLS = 1.0  # a node that has slid farther off its triangle does not touch it [h]
DEEPEST_NEAR_PAIR_IN_CELLS = 0.1  # a pair near in the reference counts only until it is so deep [h]
OPPOSED_NORMALS_COSINE = -0.2  # largest cosine between the normals of a pair
NEARLY_AS_NEAR_IN_CELLS = 0.05  # a triangle so much farther away than the one that a node touches may be next [h]
SAME_SLOPE_COSINE = 0.9999  # cosine between the normals of triangles above which they are one wall
TINY_LENGTH = 1e-300  # for an area of 0
#: triangles of a flat quad overlap: the first counts, independent of rounding in its distance
DISTANCE_TIE_TOLERANCE = 1e-6


@njit(inline="always")
def _is_neighbour(X, N, i, j, reach, factor=1.0):
    """Whether node j is in the neighbourhood of node i: in the reference closer than ``factor`` the larger ``reach`` of
    the two, and not across a gap.

    A node is across a gap from i if it lies in front of i there and its normal is opposed; N (S, 3) are normals of X.
    """
    offset, normal = less(position(X, j), position(X, i)), position(N, i)
    if dot(offset, offset) >= (factor * max(reach[i], reach[j])) ** 2:
        return False
    return dot(normal, position(N, j)) > OPPOSED_NORMALS_COSINE or dot(offset, normal) <= 0.0


@kernel
def _foot(x, i, tri, triangle):
    """Barycentric weights of the point of ``triangle`` that is nearest to node i."""
    a, b, c = corners(x, tri, triangle)
    return nearest_weights(position(x, i), a, b, c)


@kernel
def _from_foot(values, i, tri, triangle, weights):
    """The vector of node i less that of the point of ``triangle`` with barycentric ``weights``."""
    node_value, (a, b, c) = position(values, i), corners(values, tri, triangle)
    return (
        node_value[0] - weights[0] * a[0] - weights[1] * b[0] - weights[2] * c[0],
        node_value[1] - weights[0] * a[1] - weights[1] * b[1] - weights[2] * c[1],
        node_value[2] - weights[0] * a[2] - weights[1] * b[2] - weights[2] * c[2],
    )


@kernel
def _unit_normal(x, tri, triangle):
    """Of ``triangle``; 0 if it has no area."""
    a, b, c = corners(x, tri, triangle)
    n0, n1, n2 = area_vector(a, b, c)
    length = max((n0 * n0 + n1 * n1 + n2 * n2) ** 0.5, TINY_LENGTH)
    return n0 / length, n1 / length, n2 / length


def find_facing(x: Array, X: Array, N: Array, normals: Array, n_nodes: int, radius: float, reach: Array, facing: Ints):
    """Nearest node within ``radius`` with an opposed normal and outside the node's neighbourhood; -1: none."""
    if not np.ptp(x[:n_nodes]) < 10 * np.ptp(X[:n_nodes]):  # the run burst, as its next measurement will find
        return
    cells = ((x[:n_nodes] - x[:n_nodes].min(axis=0)) / radius).astype(np.int64)  # cubes
    cell_numbers = np.ravel_multi_index(tuple(cells.T), tuple(grid_shape := cells.max(axis=0) + 1))
    cell_starts = np.concatenate([[0], np.cumsum(np.bincount(cell_numbers, minlength=grid_shape.prod()))])
    in_cells = cells, grid_shape, cell_starts, np.argsort(cell_numbers, kind="stable")
    _find_facing(x, X, N, normals, radius, reach, *in_cells, facing)


@kernel(parallel=True)
def _find_facing(x, X, N, normals, radius, reach, cells, grid_shape, cell_starts, nodes_by_cell, facing):
    for i in prange(len(cells)):
        least_distance_squared, nearest_node = radius * radius, -1
        cell_x, cell_y, cell_z = position(cells, i)
        for ix in range(max(cell_x - 1, 0), min(cell_x + 2, grid_shape[0])):
            for iy in range(max(cell_y - 1, 0), min(cell_y + 2, grid_shape[1])):
                for iz in range(max(cell_z - 1, 0), min(cell_z + 2, grid_shape[2])):
                    cell_number = (ix * grid_shape[1] + iy) * grid_shape[2] + iz
                    for member in range(cell_starts[cell_number], cell_starts[cell_number + 1]):
                        j = nodes_by_cell[member]
                        offset = less(position(x, j), position(x, i))
                        distance_squared = dot(offset, offset)
                        if distance_squared >= least_distance_squared or j == i:
                            continue
                        if dot(position(normals, i), position(normals, j)) > OPPOSED_NORMALS_COSINE:
                            continue
                        if _is_neighbour(X, N, i, j, reach):
                            continue
                        least_distance_squared, nearest_node = distance_squared, j
        facing[i] = nearest_node


@kernel(parallel=True)
def choose_triangles(x, X, N, tri, ring_starts, ring_triangles, facing, reach, partner_tri):
    """For each node, the nearest of the triangles around the node that faces it; -1: none.

    Triangles with a corner in the node's neighbourhood do not count.
    """
    # beyond this, no corner of a triangle around the facing node is a neighbour: corners are two edges away at most
    far_distance = (1.0 + 2.0 / NEIGHBOUR_DISTANCE_IN_EDGES) * reach.max()
    for i in prange(len(facing)):
        least_distance_squared, nearest_triangle, facing_node = 1e300, -1, facing[i]
        if facing_node >= 0:
            ungrown_offset = less(position(X, facing_node), position(X, i))
            for ring_row in range(ring_starts[facing_node], ring_starts[facing_node + 1]):
                triangle = ring_triangles[ring_row]
                if dot(ungrown_offset, ungrown_offset) < far_distance * far_distance and (
                    _is_neighbour(X, N, i, tri[triangle, 0], reach)
                    or _is_neighbour(X, N, i, tri[triangle, 1], reach)
                    or _is_neighbour(X, N, i, tri[triangle, 2], reach)
                ):
                    continue
                offset = _from_foot(x, i, tri, triangle, _foot(x, i, tri, triangle))
                distance_squared = dot(offset, offset)
                if distance_squared < least_distance_squared * (1.0 - DISTANCE_TIE_TOLERANCE):
                    least_distance_squared, nearest_triangle = distance_squared, triangle
        partner_tri[i] = nearest_triangle


@kernel(parallel=True)
def press(x, v, X, N, mass, tri, partner_tri, cell_size, reach, stiffness, push, foot_weights, depth, energy):
    """Contact force of each node on its triangle: push (S, 3), barycentric weights (S, 3), depth (S,), energy (S,).

    A pair closer than ``NEAR_PAIR_IN_NEIGHBOUR_DISTANCES`` in the reference counts only until it is
    ``DEEPEST_NEAR_PAIR_IN_CELLS`` deep: such pairs are the flanks of one ridge, not two walls of a sulcus.
    """
    gap, max_penetration = GAP_IN_CELLS * cell_size, DEEPEST_PENETRATION_SHARE * SEARCH_RADIUS_IN_CELLS * cell_size
    for i in prange(len(partner_tri)):
        depth[i] = energy[i] = 0.0
        face = partner_tri[i]
        if face < 0:
            continue
        normal = _unit_normal(x, tri, face)
        distance = dot(normal, less(position(x, i), position(x, tri[face, 0])))
        if distance >= gap or distance < -max_penetration:
            continue
        foot = _foot(x, i, tri, face)
        offset = _from_foot(x, i, tri, face, foot)
        if dot(offset, offset) - distance * distance > (LARGEST_SLIDE_IN_CELLS * cell_size) ** 2:
            continue
        if distance < -DEEPEST_NEAR_PAIR_IN_CELLS * cell_size and _is_neighbour(
            X, N, i, tri[face, 0], reach, NEAR_PAIR_IN_NEIGHBOUR_DISTANCES
        ):
            continue
        m = min(mass[i], mass[tri[face, 0]], mass[tri[face, 1]], mass[tri[face, 2]])
        force = m * (stiffness * (gap - distance) - PENALTY_DAMPING * dot(normal, _from_foot(v, i, tri, face, foot)))
        if force <= 0.0:
            continue
        depth[i] = gap - distance
        energy[i] = 0.5 * m * stiffness * depth[i] ** 2
        for axis in range(3):
            push[i, axis], foot_weights[i, axis] = force * normal[axis], foot[axis]


@kernel
def add_pushes(tri, partner_tri, push, foot_weights, depth, forces):
    """Add the action on nodes and the reaction on their triangles; serial, so that the order of the sum is fixed."""
    for i in range(len(partner_tri)):
        if depth[i] > 0.0:
            triangle = partner_tri[i]
            for axis in range(3):
                forces[i, axis] += push[i, axis]
                for corner in range(3):
                    forces[tri[triangle, corner], axis] -= foot_weights[i, corner] * push[i, axis]


def triangles(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split quads (Q, 4) along both diagonals, into four triangles that overlap in pairs; return triangles as they are.

    The two diagonals of a bent quad give different surfaces. A node that stays clear of both stays clear of the surface
    that is written, whichever diagonal it uses.
    """
    if faces.shape[1] == 3:
        return faces
    return faces[:, [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]]].swapaxes(0, 1).reshape(-1, 3)


def longest_edges(verts: Array, faces: NDArray[np.int64]) -> Array:
    """Length (S,) of the longest edge of faces (F, 3 or 4) at each vertex (S, 3) [mm]."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge_length, longest_at_vertex = np.linalg.norm(verts[start] - verts[end], axis=1), np.zeros(len(verts))
    np.maximum.at(longest_at_vertex, start, edge_length)
    np.maximum.at(longest_at_vertex, end, edge_length)
    return longest_at_vertex


class Options(EffectOptions):
    """Self-contact of the pial surface; no options."""

    theory = True
    errors_known = True
    at_onset = False


class Contact(Effect):
    """Self-contact of the surface nodes; the docstring of the module gives the rules.

    ``per_mass`` is the penalty force per mass and penetration, at a step of one, of a body whose bulk modulus is whole;
    the explicit step is stable up to about 0.4.
    """

    saved = ("_facing", "_paired_at", "_depth", "searches")

    def __init__(self, per_mass: float = PENALTY_STIFFNESS):
        self.per_mass = per_mass

    def prepare(self, body: Body) -> None:
        n_surface = body.n_surface
        self._tri = triangles(body.bilayer.faces)
        self._N = vertex_normals(body.X[:n_surface], self._tri)
        self._reach = NEIGHBOUR_DISTANCE_IN_EDGES * longest_edges(body.X[:n_surface], body.bilayer.faces)
        vertex_triangles = incident_faces(n_surface, self._tri)
        self._ring_first, self._ring = vertex_triangles.indptr, vertex_triangles.indices
        self._facing = np.full(n_surface, -1)
        self._partner = np.full(n_surface, -1)
        self._paired_at = np.full((n_surface, 3), np.inf)
        self._push, self._weight = np.zeros((n_surface, 3)), np.zeros((n_surface, 3))
        self._depth, self._energy = np.zeros(n_surface), np.zeros(n_surface)
        self._cell_size, self._pairing_age = body.cell, 0
        self.searches = 0

    def _penalty(self, body: Body) -> float:
        """Penalty force per mass and penetration."""
        return self.per_mass * (SPLIT_PENALTY_RATIO if body.is_split else 1.0)

    def refresh(self, run) -> None:
        self._cell_size, self._pairing_age = run.body.cell, 0
        self._pair(run.body, run.state.x)

    def _pair(self, body: Body, x: Array) -> None:
        """Find the triangle that each node may touch; search for facing nodes again if the surface has moved."""
        n_surface = body.n_surface
        radius = SEARCH_RADIUS_IN_CELLS * self._cell_size
        displacement = np.max(np.abs(x[:n_surface] - self._paired_at))
        if displacement > 0.2 * radius:
            normals = vertex_normals(x[:n_surface], self._tri)
            find_facing(x, body.X, self._N, normals, n_surface, radius, self._reach, self._facing)
            self._paired_at = x[:n_surface].copy()
            self.searches += 1
        if self._facing.max() >= 0:
            triangle_rings = self._tri, self._ring_first, self._ring, self._facing
            choose_triangles(x, body.X, self._N, *triangle_rings, self._reach, self._partner)
        else:
            self._partner[:] = -1
            self._depth[:] = self._energy[:] = 0.0

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        if self._pairing_age == STEPS_PER_PAIRING:
            self._pairing_age = 0
            self._pair(body, x)
        self._pairing_age += 1
        if self._partner.max() >= 0:
            self._press(body, x, v, (self._push, self._weight, self._depth, self._energy))
            add_pushes(self._tri, self._partner, self._push, self._weight, self._depth, extra)

    def _press(self, body: Body, x: Array, v: Array, out_arrays: tuple[Array, ...]) -> None:
        pair_inputs = self._tri, self._partner, self._cell_size, self._reach
        press(x, v, body.X, self._N, body.mass, *pair_inputs, self._penalty(body), *out_arrays)

    def springs(self, body: Body, x: Array) -> Array:
        """Of nodes and triangles that press: that of two walls that approach each other, with a pair at either side."""
        pressed_nodes, springs = np.flatnonzero((self._depth > 0) & (self._partner >= 0)), np.zeros(body.n_surface)
        springs[pressed_nodes] = springs[self._tri[self._partner[pressed_nodes]].ravel()] = 4 * self._penalty(body)
        return springs

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        """Stiffness of the pairs that press at x, at velocity 0: a spring along the normal of each pair.

        A node at an edge touches now this and now that triangle. So half of its stiffness is that of triangles of other
        slopes next to its own.
        """
        push, foot_weights = np.zeros_like(self._push), np.zeros_like(self._weight)
        depth, energy = np.zeros_like(self._depth), np.zeros_like(self._energy)
        self._press(body, x, np.zeros_like(x), (push, foot_weights, depth, energy))
        pressed_nodes = np.flatnonzero(depth > 0)
        if not pressed_nodes.size:
            return sparse.csr_matrix((x.size, x.size))
        normal = unit(push[pressed_nodes])
        own_pairs = pressed_nodes, self._partner[pressed_nodes], normal, foot_weights[pressed_nodes]
        other_pairs = self._pairs_of_other_slopes(x, pressed_nodes, normal)
        node, triangle, normal, foot_weights = (np.concatenate(columns) for columns in zip(own_pairs, other_pairs))
        nodes = np.column_stack([node, self._tri[triangle]])
        node_weights = np.column_stack([np.ones(len(node)), -foot_weights])
        n_others = np.bincount(other_pairs[0], minlength=body.n_surface)[node]
        shares = np.where(n_others == 0, 1.0, 0.5 / np.where(np.arange(len(node)) < len(pressed_nodes), 1, n_others))
        slopes = (node_weights[:, :, None] * normal[:, None, :]).reshape(-1, 12)
        pair_stiffness = self._penalty(body) * shares * body.mass[nodes].min(axis=1)
        return joined_springs(nodes, pair_stiffness[:, None, None] * slopes[:, :, None] * slopes[:, None, :], x)

    def _pairs_of_other_slopes(self, x: Array, node: Ints, normal: Array) -> tuple[Ints, Ints, Array, Array]:
        """Nodes (Q,), and triangles of other slopes as near to them as their own; their normals, and weights of feet.

        ``node`` (P,) are those that press, ``normal`` (P, 3) those of their own triangles.
        """
        from trimesh.triangles import closest_point, points_to_barycentric

        ring_start = self._ring_first[self._facing[node]]
        ring_size = self._ring_first[self._facing[node] + 1] - ring_start
        row = np.repeat(np.arange(len(node)), ring_size)
        triangle = self._ring[np.arange(len(row)) + (ring_start + ring_size - np.cumsum(ring_size))[row]]
        own_corners = x[self._tri[self._partner[node]]]
        own_gap = np.linalg.norm(closest_point(own_corners, x[node]) - x[node], axis=1)
        corner_x = x[self._tri[triangle]]
        normals = unit(np.cross(corner_x[:, 1] - corner_x[:, 0], corner_x[:, 2] - corner_x[:, 0]))
        foot = closest_point(corner_x, x[node[row]])
        pressed = np.linalg.norm(foot - x[node[row]], axis=1) < own_gap[row] + NEARLY_AS_NEAR_IN_CELLS * self._cell_size
        pressed &= np.einsum("pr,pr->p", normals, x[node[row]] - corner_x[:, 0]) < GAP_IN_CELLS * self._cell_size
        pressed &= np.einsum("pr,pr->p", normals, normal[row]) < SAME_SLOPE_COSINE
        return (
            node[row[pressed]],
            triangle[pressed],
            normals[pressed],
            points_to_barycentric(corner_x[pressed], foot[pressed]),
        )

    def pace(self, g: float) -> float:
        """Slow growth down while nodes are pressed far through their triangle."""
        return min(1.0, WAIT_DEPTH_IN_CELLS * self._cell_size / max(float(self._depth.max()), 1e-300))

    def energy(self) -> float:
        return float(self._energy.sum())

    def record(self) -> dict[str, Any]:
        deepest_in_gaps = float(self._depth.max() / (GAP_IN_CELLS * self._cell_size))
        n_pairs = int((self._depth > 0).sum())
        return {"pairs": n_pairs, "deepest_in_gaps": deepest_in_gaps, "searches": self.searches}
