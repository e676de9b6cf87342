"""Directions of folds: the axis along a gyrus or sulcus, pulled back to the sphere."""

from __future__ import annotations

import numpy as np

from morphofold.analysis.curvatures import curvature
from morphofold.arrays import Array, Bools
from morphofold.geometry import face_areas, unit
from morphofold.surface import Faces, Surface
from morphofold.unfolding.smooth_surface import SmoothSurface, tangents

FORWARD = np.array([0.0, 1.0, 0.0])  # to the front of the head, in the coordinates of FreeSurfer


def fold_axes(surface: Surface, points: Array, scale: float, cortex: Bools) -> tuple[Array, Array]:
    """Fold axes of a surface on its sphere.

    Parameters
    ----------
    surface : Surface
        N vertices [mm].
    points : (N, 3) float64
        The same vertices on the unit sphere.
    scale : float
        Radius of the neighbourhood of curvature [mm].
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
    bent = curvature(surface.verts, surface.faces, scale)
    along = np.where((np.abs(bent.k1) >= np.abs(bent.k2))[:, None], bent.d2, bent.d1)
    known = np.isfinite(along).all(axis=1) & np.isfinite(bent.k1 + bent.k2) & cortex
    axes = pulled_back(np.where(known[:, None], along, 0.0), surface.verts, surface.faces, points)
    return axes, np.where(known & axes.any(axis=1), _strength(bent.k1, bent.k2), 0.0)


def smooth_axes(surface: SmoothSurface, points: Array) -> tuple[Array, Array]:
    """As :func:`fold_axes`, of a smooth surface at points (N, 3) of the unit sphere, where they are exact."""
    frame = surface.frame(points)
    metric = frame.along @ frame.along.swapaxes(1, 2)
    bend = np.einsum("pki,pmi->pkm", frame.turning, frame.along)
    inverse = np.linalg.inv(np.linalg.cholesky(metric))
    k, turned = np.linalg.eigh(inverse @ (0.5 * (bend + bend.swapaxes(1, 2))) @ inverse.swapaxes(1, 2))
    smaller = np.abs(k).argmin(axis=1)
    mixed = np.einsum("pkm,pk->pm", inverse, turned[np.arange(len(points)), :, smaller])
    return unit(np.einsum("pm,pmi->pi", mixed, tangents(points))), _strength(k[:, 1], k[:, 0])


def pulled_back(vectors: Array, verts: Array, faces: Faces, points: Array) -> Array:
    """Directions (N, 3) at the vertices of a surface, on its sphere with vertices ``points`` (N, 3): unit vectors.

    Each triangle is mapped linearly to its triangle on the sphere; a vertex has the mean of its triangles by area on
    the surface. Zero where no triangle has area.
    """
    ones, twos = (verts[faces[:, k]] - verts[faces[:, 0]] for k in (1, 2))
    there = [points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2)]
    a, b, c = (np.einsum("fi,fi->f", *pair) for pair in ((ones, ones), (ones, twos), (twos, twos)))
    whole, area = a * c - b * b, face_areas(verts, faces)
    weight = np.divide(area, whole, out=np.zeros(len(faces)), where=whole > 0)
    total = np.zeros_like(points)
    for k in range(3):
        v = vectors[faces[:, k]]
        p, q = np.einsum("fi,fi->f", v, ones), np.einsum("fi,fi->f", v, twos)
        image = (c * p - b * q)[:, None] * there[0] + (a * q - b * p)[:, None] * there[1]
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], weight * image[:, axis], len(points))
    return unit(total - np.einsum("ni,ni->n", total, points)[:, None] * points)


def forwardness(axes: Array, strengths: Array, surface: SmoothSurface, points: Array, weights: Array) -> float:
    """Mean of cos 2a on the smooth body, with the angle a between the fold axis and the front-back axis.

    1: folds run from front to back, -1: across, 0: no preferred direction. Weights are area times strength times the
    length of the front-back axis along the surface, which is 0 at the poles of the brain.
    """
    frame = surface.frame(points)
    mixed = np.einsum("pmi,pi->pm", tangents(points), axes)
    along = unit(np.einsum("pm,pmi->pi", mixed, frame.along))
    ahead = FORWARD - (frame.normal @ FORWARD)[:, None] * frame.normal
    weight = weights * strengths * np.linalg.norm(ahead, axis=1)
    cosine = np.einsum("pi,pi->p", along, unit(ahead))
    return float(weight @ (2 * cosine**2 - 1) / weight.sum()) if weight.sum() > 0 else float("nan")


def _strength(k1: Array, k2: Array) -> Array:
    """Difference over sum of the sizes of two curvatures; 0 where both are 0 or one is NaN."""
    large, small = np.maximum(np.abs(k1), np.abs(k2)), np.minimum(np.abs(k1), np.abs(k2))
    return np.divide(large - small, large + small, out=np.zeros(len(k1)), where=large + small > 0)
