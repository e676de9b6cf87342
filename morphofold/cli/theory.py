"""``morphofold theory``: the answer to a question as a table, and its figure."""

from __future__ import annotations

import math
import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

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

MOST_CURVES = 10  # of one kind that can be distinguished in a figure
#: number of states of a body that typically remain to be checked
STATES_STILL_TO_CHECK = 6
#: options that are no parameters of an answer
UNRECORDED = ("json", "plot", "quiet", "debug")
TABLES = tomllib.loads(resources.files("morphofold.cli").joinpath("theory.toml").read_text(encoding="utf-8"))


class Table(NamedTuple):
    """The answer to a question: its name in theory.toml, all rows, values for its title, and what its figure shows."""

    name: str
    rows: list[dict[str, Any]]
    values: Mapping[str, Any]
    drawn: tuple[Any, ...] = ()
    drawn_with: Mapping[str, Any] = {}


def run(args: Theory) -> Answer:
    if args.plot is not None:  # refuses before anything is computed
        from morphofold.report.plots.line_plots import check_format

        check_format(args.plot)
        check_place(args.plot)
        refuse_overlap(args.plot)
        _refuse_many_curves(args)
    table = _table(args)
    if args.plot is not None:
        _write_plot(table, args.plot)
    content = {
        "morphofold": __version__,
        "theory": type(args).__name__.lower(),
        "parameters": _parameters(args),
        "rows": table.rows,
    }
    lines = [*TABLES[table.name]["title"].strip().format_map(table.values).splitlines(), *_aligned(table)]
    return Answer(content, [*lines, f"-> {args.plot}"] if args.plot is not None else lines)


def _parameters(args: Theory) -> dict[str, Any]:
    """The options of the question, for JSON."""
    if isinstance(args, Bifurcation) and args.body is not None:
        return {"body": args.body, "curve": False} | ({"settings": args.set} if args.set else {})
    options = {key: value for key, value in asdict(args).items() if value not in (None, []) and key not in UNRECORDED}
    return {key: "inf" if value == math.inf else value for key, value in options.items()}  # JSON has no infinity


def _table(args: Theory) -> Table:
    values = asdict(args)
    core: dict[str, Any] = {"g_core": values.get("core_growth", 1.0), "A_over_C": args.hole_ratio}
    if isinstance(args, Radius):
        sphere = (args.growth, args.thickness, args.radius, args.laws)
        values["interface_radius"] = args.radius - args.thickness
        return Table("radius", theory_tables.radius_rows(*sphere, **core), values, sphere, core)
    if isinstance(args, Stress):
        at, options = (args.growth, args.thickness, args.radius, args.laws), {"mu_ratio": args.mu_ratio, **core}
        return Table("stress", theory_tables.stress_rows(*at, points=args.points, **options), values, at, options)
    if isinstance(args, Critical):
        if args.thickness:
            args.radius = args.radius or 50.0
            args.ratio = [theory_tables.outer_ratio(T, args.radius) for T in args.thickness]
        args.ratio = args.ratio or range_values(["1.02:1.3:15"])
        rows = theory_tables.critical_rows(args.ratio, args.laws, **core)
        return Table("critical", rows, values, (args.ratio, args.laws), core)
    assert isinstance(args, Bifurcation)
    return _bifurcation_table(args, values) if args.body is None else _body_table(args.body, args)


def _bifurcation_table(args: Bifurcation, values: Mapping[str, Any]) -> Table:
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
        return Table("curve", [row for case in cases for row in case.curve_rows()], values, (cases,))
    return Table("bifurcation", [case.row() for case in cases], values, (cases,))


def _body_table(body: str, args: Bifurcation) -> Table:
    scene = load_scene(body, args.set)
    if scene.geometry.shape == "radial":
        raise DoesNotApply(f"{scene.name}: a radial scene has no mesh. Leave out --body: its theory needs none.")
    checked: list[float] = []
    with progress(scene.name, args.quiet) as show:

        def on_state(g: float, eigenvalue: float) -> None:
            checked.append(g)
            state = "stable" if eigenvalue > 0 else "unstable"
            show(len(checked) / (len(checked) + STATES_STILL_TO_CHECK), f"{state} at g = {g:.5f}")

        row = theory_tables.body_row(scene, on_state)
    return Table("body", [row], {**row, "name": scene.name, "left_out_names": ", ".join(row["left_out"]) or "nothing"})


def _refuse_many_curves(args: Theory) -> None:
    curves = {Stress: ["thickness"], Bifurcation: ["mu_ratio"]}.get(type(args), [])
    for name in ["mu_ratio", "thickness"] if getattr(args, "curve", False) else curves:
        if (count := len(getattr(args, name))) > MOST_CURVES:
            option = f"--{name.replace('_', '-')}"
            raise TooLarge(f"--plot draws at most {MOST_CURVES} numbers of {option}, got {count}.")


def _write_plot(table: Table, plot: Path) -> None:
    from morphofold.report.plots import line_plots, theory_plots  # matplotlib is imported only to draw

    figure = getattr(theory_plots, TABLES[table.name]["figure"])(*table.drawn, **table.drawn_with)
    with atomic_file(plot) as temporary:
        line_plots.save(figure, temporary)


def _aligned(table: Table) -> list[str]:
    """Aligned text: words to the left, numbers to the right, a dash for a missing value; reasons in footnotes."""
    reasons = list(dict.fromkeys(row["reason"] for row in table.rows if row.get("reason")))
    notes = {reason: f"[{number}]" for number, reason in enumerate(reasons, 1)}
    columns = []
    headings = TABLES["headings"]
    for key in TABLES[table.name]["columns"].split():
        heading, form = headings.get(f"{table.name}.{key}", headings[key])
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
