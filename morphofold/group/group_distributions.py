"""Statistics of a group: distributions, left against right, outliers, and gyral against cortical thickness.

A person counts once, with the mean of its sessions. Persons are assumed to be independent of each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from morphofold.analysis.measures_result import SLOPE_SCALARS
from morphofold.analysis.multiple_tests import SIGNIFICANCE, holm
from morphofold.comparison.thickness_plot_data import Cloud, ThicknessPoint, bins, fit_line
from morphofold.frozen_arrays import Array, Ints
from morphofold.group.group_tables import Group
from morphofold.io.layouts import HEMIS
from morphofold.quantities import THICKNESS_RATIO
from morphofold.tables import write_table

OUTLIER_Z = 3.5  # robust z above which a value is an outlier
FEWEST_FOR_OUTLIERS = 8  # fewest values of a measure and side for a search for outliers
LARGEST_OUTLIER_SHARE = 0.25  # largest share of values that may differ from one common value and be outliers
RELATIVE_ROUND_OFF = 1e-6  # relative; coordinates are float32, tables have seven digits
COUNT_PREFIX = "n_"  # prefix of the names of counts
LEAST_MAD_OF_COUNTS = 0.5  # least median absolute deviation of a count, so that one more or less is no outlier
NORMAL_MAD_OVER_SD = 0.6745  # median absolute deviation of a normal distribution over its standard deviation
MOST_POINTS_DRAWN = 400  # most subjects drawn as points; more are put into bins
SUBJECT_BINS = 20
MOST_ROBUST_FIT_POINTS = 1000  # most points for the robust slope, which compares all pairs
BOUNDS = ("gyral_to_cortical_slope_low", "gyral_to_cortical_slope_high")  # bounds of another measure
#: measures of the mesh, and measures that may be negative or near 0: their asymmetry is meaningless
NO_ASYMMETRY_MEASURES = ("n_vertices", "euler_characteristic", *SLOPE_SCALARS)
#: parts, bounds and other forms of a measure that is tested: not tested again, which would make p of all larger
REPEATING_MEASURES = (
    *("n_hinges_3", "n_hinges_4", "n_hinges_low", "n_hinges_high"),
    *("mean_cortical_thickness_area_weighted_mm", "spectral_wavelength_mm"),
)

Scalars = Mapping[str, Array]  # measure -> (subjects, 2): left and right, NaN where there is none


@dataclass(frozen=True)
class Distribution:
    """Distribution of ``n`` known values of a measure and side, in its unit; ``sd`` with n - 1, NaN for one value."""

    measure: str
    hemi: str
    n: int
    mean: float
    sd: float
    least: float
    lower_quartile: float
    median: float
    upper_quartile: float
    greatest: float


@dataclass(frozen=True)
class Asymmetry:
    """Asymmetry of a measure, ``2 (L - R) / (L + R)``, over the ``n`` subjects that have both sides.

    ``asymmetry`` is its mean, positive where the left is greater. ``low`` and ``high`` are its 95 % interval (Student's
    t) for this measure alone. ``effect_size`` is Cohen's d_z, mean over standard deviation of the paired values.
    ``p_holm`` is p of a t-test against 0, corrected over the measures that are tested (Holm 1979). NaN for one subject,
    if all values are the same to round-off, or for a part or another form of a measure that is tested.
    """

    measure: str
    n: int
    asymmetry: float
    low: float
    high: float
    sd: float
    effect_size: float
    p_holm: float

    @property
    def sided(self) -> bool:
        """Whether the sides differ, by the corrected test at 0.05."""
        return self.p_holm < SIGNIFICANCE


@dataclass(frozen=True)
class Outlier:
    """A value far from the median of its measure and side; ``robust_z`` is infinite if all others are the same."""

    subject: str
    hemi: str
    measure: str
    value: float
    robust_z: float
    median: float

    @property
    def among_alike(self) -> bool:
        """Whether all others are the same, so that there is no robust z."""
        return bool(np.isinf(self.robust_z))


@dataclass(frozen=True)
class Outliers:
    """Outliers by subject, the farthest first, and what was searched.

    Attributes
    ----------
    rows : tuple of Outlier
        Rows of a subject together, the farthest first.
    n_searched : int
        Number of values searched by robust z.
    with_few_values, with_same_values : tuple of (measure, hemi)
        Measures with fewer than 8 values; measures where half or more values are the same, but too many differ.
    """

    rows: tuple[Outlier, ...]
    n_searched: int
    with_few_values: tuple[tuple[str, str], ...]
    with_same_values: tuple[tuple[str, str], ...]

    @property
    def by_chance(self) -> float:
        """Expected number of values as far out if all were normally distributed."""
        return 2 * stats.norm.sf(OUTLIER_Z) * self.n_searched

    @property
    def subjects(self) -> list[list[Outlier]]:
        """The rows of each subject, in their order."""
        return [list(rows) for _, rows in groupby(self.rows, key=lambda row: row.subject)]


def measures_of(group: Group) -> Scalars:
    """The scalars of a group that may be pooled, and gyral over cortical thickness of the whole surface; NaN where a
    hemisphere was measured with other settings than the others."""
    scalars = {name: group.pooling.pooled(name, values) for name, values in group.scalars.items()}
    cortical = scalars["mean_cortical_thickness_mm"]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(cortical > 0, scalars["median_gyral_thickness_mm"] / cortical, np.nan)
    return {**scalars, THICKNESS_RATIO: ratio}


def by_person(group: Group, scalars: Scalars) -> Scalars:
    """Means over the sessions of each person: arrays (persons, 2) of arrays (subjects, 2)."""
    return {name: _means(values, group.person_numbers[1]) for name, values in scalars.items()}


def _means(values: Array, person_number: Ints) -> Array:
    """Means (P, K) of the values (S, K) with the same number, but for NaN."""
    return pd.DataFrame(values).groupby(person_number).mean().to_numpy()


def distributions(scalars: Scalars) -> list[Distribution]:
    """Distributions of every measure and side with a value, in the order of the measures, left first."""
    rows = []
    for measure, values in scalars.items():
        for hemi, side_values in zip(HEMIS, values.T):
            if (known := side_values[np.isfinite(side_values)]).size:
                rows.append(Distribution(measure, hemi, known.size, *pd.Series(known).describe().tolist()[1:]))
    return rows


def asymmetry(scalars: Scalars) -> list[Asymmetry]:
    """Left against right, for every measure that is a positive quantity of the brain and that a subject has on both
    sides."""
    rows = []
    for name, values in scalars.items():
        left, right = values[(values >= 0).all(axis=1) & (values.sum(axis=1) > 0)].T  # and neither is NaN
        if left.size and name not in NO_ASYMMETRY_MEASURES:
            rows.append(_asymmetry_statistics(name, 2 * (left - right) / (left + right)))
    corrected_p = holm(np.array([np.nan if row.measure in REPEATING_MEASURES else row.p_holm for row in rows]))
    return [replace(row, p_holm=float(p)) for row, p in zip(rows, corrected_p)]


def _asymmetry_statistics(name: str, values: Array) -> Asymmetry:
    """Asymmetry of one measure, with p not corrected yet."""
    n, mean_asymmetry = len(values), float(values.mean())
    sd = float(values.std(ddof=1)) if n > 1 else np.nan
    half_width = float(stats.t.ppf(0.975, n - 1) * sd / np.sqrt(n))
    effect = mean_asymmetry / sd if sd > RELATIVE_ROUND_OFF else np.nan
    p = float(2 * stats.t.sf(abs(effect) * np.sqrt(n), n - 1))
    return Asymmetry(name, n, mean_asymmetry, mean_asymmetry - half_width, mean_asymmetry + half_width, sd, effect, p)


def outliers(subjects: Sequence[str], scalars: Scalars, person_number: Ints | None = None) -> Outliers:
    """Values (subjects, 2) far from the median of their measure and side; ``person_number`` (subjects,): its person.

    Median and deviation are over persons, of the mean of their sessions, but each session is searched.

    ``robust_z = 0.6745 (x - median) / MAD`` with the median absolute deviation; above 3.5 in size it is an outlier
    (Iglewicz and Hoaglin 1993). MAD of counts is at least half a count. If MAD of another measure is 0 to round-off,
    half or more of the values are the same. Values that differ are then outliers, if they are at most a quarter.
    Subjects are sorted by their largest robust z.
    """
    rows_by_subject: list[list[Outlier]] = [[] for _ in subjects]
    too_few, divided, n_searched = [], [], 0
    person_number = np.arange(len(subjects)) if person_number is None else person_number
    for measure, hemi in [(name, hemi) for name in scalars if name not in BOUNDS for hemi in HEMIS]:
        values = scalars[measure][:, HEMIS.index(hemi)]
        known_rows = np.flatnonzero(np.isfinite(values))
        person_values = _means(values[known_rows], person_number[known_rows])[:, 0]
        if person_values.size < FEWEST_FOR_OUTLIERS:
            too_few += [(measure, hemi)] * bool(known_rows.size)
            continue
        z, median = robust_z(values[known_rows], LEAST_MAD_OF_COUNTS * measure.startswith(COUNT_PREFIX), person_values)
        if np.isinf(z).mean() > LARGEST_OUTLIER_SHARE:
            divided.append((measure, hemi))
            continue
        n_searched += 0 if np.isinf(z).any() or not z.any() else known_rows.size
        for k, value_z in zip(known_rows.tolist(), z.tolist()):
            if abs(value_z) > OUTLIER_Z:
                rows_by_subject[k].append(Outlier(subjects[k], hemi, measure, float(values[k]), value_z, median))
    for rows in rows_by_subject:
        rows.sort(key=lambda row: -abs(row.robust_z))
    rows_by_subject.sort(key=lambda rows: [-abs(row.robust_z) for row in rows])
    return Outliers(tuple(row for rows in rows_by_subject for row in rows), n_searched, tuple(too_few), tuple(divided))


def robust_z(values: Array, least_mad: float = 0.0, reference: Array | None = None) -> tuple[Array, float]:
    """Robust z (N,) of known values (N,), and the median of the ``reference`` values; by default their own.

    MAD is at least ``least_mad``; 0 or signed infinity if MAD is 0 to round-off."""
    reference = values if reference is None else reference
    median = float(np.median(reference))
    deviation = values - median
    mad = max(np.median(np.abs(reference - median)), least_mad)
    tolerance = RELATIVE_ROUND_OFF * abs(median)
    if mad > tolerance:
        return NORMAL_MAD_OVER_SD * deviation / mad, median
    return np.where(np.abs(deviation) <= tolerance, 0.0, np.copysign(np.inf, deviation)), median


def subject_cloud(group: Group, side: int) -> Cloud:
    """Median gyral against mean cortical thickness of the persons on one side (0 left, 1 right), and the fit.

    More than 400 subjects are also put into bins of equal counts by cortical thickness, with medians and quartiles. The
    fit is always through the subjects.
    """
    scalars = by_person(group, measures_of(group))
    cortical, gyral = (scalars[f"{statistic}_thickness_mm"][:, side] for statistic in ("mean_cortical", "median_gyral"))
    person_rows = np.flatnonzero(np.isfinite(cortical) & np.isfinite(gyral))
    points = tuple(ThicknessPoint(float(cortical[k]), float(gyral[k]), group.person_numbers[0][k]) for k in person_rows)
    subject_bins = bins(cortical, gyral, SUBJECT_BINS, "subjects") if len(points) > MOST_POINTS_DRAWN else ()
    return Cloud("subject", points, subject_bins, fit_line(points, robust=len(points) <= MOST_ROBUST_FIT_POINTS))


def region_cloud(group: Group, side: int) -> Cloud:
    """Means over subjects of gyral against cortical thickness of the regions of one side, and the fit.

    ``low`` and ``high`` of a point are one standard deviation over subjects from its gyral thickness.
    """
    points = []
    for region, moments in group.regions.items():
        n, (cortical, gyral), sd = int(moments[side, 0, 0]), moments[side, :, 1].tolist(), float(moments[side, 1, 2])
        if n:
            points.append(ThicknessPoint(cortical, gyral, f"{region}, {n} subjects", gyral - sd, gyral + sd))
    return Cloud("region", tuple(points), (), fit_line(points))


def write_statistics(
    folder: Path, dist_rows: Sequence[Distribution], asymmetries: Sequence[Asymmetry], outlier_rows: Sequence[Outlier]
) -> None:
    """Write distributions.tsv, asymmetry.tsv and outliers.tsv; an infinite robust z is ``n/a``."""
    for file_stem, row_class, rows in (
        ("distributions", Distribution, dist_rows),
        ("asymmetry", Asymmetry, asymmetries),
        ("outliers", Outlier, outlier_rows),
    ):
        write_table(folder / f"{file_stem}.tsv", [column.name for column in fields(row_class)], map(asdict, rows))
