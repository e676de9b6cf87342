"""Power spectrum on a sphere: variance of a function in each degree of spherical harmonics, and the mean wavelength.

The height of a folded surface is taken over the sphere from which it grew, or to which it was inflated. Walls that
overhang or touch are therefore no problem.
"""

import math
from dataclasses import dataclass

import numpy as np

from morphofold import geometry
from morphofold.errors import DoesNotApply, NotFinite, OutOfRange, WrongShape
from morphofold.frozen_arrays import Array
from morphofold.surface import Faces, PerVertex, Verts
from morphofold.unfolding.harmonics import degrees, harmonics
from morphofold.validators import check_mesh

SHORTEST_WAVE_IN_EDGES = 4  # least length of the shortest wave in mesh edges
LARGEST_DEGREE = 1000  # largest degree; up to there the recurrence loses no digit
VALUES_AT_ONCE = 20_000_000  # of harmonics at vertices: bounds the memory


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Variance of a function on a sphere by degree of the harmonic.

    Attributes
    ----------
    power : (L + 1,) float64
        Mean square over the sphere of the part of each degree, in the square of the unit of the function. The mean of
        the function is removed, so degree 0 holds only rounding errors.
    rms : float
        Root mean square of the function about its mean, including degrees beyond L.
    radius : float
        Radius of the sphere.
    """

    power: Array
    rms: float
    radius: float

    def __repr__(self) -> str:
        return f"Spectrum(degrees 0 to {len(self.power) - 1}, rms {self.rms:.3g} mm, radius {self.radius:.3g} mm)"

    @property
    def share(self) -> float:
        """Share of ``rms ** 2`` in the degrees up to L; well below 1 if there are finer waves. NaN for a constant."""
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
    """Power of a function in each degree of spherical harmonics, for values at the vertices of a sphere.

    Parameters
    ----------
    sphere : (N, 3) float64
        A closed surface around the origin that every ray from there meets once: the surface of a simulated sphere
        before growth, or FreeSurfer's ``?h.sphere``. The function is given at the directions of its vertices.
    faces : (M, 3) int64
        Triangles, counter-clockwise seen from outside.
    values : (N,) float64
        The function, such as the distance of the folded surface from the centre [mm].
    last : int, optional
        Largest degree L. None: the degree whose waves are four mean edges long.

    Returns
    -------
    Spectrum

    Raises
    ------
    ValueError
        If the arrays do not describe such a surface, values are not finite, or ``last`` is not within 1 to 1000.

    Notes
    -----
    With harmonics Y_lm normalised to ``int |Y_lm|^2 = 1`` on the unit sphere::

        power_l = sum_m |a_lm|^2 / (4 pi),    a_lm = sum_i w_i h_i conj(Y_lm)(direction_i)

    where h is the function less its mean and w_i a third of the solid angles of the triangles around vertex i. This
    quadrature is of second order in the edges. The sum over the orders m makes the power independent of the rotation
    of the sphere.
    """
    check_mesh(sphere, faces)
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (len(sphere),) or not np.isfinite(values).all():
        raise (NotFinite if values.shape == (len(sphere),) else WrongShape)(
            f"values must be {len(sphere)} finite numbers, one per vertex; got shape {values.shape}."
        )
    direction = geometry.unit(sphere)
    weight = _vertex_solid_angles(direction, faces)
    radius = float(weight @ np.linalg.norm(sphere, axis=1)) / (4 * math.pi)
    if last is None:
        shortest_wave = SHORTEST_WAVE_IN_EDGES * geometry.mean_edge_length(direction, faces)
        last = int(np.clip(2 * math.pi / shortest_wave, 1, LARGEST_DEGREE))
    if not 1 <= last <= LARGEST_DEGREE:
        raise OutOfRange(f"last must be a degree from 1 to {LARGEST_DEGREE}, got {last}.")
    deviation = values - weight @ values / (4 * math.pi)
    if np.abs(deviation).max() <= 1e-13 * np.abs(values).max():  # rounding errors of a constant
        return Spectrum(np.zeros(last + 1), 0.0, radius)
    vertex_blocks = np.array_split(np.arange(len(deviation)), 1 + len(deviation) * (last + 1) ** 2 // VALUES_AT_ONCE)
    coefficients = sum((weight * deviation)[block] @ harmonics(direction[block], last) for block in vertex_blocks)
    power = np.bincount(degrees(last), coefficients**2) / (4 * math.pi)
    return Spectrum(power, float(np.sqrt(weight @ deviation**2 / (4 * math.pi))), radius)


def _vertex_solid_angles(direction: Verts, faces: Faces) -> PerVertex:
    """A third of the solid angles of the triangles around each vertex (N,), seen from the origin. The sum is 4 pi.

    Van Oosterom and Strackee 1983, IEEE Trans. Biomed. Eng. 30, 125, Eq. (8).
    """
    a, b, c = (direction[faces[:, k]] for k in range(3))
    volume = np.sum(a * np.cross(b, c), axis=1)
    cosines = 1 + np.sum(a * b, axis=1) + np.sum(b * c, axis=1) + np.sum(c * a, axis=1)
    angle = 2 * np.arctan2(volume, cosines)
    if not (angle > 0).all() or not math.isclose(angle.sum(), 4 * math.pi, rel_tol=1e-6):
        raise DoesNotApply(
            f"not a sphere around the origin: {np.count_nonzero(angle <= 0)} of {len(faces)} faces do not face outward "
            f"from it, and all faces together cover {angle.sum() / (4 * math.pi):.3g} of the directions. Pass the "
            "surface before it folded, centred at the origin, or a surface inflated to a sphere."
        )
    return np.bincount(faces.ravel(), np.repeat(angle / 3, 3), len(direction)).astype(np.float64)
