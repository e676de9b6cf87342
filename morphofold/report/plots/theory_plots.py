"""Line plots of theory for any sphere: radius, stress, creases and wrinkles, as drawn by ``morphofold theory``.

Each function returns a :class:`matplotlib.figure.Figure`, for :func:`~morphofold.report.plots.line_plots.save`. Curves
differ in colour and in line style.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.errors import NothingToDo
from morphofold.report.plots.line_plots import (
    BLACK,
    GREY,
    around,
    legend_below,
    legend_of_figure,
    line_style,
    new_figure,
    round_step,
    set_limits,
)
from morphofold.sim import theory
from morphofold.sim.theory_tables import G_MAX, Case, Row, bifurcation_cases, critical_rows, radius_rows, stress_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARK_STYLE = {"color": GREY, "linestyle": "none"}
RADIUS_LABEL = "outer radius after growth  $c/B$"
GROWTH_LABEL = "growth stretch of the cortex  $g$"
CRITICAL_LABEL = "critical growth stretch  $g_\\mathrm{crit}$"
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
#: number of points above which dots would cover the curve
MOST_DOTS = 40


def radius_figure(
    growth: Sequence[float] = (1.0, 2.0),
    thickness: float = 2.0,
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Outer radius against growth, as in Fig. 3(a), with dots at ``growth``; options as for :func:`radius_rows`."""
    ends = (min(1.0, *growth), max(2.0, *growth))
    sphere = (thickness, radius, laws)
    rows = radius_rows(np.linspace(*ends, 201), *sphere, **options)
    with new_figure(6.4, 4.4, 1, 1) as (figure, ((ax,),)):
        draw_radius(ax, rows)
        set_limits(ax, ends, around([row["c_over_B"] for row in rows], 1, 1.3, 0.1), f"$T$ = {thickness:g} mm")
        _mark_requested_points(ax, radius_rows(growth, *sphere, **options), "growth", "c_over_B")
        legend_below(ax)
        _title_with_parameters(figure, radius=radius, **options)
    return figure


def stress_figure(
    growth: float = 2.0,
    thicknesses: Sequence[float] = (1.0, 2.0, 3.0),
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Tangential stress through the cortex, as in Fig. 3(b), one panel per law; options as for :func:`stress_rows`."""
    rows = stress_rows(growth, thicknesses, radius, laws, **{**options, "points": 101, "layers": ("cortex",)})
    sigma = [row["sigma_theta_over_mu_cortex"] for row in rows]
    step = round_step(max(map(abs, sigma)))
    limits = around(sigma, -step, 0, step)
    with new_figure(*_panel_size(laws), 1, len(laws), sharey=True) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            draw_stress(ax, [row for row in rows if row["law"] == law])
            set_limits(ax, (0, 1), limits, f"{law} growth, $g$ = {growth:g}")
            legend_below(ax)
        _title_with_parameters(figure, radius=radius, **options)
    return figure


def critical_figure(
    C_bar: Sequence[float] = (1.3,), laws: Sequence[str] = GROWTH_LAWS, *, biot: bool = True, **options: Any
) -> Figure:
    """Critical growth against C/B, as in Fig. 4, with Biot's as thin lines; options as for :func:`critical_rows`.

    Dots mark the ratios ``C_bar``.
    """
    right = max(min(1.3, 1 / max(options.get("A_over_C", 0.5), 0.1)), *C_bar)  # the hole lies inside B
    rows = critical_rows(np.linspace(1 + 1e-6, right, 801), laws, **options)
    with new_figure(7.6, 4.8, 1, 1) as (figure, ((ax,),)):
        draw_critical(ax, rows, laws, biot=biot, limits=options.get("g_core", 1.0) == 1)
        least = np.nanmin([row["g_crease"] for row in rows] + [np.inf])
        set_limits(ax, (1, right), around([least, 1.5 * least], 1, 3, 0.5), "")
        _mark_requested_points(ax, critical_rows(C_bar, laws, **options), "C_over_B", "g_crease")
        legend_below(ax)
        _title_with_parameters(figure, **options)
    return figure


def bifurcation_curves(cases: Sequence[Case] | None = None) -> Figure:
    """Critical growth of every degree l: a panel per law and mu ratio, a curve per thickness, a mark at the minimum.

    Thin horizontal lines of the same style are the crease criterion, at the same kappa_ratio. Default ``cases``:
    those of the paper, T = 1, 2, 3 mm, C = 50 mm, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases() if cases is None else cases
    laws, ratios, thicknesses = _distinct_parameters(cases)
    last = max(float(case.bifurcation.curve.degree[-1]) for case in cases)
    found = [case.bifurcation for case in cases]
    top = around([g for b in found for g in (b.g_crit, b.g_crease, b.short_wave)], 1, 1.9, 0.1)
    size = (4.7 * len(laws) + 0.4, 2.9 * len(ratios) + 1.0)
    with new_figure(*size, len(ratios), len(laws), sharex=True, sharey=True) as (figure, axes):
        for k, mu_ratio in enumerate(ratios):
            for ax, law in zip(axes[k], laws):
                set_limits(ax, (1, max(last, 10)), top, f"{law} growth, {MU_RATIO_LABEL.format(mu_ratio)}")
                for i, T in enumerate(thicknesses):
                    _draw_degree_curve(
                        ax, i, [c for c in cases if (c.law, c.mu_ratio, c.thickness) == (law, mu_ratio, T)]
                    )
                _note_missing_wrinkles(ax, [c for c in cases if (c.law, c.mu_ratio) == (law, mu_ratio)])
                ax.set_xscale("log")
                ax.xaxis.set_major_formatter("{x:g}")
                ax.set(xlabel="degree of the spherical harmonic  $l$" if k == len(ratios) - 1 else "")
                ax.set(ylabel=CRITICAL_LABEL if law == laws[0] else "")
        entries: dict[str, Any] = {
            f"$T/C$ = {T / cases[0].radius:.3g}": line_style(i) for i, T in enumerate(thicknesses)
        }
        entries |= {
            "first wrinkles": {**MARK_STYLE, "marker": "o"},
            "crease criterion": {"color": GREY, "linewidth": 1.0},
        }
        _legend_of_cases(figure, axes[0][0], cases, entries, ">", columns=3 if len(laws) > 1 else 2)
    return figure


def crease_or_wrinkle(cases: Sequence[Case] | None = None) -> Figure:
    """Critical growth of wrinkles and of creases against T/C, a panel per law; the lower one comes first.

    The crease criterion is the black line, Eqs. (12) and (13), if incompressible. Otherwise it depends on the mu ratio
    and is a thin line of the same style. Triangles: the shortest waves come first. Default ``cases``: T/C from 0.01 to
    0.2, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases(np.linspace(0.5, 10, 20)) if cases is None else cases
    laws, ratios, thicknesses = _distinct_parameters(cases)
    share = np.array(thicknesses) / cases[0].radius
    right = max(0.2, float(np.ceil(share.max() * 20 - 1e-9) / 20))
    top = around([case.bifurcation.g_crit for case in cases], 1, 1.8, 0.2)
    dots = {"marker": "o", "markersize": 4.5} if len(thicknesses) < 12 else {}
    incompressible = bool(np.isinf(cases[0].kappa_ratio))
    with new_figure(*_panel_size(laws), 1, len(laws), sharey=True) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            here = [case for case in cases if case.law == law]
            if incompressible:
                T = np.linspace(1e-6, right, 801)
                ax.plot(T, theory.critical_growth(1 / (1 - T), law), color=BLACK, linewidth=2.4)
            for i, mu_ratio in enumerate(ratios):
                mine = [case for case in here if case.mu_ratio == mu_ratio]
                _draw_wrinkles_by_thickness(ax, mine, {**line_style(i + 1), **dots}, creases=not incompressible)
            set_limits(ax, (0, right), top, f"{law} growth")
            _note_missing_wrinkles(ax, here)
            ax.set(xlabel="thickness of the cortex  $T/C$", ylabel=CRITICAL_LABEL if law == laws[0] else "")
            ax.locator_params(axis="x", nbins=5)
        entries: dict[str, Any] = {
            f"wrinkles (theory), {MU_RATIO_LABEL.format(mu)}": {**line_style(i + 1), **dots}
            for i, mu in enumerate(ratios)
        }
        if incompressible:
            entries = {"creases (theory), Eqs. (12) and (13)": {"color": BLACK, "linewidth": 2.4}, **entries}
        else:
            entries["creases (theory), same style"] = {"color": GREY, "linewidth": 1.0, **dots}
        _legend_of_cases(figure, axes[0][0], cases, entries, "^", columns=len(laws))
    return figure


def draw_radius(ax: Axes, rows: list[Row]) -> None:
    for law, line, mine in _curves_by_value(rows, "law"):
        source = "Eq. (11)" if law == "isotropic" else "as Eq. (11)"
        ax.plot(*_values_of_columns(mine, "growth", "c_over_B"), label=f"theory, {source}, {law}", **line)
    ax.set(xlabel=GROWTH_LABEL, ylabel=RADIUS_LABEL)


def draw_stress(ax: Axes, rows: list[Row]) -> None:
    for T, line, mine in _curves_by_value(rows, "thickness_mm"):
        ax.plot(
            *_values_of_columns(mine, "position", "sigma_theta_over_mu_cortex"), label=f"theory, $T$ = {T:g} mm", **line
        )
    ax.set(
        xlabel="position in the grown cortex  $(r-b)/(c-b)$",
        ylabel="tangential stress  $\\sigma_\\theta/\\mu_\\mathrm{cortex}$",
    )


def draw_critical(ax: Axes, rows: list[Row], laws: Sequence[str], *, biot: bool = False, limits: bool = True) -> None:
    for law, line, mine in _curves_by_value([row for row in rows if row["law"] in laws], "law"):
        equation = "Eq. (12)" if law == "isotropic" else "Eq. (13)"
        ax.plot(*_values_of_columns(mine, "C_over_B", "g_crease"), label=f"theory, {equation}, {law}", **line)
        if biot:
            label, thin = f"theory, Biot's surface wrinkles, {law}", {**line, "linewidth": 1.0}
            ax.plot(*_values_of_columns(mine, "C_over_B", "g_biot"), label=label, **thin)
    ax.set(xlabel="outer radius / interface radius  $C/B$", ylabel=CRITICAL_LABEL)
    if limits:
        _mark_paper_limits(ax, laws)


def _mark_paper_limits(ax: Axes, laws: Sequence[str]) -> None:
    """Mark the two limits in the text of the paper: 1.34 for a thin cortex, 1.2 for isotropic growth."""
    thin = theory.CREASE ** (1 / 3)
    ax.axhline(thin, color=GREY, linewidth=0.9, zorder=1)
    ax.text(
        0.995,
        thin - 0.03,
        f"thin cortex: $g$ = {thin:.2f}",
        transform=ax.get_yaxis_transform(),
        color=GREY,
        ha="right",
        va="top",
        fontsize=10,
    )
    if "isotropic" in laws:
        last = theory.thickest_creasing()
        ax.axvline(last, color=GREY, linewidth=0.9, zorder=1)
        ax.text(
            last,
            0.97,
            f"  $C/B$ = {last:.2f}: no crease\n  beyond, if isotropic",
            color=GREY,
            va="top",
            transform=ax.get_xaxis_transform(),
            fontsize=10,
            clip_on=True,
        )


def _draw_degree_curve(ax: Axes, index: int, cases: Sequence[Case]) -> None:
    """Draw critical growth by degree with a mark at the first wrinkles, and the crease criterion."""
    for case in cases:
        b = case.bifurcation
        ax.plot(b.curve.degree, b.curve.g, **line_style(index))
        ax.axhline(b.g_crease, **{**line_style(index), "linewidth": 1.0})
        shortest_first = np.isinf(b.mode)  # the minimum is beyond the axis: an arrow at its end
        at = ax.get_xlim()[1] if shortest_first else b.mode
        mark = ">" if shortest_first else "o"
        ax.plot([at], [b.g_crit], marker=mark, markersize=7, color=line_style(index)["color"], clip_on=False, zorder=3)


def _draw_wrinkles_by_thickness(ax: Axes, cases: Sequence[Case], line: dict[str, Any], *, creases: bool) -> None:
    """Draw wrinkles of one law and mu ratio by thickness, and creases if they depend on the mu ratio."""
    x = np.array([case.thickness / case.radius for case in cases])
    wrinkles = np.array([case.bifurcation.g_crit for case in cases])
    ax.plot(x, wrinkles, **line, clip_on=False)
    if creases:
        ax.plot(x, [case.bifurcation.g_crease for case in cases], **{**line, "linewidth": 1.0})
    shortest = np.isinf([case.bifurcation.mode for case in cases])
    if shortest.any():
        ax.plot(x[shortest], wrinkles[shortest], **{**MARK_STYLE, "color": line["color"]}, marker="^", clip_on=False)


def _mark_requested_points(ax: Axes, rows: list[Row], x: str, y: str) -> None:
    """Draw dots at the requested points within the limits, unless there are more than ``MOST_DOTS``."""
    for _, line, mine in _curves_by_value(rows, "law"):
        at = [row for row in mine if row[y] <= ax.get_ylim()[1] and len(mine) <= MOST_DOTS]
        if at:  # not clipped, so that dots at the ends stay whole
            ax.plot(
                *_values_of_columns(at, x, y),
                linestyle="none",
                marker="o",
                color=line["color"],
                clip_on=False,
                zorder=3,
            )


def _curves_by_value(rows: list[Row], name: str) -> Iterator[tuple[Any, dict[str, Any], list[Row]]]:
    """Each value of a column in order of appearance, with its line style and its rows."""
    for i, value in enumerate(dict.fromkeys(row[name] for row in rows)):
        yield value, line_style(i), [row for row in rows if row[name] == value]


def _values_of_columns(rows: list[Row], *names: str) -> list[list[float]]:
    return [[row[name] for row in rows] for name in names]


def _note_missing_wrinkles(ax: Axes, cases: Sequence[Case]) -> None:
    """Write into a panel where no wrinkles were found, if there are such cases."""
    none = [case.thickness / case.radius for case in cases if np.isnan(case.bifurcation.g_crit)]
    if none:
        share = f"$T/C$ = {min(none):.3g}" + (f" to {max(none):.3g}" if max(none) > min(none) else "")
        words = f"{len(none)} of {len(cases)}: no wrinkles\nfound up to $g$ = {G_MAX:g}, {share}"
        ax.text(0.98, 0.03, words, transform=ax.transAxes, ha="right", va="bottom", color=GREY, fontsize=10)


def _legend_of_cases(
    figure: Figure, ax: Axes, cases: Sequence[Case], entries: dict[str, Any], shortest: str, columns: int
) -> None:
    """Draw the legend, with ``shortest`` as the mark of the shortest waves, and the title with the sphere."""
    if any(np.isinf(case.bifurcation.mode) for case in cases):
        entries = {**entries, "shortest waves first": {**MARK_STYLE, "marker": shortest}}
    legend_of_figure(figure, entries, ax, columns=columns)
    _title_with_parameters(figure, radius=cases[0].radius, A_over_C=cases[0].A_over_C, kappa_ratio=cases[0].kappa_ratio)


def _title_with_parameters(figure: Figure, **parameters: float) -> None:
    """Write above all panels the parameters that differ from the paper's sphere."""
    parts = [
        PAPER_SPHERE[name][1].format(value) for name, value in parameters.items() if value != PAPER_SPHERE[name][0]
    ]
    if parts:
        figure.suptitle(", ".join(parts), x=0.02, ha="left", fontsize=11)


def _distinct_parameters(cases: Sequence[Case]) -> tuple[list[str], list[float], list[float]]:
    """Laws, mu ratios and thicknesses in order of appearance."""
    if not cases:
        raise NothingToDo("no case to draw: give at least one thickness, one mu ratio and one law.")
    laws, ratios, thicknesses = zip(*((case.law, case.mu_ratio, case.thickness) for case in cases))
    return list(dict.fromkeys(laws)), list(dict.fromkeys(ratios)), list(dict.fromkeys(thicknesses))


def _panel_size(laws: Sequence[str]) -> tuple[float, float]:
    return (9.2, 4.6) if len(laws) > 1 else (6.4, 4.6)
