"""Relief of a folded surface: height above the smoothed surface, position within the fold, and the contour midway."""

import math
from dataclasses import dataclass, field

import numpy as np

from morphofold import geometry
from morphofold.analysis.diffusion import diffusion
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, PerVertex, Surface, Verts
from morphofold.threads import run_parallel
from morphofold.validators import positive

# length of edge paths over straight distance, mean over directions in a triangle grid
EDGE_PATH_DETOUR = 2 * 3**0.5 / np.pi
# of the radius of a window, and its accuracy on meshes with shorter edges than this; others are exact
WINDOW_TOLERANCE = 0.03
# on the pial surface of a person one cotangent in eight is negative and the largest is 1200
COTANGENT_BOUNDS = (0.0, 3.0)


@dataclass(frozen=True, eq=False)
class Relief:
    """Folds of a surface relative to the smoothed surface.

    ``height`` (N,) [mm], positive outward (FreeSurfer's ``sulc`` is about its negative); ``vertical`` (N, 3), the unit
    outward direction of the smoothed surface; ``amplitude`` (N,) [mm], the largest minus the smallest height within
    ``window``; ``phase`` (N,), 0 on the crown and 1 at the fundus, NaN where the amplitude is 0; ``scale`` and
    ``window`` [mm].
    """

    height: PerVertex = field(repr=False)
    vertical: Array = field(repr=False)
    amplitude: PerVertex = field(repr=False)
    phase: PerVertex = field(repr=False)
    scale: float
    window: float


def relief(verts: Verts, faces: Faces, scale: float) -> Relief:
    """Height above the surface smoothed over ``scale``, normalised within a window of 1.5 ``scale`` along the surface.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Closed surface, or one with a natural border [mm].
    scale : float
        Smoothing length [mm]; 10 for an adult human brain.

    Notes
    -----
    With x' the result of two rounds of :func:`implicit_smoothing`, and u its vertex normals,
    ``height = (x - x') . u`` and ``phase = (highest - height) / (highest - lowest)``.
    """
    window = 1.5 * scale
    height, vertical = height_and_vertical(verts, faces, scale)
    lowest, highest = windowed_range(verts, faces, height, window)
    amplitude = highest - lowest
    phase = np.divide(highest - height, amplitude, out=np.full(len(verts), np.nan), where=amplitude > 0)
    return Relief(height, vertical, amplitude, phase, float(scale), float(window))


def height_and_vertical(verts: Verts, faces: Faces, scale: float) -> tuple[PerVertex, Array]:
    """``height`` (N,) [mm] and ``vertical`` (N, 3) of :func:`relief` alone, which need no window."""
    smooth_verts = implicit_smoothing(verts, faces, scale, rounds=2)
    vertical = geometry.vertex_normals(smooth_verts, faces)
    return np.sum((verts - smooth_verts) * vertical, axis=1), vertical


def implicit_smoothing(verts: Verts, faces: Faces, scale: float, *, rounds: int = 2, rtol: float = 1e-6) -> Verts:
    """Solve ``(M + scale^2 L) x' = M x`` ``rounds`` times: features much shorter than ``scale`` [mm] vanish.

    M are the vertex areas and L the cotangent Laplacian with cotangents clipped to [0, 3], both of the *given* surface.
    A sphere of radius r shrinks by ``1 / (1 + 2 (scale / r)^2)`` in each round. The solver starts from x, and ``rtol``
    is relative to the first residual, so the position and size of the surface do not matter. Returns (N, 3).

    Raises
    ------
    OutOfRange
        If scale is not a positive length.
    RuntimeError
        If the iteration does not converge. The mesh is then too irregular.
    """
    positive(scale, "scale")
    return diffused(verts, faces, verts, scale, rounds, rtol)


def diffused(verts: Verts, faces: Faces, values: Array, scale: float, rounds: int = 1, rtol: float = 1e-4) -> Array:
    """Three fields (N, 3) on the surface, smoothed over ``scale`` [mm] as in :func:`implicit_smoothing`."""
    solver, smoothed = diffusion(verts, faces, COTANGENT_BOUNDS), np.array(values)
    for _ in range(rounds):
        smoothed += solver.solve(scale**2, -(scale**2) * (solver.stiffness @ smoothed), np.zeros_like(smoothed), rtol)
    return smoothed


def windowed_range(verts: Verts, faces: Faces, values: PerVertex, radius: float) -> tuple[PerVertex, PerVertex]:
    """The least and the largest value within ``radius`` [mm] along the surface, (N,) each: grey erosion and dilation.

    The distance is the shortest path along edges divided by 1.10, the mean detour of such paths on equilateral
    triangles. Where edges are shorter than 3 % of the radius, the radius holds to 3 % at 98 % of the vertices. There,
    each source that reaches a vertex after another is nearer by 3 %, so the time grows as the number of vertices.
    """
    graph, reach = geometry.edge_graph(verts, faces), EDGE_PATH_DETOUR * radius
    least_gain = WINDOW_TOLERANCE * reach
    if least_gain < geometry.mean_edge_length(verts, faces):
        least_gain = 0.0

    def highest(values: PerVertex) -> PerVertex:
        descending = np.argsort(-values, kind="stable")
        maximum: PerVertex = _windowed_maximum(*reading(graph, values, descending), reach + least_gain / 2, least_gain)
        return maximum

    negated_least, largest = run_parallel(lambda: highest(-values), lambda: highest(values))
    return -negated_least, largest


@kernel
def _windowed_maximum(indptr, indices, lengths, values, descending, radius, least_gain):
    # Highest source first: the first source to reach a vertex gives its maximum. A later source does not go beyond a
    # vertex that it does not reach by a path shorter than an earlier one's, by ``gain``. It ends when all vertices are
    # reached.
    # Paths are shortened until none can be (a queue, not a heap: it saves a third of the total time).
    n = len(values)
    maximum, distance, source = np.empty(n), np.full(n, np.inf), np.full(n, -1, np.int32)
    queue, is_queued = np.empty(n, np.int32), np.zeros(n, np.bool_)
    n_missing = n
    for peak in descending:
        if distance[peak] == np.inf:
            maximum[peak] = values[peak]
            n_missing -= 1
        distance[peak], source[peak] = 0.0, peak
        queue[0] = peak
        head, n_waiting = 0, 1
        while n_waiting > 0:
            vertex = queue[head]
            head = head + 1 if head + 1 < n else 0
            n_waiting -= 1
            is_queued[vertex], vertex_distance = False, distance[vertex]
            for e in range(indptr[vertex], indptr[vertex + 1]):
                w, path = indices[e], vertex_distance + lengths[e]
                if path <= radius and path < distance[w] and (path < distance[w] - least_gain or source[w] == peak):
                    if distance[w] == np.inf:
                        maximum[w] = values[peak]
                        n_missing -= 1
                    distance[w], source[w] = path, peak
                    if not is_queued[w]:
                        is_queued[w] = True
                        queue[head + n_waiting if head + n_waiting < n else head + n_waiting - n] = w
                        n_waiting += 1
        if n_missing == 0:
            break
    return maximum


LEAST_AMPLITUDE_OVER_SCALE = 0.1  # amplitude / scale below which a surface counts as unfolded
LEAST_RELATIVE_AMPLITUDE = 0.25  # amplitude, relative to its 90th percentile, below which a ripple is not a fold
SHORTEST_WAVELENGTH_IN_EDGES = 4.0  # wavelength / mean edge, below which folds cannot be distinguished from noise
# wavelength / radius of the sphere of equal area, above which it is the body's shape, not a fold
LONGEST_WAVELENGTH_IN_RADII = 1.0


@dataclass(frozen=True, eq=False)
class Contour:
    """Samples of the mid-height contour, one per triangle it crosses.

    ``points`` (S, 3) [mm]; ``length`` (S,) [mm] of contour in the ``triangle`` (S,); ``wavelength`` [mm], twice the
    area divided by the total length; ``reason``: why this is not a contour of folds, empty if it is one.
    """

    points: Array
    length: Array
    triangle: Ints
    wavelength: float
    relief: Relief
    reason: str = ""


def mid_height_contour(surface: Surface, is_inside: Bools, scale: float | None) -> Contour:
    """The contour where ``is_inside`` (N,), at the given scale [mm], or at a third of the wavelength that it finds."""
    inside_triangles = np.flatnonzero(is_inside[surface.faces].all(axis=1))
    radius = geometry.equal_area_radius(surface.verts, surface.faces[inside_triangles])
    mean_edge = geometry.mean_edge_length(surface.verts, surface.faces)
    if scale is not None:
        return _contour_at_scale(surface, is_inside, inside_triangles, radius, mean_edge, float(scale))
    scale = 0.115 * radius  # the result for a human brain is within 5 % of it, so one step is enough
    for _ in range(8):
        contour = _contour_at_scale(surface, is_inside, inside_triangles, radius, mean_edge, scale)
        next_scale = max(min(contour.wavelength / 3, 0.3 * radius), 2 * mean_edge)
        if contour.reason or abs(next_scale - scale) < 0.05 * scale:
            break
        scale = next_scale
    return contour


def _contour_at_scale(surface: Surface, inside: Bools, region: Ints, size: float, edge: float, scale: float) -> Contour:
    folds = relief(surface.verts, surface.faces, scale)
    high_amplitude = float(np.percentile(folds.amplitude[inside], 90))
    phase = np.where(folds.amplitude > LEAST_RELATIVE_AMPLITUDE * high_amplitude, folds.phase, np.nan)
    points, length, triangle = _level_set(surface, phase, region)
    contour_length = float(length.sum())
    wavelength = 8 * math.pi * size**2 / contour_length if contour_length > 0 else math.nan
    reason = ""
    border_edges, is_used = geometry.border_edges(surface.faces), geometry.used(len(surface.verts), surface.faces)
    if len(border_edges) and len(np.unique(border_edges)) == np.count_nonzero(is_used):
        reason = "no wavelength of a band one row of triangles wide: all its vertices lie on its border"
    elif high_amplitude < LEAST_AMPLITUDE_OVER_SCALE * scale:
        reason = (
            f"no folds: at scale {scale:.3g} the height of the surface varies by {high_amplitude:.2g}, less than "
            f"{LEAST_AMPLITUDE_OVER_SCALE:g} of the scale"
        )
    elif not wavelength <= LONGEST_WAVELENGTH_IN_RADII * size:  # also if there is no contour
        reason = (
            f"no folds: at scale {scale:.3g} the mid-height contour is {contour_length:.3g} long on a surface of "
            f"radius {size:.3g}; so short a contour comes from the shape of the body"
        )
    elif wavelength < SHORTEST_WAVELENGTH_IN_EDGES * edge:
        reason = (
            f"no folds resolved: at scale {scale:.3g} their wavelength is {wavelength:.2g}, which is "
            f"{wavelength / edge:.2g} mesh edges; {SHORTEST_WAVELENGTH_IN_EDGES:g} are needed. Remove the noise "
            "by smoothing, or refine the mesh"
        )
    return Contour(points, length, triangle, wavelength, folds, reason)


def _level_set(surface: Surface, phase: PerVertex, inside_triangles: Ints) -> tuple[Array, Array, Ints]:
    """Segments of phase = 1/2 within the given triangles: midpoints (S, 3), lengths (S,), triangles (S,)."""
    phase_offset = phase[surface.faces[inside_triangles]] - 0.5
    is_above = phase_offset > 0
    is_crossed = np.isfinite(phase_offset).all(axis=1) & (is_above.any(axis=1) != is_above.all(axis=1))
    triangle, phase_offset, is_above = inside_triangles[is_crossed], phase_offset[is_crossed], is_above[is_crossed]
    lone = np.where((is_above.sum(axis=1) == 1)[:, None], is_above, ~is_above).argmax(
        axis=1
    )  # the corner that is alone on its side
    rows = np.arange(len(triangle))
    corners = surface.verts[surface.faces[triangle]]
    end_points = []
    for corner_step in (1, 2):
        other = (lone + corner_step) % 3
        a, b = phase_offset[rows, lone], phase_offset[rows, other]
        end_points.append(corners[rows, lone] + (a / (a - b))[:, None] * (corners[rows, other] - corners[rows, lone]))
    return (end_points[0] + end_points[1]) / 2, np.linalg.norm(end_points[0] - end_points[1], axis=1), triangle
