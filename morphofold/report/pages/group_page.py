"""The page of a group: number of subjects measured, distributions, left and right, outliers, and failures.

Only outliers, failures and warnings have rows for single subjects, and these lists are cut. The tables beside the page
have the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from morphofold.cohort.statistics import (
    FEWEST_FOR_OUTLIERS,
    HEMIS,
    MOST_ROBUST_FIT_POINTS,
    OUTLIER_Z,
    RELATIVE_ROUND_OFF,
    Asymmetry,
    Outlier,
    Outliers,
    Scalars,
    asymmetry,
    by_person,
    distributions,
    measures_of,
    outliers,
    region_cloud,
    robust_z,
    subject_cloud,
    write_statistics,
)
from morphofold.progress import Progress, silent
from morphofold.quantities import CATEGORICAL_COLOURS, THICKNESS_RATIO, scalar_words
from morphofold.report.pages.methods import paragraph
from morphofold.report.pages.templates import versions, write_page
from morphofold.report.pictures.group import SIDE_WORDS, draw_outliers
from morphofold.report.plots import charts as plots
from morphofold.report.plots.line_plots import ticks
from morphofold.tables import write_table
from morphofold.words import number

if TYPE_CHECKING:
    from morphofold.cohort.tables import Group

HEADLINE_MEASURES = (
    "gyrification_index",
    "mean_cortical_thickness_mm",
    "median_gyral_thickness_mm",
    THICKNESS_RATIO,
    "mean_sulcal_depth_mm",
    "area_pial_mm2",
)
OPEN_CHARTS = (
    *HEADLINE_MEASURES,
    "wavelength_mm",
    "n_hinges",
)  # always visible; those of other measures are folded away
MOST_PICTURED_SUBJECTS = 12
MOST_TABLE_ROWS = 200  # of failures, and of outliers
MOST_REMARKED_SUBJECTS = 50  # subjects with warnings, and subjects under several names
LARGEST_CHARTED_Z = 10.0  # robust z above which charts leave values out
FEWEST_CHART_VALUES = 3  # values of one side that a chart needs
MOST_MEASURES_LISTED = 5  # measures that a sentence lists at most
POINT_NAMES = {
    "subject": "subjects",
    "region": "the means of regions",
}  # of a plot, as the methods paragraph calls them
STRIP_WIDTH_PX, STRIP_MARGIN_PX = 260.0, 12.0  # [px] width of a row of the asymmetry chart, and of its margins
DATA_FILES = (
    ("measures.tsv", "every number of every subject, one per line; measures.parquet has the same"),
    ("surfaces.tsv", "one line for each subject and hemisphere, with all numbers of the whole hemisphere"),
    ("distributions.tsv", "the distributions of this page"),
    ("asymmetry.tsv", "left against right"),
    ("outliers.tsv", "all outliers"),
    ("hemispheres.tsv", "how each hemisphere was measured, and the values of FreeSurfer's aseg.stats for it"),
    ("failures.tsv", "subjects and hemispheres without measures, and why"),
    ("remarks.tsv", "the warnings for each subject"),
)


@dataclass(frozen=True)
class Side:
    """Name and look of the subjects of one side."""

    hemi: str
    colour: str
    marker: str
    dash: str

    @property
    def name(self) -> str:
        return SIDE_WORDS[self.hemi].capitalize()


BOTH_SIDES = (Side("lh", CATEGORICAL_COLOURS[0], "circle", ""), Side("rh", CATEGORICAL_COLOURS[1], "square", "7 3"))


def group_report(group: Group, folder: Path, progress: Progress = silent) -> Path:
    """Write ``folder/report.html``, ``folder/figures/`` with outliers, and the tables of its statistics.

    ``progress`` gets the share done and the current step. The same group and results give the same bytes.
    """
    progress(0.0, "statistics")
    of_sessions = measures_of(group)
    scalars, far = by_person(group, of_sessions), outliers(group.subjects, of_sessions, group.person_numbers[1])
    spread, sides = distributions(scalars), asymmetry(scalars)
    write_statistics(folder, spread, sides, far.found)
    remark_rows = [
        {"subject": name, "remark": sentences} for name, remarks in group.remarks.items() for sentences in remarks
    ]
    write_table(folder / "remarks.tsv", ("subject", "remark"), remark_rows)
    progress(0.3, "charts")
    there = [side for k, side in enumerate(BOTH_SIDES) if known(group.scalars)[:, k].any()]
    charts = {name: chart for name in scalars if (chart := _histogram_chart(name, scalars[name], there))}
    clouds = [_thickness_plot(group, there, kind) for kind in ("subject", "region")]
    progress(0.5, "pictures of outliers")
    by_subject = far.subjects
    pictures = draw_outliers(
        [rows[0] for rows in by_subject[:MOST_PICTURED_SUBJECTS]],
        group.subjects,
        of_sessions,
        group.results,
        folder / "figures",
    )
    progress(0.9, "page")
    lined = [POINT_NAMES[cloud["kind"]] for cloud in clouds if any(line["fit"] for line in cloud["fits"])]
    sentences, references = methods(group, versions()[0][1], bool(sides), bool(far.looked_at or far.found), lined)
    path = write_page(
        folder / "report.html",
        "group.html",
        ["tables.js"],
        title=f"A group of {plural(len(group.subjects), 'subject')}",
        shown=shown_number,
        percent=percent,
        beside=beside,
        p_told=p_told,
        words=scalar_words,
        sides=SIDE_WORDS,
        there=there,
        verdict=verdict(group),
        warnings=warnings(group),
        headlines=headlines(scalars, there),
        unlike=measured_differently(group),
        pooling=group.pooling,
        charts=[charts[name] for name in OPEN_CHARTS if name in charts],
        other_charts=[chart for name, chart in charts.items() if name not in OPEN_CHARTS],
        spread=spread,
        alike=measures_with_one_value(scalars),
        strips=strips(sides),
        sided=sided(sides),
        scatters=[cloud for cloud in clouds if cloud["plot"]],
        fitted=bool(lined),
        outliers=far.found[:MOST_TABLE_ROWS],
        more_outliers=len(far.found) - MOST_TABLE_ROWS,
        outlying=outlying(far, len(by_subject)),
        pictures=[one for one in pictures if one.data],
        others=[one for one in pictures if not one.data],
        rows_of={rows[0].subject: rows for rows in by_subject[:MOST_PICTURED_SUBJECTS]},
        far=OUTLIER_Z,
        failures=group.failures[:MOST_TABLE_ROWS],
        more_failures=len(group.failures) - MOST_TABLE_ROWS,
        remarks=list(group.remarks.items())[:MOST_REMARKED_SUBJECTS],
        n_remarks=len(group.remarks),
        most_remarks=MOST_REMARKED_SUBJECTS,
        same=group.same[:MOST_REMARKED_SUBJECTS],
        n_same=len(group.same),
        methods=sentences,
        references=references,
        files=DATA_FILES,
        bootstrapped=MOST_ROBUST_FIT_POINTS,
    )
    progress(1.0, "done")
    return path


# --- sentences


def known(scalars: Scalars) -> NDArray[np.bool_]:
    """Mask (subjects, 2) of the sides that have a measure."""
    return np.any([np.isfinite(values) for values in scalars.values()], axis=0)


def plural(n: int, word: str) -> str:
    return f"{number(n)} {word}{'' if n == 1 else 's'}"


def verdict(group: Group) -> str:
    """Sentence: how many subjects and hemispheres were measured, and of how many."""
    there = known(group.scalars)
    some, n = int(there.any(axis=1).sum()), len(group.subjects)
    sentences = f"{number(some)} of {plural(n, 'subject')} {'has' if n == 1 else 'have'} measures"
    if not some:
        return f"{sentences}: none could be measured."
    both = int(there.all(axis=1).sum())
    parts = [f"{number(both)} with both sides"] if both else []
    for k, side in enumerate(("left", "right")):
        if only := int((there[:, k] & ~there[:, 1 - k]).sum()):
            parts.append(f"{number(only)} with the {side} one alone")
    sentences = f"{sentences}, {plural(int(there.sum()), 'hemisphere')} in all: {', '.join(parts)}."
    if group.simulated:
        simulated = number(group.simulated)
        sentences += (
            f" {simulated} of these are simulated: they have no side and are counted on the side that their files name."
        )
    return f"{sentences} {group.persons_words}".rstrip()


def warnings(group: Group) -> list[Markup]:
    """Warnings to read before the numbers are used, with links to the details."""
    sentences = []
    if group.failures:
        who = len({row["subject"] for row in group.failures})
        link = Markup('<a href="#failed">why</a>')
        sentences.append(
            Markup("{} could not be measured, in whole or in part: {}.").format(plural(who, "subject"), link)
        )
    if group.same:
        link = Markup('<a href="#same">which</a>')
        count = sum(map(len, group.same))
        sentences.append(
            Markup("{} have the same surfaces as another one; each name counts as one subject: {}.").format(
                plural(count, "subject"), link
            )
        )
    if group.pooling.counts:
        link = Markup('<a href="#unlike">what that leaves out</a>')
        sentences.append(
            Markup("{} Statistics use only those measured in the same way: {}.").format(
                group.pooling.sentences[0], link
            )
        )
    return sentences


def measured_differently(group: Group) -> list[dict[str, Any]]:
    """Measures that are pooled only in part: number of values left out, and of all values."""
    rows = ((scalar_words(name)[0], *numbers) for name, numbers in group.pooling.left_out.items())
    return [{"label": label, "left_out": out, "n": n} for label, out, n in rows]


def outlying(far: Outliers, subjects: int) -> list[str]:
    """Sentences: outliers found, how many are expected by chance, and which measures were not searched."""
    sentences = []
    if far.looked_at or far.found:
        sentences.append(
            f"Far from the median of their side: {plural(len(far.found), 'value')} of {plural(subjects, 'subject')}."
        )
    if far.looked_at:
        chance = number(far.by_chance, 2) if far.by_chance >= 1 else "less than one"
        sentences.append(
            f"Of the {number(far.looked_at)} values searched, {chance} would be as far out if all were "
            "normally distributed."
        )
    if far.too_few:
        who = (
            "Nothing was looked for"
            if not (far.looked_at or far.found)
            else f"Left out: {_measures_with_sides(far.too_few)}"
        )
        sentences.append(f"{who}: fewer than {FEWEST_FOR_OUTLIERS} values, too few to define the usual range.")
    if far.divided:
        sentences.append(
            f"Left out: {_measures_with_sides(far.divided)}: half or more of the values are the same, but over "
            "a quarter differ."
        )
    return sentences


def _measures_with_sides(pairs: Sequence[tuple[str, str]]) -> str:
    sides: dict[str, list[str]] = {}
    for measure, hemi in pairs:
        sides.setdefault(scalar_words(measure)[0], []).append(SIDE_WORDS[hemi])
    return "; ".join(f"{label}{'' if len(which) == 2 else f' ({which[0]})'}" for label, which in sides.items())


def sided(sides: Sequence[Asymmetry]) -> str:
    """Sentence: which measures differ between the sides, by the corrected test."""
    tested = [row for row in sides if np.isfinite(row.p_holm)]
    if not tested:
        return "Too few subjects with both sides, or the same value for all: no test."
    found = [
        f"{scalar_words(row.measure)[0]} ({'left' if row.asymmetry > 0 else 'right'} greater)"
        for row in tested
        if row.sided
    ]
    what = f"The sides differ in {'; '.join(found)}" if found else "No measure differs between the sides"
    if len(found) > MOST_MEASURES_LISTED:
        what = f"The sides differ in {len(found)} measures (filled dots)"
    return f"{what}, by t-tests corrected for {plural(len(tested), 'measure')} (Holm, 5 %)."


def methods(
    group: Group, version: str, sides: bool = True, far: bool = True, clouds: Sequence[str] = ()
) -> tuple[str, list[str]]:
    """A methods paragraph for a paper, and the references that it cites.

    It covers what the page has: ``sides`` (left against right), ``far`` (outliers), and fits through ``clouds`` of
    gyral against cortical thickness.
    """
    there = {name for name, values in group.scalars.items() if np.isfinite(values).any()}
    has = {"sides": sides, "far": far, "clouds": clouds, "outlier_z": OUTLIER_Z}
    return paragraph(group.settings, there, version, group=has)


# --- numbers


def shown_number(measure: str, value: float) -> str:
    """A value as text for a page; counts that are whole numbers are written as such."""
    if np.isfinite(value) and value == round(value) and measure.startswith(("n_", "euler")):
        return number(round(value))
    return number(value)


def beside(one: Outlier) -> tuple[str, str]:
    """An outlier's value and the median as text, with enough digits that they differ."""
    value, median = shown_number(one.measure, one.value), shown_number(one.measure, one.median)
    digits = 4
    while value == median and digits < 8:
        value, median = number(one.value, digits), number(one.median, digits)
        digits += 1
    return value, median


def percent(x: float) -> str:
    """A share in percent as text, with its sign."""
    if not np.isfinite(x):
        return "–"
    return f"{'+' if x > 0 else ''}{number(100 * x, 2)}"


def headlines(scalars: Scalars, there: Sequence[Side]) -> list[dict[str, Any]]:
    """Medians and quartiles for the first screen, by measure and side; None where there is none.

    The sides are compared, so only subjects with both sides are used, if there are any.
    """
    paired = {name: of_both(values) for name, values in scalars.items() if name in HEADLINE_MEASURES}
    table = {(row.measure, row.hemi): row for row in distributions(paired)}
    rows = []
    for key in HEADLINE_MEASURES:
        cells = [table.get((key, side.hemi)) for side in there]
        if any(cells):
            label, unit = scalar_words(key)
            rows.append({"key": key, "label": label, "unit": unit, "cells": cells})
    return rows


def of_both(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (subjects, 2) of the subjects that have both sides, NaN for others; all values if nobody has both."""
    both = np.isfinite(values).all(axis=1, keepdims=True)
    return np.where(both, values, np.nan) if both.any() else values


def p_told(p: float) -> str:
    """A p-value as text for a page."""
    return "< 0.001" if p < 0.001 else number(p, 2)


def strips(sides: Sequence[Asymmetry]) -> dict[str, Any] | None:
    """The chart of asymmetry, one strip per measure: positions of dot, interval and ticks in pixels."""
    if not sides:
        return None
    ends = [abs(x) for row in sides for x in (row.asymmetry, row.low, row.high) if np.isfinite(x)]
    top = 1.05 * max(ends) or 1.0

    def place(x: float) -> float | None:
        return (
            STRIP_MARGIN_PX + (x + top) / (2 * top) * (STRIP_WIDTH_PX - 2 * STRIP_MARGIN_PX) if np.isfinite(x) else None
        )

    rows = [{"row": row, "at": place(row.asymmetry), "low": place(row.low), "high": place(row.high)} for row in sides]
    marks = [(place(x), percent(x) if x else "0") for x in ticks(-top, top, about=5)]
    return {"rows": rows, "ticks": marks, "zero": place(0.0), "width": STRIP_WIDTH_PX}


# --- charts


def _histogram_chart(name: str, values: NDArray[np.float64], there: Sequence[Side]) -> Markup | None:
    """Histograms of left and right, without values that lie far out; the caption gives the number of these."""
    label, unit = scalar_words(name)
    held = np.isfinite(values)
    if held.sum(axis=0).max() < FEWEST_CHART_VALUES or are_alike(values[held]):
        return None
    z, _ = robust_z(values[held])
    beyond = np.zeros(values.shape, dtype=bool)
    beyond[held] = np.isfinite(z) & (np.abs(z) > LARGEST_CHARTED_Z)
    shown = np.where(beyond, np.nan, values)
    bins = _bin_edges(shown[np.isfinite(shown)], int(held.sum(axis=0).max()))
    series = [(side, shown[:, HEMIS.index(side.hemi)], np.ones(len(values))) for side in there]
    chart = plots.histograms(series, label, unit, bins, counted="subjects")
    numbers = [int(held[:, HEMIS.index(side.hemi)].sum()) for side in there]
    caption = [f"n: {', '.join(f'{SIDE_WORDS[side.hemi]} {number(n)}' for side, n in zip(there, numbers))}."]
    caption = caption if len(set(numbers)) > 1 else []  # else the caption below all charts gives it
    caption += [f"{plural(int(beyond.sum()), 'value')} far beyond, not drawn."] if beyond.any() else []
    if chart is not None and caption:
        chart += Markup("<figcaption>{}</figcaption>").format(" ".join(caption))
    return chart


def _bin_edges(values: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Edges of bins that hold all values, for ``n`` values per side; between whole numbers if all values are whole."""
    most = int(np.clip(2 * np.sqrt(n), 6, 48))
    low, high = float(values.min()), float(values.max())
    if (values != np.round(values)).any():
        return np.linspace(low, high, most + 1)
    step = int(np.ceil((high - low + 1) / most))
    return np.asarray(np.arange(low - 0.5, high + step + 0.5, step))


def are_alike(values: NDArray[np.float64]) -> bool:
    """Whether known values are all the same to round-off."""
    return bool(np.ptp(values) <= RELATIVE_ROUND_OFF * np.abs(values).max())


def measures_with_one_value(scalars: Scalars) -> list[str]:
    """Measures with the same value for all subjects and sides, which are not drawn, and that value."""
    sentences = []
    for name, values in scalars.items():
        known = values[np.isfinite(values)]
        if known.size >= FEWEST_CHART_VALUES and are_alike(known):
            label, unit = scalar_words(name)
            sentences.append(f"{label} {shown_number(name, float(np.median(known)))} {unit}".strip())
    return sentences


def _thickness_plot(group: Group, there: Sequence[Side], kind: str) -> dict[str, Any]:
    """The plot of gyral against cortical thickness over subjects or regions, with the fits."""
    of = {"subject": subject_cloud, "region": region_cloud}[kind]
    clouds = [(side, of(group, HEMIS.index(side.hemi))) for side in there]
    clouds = [(side, cloud) for side, cloud in clouds if cloud.points]
    drawn = []
    for side, cloud in clouds:
        if kind == "region":
            drawn.append((side, replace(cloud, bins=cloud.points)))
        else:
            drawn.append((side, replace(cloud, points=()) if cloud.bins else cloud))
    return {
        "kind": kind,
        "title": "Subjects" if kind == "subject" else "Regions, means over subjects",
        "plot": plots.thickness_plot(drawn, [], from_zero=False, size=(430, 320)),
        "binned": any(c.bins for _, c in clouds),
        "fits": [{"side": side, "fit": cloud.fit, "n": len(cloud.points)} for side, cloud in clouds],
    }
