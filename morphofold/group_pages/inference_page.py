"""The page of an inference: the result in a sentence, agreement against heterogeneity, controls, what a map means.

In goes an :class:`~morphofold.inference.inference.Inference`, out come ``report.html``, ``figures/`` and a comparison
with linked views; words are in ``templates/inference.html``.
"""

from pathlib import Path

import numpy as np
from markupsafe import Markup

from morphofold.comparison import compare
from morphofold.comparison.person.fold_heights import BANDS, FOLD_DEGREES, band, fold_heights
from morphofold.inference.inference import Grown, Inference
from morphofold.quantities import RELIEF, Quantity, quantity
from morphofold.report.pages.cortex_pages import comparison_report
from morphofold.report.pages.page_writer import write_page, write_picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.report.plots.charts import WIDE_CHART_SIZE_PX, limits_around, new_chart
from morphofold.report.plots.figure_style import BLACK, GREY
from morphofold.surface import Surface

GROWTH_FACTOR = Quantity("growth_factor", "Factor on the growth", limits=(0.4, 1.6))


def inference_report(inference: Inference, folder: Path) -> Path:
    """Write ``folder/report.html``, ``folder/figures/`` and ``folder/comparison/``; return the path of the page."""
    spread = inference.shown_spread
    best = inference.by_spread[spread][0]
    shown = [*inference.by_spread.get(0.0, [])[:1], best, *[body for body in inference.grown if body.run.turn][:1]]
    names = [_label(body) for body in shown]
    named = {inference.person.cortex.name: inference.person}
    named |= {name: body.comparison.bodies.grown.measures for name, body in zip(names, shown)}
    comparison_report(compare(named, spins=best.comparison.spins), folder / "comparison")
    (folder / "figures").mkdir(exist_ok=True)
    return write_page(
        folder / "report.html",
        "inference.html",
        title=f"Growth that would fold like {inference.person.cortex.name}",
        inference=inference,
        spread=spread,
        shown=names,
        bands=BANDS,
        fold_degrees=FOLD_DEGREES,
        curve=curve(inference),
        heights=write_picture(folder / "figures/heights.png", _heights(inference, shown), "Heights of folds"),
        growth_map=write_picture(folder / "figures/map.png", _map(inference), "Growth map"),
    )


def _label(body: Grown) -> str:
    kind = "map turned away, " if body.run.turn else ""
    return f"{kind}{100 * body.run.spread:g} %" if body.run.spread else "grown evenly"


def curve(inference: Inference) -> Markup:
    """Correlation of folds with the person's against heterogeneity: a dot for each body, controls as grey lines."""
    dots = [(body.run.spread, body.agreement, body.run) for body in inference.grown]
    spreads, values, _ = zip(*dots)
    limits = limits_around([0.0, *spreads]), limits_around([0.0, 1.0, *values])
    titles = "Correlation of folds with the person’s", "heterogeneity of growth", "correlation"
    with new_chart(*titles, *limits, size=WIDE_CHART_SIZE_PX, right=150.0) as chart:
        for name in ("before growth", "sulci deepened"):
            value = inference.controls[name]
            chart.line(limits[0], (value, value), "control", f"{name}: {value:.2f}", color=GREY, linestyle="--")
            chart.ax.text(limits[0][1], value, f" {name}", va="center")
        means = [(a, np.mean([body.agreement for body in each])) for a, each in inference.by_spread.items() if each]
        mean_spreads, mean_values = zip(*means)
        chart.line(mean_spreads, mean_values, "mean", "mean over seeds", color=BLACK)
        for spread, value, run in dots:
            style = {"fillstyle": "none", "color": GREY} if run.turn else {"color": BLACK}
            chart.line(spread, value, "point", f"{run.name}: {value:.2f}", marker="o", markersize=7, **style)
        return chart.svg()


def _heights(inference: Inference, shown: list[Grown]) -> np.ndarray:
    """Heights of folds of person and bodies, in the degrees that are compared, on the smooth body, which hides none."""
    bodies = shown[0].comparison.bodies
    labelled = [(inference.person.cortex.name, bodies.person)]
    labelled += [(_label(body), body.comparison.bodies.grown) for body in shown]
    rows = []
    for label, body in labelled:
        heights = band(fold_heights(body.points, body.measures.maps[RELIEF], body.weights))(body.points)[:, 0]
        surface = Surface(bodies.smooth(body.points), body.pial.faces)
        rows.append(Row(label, surface, np.where(body.cortex, heights, np.nan), inference.plan.cortex.hemi))
    return figure(rows, quantity(RELIEF))


def _map(inference: Inference) -> np.ndarray:
    cortex = inference.plan.cortex
    surface = cortex.inflated or inference.plan.subject.unfolding.smooth()
    return figure(
        [Row("growth map", surface, inference.final_factors, cortex.hemi)], GROWTH_FACTOR, GROWTH_FACTOR.limits
    )
