"""Expansions of functions on the unit sphere in real spherical harmonics, with exact derivatives.

The harmonics are orthonormal, without the phase (-1)^m. Y_lm is number l^2 + l + m of its expansion. They are evaluated
in Cartesian form, Q_lm(z) times Re or Im of (x + i y)^m, which is regular at the poles.

The expansion of position is a smooth closed surface: a folded surface with a sphere, after heat has flowed on the
sphere. With the position x_v and the point s_v of the unit sphere of each vertex, x(s) = sum c_lm Y_lm(s) is smoothed
to X(s) = sum exp(-l (l + 1) w) c_lm Y_lm(s). The level w is a time of heat flow on the unit sphere. Vertex v lies at
X(s_v), so numbers are kept, and any mesh of the sphere may sample X. Normals and curvatures are exact.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numba import prange
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from morphofold.errors import WrongShape
from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel
from morphofold.threads import one_blas_thread

POINTS_AT_ONCE = 8192  # bounds the memory of the harmonics at many points
LEVELS = (0.005, 0.3)  # smallest and largest level of smoothing
DEGREE = 20  # of the expansion: at the smallest level l = 20 still has exp(-2.1) of its size


@lru_cache(maxsize=8)
def _recurrence(degree: int) -> tuple[Array, Array]:
    """Factors a, b (degree + 1, degree + 1) by l and m in Q_(l+1)m = a (z Q_lm - b Q_(l-1)m)."""
    l, m = np.arange(degree + 1)[:, None], np.minimum(np.arange(degree + 1), np.arange(degree + 1)[:, None])
    a = np.sqrt((4.0 * (l + 1) ** 2 - 1) / ((l + 1) ** 2 - m * m))
    return a, np.sqrt((l * l - m * m) / np.maximum(4.0 * l * l - 1, 1.0))


@kernel(parallel=True)
def _harmonics(points, degree, a, b, values):
    """All harmonics up to ``degree`` at the points (P, 3) of the unit sphere; out (P, (degree + 1)^2)."""
    for row in prange(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        real, imaginary, sectoral = 1.0, 0.0, 0.5 / math.sqrt(math.pi)  # of (x + i y)^m, and Q_mm
        for m in range(degree + 1):
            q_before, q = 0.0, sectoral * (1.0 if m == 0 else math.sqrt(2.0))
            for l in range(m, degree + 1):
                column = l * l + l
                values[row, column + m] = q * real
                if m > 0:
                    values[row, column - m] = q * imaginary
                q_before, q = q, a[l, m] * (z * q - b[l, m] * q_before)
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
            sectoral *= math.sqrt((2.0 * m + 3.0) / (2.0 * m + 2.0))


def harmonics(points: Array, degree: int) -> Array:
    """Values (P, (degree + 1)^2) of all harmonics up to ``degree`` at ``points`` (P, 3) of the unit sphere."""
    values = np.empty((len(points), (degree + 1) ** 2))
    _harmonics(np.ascontiguousarray(points, dtype=np.float64), degree, *_recurrence(degree), values)
    return values


def degrees(degree: int) -> Ints:
    """The l of each harmonic up to ``degree``: ((degree + 1)^2,)."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


@dataclass(frozen=True, eq=False)
class Expansion:
    """A function on the unit sphere with values of any number of components.

    Attributes
    ----------
    coefficients : ((L + 1)^2, components) float64
    """

    coefficients: Array

    @property
    def degree(self) -> int:
        return math.isqrt(len(self.coefficients)) - 1

    @one_blas_thread()
    def __call__(self, points: Array) -> Array:
        """Values (P, components) at ``points`` (P, 3) of the unit sphere."""
        blocks = np.array_split(points, 1 + len(points) // POINTS_AT_ONCE)
        return np.concatenate([harmonics(block, self.degree) @ self.coefficients for block in blocks])

    def smoothed(self, level: float) -> "Expansion":
        """After heat has flowed on the sphere for the time ``level``: Y_lm falls by exp(-l (l + 1) level)."""
        l = degrees(self.degree)
        return replace(self, coefficients=np.exp(-level * l * (l + 1))[:, None] * self.coefficients)

    def gradient(self) -> "Expansion":
        """Gradient on the sphere of the solid function: the sum of r^l times the terms of degree l.

        Along the sphere its derivatives are those of this function. Components (c, r), c slowest, are the derivatives
        of component c along axis r. The derivatives of r^l Y_lm are solid harmonics of degree l - 1.
        """
        if self.degree == 0:
            return replace(self, coefficients=np.zeros((1, 3 * self.coefficients.shape[1])))
        axis_coefficients = [derivative @ self.coefficients for derivative in _derivatives(self.degree)]
        return replace(self, coefficients=np.stack(axis_coefficients, axis=2).reshape(self.degree**2, -1))


@one_blas_thread()
def fit(points: Array, values: Array, weights: Array, degree: int, penalty: float = 0.0) -> Expansion:
    """The expansion up to ``degree`` nearest to ``values`` (P, components) at ``points`` (P, 3) of the unit sphere.

    Parameters
    ----------
    weights : (P,) float64
        Of the squared differences: the share of the sphere of each point.
    penalty : float
        Of the squared coefficients, times l (l + 1): 0 for the nearest expansion, more for a smoother one.

    Raises
    ------
    WrongShape
        If the points do not determine the coefficients.
    """
    n = (degree + 1) ** 2
    normal_matrix, right_side = np.zeros((n, n)), np.zeros((n, values.shape[1]))
    for start in range(0, len(points), POINTS_AT_ONCE):
        block = slice(start, start + POINTS_AT_ONCE)
        Y = harmonics(points[block], degree)
        weighted_harmonics = Y * weights[block, None]
        normal_matrix += Y.T @ weighted_harmonics
        right_side += weighted_harmonics.T @ values[block]
    l = degrees(degree)
    normal_matrix[np.arange(n), np.arange(n)] += penalty * l * (l + 1) * float(np.sum(weights)) / (4 * np.pi)
    try:
        return Expansion(cho_solve(cho_factor(normal_matrix), right_side))
    except np.linalg.LinAlgError:
        raise WrongShape(
            f"{len(points):,} points do not determine an expansion of degree {degree}, which has {n} coefficients; use "
            "a finer surface."
        ) from None


def _derivatives(degree: int) -> list[sparse.csr_matrix]:
    """Matrices (degree^2, (degree + 1)^2) from coefficients of a solid function to those of its x, y, z derivatives.

    With Z = Q_lm (x + i y)^m: (d_x - i d_y) Z_lm = A Z_(l-1)(m-1), (d_x + i d_y) Z_lm = -B Z_(l-1)(m+1) and
    d_z Z_lm = C Z_(l-1)m.
    """
    entries: list[list[tuple[int, int, float]]] = [[], [], []]
    root2 = math.sqrt(2.0)

    def add(axis: int, l: int, m: int, new_m: int, value: float) -> None:
        if value and abs(new_m) < l:
            entries[axis].append(((l - 1) * l + new_m, l * l + l + m, value))

    for l in range(1, degree + 1):
        scale = (2 * l + 1) / (2 * l - 1)
        for m in range(l + 1):
            A, B, C = (
                math.sqrt(scale * product)
                for product in ((l + m) * (l + m - 1), (l - m) * (l - m - 1), (l - m) * (l + m))
            )
            add(2, l, m, m, C)
            if m == 0:
                add(0, l, 0, 1, -B / root2)
                add(1, l, 0, -1, -B / root2)
                continue
            add(2, l, -m, -m, C)
            add(0, l, m, m + 1, -B / 2)
            add(0, l, -m, -m - 1, -B / 2)
            add(1, l, m, -m - 1, -B / 2)
            add(1, l, -m, m + 1, B / 2)
            factor = root2 if m == 1 else 1.0
            add(0, l, m, m - 1, factor * A / 2)
            add(1, l, -m, m - 1, factor * A / 2)
            if m > 1:
                add(0, l, -m, 1 - m, A / 2)
                add(1, l, m, 1 - m, -A / 2)
    shape = (degree**2, (degree + 1) ** 2)
    return [
        sparse.csr_matrix((list(v), (list(i), list(j))), shape) for i, j, v in (zip(*e, strict=True) for e in entries)
    ]


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

    def __call__(self, points: Array) -> Array:
        """Positions (P, 3) [mm] at ``points`` (P, 3) of the unit sphere."""
        return self.shape(points)

    @cached_property
    def _with_slopes(self) -> Expansion:
        """Position, its 9 first and its 27 second derivatives, so that harmonics are evaluated once for all of them."""
        first = self.shape.gradient()
        blocks = [expansion.coefficients for expansion in (self.shape, first, first.gradient())]
        n_rows = len(blocks[0])
        return Expansion(np.hstack([np.pad(block, ((0, n_rows - len(block)), (0, 0))) for block in blocks]))

    def frame(self, points: Array) -> Frame:
        """Position, normal, stretch of area, and principal curvatures at ``points`` (P, 3) of the unit sphere.

        Along a great circle with unit tangent t the solid function F of :meth:`Expansion.gradient` gives X' = F' t and
        X'' = t F'' t - F' s.
        """
        position, F1, F2 = np.split(self._with_slopes(points), (3, 12), axis=1)
        F1, F2 = F1.reshape(-1, 3, 3), F2.reshape(-1, 3, 3, 3)
        tangent_pairs = tangents(points)
        along = np.einsum("pcr,pkr->pkc", F1, tangent_pairs)
        normal = np.cross(along[:, 0], along[:, 1])
        stretch = np.linalg.norm(normal, axis=1)
        normal /= stretch[:, None]
        second_derivatives = np.einsum("pkq,pcqr,pmr->pkmc", tangent_pairs, F2, tangent_pairs, optimize=True)
        second_derivatives -= np.eye(2)[None, :, :, None] * np.einsum("pcr,pr->pc", F1, points)[:, None, None]
        second_form = -np.einsum("pkmc,pc->pkm", second_derivatives, normal)
        metric = along @ along.swapaxes(1, 2)
        shape_operator = second_form @ np.linalg.inv(metric)
        mean, gauss = 0.5 * np.trace(shape_operator, axis1=1, axis2=2), np.linalg.det(shape_operator)
        half_difference = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
        curvature = np.column_stack([mean - half_difference, mean + half_difference])
        return Frame(position, normal, stretch, curvature, along, shape_operator @ along)

    def scaled(self, factor: float) -> "SmoothSurface":
        """The surface with all lengths times ``factor``."""
        return SmoothSurface(Expansion(factor * self.shape.coefficients))


def tangents(points: Array) -> Array:
    """Two unit vectors (P, 2, 3) along the sphere at ``points`` (P, 3), which form a right-handed frame with them."""
    axis = np.eye(3)[np.argmin(np.abs(points), axis=1)]
    first_tangent = np.cross(axis, points)
    first_tangent /= np.linalg.norm(first_tangent, axis=1, keepdims=True)
    return np.stack([first_tangent, np.cross(points, first_tangent)], axis=1)
