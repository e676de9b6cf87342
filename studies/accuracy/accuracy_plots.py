"""Plots of error against time: settings as points, the front as a line, and the time that half the error takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.report.plots.figure_style import BLACK, legend_of_figure, line_style, new_figure
from morphofold.studies.accuracy.accuracy_tables import along_meshes, laws_of
from morphofold.studies.accuracy.error_points import EACH_OTHER, OURS, Point
from morphofold.studies.accuracy.fronts import Halving, better_than, grouped, halving
from morphofold.studies.accuracy.solver_settings import PACED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vP<>"
FEWEST = 4  # least number of points of a panel
COLUMNS = 3


def front_figure(points: Sequence[Point], by: str) -> Figure | None:
    """A panel for each quantity: all settings, filled if no other dominates them, and their front.

    Parameters
    ----------
    points : sequence of Point
        Points of one half.
    by : {"axis", "method"}
        What the colours distinguish.

    Returns
    -------
    Figure or None
        None if no quantity has four points.
    """
    panels = {
        key: group
        for key, group in grouped(points).items()
        if len(group) >= FEWEST and min(p.error for p in group) > 0 and key[3] != EACH_OTHER
    }
    if not panels:
        return None
    names = list(dict.fromkeys(getattr(p, by) for group in panels.values() for p in group))
    styles = {name: _style(k) for k, name in enumerate(names)}
    rows = -(-len(panels) // COLUMNS)
    with new_figure(4.1 * COLUMNS, 3.3 * rows + 0.5, rows, COLUMNS) as (figure, axes):
        for ax, (key, group) in zip(axes.flat, panels.items()):
            _panel(ax, group, styles, by)
            ax.set_title(f"{key[2]}: {key[1]}\nagainst {key[3]}{_half_text(group)}", loc="left", fontsize=8.5)
        for ax in axes.flat[len(panels) :]:
            ax.set_axis_off()
        for row in axes:
            row[0].set(ylabel="error")
        for ax in axes.flat[max(0, len(panels) - COLUMNS) : len(panels)]:
            ax.set(xlabel="seconds")
        entries: dict[str, Mapping[str, Any]] = {
            **styles,
            "dominated": {**_style(6), "markerfacecolor": "none"},
            "front": {"color": BLACK, "linewidth": 0.9},
        }
        legend_of_figure(figure, entries, axes.flat[0], columns=3 if by == "method" else 5)
    return figure


def _panel(ax: Axes, group: Sequence[Point], styles: Mapping[str, Mapping[str, Any]], by: str) -> None:
    front = [p for p, better in zip(group, better_than(group)) if better is None]
    front.sort(key=lambda p: p.seconds)
    ax.plot([p.seconds for p in front], [p.error for p in front], color=BLACK, linewidth=0.9, zorder=1)
    for p in sorted(group, key=lambda p: p.axis == "mesh"):  # last, drawn above other points of the same run
        style = {**styles[getattr(p, by)], **({} if p in front else {"markerfacecolor": "none"})}
        ax.plot([p.seconds], [p.error], **style)
    presets: dict[float, dict[str, Point]] = {}  # by error: standard and fine can be the same
    preset_points = [p for p in group if p.preset and p.method == OURS]
    largest = max((p.size for p in preset_points if p.half == "measuring"), default=0)
    for p in preset_points:
        if p.half == "solver" or p.size == largest:
            presets.setdefault(p.error, {}).setdefault(p.preset, p)
    for error, of_error in presets.items():
        fastest = min(p.seconds for p in of_error.values())
        ax.annotate(", ".join(of_error), (fastest, error), xytext=(4, 4), textcoords="offset points", fontsize=8)
    _logarithmic(ax)


def _half_text(group: Sequence[Point]) -> str:
    """Text with the time that half the error takes along our meshes."""
    ours = [p for p in group if p.method == OURS]
    halved = half_of(ours)
    axis_text = f"({PACED})" if any(p.axis == PACED for p in ours) else "the time"
    return f"; half the error: {bounded(halved.factor)} × {axis_text}" if halved else ""


def half_of(points: Sequence[Point]) -> Halving | None:
    """How many times longer half the error takes along the meshes of one quantity, on its last axis of meshes, which
    refines most; None if this is not known."""
    groups = list(along_meshes(points).values())
    time_law, error_law = laws_of(groups[-1]) if groups else (None, None)
    return halving(time_law, error_law) if time_law and error_law else None


def bounded(factor: float) -> str:
    """A factor as text; "more than 100" if it is large."""
    return f"{factor:.2g}" if factor < 100 else "more than 100"


CURVATURE = "mean curvature"
#: solver quantities in the overview -> their labels
HEADLINES = {
    ("onset", PACED): "onset of folding, mesh and pace",
    ("gyrification index, g = 2", "mesh"): "gyrification index at g = 2",
    ("pial distance, g = 1.5", "mesh"): "pial surface at g = 1.5 (over T)",
}


def overview(points: Sequence[Point]) -> Figure:
    """Both halves in one picture: our points along meshes, and those of the peers."""
    with new_figure(11.4, 4.9, 1, 2) as (figure, axes):
        solver_ax, measuring_ax = axes[0]
        meshes = along_meshes(points)
        for k, ((quantity, axis), label) in enumerate(HEADLINES.items()):
            for (half, _, group_quantity, against, method, group_axis), group in meshes.items():
                theory = "incompressible" in against
                if (half, group_quantity, method, group_axis) == ("solver", quantity, OURS, axis) and not theory:
                    _curve(solver_ax, group, label, line_style(k))
        curvature = {key: group for key, group in meshes.items() if key[0] == "measuring" and key[2] == CURVATURE}
        shape = next((key[1] for key in curvature), "no shape")
        for k, points_of_best in enumerate(
            _best_of_packages(group for key, group in curvature.items() if key[1] == shape)
        ):
            thick_line = {"linewidth": 2.8} if points_of_best[0].method == OURS else {}
            _curve(measuring_ax, points_of_best, points_of_best[0].method, {**line_style(k), **thick_line})
        titles = "solver: a growing sphere", f"measuring: {CURVATURE} of a {shape}"
        for ax, title in zip((solver_ax, measuring_ax), titles):
            _logarithmic(ax)
            ax.set(xlabel="seconds")
            ax.set_title(title, loc="left")
            if ax.lines:
                ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8.5)
        solver_ax.set(ylabel="error")
    return figure


def _best_of_packages(groups: Iterable[Sequence[Point]]) -> list[Sequence[Point]]:
    """For each package the method with the least error on its finest mesh; ours first."""
    best: dict[str, Sequence[Point]] = {}
    for group in groups:
        package, finest_error = group[0].method.split()[0], lambda g: max(g, key=lambda p: p.size).error
        if package not in best or finest_error(group) < finest_error(best[package]):
            best[package] = group
    return sorted(best.values(), key=lambda group: group[0].method != OURS)


def _curve(ax: Axes, group: Sequence[Point], label: str, style: Mapping[str, Any]) -> None:
    group = sorted(group, key=lambda p: p.size)
    half = half_of(group)
    label = f"{label}: half the error {half.factor:.2g} × the time" if half else label
    marker_style = {"marker": "o", "markersize": 4, "label": label}
    ax.plot([p.seconds for p in group], [p.error for p in group], **{**style, **marker_style})
    is_onset = label.startswith("onset")  # its curve crosses another curve
    for p in group:
        if p.preset:
            offset = (4, -11) if is_onset else (4, 4)
            ax.annotate(p.preset, (p.seconds, p.error), xytext=offset, textcoords="offset points", fontsize=7.5)


def _style(k: int) -> dict[str, Any]:
    return {
        "color": CATEGORICAL_COLOURS[k % 7],
        "marker": MARKERS[k % 8],
        "markersize": 5,
        "linestyle": "none",
        "markeredgecolor": CATEGORICAL_COLOURS[k % 7],
    }


def _logarithmic(ax: Axes) -> None:
    """Logarithmic axes, errors in per cent; on short axes 2 and 5 are also labelled."""
    import math

    from matplotlib.ticker import FuncFormatter, LogLocator

    ax.set(xscale="log", yscale="log")
    formats = FuncFormatter(lambda s, _: f"{s:g}"), FuncFormatter(lambda e, _: f"{100 * e:g} %")
    for axis, format_tick, (low, high) in zip((ax.xaxis, ax.yaxis), formats, (ax.get_xlim(), ax.get_ylim())):
        axis.set_major_formatter(format_tick)
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_minor_formatter(format_tick if math.log10(high / low) < 2.3 else FuncFormatter(lambda *_: ""))
    ax.tick_params(which="both", labelsize=8.5)
