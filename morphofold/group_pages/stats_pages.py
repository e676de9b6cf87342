"""Pages of a model tested at every vertex, and of what subjects have in common.

In go the results and a folder, out come ``report.html`` and ``figures/`` in it; the commands stats and overlap pass
these functions to what writes their folders.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from morphofold.analysis.multiple_tests import SIGNIFICANCE
from morphofold.errors import MissingPart
from morphofold.frozen_arrays import Array
from morphofold.group.design import INTERCEPT_NAMES
from morphofold.group.map_statistics import Result, cluster_rows, split
from morphofold.group.overlap import DENSITY_MAPS, WHOLE, Overlap
from morphofold.group.permuted_model import Model
from morphofold.group.spaces import Space
from morphofold.number_texts import listed, number
from morphofold.quantities import CATEGORICAL_COLOURS, Quantity, quantity
from morphofold.report.pages.page_writer import SIDES, PictureEntry, write_page, write_picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.charts import WIDE_CHART_SIZE_PX, limits_around, new_chart, share_plot
from morphofold.report.plots.figure_style import GREY

CLUSTERS_SHOWN = 20
DENSITY_UNITS = {"hinges": "1/cm²", "crests": "mm/cm²"}


def picture(space: Space, folder: Path, measure: Quantity, maps: Mapping[str, Array]) -> PictureEntry:
    """Write ``folder/figures/KEY.png`` of maps (N,) by hemisphere on the template of a study; return its entry."""
    surface_rows = []
    for hemi, values in maps.items():
        try:
            surface = space.surface(hemi, "inflated")
        except MissingPart:
            surface = space.surface(hemi)
        surface_rows.append(Row(f"{SIDES[hemi]} hemisphere", surface, values, hemi))
    image = figure(surface_rows, measure, measure.limits)
    return write_picture(folder / "figures" / f"{measure.key}.png", image, measure.title, key=measure.key)


def _signed_log_p(p: Array, sign: Array) -> Array:
    """−log10 p with a sign, NaN where p is not significant."""
    return np.where(p <= SIGNIFICANCE, -np.log10(p) * np.sign(sign), np.nan)


# a model at every vertex -------------------------------------------------------------------------------------


def stats_report(result: Result, summary: Mapping[str, Any], folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/``: effect, r, p_tfce, p_height and subjects; returns the path
    of the page."""
    inference, largest_log_p = result.inference, float(np.log10(1 + result.permutations))
    effect_label = f"Effect of {result.contrast} on {_tested_map(result).label}"
    largest_effect = float(np.nanmax(np.abs(inference.effect))) or 1.0
    effect_quantity = Quantity("effect", effect_label, effect_unit(result), True, (-largest_effect, largest_effect))
    subjects_quantity = Quantity("subjects", "Subjects with a value", limits=(0.0, len(result.design.subjects)))
    maps = {effect_quantity: inference.effect, Quantity("r", "Partial correlation", "", True, (-1.0, 1.0)): inference.r}
    for p_name in ("p_tfce", "p_height"):
        log_p = Quantity(p_name, "−log10 p, with the sign of the effect", "", True, (-largest_log_p, largest_log_p))
        maps[log_p] = _signed_log_p(getattr(inference, p_name), inference.t)
    maps[subjects_quantity] = result.n_values.astype(float)
    return write_page(
        folder / "report.html",
        "stats.html",
        title=f"{result.shown} ~ {result.formula}",
        result=result,
        summary=summary,
        unit=effect_quantity.unit,
        pictures=[picture(result.space, folder, measure, split(result, values)) for measure, values in maps.items()],
        scatter=peak_plot(result, effect_quantity),
        clusters=cluster_rows(result)[:CLUSTERS_SHOWN],
    )


def effect_unit(result: Result) -> str:
    """Unit of the effect: that of the map, for each unit of the regressor unless groups or means are compared."""
    design, unit = result.design, _tested_map(result).unit
    weighed_columns = {name: column for name, w, column in zip(design.columns, design.contrast, design.matrix.T) if w}
    amount_names = [name for name, column in weighed_columns.items() if not np.isin(column, (0.0, 1.0)).all()]
    if not amount_names or weighed_columns.keys() & {*INTERCEPT_NAMES}:
        return unit
    is_age = amount_names in (["age"], ["center(age)"])  # BIDS has it in years
    return f"{unit} per {'year' if is_age else f'unit of {listed(amount_names)}'}".strip()


def peak_plot(result: Result, effect: Quantity) -> Markup:
    """The map against what is tested at the vertex with the largest abs(t), both less the other regressors."""
    inference, model = result.inference, Model(result.design.matrix, result.design.contrast)
    x, y = (model.residuals(values) + values.mean() for values in (model.regressor, inference.peak_values))
    limits = limits_around(x.tolist()), limits_around(y.tolist())
    with new_chart(effect.title, result.contrast, _tested_map(result).title, *limits, size=WIDE_CHART_SIZE_PX) as chart:
        slope = float(inference.effect[np.nanargmax(np.abs(inference.t))])
        x_ends = np.array([x.min(), x.max()])
        chart.line(x_ends, y.mean() + slope * (x_ends - x.mean()), "fit", f"{number(slope)} {effect.unit}", color=GREY)
        for x_point, y_point, subject in zip(x, y, result.design.subjects):
            label = f"{subject}: {number(y_point)} at {number(x_point)}"
            chart.line([x_point], [y_point], "point", label, color=CATEGORICAL_COLOURS[0], marker="o", markersize=5)
        return chart.svg()


def _tested_map(result: Result) -> Quantity:
    """The map that is tested: of one side, or the difference or index of asymmetry."""
    measure = quantity(result.map_name)
    label = measure.label.lower()
    if result.asymmetry == "index":
        return Quantity("map", f"asymmetry of {label}")
    return Quantity("map", f"{label}, left − right" if result.asymmetry else label, measure.unit)


# what subjects have in common --------------------------------------------------------------------------------


def overlap_report(space: Space, overlaps: Sequence[Overlap], summary: Mapping[str, Any], folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/``: the density of each kind; returns the page's path."""
    pictures = []
    for overlap in overlaps:
        label, map_key = overlap.kind.capitalize(), DENSITY_MAPS[overlap.kind]
        largest_density = float(max(np.nanpercentile(densities, 99.5) for densities in overlap.density.values())) or 1.0
        measure = Quantity(map_key, f"{label} per area", DENSITY_UNITS[overlap.kind], limits=(0.0, largest_density))
        pictures.append(picture(space, folder, measure, overlap.density))
    return write_page(
        folder / "report.html",
        "overlap.html",
        title="Hinges and crests that subjects share",
        summary=summary,
        kinds=[(each, DENSITY_UNITS[each.kind], share_plot(each.kind.capitalize(), each.rows)) for each in overlaps],
        pictures=pictures,
        whole=WHOLE,
        smallest_p=1 / (1 + summary["rotations"]),
    )
