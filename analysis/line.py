"""A line through the regions of a brain: gyral on cortical thickness, with what a few odd regions can do to it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

DRAWS = 2000
CONFIDENCE = 0.95
FEWEST = 3


@dataclass(frozen=True)
class Line:
    """y on x through ``n`` points.

    ``slope`` and ``intercept`` by least squares, ``r`` Pearson's; ``robust``, the median of the slopes of all pairs of
    points; ``low`` and ``high`` bound it with 95 % confidence.
    """

    n: int
    slope: float
    intercept: float
    r: float
    robust: float
    low: float
    high: float


def line(x: NDArray[np.float64], y: NDArray[np.float64], seed: int = 0) -> Line:
    """Line through points (N,), (N,), three at least, that differ in x and in y.

    The robust slope is that of Theil and Sen (Sen 1968, JASA 63). Its bounds are quantiles over 2000 draws of N points
    with replacement; where a point stands for a region of a surface this is a bootstrap by spatial blocks, and what
    vertices of one region have in common does not pass for evidence.

    Raises
    ------
    ValueError
        If there are fewer points, or x or y are all alike.
    """
    if len(x) < FEWEST or np.ptp(x) == 0 or np.ptp(y) == 0:
        raise ValueError(f"a line needs {FEWEST} points that differ in x and in y; there are {len(x)}.")
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    drawn = np.random.default_rng(seed).integers(len(x), size=(DRAWS, len(x)))
    slopes = _pair_slopes(x[drawn], y[drawn])
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(slopes[np.isfinite(slopes)], [tail, 100 - tail])
    return Line(
        len(x), slope, float(y.mean() - slope * x.mean()), float(dx @ dy / np.sqrt((dx @ dx) * (dy @ dy))),
        float(_pair_slopes(x[None], y[None])[0]), float(low), float(high),
    )  # fmt: skip


def through_regions(rows: Iterable[Mapping[str, Any]]) -> tuple[Line | None, str]:
    """Median gyral on mean cortical thickness of the regions of a table that have both, and a note."""
    pairs = [(row["cortical_thickness_mm"], row["gyral_thickness_mm"]) for row in rows]
    x, y = np.array([p for p in pairs if None not in p], dtype=np.float64).reshape(-1, 2).T
    try:
        found = line(x, y)
    except ValueError:
        return None, f"A line needs three regions with both thicknesses that differ; there are {len(x)}."
    return found, (
        f"Over {found.n} regions, median gyral on mean cortical thickness: slope and r by least squares; the robust "
        "slope is the median over pairs of regions, its bounds hold with 95 % confidence (bootstrap over regions)."
    )


def _pair_slopes(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median slope of the pairs of points that differ in x, of each row of (D, N); NaN where none do."""
    i, j = np.triu_indices(x.shape[1], 1)
    run, rise = x[:, j] - x[:, i], y[:, j] - y[:, i]
    slopes = np.sort(np.divide(rise, run, out=np.full(run.shape, np.nan), where=run != 0), axis=1)      # NaN come last
    known = np.isfinite(slopes).sum(axis=1)
    row, low, high = np.arange(len(x)), np.maximum(known - 1, 0) // 2, known // 2
    middle: NDArray[np.float64] = 0.5 * (slopes[row, low] + slopes[row, np.minimum(high, slopes.shape[1] - 1)])
    return np.where(known > 0, middle, np.nan)
