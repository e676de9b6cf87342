"""The page of a model that was tested at every vertex: effect, corrected p, subjects, and the table of clusters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from morphofold.arrays import Array
from morphofold.inference.design import INTERCEPTS
from morphofold.inference.permutations import Model
from morphofold.inference.study import Result, cluster_rows, split
from morphofold.quantities import CATEGORICAL_COLOURS, Quantity, quantity
from morphofold.report.pages.space_pictures import SIDES, picture
from morphofold.report.pages.templates import write_page
from morphofold.report.plots.charts import WIDE_CHART_SIZE_PX, limits_around, new_chart
from morphofold.report.plots.line_plots import GREY
from morphofold.words import listed, number

SIGNIFICANT = 0.05
CLUSTERS_SHOWN = 20


def stats_report(result: Result, summary: Mapping[str, Any], folder: Path) -> Path:
    """Write ``folder/report.html`` and ``folder/figures/``: effect, r, p_tfce, p_height and subjects; returns the path
    of the page."""
    (folder / "figures").mkdir()
    found, n = result.inference, float(len(result.design.subjects))
    what = Quantity("effect", f"Effect of {result.contrast} on {_map_words(result)}", effect_unit(result), signed=True)
    contrast = f"The contrast {result.contrast} of the coefficients. The colours end at its largest value."
    correlation = "The size of the effect without a unit: t / sqrt(t² + degrees of freedom)."
    counted = "Only vertices where all subjects have a value are tested."
    largest = float(np.nanmax(np.abs(found.effect))) or 1.0
    shown: list[tuple[Quantity, Array, tuple[float, float], str]] = [
        (what, found.effect, (-largest, largest), contrast),
        (Quantity("r", "Partial correlation", signed=True), found.r, (-1.0, 1.0), correlation),
    ]
    for key, how in {"p_tfce": "by threshold-free clusters", "p_height": "of single vertices, by height"}.items():
        p, most = getattr(found, key), float(np.log10(1 + result.permutations))
        log_p = Quantity(key, "−log10 p, with the sign of the effect", signed=True)
        said = f"Corrected for all vertices that are tested, {how}. Grey: p above {SIGNIFICANT}, or not tested."
        values = np.where(p <= SIGNIFICANT, -np.log10(p) * np.sign(found.t), np.nan)
        shown.append((log_p, values, (-most, most), said))
    shown.append((Quantity("subjects", "Subjects with a value"), result.counts.astype(np.float64), (0.0, n), counted))
    pictures = [picture(result.space, folder, of, split(result, v), ends, said) for of, v, ends, said in shown]
    return write_page(
        folder / "report.html",
        "stats.html",
        title=f"{result.shown} ~ {result.formula}",
        result=result,
        summary=summary,
        unit=what.unit,
        pictures=pictures,
        scatter=peak_plot(result, what),
        columns=list(zip(result.design.columns, result.design.contrast, result.design.matrix.T)),
        clusters=cluster_rows(result)[:CLUSTERS_SHOWN],
        half_widths=[found.half_width[one["peak"]] for one in found.clusters],
        sides=SIDES,
        smallest=1 / (1 + result.permutations),
    )


def effect_unit(result: Result) -> str:
    """Unit of the effect: that of the map, for each unit of the regressor unless groups or means are compared."""
    chosen, unit = result.design, _map_unit(result)
    weighed = {name: column for name, w, column in zip(chosen.columns, chosen.contrast, chosen.matrix.T) if w}
    amounts = [name for name, column in weighed.items() if not np.isin(column, (0.0, 1.0)).all()]
    if not amounts or weighed.keys() & {*INTERCEPTS}:
        return unit
    ages = amounts in (["age"], ["center(age)"])  # BIDS has it in years
    return f"{unit} per {'year' if ages else f'unit of {listed(amounts)}'}".strip()


def peak_plot(result: Result, what: Quantity) -> Markup:
    """The map against what is tested at the vertex with the largest abs(t), both less the other regressors."""
    found, model = result.inference, Model(result.design.matrix, result.design.contrast)
    x, y = (model.residuals(values) + values.mean() for values in (model.regressor, found.at_peak))
    label = Quantity("map", _map_words(result), _map_unit(result))
    limits = limits_around(x.tolist()), limits_around(y.tolist())
    with new_chart(what.title, result.contrast, label.title, *limits, size=WIDE_CHART_SIZE_PX) as chart:
        slope = float(found.effect[np.nanargmax(np.abs(found.t))])
        ends = np.array([x.min(), x.max()])
        chart.line(ends, y.mean() + slope * (ends - x.mean()), "fit", f"{number(slope)} {what.unit}", color=GREY)
        for a, b, name in zip(x.tolist(), y.tolist(), result.design.subjects):
            said = f"{name}: {number(b)} at {number(a)}"
            chart.line([a], [b], "point", said, color=CATEGORICAL_COLOURS[0], marker="o", markersize=5)
        return chart.svg()


def _map_unit(result: Result) -> str:
    return "" if result.asymmetry == "index" else quantity(result.map).unit


def _map_words(result: Result) -> str:
    words = quantity(result.map).label.lower()
    return {None: words, "difference": f"{words}, left − right", "index": f"asymmetry of {words}"}[result.asymmetry]
