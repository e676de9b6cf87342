"""Waves on a sphere: how much of a function's variance each degree of spherical harmonics holds, and their wavelength.

The height of a folded surface is taken over the sphere that it grew from, or was inflated to, so that walls that
overhang or touch don't matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from morphofold import geometry
from morphofold.errors import DoesNotApply, NotFinite, OutOfRange, WrongShape
from morphofold.surface import Faces, PerVertex, Verts, check_mesh

EDGES = 4  # mesh edges that the shortest wave has at least
MOST = 1000  # degree; the recurrence loses no digit up to there


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Variance of a function on a sphere by degree of the harmonic.

    Attributes
    ----------
    power : (L + 1,) float64
        Mean square over the sphere of the part of each degree, in the square of the function's unit. The mean of the
        function is left out, so degree 0 holds nothing but rounding.
    rms : float
        Root mean square of the function about its mean, degrees beyond L too.
    radius : float
        Of the sphere.
    """

    power: NDArray[np.float64] = field(repr=False)
    rms: float
    radius: float

    @property
    def share(self) -> float:
        """How much of ``rms ** 2`` the degrees to L hold; well below 1 if there are finer waves than that. NaN for a
        constant."""
        return float(self.power[1:].sum()) / self.rms**2 if self.rms > 0 else math.nan

    @property
    def degree(self) -> float:
        """Mean of the degrees from 1 on, weighted by power; NaN for a constant."""
        total = float(self.power[1:].sum())
        return float(np.arange(len(self.power)) @ self.power) / total if total > 0 else math.nan

    @property
    def wavelength(self) -> float:
        """2 pi radius / sqrt(l (l + 1)), l the mean ``degree``, in the unit of the radius; NaN for a constant."""
        return 2 * math.pi * self.radius / math.sqrt(self.degree * (self.degree + 1))


def power_spectrum(sphere: Verts, faces: Faces, values: PerVertex, last: int | None = None) -> Spectrum:
    """Power of each degree of spherical harmonics in a function given at the vertices of a sphere.

    Parameters
    ----------
    sphere : (N, 3) float64
        A closed surface around the origin that every ray from there meets once: the surface that a simulated sphere
        had before it grew, or FreeSurfer's ``?h.sphere``. The function belongs to the directions of its vertices.
    faces : (M, 3) int64
        Triangles, counter-clockwise seen from outside.
    values : (N,) float64
        The function, such as the distance of the folded surface from the centre [mm].
    last : int, optional
        Largest degree L. None: the one whose waves have four mean edges.

    Returns
    -------
    Spectrum

    Raises
    ------
    ValueError
        If the arrays describe no such surface, values aren't finite, or ``last`` isn't within 1 to 1000.

    Notes
    -----
    With harmonics Y_lm normalised to ``int |Y_lm|^2 = 1`` on the unit sphere::

        power_l = sum_m |a_lm|^2 / (4 pi),    a_lm = sum_i w_i h_i conj(Y_lm)(direction_i)

    where h is the function less its mean and w_i a third of the solid angles of the triangles around vertex i, a
    quadrature of second order in the edges. The sum over the orders m makes it independent of how the sphere is
    turned. The associated Legendre functions come from the recurrence in l of Press et al., Numerical Recipes,
    3rd ed., sec. 6.7.
    """
    check_mesh(sphere, faces)
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (len(sphere),) or not np.isfinite(values).all():
        raise (NotFinite if values.shape == (len(sphere),) else WrongShape)(
            f"values must be {len(sphere)} finite numbers, one per vertex; got shape {values.shape}."
        )
    direction = geometry.unit(sphere)
    weight = _vertex_angles(direction, faces)
    radius = float(weight @ np.linalg.norm(sphere, axis=1)) / (4 * math.pi)
    if last is None:
        last = int(min(max(2 * math.pi / (EDGES * geometry.mean_edge_length(direction, faces)), 1), MOST))
    if not 1 <= last <= MOST:
        raise OutOfRange(f"last must be a degree from 1 to {MOST}, got {last}.")
    height = values - weight @ values / (4 * math.pi)
    if np.abs(height).max() <= 1e-13 * np.abs(values).max():  # rounding, of a constant
        return Spectrum(np.zeros(last + 1), 0.0, radius)
    power = _project(direction, weight * height, last) / (4 * math.pi)
    return Spectrum(power, float(np.sqrt(weight @ height**2 / (4 * math.pi))), radius)


def _vertex_angles(direction: Verts, faces: Faces) -> PerVertex:
    """A third of the solid angles of the triangles around each vertex (N,), seen from the origin; they sum to 4 pi.

    Van Oosterom and Strackee 1983, IEEE Trans. Biomed. Eng. 30, 125, Eq. (8).
    """
    a, b, c = (direction[faces[:, k]] for k in range(3))
    volume = np.sum(a * np.cross(b, c), axis=1)
    cosines = 1 + np.sum(a * b, axis=1) + np.sum(b * c, axis=1) + np.sum(c * a, axis=1)
    angle = 2 * np.arctan2(volume, cosines)
    if not (angle > 0).all() or not math.isclose(angle.sum(), 4 * math.pi, rel_tol=1e-6):
        raise DoesNotApply(
            f"not a sphere around the origin: {np.count_nonzero(angle <= 0)} of {len(faces)} faces turn their back to "
            f"it, and all together cover {angle.sum() / (4 * math.pi):.3g} of the directions. Pass the surface before "
            "it folded, centred, or one inflated to a sphere."
        )
    return np.bincount(faces.ravel(), np.repeat(angle / 3, 3), len(direction)).astype(np.float64)


@njit(cache=True)
def _project(direction, f, last):
    """sum_m |sum_i f_i Y_lm(direction_i)|^2 for l = 0 to last (last + 1,); f (N,) carries the weights."""
    n = len(f)
    power = np.zeros(last + 1)
    sine = np.sqrt(direction[:, 0] ** 2 + direction[:, 1] ** 2)
    sectoral = np.full(n, np.sqrt(1 / (4 * np.pi)))  # P_mm, normalised
    real, imag = f.copy(), np.zeros(n)  # f exp(-i m phi)
    below, here = np.empty(n), np.empty(n)
    for m in range(last + 1):
        for i in range(n):
            below[i], here[i] = 0.0, sectoral[i]
        for l in range(m, last + 1):
            a, b = 0.0, 0.0
            for i in range(n):
                a += real[i] * here[i]
                b += imag[i] * here[i]
            power[l] += (a * a + b * b) * (1 if m == 0 else 2)
            up = np.sqrt((4.0 * (l + 1) ** 2 - 1) / ((l + 1.0) ** 2 - m * m))
            down = np.sqrt((float(l) * l - m * m) / (4.0 * l * l - 1)) if l > m else 0.0
            for i in range(n):
                below[i], here[i] = here[i], up * (direction[i, 2] * here[i] - down * below[i])
        grow = np.sqrt((2 * m + 3) / (2 * m + 2))
        for i in range(n):
            sectoral[i] *= grow * sine[i]
            if sine[i] > 0:  # at a pole only m = 0 is not zero
                c, s = direction[i, 0] / sine[i], direction[i, 1] / sine[i]
                real[i], imag[i] = real[i] * c + imag[i] * s, imag[i] * c - real[i] * s
    return power
