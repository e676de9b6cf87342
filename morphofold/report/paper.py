"""Line plots of the theory: Figs. 3 and 4 of Razavi et al. (2015), and the bifurcation that the paper leaves out.

Each function returns a :class:`matplotlib.figure.Figure`; :func:`save` writes it, the same bytes for the same figure.
Only theory is drawn, and labels say so, for finite-element points to join. The text of the paper doesn't state the
limits of its axes: those here are ours and follow the ranges that the text names. Curves differ in colour and in
line style.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.report.colours import CATEGORICAL
from morphofold.report.theory_tables import (
    Case,
    Row,
    bifurcation_cases,
    critical_rows,
    radius_rows,
    stress_rows,
)
from morphofold.results import write_table
from morphofold.sim import theory

if TYPE_CHECKING:                                           # matplotlib takes a second to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: file endings that a figure can be written with, and what keeps the day and the program out of the file
FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None, "Creator": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
STYLE = {
    "font.size": 11, "axes.labelsize": 11, "axes.titlesize": 11, "legend.fontsize": 10,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#e4e4e0",
    "grid.linewidth": 0.7, "axes.axisbelow": True, "lines.linewidth": 1.9, "legend.frameon": False,
    "legend.handlelength": 2.8, "svg.hashsalt": "morphofold", "pdf.fonttype": 42, "savefig.dpi": 160,
}  # fmt: skip
DASHES = ((0, ()), (0, (6, 2)), (0, (1.2, 1.4)), (0, (7, 2, 1.2, 2)), (0, (3, 1.5)), (0, (7, 1.5, 1.2, 1.5, 1.2, 1.5)))
GREY = "#666666"
BLACK = "#1a1a1a"
RADIUS_LABEL = "outer radius after growth  $c/B$"
GROWTH_LABEL = "growth stretch of the cortex  $g$"
CRITICAL_LABEL = "critical growth stretch  $g_\\mathrm{crit}$"
LAWS = ("isotropic", "tangential")


def fig3() -> Figure:
    """Fig. 3: (a) outer radius against isotropic growth, (b) tangential stress through the cortex at g = 2.

    C = 50 mm; T = 2 mm in (a), 1, 2 and 3 mm in (b). Limits: g from 1 to 2, as in the text, and c/B from 1 to 1.3;
    position from the interface (0) to the outer surface (1), stress over the cortex's own modulus from -14 to 0.
    """
    rows = fig3_rows()
    with _figure(9.2, 4.4, 1, 2) as (figure, ((left, right),)):
        _draw_radius(left, [row for row in rows if row["panel"] == "a"])
        _limits(left, (1, 2), (1, 1.3), "(a)  $T$ = 2 mm, $C$ = 50 mm, isotropic growth")
        _draw_stress(right, [row for row in rows if row["panel"] == "b"])
        _limits(right, (0, 1), (-14, 0), "(b)  $g$ = 2, $C$ = 50 mm, isotropic growth")
        _legend_below(left)
        _legend_below(right)
    return figure


def fig3_rows() -> list[Row]:
    """The points of :func:`fig3`; a column that a panel doesn't use is left out of its rows."""
    radius = radius_rows(np.linspace(1, 2, 101))
    stress = stress_rows(points=101, layers=("cortex",))
    return [{"panel": "a", "source": "theory", **row} for row in radius] + [
        {"panel": "b", "source": "theory", **row} for row in stress
    ]


def fig4() -> Figure:
    """Fig. 4: growth at which creases can form against C/B, Eqs. (12) and (13), with the limits that the text names.

    Limits: C/B from 1 to 1.3, beyond the 1.2 from which isotropic growth brings no crease; g from 1 to 3.
    """
    with _figure(7.6, 4.6, 1, 1) as (figure, ((ax,),)):
        _draw_critical(ax, fig4_rows(), LAWS)
        _limits(ax, (1, 1.3), (1, 3), "")
        _legend_below(ax)
    return figure


def fig4_rows() -> list[Row]:
    """The points of :func:`fig4`."""
    rows = critical_rows(np.linspace(1, 1.3, 601)[1:])
    return [{"source": "theory", **row} for row in rows]


def radius_figure(
    growth: tuple[float, float] = (1.0, 2.0),
    thickness: float = 2.0,
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Outer radius against growth, as in Fig. 3(a), between two growths; options as for :func:`radius_rows`."""
    rows = radius_rows(np.linspace(*growth, 201), thickness, radius, laws, **options)
    with _figure(6.4, 4.4, 1, 1) as (figure, ((ax,),)):
        _draw_radius(ax, rows)
        title = f"$T$ = {thickness:g} mm, $C$ = {radius:g} mm"
        _limits(ax, _span(growth), _around([row["c_over_B"] for row in rows], 1, 1.3, 0.1), title)
        _legend_below(ax)
    return figure


def stress_figure(
    growth: float = 2.0,
    thicknesses: Sequence[float] = (1.0, 2.0, 3.0),
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Tangential stress through the cortex, as in Fig. 3(b), a panel per law; options as for :func:`stress_rows`."""
    rows = stress_rows(growth, thicknesses, radius, laws, **{**options, "points": 101, "layers": ("cortex",)})
    limits = _around([row["sigma_theta_over_mu_cortex"] for row in rows], -14, 0, 2)
    with _figure(*_panel_size(laws), 1, len(laws)) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            _draw_stress(ax, [row for row in rows if row["law"] == law])
            _limits(ax, (0, 1), limits, f"{law} growth, $g$ = {growth:g}, $C$ = {radius:g} mm")
            _legend_below(ax)
    return figure


def critical_figure(
    C_bar: tuple[float, float] = (1.0, 1.3), laws: Sequence[str] = LAWS, *, biot: bool = True, **options: Any
) -> Figure:
    """Critical growth against C/B, as in Fig. 4, and Biot's in thin lines; options as for :func:`critical_rows`."""
    low, high = _span(C_bar)
    rows = critical_rows(np.linspace(max(low, 1 + 1e-6), high, 801), laws, **options)
    with _figure(7.6, 4.8, 1, 1) as (figure, ((ax,),)):
        _draw_critical(ax, rows, laws, biot=biot, limits=options.get("g_core", 1.0) == 1)
        least = np.nanmin([row["g_crease"] for row in rows] + [np.inf])
        _limits(ax, (low, high), _around([least, 1.5 * least], 1, 3, 0.5), "")
        _legend_below(ax)
    return figure


def bifurcation_curves(cases: Sequence[Case] | None = None) -> Figure:
    """Critical growth of every degree l: a panel per law and mu ratio, a curve per thickness, the minimum marked.

    Thin horizontal lines of the same style are the crease criterion, Eqs. (12) and (13). Without ``cases``: those of
    the paper, T = 1, 2, 3 mm, C = 50 mm, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases() if cases is None else cases
    laws, ratios, thicknesses = _distinct(cases)
    last = max(float(case.bifurcation.curve.degree[-1]) for case in cases)
    top = _around([g for case in cases for g in (case.g_crease, case.bifurcation.short_wave)], 1, 1.9, 0.1)
    size = (4.7 * len(laws) + 0.4, 2.9 * len(ratios) + 1.0)
    with _figure(*size, len(ratios), len(laws), sharex=True, sharey=True) as (figure, axes):
        for k, mu_ratio in enumerate(ratios):
            for ax, law in zip(axes[k], laws):
                _limits(ax, (1, max(last, 10)), top, f"{law} growth, {_mu_ratio(mu_ratio)}")
                for i, T in enumerate(thicknesses):
                    _draw_curve(ax, i, [c for c in cases if (c.law, c.mu_ratio, c.thickness) == (law, mu_ratio, T)])
                ax.set_xscale("log")
                ax.xaxis.set_major_formatter("{x:g}")
                ax.set(xlabel="degree of the spherical harmonic  $l$" if k == len(ratios) - 1 else "")
                ax.set(ylabel=CRITICAL_LABEL if law == laws[0] else "")
        entries: dict[str, Any] = {f"$T/C$ = {T / cases[0].radius:.3g}": _line(i) for i, T in enumerate(thicknesses)}
        mark = {"color": GREY, "linestyle": "none"}
        entries |= {"first wrinkles": {**mark, "marker": "o"}, "crease criterion": {"color": GREY, "linewidth": 1.0}}
        if any(np.isinf(case.bifurcation.mode) for case in cases):
            entries["shortest waves first"] = {**mark, "marker": ">"}
        _legend_of_figure(figure, entries, axes[0][0], columns=3 if len(laws) > 1 else 2)
    return figure


def crease_or_wrinkle(cases: Sequence[Case] | None = None) -> Figure:
    """Which comes first: critical growth of wrinkles and of creases against T/C, a panel per law.

    Below the crease criterion (black; Eqs. 12 and 13, whatever the mu ratio) wrinkles come first. Without ``cases``:
    T/C from 0.01 to 0.2, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases(np.linspace(0.01, 0.2, 20), 1.0) if cases is None else cases
    laws, ratios, thicknesses = _distinct(cases)
    share = np.array(thicknesses) / cases[0].radius
    right = max(0.2, float(np.ceil(share.max() * 20 - 1e-9) / 20))
    top = _around([case.bifurcation.g_crit for case in cases], 1, 1.8, 0.2)
    with _figure(*_panel_size(laws), 1, len(laws), sharey=True) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            T = np.linspace(1e-6, right, 801)
            ax.plot(T, theory.critical_growth(1 / (1 - T), law), color=BLACK, linewidth=2.4)
            for i, mu_ratio in enumerate(ratios):
                mine = [case for case in cases if (case.law, case.mu_ratio) == (law, mu_ratio)]
                mark = {"marker": "o", "markersize": 4.5} if len(mine) < 12 else {}
                x, y = [c.thickness / c.radius for c in mine], [c.bifurcation.g_crit for c in mine]
                ax.plot(x, y, **_line(i + 1), **mark)
            _limits(ax, (0, right), top, f"{law} growth")
            ax.set(xlabel="thickness of the cortex  $T/C$", ylabel=CRITICAL_LABEL if law == laws[0] else "")
            ax.locator_params(axis="x", nbins=5)
        entries = {f"wrinkles (theory), {_mu_ratio(mu)}": _line(i + 1) for i, mu in enumerate(ratios)}
        entries = {"creases (theory), Eqs. (12) and (13)": {"color": BLACK, "linewidth": 2.4}, **entries}
        _legend_of_figure(figure, entries, axes[0][0], columns=len(laws))
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of its ending, one of :data:`FORMATS`."""
    with _style():
        figure.savefig(path, format=check_format(path)[1:], metadata=FORMATS[check_format(path)])


def check_format(path: Path) -> str:
    """Ending of a figure's file in small letters; ``ValueError`` if it is none of :data:`FORMATS`."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise ValueError(f"{path}: a figure is written as {', '.join(FORMATS)}; name a file that ends so.")
    return ending


def reproduce_fig3(folder: Path) -> dict[str, Any]:
    """Write fig3.png and fig3.tsv into ``folder``; what an index should say of them."""
    columns = ("panel", "source", "law", "thickness_mm", "outer_radius_mm", "growth", "c_over_B", "c_over_C")
    files = _write(folder, "fig3", fig3(), columns, fig3_rows())
    return {
        "files": files,
        "shows": "(a) outer radius against growth, (b) tangential stress through the cortex",
        "equations": "(a) Eq. (11); (b) Eqs. (4) to (6) integrated in closed form, zero radial stress outside",
        "parameters": {
            "law": "isotropic", "outer_radius_mm": 50, "mu_ratio": 1,
            "a": {"thickness_mm": 2, "growth": [1, 2]}, "b": {"thickness_mm": [1, 2, 3], "growth": 2},
        },
        "limits": "ours, after the ranges in the text: g 1 to 2, c/B 1 to 1.3; position 0 to 1, stress/mu -14 to 0",
    }  # fmt: skip


def reproduce_fig4(folder: Path) -> dict[str, Any]:
    """Write fig4.png and fig4.tsv into ``folder``; what an index should say of them."""
    files = _write(folder, "fig4", fig4(), ("source", "law", "C_over_B", "T_over_C", "g_crease"), fig4_rows())
    return {
        "files": files,
        "shows": "growth at which creases can form, against the outer radius",
        "equations": "Eq. (12), isotropic; Eq. (13), tangential; criterion lambda_r/lambda_theta = 2.4, Eq. (7)",
        "parameters": {"law": list(LAWS), "C_over_B": [1, 1.3], "g_core": 1},
        "limits": "ours, after the ranges in the text: C/B 1 to 1.3, g 1 to 3",
    }


#: figure of the paper -> function that writes its files into a folder
REPRODUCTIONS: dict[str, Callable[[Path], dict[str, Any]]] = {"fig3": reproduce_fig3, "fig4": reproduce_fig4}


def _write(folder: Path, name: str, figure: Figure, columns: Sequence[str], rows: list[Row]) -> list[str]:
    save(figure, folder / f"{name}.png")
    write_table(folder / f"{name}.tsv", columns, rows)
    return [f"{name}.png", f"{name}.tsv"]


def _draw_radius(ax: Axes, rows: list[Row]) -> None:
    for i, law in enumerate(dict.fromkeys(row["law"] for row in rows)):
        mine = [row for row in rows if row["law"] == law]
        source = "Eq. (11)" if law == "isotropic" else "as Eq. (11)"
        label = f"theory, {source}, {law}"
        ax.plot([row["growth"] for row in mine], [row["c_over_B"] for row in mine], label=label, **_line(i))
    ax.set(xlabel=GROWTH_LABEL, ylabel=RADIUS_LABEL)


def _draw_stress(ax: Axes, rows: list[Row]) -> None:
    for i, T in enumerate(dict.fromkeys(row["thickness_mm"] for row in rows)):
        mine = [row for row in rows if row["thickness_mm"] == T]
        x, y = [row["position"] for row in mine], [row["sigma_theta_over_mu_cortex"] for row in mine]
        ax.plot(x, y, label=f"theory, $T$ = {T:g} mm", **_line(i))
    ax.set(
        xlabel="position in the grown cortex  $(r-b)/(c-b)$",
        ylabel="tangential stress  $\\sigma_\\theta/\\mu_\\mathrm{cortex}$",
    )


def _draw_critical(
    ax: Axes, rows: list[Row], laws: Sequence[str], *, biot: bool = False, limits: bool = True
) -> None:
    for i, law in enumerate(laws):
        mine = [row for row in rows if row["law"] == law]
        x = [row["C_over_B"] for row in mine]
        equation = "Eq. (12)" if law == "isotropic" else "Eq. (13)"
        ax.plot(x, [row["g_crease"] for row in mine], label=f"theory, {equation}, {law}", **_line(i))
        if biot:
            thin = {**_line(i), "linewidth": 1.0}
            ax.plot(x, [row["g_biot"] for row in mine], label=f"theory, Biot's surface wrinkles, {law}", **thin)
    ax.set(xlabel="outer radius over the interface's  $C/B$", ylabel=CRITICAL_LABEL)
    if limits:
        _mark_limits(ax, laws)


def _mark_limits(ax: Axes, laws: Sequence[str]) -> None:
    """The two limits that the text of the paper names: 1.34 for a thin cortex, 1.2 for isotropic growth."""
    thin = theory.CREASE ** (1 / 3)
    ax.axhline(thin, color=GREY, linewidth=0.9, zorder=1)
    ax.text(0.995, thin - 0.03, f"thin cortex: $g$ = {thin:.2f}", transform=ax.get_yaxis_transform(),
            color=GREY, ha="right", va="top", fontsize=10)  # fmt: skip
    if "isotropic" in laws:
        last = theory.thickest_creasing()
        ax.axvline(last, color=GREY, linewidth=0.9, zorder=1)
        ax.text(last, 0.97, f"  $C/B$ = {last:.2f}: no crease\n  beyond, if isotropic", color=GREY, va="top",
                transform=ax.get_xaxis_transform(), fontsize=10, clip_on=True)  # fmt: skip


def _draw_curve(ax: Axes, index: int, cases: Sequence[Case]) -> None:
    """Critical growth by degree, the first wrinkles marked, and the crease criterion."""
    for case in cases:
        b = case.bifurcation
        ax.plot(b.curve.degree, b.curve.g, **_line(index))
        ax.axhline(case.g_crease, **{**_line(index), "linewidth": 1.0})
        shortest_first = np.isinf(b.mode)                   # the minimum lies beyond every axis: an arrow at its end
        at = ax.get_xlim()[1] if shortest_first else b.mode
        mark = ">" if shortest_first else "o"
        ax.plot([at], [b.g_crit], marker=mark, markersize=7, color=_line(index)["color"], clip_on=False, zorder=3)


def _distinct(cases: Sequence[Case]) -> tuple[list[str], list[float], list[float]]:
    """Laws, mu ratios and thicknesses in the order in which they come."""
    if not cases:
        raise ValueError("no case to draw: give at least one thickness, one mu ratio and one law.")
    return (
        list(dict.fromkeys(case.law for case in cases)),
        list(dict.fromkeys(case.mu_ratio for case in cases)),
        list(dict.fromkeys(case.thickness for case in cases)),
    )


def _mu_ratio(value: float) -> str:
    return f"$\\mu_\\mathrm{{cortex}}/\\mu_\\mathrm{{core}}$ = {value:g}"


def _line(index: int) -> dict[str, Any]:
    """Colour and dashes of one curve of several; neither is needed to tell the first six apart."""
    return {"color": CATEGORICAL[index % len(CATEGORICAL)], "linestyle": DASHES[index % len(DASHES)]}


def _limits(ax: Axes, x: tuple[float, float], y: tuple[float, float], title: str) -> None:
    ax.set(xlim=x, ylim=y)
    ax.set_title(title, loc="left")


def _around(values: Sequence[float], low: float, high: float, step: float) -> tuple[float, float]:
    """Limits low to high, moved out by whole steps where finite values lie beyond."""
    finite = np.array([v for v in values if np.isfinite(v)] or [low])
    below = step * np.floor(finite.min() / step + 1e-9)
    above = step * np.ceil(finite.max() / step - 1e-9)
    return min(low, float(below)), max(high, float(above))


def _span(values: tuple[float, float]) -> tuple[float, float]:
    """Limits in rising order, of some width."""
    low, high = min(values), max(values)
    return (low, high) if high > low else (low - 0.05, high + 0.05)


def _panel_size(laws: Sequence[str]) -> tuple[float, float]:
    return (9.2, 4.6) if len(laws) > 1 else (6.4, 4.6)


def _legend_below(ax: Axes) -> None:
    """A legend under the axes, where it covers nothing."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)


def _legend_of_figure(figure: Figure, entries: Mapping[str, Mapping[str, Any]], ax: Axes, columns: int) -> None:
    """One legend under all panels, of lines that are not drawn."""
    handles = [ax.plot([], [], label=label, **line)[0] for label, line in entries.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


@contextmanager
def _style() -> Iterator[None]:
    """Matplotlib as shipped, with the house's changes, whatever the user's settings."""
    import matplotlib.style

    with matplotlib.style.context(["default", STYLE]):
        yield


@contextmanager
def _figure(width: float, height: float, rows: int, columns: int, **shared: Any) -> Iterator[tuple[Figure, Any]]:
    """A figure without pyplot's global state, and its axes (rows, columns); inches."""
    from matplotlib.figure import Figure

    with _style():
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **shared)
