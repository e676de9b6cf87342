"""Smooth closed surfaces: a folded surface with a sphere, after heat has flowed on the sphere.

With the position x_v and the point s_v of the unit sphere of each vertex, the surface is expanded in spherical
harmonics, x(s) = sum c_lm Y_lm(s), and smoothed: X(s) = sum exp(-l (l + 1) w) c_lm Y_lm(s). The level w is a time of
heat flow on the unit sphere. Vertex v lies at X(s_v), so numbers are kept, and any mesh of the sphere may sample X.
Normals and curvatures are exact.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from morphofold.arrays import Array
from morphofold.unfolding.harmonics import Expansion

LEVELS = (0.005, 0.3)  # smallest and largest level of smoothing
DEGREE = 20  # of the expansion: at the smallest level l = 20 still has exp(-2.1) of its size


class Frame(NamedTuple):
    """The surface at P points.

    Attributes
    ----------
    position, normal : (P, 3) float64
        [mm]; unit normal outwards.
    stretch : (P,) float64
        Area over that on the unit sphere [mm^2].
    curvature : (P, 2) float64
        Principal curvatures [1/mm], the smaller first; positive where the surface is convex.
    along, turning : (P, 2, 3) float64
        Derivatives of position [mm] and normal along the two :func:`tangents` of the sphere.
    """

    position: Array
    normal: Array
    stretch: Array
    curvature: Array
    along: Array
    turning: Array


@dataclass(frozen=True, eq=False)
class SmoothSurface:
    """A smooth surface over the unit sphere.

    Attributes
    ----------
    shape : Expansion
        Position [mm], 3 components.
    """

    shape: Expansion

    def __call__(self, s: Array) -> Array:
        """Positions (P, 3) [mm] at points ``s`` (P, 3) of the unit sphere."""
        return self.shape(s)

    @cached_property
    def _with_slopes(self) -> Expansion:
        """Position, its 9 first and its 27 second derivatives, so that harmonics are evaluated once for all of them."""
        first = self.shape.gradient()
        parts = [expansion.coefficients for expansion in (self.shape, first, first.gradient())]
        rows = len(parts[0])
        return Expansion(np.hstack([np.pad(part, ((0, rows - len(part)), (0, 0))) for part in parts]))

    def frame(self, s: Array) -> Frame:
        """Position, normal, stretch of area, and principal curvatures at points ``s`` (P, 3) of the unit sphere.

        Along a great circle with unit tangent t the solid function F of :meth:`Expansion.gradient` gives X' = F' t and
        X'' = t F'' t - F' s.
        """
        position, F1, F2 = np.split(self._with_slopes(s), (3, 12), axis=1)
        F1, F2 = F1.reshape(-1, 3, 3), F2.reshape(-1, 3, 3, 3)
        t = tangents(s)
        along = np.einsum("pcr,pkr->pkc", F1, t)
        normal = np.cross(along[:, 0], along[:, 1])
        stretch = np.linalg.norm(normal, axis=1)
        normal /= stretch[:, None]
        second = np.einsum("pkq,pcqr,pmr->pkmc", t, F2, t, optimize=True)
        second -= np.eye(2)[None, :, :, None] * np.einsum("pcr,pr->pc", F1, s)[:, None, None]
        bend = -np.einsum("pkmc,pc->pkm", second, normal)
        metric = along @ along.swapaxes(1, 2)
        turn = bend @ np.linalg.inv(metric)
        mean, gauss = 0.5 * np.trace(turn, axis1=1, axis2=2), np.linalg.det(turn)
        half = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
        curvature = np.column_stack([mean - half, mean + half])
        return Frame(position, normal, stretch, curvature, along, turn @ along)

    def scaled(self, factor: float) -> "SmoothSurface":
        """The surface with all lengths times ``factor``."""
        return SmoothSurface(Expansion(factor * self.shape.coefficients))


def tangents(s: Array) -> Array:
    """Two unit vectors (P, 2, 3) along the sphere at points ``s`` (P, 3), which form a right-handed frame with s."""
    axis = np.eye(3)[np.argmin(np.abs(s), axis=1)]
    first = np.cross(axis, s)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(s, first)], axis=1)
