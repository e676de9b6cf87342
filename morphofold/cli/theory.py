"""``morphofold theory``: the answer to a question as a table, and its figure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from morphofold import __version__
from morphofold.cli.options import Answer
from morphofold.cli.progress import progress
from morphofold.cli.theory_options import Bifurcation, Critical, Radius, Stress, Theory, range_values
from morphofold.errors import DoesNotApply, TooLarge
from morphofold.io import atomic_file
from morphofold.io.files import check_place
from morphofold.io.folders import refuse_overlap
from morphofold.sim import theory_tables
from morphofold.sim.scene.files import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: most rows of one answer, and most curves of one kind that can be distinguished in a figure
MOST_ROWS, MOST_CURVES = 200_000, 10
#: number of states of a body that typically remain to be checked
STATES_STILL_TO_CHECK = 6
#: options that are no parameters of an answer
UNRECORDED = ("json", "plot", "quiet", "debug", "on_interrupt")
#: key of a column -> its heading, and the format of its numbers
TABLE_COLUMNS = {
    "law": ("law", ""),
    "thickness_mm": ("T [mm]", "g"),
    "mu_ratio": ("mu ratio", "g"),
    "layer": ("layer", ""),
    "growth": ("g", ".4f"),
    "c_over_B": ("c/B", ".6f"),
    "c_over_C": ("c/C", ".6f"),
    "position": ("position", ".3f"),
    "R_mm": ("R [mm]", ".3f"),
    "r_mm": ("r [mm]", ".3f"),
    "sigma_r_over_mu_core": ("sigma_r/mu_core", ".6g"),
    "sigma_theta_over_mu_core": ("sigma_theta/mu_core", ".6g"),
    "sigma_theta_over_mu_cortex": ("sigma_theta/mu_cortex", ".6g"),
    "C_over_B": ("C/B", ".4f"),
    "T_over_C": ("T/C", ".4f"),
    "g_biot": ("g Biot", ".4f"),
    "g_crit": ("g_crit", ".5f"),
    "degree": ("l", "d"),
    "wavelength_mm": ("wavelength [mm]", ".2f"),
    "wavelength_over_T": ("over T", ".3f"),
    "wavelength_deformed_over_T": ("grown, over T", ".3f"),
    "creasing_amplitude_over_T": ("a/T to crease", ".3f"),
    "g_crease": ("g crease", ".5f"),
    "first": ("first", ""),
    "g_theory": ("by theory", ".5f"),
    "degree_theory": ("its l", "d"),
    "difference_percent": ("difference [%]", "+.2f"),
    "elements": ("elements", ",d"),
    "edge_over_T": ("edge/T", ".2f"),
    "seconds": ("seconds", ".1f"),
    "reason": ("note", ""),
}


class Table(NamedTuple):
    """The answer to a question: title, keys of the columns, all rows, and what draws the figure, if any.

    ``changed`` are the columns whose heading or format differs from TABLE_COLUMNS.
    """

    title: str
    columns: str
    rows: list[dict[str, Any]]
    draw: Callable[[], Figure] | None = None
    changed: Mapping[str, tuple[str, str]] = {}


def run(args: Theory) -> Answer:
    if args.plot is not None:  # refuses before anything is computed
        from morphofold.report.plots.line_plots import check_format

        check_format(args.plot)
        check_place(args.plot)
        refuse_overlap(args.plot)
    _refuse_large_answers(args)
    table = _table(args)
    if args.plot is not None and table.draw is not None:
        _write_plot(table.draw(), args.plot)
    parameters = {
        key: value for key, value in asdict(args).items() if value not in (None, []) and key not in UNRECORDED
    }
    if isinstance(args, Bifurcation) and args.body is not None:
        parameters = {"body": args.body, "curve": False} | ({"settings": args.set} if args.set else {})
    elif parameters.get("kappa_ratio") == math.inf:
        parameters["kappa_ratio"] = "inf"  # JSON has no infinity
    question = type(args).__name__.lower()
    content = {"morphofold": __version__, "theory": question, "parameters": parameters, "rows": table.rows}
    lines = [*table.title.splitlines(), *_aligned(table)]
    return Answer(content, [*lines, f"-> {args.plot}"] if args.plot is not None else lines)


def _table(args: Theory) -> Table:
    if isinstance(args, Radius):
        return _radius_table(args)
    if isinstance(args, Stress):
        return _stress_table(args)
    if isinstance(args, Critical):
        return _critical_table(args)
    assert isinstance(args, Bifurcation)
    return _bifurcation_table(args) if args.body is None else _body_table(args)


def _figure(name: str, *arguments: Any, **options: Any) -> Figure:
    from morphofold.report.plots import theory_plots  # matplotlib is imported only to draw

    figure: Figure = getattr(theory_plots, name)(*arguments, **options)
    return figure


def _radius_table(args: Radius) -> Table:
    core: dict[str, Any] = {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    sphere = (args.growth, args.thickness, args.radius, args.laws)
    return Table(
        f"Outer radius c of the smooth grown sphere, T = {args.thickness:g} mm, C = {args.radius:g} mm, "
        f"B = {args.radius - args.thickness:g} mm; Eqs. (9) to (11)",
        "law growth c_over_B c_over_C",
        theory_tables.radius_rows(*sphere, **core),
        partial(_figure, "radius_figure", *sphere, **core),
    )


def _stress_table(args: Stress) -> Table:
    sphere = (args.growth, args.thickness, args.radius, args.laws)
    options: dict[str, Any] = {"mu_ratio": args.mu_ratio, "g_core": args.core_growth, "A_over_C": args.hole_ratio}
    return Table(
        f"Cauchy stress at growth g = {args.growth:g}, C = {args.radius:g} mm, mu_cortex/mu_core = {args.mu_ratio:g}; "
        "tension is positive.\nUnits: the core's shear modulus mu_core; last column the cortex's own, as in Fig. 3(b). "
        "Position: 0 inside, 1 outside.",
        "law thickness_mm layer position R_mm r_mm sigma_r_over_mu_core sigma_theta_over_mu_core "
        "sigma_theta_over_mu_cortex",
        theory_tables.stress_rows(*sphere, points=args.points, **options),
        partial(_figure, "stress_figure", *sphere, **options),
    )


def _critical_table(args: Critical) -> Table:
    core: dict[str, Any] = {"g_core": args.core_growth, "A_over_C": args.hole_ratio}
    if args.thickness:
        args.radius = args.radius or 50.0
        args.ratio = [theory_tables.outer_ratio(T, args.radius) for T in args.thickness]
    args.ratio = args.ratio or range_values(["1.02:1.3:15"])
    return Table(
        "Growth at which the outer surface can crease, lambda_r/lambda_theta = 2.4 (Eq. 12 isotropic, Eq. 13 "
        "tangential),\nand at which it is unstable to waves of vanishing length (Biot, 3.383)",
        "law C_over_B T_over_C g_crease g_biot reason",
        theory_tables.critical_rows(args.ratio, args.laws, **core),
        partial(_figure, "critical_figure", args.ratio, args.laws, **core),
        {"g_crease": ("g crease", ".4f")},
    )


def _bifurcation_table(args: Bifurcation) -> Table:
    short = len(args.laws) * len(args.mu_ratio) * len(args.thickness) <= 18
    with progress("bifurcation", args.quiet or short) as show:
        cases = theory_tables.bifurcation_cases(
            args.thickness,
            args.radius,
            args.mu_ratio,
            args.laws,
            kappa_ratio=args.kappa_ratio,
            A_over_C=args.hole_ratio,
            progress=show,
        )
    if args.curve:
        title = "Growth at which spherical harmonics of degree l first grow on the smooth sphere"
        rows = [row for case in cases for row in case.curve_rows()]
        draw = partial(_figure, "bifurcation_curves", cases)
        return Table(title, "law thickness_mm mu_ratio degree g_crit reason", rows, draw)
    return Table(
        f"Growth g_crit at which the smooth sphere first wrinkles, C = {args.radius:g} mm, kappa/mu = "
        f"{args.kappa_ratio:g}; g crease: lambda_r/lambda_theta = 2.4.\n"
        "Wavelength on the ungrown sphere (grown: on the grown one). a: amplitude at which the troughs of these\n"
        "wrinkles crease (an estimate). T is the ungrown thickness throughout.",
        "law thickness_mm mu_ratio g_crit degree wavelength_mm wavelength_over_T wavelength_deformed_over_T "
        "creasing_amplitude_over_T g_crease first reason",
        [case.row() for case in cases],
        partial(_figure, "crease_or_wrinkle", cases),
    )


def _body_table(args: Bifurcation) -> Table:
    scene = load_scene(str(args.body), args.set)
    if scene.geometry.shape == "radial":
        raise DoesNotApply(f"{scene.name}: a radial scene has no mesh. Leave out --body: its theory needs none.")
    checked: list[float] = []
    with progress(scene.name, args.quiet) as show:

        def on_state(g: float, eigenvalue: float) -> None:
            checked.append(g)
            state = "stable" if eigenvalue > 0 else "unstable"
            show(len(checked) / (len(checked) + STATES_STILL_TO_CHECK), f"{state} at g = {g:.5f}")

        row = theory_tables.body_row(scene, on_state)
    title = (
        f"Growth g_crit at which the meshed body of {scene.name} loses its stability: {row['law']} growth,\n"
        f"T = {row['thickness_mm']:g} mm, mu ratio {row['mu_ratio']:g}, kappa/mu = {row['kappa_ratio']:g}; left out: "
        f"{', '.join(row['left_out']) or 'nothing'}.\nWavelength and longest edge are those of the ungrown surface."
    )
    columns = (
        "g_crit degree wavelength_mm wavelength_over_T g_theory degree_theory difference_percent elements edge_over_T "
        "seconds reason"
    )
    return Table(title, columns, [row], changed={"degree": ("l", ".1f"), "wavelength_mm": ("wave [mm]", ".2f")})


def _refuse_large_answers(args: Theory) -> None:
    """Raise before anything is computed if the answer or its figure would be too large to read."""
    values = {key: value for key, value in asdict(args).items() if isinstance(value, list) and key != "set"}
    layers = 2 * getattr(args, "points", 0.5)
    rows = int(math.prod(len(value) or 1 for value in values.values()) * len(args.laws) * layers)
    if rows > MOST_ROWS:
        raise TooLarge(f"this asks for {rows:,} rows, at most {MOST_ROWS:,} are allowed: give fewer numbers at once.")
    curves = {Stress: ["thickness"], Bifurcation: ["mu_ratio", *["thickness"] * getattr(args, "curve", False)]}
    for name in curves.get(type(args), []) if args.plot is not None else []:
        if len(values[name]) > MOST_CURVES:
            option = f"--{name.replace('_', '-')}"
            raise TooLarge(f"--plot draws at most {MOST_CURVES} numbers of {option}, got {len(values[name])}.")


def _write_plot(figure: Figure, plot: Path) -> None:

    from morphofold.report.plots import line_plots

    try:
        with atomic_file(plot) as temporary:
            line_plots.save(figure, temporary)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(plot)) from error  # not of the temporary file beside it


def _aligned(table: Table) -> list[str]:
    """Aligned text: words to the left, numbers to the right, a dash for a missing value; reasons in footnotes."""
    reasons = list(dict.fromkeys(row["reason"] for row in table.rows if row.get("reason")))
    notes = {reason: f"[{number}]" for number, reason in enumerate(reasons, 1)}
    columns = []
    for key in table.columns.split():
        heading, form = {**TABLE_COLUMNS, **table.changed}[key]
        if key != "reason" or notes:
            values = [row.get(key) for row in table.rows]
            cells = [heading, *(notes.get(v, "") if key == "reason" else _formatted_cell(v, form) for v in values)]
            width = max(map(len, cells))
            columns.append([cell.rjust(width) if form else cell.ljust(width) for cell in cells])
    lines = ["  ".join(cells).rstrip() for cells in zip(*columns)]
    footnotes = (textwrap.fill(f"{note} {reason}", 120, subsequent_indent="    ") for reason, note in notes.items())
    return [*lines, *(line for note in footnotes for line in note.splitlines())]


def _formatted_cell(value: Any, form: str) -> str:
    if value is None or value != value:
        return "–"
    return "∞" if value == "inf" else format(value, form)
