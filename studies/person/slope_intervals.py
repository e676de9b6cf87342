"""Slopes of log width on log thickness, with an error of regression, one of seeds, and one of rotations."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from morphofold.frozen_arrays import Array


class Slope(NamedTuple):
    """Least squares through n parcels: slope, its standard error (parcels taken as independent), correlation."""

    n: int
    slope: float
    standard_error: float
    r: float


class Interval(NamedTuple):
    """Mean of runs, with the bounds of its 95 % interval by Student's t, and their number."""

    mean: float
    low: float
    high: float
    n: int


def paired_slope(x: Array, y: Array) -> Slope:
    """The line through the parcels (P,) where both are finite; NaN if they are fewer than three."""
    is_finite = np.isfinite(x) & np.isfinite(y)
    n_finite = int(is_finite.sum())
    if n_finite < 3 or np.ptp(x[is_finite]) == 0:
        return Slope(n_finite, np.nan, np.nan, np.nan)
    regression = stats.linregress(x[is_finite], y[is_finite])
    return Slope(n_finite, float(regression.slope), float(regression.stderr), float(regression.rvalue))


def spin_p(spun_maps: Array, log_widths: Array, slope: Slope) -> float:
    """Share of rotated maps ``spun_maps`` (K, P) with a slope at least as far from 0, the map itself counted with them.

    Neighbouring parcels are not independent. A rotated map has the same smoothness as the map, but no relation to the
    widths.
    """
    n_beyond = sum(abs(paired_slope(spun_map, log_widths).slope) >= abs(slope.slope) for spun_map in spun_maps)
    return (1 + n_beyond) / (1 + len(spun_maps))


def interval(values: Sequence[float]) -> Interval:
    """Mean over runs with its 95 % interval; NaN bounds for fewer than two."""
    finite_values = np.array([value for value in values if np.isfinite(value)])
    mean, n_values = float(finite_values.mean()) if len(finite_values) else np.nan, len(finite_values)
    if n_values < 2:
        return Interval(mean, np.nan, np.nan, n_values)
    half_width = float(stats.t.ppf(0.975, n_values - 1) * finite_values.std(ddof=1) / np.sqrt(n_values))
    return Interval(mean, mean - half_width, mean + half_width, n_values)
