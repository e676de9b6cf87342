"""Small charts as inline SVG: distributions over each other, and gyral against cortical thickness.

Geometry is worked out here, drawn in ``templates/chart.svg``; names are escaped there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape
from markupsafe import Markup

from morphofold.words import number

MARKERS = ("circle", "square", "triangle", "diamond")
DASHES = ("", "7 3", "2 3", "9 3 2 3")


@cache
def environment() -> Environment:
    """The templates of the report, escaping on in all of them."""
    env = Environment(
        loader=PackageLoader("morphofold.report", "templates"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters["short"] = lambda x: f"{x:.4g}".replace("-", "−")
    env.filters["px"] = lambda x: f"{x:.2f}".rstrip("0").rstrip(".")
    return env


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """About ``about`` round numbers from low to high, steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / max(about, 1)
    if not raw > 0:
        return [low]
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(power * m for m in (1, 2, 5, 10) if power * m >= raw * 0.999)
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


@dataclass
class Axes:
    """A plot area in pixels and the data range it shows."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float = 430.0
    height: float = 250.0
    margin: tuple[float, float, float, float] = (12.0, 14.0, 44.0, 54.0)  # top right bottom left
    items: list[dict[str, Any]] = field(default_factory=list)

    def px(self, x: Any) -> Any:
        left, right = self.margin[3], self.width - self.margin[1]
        return left + (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0]) * (right - left)

    def py(self, y: Any) -> Any:
        top, bottom = self.margin[0], self.height - self.margin[2]
        return bottom - (np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]) * (bottom - top)

    def path(self, x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray) -> str:
        return "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in zip(self.px(x), self.py(y)))

    def render(self, x_label: str, y_label: str, title: str, legend: Sequence[dict[str, Any]] = ()) -> Markup:
        across, up = ticks(*self.x, about=6), ticks(*self.y, about=4)
        return Markup(
            environment().get_template("chart.svg").render(
                axes=self, x_label=x_label, y_label=y_label, title=title, legend=legend, items=self.items,
                x_ticks=[(float(self.px(t)), f"{t:.6g}".replace("-", "−")) for t in across],
                y_ticks=[(float(self.py(t)), f"{t:.6g}".replace("-", "−")) for t in up],
            )
        )  # fmt: skip


def histograms(
    series: Sequence[tuple[str, np.ndarray, np.ndarray, str, str]], label: str, unit: str,
    bins: int | np.ndarray = 48, counted: str = "",
) -> Markup | None:  # fmt: skip
    """Distributions over each other, in the same bins: area-weighted, or counts.

    Parameters
    ----------
    series : sequence of (name, values (N,), weights (N,), colour, dash)
        NaN values are left out; each distribution is normalised over all its measured area.
    label, unit : str
        Of the quantity; the vertical axis is share of area per unit.
    bins : int or array
        Equal bins between the least 0.5th and the greatest 99.5th percentile of any surface; or the edges of bins.
    counted : str
        What the values are of, if their number in each bin is to be drawn instead.

    Returns
    -------
    svg : Markup, or None if no surface has a value.
    """
    ends = [np.percentile(v[np.isfinite(v)], [0.5, 99.5]) for _, v, *_ in series if np.isfinite(v).any()]
    if not ends:
        return None
    if isinstance(bins, int):
        low, high = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
        wide = max(0.02 * (high - low), 1e-6 * max(abs(low), abs(high))) or 0.5     # bins wider than round-off
        edges = np.linspace(low - wide, high + wide, bins + 1)
    else:
        edges = bins
    curves = []
    for name, values, weights, colour, dash in series:
        known = np.isfinite(values)
        if known.any() and weights[known].sum() > 0:
            density = np.histogram(values[known], edges, weights=None if counted else weights[known])[0]
            if not counted:
                density = density / weights[known].sum() / np.diff(edges)
            curves.append((name, density, colour, dash, weighted_median(values[known], weights[known])))
    if not curves:
        return None
    top = max(float(d.max()) for _, d, *_ in curves) or 1.0
    axes = Axes((float(edges[0]), float(edges[-1])), (0.0, 1.08 * top))
    for name, density, colour, dash, median in curves:
        x = np.repeat(edges, 2)
        y = np.concatenate([[0], np.repeat(density, 2), [0]])
        axes.items.append({
            "kind": "area", "d": axes.path(x, y), "colour": colour, "dash": dash,
            "title": f"{name}: median {number(median)} {unit}".strip(),
        })  # fmt: skip
        if edges[0] <= median <= edges[-1]:
            axes.items.append({"kind": "median", "x": float(axes.px(median)), "y": float(axes.py(0)), "colour": colour})
    up = counted or (f"share of area per {unit}" if unit else "share of area")
    return axes.render(f"{label} [{unit}]" if unit else label, up, f"Distribution of {label}")


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Smallest value below which at least half the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def thickness_plot(
    clouds: Sequence[dict[str, Any]], lines: Sequence[tuple[float, str]], *, from_zero: bool = True,
    size: tuple[float, float] = (880, 430),
) -> Markup | None:  # fmt: skip
    """Gyral against cortical thickness, every surface in one plot, with theoretical lines through the origin.

    Parameters
    ----------
    clouds : sequence of dict
        ``name``, ``colour``, ``marker``, ``dash``; ``points`` and ``bins`` with attributes ``cortical`` and
        ``gyral`` [mm], ``label`` and, for bins, quartiles ``low`` and ``high``; ``fit`` with ``slope``, ``intercept``
        and ``sloped``, or None. A fit that is not sloped is drawn faint.
    lines : sequence of (slope [mm/mm], label)
    from_zero : bool
        Axes begin at 0; else they are those of the points.
    size : (width, height)
        In pixels.

    Returns
    -------
    svg : Markup, or None if there is no point at all.
    """
    marks = [p for c in clouds for p in (*c["points"], *c["bins"])]
    if not marks:
        return None
    right = 1.12 * max(p.cortical for p in marks)
    top = 1.12 * max(max(p.gyral, p.high or 0) for p in marks)
    across, up = (0.0, right), (0.0, top)
    if not from_zero:
        across = around([p.cortical for p in marks])
        up = around([y for p in marks for y in (p.low, p.gyral, p.high) if y is not None])
    axes = Axes(across, up, *size, margin=(14, 18, 46, 58))
    for slope, label in lines:
        end = min(right, top / slope)
        axes.items.append({"kind": "theory", "d": axes.path([0, end], [0, end * slope]), "title": label})
    for cloud in clouds:
        _draw_cloud(axes, cloud)
    return axes.render("Cortical thickness [mm]", "Gyral thickness [mm]", "Gyral thickness against cortical thickness")


def range_of(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def around(values: Sequence[float]) -> tuple[float, float]:
    """Least and greatest of some values, a little apart from them."""
    low, high = range_of(values)
    edge = 0.06 * (high - low) if high - low > 1e-6 * max(abs(low), abs(high)) else 0.1 * abs(high) or 1.0
    return low - edge, high + edge


def _draw_cloud(axes: Axes, cloud: dict[str, Any]) -> None:
    name, colour, points = cloud["name"], cloud["colour"], cloud["points"]

    def add(p: Any, kind: str, title: str, **more: Any) -> None:
        place = {"x": float(axes.px(p.cortical)), "y": float(axes.py(p.gyral))}
        axes.items.append({"kind": kind, "colour": colour, "title": title, **place, **more})

    for p in cloud["bins"]:
        add(p, "bar", f"{name}, {p.label}", y0=float(axes.py(p.low)), y1=float(axes.py(p.high)))
    if cloud["fit"] is not None:
        x = np.array(range_of([p.cortical for p in points or cloud["bins"]]))
        d = axes.path(x, cloud["fit"].intercept + cloud["fit"].slope * x)
        faint = not cloud["fit"].sloped
        axes.items.append({"kind": "fit", "d": d, "colour": colour, "dash": cloud["dash"], "faint": faint})
    for p in points:
        title = f"{name}, {p.label}: {number(p.gyral)} mm at {number(p.cortical)} mm"
        add(p, "point", title, marker=cloud["marker"], big=len(points) == 1)


def folding_plot(
    surfaces: Sequence[tuple[str, Any, str, str]], paths: Sequence[tuple[str, Sequence[Any]]]
) -> Markup | None:
    """The law of folding: decimal logarithms of total area times root thickness over exposed area, lines of equal k.

    Parameters
    ----------
    surfaces : sequence of (name, ShapeTerms, colour, marker)
    paths : sequence of (name, sequence of ShapeTerms)
        Bodies as they grow, drawn dashed.

    Returns
    -------
    svg : Markup, or None if there is no surface.
    """
    if not surfaces:
        return None

    def place(t: Any) -> tuple[float, float]:
        return float(np.log10(t.exposed)), float(np.log10(t.total * np.sqrt(t.thickness)))

    every = np.array([place(t) for t in [*(t for _, t, *_ in surfaces), *(t for _, path in paths for t in path)]])
    (x0, y0), (x1, y1) = every.min(axis=0) - 0.06, every.max(axis=0) + 0.06
    axes = Axes((float(x0), float(x1)), (float(y0), float(y1)), width=880, height=400, margin=(14, 60, 46, 58))
    for k in (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5):
        ends = np.array([max(x0, (y0 - np.log10(k)) / 1.25), min(x1, (y1 - np.log10(k)) / 1.25)])
        if ends[1] - ends[0] > 0.02:
            axes.items.append({"kind": "level", "d": axes.path(ends, 1.25 * ends + np.log10(k)), "title": f"k = {k:g}"})
            at = float(axes.px(ends[1])) + 4, float(axes.py(1.25 * ends[1] + np.log10(k))) + 4
            axes.items.append({"kind": "text", "x": at[0], "y": at[1], "text": f"k = {k:g}"})
    for name, path in paths:
        d = axes.path(*np.array([place(t) for t in path]).T)
        axes.items.append({"kind": "theory", "d": d, "title": name})
    for name, t, colour, marker in surfaces:
        x, y = place(t)
        axes.items.append({
            "kind": "point", "colour": colour, "title": f"{name}: k = {number(t.k)}", "marker": marker, "big": True,
            "x": float(axes.px(x)), "y": float(axes.py(y)),
        })  # fmt: skip
    labels = "log\u2081\u2080 exposed area [mm²]", "log\u2081\u2080 total area × √thickness [mm² √mm]"
    return axes.render(*labels, "The law of folding")


def growth_chart(
    label: str, curves: Sequence[tuple[str, np.ndarray, np.ndarray]], others: Sequence[tuple[str, float, str, str]]
) -> Markup | None:
    """A number over growth, black, with the number of other surfaces as level lines in their colours.

    Parameters
    ----------
    label : str
        What the number is.
    curves : sequence of (name, growth (G,), values (G,))
        NaN values are left out.
    others : sequence of (name, value, colour, dash)

    Returns
    -------
    svg : Markup, or None if no curve has a value.
    """
    known = [(name, g[np.isfinite(v)], v[np.isfinite(v)]) for name, g, v in curves if np.isfinite(v).any()]
    if not known:
        return None
    g = np.concatenate([g for _, g, _ in known])
    top = 1.12 * max([float(v.max()) for _, _, v in known] + [value for _, value, *_ in others])
    axes = Axes((float(g.min()) - 0.02, float(g.max()) + 0.02), (0.0, top))
    for _, value, colour, dash in others:
        d = axes.path(axes.x, (value, value))
        axes.items.append({"kind": "fit", "d": d, "colour": colour, "dash": dash, "faint": False})
    for name, at, values in known:
        axes.items.append({"kind": "theory", "d": axes.path(at, values), "title": name})
        for x, y in zip(at.tolist(), values.tolist()):
            axes.items.append({
                "kind": "point", "colour": "#1a1a1a", "title": f"{name}, g = {x:.2f}: {number(y)}", "marker": "circle",
                "big": False, "x": float(axes.px(x)), "y": float(axes.py(y)),
            })  # fmt: skip
    return axes.render("growth g", label, f"{label} over growth")
