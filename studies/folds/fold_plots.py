"""Wavelength of simulated folds and of theory against cortical thickness: the picture of a study of folds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.report.plots.figure_style import BLACK, GREY, legend_of_figure, line_style, new_figure
from morphofold.studies.folds.fold_agreement import SCENES_BY_LAW
from morphofold.studies.markdown import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: prefix of the columns of a line in slope.tsv -> how it is drawn
LINE_STYLES: dict[str, dict[str, Any]] = {"theory": {"color": BLACK}, "film": {"color": GREY, "linestyle": ":"}}


def thickness_figure(folds: Sequence[Row], slopes: Sequence[Row], summary: dict[str, Any]) -> Figure:
    """Wavelength against thickness, one panel per growth law: each seed is a point; theory is drawn as lines."""
    level = summary["parameters"]["all_seeds_at_level"]
    line_rows = [row for row in slopes if (row["number"], row["level"]) == ("wavelength_mm", level)]
    growths = list(dict.fromkeys(row["growth"] for row in line_rows))
    scene_names = {scene_name for body_names in SCENES_BY_LAW for scene_name in body_names}
    folds = [row for row in folds if row["scene"] in scene_names and row["level"] == level]
    largest_T = 1.15 * max(row["thickness_mm"] for row in folds)
    longest_wave = max(max(row["wavelength_mm"] or 0, row["theory_wavelength_mm"]) for row in folds)
    laws = list(dict.fromkeys(row["law"] for row in line_rows))
    with new_figure(4.4 * len(laws) + 0.6, 4.8, 1, len(laws), sharey=True) as (figure, panels):
        for ax, law in zip(panels[0], laws):
            law_rows = [row for row in line_rows if row["law"] == law]
            _draw(ax, [row for row in folds if row["law"] == law], law_rows, growths, largest_T)
            ax.set(xlim=(0, largest_T), ylim=(0, 1.1 * longest_wave), title=f"{law} growth, {level}")
            ax.set(xlabel="thickness of the cortex before growth  $T$, mm")
        panels[0][0].set(ylabel="wavelength of the folds, mm")
        legend_entries: dict[str, Any] = {
            "linear stability": LINE_STYLES["theory"],
            "film formula": LINE_STYLES["film"],
            **{f"$g$ = {g:.2f}": _of_growth(growth_index) for growth_index, g in enumerate(growths)},
        }
        legend_of_figure(figure, legend_entries, panels[0][0], columns=3)
    return figure


def _draw(ax: Axes, folds: Sequence[Row], line_rows: Sequence[Row], growths: Sequence[float], largest_T: float) -> None:
    T = np.array([0.0, largest_T])
    for name, style in LINE_STYLES.items():
        ax.plot(T, line_rows[0][f"{name}_intercept"] + line_rows[0][f"{name}_slope"] * T, **style)
    for growth_index, g in enumerate(growths):
        points = [(r["thickness_mm"], r["wavelength_mm"]) for r in folds if r["growth"] == g and r["wavelength_mm"]]
        style = _of_growth(growth_index)
        ax.plot([point[0] for point in points], [point[1] for point in points], **{**style, "linestyle": "none"})
        for line_row in line_rows:
            if line_row["growth"] == g and line_row["slope"] is not None:
                ax.plot(T, line_row["intercept"] + line_row["slope"] * T, color=style["color"], linewidth=0.8)


def _of_growth(rank: int) -> dict[str, Any]:
    return {"color": line_style(rank)["color"], "marker": "os^Dv<>p"[rank % 8], "markersize": 4.5, "linewidth": 0.8}
