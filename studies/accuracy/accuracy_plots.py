"""Plots of error against time: settings as points, the front as a line, and the time that half the error takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from morphofold.quantities import CATEGORICAL_COLOURS
from morphofold.report.plots.figure_style import BLACK, legend_of_figure, line_style, new_figure
from morphofold.studies.accuracy.accuracy_tables import along_meshes, laws_of
from morphofold.studies.accuracy.error_points import OTHER_PEER, OUR_CODE, Point
from morphofold.studies.accuracy.errors_from_theory import THEORY
from morphofold.studies.accuracy.folds_by_mesh import FINEST_MESH, OWN_LIMIT
from morphofold.studies.accuracy.solver_settings import MESH_AND_PACE
from morphofold.studies.accuracy.time_error_fronts import Halving, better_than, grouped, halving

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vP<>"
LEAST_POINTS = 4  # least number of points of a panel
N_COLUMNS = 3


def front_figure(points: Sequence[Point], colour_by: str) -> Figure | None:
    """A panel for each quantity: all settings, filled if no other dominates them, and their front.

    Parameters
    ----------
    points : sequence of Point
        Points of one half.
    colour_by : {"axis", "method"}
        What the colours distinguish.

    Returns
    -------
    Figure or None
        None if no quantity has four points.
    """
    panel_points = {
        key: group
        for key, group in grouped(points).items()
        if len(group) >= LEAST_POINTS and min(point.error for point in group) > 0 and key[3] != OTHER_PEER
    }
    if not panel_points:
        return None
    labels = list(dict.fromkeys(getattr(point, colour_by) for group in panel_points.values() for point in group))
    style_by_label = {label: _style(label_index) for label_index, label in enumerate(labels)}
    n_rows = -(-len(panel_points) // N_COLUMNS)
    with new_figure(4.1 * N_COLUMNS, 3.3 * n_rows + 0.5, n_rows, N_COLUMNS) as (figure, axes):
        for ax, (key, group) in zip(axes.flat, panel_points.items()):
            _panel(ax, group, style_by_label, colour_by)
            ax.set_title(f"{key[2]}: {key[1]}\nagainst {key[3]}{_half_text(group)}", loc="left", fontsize=8.5)
        for ax in axes.flat[len(panel_points) :]:
            ax.set_axis_off()
        for axes_row in axes:
            axes_row[0].set(ylabel="error")
        for ax in axes.flat[max(0, len(panel_points) - N_COLUMNS) : len(panel_points)]:
            ax.set(xlabel="seconds")
        legend_entries: dict[str, Mapping[str, Any]] = {
            **style_by_label,
            "dominated": {**_style(6), "markerfacecolor": "none"},
            "front": {"color": BLACK, "linewidth": 0.9},
        }
        legend_of_figure(figure, legend_entries, axes.flat[0], columns=3 if colour_by == "method" else 5)
    return figure


def _panel(ax: Axes, group: Sequence[Point], styles: Mapping[str, Mapping[str, Any]], colour_by: str) -> None:
    front = [point for point, dominator in zip(group, better_than(group)) if dominator is None]
    front.sort(key=lambda point: point.seconds)
    ax.plot([point.seconds for point in front], [point.error for point in front], color=BLACK, linewidth=0.9, zorder=1)
    for point in sorted(group, key=lambda point: point.axis == "mesh"):  # last: drawn above others of the same run
        style = {**styles[getattr(point, colour_by)], **({} if point in front else {"markerfacecolor": "none"})}
        ax.plot([point.seconds], [point.error], **style)
    error_presets: dict[float, dict[str, Point]] = {}  # by error: standard and fine can be the same
    preset_points = [point for point in group if point.preset and point.method == OUR_CODE]
    largest_size = max((point.size for point in preset_points if point.half == "measuring"), default=0)
    for point in preset_points:
        if point.half == "solver" or point.size == largest_size:
            error_presets.setdefault(point.error, {}).setdefault(point.preset, point)
    for error, presets_here in error_presets.items():
        fastest = min(point.seconds for point in presets_here.values())
        ax.annotate(", ".join(presets_here), (fastest, error), xytext=(4, 4), textcoords="offset points", fontsize=8)
    _logarithmic(ax)


def _half_text(group: Sequence[Point]) -> str:
    """Text with the time that half the error takes along our meshes."""
    our_points = [point for point in group if point.method == OUR_CODE]
    half_time = half_of(our_points)
    time_text = f"({MESH_AND_PACE})" if any(point.axis == MESH_AND_PACE for point in our_points) else "the time"
    return f"; half the error: {bounded(half_time.factor)} × {time_text}" if half_time else ""


def half_of(points: Sequence[Point]) -> Halving | None:
    """How many times longer half the error takes along the meshes of one quantity, on its last axis of meshes, which
    refines most; None if this is not known."""
    mesh_groups = list(along_meshes(points).values())
    time_law, error_law = laws_of(mesh_groups[-1]) if mesh_groups else (None, None)
    return halving(time_law, error_law) if time_law and error_law else None


def bounded(time_factor: float) -> str:
    """A factor as text; "more than 100" if it is large."""
    return f"{time_factor:.2g}" if time_factor < 100 else "more than 100"


CURVATURE = "mean curvature"
#: solver quantities in the overview, along which axis and against what -> their labels
CURVE_LABELS = {
    ("onset", MESH_AND_PACE, THEORY): "onset of folding, mesh and pace",
    ("gyrification index, g = 2", "mesh", FINEST_MESH): "gyrification index at g = 2, mesh and pattern",
    ("gyrification index, g = 2", "mesh", OWN_LIMIT): "gyrification index at g = 2, mesh alone",
    ("pial distance, g = 1.5", "mesh", FINEST_MESH): "pial surface at g = 1.5 (over T)",
}


def overview(points: Sequence[Point]) -> Figure:
    """Both halves in one picture: our points along meshes, and those of the peers."""
    with new_figure(11.4, 4.9, 1, 2) as (figure, axes):
        solver_ax, measuring_ax = axes[0]
        mesh_groups = along_meshes(points)
        for curve_index, ((quantity, axis, reference), label) in enumerate(CURVE_LABELS.items()):
            for (half, _, *keys), group in mesh_groups.items():
                if (half, *keys) == ("solver", quantity, reference, OUR_CODE, axis):
                    _curve(solver_ax, group, label, line_style(curve_index))
        curvature = {key: group for key, group in mesh_groups.items() if key[0] == "measuring" and key[2] == CURVATURE}
        shape_name = next((key[1] for key in curvature), "no shape")
        for curve_index, best_points in enumerate(
            _best_of_packages(group for key, group in curvature.items() if key[1] == shape_name)
        ):
            width_style = {"linewidth": 2.8} if best_points[0].method == OUR_CODE else {}
            _curve(measuring_ax, best_points, best_points[0].method, {**line_style(curve_index), **width_style})
        titles = "solver: a growing sphere", f"measuring: {CURVATURE} of a {shape_name}"
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
    best_by_package: dict[str, Sequence[Point]] = {}
    for group in groups:
        package, finest_error = group[0].method.split()[0], lambda curve: max(curve, key=lambda point: point.size).error
        if package not in best_by_package or finest_error(group) < finest_error(best_by_package[package]):
            best_by_package[package] = group
    return sorted(best_by_package.values(), key=lambda group: group[0].method != OUR_CODE)


def _curve(ax: Axes, group: Sequence[Point], label: str, style: Mapping[str, Any]) -> None:
    group = sorted(group, key=lambda p: p.size)
    half_time = half_of(group)
    label = f"{label}: half the error {half_time.factor:.2g} × the time" if half_time else label
    marker_style = {"marker": "o", "markersize": 4, "label": label}
    ax.plot([p.seconds for p in group], [p.error for p in group], **{**style, **marker_style})
    is_onset = label.startswith("onset")  # its curve crosses another curve
    for p in group:
        if p.preset:
            text_offset = (4, -11) if is_onset else (4, 4)
            ax.annotate(p.preset, (p.seconds, p.error), xytext=text_offset, textcoords="offset points", fontsize=7.5)


def _style(label_index: int) -> dict[str, Any]:
    return {
        "color": CATEGORICAL_COLOURS[label_index % 7],
        "marker": MARKERS[label_index % 8],
        "markersize": 5,
        "linestyle": "none",
        "markeredgecolor": CATEGORICAL_COLOURS[label_index % 7],
    }


def _logarithmic(ax: Axes) -> None:
    """Logarithmic axes, errors in per cent; on short axes 2 and 5 are also labelled."""
    import math

    from matplotlib.ticker import FuncFormatter, LogLocator

    ax.set(xscale="log", yscale="log")
    formatters = FuncFormatter(lambda seconds, _: f"{seconds:g}"), FuncFormatter(lambda error, _: f"{100 * error:g} %")
    for axis, formatter, (low, high) in zip((ax.xaxis, ax.yaxis), formatters, (ax.get_xlim(), ax.get_ylim())):
        axis.set_major_formatter(formatter)
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_minor_formatter(formatter if math.log10(high / low) < 2.3 else FuncFormatter(lambda *_: ""))
    ax.tick_params(which="both", labelsize=8.5)
