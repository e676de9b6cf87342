"""Growth maps made from the heights of folds: more growth where a gyrus is to be.

In go heights of folds on the sphere, out come values of ``effects.growth_map`` at the vertices. The lowest degrees are
left out, since they are the shape of the body, and the smoothing that the solver applies to a map is undone.
"""

import math
from dataclasses import dataclass

import numpy as np

from morphofold.analysis.relief import height_and_vertical
from morphofold.comparison.person.common_sphere import RELIEF_SCALE_MM
from morphofold.comparison.person.fold_heights import FOLD_DEGREES, MOST_FITTED_VERTICES, band, fold_heights
from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.hemisphere.subject_maps import HARMONIC_PENALTY, Subject, smooth_map
from morphofold.surface import Surface
from morphofold.unfolding.harmonics import Expansion, degrees

MAP_DEGREE_OVER_FOLDS = 1.4  # largest degree of a map, over that of the folds
WAVES_PER_DEGREE = 5.7  # wavelength of a soft cortex over its thickness, as folds of such bodies have it
CLIPPED = (0.1, 3.0)  # factors on the growth
CORRECTIONS = 6  # of the spread and the mean, after clipping and smoothing
LEAST_APPLIED = 0.95  # of the spread that is asked for


@dataclass(frozen=True, eq=False)
class Target:
    """The folds that a body is to have.

    Attributes
    ----------
    points : (N, 3) float64
        Vertices on the unit sphere.
    weights : (N,) float64
        Area of the smooth body around each, 0 off the cortex.
    heights : Expansion
        Heights of folds [mm], in degrees up to 30.
    """

    points: Array
    weights: Array
    heights: Expansion

    @property
    def fold_degree(self) -> float:
        """Root mean square degree of the folds, by power in degrees from 7."""
        l, power = degrees(self.heights.degree), band(self.heights).coefficients[:, 0] ** 2
        return math.sqrt(np.average(l**2, weights=power))

    @property
    def map_degree(self) -> int:
        """Largest degree of a map for these folds."""
        return min(round(MAP_DEGREE_OVER_FOLDS * self.fold_degree), FOLD_DEGREES[1])

    def thickness(self, radius: float) -> float:
        """Cortical thickness [mm] with which a body of this radius has waves as long as these folds."""
        return 2 * math.pi * radius / (WAVES_PER_DEGREE * self.fold_degree)

    def map_values(self, spread: float, turn: Array | None = None) -> tuple[Array, Array]:
        """Values of a map (N,), more where a fold is high, and those that the solver applies (N,), 1 in the mean.

        Parameters
        ----------
        spread : float
            Standard deviation of the map as the solver applies it, over the cortex; negative: less where a fold is
            high.
        turn : (3, 3) float64, optional
            Turns the folds away from where they are: a control.

        Raises
        ------
        OutOfRange
            If factors from 0.1 to 3 do not allow the spread.
        """
        rows = slice(None, None, -(-len(self.points) // MOST_FITTED_VERTICES))
        degree, points = self.map_degree, self.points if turn is None else self.points @ turn
        l = degrees(degree)
        folds = band(self.heights, high=degree).coefficients[: len(l), 0]
        wave = Expansion((folds * (1 + HARMONIC_PENALTY * l * (l + 1)))[:, None])(points)[:, 0]
        mean, deviation = weighted_mean_and_sd(wave, self.weights)
        wave, factor, level, applied = (wave - mean) / deviation, 1.0, 1.0, 0.0
        for _ in range(CORRECTIONS):
            values = np.where(self.weights > 0, np.clip(1 + factor * spread * wave, *CLIPPED) / level, 1.0)
            fitted = smooth_map(values[rows], (self.points[rows], self.weights[rows]), degree, "growth map")
            mean, applied = weighted_mean_and_sd(fitted(self.points[rows]), self.weights[rows])
            level, factor = level * mean, factor * abs(spread) * mean / applied
        if applied < LEAST_APPLIED * abs(spread):
            raise OutOfRange(
                f"growth by a map of these folds can have a standard deviation of {applied:.2f} at most, where "
                f"{abs(spread):.2f} is needed: factors must lie between {CLIPPED[0]} and {CLIPPED[1]}. Ask for less."
            )
        return values, np.where(self.weights > 0, fitted(self.points), 1.0)


def weighted_mean_and_sd(values: Array, weights: Array) -> tuple[float, float]:
    """Mean and standard deviation of values (N,) by weights (N,)."""
    mean = float(np.average(values, weights=weights))
    return mean, math.sqrt(np.average((values - mean) ** 2, weights=weights))


def target_of(subject: Subject, pial: Surface) -> Target:
    """The folds of a person's pial surface, which has the vertices of the subject."""
    points, weights = subject.vertices()
    heights = height_and_vertical(pial.verts, pial.faces, RELIEF_SCALE_MM)[0]
    return Target(points, weights, fold_heights(points, heights, weights))
