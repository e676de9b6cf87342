"""Benchmarks of a checkout: speed, what accuracy costs, and how well folds agree.

``python3 run.py bench`` sets everything up and runs one; in an environment that is set up, ``python -m
morphofold.studies.bench`` does the same.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from morphofold.cli import Parser, add_questions, add_shared, add_threads, run_parser
from morphofold.errors import NothingToDo, NotReadable, OptionsClash, OutOfRange, UnknownName

PROGRAM = "run.py bench"
EXAMPLES = (
    "python3 run.py bench speed",
    "python3 run.py bench effects",
    "python3 run.py bench measures --vertices 10000,40000",
    "python3 run.py bench cohort --subjects 20 --workers 1,2 -o load",
    "python3 run.py bench folds --scenes fig5 --levels draft,standard --seeds 0,1 -o folds",
    "python3 run.py bench accuracy --halves measuring -o accuracy",
    "python3 run.py bench hemisphere -o hemisphere",
)
BENCHMARK_SUMMARIES = {
    "speed": "element-steps per second on this machine, bricks and tetrahedra",
    "effects": "what each effect adds to a step on this machine",
    "measures": "seconds of each measure on this machine, from 10,000 to 1,000,000 vertices",
    "cohort": "what many subjects cost in addition to their measuring: small made-up subjects, on local workers",
    "folds": "agreement of folds between meshes and between seeds; wavelength against cortical thickness",
    "accuracy": "what accuracy costs in time: error against seconds, for many settings and for other programs",
    "hemisphere": "cost and folds of an unfolded hemisphere on several meshes; a ferret beside published stages",
}
FOLDING_SCENES = ("fig5", "fig6-thin", "fig6-thick", "fig7-ratio1", "fig7-ratio4")
CASES_FOLDER = "cases"  # of an accuracy study, in its folder
TANGENTIAL_SCENES = tuple(f"{name}-tangential" for name in FOLDING_SCENES)
FOLDS_HELP = """
Grows every scene at every level of accuracy from the first seed of its imperfection. At the second-finest level (or the
only one) it also grows the scene from the other seeds. This gives convergence with the mesh and spread over seeds, and
grows the finest mesh only once. Runs are in OUT/simulations; existing runs are used again, and interrupted runs
continue. Writes folds.tsv, convergence.tsv, spread.tsv, slope.tsv and summary.json.
"""
ACCURACY_HELP = """
Solver: radius, stress and onset against theory, folds against the finest mesh or setting. It varies mesh size, elements
through the cortex, kappa/mu, pace (alone, and with the mesh), stiffness of contact, kind of element and precision.
Analysis: shapes with known answers, a real hemisphere against its own refinement, and the other programs that are
installed (extra bench).
Takes about forty minutes on two idle cores. Cases that were done on the same machine are used again, so an interrupted
study continues.
Writes points.tsv, laws.tsv, presets.tsv, budget.tsv, peers.tsv, figures/ and summary.json.
"""

LONGER_HELP = {
    "measures": "The surface is a sphere with ridges along an irregular net.",
    "cohort": "Each subject is a hemisphere of 162 vertices; its tables are as large as for FreeSurfer's first atlas.",
    "folds": FOLDS_HELP,
    "accuracy": ACCURACY_HELP,
}
#: question -> what an earlier run may have written in its folder of results
KEPT_RESULTS_HELP = {
    "cohort": "made-up subjects there are kept",
    "folds": "simulations of an earlier study there are kept",
    "accuracy": "cases of an earlier study there are kept",
    "hemisphere": "simulations of an earlier study there are kept",
}
#: question, option, metavar of its list, default, and help text
LIST_OPTIONS = (
    (
        "measures",
        "--vertices",
        "N,N",
        "10000,40000,160000,400000,1000000",
        "sizes, separated by commas (default: 10000 to 1000000; the last takes minutes)",
    ),
    (
        "cohort",
        "--subjects",
        "N,N",
        "100,400",
        "numbers of subjects, separated by commas (default: 100,400; 10000 take half an hour)",
    ),
    ("cohort", "--workers", "N,N", "1,2", "numbers of workers (default: 1,2)"),
    (
        "folds",
        "--scenes",
        "NAMES",
        ",".join((*FOLDING_SCENES, *TANGENTIAL_SCENES)),
        f"spheres, separated by commas (default: {','.join(FOLDING_SCENES)} and the same with -tangential)",
    ),
    ("folds", "--levels", "LEVELS", "draft,standard,fine", "levels of accuracy (default: draft,standard,fine)"),
    ("folds", "--seeds", "SEEDS", "0,1,2", "seeds of the imperfection (default: 0,1,2)"),
    ("folds", "--portion", "PORTION", "octant", "part of the sphere: octant, quarter, half or full (default: octant)"),
    ("folds", "--growth", "G", "1.3,1.5,1.75,2.0", "stretches at which folds are measured (default: 1.3,1.5,1.75,2.0)"),
    (
        "hemisphere",
        "--levels",
        "LEVELS",
        "draft,standard,fine",
        "levels of accuracy, from coarse to fine, or none (default: draft,standard,fine; all three take half an hour)",
    ),
    (
        "hemisphere",
        "--thickness",
        "MM,MM",
        "2.5,3,4",
        "thicknesses of the cortex at a radius of 50 mm (default: 2.5,3,4)",
    ),
    (
        "hemisphere",
        "--ferret",
        "FILES",
        "none",
        "published surfaces of a growing ferret's brain, separated by commas, the first one of which grows "
        "(default: none)",
    ),
    (
        "accuracy",
        "--halves",
        "HALVES",
        "measuring,solver",
        "halves of the study, separated by commas (default: measuring,solver)",
    ),
)
#: what --json prints, and the lines that are printed otherwise
JsonAndLines = tuple[str, list[str]]


def parser() -> Parser:
    """Return the parser of all benchmarks."""
    from rich_argparse import RichHelpFormatter

    top = Parser(prog=PROGRAM, description=__doc__, formatter_class=RichHelpFormatter)
    top.examples = EXAMPLES
    add_args(top)
    add_shared(top, default=False)
    top.set_defaults(run=run)
    return top


def add_args(parser: Parser) -> None:
    parsers = add_questions(parser, BENCHMARK_SUMMARIES, LONGER_HELP)
    for name in ("speed", "effects"):
        parsers[name].add_argument("--seconds", type=float, default=2.0, metavar="S", help="time per case (default: 2)")
    for name, what in KEPT_RESULTS_HELP.items():
        parsers[name].add_argument("-o", "--out", metavar="DIR", required=True, help=f"folder to write; {what}")
    for name, option, metavar, default, words in LIST_OPTIONS:
        parsers[name].add_argument(option, metavar=metavar, default=default, help=words)
    parsers["measures"].add_argument(
        "--against",
        metavar="PYTHON",
        help="time every measure against that of another version, in turn: the python of an environment that has it; "
        "with one size in --vertices",
    )
    parsers["measures"].add_argument(
        "--repeats", type=int, default=5, metavar="N", help="pairs of --against for each measure (default: 5)"
    )
    parsers["measures"].add_argument(
        "--peers",
        action="store_true",
        help="race the other programs that are installed (extra bench; Connectome Workbench), on 163,842 vertices",
    )
    for name, sub in parsers.items():
        if name in ("measures", "folds", "accuracy", "hemisphere"):
            add_threads(sub)
        printed = "summary.json" if name in KEPT_RESULTS_HELP else "as JSON"
        sub.add_argument("--json", action="store_true", help=f"print {printed}")
        add_shared(sub, default=argparse.SUPPRESS)  # so that they work before and after WHAT


def main(argv: Sequence[str] | None = None) -> int:
    """Run one benchmark and return its exit code, as a command of morphofold does."""
    return run_parser(PROGRAM, parser, argv)


def run(args: argparse.Namespace) -> int:
    kinds = {
        "speed": _time_solver,
        "effects": _time_effects,
        "measures": _time_measures,
        "cohort": _time_cohort,
        "folds": _run_folds_study,
        "accuracy": _run_accuracy_study,
        "hemisphere": _run_hemisphere_study,
    }
    as_json, lines = kinds[args.what](args)
    print(as_json.rstrip() if args.json else "\n".join(lines))
    return 0


def _run_folds_study(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.runs import Runs
    from morphofold.io import atomic_folder
    from morphofold.studies.folds.page import text_tables
    from morphofold.studies.folds.study import Study, planned, run_study

    study = Study(
        _parsed_list("--scenes", args.scenes, str),
        _parsed_list("--levels", args.levels, str),
        _parsed_list("--seeds", args.seeds, int),
        args.portion,
        _parsed_list("--growth", args.growth, float),
    )
    planned(study)  # refuses before anything is written
    out = Path(args.out)
    runs = Runs(out, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:
        summary = run_study(study, folder, runs)
    lines = [
        "\n\n".join(text_tables(out)),
        "",
        *(f"no {name}.tsv: {why}" for name, why in summary["left_out"].items()),
        *(f"warning: {warning}" for warning in summary["warnings"]),
        f"-> {out / 'summary.json'}",
    ]
    return (out / "summary.json").read_text(encoding="utf-8"), lines


def _run_hemisphere_study(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.runs import Runs
    from morphofold.io import atomic_folder
    from morphofold.io.files import existing_file
    from morphofold.provenance import strict_json
    from morphofold.sim.scene import LEVELS
    from morphofold.studies.person.study import run_study

    levels = () if args.levels == "none" else _parsed_list("--levels", args.levels, str)
    thicknesses = _parsed_list("--thickness", args.thickness, float)
    if not set(levels) <= set(LEVELS):
        raise UnknownName(f"--levels: {args.levels!r} is unknown; there are {', '.join(LEVELS)}.")
    named = () if args.ferret == "none" else _parsed_list("--ferret", args.ferret, str)
    surfaces = [existing_file(path, "surface") for path in named]
    if not (levels and thicknesses) and not surfaces:
        raise NothingToDo("nothing is grown. Give --levels and --thickness, or --ferret.")
    out = Path(args.out)
    runs = Runs(out, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:
        files = run_study(levels, thicknesses, surfaces, folder, runs)
        (folder / "summary.json").write_text(strict_json({"files": files}), encoding="utf-8")
    tables = [(out / name).read_text(encoding="utf-8") for name in files if name.endswith(".tsv")]
    return (out / "summary.json").read_text(encoding="utf-8"), [*tables, f"-> {out / 'summary.json'}"]


def _run_accuracy_study(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.progress import progress
    from morphofold.cli.runs import begin
    from morphofold.io import atomic_folder
    from morphofold.studies.accuracy.page import text_answers
    from morphofold.studies.accuracy.report import write_study
    from morphofold.studies.accuracy.study import HALVES, Kept, all_points, circumstances
    from morphofold.threads import set_threads

    halves = _parsed_list("--halves", args.halves, str)
    if not halves or not set(halves) <= set(HALVES):
        raise UnknownName(f"--halves: {args.halves!r} is unknown; there are {', '.join(HALVES)}.")
    set_threads(args.threads)
    out, made = Path(args.out), circumstances()
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:  # refuses a foreign folder at once
        begin(out)
        with progress("accuracy", args.quiet) as show:
            points = all_points(halves, Kept(out / CASES_FOLDER, made), show)
        write_study(points, made, folder)
    return (out / "summary.json").read_text(encoding="utf-8"), [*text_answers(out), f"-> {out / 'summary.json'}"]


def _time_cohort(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.progress import progress
    from morphofold.cli.runs import begin
    from morphofold.io import atomic_file, refuse_foreign
    from morphofold.io.folders import alone
    from morphofold.provenance import strict_json
    from morphofold.studies.speed.cohort import Load, measure_load, text_table

    counts, workers = _parsed_list("--subjects", args.subjects, int), _parsed_list("--workers", args.workers, int)
    if not counts or not workers or min(*counts, *workers) < 1 or max(workers) > 1000 or max(counts) > 10**6:
        words = "give at least 1 of each, and at most 1,000,000 subjects and 1,000 workers."
        raise OutOfRange(f"--subjects {args.subjects} --workers {args.workers}: {words}")
    out, loads = Path(args.out).absolute(), list[Load]()
    refuse_foreign(out)
    begin(out)
    with alone(out):
        for count in counts:
            for several in workers:
                with progress(f"{count} subjects, {several} workers", args.quiet) as show:
                    loads.append(measure_load(out, count, several, show))
        content = strict_json({"loads": [load.as_dict() for load in loads]})
        with atomic_file(out / "summary.json") as file:
            file.write_text(content, encoding="utf-8")
    return content, text_table(loads)


def _checked_seconds(args: argparse.Namespace) -> float:
    if not 0 < args.seconds < 3600:
        raise OutOfRange(f"--seconds must be a positive number below 3600, got {args.seconds}.")
    return args.seconds


def _parsed_list(option: str, text: str, kind: Callable[[str], Any]) -> tuple[Any, ...]:
    """Items of a list separated by commas; empty items are ignored."""
    items = [item.strip() for item in text.split(",") if item.strip()]
    try:
        return tuple(map(kind, items))
    except ValueError:
        what = "whole numbers" if kind is int else "numbers"
        raise NotReadable(f"{option}: {text!r} is not a list of {what}; separate them by commas.") from None


def _time_solver(args: argparse.Namespace) -> JsonAndLines:
    import numba

    from morphofold.studies.speed.solver import PEERS, PEERS_SOURCE, SIZES, element_speed, speed_body

    seconds, threads = _checked_seconds(args), list(dict.fromkeys((1, numba.get_num_threads())))
    rows = [
        row
        for element, sizes in SIZES.items()
        for cells in sizes
        for row in element_speed(speed_body(element, cells), threads, seconds)
    ]
    lines = [
        "million element-steps per second: force kernel (median, best) and whole steps; a brick has 8 points",
        f"{'element':8} {'elements':>8} {'threads':>8} {'median':>8} {'best':>8} {'steps':>8} {'steps per core':>15}",
        *(
            f"{r['element']:8} {r['elements']:8,} {r['threads']:8} {r['median']:8.1f} {r['best']:8.1f} "
            f"{r['steps']:8.1f} {r['steps'] / r['threads']:15.1f}"
            for r in rows
        ),
        "",
        *textwrap.wrap(f"quoted, not measured here; {PEERS_SOURCE}:", 110),
        f"{'design':31} {'threads':>7} {'ms a step':>10} {'million tet-steps/s':>20}  timed",
        *(f"{p.design:31} {p.threads:>7} {p.ms:>10} {p.millions:>20}  {p.timed}" for p in PEERS),
    ]
    return json.dumps(rows, indent=1), lines


def _time_measures(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.progress import progress
    from morphofold.studies.speed.measures import exponent, measuring_speed
    from morphofold.threads import set_threads

    sizes = sorted(set(_parsed_list("--vertices", args.vertices, int)))
    if not sizes or not 1000 <= sizes[0] <= sizes[-1] <= 10_000_000:
        raise OutOfRange(f"--vertices: sizes lie between 1,000 and 10,000,000, got {args.vertices!r}.")
    set_threads(args.threads)
    if args.peers:
        if args.against is not None:
            raise OptionsClash("--peers and --against are two benchmarks: ask for one.")
        return _race_peers(args)
    if args.against is not None:
        if len(sizes) != 1:
            raise OptionsClash("--against compares two installations at one size: name it with --vertices.")
        return _time_pairs(args, sizes[0])
    with progress("measure", args.quiet) as show:
        rows = measuring_speed(sizes, show)
    whole = [row for row in rows if row["stage"] == "all"]
    stages = list(dict.fromkeys(row["stage"] for row in rows))
    lines = [
        f"seconds with {rows[0]['threads']} threads; the cost grows as (n log n)^power, with n vertices",
        f"{'stage':20}" + "".join(f"{n:>12,}" for n in sizes) + f"{'power':>8}",
        *(
            f"{stage:20}"
            + "".join(f"{row['seconds']:12.2f}" for row in rows if row["stage"] == stage)
            + (f"{exponent(rows, stage):8.2f}" if len(sizes) > 1 else "")
            for stage in stages
        ),
        f"{'memory, GiB':20}" + "".join(f"{row['memory_GiB'] or math.nan:12.2f}" for row in whole),
    ]
    return json.dumps(rows, indent=1), lines


def _time_pairs(args: argparse.Namespace, size: int) -> JsonAndLines:
    from morphofold.cli.progress import progress
    from morphofold.shapes.folded_ball import folded_ball
    from morphofold.studies.speed.paired import paired_speed, text_table

    if args.repeats < 1:
        raise OutOfRange(f"--repeats must be 1 or more, got {args.repeats}.")
    with progress("measure", args.quiet) as show:
        rows = paired_speed(
            folded_ball(size), Path(args.against), repeats=args.repeats, threads=args.threads, progress=show
        )
    return json.dumps(rows, indent=1), text_table(rows)


def _race_peers(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.cli.progress import progress
    from morphofold.studies.speed.race import race, text_table

    with progress("race", args.quiet) as show:
        rows = race(repeats=max(args.repeats, 1), progress=show)
    return json.dumps(rows, indent=1), text_table(rows)


def _time_effects(args: argparse.Namespace) -> JsonAndLines:
    from morphofold.studies.speed.solver import effect_costs

    rows = effect_costs(seconds=_checked_seconds(args))
    lines = [
        "what each effect adds to a step of an octant of demo, one thread",
        f"{'effect':28} {'ms':>8} {'share':>8}",
        *(f"{r['effect']:28} {r['ms']:8.3f} {r['share']:8.1%}" for r in rows),
    ]
    return json.dumps(rows, indent=1), lines


if __name__ == "__main__":
    sys.exit(main())
