"""Principal curvatures and their directions at each vertex of a triangle mesh, and the scales to measure them at."""

import math
from dataclasses import dataclass

import numpy as np

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.geometry import (
    adjacency,
    cross,
    dot,
    equal_area_radius,
    less,
    mean_edge_length,
    position,
    unit,
    vertex_normals,
)
from morphofold.kernels import kernel, reading
from morphofold.surface import Cortex, Faces, PerVertex, Verts
from morphofold.threads import in_blocks
from morphofold.validators import check_mesh, positive

DEFAULT_SCALE_IN_EDGES = 3.0  # the default scale, in mean edges
LEAST_CUBIC_FIT_POINTS = 14  # points needed for the ten coefficients; with fewer the neighbourhood grows
LEAST_NORMAL_COSINE = 0.2  # cosine below which a neighbour's normal belongs to another wall
ENLARGEMENT_FACTOR = 1.4  # factor on the radius where there are too few points, at most MOST_ENLARGEMENTS times
MOST_ENLARGEMENTS = 5
# powers of u and v in the ten monomials
U_POWERS, V_POWERS = (0, 1, 0, 2, 1, 0, 3, 2, 1, 0), (0, 0, 1, 0, 1, 2, 0, 1, 2, 3)
SMALLEST_RELATIVE_PIVOT = 1e-4  # smallest Cholesky pivot, relative to its diagonal, that counts as determined


@dataclass(frozen=True, eq=False)
class Curvature:
    """Curvature of a surface at each vertex at a given scale; positive where convex, [1/length] of the mesh.

    ``k1 >= k2`` (N,); unit directions ``d1``, ``d2`` (N, 3), with arbitrary sign, right-handed with ``normals`` (N, 3),
    the outward normals of the fitted surface; extremalities ``e1``, ``e2`` (N,) [1/length^2], the derivatives of k1
    along d1 and of k2 along d2, whose sign follows that of the direction; ``scale``, the radius of the neighbourhoods
    in the length unit of the mesh. NaN where no face uses the vertex or no surface could be fitted.
    """

    k1: PerVertex
    k2: PerVertex
    d1: Array
    d2: Array
    normals: Array
    e1: PerVertex
    e2: PerVertex
    scale: float

    def __repr__(self) -> str:
        return f"Curvature({len(self.normals):,} vertices, neighbourhoods of {self.scale:.3g} mm)"

    @property
    def H(self) -> PerVertex:
        """Mean curvature (k1 + k2) / 2 (N,) [1/length]; 1/r on a sphere."""
        return (self.k1 + self.k2) / 2

    @property
    def K(self) -> PerVertex:
        """Gaussian curvature k1 k2 (N,) [1/length^2]; 1/r^2 on a sphere."""
        return self.k1 * self.k2

    @property
    def shape_index(self) -> PerVertex:
        """(2/pi) atan((k1 + k2) / (k1 - k2)) (N,): 1 dome, 1/2 ridge, 0 saddle, -1/2 rut, -1 cup; NaN on a plane."""
        with np.errstate(invalid="ignore"):
            index = 2 / np.pi * np.arctan2(self.k1 + self.k2, self.k1 - self.k2)
        return np.where((self.k1 == 0) & (self.k2 == 0), np.nan, index)

    @property
    def curvedness(self) -> PerVertex:
        """sqrt((k1^2 + k2^2) / 2) (N,) [1/length]; 1/r on a sphere."""
        return np.sqrt((self.k1**2 + self.k2**2) / 2)


def curvature(verts: Verts, faces: Faces, scale: float | None = None) -> Curvature:
    """Principal curvatures by a local cubic fit within a physical radius.

    Parameters
    ----------
    verts : (N, 3) float64
        Vertex positions [mm].
    faces : (M, 3) int64
        Triangles, counter-clockwise seen from outside. Borders, several pieces and unused vertices are allowed.
    scale : float, optional
        Radius of the neighbourhood [mm]. The bias grows with its square. The effect of noise falls with its cube up to
        six mean edges and with its square beyond. For a surface with 1 % noise use 4 to 5 mean edges, or at least 4.5
        if its vertices lie at random; for a clean one 2.2 to 3. None: 3 mean edges.

    Returns
    -------
    Curvature
        Curvature at ``scale``, which it contains. NaN at a vertex that no face uses, or where even the largest
        neighbourhood does not determine a quadric. On a FreeSurfer pial surface these are a few vertices in ten
        thousand, in crushed or folded places.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh; or if scale is shorter than the mean edge, or longer than both
        the radius of a sphere of equal area and 3 mean edges.

    Notes
    -----
    The neighbourhood of a vertex is found by walking along edges, over vertices within ``scale`` that face the same way
    (normals less than 78 degrees apart). So the opposite wall of a closed sulcus is excluded. A cubic polynomial is
    fitted to the heights over the tangent plane. It has constant and linear terms, so it is not forced through the
    vertex or into the frame. The weights are ``(1 - d^2/scale^2) n.n_i``.
    Curvatures and directions follow from the first and second fundamental form of the fit at the vertex.

    A point of height h is not placed at its projection x. It is moved outwards along the unit gradient g of the surface
    there by ``sqrt((g.x)^2 + h^2) - g.x`` (with the sign of g such that ``g.x > 0``). The chord then keeps its length
    across the contours of height. This changes only the third order, and makes heights on a sphere and on a circular
    cylinder exactly quadratic. Without it, folds narrower than ``scale`` come out too sharp. The gradient is that of
    ``k1 u^2 + k2 v^2`` from a first fit, and the second fit uses the normal and principal directions of the first. The
    first fit moves points radially, which is exact on spheres but turns a cylinder into a dome. For a torus with a tube
    of radius 2 at scale 3, the integral of the positive K divided by 4 pi is 0.97 (exact 1); after the first fit it is
    1.58. The method is of second order in ``scale``, also on irregular meshes. At a fixed scale, narrower folds come
    out too blunt.

    Where fewer than 14 points are found, or they do not determine a cubic, the radius grows, up to 5.4 times, and then
    a quadric is tried. Local polynomial fits are due to [1]_. This one uses heights only. Normals of neighbours would
    carry one order more of the noise.

    References
    ----------
    .. [1] Cazals, Pouget. Estimating differential quantities using polynomial fitting of osculating jets.
       Computer Aided Geometric Design 22, 2005.

    Examples
    --------
    >>> from morphofold.shapes import icosphere
    >>> c = curvature(*icosphere(4, radius=10.0))
    >>> print(f"{c.k2.min():.3f} .. {c.k1.max():.3f}")
    0.100 .. 0.100
    """
    check_mesh(verts, faces)
    verts, faces = np.ascontiguousarray(verts, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
    if scale is None:
        scale = DEFAULT_SCALE_IN_EDGES * mean_edge_length(verts, faces)
    check_scale(verts, faces, scale)
    ring = adjacency(len(verts), faces)
    normals = vertex_normals(verts, faces, "max")
    lacks_normal = ~normals.any(axis=1)  # only triangles without area: use the neighbours' direction
    if lacks_normal.any():
        normals = normals.copy()
        normals[lacks_normal] = unit(ring[lacks_normal] @ normals)
    k1, k2, e1, e2 = np.full((4, len(verts)), np.nan)
    d1, d2, fitted = np.full((3, len(verts), 3), np.nan)
    in_blocks(_fit_curvatures, len(verts), *reading(verts, normals, ring), float(scale), k1, k2, d1, d2, fitted, e1, e2)
    return Curvature(k1, k2, d1, d2, fitted, e1, e2, float(scale))


def largest_scale(verts: Verts, faces: Faces) -> float:
    """Radius of a sphere of equal area, or 3 mean edges if that is more, as a coarse mesh needs."""
    return max(equal_area_radius(verts, faces), DEFAULT_SCALE_IN_EDGES * mean_edge_length(verts, faces))


def check_scale(verts: Verts, faces: Faces, scale: float) -> None:
    """Raise ``OutOfRange`` if the radius ``scale`` does not fit the mesh, by the bounds of ``curvature``."""
    mean_edge = mean_edge_length(verts, faces)
    positive(scale, "scale", "length in the unit of the mesh")
    radius = equal_area_radius(verts, faces)
    if scale < mean_edge:
        raise OutOfRange(
            f"scale {scale:.4g} is less than the mean edge of the mesh, {mean_edge:.4g}: so small a neighbourhood "
            f"does not hold enough vertices. Pass {2.2 * mean_edge:.4g} to {3 * mean_edge:.4g}, or refine the mesh."
        )
    if scale > largest_scale(verts, faces):
        raise OutOfRange(
            f"scale {scale:.4g} is more than the radius {radius:.4g} of a sphere with the area of the mesh; the mean "
            f"edge is {mean_edge:.4g}. Pass {2.2 * mean_edge:.4g} to {max(radius / 4, 3 * mean_edge):.4g}. Are scale "
            "and mesh in the same unit of length?"
        )


@kernel
def _fit_curvatures(start, stop, verts, normals, indptr, indices, scale, k1, k2, d1, d2, new_normals, e1, e2):
    """Write k1, k2 (N,) [1/length]; d1, d2 and the fitted normal (N, 3); e1, e2 (N,) [1/length^2]."""
    seen, queue = np.zeros(len(verts), np.int32), np.empty(len(verts), np.int32)
    stamp = 0
    A, b, moments, frame = np.empty((10, 10)), np.empty(10), np.empty((7, 7)), np.empty((3, 3))
    for i in range(start, stop):
        if indptr[i] == indptr[i + 1]:
            continue
        radius, n_unknowns, n_points = scale, 0, 0
        _tangent_frame(normals[i], frame)
        for trial in range(MOST_ENLARGEMENTS + 1):
            if trial > 0:
                radius *= ENLARGEMENT_FACTOR
            stamp += 1
            n_points = _collect_neighbourhood(i, verts, normals, indptr, indices, radius, seen, stamp, queue)
            if n_points >= LEAST_CUBIC_FIT_POINTS or trial == MOST_ENLARGEMENTS:
                _normal_equations(i, verts, normals, queue, n_points, radius, frame, 1.0, 1.0, A, b, moments)
                n_unknowns = _solve_cholesky(A, b, 10 if n_points >= LEAST_CUBIC_FIT_POINTS else 6)
                if n_unknowns == 10:
                    break
        if n_unknowns < 6:
            continue
        _principal_curvatures(i, b, radius, frame, k1, k2, d1, d2, new_normals)
        for k in range(3):  # again, in the frame of the first fit
            frame[0, k], frame[1, k], frame[2, k] = d1[i, k], d2[i, k], new_normals[i, k]
        _normal_equations(i, verts, normals, queue, n_points, radius, frame, k1[i], k2[i], A, b, moments)
        n_unknowns = _solve_cholesky(A, b, n_unknowns)
        if n_unknowns >= 6:
            _principal_curvatures(i, b, radius, frame, k1, k2, d1, d2, new_normals)
        if n_unknowns == 10:
            e1[i] = _extremality(b, radius, frame, d1[i])
            e2[i] = _extremality(b, radius, frame, d2[i])


@kernel
def _collect_neighbourhood(i, verts, normals, indptr, indices, radius, seen, stamp, queue):
    """Fill ``queue`` with vertices within ``radius`` that face like vertex i and connect to it through such ones."""
    centre, normal, squared_radius = position(verts, i), position(normals, i), radius * radius
    queue[0], seen[i] = i, stamp
    head, queue_end = 0, 1
    while head < queue_end:
        vertex = queue[head]
        head += 1
        for e in range(indptr[vertex], indptr[vertex + 1]):
            neighbour = indices[e]
            if seen[neighbour] == stamp:
                continue
            seen[neighbour] = stamp
            offset = less(position(verts, neighbour), centre)
            if dot(offset, offset) < squared_radius and dot(position(normals, neighbour), normal) > LEAST_NORMAL_COSINE:
                queue[queue_end] = neighbour
                queue_end += 1
    return queue_end


@kernel
def _tangent_frame(normal, frame):
    """Rows: two tangents and the normal."""
    n = normal[0], normal[1], normal[2]
    x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
    if x <= y and x <= z:  # the cross product with the axis farthest from the normal
        tangent = 0.0, n[2], -n[1]
    elif y <= z:
        tangent = -n[2], 0.0, n[0]
    else:
        tangent = n[1], -n[0], 0.0
    length = math.sqrt(dot(tangent, tangent))
    if length == 0.0:
        length = 1.0
    tangent = tangent[0] / length, tangent[1] / length, tangent[2] / length
    second_tangent = cross(n, tangent)
    for k in range(3):
        frame[0, k], frame[1, k], frame[2, k] = tangent[k], second_tangent[k], n[k]


@kernel
def _normal_equations(i, verts, normals, queue, n_points, radius, frame, bend_u, bend_v, A, b, moments):
    """Weighted least squares of the heights over the tangent plane with ten monomials, lengths in radii.

    Points move outwards along the gradient of ``bend_u u^2 + bend_v v^2``; radially if the two are equal. Of the matrix
    only the weighted moments ``moments[p, q]`` of ``u^p v^q`` are summed, which are its 28 different entries.
    """
    for u_power in range(7):
        for v_power in range(7 - u_power):
            moments[u_power, v_power] = 0.0
    for row in range(10):
        b[row] = 0.0
    for q in range(n_points):
        neighbour = queue[q]
        offset = less(position(verts, neighbour), position(verts, i))
        offset = offset[0] / radius, offset[1] / radius, offset[2] / radius
        u, v, height = dot(position(frame, 0), offset), dot(position(frame, 1), offset), dot(position(frame, 2), offset)
        squared_distance = dot(offset, offset)
        gu, gv = bend_u * u, bend_v * v
        bend_size = math.sqrt(gu * gu + gv * gv)
        if bend_size > 0.0:  # at the centre, and on a plane, there is nothing to move
            along_bend = abs(gu * u + gv * v) / bend_size
            step = (math.sqrt(along_bend * along_bend + height * height) - along_bend) / bend_size
            if gu * u + gv * v < 0.0:
                step = -step
            u, v = u + step * gu, v + step * gv
        weight = max(dot(position(normals, neighbour), position(frame, 2)), 0.0) * (1.0 - squared_distance)
        term = weight
        for u_power in range(7):
            moment_term = term
            for v_power in range(7 - u_power):
                moments[u_power, v_power] += moment_term
                moment_term *= v
            term *= u
        wh = weight * height
        wu, wv, wuu, wuv, wvv = wh * u, wh * v, wh * u * u, wh * u * v, wh * v * v
        b[0] += wh
        b[1] += wu
        b[2] += wv
        b[3] += wuu
        b[4] += wuv
        b[5] += wvv
        b[6] += wuu * u
        b[7] += wuu * v
        b[8] += wvv * u
        b[9] += wvv * v
    for row in range(10):
        for column in range(row + 1):
            A[row, column] = moments[U_POWERS[row] + U_POWERS[column], V_POWERS[row] + V_POWERS[column]]


@kernel
def _solve_cholesky(A, b, n_unknowns):
    """Solve A x = b in place by Cholesky for the leading ``n_unknowns`` unknowns: 10, or 6 if those are not determined.

    Returns the order solved; 0 if not even six are determined.
    """
    row = 0
    while row < n_unknowns:
        for column in range(row):
            remainder = A[row, column]
            for k in range(column):
                remainder -= A[row, k] * A[column, k]
            A[row, column] = remainder / A[column, column]
        remainder = A[row, row]
        for k in range(row):
            remainder -= A[row, k] * A[row, k]
        if not remainder > SMALLEST_RELATIVE_PIVOT * A[row, row]:  # also true of 0 and NaN
            n_unknowns = 6 if row >= 6 else 0
            break
        A[row, row] = math.sqrt(remainder)
        row += 1
    for row in range(n_unknowns):
        remainder = b[row]
        for k in range(row):
            remainder -= A[row, k] * b[k]
        b[row] = remainder / A[row, row]
    for row in range(n_unknowns - 1, -1, -1):
        remainder = b[row]
        for k in range(row + 1, n_unknowns):
            remainder -= A[k, row] * b[k]
        b[row] = remainder / A[row, row]
    return n_unknowns


@kernel
def _principal_curvatures(i, coefficients, radius, frame, k1, k2, d1, d2, new_normals):
    """Principal curvatures of the graph h(u, v) at the origin, from its first and second derivatives."""
    p, q = coefficients[1], coefficients[2]
    E, F = 1.0 + p * p, p * q
    D2 = 1.0 + p * p + q * q  # E G - F^2
    D = math.sqrt(D2)
    L, M, N = -2.0 * coefficients[3] / D, -coefficients[4] / D, -2.0 * coefficients[5] / D  # minus: a hill is convex
    # The second form in the orthonormal basis e = d_u / sqrt(E), f = (E d_v - F d_u) / (sqrt(E) D).
    ee = L / E
    ef = (E * M - F * L) / (E * D)
    ff = (F * F * L - 2.0 * E * F * M + E * E * N) / (E * D2)
    mean_curvature, half_difference = (ee + ff) / 2.0, math.sqrt(((ee - ff) / 2.0) ** 2 + ef * ef)
    k1[i], k2[i] = (mean_curvature + half_difference) / radius, (mean_curvature - half_difference) / radius
    angle = math.atan2(2.0 * ef, ee - ff) / 2.0
    cosine, sine, root_E = math.cos(angle), math.sin(angle), math.sqrt(E)
    for k in range(3):
        du, dv = frame[0, k] + p * frame[2, k], frame[1, k] + q * frame[2, k]
        e, f = du / root_E, (E * dv - F * du) / (root_E * D)
        d1[i, k], d2[i, k] = cosine * e + sine * f, cosine * f - sine * e
        new_normals[i, k] = (frame[2, k] - p * frame[0, k] - q * frame[1, k]) / D


@kernel
def _extremality(coeffs, radius, frame, direction):
    """Derivative, along a direction, of the curvature of the normal section of h(u, v) in that direction."""
    u, v = dot(direction, position(frame, 0)), dot(direction, position(frame, 1))
    length = math.sqrt(u * u + v * v)
    if length == 0.0:
        return 0.0
    u, v = u / length, v / length
    slope = coeffs[1] * u + coeffs[2] * v
    second = 2.0 * (coeffs[3] * u * u + coeffs[4] * u * v + coeffs[5] * v * v)
    third = 6.0 * (coeffs[6] * u * u * u + coeffs[7] * u * u * v + coeffs[8] * u * v * v + coeffs[9] * v * v * v)
    stretch = math.sqrt(1.0 + slope * slope)
    return -(third / stretch**4 - 3.0 * slope * second * second / stretch**6) / radius**2


CURVATURE_SCALE_MM = 3.0  # [mm], unless the mesh is too coarse for it
LEAST_CURVATURE_SCALE_IN_EDGES = 2.5  # least curvature scale in mean edges
LEAST_FOLDING_SCALE_IN_EDGES = 1.5  # least smoothing of the folding indices in mean edges
# of the radius of the sphere of equal area, above which the curvature scale gives a note
LARGEST_SCALE_OVER_RADIUS = 0.1


def scale_of_curvature(cortex: Cortex, curvature_scale: float | None = None) -> tuple[float, str]:
    """The curvature scale [mm], by default one that fits the mesh, and a note on it or on the unit of length, or "".

    Raises
    ------
    ValueError
        If the scale does not fit the mesh.
    """
    meshes = [(surface.verts, cortex.faces) for surface in (cortex.white, cortex.pial)]
    mean_edge = max(mean_edge_length(*mesh) for mesh in meshes)
    radius = min(equal_area_radius(*mesh) for mesh in meshes)
    scale = max(_usual_curvature_scale(radius), LEAST_CURVATURE_SCALE_IN_EDGES * mean_edge)
    scale = (
        min(scale, *(largest_scale(*mesh) for mesh in meshes)) if curvature_scale is None else float(curvature_scale)
    )
    for mesh in meshes:
        check_scale(*mesh, scale)
    sizes_text = f"mean edge {mean_edge:.3g}, radius of the sphere of equal area {radius:.3g}."
    lengths_text = f"curvature is fitted within {scale:.3g}, {sizes_text}"
    if cortex.units != "mm":
        return scale, f"Lengths are in {cortex.units!r}, not in mm as the names of the measures suggest; {lengths_text}"
    is_small = CURVATURE_SCALE_MM > LARGEST_SCALE_OVER_RADIUS * radius
    if curvature_scale is None and (is_small or LEAST_CURVATURE_SCALE_IN_EDGES * mean_edge > 10 * CURVATURE_SCALE_MM):
        return scale, f"The coordinates do not look like millimetres of a human brain; {lengths_text}"
    return scale, ""


def scale_of_folding(cortex: Cortex, scale: float) -> float:
    """Scale of the folding indices [mm]: 3, or 1.5 mean edges of white if that is more; at most the curvature scale."""
    mesh = cortex.white.verts, cortex.faces
    usual_scale = _usual_curvature_scale(equal_area_radius(*mesh))
    return min(scale, max(usual_scale, LEAST_FOLDING_SCALE_IN_EDGES * mean_edge_length(*mesh)))


def _usual_curvature_scale(radius: float) -> float:
    """Curvature scale of a body with the equal-area radius ``radius``; 0 where it can only follow from the mesh."""
    return CURVATURE_SCALE_MM if CURVATURE_SCALE_MM < radius / 2 else 0.0
