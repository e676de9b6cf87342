"""Self-intersections of a surface, their places and depths: independent of contact in the solver, with exact signs.

Two cases are searched for. First, an edge that crosses a triangle with which it shares no vertex: surfaces that cross
each other have such a pair, also two triangles that meet only in one vertex. Second, a vertex behind a wall that faces
it: two smooth walls may overlap widely and cross only at the rim at a small angle, where no single crossing is deep.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from morphofold import geometry
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import area_vector, corners, cross, distance_from_triangle, dot, less, position
from morphofold.intersections.box_tree import LEAF_SIZE, BoxTree, box_tree, following, meets, ray_hits
from morphofold.intersections.signs import clear_sign, plane_sign, side
from morphofold.kernels import kernel, reading
from morphofold.surface import Surface
from morphofold.threads import in_blocks

# a face belongs to another wall than a vertex if the cosine of their normals is less than this
ANOTHER_WALL_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class Intersections:
    """Self-intersections of a surface: K crossings in the order of their edges, and P passed vertices.

    Attributes
    ----------
    edge : (K, 2) int64
        Vertices of the crossing edge, the lower number first.
    face : (K,) int64
        The crossed face.
    point : (K, 3) float64
        Position of the crossing [mm].
    depth : (K,) float64
        Depth of the crossing [mm]: the smallest displacement that undoes it. Either the nearer end moves back to the
        plane of the face, or the edge is lifted over a ridge: a side or a corner of the face beside which the surface,
        seen along the edge, shows its other side or ends. Other sides are no exit: the edge would cross the next face.
        So the depth is zero for an edge that only grazes a ridge or touches a face with its end. It grows steadily from
        there, and does not depend on the positions of the sides of faces in a smooth wall. It is at most half of the
        edge.
    vertex : (P,) int64
        Vertices behind a wall that faces them.
    vertex_depth : (P,) float64
        Distance of the vertex from that wall [mm].
    mean_edge : float
        Mean length of the edges of the surface [mm].
    """

    edge: Ints = field(repr=False)
    face: Ints = field(repr=False)
    point: Array = field(repr=False)
    depth: Array = field(repr=False)
    vertex: Ints = field(repr=False)
    vertex_depth: Array = field(repr=False)
    mean_edge: float

    def __len__(self) -> int:
        """How many edges cross a face."""
        return len(self.edge)

    @property
    def deepest(self) -> float:
        """Depth of the deepest crossing or vertex [mm]; 0 if there is none."""
        return float(max(self.depth.max(initial=0.0), self.vertex_depth.max(initial=0.0)))

    @property
    def deepest_share(self) -> float:
        """Depth of the deepest crossing or vertex, in mean edges."""
        return self.deepest / self.mean_edge

    def only(self, crossings: Ints) -> "Intersections":
        """The same with only these crossings, given by their numbers."""
        chosen_fields = {name: getattr(self, name)[crossings] for name in ("edge", "face", "point", "depth")}
        return replace(self, **chosen_fields)

    def crossed_faces(self, faces: Ints) -> Ints:
        """Faces of the surface (F,) that are crossed or have a crossing edge, ascending."""
        edge_key = lambda ends: ends.min(axis=1) * (int(faces.max()) + 1) + ends.max(axis=1)
        has_crossing_edge = [np.isin(edge_key(faces[:, [k, (k + 1) % 3]]), edge_key(self.edge)) for k in range(3)]
        return np.union1d(self.face, np.flatnonzero(np.any(has_crossing_edge, axis=0)))

    def deeper_than(self, n_edges: float) -> int:
        """Number of crossings and vertices that are deeper than ``n_edges`` mean edges."""
        least_depth = n_edges * self.mean_edge
        return int((self.depth > least_depth).sum() + (self.vertex_depth > least_depth).sum())


def self_intersections(surface: Surface, *, vertices: bool = True, n_tested: int | None = None) -> Intersections:
    """Edges of a surface that cross its faces, and vertices that have passed through a facing wall.

    Parameters
    ----------
    surface : Surface
        Closed, with outward faces. An open surface has no inside, so only edges that cross faces are found. Flat walls
        that have completely passed through each other cross only at their rims. If the surface beyond both rims is in
        one plane, they do not cross there either: on an open surface such walls are not found.
    vertices : bool
        Whether to search for vertices; this takes three quarters of the time.
    n_tested : int, optional
        Search only among the first so many vertices.

    Returns
    -------
    Intersections

    Notes
    -----
    Signs are exact (:mod:`morphofold.intersections.signs`). Touching is not a crossing. Ties are decided as if the
    vertices were displaced by infinitely small lengths, so an edge exactly through another edge or a vertex crosses one
    triangle there; crossings with a depth of zero are left out. A surface that passes through its own mirror image
    meets it edge on edge, and is found. Two triangles folded flat on each other over a common edge only touch.

    A vertex has passed if two conditions hold. First, it lies behind a face of another wall, whose normal differs from
    its own by more than 60 degrees, at less than one mean edge from the nearest such face. Second, the surface winds
    around the space in front of it, counted along its normal. Its depth is the distance to that face. Vertices deeper
    than an edge are not listed, but those nearer to the rim are. A vertex on a fold so sharp that a face around it is
    turned by more than 60 degrees has no front, and is not tested.
    """
    verts, faces = surface.verts, surface.faces
    mean_edge = geometry.mean_edge_length(verts, faces)
    tree, vertex_faces = box_tree(verts, faces), geometry.incident_faces(len(verts), faces)
    edge, face = _crossings(verts, faces, tree)
    point, depth = np.empty((len(edge), 3)), np.empty(len(edge))
    if len(edge):
        _measure_crossings(*reading(verts, faces, vertex_faces, edge, face), point, depth)
    deep, wall_depth = depth > 0, np.zeros(len(verts))
    if vertices and geometry.is_closed(surface.faces):
        normals = _reliable_normals(verts, faces)
        in_blocks(
            _depth_behind_walls, n_tested or len(verts), *reading(verts, faces, normals, *tree), mean_edge, wall_depth
        )
    vertex = np.flatnonzero(wall_depth > 0)
    return Intersections(edge[deep], face[deep], point[deep], depth[deep], vertex, wall_depth[vertex], mean_edge)


def _reliable_normals(verts: Array, faces: Ints) -> Array:
    """Unit vertex normals (N, 3); zero where a face around the vertex is turned too far from the normal."""
    normals, area_vectors = geometry.vertex_normals(verts, faces).copy(), geometry.face_vectors(verts, faces)
    least_component = ANOTHER_WALL_COSINE * geometry.norms(area_vectors)
    for corner_vertices in faces.T:
        normals[corner_vertices[geometry.inner(area_vectors, normals[corner_vertices]) < least_component]] = 0.0
    return normals


def _crossings(verts: Array, faces: Ints, tree: BoxTree) -> tuple[Ints, Ints]:
    """Edge (K, 2) and face (K,) of each crossing, by edge and then face."""
    n_leaves, crossings = -(-len(faces) // LEAF_SIZE), np.empty((0, 3), dtype=np.int64)
    surface_arrays, row_starts = reading(verts, faces, *tree), np.zeros(n_leaves + 1, dtype=np.int64)
    in_blocks(_find_crossings, n_leaves, *surface_arrays, row_starts, crossings)
    row_starts = np.cumsum(row_starts)
    if row_starts[-1]:
        crossings = np.empty((row_starts[-1], 3), dtype=np.int64)
        in_blocks(_find_crossings, n_leaves, *surface_arrays, row_starts, crossings)
    crossings = np.unique(crossings, axis=0)  # an edge of two triangles is found with both
    return crossings[:, :2], crossings[:, 2]


@kernel
def _find_crossings(start, stop, verts, faces, bounds, order, boxes, row_starts, crossings):
    """Crossings of the triangles of a leaf with those of the same or a later leaf: two ends of an edge, and a triangle.

    Write their number for each leaf to ``row_starts[leaf + 1]`` if there is no room in ``crossings`` (K, 3), else the
    crossings from ``crossings[row_starts[leaf]]`` on.
    """
    n_leaves = len(bounds) // 2
    for leaf in range(start, stop):
        if len(crossings) > 0 and row_starts[leaf + 1] == row_starts[leaf]:
            continue
        row, node = row_starts[leaf] if len(crossings) > 0 else 0, n_leaves + leaf
        first_slot, slot_stop = LEAF_SIZE * leaf, min(LEAF_SIZE * (leaf + 1), len(order))
        while node > 0:
            if meets(bounds[node], bounds[n_leaves + leaf]):
                if node < n_leaves:
                    node *= 2
                    continue
                other_end_slot = min(LEAF_SIZE * (node - n_leaves + 1), len(order))
                for slot in range(first_slot, slot_stop):
                    for other_slot in range(max(slot + 1, LEAF_SIZE * (node - n_leaves)), other_end_slot):
                        if meets(boxes[order[slot]], boxes[order[other_slot]]):
                            row = _add_crossings(verts, faces, order[slot], order[other_slot], crossings, row)
            node = following(node)
        if len(crossings) == 0:
            row_starts[leaf + 1] = row


@kernel
def _add_crossings(verts, faces, face1, face2, crossings, row):
    """Write edges of one of two triangles that cross the other, from row ``row`` on; returns the next row."""
    n_shared = 0
    for k in range(9):
        n_shared += faces[face1, k // 3] == faces[face2, k % 3]
    if n_shared > 1 or _is_on_one_side(verts, faces, face1, face2) or _is_on_one_side(verts, faces, face2, face1):
        return row
    for edge_triangle, crossed_triangle in ((face1, face2), (face2, face1)):
        for k in range(3):
            p, q = faces[edge_triangle, k], faces[edge_triangle, (k + 1) % 3]
            p, q = min(p, q), max(p, q)
            if _edge_crosses_triangle(verts, faces, p, q, crossed_triangle):
                if len(crossings) > 0:
                    crossings[row, 0], crossings[row, 1], crossings[row, 2] = p, q, crossed_triangle
                row += 1
    return row


@kernel
def _is_on_one_side(verts, faces, face, other_face):
    """Whether all vertices of face g that are not in face f are clearly on one side of its plane."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    a, b, c = corners(verts, faces, face)
    side_before = 0
    for corner in range(3):
        vertex = faces[other_face, corner]
        if vertex != i and vertex != j and vertex != k:
            this_side = clear_sign(a, b, c, position(verts, vertex), 1.0)  # 0 if rounding might change it
            if this_side == 0 or this_side == -side_before:
                return False
            side_before = this_side
    return True


@kernel
def _edge_crosses_triangle(verts, faces, p, q, face):
    """Whether the edge pq crosses a triangle with which it shares no vertex."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    if p == i or p == j or p == k or q == i or q == j or q == k:
        return False
    side_of_p = side(verts, i, j, k, p)
    if side_of_p == 0 or side(verts, i, j, k, q) != -side_of_p:
        return False
    edge_side = side(verts, p, q, i, j)
    return edge_side != 0 and side(verts, p, q, j, k) == edge_side and side(verts, p, q, k, i) == edge_side


@kernel
def _measure_crossings(verts, faces, starts, ring, edge, face, point, depth):
    """Write point (K, 3) and depth (K,) of crossings; ``ring[starts[i] : starts[i + 1]]`` are the faces at vertex i."""
    for e in range(len(edge)):
        p, q = position(verts, edge[e, 0]), position(verts, edge[e, 1])
        a, b, c = corners(verts, faces, face[e])
        normal, along = area_vector(a, b, c), less(q, p)
        normal_length = max(dot(normal, normal) ** 0.5, 1e-300)
        h_p, h_q = abs(dot(less(p, a), normal)) / normal_length, abs(dot(less(q, a), normal)) / normal_length
        fraction = h_p / (h_p + h_q) if h_p + h_q > 0.0 else 0.5
        for axis in range(3):
            point[e, axis] = p[axis] + fraction * along[axis]
        reach = 0.0 if plane_sign(a, b, c, p, 1.0) == 0 or plane_sign(a, b, c, q, 1.0) == 0 else min(h_p, h_q)
        for k in range(3):
            reach = min(
                reach, _distance_to_exit(verts, faces, starts, ring, edge[e], face[e], k, position(point, e), along)
            )
        depth[e] = reach


@kernel
def _distance_to_exit(verts, faces, ring_starts, ring, edge, face, corner, point, edge_vector):
    """Distance of a crossing from corner k of face f, or from the side that begins there, if the edge can exit there.

    It can if the surface, seen along the edge, shows its other side next to f, or ends.
    """
    i, j, h = faces[face, corner], faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    p, q = position(verts, edge[0]), position(verts, edge[1])
    facing_product = dot(edge_vector, area_vector(position(verts, i), position(verts, j), position(verts, h)))
    exits_at_corner, is_open_side, exits_at_side = False, True, False
    for slot in range(ring_starts[i], ring_starts[i + 1]):
        a, b, c = faces[ring[slot]]
        if ring[slot] != face:
            shows_back = facing_product * dot(edge_vector, area_vector(*corners(verts, faces, ring[slot]))) <= 0.0
            exits_at_corner |= shows_back
            if a == j or b == j or c == j:
                is_open_side = False
                exits_at_side |= shows_back
    from_corner, side_line = less(point, position(verts, i)), less(position(verts, j), position(verts, i))
    on_side = plane_sign(p, q, position(verts, i), position(verts, j), 1.0) == 0
    distance = np.inf
    if is_open_side or exits_at_side:
        offset = cross(side_line, from_corner)
        distance = 0.0 if on_side else (dot(offset, offset) / max(dot(side_line, side_line), 1e-300)) ** 0.5
    if exits_at_corner:
        on_corner = on_side and plane_sign(p, q, position(verts, h), position(verts, i), 1.0) == 0
        distance = min(distance, 0.0 if on_corner else dot(from_corner, from_corner) ** 0.5)
    return distance


@kernel
def _is_on_another_wall(face_vector, normal):
    """Whether a triangle of this area vector belongs to another wall than a vertex with unit normal ``normal``."""
    return dot(face_vector, normal) < ANOTHER_WALL_COSINE * dot(face_vector, face_vector) ** 0.5


@kernel
def _depth_behind_walls(start, stop, verts, faces, normals, bounds, order, boxes, radius, wall_depth):
    """Write the distance (N,) of each vertex from the facing wall that it has passed, if any, within ``radius``."""
    no_hits = np.empty(0)
    for i in range(start, stop):
        if dot(position(normals, i), position(normals, i)) == 0.0:
            continue
        distance = _distance_to_wall_behind(verts, faces, position(normals, i), bounds, order, boxes, i, radius)
        if (
            distance < radius
            and ray_hits(verts, faces, bounds, order, position(verts, i), position(normals, i), no_hits, no_hits)[1] > 0
        ):
            wall_depth[i] = distance


@kernel
def _distance_to_wall_behind(verts, faces, normal, bounds, order, boxes, i, radius):
    """Distance of vertex i from the nearest face of another wall that does not have i in front; else inf."""
    least_distance = np.inf
    box = np.empty(6)
    for axis in range(3):
        box[axis], box[3 + axis] = verts[i, axis] - radius, verts[i, axis] + radius
    node, n_leaves = 1, len(bounds) // 2
    while node > 0:
        if meets(bounds[node], box):
            if node < n_leaves:
                node *= 2
                continue
            for slot in range(LEAF_SIZE * (node - n_leaves), min(LEAF_SIZE * (node - n_leaves + 1), len(order))):
                face = order[slot]
                if faces[face, 0] == i or faces[face, 1] == i or faces[face, 2] == i or not meets(boxes[face], box):
                    continue
                a, b, c = corners(verts, faces, face)
                if (
                    _is_on_another_wall(area_vector(a, b, c), normal)
                    and plane_sign(a, b, c, position(verts, i), 1.0) <= 0
                ):
                    least_distance = min(least_distance, distance_from_triangle(position(verts, i), a, b, c))
        node = following(node)
    return least_distance
