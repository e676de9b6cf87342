"""Change per year of persons with several scans: the least-squares slope of each measure over the time of the scans."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array, Ints
from morphofold.io.layouts import HEMIS

CHANGE_COLUMNS = ("person", "hemi", "measure", "n_scans", "years", "mean", "per_year", "percent_per_year")
DAYS_PER_YEAR = 365.25


def scan_years(scans: Sequence[Row], person: Ints) -> Array:
    """Time [years] of each scan by its covariates: the date in ``acq_time`` where the dates of its ``person`` (S,)
    differ, since ages are often whole years; else ``age`` [years]. NaN where it is unknown."""
    table = pd.DataFrame(list(scans)).reindex(columns=["age", "acq_time"])
    dates = pd.to_datetime(table["acq_time"], errors="coerce", utc=True, format="ISO8601")
    years = (dates - dates.min()) / pd.Timedelta(days=DAYS_PER_YEAR)
    is_dated = years.groupby(person).transform("nunique") > 1
    return years.where(is_dated, pd.to_numeric(table["age"], errors="coerce")).to_numpy(dtype=np.float64)


def changes(persons: Sequence[str], person: Ints, years: Array, scalars: Mapping[str, Array]) -> list[Row]:
    """One row for each person, hemisphere and measure that two scans or more have at different times.

    Parameters
    ----------
    persons : sequence of str
    person : (S,) int
        Number of the person of each scan.
    years : (S,) float64
        NaN where unknown.
    scalars : mapping of measure to (S, 2) float64
        Left and right, NaN where there is none.

    Returns
    -------
    list of dict
        With ``CHANGE_COLUMNS``: ``years`` from the first to the last scan, ``per_year`` in the unit of the measure, and
        ``percent_per_year`` of the absolute ``mean``, None where that is 0.
    """
    rows = []
    for number, name in enumerate(persons):
        scans = np.flatnonzero((person == number) & np.isfinite(years))
        for side, hemi in enumerate(HEMIS if len(scans) > 1 else ()):
            for measure, values in scalars.items():
                known = scans[np.isfinite(values[scans, side])]
                if len(known) < 2 or np.ptp(years[known]) == 0:
                    continue
                from_mean, mean = years[known] - years[known].mean(), float(values[known, side].mean())
                slope = float(from_mean @ (values[known, side] - mean) / (from_mean @ from_mean))
                percent = 100 * slope / abs(mean) if mean else None
                numbers = len(known), float(np.ptp(years[known])), mean, slope, percent
                rows.append(dict(zip(CHANGE_COLUMNS, (name, hemi, measure, *numbers))))
    return rows
