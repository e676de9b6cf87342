"""Phase diagrams of a sweep, with theory: ``Phases`` and one of the :data:`SHOWN_MEASURES` go in, a matplotlib
``Figure`` comes out: a coloured cell per point of two varied keys, or a curve over one. The page of a sweep shows them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, product
from statistics import stdev
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from morphofold.group.sweep import AREA_OVER_FLAT, HINGES_PER_AREA, Phases, RunResult
from morphofold.group.sweep_grid import Axis, GridIndex
from morphofold.number_texts import number
from morphofold.quantities import CATEGORICAL_COLOURS, Quantity, round_out
from morphofold.report import colours
from morphofold.report.pictures.surfaces import Row, draw
from morphofold.report.plots.figure_style import (
    BLACK,
    GREY,
    NO_FORMULAS,
    Style,
    colour_bar,
    legend_of_figure,
    new_figure,
    round_step,
)
from morphofold.sim.scene.table_bases import unit_of
from morphofold.surface import Surface

THUMBNAIL_PX = 380
BOUNDARY_LABEL = "final growth = theory's critical growth"
WAVELENGTH_KEY = "wavelength_mm"
ROUND_OFF = 1e-3  # of the measures shown, in their units
#: the measures of the diagrams; the first limit is the lower end of their colours and axes
SHOWN_MEASURES = (
    Quantity("gyrification_index", "Gyrification index", limits=(1.0, math.inf)),
    Quantity(WAVELENGTH_KEY, "Wavelength of folds", "mm", limits=(0.0, math.inf)),
    Quantity(HINGES_PER_AREA, "Hinges per area", "1/1000 mm²", limits=(0.0, math.inf)),
)
AREA_RATIO = Quantity(AREA_OVER_FLAT, "Pial / flat area", limits=(1.0, math.inf))


@dataclass(frozen=True)
class Cell:
    """A measure at one point: the runs, one per seed, and the values of those that have it."""

    runs: Sequence[RunResult]
    values: list[float]

    @property
    def failed(self) -> int:
        """The number of runs that failed."""
        return sum(bool(run.reason) for run in self.runs)

    @property
    def mean(self) -> float:
        """NaN if no run has the measure."""
        return float(np.mean(self.values)) if self.values else math.nan

    @property
    def lines(self) -> list[str]:
        """The text of the cell, at most three short lines: mean, sample standard deviation, how many runs have it.

        A star marks a mean with runs that are not healthy.
        """
        n_values, n_runs = len(self.values), len(self.runs)
        if not n_values:
            return ["failed" if self.failed == n_runs else "–"]
        mean_text = number(float(f"{self.mean:.3g}"))  # so that 0.99999 and 1.00001 are both 1.00
        lines = [mean_text + "*" * any(run.warnings for run in self.runs)]
        if n_values > 1:
            sd, n_decimals = stdev(self.values), len(mean_text.partition(".")[2])  # as many as the mean
            sd_text = f"{sd:.{n_decimals}f}"
            lines.append(f"± {number(sd, 1) if sd > ROUND_OFF and not float(sd_text) else sd_text}")
        return lines if n_values == n_runs else [*lines, f"({n_values} of {n_runs})"]


def plotted_measures(phases: Phases) -> tuple[Quantity, ...]:
    """The measures that are meaningful for the shape of a sweep.

    A patch or strip has a border, so it has no gyrification index; its area over that of the flat piece is used
    instead. A strip is a section through folds: it has no hinges, and it is too narrow to measure a wavelength.
    """
    measures_by_shape = {"strip": (AREA_RATIO,), "patch": (AREA_RATIO, *SHOWN_MEASURES[1:])}
    return measures_by_shape.get(phases.grid.points[0].scene.geometry.shape, SHOWN_MEASURES)


def values_of(runs: Iterable[RunResult], key: str) -> list[float]:
    """A measure of the runs that have it."""
    return [value for run in runs if math.isfinite(value := run.measures.get(key, math.nan))]


def cell(phases: Phases, index: GridIndex, key: str) -> Cell:
    """A measure over the seeds of one point."""
    runs = phases.runs_at[index]
    return Cell(runs, values_of(runs, key))


def limits_of(phases: Phases, measure: Quantity) -> colours.Limits:
    """From the lower end to the largest value of any run, rounded up: the same for all diagrams of a sweep."""
    lower_limit = measure.limits[0] if measure.limits else 0.0
    largest_above = max([*values_of(phases.runs, measure.key), lower_limit]) - lower_limit
    return lower_limit, lower_limit + (round_out(largest_above) if largest_above > ROUND_OFF else 1.0)


def slices(phases: Phases) -> list[GridIndex]:
    """Indices on the third and further axes, one diagram each; one empty index if there are no such axes."""
    return sorted({index[2:] for index in phases.runs_at})


def growth_past_critical(phases: Phases, index: GridIndex) -> float:
    """Final growth of the scene at a point minus theory's critical growth; NaN where theory has none."""
    return phases.grid.scenes[index].growth.final - phases.theory[index].g_crit


# diagrams ----------------------------------------------------------------------------------------------------


def diagram(phases: Phases, measure: Quantity, slice_index: GridIndex = ()) -> Figure:
    """A measure over the first two axes, at ``slice_index`` of the further axes: a cell for each point.

    The dashed line is where final growth equals theory's critical growth, interpolated linearly between numbers. Words
    have no order, so there is no line between them.
    """
    colour_limits = limits_of(phases, measure)
    cells = {index[:2]: cell(phases, index, measure.key) for index in phases.runs_at if index[2:] == slice_index}
    n_columns, n_rows = grid_shape = [len(axis.values) for axis in phases.grid.axes[:2]]
    cell_means = np.reshape([point_cell.mean for point_cell in cells.values()], grid_shape).T
    rgb = colours.apply(cell_means, colour_limits, signed=False)
    figure_size = (max(4.8, 1.15 * n_columns + 2.2), max(3.4, 0.95 * n_rows + 1.4))
    with new_figure(*figure_size, style=NO_FORMULAS) as (figure, ((ax,),)):
        ax.grid(False)
        ax.imshow(rgb, origin="lower", aspect="auto", interpolation="nearest")
        for (i, j), point_cell in cells.items():
            if point_cell.failed:
                ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fill=False, hatch="////", ec="#8a8a86", lw=0))
            cell_lines = [*point_cell.lines, *_theory_text(phases, (i, j, *slice_index), measure)]
            box = {"facecolor": rgb[j, i] / 255, "edgecolor": "none", "pad": 1.5}  # above hatches and line of theory
            text_style: Style = {"ha": "center", "va": "center", "fontsize": 9.5, "zorder": 5, "bbox": box}
            ax.text(i, j, "\n".join(cell_lines), color=colours.ink(rgb[j, i]), **text_style)
        _draw_boundary(ax, phases, slice_index)
        if ax.collections:  # the line lies inside
            legend_of_figure(figure, {BOUNDARY_LABEL: {"color": BLACK, "linestyle": "--"}}, ax, columns=1)
        _name_axes(ax, phases)
        ax.tick_params(length=0)
        ax.set(title=measure.label + fixed_parameters_text(phases, slice_index))
        if np.isfinite(cell_means).any():
            colour_bar(figure, measure.title, colour_limits, ax=ax, pad=0.02)
    return figure


def _name_axes(ax: Axes, phases: Phases) -> None:
    for axis, varied in zip((ax.xaxis, ax.yaxis), phases.grid.axes):
        axis.set_ticks(range(len(varied.texts)), [w if len(w) <= 16 else f"{w[:8]}…{w[-7:]}" for w in varied.texts])
        axis.set_label_text(axis_title(phases, varied))


def thumbnails(phases: Phases, surfaces: Mapping[GridIndex, Surface | str], view: str, largest: float) -> Figure:
    """Bare surfaces in place of the cells of a :func:`diagram`, or a text; ``largest`` mm fill 0.94 of a cell."""
    n_columns, n_rows = ([len(axis.values) for axis in phases.grid.axes] + [1, 1])[:2]
    cell_inches = min(1.6, 8.5 / n_columns)
    # letters are small, since it is shown at its size, diagrams at half of theirs
    style = {**NO_FORMULAS, "axes.grid": False, "font.size": 7, "axes.labelsize": 7}
    with new_figure(cell_inches * n_columns + 1.2, cell_inches * n_rows + 1.1, style=style) as (figure, ((ax,),)):
        ax.set(xticks=[], yticks=[])
        for index, surface in surfaces.items():
            i, j = (*index, 0, 0)[:2]
            if isinstance(surface, Surface):
                image_size, px_per_mm = (THUMBNAIL_PX, THUMBNAIL_PX), 0.94 * THUMBNAIL_PX / largest
                image = draw(Row("", surface), view, image_size, px_per_mm)
                ax.imshow(image, extent=(i - 0.5, i + 0.5, j - 0.5, j + 0.5))
            else:
                ax.add_patch(Rectangle((i - 0.47, j - 0.47), 0.94, 0.94, color="0.957"))
                ax.text(i, j, surface, ha="center", va="center", color="0.35")
        _name_axes(ax, phases)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        ax.set(xlim=(-0.5, n_columns - 0.5), ylim=(-0.5, n_rows - 0.5))
        span = round_step(largest / 3)
        bar = AnchoredSizeBar(ax.transData, 0.94 * span / largest, f"{span:g} mm", "upper right", frameon=False, pad=0)
        bar.set_bbox_to_anchor((0, 0), ax.transAxes)
        ax.add_artist(bar)
    return figure


def _theory_text(phases: Phases, index: GridIndex, measure: Quantity) -> list[str]:
    """Theory's line in a cell: its wavelength below the measured one, its critical growth below gyrification."""
    theory = phases.theory[index]
    theory_numbers = {WAVELENGTH_KEY: ("theory", theory.wavelength), SHOWN_MEASURES[0].key: ("theory g", theory.g_crit)}
    label, value = theory_numbers.get(measure.key, ("", math.nan))
    return [f"{label} {number(value)}"] if math.isfinite(value) else []


def _draw_boundary(ax: Axes, phases: Phases, slice_index: GridIndex) -> None:
    """Draw the line between folded and smooth, if it lies inside; one piece per word if an axis has words."""
    axis_kinds = [(axis.numeric, len(axis.values)) for axis in phases.grid.axes[:2]]
    index_ranges = ([range(n)] if is_numeric else [range(k, k + 1) for k in range(n)] for is_numeric, n in axis_kinds)
    for columns, rows in product(*index_ranges):
        growth_past = np.array([[growth_past_critical(phases, (i, j, *slice_index)) for i in columns] for j in rows])
        if (growth_past < 0).any() and (growth_past > 0).any():
            x, y = ([indices[0] - 0.5, *indices, indices[-1] + 0.5] for indices in (columns, rows))
            padded_growth = np.pad(growth_past, 1, mode="edge")
            for colour, width in (("white", 4.0), (BLACK, 1.9)):
                ax.contour(x, y, padded_growth, levels=[0.0], colors=[colour], linewidths=width, linestyles="--")


# curves ------------------------------------------------------------------------------------------------------


def curve(phases: Phases, measure: Quantity) -> Figure:
    """A measure over one axis: seeds as dots, means as a line, theory's wavelength dashed, its critical growth dotted.

    Words have no order, so nothing is joined: means and theory are horizontal marks.
    """
    (axis,), several_seeds, (y_low, y_high) = phases.grid.axes, len(phases.grid.seeds) > 1, limits_of(phases, measure)
    values_and_points = [*zip(axis.values if axis.numeric else count(), phases.runs_at)]
    x, ordered_index = zip(*sorted(values_and_points))
    mark_style: Style = {"linestyle": "", "marker": "_", "markersize": 26}
    mean_style, theory_style = ({}, {"linestyle": "--", "marker": "."}) if axis.numeric else (mark_style, mark_style)
    with new_figure(6.2, 3.9, style=NO_FORMULAS) as (figure, ((ax,),)):
        cells = {index: cell(phases, index, measure.key) for index in ordered_index}
        for axis_value, index in values_and_points:
            _draw_seeds(ax, axis_value, cells[index], measure.key)
        cell_means = [point_cell.mean for point_cell in cells.values()]
        if np.isfinite(cell_means).any() and (axis.numeric or several_seeds):
            label = "mean over seeds" if several_seeds else "measured"
            ax.plot(x, cell_means, color=CATEGORICAL_COLOURS[0], label=label, **mean_style)
        theory_wavelengths = [phases.theory[index].wavelength for index in ordered_index]
        if measure.key == WAVELENGTH_KEY and np.isfinite(theory_wavelengths).any():
            ax.plot(x, theory_wavelengths, color=BLACK, label="theory, first wrinkles", **theory_style)
            y_high = max(y_high, 1.08 * np.nanmax(theory_wavelengths))
        if axis.numeric:
            growth_past = np.array([growth_past_critical(phases, index) for index in ordered_index])
            for k, crossing in enumerate(crossings(np.array(x), growth_past)):
                ax.axvline(crossing, color=GREY, linestyle=":", label=None if k else BOUNDARY_LABEL)
            ax.set(xlabel=axis_title(phases, axis))
        else:
            _name_axes(ax, phases)
        margin = 0.04 * (y_high - y_low)
        ax.set(title=measure.label, ylabel=measure.title, ylim=(y_low - margin, y_high + margin))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _draw_seeds(ax: Axes, x: float, cell: Cell, key: str) -> None:
    """Draw a dot for each run at a point of the axis, a cross on one that is not healthy, and how many failed."""
    unhealthy_values = values_of([run for run in cell.runs if run.warnings], key)
    ax.plot([x] * len(cell.values), cell.values, "o", color=CATEGORICAL_COLOURS[0], markersize=5, alpha=0.6)
    ax.plot([x] * len(unhealthy_values), unhealthy_values, "x", color=BLACK, markersize=7)
    if cell.failed:
        foot = ("data", "axes fraction")
        ax.annotate(f"{cell.failed} failed", (x, 0), (0, 4), foot, "offset points", ha="center", color=GREY, fontsize=9)


def crossings(x: np.ndarray, y: np.ndarray) -> list[float]:
    """Where a curve, linear between its points (N,), crosses zero."""
    segment = np.flatnonzero(y[:-1] * y[1:] < 0)
    return list(x[segment] + np.diff(x)[segment] * y[segment] / (y[segment] - y[segment + 1]))


def axis_title(phases: Phases, axis: Axis) -> str:
    """Label of a varied key, with its unit."""
    *table_names, key = axis.key.split(".")
    scene_part: Any = phases.grid.points[0].scene
    for table_name in table_names:
        scene_part = scene_part[table_name] if isinstance(scene_part, dict) else getattr(scene_part, table_name)
    return Quantity("", axis.label, unit_of(type(scene_part), key)).title


def fixed_parameters_text(phases: Phases, slice_index: GridIndex) -> str:
    """The values on the third and further axes, as the end of a title."""
    fixed_text = ", ".join(f"{axis.label} = {axis.texts[i]}" for axis, i in zip(phases.grid.axes[2:], slice_index))
    return f" at {fixed_text}" if fixed_text else ""
