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
    G_MAX,
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
MARK = {"color": GREY, "linestyle": "none"}
BLACK = "#1a1a1a"
RADIUS_LABEL = "outer radius after growth  $c/B$"
GROWTH_LABEL = "growth stretch of the cortex  $g$"
CRITICAL_LABEL = "critical growth stretch  $g_\\mathrm{crit}$"
LAWS = ("isotropic", "tangential")
#: parameters of the paper's sphere, which titles leave out, and how they say others
PAPER = {"radius": 50.0, "A_over_C": 0.5, "g_core": 1.0, "mu_ratio": 1.0, "kappa_ratio": np.inf}
SAY = {
    "radius": "$C$ = {:g} mm", "A_over_C": "$A/C$ = {:g}", "g_core": "$g_\\mathrm{{core}}$ = {:g}",
    "mu_ratio": "$\\mu_\\mathrm{{cortex}}/\\mu_\\mathrm{{core}}$ = {:g}", "kappa_ratio": "$\\kappa/\\mu$ = {:g}",
}  # fmt: skip
#: asked points beyond which dots would cover the curve
MOST_DOTS = 40


def fig3() -> Figure:
    """Fig. 3: (a) outer radius against isotropic growth, (b) tangential stress through the cortex at g = 2.

    C = 50 mm; T = 2 mm in (a), 1, 2 and 3 mm in (b). Limits: g from 1 to 2, as in the text, and c/B from 1 to 1.3;
    position from the interface (0) to the outer surface (1), stress over the cortex's own modulus from -14 to 0.
    """
    radius, stress = fig3_rows()
    with _figure(9.2, 4.4, 1, 2) as (figure, ((left, right),)):
        _draw_radius(left, radius)
        _limits(left, (1, 2), (1, 1.3), "(a)  $T$ = 2 mm, $C$ = 50 mm, isotropic growth")
        _draw_stress(right, stress)
        _limits(right, (0, 1), (-14, 0), "(b)  $g$ = 2, $C$ = 50 mm, isotropic growth")
        _legend_below(left)
        _legend_below(right)
    return figure


def fig3_rows() -> tuple[list[Row], list[Row]]:
    """The points of :func:`fig3`, panels (a) and (b)."""
    radius, stress = radius_rows(np.linspace(1, 2, 101)), stress_rows(points=101, layers=("cortex",))
    return [{"source": "theory", **row} for row in radius], [{"source": "theory", **row} for row in stress]


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
    growth: Sequence[float] = (1.0, 2.0),
    thickness: float = 2.0,
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    **options: Any,
) -> Figure:
    """Outer radius against growth, as in Fig. 3(a), the growths asked for as dots; options as :func:`radius_rows`."""
    ends = (min(1.0, *growth), max(2.0, *growth))
    sphere = (thickness, radius, laws)
    rows = radius_rows(np.linspace(*ends, 201), *sphere, **options)
    with _figure(6.4, 4.4, 1, 1) as (figure, ((ax,),)):
        _draw_radius(ax, rows)
        _limits(ax, ends, _around([row["c_over_B"] for row in rows], 1, 1.3, 0.1), f"$T$ = {thickness:g} mm")
        _mark(ax, radius_rows(growth, *sphere, **options), "growth", "c_over_B")
        _legend_below(ax)
        _say(figure, radius=radius, **options)
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
    sigma = [row["sigma_theta_over_mu_cortex"] for row in rows]
    step = _step(max(map(abs, sigma)))
    limits = _around(sigma, -step, 0, step)
    with _figure(*_panel_size(laws), 1, len(laws), sharey=True) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            _draw_stress(ax, [row for row in rows if row["law"] == law])
            _limits(ax, (0, 1), limits, f"{law} growth, $g$ = {growth:g}")
            _legend_below(ax)
        _say(figure, radius=radius, **options)
    return figure


def critical_figure(
    C_bar: Sequence[float] = (1.3,), laws: Sequence[str] = LAWS, *, biot: bool = True, **options: Any
) -> Figure:
    """Critical growth against C/B, as in Fig. 4, and Biot's in thin lines; options as for :func:`critical_rows`.

    The ratios asked for are dots.
    """
    right = max(min(1.3, 1 / max(options.get("A_over_C", 0.5), 0.1)), *C_bar)       # the hole lies inside B
    rows = critical_rows(np.linspace(1 + 1e-6, right, 801), laws, **options)
    with _figure(7.6, 4.8, 1, 1) as (figure, ((ax,),)):
        _draw_critical(ax, rows, laws, biot=biot, limits=options.get("g_core", 1.0) == 1)
        least = np.nanmin([row["g_crease"] for row in rows] + [np.inf])
        _limits(ax, (1, right), _around([least, 1.5 * least], 1, 3, 0.5), "")
        _mark(ax, critical_rows(C_bar, laws, **options), "C_over_B", "g_crease")
        _legend_below(ax)
        _say(figure, **options)
    return figure


def bifurcation_curves(cases: Sequence[Case] | None = None) -> Figure:
    """Critical growth of every degree l: a panel per law and mu ratio, a curve per thickness, the minimum marked.

    Thin horizontal lines of the same style are the crease criterion, at the same kappa_ratio. Without ``cases``:
    those of the paper, T = 1, 2, 3 mm, C = 50 mm, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases() if cases is None else cases
    laws, ratios, thicknesses = _distinct(cases)
    last = max(float(case.bifurcation.curve.degree[-1]) for case in cases)
    found = [case.bifurcation for case in cases]
    top = _around([g for b in found for g in (b.g_crit, b.g_crease, b.short_wave)], 1, 1.9, 0.1)
    size = (4.7 * len(laws) + 0.4, 2.9 * len(ratios) + 1.0)
    with _figure(*size, len(ratios), len(laws), sharex=True, sharey=True) as (figure, axes):
        for k, mu_ratio in enumerate(ratios):
            for ax, law in zip(axes[k], laws):
                _limits(ax, (1, max(last, 10)), top, f"{law} growth, {_mu_ratio(mu_ratio)}")
                for i, T in enumerate(thicknesses):
                    _draw_curve(ax, i, [c for c in cases if (c.law, c.mu_ratio, c.thickness) == (law, mu_ratio, T)])
                _say_none(ax, [c for c in cases if (c.law, c.mu_ratio) == (law, mu_ratio)])
                ax.set_xscale("log")
                ax.xaxis.set_major_formatter("{x:g}")
                ax.set(xlabel="degree of the spherical harmonic  $l$" if k == len(ratios) - 1 else "")
                ax.set(ylabel=CRITICAL_LABEL if law == laws[0] else "")
        entries: dict[str, Any] = {f"$T/C$ = {T / cases[0].radius:.3g}": _line(i) for i, T in enumerate(thicknesses)}
        entries |= {"first wrinkles": {**MARK, "marker": "o"}, "crease criterion": {"color": GREY, "linewidth": 1.0}}
        if any(np.isinf(case.bifurcation.mode) for case in cases):
            entries["shortest waves first"] = {**MARK, "marker": ">"}
        _legend_of_figure(figure, entries, axes[0][0], columns=3 if len(laws) > 1 else 2)
        _say_of_cases(figure, cases)
    return figure


def crease_or_wrinkle(cases: Sequence[Case] | None = None) -> Figure:
    """Which comes first: critical growth of wrinkles and of creases against T/C, a panel per law.

    Wrinkles below the crease criterion come first. It is black, Eqs. (12) and (13), if incompressible; else it depends
    on the mu ratio, and is a thin line of the same style. Triangles: the shortest waves come first. Without ``cases``:
    T/C from 0.01 to 0.2, mu ratio 1, 2 and 4.
    """
    cases = bifurcation_cases(np.linspace(0.5, 10, 20)) if cases is None else cases
    laws, ratios, thicknesses = _distinct(cases)
    share = np.array(thicknesses) / cases[0].radius
    right = max(0.2, float(np.ceil(share.max() * 20 - 1e-9) / 20))
    top = _around([case.bifurcation.g_crit for case in cases], 1, 1.8, 0.2)
    dots = {"marker": "o", "markersize": 4.5} if len(thicknesses) < 12 else {}
    incompressible = bool(np.isinf(cases[0].kappa_ratio))
    with _figure(*_panel_size(laws), 1, len(laws), sharey=True) as (figure, axes):
        for ax, law in zip(axes[0], laws):
            here = [case for case in cases if case.law == law]
            if incompressible:
                T = np.linspace(1e-6, right, 801)
                ax.plot(T, theory.critical_growth(1 / (1 - T), law), color=BLACK, linewidth=2.4)
            for i, mu_ratio in enumerate(ratios):
                _draw_map(ax, [case for case in here if case.mu_ratio == mu_ratio], _line(i + 1), dots, incompressible)
            _limits(ax, (0, right), top, f"{law} growth")
            _say_none(ax, here)
            ax.set(xlabel="thickness of the cortex  $T/C$", ylabel=CRITICAL_LABEL if law == laws[0] else "")
            ax.locator_params(axis="x", nbins=5)
        entries: dict[str, Any] = {f"wrinkles (theory), {_mu_ratio(mu)}": {**_line(i + 1), **dots}
                                   for i, mu in enumerate(ratios)}  # fmt: skip
        if incompressible:
            entries = {"creases (theory), Eqs. (12) and (13)": {"color": BLACK, "linewidth": 2.4}, **entries}
        else:
            entries["creases (theory), same style"] = {"color": GREY, "linewidth": 1.0, **dots}
        if any(np.isinf(case.bifurcation.mode) for case in cases):
            entries["shortest waves first"] = {**MARK, "marker": "^"}
        _legend_of_figure(figure, entries, axes[0][0], columns=len(laws))
        _say_of_cases(figure, cases)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of its ending, one of :data:`FORMATS`."""
    with _style():
        figure.savefig(path, format=check_format(path)[1:], metadata=FORMATS[check_format(path)])


def check_format(path: Path) -> str:
    """Ending of a figure's file in small letters; ``ValueError`` if it is none of :data:`FORMATS`."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise ValueError(f"{path}: a figure is written as {', '.join(FORMATS)}; name one such as figure.png.")
    return ending


def reproduce_fig3(folder: Path) -> dict[str, Any]:
    """Write fig3.png, fig3a.tsv and fig3b.tsv into ``folder``; what an index should say of them."""
    save(fig3(), folder / "fig3.png")
    for panel, rows in zip("ab", fig3_rows()):
        write_table(folder / f"fig3{panel}.tsv", list(rows[0]), rows)
    return {
        "files": ["fig3.png", "fig3a.tsv", "fig3b.tsv"],
        "shows": "(a) outer radius against growth, (b) tangential stress through the cortex",
        "equations": "(a) Eq. (11); (b) Eqs. (4) to (6) integrated in closed form, zero radial stress outside",
        "parameters": {
            "law": "isotropic", "outer_radius_mm": 50,
            "a": {"thickness_mm": 2, "growth": [1, 2]},
            "b": {"thickness_mm": [1, 2, 3], "growth": 2, "mu_ratio": 1},
        },
        "limits": "ours, after the ranges in the text: g 1 to 2, c/B 1 to 1.3; position 0 to 1, stress/mu -14 to 0",
    }  # fmt: skip


def reproduce_fig4(folder: Path) -> dict[str, Any]:
    """Write fig4.png and fig4.tsv into ``folder``; what an index should say of them."""
    save(fig4(), folder / "fig4.png")
    write_table(folder / "fig4.tsv", ("source", "law", "C_over_B", "T_over_C", "g_crease"), fig4_rows())
    return {
        "files": ["fig4.png", "fig4.tsv"],
        "shows": "growth at which creases can form, against the outer radius",
        "equations": "Eq. (12), isotropic; Eq. (13), tangential; criterion lambda_r/lambda_theta = 2.4, Eq. (7)",
        "parameters": {"law": list(LAWS), "C_over_B": [1, 1.3], "g_core": 1},
        "limits": "ours, after the ranges in the text: C/B 1 to 1.3, g 1 to 3",
    }


#: figure of the paper -> function that writes its files into a folder
REPRODUCTIONS: dict[str, Callable[[Path], dict[str, Any]]] = {"fig3": reproduce_fig3, "fig4": reproduce_fig4}


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
    ax.set(xlabel="outer radius / interface radius  $C/B$", ylabel=CRITICAL_LABEL)
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
        ax.axhline(b.g_crease, **{**_line(index), "linewidth": 1.0})
        shortest_first = np.isinf(b.mode)                   # the minimum lies beyond every axis: an arrow at its end
        at = ax.get_xlim()[1] if shortest_first else b.mode
        mark = ">" if shortest_first else "o"
        ax.plot([at], [b.g_crit], marker=mark, markersize=7, color=_line(index)["color"], clip_on=False, zorder=3)


def _draw_map(
    ax: Axes, cases: Sequence[Case], line: dict[str, Any], dots: dict[str, Any], incompressible: bool
) -> None:
    """Wrinkles of one law and mu ratio by thickness; their creases too if those depend on the mu ratio."""
    x = np.array([case.thickness / case.radius for case in cases])
    wrinkles, creases = (np.array([getattr(c.bifurcation, name) for c in cases]) for name in ("g_crit", "g_crease"))
    ax.plot(x, wrinkles, **line, **dots, clip_on=False)
    if not incompressible:
        ax.plot(x, creases, **{**line, **dots, "linewidth": 1.0})
    shortest = np.isinf([case.bifurcation.mode for case in cases])
    if shortest.any():
        ax.plot(x[shortest], wrinkles[shortest], **{**MARK, "color": line["color"]}, marker="^", clip_on=False)


def _mark(ax: Axes, rows: list[Row], x: str, y: str) -> None:
    """Dots on numbers that were asked for, within the limits, as long as there is room between them."""
    for i, law in enumerate(dict.fromkeys(row["law"] for row in rows)):
        mine = [row for row in rows if row["law"] == law]
        at = [(row[x], row[y]) for row in mine if row[y] <= ax.get_ylim()[1] and len(mine) <= MOST_DOTS]
        if at:                                              # not clipped: dots at the ends stay whole
            ax.plot(*zip(*at), linestyle="none", marker="o", color=_line(i)["color"], clip_on=False, zorder=3)


def _say_none(ax: Axes, cases: Sequence[Case]) -> None:
    """Words in a panel that has gaps: where no wrinkles were found."""
    none = [case.thickness / case.radius for case in cases if np.isnan(case.bifurcation.g_crit)]
    if none:
        share = f"$T/C$ = {min(none):.3g}" + (f" to {max(none):.3g}" if max(none) > min(none) else "")
        words = f"{len(none)} of {len(cases)}: no wrinkles\nfound up to $g$ = {G_MAX:g}, {share}"
        ax.text(0.98, 0.03, words, transform=ax.transAxes, ha="right", va="bottom", color=GREY, fontsize=10)


def _say_of_cases(figure: Figure, cases: Sequence[Case]) -> None:
    _say(figure, radius=cases[0].radius, A_over_C=cases[0].A_over_C, kappa_ratio=cases[0].kappa_ratio)


def _say(figure: Figure, **parameters: float) -> None:
    """A line above all panels of what differs from the paper's sphere."""
    said = [SAY[name].format(value) for name, value in parameters.items() if value != PAPER[name]]
    if said:
        figure.suptitle(", ".join(said), x=0.02, ha="left", fontsize=11)


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
    return SAY["mu_ratio"].format(value)


def _line(index: int) -> dict[str, Any]:
    """Colour and dashes of one curve of several; either tells the first six apart, both the first 36."""
    return {"color": CATEGORICAL[index % 6], "linestyle": DASHES[(index + index // 6) % 6]}


def _limits(ax: Axes, x: tuple[float, float], y: tuple[float, float], title: str) -> None:
    ax.set(xlim=x, ylim=y)
    ax.set_title(title, loc="left")


def _around(values: Sequence[float], low: float, high: float, step: float) -> tuple[float, float]:
    """Limits low to high, moved out by whole steps where finite values lie beyond."""
    finite = np.array([v for v in values if np.isfinite(v)] or [low])
    below = step * np.floor(finite.min() / step + 1e-9)
    above = step * np.ceil(finite.max() / step - 1e-9)
    return min(low, float(below)), max(high, float(above))


def _step(size: float) -> float:
    """A round step, 1, 2 or 5 times a power of ten, that goes into a size 3 to 8 times."""
    if size < 1e-9:                                         # rounding, of nothing
        return 1.0
    decade = 10.0 ** np.floor(np.log10(size / 3))
    return float(decade * max(k for k in (1, 2, 5) if k * decade <= size / 3))


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
