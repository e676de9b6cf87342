"""``morphofold theory``: the answer to a question as a table, and its figure.

In go the options of a question, out come its rows as lines or JSON. What differs between questions is in theory.toml.
"""

import itertools
import math
import textwrap
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from morphofold import __version__
from morphofold.cli.command_options import Answer, Bifurcation, Critical, Stress, Theory, range_values
from morphofold.cli.terminal_output import aligned, progress
from morphofold.errors import DoesNotApply, TooLarge
from morphofold.io import atomic_file
from morphofold.io.atomic_folders import refuse_overlap
from morphofold.io.files import check_place
from morphofold.results import theory_tables
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene

MOST_CURVES = 10  # of one kind that can be distinguished in a figure
#: number of states of a body that typically remain to be checked
STATES_STILL_TO_CHECK = 6
#: options that are no parameters of an answer
UNRECORDED = ("json", "plot", "quiet", "debug")
TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
#: all rows of an answer, and the arguments of its figure
Rows = list[dict[str, Any]]
Drawable = tuple[Rows, Sequence[Any], Mapping[str, Any]]


def run(args: Theory) -> Answer:
    question = table_name = type(args).__name__.lower()
    if isinstance(args, Bifurcation):
        table_name = "body" if args.body is not None else "curve" if args.curve else question
    table = TABLES[table_name]
    if args.plot is not None:  # refuses before anything is computed
        from morphofold.report.plots import figure_style, theory_plots  # matplotlib is imported only to draw

        figure_style.check_format(args.plot)
        check_place(args.plot)
        refuse_overlap(args.plot)
        for option in table["curves"].split():
            if (n_curves := len(getattr(args, option))) > MOST_CURVES:
                option_name = option.replace("_", "-")
                raise TooLarge(f"--plot draws at most {MOST_CURVES} numbers of --{option_name}, got {n_curves}.")
    rows, figure_arguments, figure_options = (
        _bifurcation(args) if isinstance(args, Bifurcation) else _sphere(args, question)
    )
    left_out = ", ".join(rows[0].get("left_out", ())) or "nothing"
    lines = table["title"].strip().format(args, rows[0], left_out=left_out).splitlines() + _aligned(table, rows)
    if args.plot is not None:
        figure = getattr(theory_plots, table["figure"])(*figure_arguments, **figure_options)
        with atomic_file(args.plot) as temporary:
            figure_style.save(figure, temporary)
        lines.append(f"-> {args.plot}")
    content = {"morphofold": __version__, "theory": question, "parameters": _parameters(args), "rows": rows}
    return Answer(content, lines)


def _parameters(args: Theory) -> dict[str, Any]:
    """The options of the question, for JSON, which has no infinity."""
    option_values = asdict(args)
    if isinstance(args, Bifurcation) and args.body is not None:
        option_values = {"body": args.body, "curve": False, "settings": args.set}
    return {
        key: "inf" if value == math.inf else value
        for key, value in option_values.items()
        if value not in (None, ()) and key not in UNRECORDED
    }


def _sphere(args: Theory, question: str) -> Drawable:
    if isinstance(args, Critical):
        if args.thickness:
            args.radius = args.radius or 50.0
            args.ratio = [theory_tables.outer_ratio(T, args.radius) for T in args.thickness]
        args.ratio = args.ratio or range_values(["1.02:1.3:15"])
    arguments = [getattr(args, option) for option in TABLES[question]["arguments"].split()]
    options = {name: getattr(args, option) for name, option in TABLES[question]["options"].items()}
    points_option = {"points": args.points} if isinstance(args, Stress) else {}
    rows = getattr(theory_tables, f"{question}_rows")(*arguments, **options, **points_option)
    return rows, arguments, options


def _bifurcation(args: Bifurcation) -> Drawable:
    if args.body is not None:
        return [_row_of_body(load_scene(args.body, args.set), args)], (), {}
    is_quick = len(args.laws) * len(args.mu_ratio) * len(args.thickness) <= 18
    with progress("bifurcation", args.quiet or is_quick) as on_progress:
        cases = theory_tables.bifurcation_cases(
            args.thickness,
            args.radius,
            args.mu_ratio,
            args.laws,
            kappa_ratio=args.kappa_ratio,
            A_over_C=args.hole_ratio,
            progress=on_progress,
        )
    rows = [row for case in cases for row in (case.curve_rows() if args.curve else [case.row()])]
    return rows, (cases,), {}


def _row_of_body(scene: Scene, args: Bifurcation) -> dict[str, Any]:
    if scene.geometry.shape == "radial":
        raise DoesNotApply(f"{scene.name}: a radial scene has no mesh. Leave out --body: its theory needs none.")
    state_numbers = itertools.count(1)
    with progress(scene.name, args.quiet) as on_progress:

        def on_state(g: float, eigenvalue: float) -> None:
            n_checked, state_text = next(state_numbers), "stable" if eigenvalue > 0 else "unstable"
            on_progress(n_checked / (n_checked + STATES_STILL_TO_CHECK), f"{state_text} at g = {g:.5f}")

        return theory_tables.body_row(scene, on_state)


def _aligned(table: Mapping[str, Any], rows: Rows) -> list[str]:
    """Aligned text: words to the left, numbers to the right, a dash for a missing value; reasons in footnotes."""
    reasons = dict.fromkeys(row["reason"] for row in rows if row.get("reason"))
    notes = {reason: f"[{note_number}]" for note_number, reason in enumerate(reasons, 1)}
    columns, alignments, headings = [], "", TABLES["headings"] | table.get("headings", {})
    for column in table["columns"].split():
        heading, cell_format = headings[column]
        columns.append([heading, *(_formatted_cell(row.get(column), cell_format) for row in rows)])
        alignments += ">" if cell_format else "<"
    if notes:
        columns.append(["note", *(notes.get(row["reason"], "") for row in rows)])
    footnotes = (textwrap.fill(f"{note} {reason}", 120, subsequent_indent="    ") for reason, note in notes.items())
    return [*aligned(columns, f"{alignments}<"), *"\n".join(footnotes).splitlines()]


def _formatted_cell(value: Any, cell_format: str) -> str:
    if value is None or value != value:
        return "–"
    return "∞" if value == "inf" else format(value, cell_format)
