"""Folding indices, integrals of curvature almost independent of the mesh, and the scaling law of folded cortices."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from morphofold import geometry
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.frozen_arrays import Array, Ints
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.validators import check_mesh, positive

if TYPE_CHECKING:
    from morphofold.analysis.measures_result import Measures

SAME_PLACE_IN_EDGES = 0.02  # mean edges: vertices joined by a shorter edge count as one place, and share their measures
HEAT_FLOW_TOLERANCE = 1e-8  # of the heat flow: it is small because the root of H^2 - K counts, which is 0 on a sphere


@dataclass(frozen=True)
class FoldingIndices:
    """Dimensionless integrals of curvature over a surface, each divided by 4 pi.

    ``folding_index`` is ``int |k1| (|k1| - |k2|) dA / 4 pi`` with ``|k1| >= |k2|`` (0 on a sphere);
    ``intrinsic_curvature_index`` the integral of the positive part of K (1 on a sphere, or any convex surface);
    ``negative_curvature_index`` that of its negative part (<= 0); ``total`` their sum, half the Euler characteristic
    of a closed surface (Gauss-Bonnet).
    """

    folding_index: float
    intrinsic_curvature_index: float
    negative_curvature_index: float
    total: float


def folding_indices(verts: Verts, faces: Faces, scale: float) -> FoldingIndices:
    """Folding and intrinsic curvature index of a surface whose curvatures are smoothed over ``scale``.

    Parameters
    ----------
    verts, faces : (N, 3) float64, (M, 3) int64
        Vertices [mm] and triangles. Borders (where K is left out), several pieces and unused vertices are allowed.
    scale : float
        Standard deviation [mm] of the heat kernel; at least a mean edge of the mesh.

    Returns
    -------
    FoldingIndices
        Indices at that scale. Much narrower folds do not count. Indices at two scales cannot be compared.

    Raises
    ------
    ValueError
        If the arrays do not describe a triangle mesh, or scale is not a positive length.

    Notes
    -----
    The smoothed quantities are measures (integrals at each vertex), whose sum does not change with smoothing or with
    the mesh. For K this is the angle defect of each vertex, 2 pi less the angles of its triangles; for H it is half the
    gradient of the area along the normal. Both are well defined on needles, caps and edges of zero length. They are
    smoothed by heat flow along the surface. Then ``|k1| = |H| + (H^2 - K)^1/2`` and ``|k2| = ||H| - (H^2 - K)^1/2|``.

    The integrals are those of FreeSurfer's ``mris_curvature_stats``, but the curvatures are not. A quadric fitted over
    one or two rings violates Gauss-Bonnet and depends on the mesh (a cubic fitted within 3 mm gives 17 times the value
    that Gauss-Bonnet requires on S1). On the white surface of S1 with 153,000 vertices, and thinned to 80,000 and
    40,000, the intrinsic curvature index at 3 mm is 27.1, 27.4 and 27.7, the folding index is 289, 282 and 270, and the
    total is 1.00. A fit within 4.5 mm gives 66, 73 and 83, and totals of 13 to 19.

    On a sphere of radius R the smoothing reduces a ripple of degree l by ``exp(-l (l + 1) scale^2 / 2 R^2)``.
    """
    check_mesh(verts, faces)
    positive(scale, "scale", "length in the unit of the mesh")
    operators = SurfaceOperators(verts, faces)
    short_edges = operators.edges[operators.lengths < SAME_PLACE_IN_EDGES * operators.mean_edge]
    place = geometry.connected(len(verts), short_edges)  # vertices of one place
    normals = geometry.unit(_sums_by_place(operators.normals, place)[place])
    H_integrals = 0.5 * np.sum(area_gradients(verts, faces) * normals, axis=1)
    weight = 1 / np.bincount(place)
    sums = _sums_by_place(np.column_stack([angle_defects(verts, faces), H_integrals]), place)
    K, H = operators.spread((sums * weight[:, None])[place], scale, np.zeros((len(verts), 2)), HEAT_FLOW_TOLERANCE).T
    H = np.abs(H)
    half_difference = np.sqrt(np.maximum(H**2 - K, 0))
    weight = geometry.vertex_areas(verts, faces) / (4 * np.pi)
    convex_integral, saddle_integral = float(np.maximum(K, 0) @ weight), float(np.minimum(K, 0) @ weight)
    folding_integral = float(((H + half_difference) * (H + half_difference - np.abs(H - half_difference))) @ weight)
    return FoldingIndices(folding_integral, convex_integral, saddle_integral, convex_integral + saddle_integral)


def angle_defects(verts: Verts, faces: Faces) -> PerVertex:
    """2 pi less the angles at each vertex (N,) [rad], the integral of K there; 0 on a border and without a face."""
    doubled_vectors, dot_products, edge_squares = geometry.triangles(verts, faces)
    angle = np.arctan2(geometry.norms(doubled_vectors)[:, None], dot_products)
    is_defined = (edge_squares > 0) & (edge_squares[:, [2, 0, 1]] > 0)
    remaining_angle = (np.pi - angle.sum(axis=1)) / np.maximum(
        3 - is_defined.sum(axis=1), 1
    )  # at an edge of zero length: the remaining angle
    angle = np.where(is_defined, angle, remaining_angle[:, None])
    defect = 2 * np.pi - np.bincount(faces.ravel(), angle.ravel(), len(verts))
    is_inner = geometry.used(len(verts), faces)
    is_inner[geometry.border_edges(faces)] = False
    return np.where(is_inner, defect, 0.0)


def area_gradients(verts: Verts, faces: Faces) -> Verts:
    """Gradient (N, 3) [mm] of the area of the surface with respect to the position of each vertex.

    It is half the cross product of the normal of each triangle and its edge opposite the vertex. This equals the
    cotangent Laplacian of the positions, but stays bounded in triangles of almost zero area.
    """
    corner_positions = verts[faces]
    normal = geometry.face_normals(verts, faces)
    gradient = np.zeros((len(verts), 3))
    for k in range(3):
        corner_gradient = 0.5 * np.cross(normal, corner_positions[:, k - 1] - corner_positions[:, k - 2])
        for axis in range(3):
            gradient[:, axis] += np.bincount(faces[:, k], corner_gradient[:, axis], len(verts))
    return gradient


def _sums_by_place(values: Array, vertex_group: Ints) -> Array:
    """Sums of values (N, K) over the vertices of each place."""
    return np.stack([np.bincount(vertex_group, column) for column in values.T], axis=-1)


@dataclass(frozen=True)
class ShapeTerms:
    """Size and folding of one closed cortex.

    Attributes
    ----------
    total, exposed : float
        Area of the pial surface and of its convex hull [mm^2].
    thickness : float
        Mean cortical thickness [mm].
    k : float
        ``total thickness^(1/2) / exposed^(5/4)``, without unit.
    log_k, size, shape : float
        Decimal logarithms of ``k``, of ``total exposed thickness^2``, and of the remaining term
        ``total^(3/2) exposed^(3/4) / thickness^(9/2)``. The source calls them K, I and S. K and S do not change with
        size.
    """

    total: float
    exposed: float
    thickness: float
    k: float
    log_k: float
    size: float
    shape: float


def shape_terms(total: float, exposed: float, thickness: float) -> ShapeTerms:
    """The shape terms of a cortex with these areas [mm^2] and thickness [mm].

    Raises
    ------
    OutOfRange
        If one of them is not a positive number.

    Notes
    -----
    The law ``A_total sqrt(T) = k A_exposed^(5/4)`` is that of Mota and Herculano-Houzel 2015 (Science 349, 74). In the
    space of ``log A_total``, ``log A_exposed`` and ``log T^2`` it is a plane with the normal (1, -5/4, 1/4), which
    gives ``log_k``. The direction (1, 1, 1) is growth without change of shape and gives ``size``. The direction at
    right angles to both gives ``shape`` (Wang and others 2021, NeuroImage 226, 117546).
    """
    for name, value in (("total", total), ("exposed", exposed), ("thickness", thickness)):
        positive(value, name, "number")
    a, e, t = math.log10(total), math.log10(exposed), 2 * math.log10(thickness)
    log_k = a - 5 / 4 * e + t / 4
    return ShapeTerms(total, exposed, thickness, 10**log_k, log_k, a + e + t, 3 / 2 * a + 3 / 4 * e - 9 / 4 * t)


def shape_terms_of(measures: Measures) -> ShapeTerms | None:
    """The shape terms of a measured cortex; None if it lacks one of the three numbers (not closed, or no thickness).

    Areas are of the whole closed surfaces, including the medial wall; the exposed area is that of the convex hull. The
    thickness is the mean over the vertices of the cortex.
    """
    area, gyrification, thickness = (
        measures.scalars.get(key) for key in ("area_pial_mm2", "gyrification_index", "mean_cortical_thickness_mm")
    )
    return shape_terms(area, area / gyrification, thickness) if area and gyrification and thickness else None
