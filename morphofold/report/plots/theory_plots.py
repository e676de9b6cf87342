"""Figures of the theory of any sphere: arguments as for :mod:`morphofold.results.theory_tables`, or cases of it, go
in; a matplotlib ``Figure`` comes out, a curve for the theory and dots at the values that were asked for.

``morphofold theory --plot`` draws them, studies/paper the curves alone. Curves differ in colour and in line style.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morphofold.errors import NothingToDo
from morphofold.report.plots.figure_style import (
    BLACK,
    GREY,
    Style,
    around,
    legend_below,
    legend_of_figure,
    line_style,
    new_figure,
    round_step,
)
from morphofold.results.theory_tables import G_MAX, Case, Row, critical_rows, radius_rows, stress_rows
from morphofold.sim import theory

Rows = list[Row]
NOTE_STYLE: Style = {"color": GREY, "fontsize": 10}
THIN: Style = {"linewidth": 1.0}
NO_LINE_STYLE: Style = {"linestyle": "none", "color": GREY}
GROWTH_LAWS = ("isotropic", "tangential")
MU_RATIO_LABEL = "$\\mu_\\mathrm{{cortex}}/\\mu_\\mathrm{{core}}$ = {:g}"
#: parameters of the paper's sphere, which titles leave out, and the format for other values
PAPER_SPHERE = {
    "radius": (50.0, "$C$ = {:g} mm"),
    "A_over_C": (0.5, "$A/C$ = {:g}"),
    "mu_ratio": (1.0, MU_RATIO_LABEL),
    "g_core": (1.0, "$g_\\mathrm{{core}}$ = {:g}"),
    "kappa_ratio": (np.inf, "$\\kappa/\\mu$ = {:g}"),
}
AXIS_LABELS = {
    "growth": "growth stretch of the cortex  $g$",
    "c_over_B": "outer radius after growth  $c/B$",
    "position": "position in the grown cortex  $(r-b)/(c-b)$",
    "sigma_theta_over_mu_cortex": "tangential stress  $\\sigma_\\theta/\\mu_\\mathrm{cortex}$",
    "C_over_B": "outer radius / interface radius  $C/B$",
    "T_over_C": "thickness of the cortex  $T/C$",
    "degree": "degree of the spherical harmonic  $l$",
    **dict.fromkeys(("g_crease", "g_biot", "g_crit"), "critical growth stretch  $g_\\mathrm{crit}$"),
}
RADIUS_EQUATIONS = {"isotropic": "Eq. (11)", "tangential": "as Eq. (11)"}
CREASE_EQUATIONS = {"isotropic": "Eq. (12)", "tangential": "Eq. (13)"}
#: number of points above which dots would cover the curve
MOST_DOTS = 40


def radius_figure(growth: Sequence[float], *sphere: Any, **options: Any) -> Figure:
    """Outer radius against growth, as in Fig. 3(a), with dots at ``growth``; arguments as for :func:`radius_rows`."""
    growth_ends = (min(1.0, *growth), max(2.0, *growth))
    rows, dot_rows = (radius_rows(g, *sphere, **options) for g in (np.linspace(*growth_ends, 201), growth))
    with _sphere_figure(6.4, 4.4, radius=rows[0]["outer_radius_mm"], **options) as (figure, (ax,)):
        draw_radius(ax, rows)
        y_limits = around([row["c_over_B"] for row in rows], 1, 1.3, 0.1)
        ax.set(xlim=growth_ends, ylim=y_limits, title=f"$T$ = {rows[0]['thickness_mm']:g} mm")
        _draw_dots(ax, dot_rows, "growth", "c_over_B")
        legend_below(ax)
    return figure


def stress_figure(*sphere: Any, **options: Any) -> Figure:
    """Tangential stress through the cortex, as in Fig. 3(b), one panel per law; arguments of :func:`stress_rows`."""
    rows = stress_rows(*sphere, points=101, layers=("cortex",), **options)
    stresses = [depth_row["sigma_theta_over_mu_cortex"] for depth_row in rows]
    largest_stress = max(map(abs, stresses))
    tick_step = round_step(largest_stress / 3) if largest_stress > 1e-9 else 1.0  # else it is round-off
    law_panels = [*_by_value(rows, "law")]
    figure_size = (3.6 + 2.8 * len(law_panels), 4.6, 1, len(law_panels))
    with _sphere_figure(*figure_size, radius=rows[0]["outer_radius_mm"], **options) as (figure, axes):
        for ax, (law, _, law_rows) in zip(axes, law_panels):
            draw_stress(ax, law_rows)
            ax.set(xlim=(0, 1), ylim=around(stresses, -tick_step, 0, tick_step))
            ax.set_title(f"{law} growth, $g$ = {law_rows[0]['growth']:g}")
            legend_below(ax)
    return figure


def critical_figure(C_bar: Sequence[float], *laws: Any, **options: Any) -> Figure:
    """Critical growth against C/B, as in Fig. 4, with Biot's as thin lines; arguments as for :func:`critical_rows`.

    Dots mark the ratios ``C_bar``.
    """
    x_end = max(min(1.3, 1 / max(options.get("A_over_C", 0.5), 0.1)), *C_bar)  # the hole lies inside B
    rows, dot_rows = (critical_rows(ratios, *laws, **options) for ratios in (np.linspace(1 + 1e-6, x_end, 801), C_bar))
    with _sphere_figure(7.6, 4.8, **options) as (figure, (ax,)):
        draw_critical(ax, rows, biot=True, mark_limits=options.get("g_core", 1.0) == 1)
        least_crease = np.nanmin([row["g_crease"] for row in rows] + [np.inf])
        ax.set(xlim=(1, x_end), ylim=around([least_crease, 1.5 * least_crease], 1, 3, 0.5))
        _draw_dots(ax, dot_rows, "C_over_B", "g_crease")
        legend_below(ax)
    return figure


def bifurcation_curves(cases: Sequence[Case]) -> Figure:
    """Critical growth of every degree l: a panel per law and mu ratio, a curve per thickness, a mark at the minimum.

    Thin horizontal lines of the same style are the crease criterion, at the same kappa_ratio.
    """
    rows, laws, mu_ratios, thicknesses, sphere = _parameters(cases)
    x_end = max(10, *(row["curve"][-1]["degree"] for row in rows))
    g_crit = [g for b in (case.bifurcation for case in cases) for g in (b.g_crit, b.g_crease, b.short_wave)]
    width, height = 4.7 * len(laws) + 0.4, 2.9 * len(mu_ratios) + 1.0
    with _sphere_figure(width, height, len(mu_ratios), len(laws), **sphere) as (figure, axes):
        for ax, (mu_ratio, law) in zip(axes, product(mu_ratios, laws)):
            panel_rows = [row for row in rows if (row["law"], row["mu_ratio"]) == (law, mu_ratio)]
            for row in panel_rows:
                style = line_style(thicknesses.index(row["T_over_C"]))
                _draw(ax, row["curve"], "degree", "g_crit", **style)
                ax.axhline(row["g_crease"], **style, **THIN)
                # where the shortest waves come first, the minimum is beyond the axis: an arrow at its end
                x, marker = (x_end, ">") if row["degree"] == "inf" else (row["degree"], "o")
                ax.plot([x], row["g_crit"], marker=marker, markersize=7, color=style["color"], clip_on=False, zorder=3)
            title = f"{law} growth, {MU_RATIO_LABEL.format(mu_ratio)}"
            _finish_panel(ax, panel_rows, xscale="log", xlim=(1, x_end), ylim=around(g_crit, 1, 1.9, 0.1), title=title)
            ax.xaxis.set_major_formatter("{x:g}")
        legend_entries = {
            **{f"$T/C$ = {T:.3g}": line_style(i) for i, T in enumerate(thicknesses)},
            "first wrinkles": {**NO_LINE_STYLE, "marker": "o"},
            "crease criterion": {"color": GREY, **THIN},
        }
        legend_of_figure(figure, legend_entries | _shortest_waves(rows, ">"), axes[0], 1 + len(laws))
    return figure


def crease_or_wrinkle(cases: Sequence[Case]) -> Figure:
    """Critical growth of wrinkles and of creases against T/C, a panel per law; the lower one comes first.

    The crease criterion is the black line, Eqs. (12) and (13), if incompressible. Otherwise it depends on the mu ratio
    and is a thin line of the same style. Triangles: the shortest waves come first.
    """
    rows, laws, mu_ratios, thicknesses, sphere = _parameters(cases)
    x_end = max(0.2, np.ceil(max(thicknesses) * 20 - 1e-9) / 20)
    y_limits = around([row["g_crit"] for row in rows], 1, 1.8, 0.2)
    dot_style: Style = {"marker": "o", "markersize": 4.5} if len(thicknesses) < 12 else {}
    styles = [{**line_style(i), **dot_style} for i in range(1, 1 + len(mu_ratios))]
    legend_entries = {f"wrinkles (theory), {MU_RATIO_LABEL.format(mu)}": style for mu, style in zip(mu_ratios, styles)}
    crease_style: Style = {"color": BLACK, "linewidth": 2.4}
    is_incompressible = sphere["kappa_ratio"] == np.inf
    if is_incompressible:
        legend_entries = {"creases (theory), Eqs. (12) and (13)": crease_style, **legend_entries}
    else:
        legend_entries["creases (theory), same style"] = {"color": GREY, **THIN, **dot_style}
    with _sphere_figure(3.6 + 2.8 * len(laws), 4.6, 1, len(laws), **sphere) as (figure, axes):
        for ax, (law, _, law_rows) in zip(axes, _by_value(rows, "law")):
            if is_incompressible:
                T = np.linspace(1e-6, x_end, 801)
                ax.plot(T, theory.critical_growth(1 / (1 - T), law), **crease_style)
            for style, (_, _, ratio_rows) in zip(styles, _by_value(law_rows, "mu_ratio")):
                _draw(ax, ratio_rows, "T_over_C", "g_crit", **style, clip_on=False)
                if not is_incompressible:
                    _draw(ax, ratio_rows, "T_over_C", "g_crease", **style, **THIN)
                shortest_wave_rows = [row for row in ratio_rows if row["degree"] == "inf"]
                mark_style = {**NO_LINE_STYLE, "color": style["color"], "marker": "^", "clip_on": False}
                _draw(ax, shortest_wave_rows, "T_over_C", "g_crit", **mark_style)
            _finish_panel(ax, law_rows, xlim=(0, x_end), ylim=y_limits, title=f"{law} growth")
            ax.locator_params(axis="x", nbins=5)
        legend_of_figure(figure, legend_entries | _shortest_waves(rows, "^"), axes[0], len(laws))
    return figure


def draw_radius(ax: Axes, rows: Rows) -> None:
    for law, style, law_rows in _by_value(rows, "law"):
        _draw(ax, law_rows, "growth", "c_over_B", label=f"theory, {RADIUS_EQUATIONS[law]}, {law}", **style)


def draw_stress(ax: Axes, rows: Rows) -> None:
    for T, style, thick_rows in _by_value(rows, "thickness_mm"):
        _draw(ax, thick_rows, "position", "sigma_theta_over_mu_cortex", label=f"theory, $T$ = {T:g} mm", **style)


def draw_critical(ax: Axes, rows: Rows, *, biot: bool = False, mark_limits: bool = True) -> None:
    """Draw creases, and with ``biot`` Biot's wrinkles; ``mark_limits``: where the paper's text says that they end."""
    for law, style, law_rows in _by_value(rows, "law"):
        _draw(ax, law_rows, "C_over_B", "g_crease", label=f"theory, {CREASE_EQUATIONS[law]}, {law}", **style)
        if biot:
            _draw(ax, law_rows, "C_over_B", "g_biot", label=f"theory, Biot's surface wrinkles, {law}", **style, **THIN)
    if mark_limits:
        _mark_paper_limits(ax, rows)


def _mark_paper_limits(ax: Axes, rows: Rows) -> None:
    """Mark the two limits in the text of the paper: 1.34 for a thin cortex, 1.2 for isotropic growth."""
    thin_limit, thickest_creasing = theory.CREASE ** (1 / 3), theory.thickest_creasing()
    limit_style: Style = {"color": GREY, "linewidth": 0.9, "zorder": 1}
    ax.axhline(thin_limit, **limit_style)
    note = f"thin cortex: $g$ = {thin_limit:.2f}"
    ax.text(0.995, thin_limit - 0.03, note, transform=ax.get_yaxis_transform(), ha="right", va="top", **NOTE_STYLE)
    if "isotropic" in _distinct(rows, "law"):
        ax.axvline(thickest_creasing, **limit_style)
        note = f"  $C/B$ = {thickest_creasing:.2f}: no crease\n  beyond, if isotropic"
        ax.text(thickest_creasing, 0.97, note, transform=ax.get_xaxis_transform(), va="top", clip_on=True, **NOTE_STYLE)


def _draw_dots(ax: Axes, rows: Rows, x_key: str, y_key: str) -> None:
    """Draw dots at the requested points within the limits, unless there are more than ``MOST_DOTS``."""
    for _, style, law_rows in _by_value(rows, "law"):
        if len(law_rows) <= MOST_DOTS:  # not clipped, so that dots at the ends stay whole
            shown = [row for row in law_rows if row[y_key] <= ax.get_ylim()[1]]
            _draw(ax, shown, x_key, y_key, linestyle="none", marker="o", color=style["color"], clip_on=False, zorder=3)


def _draw(ax: Axes, rows: Rows, x_key: str, y_key: str, **style: Any) -> None:
    """Draw a column of rows over another, and name the axes."""
    if rows:
        ax.plot([row[x_key] for row in rows], [row[y_key] for row in rows], **style)
    ax.set(xlabel=AXIS_LABELS[x_key], ylabel=AXIS_LABELS[y_key])


def _finish_panel(ax: Axes, case_rows: Rows, **settings: Any) -> None:
    """Set limits and title of a panel; write into it where no wrinkles were found, if there are such cases."""
    ax.set(**settings)
    ax.label_outer()
    smooth_T = [row["T_over_C"] for row in case_rows if np.isnan(row["g_crit"])]
    if smooth_T:
        T_range = f"$T/C$ = {min(smooth_T):.3g}" + f" to {max(smooth_T):.3g}" * (max(smooth_T) > min(smooth_T))
        note = f"{len(smooth_T)} of {len(case_rows)}: no wrinkles\nfound up to $g$ = {G_MAX:g}, {T_range}"
        ax.text(0.98, 0.03, note, transform=ax.transAxes, ha="right", va="bottom", **NOTE_STYLE)


def _shortest_waves(rows: Rows, marker: str) -> dict[str, Style]:
    """The entry of a legend for the mark of the shortest waves, if a case has them."""
    return {"shortest waves first": {**NO_LINE_STYLE, "marker": marker}} if "inf" in _distinct(rows, "degree") else {}


@contextmanager
def _sphere_figure(*size: Any, **sphere: float) -> Iterator[tuple[Figure, Any]]:
    """Panels in one row after the other, and above them the parameters that differ from the paper's sphere.

    ``size`` is as for :func:`new_figure`.
    """
    with new_figure(*size, sharex=True, sharey=True) as (figure, axes):
        yield figure, axes.ravel()
        parameters = ((value, *PAPER_SPHERE[name]) for name, value in sphere.items())
        if title := ", ".join(template.format(value) for value, usual, template in parameters if value != usual):
            figure.suptitle(title, x=0.02, ha="left", fontsize=11)


def _parameters(cases: Sequence[Case]) -> tuple[Rows, list[str], list[float], list[float], Style]:
    """Rows of the cases with their ``curve``, their laws, mu ratios and T/C, and the sphere that all share."""
    if not cases:
        raise NothingToDo("no case to draw: give at least one thickness, one mu ratio and one law.")
    rows = [{**case.row(), "curve": case.curve_rows()} for case in cases]
    laws, mu_ratios, thicknesses = (_distinct(rows, key) for key in ("law", "mu_ratio", "T_over_C"))
    sphere = {key: getattr(cases[0], key) for key in ("radius", "A_over_C", "kappa_ratio")}
    return rows, laws, mu_ratios, thicknesses, sphere


def _by_value(rows: Rows, key: str) -> Iterator[tuple[Any, Style, Rows]]:
    """Each value of a column in order of appearance, with its line style and its rows."""
    for i, value in enumerate(_distinct(rows, key)):
        yield value, line_style(i), [row for row in rows if row[key] == value]


def _distinct(rows: Rows, key: str) -> list[Any]:
    """The values of a column in order of appearance."""
    return [*dict.fromkeys(row[key] for row in rows)]
