"""Directions of folds at the vertices of a surface, as axes along its sphere, where two surfaces can be compared.

From a person, the smooth body and the grown cortex come the axes of each; from axes of two, how well they agree.
``compare_person`` calls it.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from morphofold.analysis.curvatures import curvature
from morphofold.comparison.person.common_sphere import Bodies
from morphofold.comparison.person.person_agreement import Statistic
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import face_areas, unit
from morphofold.surface import Faces, Surface
from morphofold.unfolding.harmonics import SmoothSurface, tangents

FORWARD = np.array([0.0, 1.0, 0.0])  # to the front of the head, in the coordinates of FreeSurfer

dot = partial(np.einsum, "pi,pi->p")  # of vectors (P, 3) and (P, 3): (P,)

Axes = tuple[Array, Array]  # fold axes (N, 3) without sign, and how clear they are (N,)


def axes_of_bodies(bodies: Bodies) -> dict[str, Axes]:
    """Fold axes of person, grown cortex, smooth and deepened body, of measured bodies at the scale of their curvature.

    Those of the smooth bodies are at the grown vertices.
    """
    person, grown = (
        fold_axes(body.pial, body.points, body.measures.parameters.get("curvature_scale_mm"), body.cortex)
        for body in (bodies.person, bodies.grown)
    )
    points = bodies.grown.points
    smooth, deepened = smooth_axes(bodies.smooth, points), smooth_axes(bodies.deepened, points)
    return {"person": person, "grown": grown, "smooth": smooth, "deepened": deepened}


def fold_axes(surface: Surface, points: Array, scale: float | None, cortex: Bools) -> Axes:
    """Fold axes of a surface on its sphere.

    Parameters
    ----------
    surface : Surface
        N vertices [mm].
    points : (N, 3) float64
        The same vertices on the unit sphere.
    scale : float or None
        Radius of the neighbourhood of curvature [mm]; None: three mean edges.
    cortex : (N,) bool
        Elsewhere the strength is 0.

    Returns
    -------
    axes : (N, 3) float64
        Unit vectors along the sphere, without sign.
    strengths : (N,) float64
        ``(|ka| - |kb|) / (|ka| + |kb|)`` of the larger and the smaller principal curvature: 1 on a cylinder, 0 on a
        sphere or a symmetric saddle.

    Notes
    -----
    The axis is the direction of the principal curvature that is smaller in size: the curvature is small along a fold
    and large across it, be it a gyrus or a sulcus.
    """
    curvatures = curvature(surface.verts, surface.faces, scale)
    fold_directions = np.where((abs(curvatures.k1) >= abs(curvatures.k2))[:, None], curvatures.d2, curvatures.d1)
    axes = pulled_back(np.nan_to_num(fold_directions), surface.verts, surface.faces, points)
    return axes, _strength(curvatures.k1, curvatures.k2) * (cortex & axes.any(axis=1))


def smooth_axes(surface: SmoothSurface, points: Array) -> Axes:
    """As :func:`fold_axes`, of a smooth surface at points (N, 3) of the unit sphere, where they are exact."""
    frame = surface.frame(points)
    metric = frame.along @ frame.along.swapaxes(1, 2)
    form = np.einsum("pki,pmi->pkm", frame.turning, frame.along)
    inverse = np.linalg.inv(np.linalg.cholesky(metric))
    curvatures, eigenvectors = np.linalg.eigh(inverse @ (0.5 * (form + form.swapaxes(1, 2))) @ inverse.swapaxes(1, 2))
    smaller_index = abs(curvatures).argmin(axis=1)
    tangent_components = np.einsum("pkm,pk->pm", inverse, eigenvectors[np.arange(len(points)), :, smaller_index])
    return unit(np.einsum("pm,pmi->pi", tangent_components, tangents(points))), _strength(*curvatures.T)


def pulled_back(vectors: Array, verts: Array, faces: Faces, points: Array) -> Array:
    """Directions (N, 3) at the vertices of a surface, on its sphere with vertices ``points`` (N, 3): unit vectors.

    Each triangle is mapped linearly to its triangle on the sphere; a vertex has the mean of its triangles by area on
    the surface. Zero where no triangle has area.
    """
    (edge, other_edge), (first, second) = ([x[faces[:, k]] - x[faces[:, 0]] for k in (1, 2)] for x in (verts, points))
    a, b, c = dot(edge, edge), dot(edge, other_edge), dot(other_edge, other_edge)
    gram_determinant, area = a * c - b * b, face_areas(verts, faces)
    face_weights = np.divide(area, gram_determinant, out=np.zeros(len(faces)), where=gram_determinant > 0)
    summed_images = np.zeros_like(points)
    for k in range(3):
        corner_vectors = vectors[faces[:, k]]
        p, q = dot(corner_vectors, edge), dot(corner_vectors, other_edge)
        image = (c * p - b * q) * first.T + (a * q - b * p) * second.T
        summed_images += np.transpose([np.bincount(faces[:, k], terms, len(points)) for terms in face_weights * image])
    return unit(summed_images - dot(summed_images, points)[:, None] * points)


def forwardness(axes: Array, strengths: Array, surface: SmoothSurface, points: Array, weights: Array) -> float:
    """Mean of cos 2a on the smooth body, with the angle a between the fold axis and the front-back axis.

    1: folds run from front to back, -1: across, 0: no preferred direction. Weights are area times strength times the
    length of the front-back axis along the surface, which is 0 at the poles of the brain.
    """
    frame = surface.frame(points)
    axis_components = np.einsum("pmi,pi->pm", tangents(points), axes)
    fold_direction = unit(np.einsum("pm,pmi->pi", axis_components, frame.along))
    forward_tangent = FORWARD - (frame.normal @ FORWARD)[:, None] * frame.normal
    point_weights = weights * strengths * np.linalg.norm(forward_tangent, axis=1)
    cosine = dot(fold_direction, unit(forward_tangent))
    return point_weights @ (2 * cosine**2 - 1) / point_weights.sum() if point_weights.sum() > 0 else np.nan


def _strength(k1: Array, k2: Array) -> Array:
    """Difference over sum of the sizes of two curvatures; 0 where both are 0 or one is NaN."""
    small, large = np.sort(np.abs([k1, k2]), axis=0)
    return np.divide(large - small, large + small, out=np.zeros(len(k1)), where=large + small > 0)


def agreement_of_axes(body_axes: Sequence[Axes], person: Axes, weights: Array, points: Array) -> Statistic:
    """Mean of cos 2 delta, with the angle delta between the fold axes of each of K bodies and the person.

    Parameters
    ----------
    body_axes : sequence of (axes (P, 3), strengths (P,))
        Unit vectors along the sphere at the target points, without sign, and how clear they are, 0 to 1.
    person : axes (N, 3), strengths (N,)
        At the source vertices.
    weights : (P,) float64
        Area of the target points.
    points : (P, 3) float64
        Target points on the unit sphere.

    Returns
    -------
    function of (nearest, rotation) to (K,) float64
        1 where axes are the same, 0 by chance, -1 at right angles. Weights are area times both strengths.
    """
    weights = weights * np.prod([strength > 0 for _, strength in body_axes], axis=0)

    def statistic(nearest: Ints, rotation: Array) -> Array:
        person_axes = person[0][nearest] @ rotation.T
        person_axes = person_axes - dot(person_axes, points)[:, None] * points  # the nearest vertex is a little off
        sq_norms = dot(person_axes, person_axes)
        person_weights = weights * person[1][nearest]
        means = []
        for axes, strength in body_axes:
            projection = dot(person_axes, axes) ** 2
            cos_squared = np.divide(projection, sq_norms, out=np.full(len(sq_norms), 0.5), where=sq_norms > 0)
            area = person_weights * strength
            means.append((area @ (2 * cos_squared - 1)) / area.sum() if area.sum() > 0 else 0.0)
        return np.array(means)

    return statistic
