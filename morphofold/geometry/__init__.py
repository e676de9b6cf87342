"""Triangle-mesh geometry for all measures: areas, normals, neighbours, the cotangent Laplacian, topology.

All sums run in the order of the faces, so results do not depend on the number of threads. Functions without types are
for kernels: points and vectors have three numbers; results are tuples of three; nothing is allocated. Three of them
find the nearest point of a triangle. Their results differ by rounding, by 1e-9 on needle triangles, so each caller
keeps its function.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from morphofold.errors import OutOfRange, UnknownName
from morphofold.frozen_arrays import Array, Bools, Ints, memoized
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.validators import check_arrays


@memoized
def face_vectors(verts: Verts, faces: Faces) -> Array:
    """Vector areas (M, 3) [mm^2]: along the outward normal, as long as the triangle's area.

    Raises ``OutOfRange`` if a face names a vertex that does not exist.
    """
    return triangles(verts, faces)[0] / 2


def triangles(verts: Verts, faces: Faces) -> tuple[Array, Array, Array]:
    """Twice the vector areas of triangles, products at their corners, and squared lengths of their sides, (M, 3) each.

    The product at a corner [mm^2] is that of the vectors to the next and to the previous corner; the side of a corner
    leads to the next one. Raises ``OutOfRange`` if a face names a vertex that does not exist.
    """
    check_arrays(verts, faces)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(verts):  # compiled code would read beyond the array
        raise OutOfRange(f"faces name a vertex outside 0..{len(verts) - 1}: {faces.min()} to {faces.max()}.")
    triangle_measures: tuple[Array, Array, Array] = _measure_triangles(
        *reading(np.asarray(verts, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    )
    return triangle_measures


@kernel
def _measure_triangles(verts, faces):
    area_normals, products, squares = np.empty((len(faces), 3)), np.empty((len(faces), 3)), np.empty((len(faces), 3))
    for t in range(len(faces)):
        a, b, c = corners(verts, faces, t)
        ab, bc, ca = less(b, a), less(c, b), less(a, c)
        area_normals[t, 0], area_normals[t, 1], area_normals[t, 2] = cross(ab, less(c, a))
        # 0.0 less the product, not minus it: at a side of no length -0.0 would be the angle pi
        products[t, 0], products[t, 1], products[t, 2] = 0.0 - dot(ab, ca), 0.0 - dot(bc, ab), 0.0 - dot(ca, bc)
        squares[t, 0], squares[t, 1], squares[t, 2] = dot(ab, ab), dot(bc, bc), dot(ca, ca)
    return area_normals, products, squares


@memoized
def face_areas(verts: Verts, faces: Faces) -> Array:
    """Areas (M,) [mm^2]."""
    return norms(face_vectors(verts, faces))


def equal_area_radius(verts: Verts, faces: Faces) -> float:
    """Radius [mm] of the sphere with the area of the surface."""
    return float(np.sqrt(face_areas(verts, faces).sum() / (4 * np.pi)))


def face_normals(verts: Verts, faces: Faces) -> Array:
    """Unit normals (M, 3), outward for counter-clockwise faces; zero for triangles of zero area."""
    return unit(face_vectors(verts, faces))


def unit(vectors: Array) -> Array:
    """Array scaled to unit length; a zero vector stays zero."""
    return ratio(vectors, norms(vectors)[:, None])


def ratio(dividend: np.ndarray | float, divisor: np.ndarray) -> Array:
    """The dividend over the divisor, 0 where that is not positive."""
    shape = np.broadcast_shapes(np.shape(dividend), divisor.shape)
    return np.divide(dividend, divisor, out=np.zeros(shape), where=divisor > 0)


@memoized
def vertex_areas(verts: Verts, faces: Faces) -> PerVertex:
    """A third of the area of the incident triangles (N,) [mm^2], as in FreeSurfer's ``?h.area`` of the white surface.

    They sum to the area of the surface. 0 at a vertex that no face uses.
    """
    third_areas = np.repeat(face_areas(verts, faces) / 3, 3)
    return np.bincount(faces.ravel(), third_areas, len(verts)).astype(np.float64)


@memoized
def vertex_normals(verts: Verts, faces: Faces, weights: str = "area") -> Array:
    """Unit vertex normals (N, 3): sums of the normals of the incident triangles, weighted at the corner.

    ``weights``: ``"area"`` of the triangle; ``"angle"`` at the corner; ``"sine"`` of that angle; ``"max"``, the
    vector area over the squared lengths of the corner's two edges, exact on any sphere (N. Max 1999). Zero where
    no face has area.
    """
    doubled_vectors, dot_products, squared_sides = triangles(verts, faces)  # the vector is 2 x area x normal
    if weights == "area":
        corner_weight = np.ones((len(faces), 3))
    elif weights == "angle":
        doubled_areas = norms(doubled_vectors)[:, None]
        angle = np.arctan2(doubled_areas, dot_products)  # not acos: also exact for slivers
        corner_weight = ratio(angle, doubled_areas)
    elif weights in ("sine", "max"):
        side_products = squared_sides * squared_sides[:, [2, 0, 1]]
        side_products = np.sqrt(side_products) if weights == "sine" else side_products
        corner_weight = ratio(1, side_products)
    else:
        raise UnknownName(f"weights must be 'area', 'angle', 'sine' or 'max', got {weights!r}.")
    return unit(_sum_corners(*reading(doubled_vectors, corner_weight, faces), len(verts)))


def norms(vectors: Array) -> Array:
    """Lengths (N,) of vectors (N, 3)."""
    return np.sqrt(inner(vectors, vectors))


def inner(a: Array, b: Array) -> Array:
    """Inner products (N,) of vectors (N, 3) with others."""
    return np.einsum("ij,ij->i", a, b)


@kernel
def _sum_corners(vectors, weight, faces, n_vertices):
    """For each vertex (n, 3) the sum of the vectors (M, 3) of its triangles, times the share (M, 3) of the corner."""
    sums = np.zeros((n_vertices, 3))
    for face in range(len(faces)):
        for corner in range(3):
            for axis in range(3):
                sums[faces[face, corner], axis] += vectors[face, axis] * weight[face, corner]
    return sums


def used(n: int, faces: Faces) -> Bools:
    """True (n,) where a face uses the vertex."""
    in_face = np.zeros(n, dtype=bool)
    in_face[faces] = True
    return in_face


def in_use(verts: Verts, faces: Faces) -> tuple[Ints, Verts, Faces]:
    """Numbers (U,) of the vertices that faces use, these vertices (U, 3), and the faces (M, 3) among them."""
    in_face = used(len(verts), faces)
    return np.flatnonzero(in_face), verts[in_face], (np.cumsum(in_face) - 1)[faces]


def edges(faces: Faces) -> Ints:
    """Edges (E, 2), each once, the smaller vertex first, in ascending order."""
    return edges_and_counts(faces)[0]


@memoized
def edges_and_counts(faces: Faces) -> tuple[Ints, Ints]:
    """``edges``, and the number of triangles at each (E,)."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)  # n^2 needs more
    lower_vertex, higher_vertex = pairs.min(axis=1), pairs.max(axis=1)
    key_base = int(faces.max()) + 1
    edge_key, n_triangles = np.unique(lower_vertex * key_base + higher_vertex, return_counts=True)
    return np.stack([edge_key // key_base, edge_key % key_base], axis=1), n_triangles


def border_edges(faces: Faces) -> Ints:
    """The ``edges`` (B, 2) that belong to only one triangle."""
    edge_ends, n_triangles = edges_and_counts(faces)
    return edge_ends[n_triangles == 1]


@memoized
def edges_of_faces(faces: Faces) -> Ints:
    """Index in ``edges`` of the side of each triangle from each corner to the next (M, 3)."""
    edge_ends, key_base = edges(faces), int(faces.max()) + 1
    start_vertex = faces.astype(np.int64)  # n^2 needs more than 32 bits
    stop_vertex = np.roll(start_vertex, -1, axis=1)
    side_key = np.minimum(start_vertex, stop_vertex) * key_base + np.maximum(start_vertex, stop_vertex)
    return np.searchsorted(edge_ends[:, 0] * key_base + edge_ends[:, 1], side_key)  # ascending, as edges are


@memoized
def edge_lengths(verts: Verts, faces: Faces) -> Array:
    """Lengths (E,) of ``edges`` [mm]."""
    edge_ends = edges(faces)
    return norms(verts[edge_ends[:, 0]] - verts[edge_ends[:, 1]])


def mean_edge_length(verts: Verts, faces: Faces) -> float:
    """Mean length of the edges [mm], each edge once."""
    return float(edge_lengths(verts, faces).mean())


def split(verts: Verts, faces: Faces) -> tuple[Verts, Faces]:
    """The same surface with every triangle cut in four: the old vertices, then the middles of ``edges``.

    Returns
    -------
    verts : (N + E, 3) float64
    faces : (4 M, 3) int64
        Triangle i is cut into i, i + M, i + 2 M (its corners, in order) and i + 3 M (its middle).
    """
    edge_ends, (a, b, c) = edges(faces), faces.T
    ab, bc, ca = len(verts) + edges_of_faces(faces).T
    sub_triangles = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return (
        np.concatenate([verts, (verts[edge_ends[:, 0]] + verts[edge_ends[:, 1]]) / 2]),
        np.concatenate([np.stack(corners, axis=1) for corners in sub_triangles]),
    )


@memoized
def adjacency(n: int, faces: Faces) -> sparse.csr_array:
    """(n, n) boolean CSR; ``indptr`` and ``indices`` list each vertex's neighbours in ascending order."""
    pairs = edges(faces)
    return symmetric(n, pairs, np.ones(len(pairs), dtype=np.bool_))


def symmetric(n: int, pairs: Ints, values: NDArray[Any]) -> sparse.csr_array:
    """(n, n) CSR of values (E,) at the positions ``pairs`` (E, 2) and mirrored; ``indices`` ascend in each row."""
    (i, j), both_values = pairs.T.astype(np.int32), np.concatenate([values, values])
    matrix = sparse.csr_array((both_values, (np.concatenate([j, i]), np.concatenate([i, j]))), shape=(n, n))  # in order
    matrix.sort_indices()
    return matrix


def edge_graph(verts: Verts, faces: Faces) -> sparse.csr_array:
    """(N, N) symmetric CSR of edge lengths [mm]; an edge of zero length is stored as 1e-300."""
    return symmetric(len(verts), edges(faces), np.maximum(edge_lengths(verts, faces), 1e-300))


@memoized
def incident_faces(n: int, faces: Faces) -> sparse.csr_array:
    """(n, M) boolean CSR; ``indptr`` and ``indices`` list the faces of each vertex in ascending order."""
    face_of_corner = np.repeat(np.arange(len(faces), dtype=np.int32), 3)
    ones = np.ones(len(face_of_corner), dtype=np.bool_)
    matrix = sparse.csr_array((ones, (faces.ravel().astype(np.int32), face_of_corner)), shape=(n, len(faces)))
    matrix.sort_indices()
    return matrix


@memoized
def cotangent_laplacian(verts: Verts, faces: Faces, *, clip: tuple[float, float] | None = None) -> sparse.csr_array:
    """Stiffness matrix L (N, N) of linear elements: symmetric, rows sum to zero, ``x @ L @ x >= 0``.

    ``(L x)_i = sum_j w_ij (x_i - x_j)`` with ``w_ij = (cot a + cot b) / 2`` over the two angles that face the edge.
    With ``clip`` the cotangents are first bounded by it. A lower bound of 0 makes every weight non-negative (a maximum
    principle on needle triangles), but loses consistency there.
    """
    doubled_vectors, dot_products, _ = triangles(verts, faces)
    doubled_areas = norms(doubled_vectors)[:, None]
    cotangents = ratio(dot_products, doubled_areas)
    if clip is not None:
        cotangents = np.clip(cotangents, *clip)
    n, facing_edge = len(verts), edges_of_faces(faces)[:, [1, 2, 0]]  # the edge facing each corner
    weights = np.bincount(facing_edge.ravel(), cotangents.ravel() / 2, len(edges(faces)))
    row_sums = np.bincount(edges(faces).ravel(), np.repeat(weights, 2), n)
    return (symmetric(n, edges(faces), -weights) + sparse.dia_array((row_sums[None, :], [0]), shape=(n, n))).tocsr()


def euler_characteristic(faces: Faces) -> int:
    """V - E + F over the vertices that faces use; 2 for a sphere, 0 for a torus."""
    check_arrays(faces, faces)
    return int(np.count_nonzero(used(int(faces.max()) + 1, faces))) - len(edges(faces)) + len(faces)


@memoized
def is_closed(faces: Faces) -> bool:
    """True if exactly two faces meet at every edge."""
    return bool((edges_and_counts(faces)[1] == 2).all())


@memoized
def components(n: int, faces: Faces) -> tuple[int, Ints]:
    """Number of connected pieces, and the piece (n,) of each vertex; -1 if no face uses the vertex."""
    part = connected(n, edges(faces))
    is_used = used(n, faces)
    piece = np.full(n, -1, dtype=np.int64)
    used_parts, piece[is_used] = np.unique(part[is_used], return_inverse=True)
    return len(used_parts), piece


def connected(n_items: int, pairs: Ints) -> Ints:
    """Connected part (n,), from 0, of each of n elements joined by ``pairs`` (P, 2)."""
    links = sparse.coo_array((np.ones(len(pairs), dtype=np.bool_), tuple(pairs.T)), shape=(n_items, n_items))
    return csgraph.connected_components(links, directed=False)[1].astype(np.int64)


def arc_length(points: Array) -> Array:
    """Length (P,) [mm] along a polyline from the first of its points (P, 3) to each of them."""
    lengths = np.zeros(len(points))
    np.cumsum(norms(points[1:] - points[:-1]), out=lengths[1:])
    return lengths


def morton_codes(points: Array, bits: int = 20) -> Ints:
    """Position (P,) along a Morton curve of points (P, 3) in the unit cube: ``bits`` of each axis, 20 at most."""
    codes: Ints = _morton(*reading(points), bits)
    return codes


@kernel
def _morton(points, bits):
    codes, n_cells = np.zeros(len(points), dtype=np.int64), 2**bits
    for row in range(len(points)):
        for axis in range(3):
            cell = min(int(points[row, axis] * n_cells), n_cells - 1)
            for bit in range(bits):
                codes[row] |= ((cell >> bit) & 1) << (3 * bit + axis)
    return codes


@njit(inline="always")
def position(points, index):
    """Point i of an array (P, 3)."""
    return points[index, 0], points[index, 1], points[index, 2]


@njit(inline="always")
def corners(verts, faces, face):
    """The three corners of face f."""
    return position(verts, faces[face, 0]), position(verts, faces[face, 1]), position(verts, faces[face, 2])


@kernel
def less(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def weighted(r, a, s, b, t, c):
    """r a + s b + t c: the point of a triangle with these barycentric weights."""
    return r * a[0] + s * b[0] + t * c[0], r * a[1] + s * b[1] + t * c[1], r * a[2] + s * b[2] + t * c[2]


@kernel
def area_vector(a, b, c):
    """Normal of the triangle abc, outward if it is counter-clockwise; its length is twice the area."""
    return cross(less(b, a), less(c, a))


@njit(inline="always")
def nearest_weights(p, a, b, c):
    """Barycentric weights of the point of triangle abc nearest to p (Ericson 2005, section 5.1.5); not for needles."""
    ab, ac, ap, bp, cp = less(b, a), less(c, a), less(p, a), less(p, b), less(p, c)
    d1, d2, d3, d4, d5, d6 = dot(ab, ap), dot(ac, ap), dot(ab, bp), dot(ac, bp), dot(ab, cp), dot(ac, cp)
    if d1 <= 0 and d2 <= 0:
        return 1.0, 0.0, 0.0
    if d3 >= 0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        t = d1 / (d1 - d3)
        return 1 - t, t, 0.0
    if d6 >= 0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6)
        return 1 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1 - t, t
    total = va + vb + vc
    return va / total, vb / total, vc / total


@njit(inline="always")
def _clamp(x):
    return min(max(x, 0.0), 1.0)


@kernel
def closest_in_triangle(p, a, b, c):
    """Barycentric coordinates (of b, of c) of the point of triangle abc nearest to p, also for needle triangles."""
    u, v, w = less(b, a), less(c, a), less(p, a)
    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    det = uu * vv - uv * uv  # 4 x squared area
    if det > 1e-14 * uu * vv:
        s, t = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
        if s >= 0 and t >= 0 and s + t <= 1:
            return s, t
    # Outside (or a sliver): the nearest of the three edges' nearest points, compared without constants.
    s = _clamp(uw / uu) if uu > 0 else 0.0
    best_s, best_t, least_square = s, 0.0, s * s * uu - 2 * s * uw
    t = _clamp(vw / vv) if vv > 0 else 0.0
    square = t * t * vv - 2 * t * vw
    if square < least_square:
        best_s, best_t, least_square = 0.0, t, square
    edge_square = uu + vv - 2 * uv  # edge from b to c
    t = _clamp((vw - uw + uu - uv) / edge_square) if edge_square > 0 else 0.0
    square = (1 - t) ** 2 * uu + t * t * vv + 2 * t * (1 - t) * uv - 2 * (1 - t) * uw - 2 * t * vw
    if square < least_square:
        best_s, best_t = 1 - t, t
    return best_s, best_t


@kernel
def distance_from_triangle(p, a, b, c):
    """Distance of p from the triangle abc: from its plane if p lies over it (exactly 0 on it), else from a side."""
    normal, is_above, least_square = area_vector(a, b, c), True, np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        side_vector, offset = less(end, start), less(p, start)
        is_above &= dot(cross(side_vector, offset), normal) >= 0.0
        t = min(max(dot(side_vector, offset) / max(dot(side_vector, side_vector), 1e-300), 0.0), 1.0)
        from_side = offset[0] - t * side_vector[0], offset[1] - t * side_vector[1], offset[2] - t * side_vector[2]
        least_square = min(least_square, dot(from_side, from_side))
    normal_square = dot(normal, normal)
    return abs(dot(less(p, a), normal)) / normal_square**0.5 if is_above and normal_square > 0.0 else least_square**0.5
