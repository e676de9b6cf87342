"""Does a surface pass through itself, where, and how deep: independent of the solver's own contact, with exact signs.

Two things are looked for. An edge that crosses a triangle with which it shares no vertex: surfaces that pass through
each other have such a pair, also two triangles that meet in one vertex only. And a vertex that lies behind a wall which
faces it: two smooth walls may overlap widely and cross only at the rim, at a small angle, where no single crossing is
deep.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from morphofold.sim.boxes import BLOCK, BoxTree, box_tree, following, meets
from morphofold.sim.rays import ray_hits
from morphofold.sim.signs import plane_sign, side
from morphofold.sim.vectors import area_vector, cross, dot, less
from morphofold.surface import Surface

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ANOTHER_WALL = 0.5      # a face belongs to another wall than a vertex if the cosine of their normals is less than this


@dataclass(frozen=True, eq=False)
class Intersections:
    """Where a surface passes through itself: K crossings in the order of their edges, P passed vertices.

    Attributes
    ----------
    edge : (K, 2) int64
        Vertices of the edge that crosses, the lower number first.
    face : (K,) int64
        The face it crosses.
    point : (K, 3) float64
        Where [mm].
    depth : (K,) float64
        How far the edge has passed [mm]: the least of the distances of its two ends from the plane of the face, and of
        ``point`` from the three sides of the face. A displacement of that length undoes the crossing, either by
        drawing the nearer end back or, over a ridge, by lifting the edge off the face: so the number is zero when the
        edge only grazes, and grows steadily from there. It is a lower bound where many faces are crossed, and never
        more than the radius of the circle inside the face, 0.29 of an edge for an equilateral one.
    vertex : (P,) int64
        Vertices behind a wall that faces them.
    vertex_depth : (P,) float64
        Distance of the vertex from that wall [mm].
    mean_edge : float
        Mean length of the edges of the surface [mm].
    """

    edge: Indices = field(repr=False)
    face: Indices = field(repr=False)
    point: Array = field(repr=False)
    depth: Array = field(repr=False)
    vertex: Indices = field(repr=False)
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

    def deeper_than(self, share: float) -> int:
        """How many crossings and vertices are deeper than ``share`` mean edges."""
        least = share * self.mean_edge
        return int((self.depth > least).sum() + (self.vertex_depth > least).sum())


def self_intersections(surface: Surface) -> Intersections:
    """Edges of a surface that cross its faces, and vertices that have passed through a facing wall.

    Parameters
    ----------
    surface : Surface
        Closed, with outward faces. An open one has no inside: of it, only edges that cross faces are told.

    Returns
    -------
    Intersections

    Notes
    -----
    Signs are exact (:mod:`morphofold.sim.signs`). Touching is no crossing: ties are decided as if the vertices were
    displaced by next to nothing, so that an edge exactly through another edge or a vertex crosses one triangle there,
    and what then has the depth zero is left out. An edge through an edge has that depth too: a surface that passes
    through its own mirror image, vertex for vertex, is found by its vertices alone. Two triangles folded flat on each
    other over a common edge touch.

    A vertex has passed if, first, it lies behind a face of another wall, whose normal is turned from its own by more
    than 60 degrees, less than one mean edge from the nearest such face, and second, the surface winds around the space
    in front of it, counted along its normal. Its depth is the distance to that face. Vertices deeper than an edge
    aren't listed, but those nearer to the rim are. A vertex on a fold so sharp that a face around it is turned by more
    than 60 degrees has no front, and isn't asked.
    """
    verts, faces = surface.verts.copy(), surface.faces.copy()           # writable, as all arrays here: compiled once
    edges, closed = _edges(faces)
    mean_edge = float(np.linalg.norm(verts[edges[:, 0]] - verts[edges[:, 1]], axis=1).mean())
    tree = box_tree(verts, faces)
    edge, face = _crossings(verts, faces, edges, tree)
    point, depth = _point_and_depth(verts, edge, faces[face])
    kept = depth > 0
    behind = _passed(verts, faces, _node_normals(verts, faces), *tree, mean_edge) if closed else np.zeros(len(verts))
    vertex = np.flatnonzero(behind > 0)
    return Intersections(edge[kept], face[kept], point[kept], depth[kept], vertex, behind[vertex], mean_edge)


def _edges(faces: Indices) -> tuple[Indices, bool]:
    """Edges (E, 2), each once, lower number first, ascending; and whether each has two faces."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    key, count = np.unique(ends.min(axis=1) * n + ends.max(axis=1), return_counts=True)
    return np.stack(np.divmod(key, n), axis=1), bool((count == 2).all())


def _crossings(verts: Array, faces: Indices, edges: Indices, tree: BoxTree) -> tuple[Indices, Indices]:
    """Edge (K, 2) and face (K,) of each crossing, by edge and then face."""
    first = np.concatenate([[0], np.cumsum(_count(verts, faces, edges, *tree))])
    face = np.empty(first[-1], dtype=np.int64)
    _fill(verts, faces, edges, *tree, first, face)
    number = np.repeat(np.arange(len(edges)), np.diff(first))
    order = np.lexsort([face, number])
    return edges[number[order]], face[order]


def _point_and_depth(verts: Array, edge: Indices, tri: Indices) -> tuple[Array, Array]:
    """Point (K, 3) and depth (K,) of crossings; exactly 0 where a sign is zero, and for faces without area."""
    p, q = verts[edge[:, 0]], verts[edge[:, 1]]
    corner = verts[tri]                                                 # (K, 3, 3)
    along = np.roll(corner, -1, axis=1) - corner
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    ends = np.stack([np.einsum("ij,ij->i", x - corner[:, 0], normal) for x in (p, q)], axis=1)
    span = ends[:, 0] - ends[:, 1]
    share = np.clip(np.divide(ends[:, 0], span, out=np.full(len(p), 0.5), where=span != 0), 0.0, 1.0)
    point = p + share[:, None] * (q - p)
    area = np.linalg.norm(np.cross(along, point[:, None] - corner), axis=2)
    length = np.linalg.norm(along, axis=2)
    sides = np.divide(area, length, out=np.zeros_like(area), where=length > 0)
    distances = np.concatenate([np.abs(ends), sides], axis=1)
    distances[_plain_signs(verts, edge, tri) == 0] = 0.0
    return point, distances.min(axis=1, initial=np.inf)


@njit(parallel=True, cache=True)
def _count(verts, faces, edges, bounds, order, single):
    count = np.empty(len(edges), dtype=np.int64)
    for e in prange(len(edges)):
        count[e] = _crossed(verts, faces, bounds, order, single, edges[e], np.empty(0, dtype=np.int64))
    return count


@njit(parallel=True, cache=True)
def _fill(verts, faces, edges, bounds, order, single, first, face):
    for e in prange(len(edges)):
        if first[e + 1] > first[e]:
            _crossed(verts, faces, bounds, order, single, edges[e], face[first[e] : first[e + 1]])


@njit(cache=True)
def _crossed(verts, faces, bounds, order, single, edge, found):
    """Write the faces that an edge crosses to ``found``, as many as fit; returns how many there are."""
    p, q = edge
    box = np.empty(6)
    for r in range(3):
        box[r], box[3 + r] = min(verts[p, r], verts[q, r]), max(verts[p, r], verts[q, r])
    n, k, leaves = 0, 1, len(bounds) // 2
    while k > 0:
        if meets(bounds[k], box):
            if k < leaves:
                k *= 2
                continue
            for s in range(BLOCK * (k - leaves), min(BLOCK * (k - leaves + 1), len(order))):
                f = order[s]
                if meets(single[f], box) and _crosses(verts, p, q, faces[f]):
                    if n < len(found):
                        found[n] = f
                    n += 1
        k = following(k)
    return n


@njit(cache=True)
def _crosses(verts, p, q, tri):
    """Whether the edge pq crosses a triangle with which it shares no vertex."""
    i, j, k = tri
    if p == i or p == j or p == k or q == i or q == j or q == k:
        return False
    before = side(verts, i, j, k, p)
    if before == 0 or side(verts, i, j, k, q) != -before:
        return False
    turn = side(verts, p, q, i, j)
    return turn != 0 and side(verts, p, q, j, k) == turn and side(verts, p, q, k, i) == turn


@njit(cache=True)
def _plain_signs(verts, edge, tri):
    """Signs (K, 5) of both ends against the plane, and of the edge against the three sides; true zeros stay zero."""
    signs = np.empty((len(edge), 5))
    for e in range(len(edge)):
        p, q = verts[edge[e, 0]], verts[edge[e, 1]]
        a, b, c = verts[tri[e, 0]], verts[tri[e, 1]], verts[tri[e, 2]]
        signs[e, 0], signs[e, 1] = plane_sign(a, b, c, p, 1.0), plane_sign(a, b, c, q, 1.0)
        signs[e, 2], signs[e, 3] = plane_sign(p, q, a, b, 1.0), plane_sign(p, q, b, c, 1.0)
        signs[e, 4] = plane_sign(p, q, c, a, 1.0)
    return signs


@njit(cache=True)
def _elsewhere(n, normal):
    """Whether a triangle of area vector ``n`` belongs to another wall than a vertex of the unit normal ``normal``."""
    return dot(n, normal) < ANOTHER_WALL * dot(n, n) ** 0.5


@njit(cache=True)
def _node_normals(verts, faces):
    """Unit area-weighted normals (N, 3); zero where a face around the vertex is turned too far away."""
    normals, area = np.zeros_like(verts), np.empty_like(faces, dtype=np.float64)
    for f in range(len(faces)):
        n = area_vector(verts[faces[f, 0]], verts[faces[f, 1]], verts[faces[f, 2]])
        for k in range(3):
            area[f, k] = n[k]
            for r in range(3):
                normals[faces[f, k], r] += n[r]
    for i in range(len(verts)):
        length = dot(normals[i], normals[i]) ** 0.5
        for r in range(3):
            normals[i, r] /= max(length, 1e-300)
    turned = np.zeros(len(verts), dtype=np.bool_)
    for f in range(len(faces)):
        for k in range(3):
            turned[faces[f, k]] |= _elsewhere(area[f], normals[faces[f, k]])
    for i in np.flatnonzero(turned):
        for r in range(3):
            normals[i, r] = 0.0
    return normals


@njit(parallel=True, cache=True)
def _passed(verts, faces, normals, bounds, order, single, radius):
    """Distance (N,) of each vertex from the facing wall that it has passed, 0 if none, within ``radius``."""
    behind, none = np.zeros(len(verts)), np.empty(0)
    for i in prange(len(verts)):
        if dot(normals[i], normals[i]) == 0.0:
            continue
        own = np.int64(i)                                               # prange counts in another type: compiled once
        distance = _wall_behind(verts, faces, normals[i], bounds, order, single, own, radius)
        if distance < radius and ray_hits(verts, faces, bounds, order, verts[i], normals[i], none, none, own)[1] > 0:
            behind[i] = distance
    return behind


@njit(cache=True)
def _wall_behind(verts, faces, normal, bounds, order, single, i, radius):
    """Distance of vertex i from the nearest face of another wall that doesn't have i in front; inf: none within."""
    nearest = np.inf
    box = np.empty(6)
    for r in range(3):
        box[r], box[3 + r] = verts[i, r] - radius, verts[i, r] + radius
    k, leaves = 1, len(bounds) // 2
    while k > 0:
        if meets(bounds[k], box):
            if k < leaves:
                k *= 2
                continue
            for s in range(BLOCK * (k - leaves), min(BLOCK * (k - leaves + 1), len(order))):
                f = order[s]
                if faces[f, 0] == i or faces[f, 1] == i or faces[f, 2] == i or not meets(single[f], box):
                    continue
                a, b, c = verts[faces[f, 0]], verts[faces[f, 1]], verts[faces[f, 2]]
                if _elsewhere(area_vector(a, b, c), normal) and plane_sign(a, b, c, verts[i], 1.0) <= 0:
                    nearest = min(nearest, _distance(verts[i], a, b, c))
        k = following(k)
    return nearest


@njit(cache=True)
def _distance(p, a, b, c):
    """Distance of p from the triangle abc: from its plane if p lies over it, else from the nearest side."""
    n, over, nearest = area_vector(a, b, c), True, np.inf
    for x, y in ((a, b), (b, c), (c, a)):
        along, to = less(y, x), less(p, x)
        over &= dot(cross(along, to), n) >= 0.0
        t = min(max(dot(along, to) / max(dot(along, along), 1e-300), 0.0), 1.0)
        rest = to[0] - t * along[0], to[1] - t * along[1], to[2] - t * along[2]
        nearest = min(nearest, dot(rest, rest))
    square = dot(n, n)
    return abs(dot(less(p, a), n)) / square**0.5 if over and square > 0.0 else nearest**0.5
