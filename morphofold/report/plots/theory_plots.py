"""Line plots of theory for any sphere: radius, stress, creases and wrinkles, as drawn by ``morphofold theory``.

Each function returns a :class:`matplotlib.figure.Figure`, for :func:`~morphofold.report.plots.line_plots.save`. Curves
differ in colour and in line style.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from morphofold.errors import NothingToDo
from morphofold.report.plots import line_plots
from morphofold.sim import theory
from morphofold.sim.theory_tables import G_MAX, Case, Row, critical_rows, radius_rows, stress_rows

MARK_STYLE = {"color": line_plots.GREY, "linestyle": "none"}
NOTE: dict[str, Any] = {"color": line_plots.GREY, "fontsize": 10}
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
    growth: Sequence[float],
    thickness: float = 2.0,
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Outer radius against growth, as in Fig. 3(a), with dots at ``growth``; options as for :func:`radius_rows`."""
    ends = (min(1.0, *growth), max(2.0, *growth))
    rows, dots = (radius_rows(g, thickness, radius, laws, **options) for g in (np.linspace(*ends, 201), growth))
    with _sphere_figure(6.4, 4.4, radius=radius, **options) as (figure, ((ax,),)):
        draw_radius(ax, rows)
        limits = line_plots.around([row["c_over_B"] for row in rows], 1, 1.3, 0.1)
        ax.set(xlim=ends, ylim=limits, title=f"$T$ = {thickness:g} mm")
        _draw_dots(ax, dots, "growth", "c_over_B")
        line_plots.legend_below(ax)
    return figure


def stress_figure(
    growth: float = 2.0,
    thicknesses: Sequence[float] = (1.0, 2.0, 3.0),
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Tangential stress through the cortex, as in Fig. 3(b), one panel per law; options as for :func:`stress_rows`."""
    rows = stress_rows(growth, thicknesses, radius, laws, points=101, layers=("cortex",), **options)
    sigma = [row["sigma_theta_over_mu_cortex"] for row in rows]
    step = line_plots.round_step(max(map(abs, sigma)))
    limits = line_plots.around(sigma, -step, 0, step)
    with _sphere_figure(*_size(laws), radius=radius, **options) as (figure, ((*axes,),)):
        for ax, law in zip(axes, laws):
            draw_stress(ax, [row for row in rows if row["law"] == law])
            ax.set(xlim=(0, 1), ylim=limits, title=f"{law} growth, $g$ = {growth:g}")
            line_plots.legend_below(ax)
    return figure


def critical_figure(C_bar: Sequence[float], laws: Sequence[str], **options: Any) -> Figure:
    """Critical growth against C/B, as in Fig. 4, with Biot's as thin lines; options as for :func:`critical_rows`.

    Dots mark the ratios ``C_bar``.
    """
    right = max(min(1.3, 1 / max(options.get("A_over_C", 0.5), 0.1)), *C_bar)  # the hole lies inside B
    rows, dots = (critical_rows(ratios, laws, **options) for ratios in (np.linspace(1 + 1e-6, right, 801), C_bar))
    with _sphere_figure(7.6, 4.8, **options) as (figure, ((ax,),)):
        draw_critical(ax, rows, laws, biot=True, limits=options.get("g_core", 1.0) == 1)
        least = np.nanmin([row["g_crease"] for row in rows] + [np.inf])
        ax.set(xlim=(1, right), ylim=line_plots.around([least, 1.5 * least], 1, 3, 0.5))
        _draw_dots(ax, dots, "C_over_B", "g_crease")
        line_plots.legend_below(ax)
    return figure


def bifurcation_curves(cases: Sequence[Case]) -> Figure:
    """Critical growth of every degree l: a panel per law and mu ratio, a curve per thickness, a mark at the minimum.

    Thin horizontal lines of the same style are the crease criterion, at the same kappa_ratio.
    """
    laws, ratios, thicknesses, sphere = _parameters(cases)
    last = max(float(case.bifurcation.curve.degree[-1]) for case in cases)
    critical = [g for b in (case.bifurcation for case in cases) for g in (b.g_crit, b.g_crease, b.short_wave)]
    top = line_plots.around(critical, 1, 1.9, 0.1)
    size = (4.7 * len(laws) + 0.4, 2.9 * len(ratios) + 1.0)
    with _sphere_figure(*size, len(ratios), len(laws), **sphere) as (figure, axes):
        for (k, column), ax in np.ndenumerate(axes):
            shown = [case for case in cases if (case.law, case.mu_ratio) == (laws[column], ratios[k])]
            title = f"{laws[column]} growth, {MU_RATIO_LABEL.format(ratios[k])}"
            ax.set(xscale="log", xlim=(1, max(last, 10)), ylim=top, title=title)
            ax.set(xlabel="degree of the spherical harmonic  $l$", ylabel=CRITICAL_LABEL)
            for case in shown:
                _draw_degree_curve(ax, line_plots.line_style(thicknesses.index(case.thickness)), case.bifurcation)
            _note_missing_wrinkles(ax, shown)
            ax.xaxis.set_major_formatter("{x:g}")
            ax.label_outer()
        entries: dict[str, Any] = {
            **{f"$T/C$ = {T / cases[0].radius:.3g}": line_plots.line_style(i) for i, T in enumerate(thicknesses)},
            "first wrinkles": {**MARK_STYLE, "marker": "o"},
            "crease criterion": {"color": line_plots.GREY, "linewidth": 1.0},
            **_shortest_waves(cases, ">"),
        }
        line_plots.legend_of_figure(figure, entries, axes[0][0], columns=3 if len(laws) > 1 else 2)
    return figure


def crease_or_wrinkle(cases: Sequence[Case]) -> Figure:
    """Critical growth of wrinkles and of creases against T/C, a panel per law; the lower one comes first.

    The crease criterion is the black line, Eqs. (12) and (13), if incompressible. Otherwise it depends on the mu ratio
    and is a thin line of the same style. Triangles: the shortest waves come first.
    """
    laws, ratios, thicknesses, sphere = _parameters(cases)
    right = max(0.2, float(np.ceil(max(thicknesses) / cases[0].radius * 20 - 1e-9) / 20))
    top = line_plots.around([case.bifurcation.g_crit for case in cases], 1, 1.8, 0.2)
    dots = {"marker": "o", "markersize": 4.5} if len(thicknesses) < 12 else {}
    styles = {mu_ratio: {**line_plots.line_style(i), **dots} for i, mu_ratio in enumerate(ratios, start=1)}
    thick, incompressible = {"color": line_plots.BLACK, "linewidth": 2.4}, bool(np.isinf(cases[0].kappa_ratio))
    with _sphere_figure(*_size(laws), **sphere) as (figure, ((*axes,),)):
        for ax, law in zip(axes, laws):
            shown = [case for case in cases if case.law == law]
            if incompressible:
                T = np.linspace(1e-6, right, 801)
                ax.plot(T, theory.critical_growth(1 / (1 - T), law), **thick)
            for mu_ratio, style in styles.items():
                mine = [case for case in shown if case.mu_ratio == mu_ratio]
                _draw_wrinkles_by_thickness(ax, mine, style, creases=not incompressible)
            ax.set(xlim=(0, right), ylim=top, title=f"{law} growth")
            ax.set(xlabel="thickness of the cortex  $T/C$", ylabel=CRITICAL_LABEL)
            _note_missing_wrinkles(ax, shown)
            ax.locator_params(axis="x", nbins=5)
            ax.label_outer()
        entries: dict[str, Any] = {"creases (theory), Eqs. (12) and (13)": thick} if incompressible else {}
        entries |= {f"wrinkles (theory), {MU_RATIO_LABEL.format(mu)}": style for mu, style in styles.items()}
        if not incompressible:
            entries["creases (theory), same style"] = {"color": line_plots.GREY, "linewidth": 1.0, **dots}
        line_plots.legend_of_figure(figure, entries | _shortest_waves(cases, "^"), axes[0], columns=len(laws))
    return figure


def draw_radius(ax: Axes, rows: list[Row]) -> None:
    for law, style, mine in _by_value(rows, "law"):
        source = "Eq. (11)" if law == "isotropic" else "as Eq. (11)"
        _draw(ax, mine, "growth", "c_over_B", label=f"theory, {source}, {law}", **style)
    ax.set(xlabel="growth stretch of the cortex  $g$", ylabel="outer radius after growth  $c/B$")


def draw_stress(ax: Axes, rows: list[Row]) -> None:
    for T, style, mine in _by_value(rows, "thickness_mm"):
        _draw(ax, mine, "position", "sigma_theta_over_mu_cortex", label=f"theory, $T$ = {T:g} mm", **style)
    stress = "tangential stress  $\\sigma_\\theta/\\mu_\\mathrm{cortex}$"
    ax.set(xlabel="position in the grown cortex  $(r-b)/(c-b)$", ylabel=stress)


def draw_critical(ax: Axes, rows: list[Row], laws: Sequence[str], *, biot: bool = False, limits: bool = True) -> None:
    for law, style, mine in _by_value(rows, "law"):
        equation = "Eq. (12)" if law == "isotropic" else "Eq. (13)"
        _draw(ax, mine, "C_over_B", "g_crease", label=f"theory, {equation}, {law}", **style)
        if biot:
            thin = {**style, "linewidth": 1.0}
            _draw(ax, mine, "C_over_B", "g_biot", label=f"theory, Biot's surface wrinkles, {law}", **thin)
    ax.set(xlabel="outer radius / interface radius  $C/B$", ylabel=CRITICAL_LABEL)
    if limits:
        _mark_paper_limits(ax, laws)


def _mark_paper_limits(ax: Axes, laws: Sequence[str]) -> None:
    """Mark the two limits in the text of the paper: 1.34 for a thin cortex, 1.2 for isotropic growth."""
    thin, last = theory.CREASE ** (1 / 3), theory.thickest_creasing()
    line: dict[str, Any] = {"color": line_plots.GREY, "linewidth": 0.9, "zorder": 1}
    across, up = ax.get_yaxis_transform(), ax.get_xaxis_transform()
    ax.axhline(thin, **line)
    ax.text(0.995, thin - 0.03, f"thin cortex: $g$ = {thin:.2f}", transform=across, ha="right", va="top", **NOTE)
    if "isotropic" in laws:
        ax.axvline(last, **line)
        text = f"  $C/B$ = {last:.2f}: no crease\n  beyond, if isotropic"
        ax.text(last, 0.97, text, transform=up, va="top", clip_on=True, **NOTE)


def _draw_degree_curve(ax: Axes, style: dict[str, Any], b: theory.Bifurcation) -> None:
    """Draw critical growth by degree with a mark at the first wrinkles, and the crease criterion."""
    ax.plot(b.curve.degree, b.curve.g, **style)
    ax.axhline(b.g_crease, **{**style, "linewidth": 1.0})
    # where the shortest waves come first, the minimum is beyond the axis: an arrow at its end
    at, mark = (ax.get_xlim()[1], ">") if np.isinf(b.mode) else (b.mode, "o")
    ax.plot([at], [b.g_crit], marker=mark, markersize=7, color=style["color"], clip_on=False, zorder=3)


def _draw_wrinkles_by_thickness(ax: Axes, cases: Sequence[Case], style: dict[str, Any], *, creases: bool) -> None:
    """Draw wrinkles of one law and mu ratio by thickness, and creases if they depend on the mu ratio."""
    x = np.array([case.thickness / case.radius for case in cases])
    wrinkles = np.array([case.bifurcation.g_crit for case in cases])
    ax.plot(x, wrinkles, **style, clip_on=False)
    if creases:
        ax.plot(x, [case.bifurcation.g_crease for case in cases], **{**style, "linewidth": 1.0})
    shortest = np.isinf([case.bifurcation.mode for case in cases])
    if shortest.any():
        ax.plot(x[shortest], wrinkles[shortest], **{**MARK_STYLE, "color": style["color"]}, marker="^", clip_on=False)


def _draw_dots(ax: Axes, rows: list[Row], x: str, y: str) -> None:
    """Draw dots at the requested points within the limits, unless there are more than ``MOST_DOTS``."""
    for _, style, mine in _by_value(rows, "law"):
        at = [row for row in mine if row[y] <= ax.get_ylim()[1] and len(mine) <= MOST_DOTS]
        if at:  # not clipped, so that dots at the ends stay whole
            _draw(ax, at, x, y, linestyle="none", marker="o", color=style["color"], clip_on=False, zorder=3)


def _by_value(rows: list[Row], name: str) -> Iterator[tuple[Any, dict[str, Any], list[Row]]]:
    """Each value of a column in order of appearance, with its line style and its rows."""
    for i, value in enumerate(dict.fromkeys(row[name] for row in rows)):
        yield value, line_plots.line_style(i), [row for row in rows if row[name] == value]


def _draw(ax: Axes, rows: list[Row], x: str, y: str, **style: Any) -> None:
    ax.plot([row[x] for row in rows], [row[y] for row in rows], **style)


def _note_missing_wrinkles(ax: Axes, cases: Sequence[Case]) -> None:
    """Write into a panel where no wrinkles were found, if there are such cases."""
    none = [case.thickness / case.radius for case in cases if np.isnan(case.bifurcation.g_crit)]
    if none:
        share = f"$T/C$ = {min(none):.3g}" + f" to {max(none):.3g}" * (max(none) > min(none))
        text = f"{len(none)} of {len(cases)}: no wrinkles\nfound up to $g$ = {G_MAX:g}, {share}"
        ax.text(0.98, 0.03, text, transform=ax.transAxes, ha="right", va="bottom", **NOTE)


def _shortest_waves(cases: Sequence[Case], marker: str) -> dict[str, Any]:
    """The entry of a legend for the mark of the shortest waves, if a case has them."""
    any_shortest = any(np.isinf(case.bifurcation.mode) for case in cases)
    return {"shortest waves first": {**MARK_STYLE, "marker": marker}} if any_shortest else {}


@contextmanager
def _sphere_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **sphere: float
) -> Iterator[tuple[Figure, Any]]:
    """Panels (rows, columns), and above them the parameters that differ from the paper's sphere."""
    with line_plots.new_figure(width, height, rows, columns, sharex=True, sharey=True) as (figure, axes):
        yield figure, axes
        paper = ((value, *PAPER_SPHERE[name]) for name, value in sphere.items())
        if others := ", ".join(text.format(value) for value, usual, text in paper if value != usual):
            figure.suptitle(others, x=0.02, ha="left", fontsize=11)


def _size(laws: Sequence[str]) -> tuple[float, float, int, int]:
    return (9.2 if len(laws) > 1 else 6.4, 4.6, 1, len(laws))


def _parameters(cases: Sequence[Case]) -> tuple[list[str], list[float], list[float], dict[str, Any]]:
    """Laws, mu ratios and thicknesses in order of appearance, and what all cases share."""
    if not cases:
        raise NothingToDo("no case to draw: give at least one thickness, one mu ratio and one law.")
    laws, ratios, thicknesses = zip(*((case.law, case.mu_ratio, case.thickness) for case in cases))
    shared = {name: getattr(cases[0], name) for name in ("radius", "A_over_C", "kappa_ratio")}
    return [*dict.fromkeys(laws)], [*dict.fromkeys(ratios)], [*dict.fromkeys(thicknesses)], shared
