"""Charts of the pages: numbers and the looks of surfaces go in, inline SVG comes out; None if there is none to draw.

A mark shows its text when the pointer is over it. Names are escaped, and no text is parsed as a formula.
"""

import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morphofold.comparison.thickness_plot_data import Cloud
from morphofold.number_texts import number
from morphofold.quantities import Quantity
from morphofold.report.colours import Limits
from morphofold.report.plots.figure_style import BLACK, GREY, NO_FORMULAS, Style, plot_style, ticks

MARKERS = {"circle": "o", "square": "s", "triangle": "^", "diamond": "D"}  # name on pages -> matplotlib's name
DASHES = ("", "7 3", "2 3", "9 3 2 3")
THEORY_STYLE: Style = {"color": GREY, "linestyle": (0, (8, 5))}
DOT_STYLE: Style = {"gid": "point", "zorder": 3, "alpha": 0.72, "edgecolors": "white", "linewidths": 0.6}
HEMI_STYLE = {"lh": ("#1f5fa8", 0.17), "rh": ("#b3472b", -0.17)}  # colour, and height above the line of a region
CHART_SIZE_PX = (430.0, 250.0)  # [px] of a chart, two side by side
WIDE_CHART_SIZE_PX = (880.0, 430.0)
N_BINS = 48
#: added to the style of all plots for pages: text set by the browser, and lengths in pixels
PAGE_STYLE = {"svg.fonttype": "none", "lines.scale_dashes": False, "lines.linewidth": 1.7, **NO_FORMULAS}
NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))

Values = np.ndarray
Rows = Sequence[Mapping[str, Any]]
Size = tuple[float, float]  # [px], width and height


@dataclass(frozen=True, eq=False)
class Pen:
    """Name, colour, marker and dashes by which a surface is drawn, or a side of a group."""

    name: str
    colour: str
    marker: str
    dash: str


@dataclass(frozen=True)
class Chart:
    """Axes in pixels, and the texts that marks show under the pointer."""

    figure: Figure
    ax: Axes
    size: Size
    title: str
    mark_texts: list[str] = field(default_factory=list)

    def reads(self, text: str) -> str:
        """Register the text of a mark; return the address (url) to give to the mark."""
        self.mark_texts.append(text)
        return f"{len(self.mark_texts) - 1}"

    def line(self, x: Any, y: Any, kind: str, text: str | None = None, **style: Any) -> None:
        """Draw a line, or marks if the style has a marker."""
        style = {"linestyle": "none", **style} if "marker" in style else style
        self.ax.plot(x, y, gid=kind, url=text and self.reads(text), clip_on=False, **style)

    def points(self, marks: Iterable[tuple[float, float, str]], pen: Pen, *, big: bool) -> None:
        """Draw a mark for each (x, y, text)."""
        x, y, texts = zip(*marks)
        urls, area = [self.reads(text) for text in texts], (14 if big else 7) ** 2
        self.ax.scatter(x, y, area, color=pen.colour, marker=MARKERS[pen.marker], urls=urls, clip_on=False, **DOT_STYLE)

    def svg(self) -> Markup:
        """The drawing as SVG, ready for a page."""
        svg_file = io.StringIO()
        self.figure.savefig(svg_file, format="svg", metadata=NO_METADATA)
        svg_text = svg_file.getvalue().partition("</defs>")[2]  # the first definitions are a style for the whole page
        svg_text = svg_text.replace('<g id="', '<g class="')  # ids are the same in all charts
        svg_text = re.sub(
            r'<a xlink:href="(\d+)" target="_blank">(.*?)</a>',
            lambda link_match: f"<g><title>{escape(self.mark_texts[int(link_match[1])])}</title>{link_match[2]}</g>",
            svg_text,
            flags=re.DOTALL,
        )
        return Markup(
            '<svg class="chart" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}" xmlns="http://www.w3.org/2000/svg">'
            "<title>{}</title>{}"
        ).format(*self.size, self.title, self.title, Markup(svg_text))


@contextmanager
def new_chart(
    title: str,
    x_label: str,
    y_label: str,
    x: Limits,
    y: Limits,
    size: Size = CHART_SIZE_PX,
    right: float = 14.0,
    left: float = 56.0,
) -> Iterator[Chart]:
    """A chart with given limits and margins ``right`` and ``left`` [px]."""
    (width, height), top, bottom = size, 12.0, 38.0
    with plot_style({**PAGE_STYLE, "svg.hashsalt": title}):  # so that no two charts share ids
        figure = Figure(figsize=(width / 72, height / 72))  # a pixel is a point, a 72nd of an inch
        ax = figure.subplots()
        figure.subplots_adjust(left / width, bottom / height, 1 - right / width, 1 - top / height)
        for patch_owner in (figure, ax):
            patch_owner.patch.set_visible(False)
        for axis, limits, n_ticks in ((ax.xaxis, x, 6), (ax.yaxis, y, 4)):
            tick_positions = ticks(*limits, n_ticks)
            axis.set_ticks(tick_positions, [f"{tick:.6g}".replace("-", "−") for tick in tick_positions])
        ax.set(xlim=x, ylim=y, xlabel=x_label, ylabel=y_label)
        ax.yaxis.set_label_coords(14 / width, (height + bottom - top) / 2 / height, figure.transFigure)
        yield Chart(figure, ax, size, title)


def line_of(pen: Pen) -> Style:
    """Colour and dashes of a line, for matplotlib."""
    dashes = tuple(map(float, pen.dash.split()))
    return {"color": pen.colour, "linestyle": (0, dashes) if dashes else "-"}


def limits_around(values: Sequence[float]) -> Limits:
    """Limits a little outside the least and greatest value."""
    low, high = min(values), max(values)
    margin = 0.06 * (high - low) if high - low > 1e-6 * max(abs(low), abs(high)) else 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def histograms(
    series: Sequence[tuple[Pen, Values, Values]], label: str, unit: str, edges: Values | None = None, counted: str = ""
) -> Markup | None:
    """Distributions in one chart, with the same bins: area-weighted, or counts.

    Parameters
    ----------
    series : sequence of (pen, values (N,), weights (N,))
        NaN values are left out; each distribution is normalised over all its measured area.
    label, unit : str
        Of the quantity; the vertical axis is share of area per unit.
    edges : array, optional
        Of the bins; by default ``N_BINS`` equal ones between the least 0.5th and the greatest 99.5th percentile of any
        surface.
    counted : str
        What is counted ("subjects"), to draw the number of values per bin instead.

    Returns
    -------
    svg : Markup, or None if no surface has a value.
    """
    measured = [(pen, v[m], w[m]) for pen, v, w in series if (m := np.isfinite(v)).any() and w[m].sum() > 0]
    if not measured:
        return None
    edges = _edges([values for _, values, _ in measured]) if edges is None else edges
    heights = [
        np.histogram(v, edges, weights=w)[0] / (1.0 if counted else w.sum() * np.diff(edges)) for _, v, w in measured
    ]
    y_label = counted or f"share of area per {unit}".removesuffix(" per ")
    limits = (edges[0], edges[-1]), (0.0, 1.08 * (np.max(heights) or 1.0))
    with new_chart(f"Distribution of {label}", Quantity("", label, unit).title, y_label, *limits) as chart:
        for (pen, values, weights), bin_heights in zip(measured, heights):
            median = float(np.quantile(values, 0.5, weights=weights, method="inverted_cdf"))
            style: Style = {"linestyle": line_of(pen)["linestyle"], "linewidth": 1.7, "clip_on": False, "gid": "curve"}
            text_id = chart.reads(f"{pen.name}: median {number(median)} {unit}".strip())
            chart.ax.stairs(bin_heights, edges, ec=pen.colour, fill=True, fc=(pen.colour, 0.12), url=text_id, **style)
            if edges[0] <= median <= edges[-1]:
                chart.line(median, 0, "median", color=pen.colour, marker=10, markersize=8)  # a caret
        return chart.svg()


def _edges(series: Sequence[Values]) -> Values:
    percentiles = [np.percentile(values, [0.5, 99.5]) for values in series]
    low, high = np.min(percentiles), np.max(percentiles)
    margin = max(0.02 * (high - low), 1e-6 * np.abs(percentiles).max()) or 0.5  # bins wider than round-off
    return np.linspace(low - margin, high + margin, N_BINS + 1)


def thickness_plot(
    clouds: Sequence[tuple[Pen, Cloud]],
    theory_lines: Sequence[tuple[float, str]],
    *,
    from_zero: bool = True,
    size: Size = WIDE_CHART_SIZE_PX,
) -> Markup | None:
    """Gyral against cortical thickness, every surface in one plot, with theoretical lines through the origin.

    Parameters
    ----------
    clouds : sequence of (pen, Cloud)
        A fit whose slope is not different from 0 is drawn faint.
    theory_lines : sequence of (slope [mm/mm], label)
    from_zero : bool
        Axes begin at 0; otherwise they enclose the points.
    size : (width, height)
        In pixels.

    Returns
    -------
    svg : Markup, or None if there is no point.
    """
    plotted_points = [point for _, cloud in clouds for point in (*cloud.points, *cloud.bins)]
    if not plotted_points:
        return None
    x = [point.cortical for point in plotted_points]
    y = [value for point in plotted_points for value in (point.low, point.gyral, point.high) if value is not None]
    x_max, y_max = upper_ends = 1.12 * max(x), 1.12 * max(y)
    x_limits, y_limits = ((0.0, end) if from_zero else limits_around(values) for end, values in zip(upper_ends, (x, y)))
    axis_labels = "Cortical thickness [mm]", "Gyral thickness [mm]"
    with new_chart("Gyral thickness against cortical thickness", *axis_labels, x_limits, y_limits, size) as chart:
        for slope, label in theory_lines:
            end = min(x_max, y_max / slope)
            chart.line([0, end], [0, end * slope], "theory", label, **THEORY_STYLE)
        for pen, cloud in clouds:
            _draw_cloud(chart, pen, cloud)
        return chart.svg()


def _draw_cloud(chart: Chart, pen: Pen, cloud: Cloud) -> None:
    """Draw bins as crossed bars (median and quartiles), the fit, and the points."""
    bar_style: Style = {"kind": "bin", "color": pen.colour, "linewidth": 1.4, "alpha": 0.75}
    for point in cloud.bins:
        bar_style["text"] = f"{pen.name}, {point.label}"
        chart.line([point.cortical, point.cortical], [point.low, point.high], **bar_style)
        chart.line(point.cortical, point.gyral, **bar_style, marker="_", markersize=8)
    if cloud.fit is not None:
        x = [point.cortical for point in cloud.points or cloud.bins]
        x_ends = np.array([min(x), max(x)])
        faint_style: Style = {} if cloud.fit.sloped else {"linewidth": 1.0, "alpha": 0.45}
        chart.line(x_ends, cloud.fit.at(x_ends), "fit faint" if faint_style else "fit", **line_of(pen), **faint_style)
    if cloud.points:
        labelled_points = [
            (p.cortical, p.gyral, f"{pen.name}, {p.label}: {number(p.gyral)} mm at {number(p.cortical)} mm")
            for p in cloud.points
        ]
        chart.points(labelled_points, pen, big=len(labelled_points) == 1)


def folding_plot(surfaces: Sequence[tuple[Pen, Any]], paths: Sequence[tuple[str, Sequence[Any]]]) -> Markup | None:
    """The law of folding: total area times root thickness against exposed area (decimal logarithms), lines of equal k.

    Parameters
    ----------
    surfaces : sequence of (pen, ShapeTerms)
    paths : sequence of (name, sequence of ShapeTerms)
        Growing bodies, drawn dashed.

    Returns
    -------
    svg : Markup, or None if there is no surface.
    """
    if not surfaces:
        return None

    def logs(terms: Sequence[Any]) -> Values:
        return np.log10([(body.exposed, body.total * np.sqrt(body.thickness)) for body in terms])

    all_logs = logs([*(terms for _, terms in surfaces), *(terms for _, path in paths for terms in path)])
    x_limits, y_limits = zip(all_logs.min(axis=0) - 0.06, all_logs.max(axis=0) + 0.06)
    axis_labels = "log\u2081\u2080 exposed area [mm²]", "log\u2081\u2080 total area × √thickness [mm² √mm]"
    with new_chart("The law of folding", *axis_labels, x_limits, y_limits, (880.0, 400.0), right=60.0) as chart:
        for k in (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5):
            line_x = np.clip((np.array(y_limits) - np.log10(k)) / 1.25, *x_limits)
            if line_x[1] - line_x[0] > 0.02:
                line_y = 1.25 * line_x + np.log10(k)
                chart.line(line_x, line_y, "level", f"k = {k:g}", color="#cdd2d8", linewidth=1.0)
                chart.ax.text(line_x[1], line_y[1], f" k = {k:g}", va="center")
        for name, path in paths:
            x, y = logs(path).T
            chart.line(x, y, "theory", name, **THEORY_STYLE)
        for pen, terms in surfaces:
            chart.points([(*logs([terms])[0], f"{pen.name}: k = {number(terms.k)}")], pen, big=True)
        return chart.svg()


def growth_chart(
    label: str, curves: Sequence[tuple[str, Values, Values]], other_values: Sequence[tuple[Pen, float]]
) -> Markup | None:
    """A number over growth (black), with the values of other surfaces as horizontal lines in their colours.

    Parameters
    ----------
    label : str
        Name of the number.
    curves : sequence of (name, growth (G,), values (G,))
        NaN values are left out.
    other_values : sequence of (pen, value)

    Returns
    -------
    svg : Markup, or None if no curve has a value.
    """
    measured_curves = [(name, g[known], v[known]) for name, g, v in curves if (known := np.isfinite(v)).any()]
    if not measured_curves:
        return None
    _, g, values = map(np.hstack, zip(*measured_curves))
    x_limits = g.min() - 0.02, g.max() + 0.02
    y_max = 1.12 * max([values.max(), *(other_value for _, other_value in other_values)])
    with new_chart(f"{label} over growth", "growth g", label, x_limits, (0.0, y_max)) as chart:
        for pen, other_value in other_values:
            chart.line(x_limits, (other_value, other_value), "fit", **line_of(pen))
        for name, g, values in measured_curves:
            chart.line(g, values, "theory", name, **THEORY_STYLE)
            for x, y in zip(g, values):
                chart.line(x, y, "point", f"{name}, g = {x:.2f}: {number(y)}", color=BLACK, marker="o", markersize=6)
        return chart.svg()


def region_plot(rows: Rows, key: str, label: str, unit: str, person: Pen, grown: Pen) -> Markup | None:
    """A measure of the regions of the grown cortex, and of the smooth body in grey, against the person's.

    Parameters
    ----------
    rows : sequence of mapping
        Regions with ``person_KEY``, ``grown_KEY`` and perhaps ``smooth_KEY``.
    key, label, unit : str
    person, grown : Pen

    Returns
    -------
    svg : Markup, or None if fewer than two regions have both.
    """
    region_numbers = [(r["region"], *(r.get(f"{body}_{key}") for body in ("person", "grown", "smooth"))) for r in rows]
    points = [numbers for numbers in region_numbers if None not in numbers[1:3]]
    if len(points) < 2:
        return None
    _, x, y, smooth_values = zip(*points)
    limits = limits_around(x), limits_around([*y, *(value for value in smooth_values if value is not None)])
    title, x_quantity = f"{label}, {grown.name} against {person.name}", Quantity("", f"{label} of {person.name}", unit)
    with new_chart(title, x_quantity.title, grown.name, *limits) as chart:
        for region, x, _, smooth_value in points:
            if smooth_value is not None:
                point_text = f"{region}: {number(smooth_value)} before growth, {number(x)} {person.name}"
                chart.line(x, smooth_value, "point", point_text, color=GREY, marker="o", markersize=5, fillstyle="none")
        marks = [(x, y, f"{region}: {number(y)} {grown.name}, {number(x)} {person.name}") for region, x, y, _ in points]
        chart.points(marks, grown, big=False)
        return chart.svg()


def share_plot(kind: str, rows: Rows) -> Markup | None:
    """Shares of hinges or crests (``what``) that subjects have in common, by region; None without rows.

    There is a mark for each hemisphere, and a grey line for the middle 95 % by chance. ``rows`` are those of
    :class:`morphofold.group.overlap.Overlap`.
    """
    rows = [row for row in rows if row.get("share") is not None]
    if not rows:
        return None
    titles = f"{kind} that another subject has, too", "share, and by chance (grey)"
    with _regions_chart(rows, "share", *titles, (0.0, 1.0), 880.0) as (chart, regions):
        for row in rows:
            colour, y_offset = HEMI_STYLE[row["hemi"]]
            y = regions.index(row["region"]) + y_offset
            chart.line([row["chance_low"], row["chance_high"]], [y, y], "chance", color=GREY, linewidth=3, alpha=0.5)
            chance_text = f"by chance {number(row['chance'])}, p {number(row['p'])}"
            point_text = f"{row['hemi']} {row['region']}: {number(row['share'])}, {chance_text}"
            chart.line(row["share"], y, "share", point_text, color=colour, marker="o", markersize=5)
        return chart.svg()


def region_dots(rows: Rows, key: str, label: str, unit: str) -> Markup | None:
    """A measure of each region, a dot for each hemisphere, by the mean of both; None with fewer than two regions.

    ``rows`` are those of ``Measures.regions``.
    """
    rows = [row for row in rows if row.get(key) is not None and row["hemi"] in HEMI_STYLE]
    if len({row["region"] for row in rows}) < 2:
        return None
    limits, x_title = limits_around([row[key] for row in rows]), Quantity("", label, unit).title
    with _regions_chart(rows, key, f"{label} of regions", x_title, limits, CHART_SIZE_PX[0]) as (chart, regions):
        for row in rows:
            colour, y_offset = HEMI_STYLE[row["hemi"]]
            point_text = f"{row['hemi']} {row['region']}: {number(row[key])} {unit}"
            y = regions.index(row["region"]) + y_offset
            chart.line(row[key], y, "region", point_text, color=colour, marker="o", markersize=5)
        return chart.svg()


@contextmanager
def _regions_chart(
    rows: Rows, key: str, title: str, x_title: str, limits: Limits, width: float
) -> Iterator[tuple[Chart, list[str]]]:
    """A chart with a line for each region, and the regions from the lowest line up, by their mean of ``key``."""
    values_by_region: dict[str, list[float]] = {}
    for row in rows:
        values_by_region.setdefault(row["region"], []).append(row[key])
    regions = sorted(sorted(values_by_region), key=lambda region: np.mean(values_by_region[region]))
    y_limits, size = (-0.7, len(regions) - 0.3), (width, 60.0 + 15.0 * len(regions))
    with new_chart(title, x_title, "", limits, y_limits, size=size, left=190.0) as chart:
        chart.ax.set_yticks(range(len(regions)), regions)
        yield chart, regions
