"""Charts of the pages as inline SVG: distributions, gyral against cortical thickness, the law of folding, numbers
over growth.

A mark shows its text when the pointer is over it. Names are escaped, and no text is parsed as a formula.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from markupsafe import Markup, escape

from morphofold.comparison.thickness import Cloud
from morphofold.report.plots.line_plots import BLACK, GREY, NO_FORMULAS, blank_figure, ticks
from morphofold.words import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = {"circle": "o", "square": "s", "triangle": "^", "diamond": "D"}  # name on pages -> matplotlib's name
DASHES = ("", "7 3", "2 3", "9 3 2 3")
THEORY_DASHES = (0, (8, 5))
CHART_SIZE_PX = (430.0, 250.0)  # [px] of a chart, two side by side
WIDE_CHART_SIZE_PX = (880.0, 430.0)
MARGINS_PX = (56.0, 14.0, 12.0, 38.0)  # [px] left, right, top, bottom
#: added to the style of all plots for pages: text set by the browser, and lengths in pixels
PAGE_STYLE = {"svg.fonttype": "none", "lines.scale_dashes": False, "lines.linewidth": 1.7, **NO_FORMULAS}
NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))


class Look(Protocol):
    """Name and look of a surface, or of a side of a group."""

    @property
    def name(self) -> str: ...
    @property
    def colour(self) -> str: ...
    @property
    def marker(self) -> str: ...
    @property
    def dash(self) -> str: ...


@dataclass(frozen=True, eq=False)
class Chart:
    """Axes in pixels, and the texts that marks show under the pointer."""

    figure: Figure
    ax: Axes
    size: tuple[float, float]
    title: str
    titles: list[str] = field(default_factory=list)

    def reads(self, words: str) -> str:
        """Register the text of a mark; return the address (url) to give to the mark."""
        self.titles.append(words)
        return f"{len(self.titles) - 1}"

    def line(self, x: Any, y: Any, kind: str, words: str | None = None, **style: Any) -> None:
        """Draw a line, or marks if the style has a marker."""
        style = {"linestyle": "none", **style} if "marker" in style else style
        self.ax.plot(x, y, gid=kind, url=None if words is None else self.reads(words), clip_on=False, **style)

    def points(self, x: Sequence[float], y: Sequence[float], words: Sequence[str], look: Look, *, big: bool) -> None:
        self.ax.scatter(
            x,
            y,
            s=(14 if big else 7) ** 2,
            color=look.colour,
            marker=MARKERS[look.marker],
            alpha=0.72,
            edgecolors="white",
            linewidths=0.6,
            zorder=3,
            clip_on=False,
            gid="point",
            urls=list(map(self.reads, words)),
        )

    def svg(self) -> Markup:
        """The drawing as SVG, ready for a page."""
        file = io.StringIO()
        self.figure.savefig(file, format="svg", metadata=NO_METADATA)
        drawn = file.getvalue().partition("</defs>")[2]  # the first definitions are a style for the whole page
        drawn = drawn.replace('<g id="', '<g class="')  # ids are the same in all charts
        drawn = re.sub(
            r'<a xlink:href="(\d+)" target="_blank">(.*?)</a>',
            lambda mark: f"<g><title>{escape(self.titles[int(mark[1])])}</title>{mark[2]}</g>",
            drawn,
            flags=re.DOTALL,
        )
        return Markup(
            '<svg class="chart" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}" xmlns="http://www.w3.org/2000/svg">'
            "<title>{}</title>{}"
        ).format(*self.size, self.title, self.title, Markup(drawn))


@contextmanager
def new_chart(
    title: str,
    x_label: str,
    y_label: str,
    x: tuple[float, float],
    y: tuple[float, float],
    size: tuple[float, float] = CHART_SIZE_PX,
    right: float = MARGINS_PX[1],
    left: float = MARGINS_PX[0],
) -> Iterator[Chart]:
    """A chart with given limits and margins ``right`` and ``left`` [px]."""
    inches = 72.0  # pixels per inch in an SVG, where a point is a pixel
    (width, height), (_, _, top, bottom) = size, MARGINS_PX
    style = {**PAGE_STYLE, "svg.hashsalt": title}  # so that no two charts share ids
    with blank_figure(width / inches, height / inches, None, style) as figure:
        ax = figure.subplots()
        figure.subplots_adjust(left / width, bottom / height, 1 - right / width, 1 - top / height)
        figure.patch.set_visible(False)
        ax.patch.set_visible(False)
        for axis, about in ((ax.xaxis, 6), (ax.yaxis, 4)):
            at = ticks(*(x if axis is ax.xaxis else y), about)
            axis.set_ticks(at, [f"{t:.6g}".replace("-", "−") for t in at])
        ax.set(xlim=x, ylim=y, xlabel=x_label, ylabel=y_label)
        ax.yaxis.set_label_coords(14 / width, (height + bottom - top) / 2 / height, figure.transFigure)
        yield Chart(figure, ax, size, title)


def line_of(look: Look) -> dict[str, Any]:
    """Colour and dashes of a line, for matplotlib."""
    dashes = tuple(map(float, look.dash.split()))
    return {"color": look.colour, "linestyle": (0, dashes) if dashes else "-"}


def histograms(
    series: Sequence[tuple[Look, np.ndarray, np.ndarray]],
    label: str,
    unit: str,
    bins: int | np.ndarray = 48,
    counted: str = "",
) -> Markup | None:
    """Distributions in one chart, with the same bins: area-weighted, or counts.

    Parameters
    ----------
    series : sequence of (look, values (N,), weights (N,))
        NaN values are left out; each distribution is normalised over all its measured area.
    label, unit : str
        Of the quantity; the vertical axis is share of area per unit.
    bins : int or array
        Number of equal bins between the least 0.5th and the greatest 99.5th percentile of any surface; or bin edges.
    counted : str
        What is counted ("subjects"), to draw the number of values per bin instead.

    Returns
    -------
    svg : Markup, or None if no surface has a value.
    """
    ends = [np.percentile(v[np.isfinite(v)], [0.5, 99.5]) for _, v, _ in series if np.isfinite(v).any()]
    if not ends:
        return None
    if isinstance(bins, int):
        low, high = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
        wide = max(0.02 * (high - low), 1e-6 * max(abs(low), abs(high))) or 0.5  # bins wider than round-off
        edges = np.linspace(low - wide, high + wide, bins + 1)
    else:
        edges = bins
    curves = []
    for look, values, weights in series:
        known = np.isfinite(values)
        if known.any() and weights[known].sum() > 0:
            density = np.histogram(values[known], edges, weights=None if counted else weights[known])[0]
            if not counted:
                density = density / weights[known].sum() / np.diff(edges)
            curves.append((look, density, weighted_median(values[known], weights[known])))
    if not curves:
        return None
    top = max(float(density.max()) for _, density, _ in curves) or 1.0
    up = counted or (f"share of area per {unit}" if unit else "share of area")
    across = f"{label} [{unit}]" if unit else label
    limits = (float(edges[0]), float(edges[-1])), (0.0, 1.08 * top)
    with new_chart(f"Distribution of {label}", across, up, *limits) as chart:
        for look, density, median in curves:
            words = f"{look.name}: median {number(median)} {unit}".strip()
            chart.ax.stairs(
                density,
                edges,
                fill=True,
                facecolor=(look.colour, 0.12),
                edgecolor=look.colour,
                linewidth=1.7,
                linestyle=line_of(look)["linestyle"],
                gid="curve",
                url=chart.reads(words),
                clip_on=False,
            )
            if edges[0] <= median <= edges[-1]:
                chart.line([median], [0], "median", color=look.colour, marker=10, markersize=8)  # a caret
        return chart.svg()


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Smallest value at or below which at least half the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def thickness_plot(
    clouds: Sequence[tuple[Look, Cloud]],
    lines: Sequence[tuple[float, str]],
    *,
    from_zero: bool = True,
    size: tuple[float, float] = WIDE_CHART_SIZE_PX,
) -> Markup | None:
    """Gyral against cortical thickness, every surface in one plot, with theoretical lines through the origin.

    Parameters
    ----------
    clouds : sequence of (look, Cloud)
        A fit whose slope is not different from 0 is drawn faint.
    lines : sequence of (slope [mm/mm], label)
    from_zero : bool
        Axes begin at 0; otherwise they enclose the points.
    size : (width, height)
        In pixels.

    Returns
    -------
    svg : Markup, or None if there is no point.
    """
    marks = [p for _, cloud in clouds for p in (*cloud.points, *cloud.bins)]
    if not marks:
        return None
    right, top = 1.12 * max(p.cortical for p in marks), 1.12 * max(max(p.gyral, p.high or 0) for p in marks)
    across, up = (0.0, right), (0.0, top)
    if not from_zero:
        across = limits_around([p.cortical for p in marks])
        up = limits_around([y for p in marks for y in (p.low, p.gyral, p.high) if y is not None])
    labels = "Cortical thickness [mm]", "Gyral thickness [mm]"
    with new_chart("Gyral thickness against cortical thickness", *labels, across, up, size) as chart:
        for slope, label in lines:
            end = min(right, top / slope)
            chart.line([0, end], [0, end * slope], "theory", label, color=GREY, linestyle=THEORY_DASHES)
        for look, cloud in clouds:
            _draw_cloud(chart, look, cloud)
        return chart.svg()


def limits_around(values: Sequence[float]) -> tuple[float, float]:
    """Limits a little outside the least and greatest value."""
    low, high = min(values), max(values)
    edge = 0.06 * (high - low) if high - low > 1e-6 * max(abs(low), abs(high)) else 0.1 * abs(high) or 1.0
    return low - edge, high + edge


def _draw_cloud(chart: Chart, look: Look, cloud: Cloud) -> None:
    """Draw bins as crossed bars (median and quartiles), the fit, and the points."""
    for p in cloud.bins:
        bar: dict[str, Any] = {"color": look.colour, "linewidth": 1.4, "alpha": 0.75}
        chart.line([p.cortical, p.cortical], [p.low, p.high], "bin", f"{look.name}, {p.label}", **bar)
        chart.line([p.cortical], [p.gyral], "bin", f"{look.name}, {p.label}", **bar, marker="_", markersize=8)
    if cloud.fit is not None:
        marks = [p.cortical for p in cloud.points or cloud.bins]
        ends = np.array([min(marks), max(marks)])
        faint: dict[str, Any] = {} if cloud.fit.sloped else {"linewidth": 1.0, "alpha": 0.45}
        kind = "fit" if cloud.fit.sloped else "fit faint"
        chart.line(ends, cloud.fit.at(ends), kind, **line_of(look), **faint)
    if cloud.points:
        words = [f"{look.name}, {p.label}: {number(p.gyral)} mm at {number(p.cortical)} mm" for p in cloud.points]
        x, y = ([getattr(p, key) for p in cloud.points] for key in ("cortical", "gyral"))
        chart.points(x, y, words, look, big=len(cloud.points) == 1)


def folding_plot(surfaces: Sequence[tuple[Look, Any]], paths: Sequence[tuple[str, Sequence[Any]]]) -> Markup | None:
    """The law of folding: total area times root thickness against exposed area (decimal logarithms), lines of equal k.

    Parameters
    ----------
    surfaces : sequence of (look, ShapeTerms)
    paths : sequence of (name, sequence of ShapeTerms)
        Growing bodies, drawn dashed.

    Returns
    -------
    svg : Markup, or None if there is no surface.
    """
    if not surfaces:
        return None

    def place(t: Any) -> tuple[float, float]:
        return float(np.log10(t.exposed)), float(np.log10(t.total * np.sqrt(t.thickness)))

    every = np.array([place(t) for t in [*(t for _, t in surfaces), *(t for _, path in paths for t in path)]])
    (x0, y0), (x1, y1) = (every.min(axis=0) - 0.06).tolist(), (every.max(axis=0) + 0.06).tolist()
    labels = "log\u2081\u2080 exposed area [mm²]", "log\u2081\u2080 total area × √thickness [mm² √mm]"
    with new_chart("The law of folding", *labels, (x0, x1), (y0, y1), (880.0, 400.0), right=60.0) as chart:
        for k in (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5):
            ends = np.array([max(x0, (y0 - np.log10(k)) / 1.25), min(x1, (y1 - np.log10(k)) / 1.25)])
            if ends[1] - ends[0] > 0.02:
                heights = 1.25 * ends + np.log10(k)
                chart.line(ends, heights, "level", f"k = {k:g}", color="#cdd2d8", linewidth=1.0)
                chart.ax.text(ends[1], heights[1], f" k = {k:g}", va="center")
        for name, path in paths:
            x, y = np.array([place(t) for t in path]).T
            chart.line(x, y, "theory", name, color=GREY, linestyle=THEORY_DASHES)
        for look, t in surfaces:
            exposed, total = place(t)
            chart.points([exposed], [total], [f"{look.name}: k = {number(t.k)}"], look, big=True)
        return chart.svg()


def growth_chart(
    label: str, curves: Sequence[tuple[str, np.ndarray, np.ndarray]], others: Sequence[tuple[Look, float]]
) -> Markup | None:
    """A number over growth (black), with the values of other surfaces as horizontal lines in their colours.

    Parameters
    ----------
    label : str
        Name of the number.
    curves : sequence of (name, growth (G,), values (G,))
        NaN values are left out.
    others : sequence of (look, value)

    Returns
    -------
    svg : Markup, or None if no curve has a value.
    """
    known = [(name, g[np.isfinite(v)], v[np.isfinite(v)]) for name, g, v in curves if np.isfinite(v).any()]
    if not known:
        return None
    g = np.concatenate([g for _, g, _ in known])
    top = 1.12 * max([float(v.max()) for _, _, v in known] + [value for _, value in others])
    across = float(g.min()) - 0.02, float(g.max()) + 0.02
    with new_chart(f"{label} over growth", "growth g", label, across, (0.0, top)) as chart:
        for look, value in others:
            chart.line(across, (value, value), "fit", **line_of(look))
        for name, at, values in known:
            chart.line(at, values, "theory", name, color=GREY, linestyle=THEORY_DASHES)
            for x, y in zip(at.tolist(), values.tolist()):
                words = f"{name}, g = {x:.2f}: {number(y)}"
                chart.line([x], [y], "point", words, color=BLACK, marker="o", markersize=6)
        return chart.svg()
