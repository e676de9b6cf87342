"""Data of the plot of gyral against cortical thickness (Fig. 8b of Razavi et al. 2015), which ``report`` draws.

In go the ``Measures`` of one surface; out comes a ``Cloud`` with a point for each region, else for each crest, and its
fitted line. Also the ratio of both thicknesses, and the line of linear wrinkling theory, wavelength over cortical
thickness, at a ratio of stiffness.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphofold.analysis.measures_result import Measures
from morphofold.analysis.thickness.robust_slope import LEAST_POINTS, LEAST_POINTS_FOR_BOUNDS, robust_line
from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array
from morphofold.quantities import CREST_THICKNESS_RATIO, THICKNESS_RATIO, find

GYRAL, CORTICAL = "gyral_thickness_mm", "cortical_thickness_mm"
#: of a whole surface
WHOLE_SURFACE_THICKNESSES = ("median_gyral_thickness_mm", "mean_cortical_thickness_mm")
MOST_BINS, LEAST_VERTICES_OF_A_BIN = 8, 50


@dataclass(frozen=True)
class ThicknessPoint:
    """Gyral against cortical thickness [mm] of one region, crest, bin of vertices or whole surface.

    ``low`` and ``high`` are quartiles of the gyral thickness, if the point represents many vertices.
    """

    cortical: float
    gyral: float
    label: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Fit:
    """Line of gyral on cortical thickness over ``n`` points, robust and by least squares.

    ``robust`` is the median of the slopes of all pairs of points, with a 95 % interval from a bootstrap over the points
    (:func:`~morphofold.analysis.thickness.robust_slope.robust_line`; None for fewer than five); 0 if all gyral
    thicknesses are the same, NaN if it was not computed. ``slope`` is from least squares, with its 95 % interval;
    ``slope_without_few`` is the same without the twentieth of the points (at least one) that change it most, None for
    fewer than five points. Where the two differ, few points make the slope. Intervals assume independent points, but
    neighbouring regions are not fully independent.
    """

    robust: float
    robust_low: float | None
    robust_high: float | None
    robust_intercept: float
    slope: float
    slope_low: float
    slope_high: float
    slope_without_few: float | None
    intercept: float
    r: float
    p: float
    n: int

    @property
    def sloped(self) -> bool:
        """Whether the interval of the robust slope excludes 0; of that of least squares if there is none."""
        lower_slope, upper_slope = self.robust_low, self.robust_high
        if lower_slope is None or upper_slope is None:
            lower_slope, upper_slope = self.slope_low, self.slope_high
        return not lower_slope <= 0 <= upper_slope

    def at(self, cortical: Array) -> Array:
        """Gyral thickness [mm] of the robust line, else of that by least squares, at cortical thicknesses (P,) [mm]."""
        if np.isfinite(self.robust):
            return self.robust_intercept + self.robust * cortical
        return self.intercept + self.slope * cortical


@dataclass(frozen=True)
class Cloud:
    """Thickness points of a surface, ``kind`` ``"region"``, ``"crest"`` or ``"whole"``; of a group, ``"subject"``."""

    kind: str
    points: tuple[ThicknessPoint, ...]
    bins: tuple[ThicknessPoint, ...] = ()
    fit: Fit | None = None

    def __repr__(self) -> str:
        slope = f"slope {self.fit.slope:.3g}" if self.fit else "no line"
        return f"Cloud({len(self.points)} points, one for each {self.kind}; {slope})"


@dataclass(frozen=True)
class TheoryLine:
    """The wrinkling wavelength of a stiff film on a soft substrate, per film thickness [mm/mm]."""

    mu_ratio: float
    slope: float


def wrinkling_wavelength(mu_ratio: float) -> TheoryLine:
    """Wavelength of linear wrinkling per film thickness, ``2 pi (mu_f / 3 mu_s)^(1/3)``.

    Section IV of Razavi et al. 2015, who take it from Chen and Hutchinson, J. Appl. Mech. 71, 597 (2004);
    mu_f and mu_s are the shear moduli of film and substrate. It is 4.36 for equal stiffness; but this is the linear
    theory of a thin stiff film, so ratios near 1 are outside the range for which it was derived.
    """
    return TheoryLine(float(mu_ratio), 2 * np.pi * (mu_ratio / 3) ** (1 / 3))


def thickness_cloud(measures: Measures) -> Cloud:
    """Gyral against cortical thickness of one surface.

    One point per region if there are regions with both thicknesses; else one per crest; else one for the whole
    surface (median gyral, mean cortical thickness). Crests whose cortex is less than half as thick as the surface's are
    left out: they lie on a medial wall that was not marked. Without regions, bins of vertices with equal counts by
    cortical thickness show the spread (median and quartiles). The line is fitted to at least three regions or crests,
    never to bins: their vertices are not independent.
    """
    gyral, cortical = map(measures.scalars.get, WHOLE_SURFACE_THICKNESSES)
    whole_row = {GYRAL: gyral, CORTICAL: cortical, "whole": "whole surface"}
    for kind, rows in (("region", measures.regions), ("crest", measures.crests), ("whole", [whole_row])):
        points = tuple(
            ThicknessPoint(float(row[CORTICAL]), float(row[GYRAL]), str(row.get(kind, kind)))
            for row in _with_both_thicknesses(rows)
            if kind != "crest" or row[CORTICAL] >= 0.5 * (cortical or 0.0)
        )
        if points:
            return Cloud(kind, points, () if kind == "region" else _vertex_bins(measures), fit_line(points))
    return Cloud("whole", ())


def thickness_ratios(measures: Measures) -> dict[str, float | None]:
    """Gyral over cortical thickness: median over mean of the whole surface, and the median of the ratio over crests.

    The two differ if the cortex of crowns is thicker or thinner than that of walls and fundi. None if one of the two
    thicknesses is not known.
    """
    gyral, cortical = map(measures.scalars.get, WHOLE_SURFACE_THICKNESSES)
    ratios = [row[GYRAL] / row[CORTICAL] for row in _with_both_thicknesses(measures.crests) if row[CORTICAL] > 0]
    return {
        THICKNESS_RATIO: gyral / cortical if gyral and cortical else None,
        CREST_THICKNESS_RATIO: float(np.median(ratios)) if ratios else None,
    }


def _with_both_thicknesses(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if np.isfinite(np.array([row.get(GYRAL), row.get(CORTICAL)], dtype=np.float64)).all()]


def _vertex_bins(measures: Measures) -> tuple[ThicknessPoint, ...]:
    """Vertices that have both thicknesses, in bins of equal count by cortical thickness."""
    cortical, gyral = find(measures.maps, "cortical_thickness"), find(measures.maps, "gyral_thickness")
    if cortical is None or gyral is None:
        return ()
    n_bins = np.isfinite(cortical + gyral).sum() // LEAST_VERTICES_OF_A_BIN
    return bins(cortical, gyral, min(n_bins, MOST_BINS), "vertices") if n_bins > 1 else ()


def bins(cortical: Array, gyral: Array, n_bins: int, noun: str) -> tuple[ThicknessPoint, ...]:
    """Known pairs of thicknesses [mm] in bins of equal count by the cortical one: medians and quartiles."""
    known_vertices = np.flatnonzero(np.isfinite(cortical + gyral))
    points = []
    for bin_vertices in np.array_split(known_vertices[np.argsort(cortical[known_vertices], kind="stable")], n_bins):
        low, middle, high = np.percentile(gyral[bin_vertices], [25, 50, 75]).tolist()
        label = f"{len(bin_vertices)} {noun} of {cortical[bin_vertices[0]]:.2f} to {cortical[bin_vertices[-1]]:.2f} mm"
        points.append(ThicknessPoint(float(np.median(cortical[bin_vertices])), middle, label, low, high))
    return tuple(points)


def fit_line(points: Sequence[ThicknessPoint], *, robust: bool = True) -> Fit | None:
    """Lines of gyral on cortical thickness; None for fewer than three points or no spread in x.

    ``robust``: also the median of slopes, whose time and memory grow as the square of the points; else it is NaN.
    """
    from scipy import stats  # takes a third of a second, which a page without points saves

    x, y = np.array([p.cortical for p in points]), np.array([p.gyral for p in points])
    if len(points) < LEAST_POINTS or np.ptp(x) == 0:
        return None
    slope, intercept, r, p, slope_error = map(float, stats.linregress(x, y))
    half = float(stats.t.ppf(0.975, len(points) - 2)) * slope_error
    median = robust_low = robust_high = 0.0 if robust else np.nan
    if robust and np.ptp(y) > 0:
        robust_fit = robust_line(x, y)
        median, robust_low, robust_high = robust_fit.robust, robust_fit.low, robust_fit.high
    low, high = (bound if np.isfinite(bound) else None for bound in (robust_low, robust_high))
    start, without_few = float(np.median(y - median * x)), _slope_without_few(x, y, slope)
    return Fit(median, low, high, start, slope, slope - half, slope + half, without_few, intercept, r, p, len(points))


def _slope_without_few(x: Array, y: Array, slope: float) -> float | None:
    """Slope of least squares without the twentieth of the points, at least one, that each change it most."""
    if len(x) < LEAST_POINTS_FOR_BOUNDS:
        return None
    dx = x - x.mean()
    own_share = np.maximum(1 - 1 / len(x) - dx**2 / (dx @ dx), np.finfo(float).eps)  # of a point's own residual
    slope_change = np.abs(dx * (y - y.mean() - slope * dx)) / own_share
    kept_points = np.argsort(slope_change, kind="stable")[: len(x) - max(len(x) // 20, 1)]
    return float(np.polyfit(x[kept_points], y[kept_points], 1)[0]) if np.ptp(x[kept_points]) > 0 else None
