"""The page of a group: number of subjects measured, distributions, left and right, outliers, and failures.

In goes the group of :mod:`morphofold.group.group_tables`, out come ``report.html``, pictures, and tables of statistics;
``cohort`` and ``bids`` call it.
Only outliers, failures and warnings have rows for single subjects, and these lists are cut. The tables beside the page
have the rest. Sentences are in ``templates/group.html``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from morphofold.frozen_arrays import Array
from morphofold.group import group_distributions as stats
from morphofold.group.group_tables import Group
from morphofold.note_texts import WARNINGS
from morphofold.number_texts import in_one_line, number
from morphofold.progress_callbacks import Progress, logged
from morphofold.quantities import CATEGORICAL_COLOURS, MAP_OF_SCALAR, THICKNESS_RATIO, quantity, scalar_words
from morphofold.report.pages.page_writer import SIDES, Pictures, paragraph, plural, write_page, write_picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots import charts as plots
from morphofold.report.plots.figure_style import ticks
from morphofold.results import read_pial
from morphofold.tables import write_table

HEADLINE_MEASURES = (
    "gyrification_index",
    "mean_cortical_thickness_mm",
    "median_gyral_thickness_mm",
    THICKNESS_RATIO,
    "mean_sulcal_depth_mm",
    "area_pial_mm2",
)
VISIBLE_CHARTS = (*HEADLINE_MEASURES, "wavelength_mm", "n_hinges")  # always visible; others are folded away
MOST_PICTURED_SUBJECTS = 12
FIGURE_WIDTH_PX = 860  # [pixels]
MOST_EMBEDDED_CHARACTERS = 1_500_000  # most characters of pictures inside a page; further pictures are files only
LARGEST_CHARTED_Z = 10.0  # robust z above which charts leave values out
FEWEST_CHART_VALUES = 3  # values of one side that a chart needs
CLOUD_OF_KIND = {"subject": stats.subject_cloud, "region": stats.region_cloud}  # of gyral against cortical thickness


@dataclass(frozen=True)
class Side(plots.Pen):
    """Pen of the subjects of one side, and its column in the arrays of a group."""

    column: int


BOTH_SIDES = (
    Side("Left", CATEGORICAL_COLOURS[0], "circle", "", 0),
    Side("Right", CATEGORICAL_COLOURS[1], "square", "7 3", 1),
)


def group_report(group: Group, folder: Path, progress: Progress = logged) -> Path:
    """Write ``folder/report.html``, ``folder/figures/`` with outliers, and the tables of its statistics.

    ``progress`` gets the share done and the current step. The same group and results give the same bytes.
    """
    progress(0.0, "statistics")
    session_scalars = stats.measures_of(group)
    person_scalars = stats.by_person(group, session_scalars)
    outliers = stats.outliers(group.subjects, session_scalars, group.person_numbers[1])
    distributions, asymmetries = stats.distributions(person_scalars), stats.asymmetry(person_scalars)
    stats.write_statistics(folder, distributions, asymmetries, outliers.rows)
    remark_rows = [{"subject": who, "remark": text} for who, remarks in group.remarks.items() for text in remarks]
    write_table(folder / "remarks.tsv", ("subject", "remark"), remark_rows)
    progress(0.3, "charts")
    page_values = {"group": group, "stats": stats, "spread": distributions, "asymmetries": asymmetries, "far": outliers}
    page_values |= _sides_and_charts(group, person_scalars)
    progress(0.5, "pictures of outliers")
    pictures = draw_outliers(outliers.subjects[:MOST_PICTURED_SUBJECTS], group, session_scalars, folder / "figures")
    progress(0.9, "page")
    measured_names = {scalar for scalar, values in group.scalars.items() if np.isfinite(values).any()}
    page_file = write_page(
        folder / "report.html",
        "group.html",
        ["tables.js"],
        title=f"A group of {plural(len(group.subjects), 'subject')}",
        **page_values,
        shown_number=shown_number,
        value_and_median=value_and_median,
        measures_with_sides=measures_with_sides,
        alike=measures_with_one_value(person_scalars),
        strips=strips(asymmetries),
        causes={code: cause for code, (cause, _) in WARNINGS.items()},
        pictures=pictures,
        methods=paragraph(group.hemisphere_rows, measured_names, **page_values),
    )
    progress(1.0, "done")
    return page_file


def _sides_and_charts(group: Group, scalars: stats.Scalars) -> dict[str, Any]:
    """Who has which side, medians, and charts of measures and of gyral against cortical thickness."""
    has_left, has_right = np.any(np.isfinite([*group.scalars.values()]), axis=0).T
    sides = [side for side, has_side in zip(BOTH_SIDES, (has_left, has_right)) if has_side.any()]
    charts = {name: chart for name, values in scalars.items() if (chart := _histogram_chart(name, values, sides))}
    cloud_plots = [plot for kind in CLOUD_OF_KIND if (plot := _thickness_plot(group, sides, kind))["plot"]]
    return {
        "sides": sides,
        "both": (has_left & has_right).sum(),
        "alone": {"left": (has_left & ~has_right).sum(), "right": (has_right & ~has_left).sum()},
        "headlines": headlines(scalars, sides),
        "charts": [charts[name] for name in VISIBLE_CHARTS if name in charts],
        "other_charts": [chart for name, chart in charts.items() if name not in VISIBLE_CHARTS],
        "clouds": cloud_plots,
        "fitted": [plot["kind"] for plot in cloud_plots if any(fit for _, fit, _ in plot["fits"])],
    }


# numbers and words -------------------------------------------------------------------------------------------


def shown_number(measure: str, value: float) -> str:
    """A value as text for a page; counts that are whole numbers are written as such."""
    is_whole = measure.startswith(("n_", "euler")) and float(value).is_integer()
    return number(round(value) if is_whole else value)


def value_and_median(outlier: stats.Outlier) -> tuple[str, str]:
    """An outlier's value and the median as text, with enough digits that they differ."""
    value_text, median_text = (shown_number(outlier.measure, value) for value in (outlier.value, outlier.median))
    for n_digits in range(4, 8):
        if value_text != median_text:
            break
        value_text, median_text = number(outlier.value, n_digits), number(outlier.median, n_digits)
    return value_text, median_text


def measures_with_sides(measure_hemis: Sequence[tuple[str, str]]) -> str:
    """Names of measures, each with its side unless both have it."""
    sides_by_label: dict[str, list[str]] = {}
    for measure, hemi in measure_hemis:
        sides_by_label.setdefault(scalar_words(measure)[0], []).append(SIDES[hemi])
    return "; ".join(f"{label}{'' if len(sides) == 2 else f' ({sides[0]})'}" for label, sides in sides_by_label.items())


def headlines(scalars: stats.Scalars, sides: Sequence[Side]) -> dict[str, list[stats.Distribution | None]]:
    """Medians and quartiles for the first screen: of each measure a value for each side, None where there is none.

    The sides are compared, so only subjects with both sides are used, if there are any.
    """
    paired_scalars = {}
    for measure, values in scalars.items():
        has_both = np.isfinite(values).all(axis=1, keepdims=True)
        paired_scalars[measure] = np.where(has_both | ~has_both.any(), values, np.nan)
    spread_of = {(spread.measure, spread.hemi): spread for spread in stats.distributions(paired_scalars)}
    by_measure = {key: [spread_of.get((key, stats.HEMIS[side.column])) for side in sides] for key in HEADLINE_MEASURES}
    return {key: distributions for key, distributions in by_measure.items() if any(distributions)}


def measures_with_one_value(scalars: stats.Scalars) -> dict[str, float]:
    """Measures with the same value for all subjects and sides, which are not drawn, and that value."""
    known_values = {measure: values[np.isfinite(values)] for measure, values in scalars.items()}
    enough_values = {measure: values for measure, values in known_values.items() if values.size >= FEWEST_CHART_VALUES}
    return {measure: float(np.median(values)) for measure, values in enough_values.items() if are_alike(values)}


def are_alike(values: Array) -> bool:
    """Whether known values are all the same to round-off."""
    return bool(np.ptp(values) <= stats.RELATIVE_ROUND_OFF * np.abs(values).max())


# charts ------------------------------------------------------------------------------------------------------


def strips(asymmetries: Sequence[stats.Asymmetry]) -> tuple[float, list[float]]:
    """Largest asymmetry that fits into the chart of asymmetry, and its ticks."""
    interval_ends = [abs(end) for row in asymmetries for end in (row.asymmetry, row.low, row.high) if np.isfinite(end)]
    axis_end = 1.05 * max(interval_ends, default=0.0) or 1.0
    return axis_end, ticks(-axis_end, axis_end, n_ticks=5)


def _histogram_chart(measure: str, values: Array, sides: Sequence[Side]) -> Markup | None:
    """Histograms of left and right, without values that lie far out; the caption gives the number of these."""
    label, unit = scalar_words(measure)
    is_known = np.isfinite(values)
    n_known = is_known.sum(axis=0).tolist()
    if max(n_known) < FEWEST_CHART_VALUES or are_alike(values[is_known]):
        return None
    robust_scores, _ = stats.robust_z(values[is_known])
    is_beyond = np.zeros(values.shape, dtype=bool)
    is_beyond[is_known] = np.isfinite(robust_scores) & (np.abs(robust_scores) > LARGEST_CHARTED_Z)
    charted_values = np.where(is_beyond, np.nan, values)
    bin_edges = _bin_edges(charted_values[np.isfinite(charted_values)], max(n_known))
    series = [(side, charted_values[:, side.column], np.ones(len(values))) for side in sides]
    chart = plots.histograms(series, label, unit, bin_edges, counted="subjects")
    count_texts = [f"{side.name.lower()} {number(n_known[side.column])}" for side in sides]
    counts_differ = len({n_known[side.column] for side in sides}) > 1  # else the caption of all charts gives them
    caption_parts = [f"n: {', '.join(count_texts)}."] if counts_differ else []
    caption_parts += [f"{plural(is_beyond.sum(), 'value')} far beyond, not drawn."] if is_beyond.any() else []
    return Markup("{}<figcaption>{}</figcaption>").format(chart, " ".join(caption_parts)) if caption_parts else chart


def _bin_edges(values: Array, n_per_side: int) -> Array:
    """Edges of bins that hold all values, ``n_per_side`` on a side; between whole numbers if all values are whole."""
    max_bins = int(np.clip(2 * np.sqrt(n_per_side), 6, 48))
    lowest, highest = values.min(), values.max()
    if (values != np.round(values)).any():
        return np.linspace(lowest, highest, max_bins + 1)
    bin_width = np.ceil((highest - lowest + 1) / max_bins)
    return np.arange(lowest - 0.5, highest + bin_width + 0.5, bin_width)


def _thickness_plot(group: Group, sides: Sequence[Side], cloud_kind: str) -> dict[str, Any]:
    """The plot of gyral against cortical thickness over subjects or regions, with the fits."""
    side_clouds = [(side, cloud) for side in sides if (cloud := CLOUD_OF_KIND[cloud_kind](group, side.column)).points]
    plotted_clouds = []
    for side, cloud in side_clouds:
        binned_cloud = replace(cloud, points=() if cloud.bins else cloud.points)
        plotted_clouds.append((side, replace(cloud, bins=cloud.points) if cloud_kind == "region" else binned_cloud))
    return {
        "kind": cloud_kind,
        "plot": plots.thickness_plot(plotted_clouds, [], from_zero=False, size=(430, 320)),
        "binned": any(cloud.bins for _, cloud in side_clouds),
        "fits": [(side, cloud.fit, len(cloud.points)) for side, cloud in side_clouds],
    }


# pictures ----------------------------------------------------------------------------------------------------


def draw_outliers(
    outlier_lists: Sequence[Sequence[stats.Outlier]], group: Group, scalars: stats.Scalars, folder: Path
) -> Pictures:
    """Write ``folder/outlier-01.png`` and so on, one for the first outlier of each subject: lateral and medial view.

    Returns an entry for each, for the page: the ``outlier``, the ``rest`` of the subject's, the ``typical`` subject
    beside it in the same colours and at one scale, who is nearest to the median, the ``map``, and the ``file`` and its
    ``data``, or the ``reason`` why there is none.
    """
    entries: Pictures = []
    for k, (outlier, *others) in enumerate(outlier_lists, start=1):
        median_distance = np.abs(scalars[outlier.measure][:, stats.HEMIS.index(outlier.hemi)] - outlier.median)
        typical = group.subjects[np.nanargmin(median_distance)]
        map_name = MAP_OF_SCALAR.get(outlier.measure, "H")
        entry = {"outlier": outlier, "rest": others, "typical": typical, "map": quantity(map_name).label, "data": ""}
        entries.append(entry)
        surface_rows = []
        try:
            for subject, row_name in ((outlier.subject, outlier.subject), (typical, f"{typical}, at the median")):
                surface, map_values = read_pial(group.result_folders[subject], outlier.hemi, map_name)
                map_values = np.full(len(surface.verts), np.nan) if map_values is None else map_values
                surface_rows.append(Row(row_name, surface, map_values, outlier.hemi))
            measured_map = quantity(map_name, [row.values for row in surface_rows])
            image = figure(surface_rows, measured_map, None, ("lateral", "medial"), FIGURE_WIDTH_PX)
        except (OSError, ValueError) as error:
            entry["reason"] = in_one_line(error)
            continue
        entry |= write_picture(folder / f"outlier-{k:02}.png", image, outlier.subject)
        if sum(len(drawn_entry["data"]) for drawn_entry in entries) > MOST_EMBEDDED_CHARACTERS:
            entry["data"] = ""
    return entries
