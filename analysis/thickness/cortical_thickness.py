"""Cortical thickness between a white and a pial surface: one length per vertex."""

import math

import numpy as np

from morphofold import geometry
from morphofold.errors import OutOfRange, UnlikeSurfaces
from morphofold.frozen_arrays import Array, memoized
from morphofold.geometry import closest_in_triangle, corners, dot, less, position, weighted
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Surface, Verts
from morphofold.threads import in_blocks
from morphofold.validators import check_kind, one_of

LEAST_RELIABLE_AREA = 1e-5  # of a triangle, over its squared radius: rounding may turn the normal of a thinner one
DISC_MARGIN = 1e-6  # relative margin, safe against rounding, of the squared distance of the disc around a triangle


def cortical_thickness(
    white: Surface, pial: Surface, *, mode: str = "surface", cap: float | None = None, rings: int = 10
) -> PerVertex:
    """Cortical thickness: half the sum of the distances from white to pial and from pial to white.

    At vertex i, ``t_i = (min(a_i, cap) + min(b_i, cap)) / 2``. ``a_i`` is the distance from white vertex i to the
    nearest admissible point of the pial surface, and ``b_i`` the distance from pial vertex i to that of the white
    surface.

    Parameters
    ----------
    white, pial : Surface
        Inner and outer surface [mm] with equal faces: vertex i of one corresponds to vertex i of the other.
    mode : {"surface", "freesurfer"}
        ``"surface"``: nearest point of a *triangle*. It does not depend on resolution; use it for models and coarse
        meshes. ``"freesurfer"``: nearest *vertex* within ``rings`` rings, as in FreeSurfer's thickness files. It is too
        large on coarse meshes (by 8 % on fsaverage5); use it to compare with such files.
    cap : float or None
        Upper bound [mm] of each of the two distances. FreeSurfer uses 5, meant for adult human cortex, where it lowers
        the mean by 0.1 %. A simulated cortex of reference thickness 3 is 7 to 8 thick at growth 2.
    rings : int
        Reach of the search in ``"freesurfer"`` mode. FreeSurfer uses 20; 10 takes a fifth of the time and differs at
        0.2 % of the vertices.

    Returns
    -------
    thickness : (N,) float64
        [mm]. 0 where white and pial coincide (FreeSurfer's medial wall); NaN at a vertex that no face uses.

    Raises
    ------
    ValueError
        If the surfaces do not correspond, or an option has no meaning.

    Notes
    -----
    A point q is admissible from p if it lies outward of white (inward of pial), ``(q - p) . n >= 0`` (``<= 0``), and
    faces the same way, ``n_q . n >= 0``. In both directions all normals are those of the pial surface, with corners
    weighted by the sine of their angle. The normal of a point on a white triangle is interpolated from the pial normals
    of its vertices. The search starts at the partner vertex and its distance. In ``"surface"`` mode it continues over
    the other surface through vertices no farther than the partner (plus one mean edge). It therefore cannot jump across
    a sulcus to a nearby bank. The definition is that of Fischl and Dale [1]_. The normals, the rings and the use of the
    cap were found by comparison with FreeSurfer's files.

    References
    ----------
    .. [1] Fischl, Dale. Measuring the thickness of the human cerebral cortex from magnetic resonance images.
       PNAS 97, 2000.
    """
    for name, surface in (("white", white), ("pial", pial)):
        check_kind(surface, Surface, f"cortical_thickness: {name}")
    one_of(mode, ("surface", "freesurfer"), "mode")
    largest_distance = math.inf if cap is None else float(cap)
    if not largest_distance > 0:
        raise OutOfRange(f"cap must be a positive length or None, got {cap!r}.")
    if rings < 1:
        raise OutOfRange(f"rings must be at least 1, got {rings}.")
    if white.verts.shape != pial.verts.shape or not np.array_equal(white.faces, pial.faces):
        raise UnlikeSurfaces(
            f"{white.name} ({len(white.verts)} vertices, {len(white.faces)} faces) and {pial.name} ({len(pial.verts)}, "
            f"{len(pial.faces)}) do not correspond. Thickness needs the same faces in both: take both from one "
            "reconstruction."
        )
    faces, normals = pial.faces, geometry.vertex_normals(pial.verts, pial.faces, weights="sine")
    distance_sum = np.zeros(len(pial.verts))
    for start_verts, target_verts, sign in ((white.verts, pial.verts, 1.0), (pial.verts, white.verts, -1.0)):
        if mode == "freesurfer":
            distance = _distance_to_nearest_vertex(start_verts, target_verts, faces, normals, sign, rings)
        else:
            distance = _distance_to_nearest_triangle(start_verts, target_verts, faces, normals, sign)
        distance_sum += np.minimum(distance, largest_distance)
    distance_sum[~geometry.used(len(distance_sum), faces)] = np.nan
    return distance_sum / 2


def _distance_to_nearest_vertex(
    start: Verts, target: Verts, faces: Faces, normals: Verts, sign: float, rings: int
) -> PerVertex:
    """Distance [mm] from each start vertex to the nearest admissible target vertex within so many rings, (N,)."""
    neighbours, distance = geometry.adjacency(len(target), faces), np.empty(len(target))
    in_blocks(_search_vertices, len(distance), *reading(start, target, normals, neighbours), sign, rings, distance)
    return distance


@memoized
def _distance_to_nearest_triangle(start: Verts, target: Verts, faces: Faces, normals: Verts, sign: float) -> PerVertex:
    """Distance [mm] from each start vertex to the nearest admissible target triangle near its partner, (N,)."""
    graph, vertex_faces = geometry.adjacency(len(target), faces), geometry.incident_faces(len(target), faces)
    distance, radius = np.empty(len(target)), geometry.norms(target - start)
    radius += (radius > 0) * geometry.mean_edge_length(target, faces)
    arrays = reading(start, target, normals, graph, faces, vertex_faces, _discs_around_triangles(target, faces), radius)
    in_blocks(_search_triangles, len(distance), *arrays, sign, distance)
    return distance


def _discs_around_triangles(verts: Verts, faces: Faces) -> Array:
    """Middle of each triangle [mm], its unit normal, and the distance of its farthest corner from the middle (M, 7).

    The normal of a needle or cap, which rounding may turn, is zero.
    """
    corners = [verts[corner] for corner in faces.T]
    middle = (corners[0] + corners[1] + corners[2]) / 3
    radius = np.maximum.reduce([geometry.norms(corner - middle) for corner in corners])
    normal, area = geometry.face_vectors(verts, faces), geometry.face_areas(verts, faces)
    is_reliable = area > LEAST_RELIABLE_AREA * radius**2
    normal = normal * np.divide(1, area, out=np.zeros_like(area), where=is_reliable)[:, None]
    return np.column_stack([middle, normal, radius])


@kernel
def _search_vertices(begin, end, start_verts, target_verts, normals, indptr, indices, sign, rings, distance):
    """Write the distance [mm] from each start vertex to the nearest admissible target vertex within so many rings."""
    seen, queue = np.zeros(len(target_verts), np.int32), np.empty(len(target_verts), np.int32)
    for i in range(begin, end):
        point, normal = position(start_verts, i), position(normals, i)
        offset = less(position(target_verts, i), point)
        least = dot(offset, offset)
        queue[0], seen[i] = i, i + 1
        ring_start, queue_end = 0, 1
        for _ in range(rings):
            ring_end = queue_end
            for q in range(ring_start, ring_end):
                for e in range(indptr[queue[q]], indptr[queue[q] + 1]):
                    node = indices[e]
                    if seen[node] == i + 1:
                        continue
                    seen[node] = i + 1
                    queue[queue_end] = node
                    queue_end += 1
                    offset = less(position(target_verts, node), point)
                    square = dot(offset, offset)
                    if square < least and sign * dot(offset, normal) >= 0 and dot(position(normals, node), normal) >= 0:
                        least = square
            ring_start = ring_end
        distance[i] = math.sqrt(least)


@kernel
def _search_triangles(
    begin, end, start, target, normals, indptr, indices, faces, face_ptr, face_ids, discs, search_radius, sign, distance
):
    """Write the distance [mm] from each start vertex to the nearest admissible target triangle near its partner.

    The vertices within ``search_radius`` (N,) are found first, and triangles at the nearest are tested first. Most
    others then lie farther than the best so far: each is within a disc, whose distance is cheap.
    """
    seen, tested = np.zeros(len(target), np.int32), np.zeros(len(faces), np.int32)
    queue = np.empty(len(target), np.int32)
    for i in range(begin, end):
        point, normal = position(start, i), position(normals, i)
        offset = less(position(target, i), point)
        least_square = dot(offset, offset)
        squared_radius, nearest_square, nearest_row = search_radius[i] * search_radius[i], least_square, 0
        queue[0], seen[i] = i, i + 1
        head, queue_end = 0, 1
        while head < queue_end and least_square > 0:
            vertex = queue[head]
            head += 1
            for e in range(indptr[vertex], indptr[vertex + 1]):
                neighbour = indices[e]
                if seen[neighbour] != i + 1:
                    seen[neighbour] = i + 1
                    offset = less(position(target, neighbour), point)
                    square = dot(offset, offset)
                    if square <= squared_radius:
                        queue[queue_end] = neighbour
                        if square < nearest_square:
                            nearest_square, nearest_row = square, queue_end
                        queue_end += 1
        queue[0], queue[nearest_row] = queue[nearest_row], queue[0]
        for q in range(queue_end if least_square > 0 else 0):
            vertex = queue[q]
            for e in range(face_ptr[vertex], face_ptr[vertex + 1]):
                face = face_ids[e]
                if tested[face] == i + 1:
                    continue
                tested[face] = i + 1
                disc_offset = less(point, position(discs, face))
                height = dot(disc_offset, (discs[face, 3], discs[face, 4], discs[face, 5]))
                height *= height
                beyond_disc = math.sqrt(max(dot(disc_offset, disc_offset) - height, 0.0)) - discs[face, 6]
                if (height + max(beyond_disc, 0.0) ** 2) * (1.0 - DISC_MARGIN) > least_square:
                    continue
                a, b, c = corners(target, faces, face)
                s, t = closest_in_triangle(point, a, b, c)
                offset = less(weighted(1.0 - s - t, a, s, b, t, c), point)
                square = dot(offset, offset)
                if square >= least_square or sign * dot(offset, normal) < 0:
                    continue
                a, b, c = corners(normals, faces, face)
                if dot(weighted(1.0 - s - t, a, s, b, t, c), normal) >= 0:
                    least_square = square
        distance[i] = math.sqrt(least_square)
