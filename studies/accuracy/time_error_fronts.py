"""Which settings are worth their time, and how time and error scale with the size of a mesh."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student

from morphofold.errors import OutOfRange
from morphofold.studies.accuracy.error_points import Point

CONFIDENCE = 0.95  # confidence of intervals
LARGEST_POWER = 1000.0  # largest power of two of the time; larger ones are cut to it
FASTER_SHARE, TRUER_SHARE = 0.75, 0.95  # shares of time and error below which a setting is clearly better

#: points with the same key can be compared and are in one picture
PointKey = tuple[str, str, str, str]


def grouped(points: Iterable[Point]) -> dict[PointKey, list[Point]]:
    """Points by (half, subject, quantity, against), in the given order."""
    group_by_key: dict[PointKey, list[Point]] = defaultdict(list)
    for point in points:
        group_by_key[point.half, point.subject, point.quantity, point.against].append(point)
    return dict(group_by_key)


def better_than(points: Sequence[Point]) -> list[Point | None]:
    """For each point, the point that dominates it, or None. The other point is faster by more than the scatter of times
    (``FASTER_SHARE``) and not less accurate beyond the scatter of errors (``TRUER_SHARE``), or more accurate beyond
    that and not slower.

    Points with None form the Pareto front. Of several dominating points, the most accurate is given, then the fastest.
    """
    best_dominators: list[Point | None] = []
    for point in points:
        dominators = [
            other
            for other in points
            if (other.seconds < FASTER_SHARE * point.seconds and TRUER_SHARE * other.error <= point.error)
            or (other.seconds <= point.seconds and other.error < TRUER_SHARE * point.error)
        ]
        best_dominators.append(min(dominators, key=lambda other: (other.error, other.seconds)) if dominators else None)
    return best_dominators


@dataclass(frozen=True)
class Law:
    """A power law ``y = coefficient x^power``, fitted to logarithms.

    Attributes
    ----------
    coefficient, power : float
    uncertainty : float
        Half the width of the 95 % interval of the power (Student's t).
    scatter : float
        Standard deviation of ln y about the law.
    n_points : int
        Number of points.
    lowest_x, highest_x : float
        Range of x.
    """

    coefficient: float
    power: float
    uncertainty: float
    scatter: float
    n_points: int
    lowest_x: float
    highest_x: float

    def at(self, x: float) -> float:
        """y at an x."""
        return self.coefficient * x**self.power


def law(x: ArrayLike, y: ArrayLike) -> Law:
    """The power law through points, by least squares of logarithms.

    Parameters
    ----------
    x, y : (n,) float
        Positive; at least three points.

    Raises
    ------
    OutOfRange
        If there are fewer than three different x, or numbers that are not positive and finite.
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(np.unique(x)) < 3 or not (np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)).all():
        raise OutOfRange(
            f"a power law needs at least three points, all positive; got x = {x.tolist()}, y = {y.tolist()}."
        )
    power, intercept = np.polyfit(np.log(x), np.log(y), 1)
    residuals, x_deviations = np.log(y) - intercept - power * np.log(x), np.log(x) - np.log(x).mean()
    degrees_of_freedom = len(x) - 2
    scatter = float(np.sqrt(np.sum(residuals**2) / degrees_of_freedom))
    power_error = scatter / float(np.sqrt(np.sum(x_deviations**2)))
    uncertainty = float(student.ppf(0.5 * (1 + CONFIDENCE), degrees_of_freedom)) * power_error
    return Law(float(np.exp(intercept)), float(power), uncertainty, scatter, len(x), float(x.min()), float(x.max()))


def constant(x: ArrayLike, y: ArrayLike) -> Law:
    """The law of power 0 through points x, y (n,), positive: the geometric mean of y."""
    logarithms = np.log(np.asarray(y, dtype=np.float64))
    scatter = float(np.std(logarithms, ddof=1))
    return Law(float(np.exp(logarithms.mean())), 0.0, 0.0, scatter, len(logarithms), float(np.min(x)), float(np.max(x)))


@dataclass(frozen=True)
class Halving:
    """How many times longer half the error takes, with its 95 % interval."""

    factor: float
    low: float
    high: float


def halving(time_law: Law, error_law: Law) -> Halving | None:
    """Time scales with x to a negative power a, the error to a positive power p: half the error takes ``2^(-a/p)``
    times as long. None if the power of the error is not significantly positive.

    The interval is that of the ratio of two powers (Fieller); it is not symmetric.
    """
    a, p, da, dp = -time_law.power, error_law.power, time_law.uncertainty, error_law.uncertainty
    if not p - dp > 0:
        return None
    middle, half_width = a * p, np.sqrt((a * dp) ** 2 + da**2 * (p**2 - dp**2))
    low_power, high_power = (min((middle + sign * half_width) / (p**2 - dp**2), LARGEST_POWER) for sign in (-1, 1))
    return Halving(float(2 ** (a / p)), float(2**low_power), float(2**high_power))
