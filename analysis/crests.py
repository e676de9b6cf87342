"""Crest lines: where a principal curvature is extremal along its own direction, on gyral crowns and sulcal fundi."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.curvatures import Curvature, curvature
from morphofold.analysis.graph.curve_net import paths
from morphofold.analysis.relief import diffused
from morphofold.errors import OptionsClash
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import symmetric, vertex_normals
from morphofold.surface import Faces, PerVertex, Verts

EXTREMALITY_SMOOTHING_IN_SCALES = 0.6  # smoothing length of the extremality, in scales
LEAST_SHARPNESS = 1.0  # a crest falls away at its median by more than this times the cube of its curvature,
# or its curvature is less by this share so many scales to either side
SIDE_DISTANCE_IN_SCALES, LEAST_CURVATURE_DROP = 1.0, 0.3
LEAST_CURVATURE_DIFFERENCE = 0.15  # on a crest k2 is less than k1 by this share
SHORTEST_LINE_IN_SCALES = 1.0  # least length of a line, in scales
CREST_KINDS = ("gyral", "sulcal")


@dataclass(frozen=True, eq=False)
class CrestLine:
    """One crest line.

    Attributes
    ----------
    kind : {"gyral", "sulcal"}
    points : (P, 3) float64
        Points on edges of the surface, in order [mm]; in a closed line the first is also the last.
    length : float
        Length [mm].
    strength : float
        Integral of the absolute extremal curvature along the line, without unit (Ohtake and others 2004).
    mean_H : float
        Mean of the mean curvature along the line [1/mm], convex positive.
    """

    kind: str
    points: Array = field(repr=False)
    length: float
    strength: float
    mean_H: float


@dataclass(frozen=True, eq=False)
class CrestLines:
    """The crest lines of a surface, the strongest first, and the curvature ``scale`` [mm]."""

    lines: list[CrestLine]
    scale: float

    def __repr__(self) -> str:
        kind_texts = [f"{len(self.of_kind(kind))} {kind} lines, {self.length(kind):.0f} mm" for kind in CREST_KINDS]
        return f"CrestLines({'; '.join(kind_texts)}; scale {self.scale:.3g} mm)"

    def of_kind(self, kind: str) -> list[CrestLine]:
        return [polyline for polyline in self.lines if polyline.kind == kind]

    def length(self, kind: str) -> float:
        """Length of all lines of a kind [mm]."""
        return float(sum(line.length for line in self.of_kind(kind)))


def crest_lines(
    verts: Verts, faces: Faces, *, scale: float | None = None, curv: Curvature | None = None, weakest: float = 0.0
) -> CrestLines:
    """Gyral and sulcal crest lines of a surface.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Surface [mm], faces counter-clockwise seen from outside.
    scale : float, optional
        Curvature scale [mm]; None: the default of :func:`morphofold.analysis.curvature`.
    curv : Curvature, optional
        Curvature of the surface, if it was computed before.
    weakest : float
        Least strength of a line.

    Returns
    -------
    CrestLines

    Raises
    ------
    ValueError
        If the arrays are not a mesh, scale does not fit it (as in ``curvature``), or scale and ``curv`` are both given.

    Notes
    -----
    Gyral lines: ``e1 = 0``, ``de1/dt1 < 0``, ``k1 > |k2|``. Sulcal lines: the same on the surface turned inside out
    (Ohtake, Belyaev, Seidel 2004, ACM TOG 23). Extremality comes from the cubic terms of the fit of the curvature. The
    vector ``e1 d1`` does not depend on the sign of d1, so it is this vector that is smoothed over 0.6 ``scale``. In
    each triangle the directions at the three corners are given one sense, and the extremality is linear. A line runs
    straight between the two sides on which it is 0, if its slope along d1 is negative there.

    A sphere, a torus, a cylinder and all cyclides of Dupin have e = 0 everywhere and must have no lines. Therefore a
    line must meet one of two conditions at its median. Its curvature falls away by more than its own cube,
    ``-d2k/dt2 > k^3``; this bound has no unit and does not depend on the mesh. Or its curvature is less by 0.3 of
    itself one scale away on both sides, along a circle of that curvature, as on the round caps of thin gyri. In
    addition k2 must be less than 0.85 k1, because near an umbilic the direction is only noise. Lines shorter than
    ``scale`` are left out. On a surface with noise of 1 % of an edge use a scale of four edges.

    Crest lines end before they meet: where three gyri meet, the surface is umbilic and has no direction to follow. For
    the net see :func:`morphofold.analysis.gyral_graph`.
    """
    if curv is not None and scale is not None:
        raise OptionsClash("pass scale or curv, not both: curv has its scale.")
    if curv is None:
        curv = curvature(verts, faces, scale)
    lines, side_distance = [], SIDE_DISTANCE_IN_SCALES * curv.scale
    for kind in CREST_KINDS:
        sign = 1.0 if kind == "gyral" else -1.0
        k, k_other, direction, e = (
            (curv.k1, curv.k2, curv.d1, curv.e1) if kind == "gyral" else (-curv.k2, -curv.k1, curv.d2, -curv.e2)
        )
        rough_vectors, smoothing = np.nan_to_num(e[:, None] * direction), EXTREMALITY_SMOOTHING_IN_SCALES * curv.scale
        e_vectors = np.nan_to_num(diffused(verts, faces, rough_vectors, smoothing))
        traced_lines = _trace_lines(verts, faces, k, k_other, direction, e_vectors, sign * side_distance)
        lines += [
            CrestLine(kind, points, length, float(strength), sign * float(mean_H))
            for points, length, strength, mean_H in traced_lines
            if length >= SHORTEST_LINE_IN_SCALES * curv.scale and strength >= weakest
        ]
    return CrestLines(sorted(lines, key=lambda line: -line.strength), curv.scale)


def _trace_lines(
    verts: Verts, faces: Faces, k: PerVertex, k_other: PerVertex, direction: Array, e_vecs: Array, side_distance: float
) -> Iterator[tuple[Array, float, float, float]]:
    """Points, length, integral of k and mean of (k + k_other) / 2 of each line.

    ``side_distance`` [mm]: distance to either side of a line at which its curvature is compared; negative if k is
    convex inwards.
    """
    triangle, e_fall, is_cut = _extremality_sign_changes(verts, faces, direction, e_vecs)
    next_vertices = np.roll(faces, -1, axis=1)
    start_vertex, end_vertex = faces[triangle][is_cut].reshape(-1, 2), next_vertices[triangle][is_cut].reshape(-1, 2)
    low, high = np.minimum(start_vertex, end_vertex), np.maximum(start_vertex, end_vertex)
    e_sizes = [np.abs(np.sum(e_vecs[end] * direction[end], axis=2)) for end in (low, high)]
    fraction = e_sizes[0] / np.maximum(e_sizes[0] + e_sizes[1], 1e-300)  # the same for both triangles of an edge
    line_k, other_k = ((1 - fraction) * f[low] + fraction * f[high] for f in (k, k_other))
    is_crest = (
        (e_fall > 0)
        & (line_k > np.abs(other_k)).all(axis=1)
        & (other_k < (1 - LEAST_CURVATURE_DIFFERENCE) * line_k).all(axis=1)
    )
    _, rows, point_pairs = np.unique((low * len(verts) + high)[is_crest], return_index=True, return_inverse=True)
    low, high, fraction, line_k, other_k = (f[is_crest].ravel()[rows] for f in (low, high, fraction, line_k, other_k))
    points = verts[low] + fraction[:, None] * (verts[high] - verts[low])
    point_H, sharp = 0.5 * (line_k + other_k), e_fall[is_crest].repeat(2)[rows] / line_k**3
    nearest = np.where(fraction < 0.5, low, high)
    k_drop = _curvature_drop_beside(verts, faces, k, points, nearest, direction, line_k, side_distance)
    point_pairs = point_pairs.reshape(-1, 2)
    graph = symmetric(len(points), point_pairs, np.ones(len(point_pairs), dtype=np.int8))
    no_junctions = np.zeros(0, dtype=np.int64)  # no junctions: an edge has two triangles
    for path in paths(graph, no_junctions, np.arange(len(points))):
        line_points = points[path]
        step_mm = np.linalg.norm(np.diff(line_points, axis=0), axis=1)
        length = float(step_mm.sum())
        if length > 0 and (np.median(sharp[path]) > LEAST_SHARPNESS or np.median(k_drop[path]) > LEAST_CURVATURE_DROP):
            k_total, H_total = (0.5 * float(np.sum(step_mm * (f[path][1:] + f[path][:-1]))) for f in (line_k, point_H))
            yield line_points, length, k_total, H_total / length


def _curvature_drop_beside(
    verts: Verts,
    faces: Faces,
    k: PerVertex,
    points: Array,
    nearest: Ints,
    direction: Array,
    point_k: Array,
    side_distance: float,
) -> Array:
    """Share (P,) by which k is less on both sides of each point; the smaller of the two.

    The two places lie ``side_distance`` from the point along a circle of its own curvature, or a quarter turn away if
    that is nearer. ``nearest`` (P,) are vertices next to the points, which give direction and normal. At each place the
    nearest vertex with a known curvature counts.
    """
    normal, fitted_vertices = vertex_normals(verts, faces), np.flatnonzero(np.isfinite(k))
    tree = cKDTree(verts[fitted_vertices])
    angle = np.minimum(np.abs(side_distance) * point_k, 0.5 * np.pi)[:, None]  # no farther than down the wall
    down_step = np.sign(side_distance) * (np.cos(angle) - 1) / point_k[:, None] * normal[nearest]
    offsets = [down_step + side * np.sin(angle) / point_k[:, None] * direction[nearest] for side in (-1.0, 1.0)]
    side_curvature = np.max([k[fitted_vertices[tree.query(points + offset)[1]]] for offset in offsets], axis=0)
    return np.asarray(1 - side_curvature / point_k)


def _extremality_sign_changes(verts: Verts, faces: Faces, direction: Array, e_vecs: Array) -> tuple[Ints, Array, Bools]:
    """Triangles (T,) in which extremality changes sign, its fall (T,) [1/length^3] there along the direction, and the
    sides (T, 3), from each corner to the next, on which it changes sign: two in each triangle."""
    corner_d = direction[faces]  # (M, 3, 3), with the sense of the first
    corner_d = np.where(np.sum(corner_d * corner_d[:, :1], axis=2) < 0, -1.0, 1.0)[:, :, None] * corner_d
    e = np.sum(e_vecs[faces] * corner_d, axis=2)
    is_cut = (e < 0) != (np.roll(e, -1, axis=1) < 0)
    triangle = np.flatnonzero(is_cut.any(axis=1))
    corners, e, mean_direction = verts[faces[triangle]], e[triangle], corner_d[triangle].sum(axis=1)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(u, v)
    gradient = np.cross(normal, (e[:, 2] - e[:, 0])[:, None] * u - (e[:, 1] - e[:, 0])[:, None] * v)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_direction /= np.linalg.norm(mean_direction, axis=1, keepdims=True)
        e_fall = -np.sum(gradient * mean_direction, axis=1) / np.sum(normal**2, axis=1)
    return triangle, e_fall, is_cut[triangle]
