"""Which settings are worth their time, and how time and error scale with the size of a mesh."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student

from morphofold.errors import OutOfRange
from morphofold.studies.accuracy.error_points import Point

LIKELY = 0.95  # confidence of intervals
ENDLESS = 1000.0  # largest power of two of the time; larger ones are cut to it
FASTER, TRUER = 0.75, 0.95  # shares of time and error below which a setting is clearly better

#: points with the same key can be compared and are in one picture
Key = tuple[str, str, str, str]


def grouped(points: Iterable[Point]) -> dict[Key, list[Point]]:
    """Points by (half, subject, quantity, against), in the given order."""
    groups: dict[Key, list[Point]] = defaultdict(list)
    for p in points:
        groups[p.half, p.subject, p.quantity, p.against].append(p)
    return dict(groups)


def better_than(points: Sequence[Point]) -> list[Point | None]:
    """For each point, the point that dominates it, or None. The other point is faster by more than the scatter of times
    (``FASTER``) and not less accurate beyond the scatter of errors (``TRUER``), or more accurate beyond that and not
    slower.

    Points with None form the Pareto front. Of several dominating points, the most accurate is given, then the fastest.
    """
    dominating: list[Point | None] = []
    for p in points:
        dominators = [
            q
            for q in points
            if (q.seconds < FASTER * p.seconds and TRUER * q.error <= p.error)
            or (q.seconds <= p.seconds and q.error < TRUER * p.error)
        ]
        dominating.append(min(dominators, key=lambda q: (q.error, q.seconds)) if dominators else None)
    return dominating


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
    n : int
        Number of points.
    low, high : float
        Range of x.
    """

    coefficient: float
    power: float
    uncertainty: float
    scatter: float
    n: int
    low: float
    high: float

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
    residuals, deviations = np.log(y) - intercept - power * np.log(x), np.log(x) - np.log(x).mean()
    degrees_of_freedom = len(x) - 2
    scatter = float(np.sqrt(np.sum(residuals**2) / degrees_of_freedom))
    power_error = scatter / float(np.sqrt(np.sum(deviations**2)))
    uncertainty = float(student.ppf(0.5 * (1 + LIKELY), degrees_of_freedom)) * power_error
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


def halving(seconds: Law, error: Law) -> Halving | None:
    """Time scales with x to a negative power a, the error to a positive power p: half the error takes ``2^(-a/p)``
    times as long. None if the power of the error is not significantly positive.

    The interval is that of the ratio of two powers (Fieller); it is not symmetric.
    """
    a, p, da, dp = -seconds.power, error.power, seconds.uncertainty, error.uncertainty
    if not p - dp > 0:
        return None
    middle, half_width = a * p, np.sqrt((a * dp) ** 2 + da**2 * (p**2 - dp**2))
    low_power, high_power = (min((middle + sign * half_width) / (p**2 - dp**2), ENDLESS) for sign in (-1, 1))
    return Halving(float(2 ** (a / p)), float(2**low_power), float(2**high_power))
