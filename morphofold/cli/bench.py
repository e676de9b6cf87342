"""Measure: ``bench speed`` times the solver on this machine, ``bench effects`` what each effect adds to a step,
``bench measures`` the measuring room, ``bench cohort`` what is around it; ``bench folds`` grows folds on several meshes
and from several imperfections and says how far they agree, and ``bench accuracy`` what accuracy costs in time."""

from __future__ import annotations

import argparse
import json
import math
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from morphofold.cli import add_shared

WORDS = {
    "speed": "element-steps per second on this machine, bricks and tetrahedra",
    "effects": "what each effect adds to a step on this machine",
    "measures": "seconds of each measure on this machine, from 10,000 to 1,000,000 vertices",
    "cohort": "what many subjects cost beside being measured: made-up small ones, on local workers",
    "folds": "do folds agree between meshes and between seeds; wavelength against cortical thickness",
    "accuracy": "what accuracy costs in time: error against seconds of many settings, and of peers",
}
SCENES = ("fig5", "fig6-thin", "fig6-thick", "fig7-ratio1", "fig7-ratio4")
CASES = "cases"         # of a study of accuracy, in its folder
TWINS = tuple(f"{name}-tangential" for name in SCENES)
FOLDS = """
Grows every scene at every level of accuracy from the first seed of its imperfection, and at the second-finest of the
levels (the only one, if there is one) from the other seeds too: convergence with the mesh and spread over seeds are
both had without growing the finest mesh more than once. Runs lie in OUT/simulations; those that are there are used
again, and interrupted ones go on. Writes folds.tsv, convergence.tsv, spread.tsv, slope.tsv and summary.json.
"""
ACCURACY = """
Solver: radius, stress and onset against theory, folds against the finest mesh or setting, over mesh size, elements
through the cortex, kappa/mu, pace (alone, and with the mesh), stiffness of contact, kind of element and precision.
Measuring room: shapes with known answers, a real hemisphere against its own refinement, and the peers that are
installed (extra bench).
Takes about an hour on two cores with nothing else to do; cases that were done on the same machine are used again, so an
interrupted study goes on.
Writes points.tsv, laws.tsv, presets.tsv, budget.tsv, peers.tsv, figures/ and summary.json.
"""


def add_args(parser: argparse.ArgumentParser) -> None:
    questions = parser.add_subparsers(dest="what", metavar="WHAT", required=True)

    def question(name: str, more: str = "") -> argparse.ArgumentParser:
        words = f"{WORDS[name][0].upper()}{WORDS[name][1:]}. {more}"
        return questions.add_parser(name, help=WORDS[name], description=words, formatter_class=parser.formatter_class)

    for name in ("speed", "effects"):
        timed = question(name)
        timed.add_argument("--seconds", type=float, default=2.0, metavar="S", help="time per case (default: 2)")
        _add_common(timed, "print as JSON")

    measures = question("measures", "The surface is a sphere with ridges along an irregular net.")
    measures.add_argument("--vertices", metavar="N,N", default="10000,40000,160000,400000,1000000",
                          help="sizes, separated by commas (default: 10000 to 1000000; the last takes minutes)")
    measures.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")
    _add_common(measures, "print as JSON")

    cohort = question("cohort", "A hemisphere of 162 vertices each, as large tables as of FreeSurfer's first atlas.")
    cohort.add_argument("-o", "--out", metavar="DIR", required=True, help="folder to write; made-up subjects stay")
    cohort.add_argument("--subjects", metavar="N,N", default="100,400",
                        help="numbers of subjects, separated by commas (default: 100,400; 10000 take half an hour)")
    cohort.add_argument("--workers", metavar="N,N", default="1,2", help="numbers of workers (default: 1,2)")
    _add_common(cohort, "print summary.json")

    folds = question("folds", FOLDS)
    folds.add_argument("-o", "--out", metavar="DIR", required=True,
                       help="folder to write; simulations of an earlier study there stay")  # fmt: skip
    folds.add_argument("--scenes", metavar="NAMES", default=",".join((*SCENES, *TWINS)),
                       help=f"spheres, separated by commas (default: {','.join(SCENES)} and their -tangential twins)")
    folds.add_argument("--levels", metavar="LEVELS", default="draft,standard,fine",
                       help="of accuracy (default: draft,standard,fine)")  # fmt: skip
    folds.add_argument("--seeds", metavar="SEEDS", default="0,1,2", help="of the imperfection (default: 0,1,2)")
    folds.add_argument("--portion", metavar="PORTION", default="octant",
                       help="of the sphere: octant, quarter, half or full (default: octant)")  # fmt: skip
    folds.add_argument("--growth", metavar="G", default="1.3,1.5,1.75,2.0",
                       help="stretches at which folds are measured (default: 1.3,1.5,1.75,2.0)")  # fmt: skip
    folds.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")
    _add_common(folds, "print summary.json")

    accuracy = question("accuracy", ACCURACY)
    accuracy.add_argument("-o", "--out", metavar="DIR", required=True,
                          help="folder to write; cases of an earlier study there stay")  # fmt: skip
    accuracy.add_argument("--halves", metavar="HALVES", default="measuring,solver",
                          help="of the tool, separated by commas (default: measuring,solver)")  # fmt: skip
    accuracy.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")
    _add_common(accuracy, "print summary.json")


def _add_common(parser: argparse.ArgumentParser, json_words: str) -> None:
    parser.add_argument("--json", action="store_true", help=json_words)
    add_shared(parser, default=argparse.SUPPRESS)           # so that they count on either side of WHAT


def run(args: argparse.Namespace) -> int:
    if args.what == "folds":
        return _folds(args)
    if args.what == "accuracy":
        return _accuracy(args)
    if args.what == "cohort":
        return _cohort(args)
    if args.what == "measures":
        rows, lines = _measures(args)
    elif not 0 < args.seconds < 3600:
        raise ValueError(f"--seconds must be a positive number below 3600, got {args.seconds}.")
    else:
        rows, lines = _speed(args.seconds) if args.what == "speed" else _effects(args.seconds)
    print(json.dumps(rows, indent=1) if args.json else "\n".join(lines))
    return 0


def _folds(args: argparse.Namespace) -> int:
    from morphofold.cli.runs import Runs
    from morphofold.io import atomic_folder
    from morphofold.studies.folds.page import text_tables
    from morphofold.studies.folds.study import Study, planned, run_study

    study = Study(
        _listed("--scenes", args.scenes, str), _listed("--levels", args.levels, str),
        _listed("--seeds", args.seeds, int), args.portion, _listed("--growth", args.growth, float),
    )  # fmt: skip
    planned(study)                                                      # refuses before anything is written
    out = Path(args.out)
    runs = Runs(out, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:
        summary = run_study(study, folder, runs)
    if args.json:
        print((out / "summary.json").read_text(encoding="utf-8"), end="")
        return 0
    print("\n\n".join(text_tables(out)), end="\n\n")
    for name, why in summary["left_out"].items():
        print(f"no {name}.tsv: {why}")
    for warning in summary["warnings"]:
        print(f"warning: {warning}")
    print(f"-> {out / 'summary.json'}")
    return 0


def _accuracy(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.cli.runs import begin
    from morphofold.io import atomic_folder
    from morphofold.studies.accuracy.page import text_answers
    from morphofold.studies.accuracy.report import write_study
    from morphofold.studies.accuracy.study import HALVES, Kept, all_points, circumstances
    from morphofold.threads import set_threads

    halves = _listed("--halves", args.halves, str)
    if not halves or not set(halves) <= set(HALVES):
        raise ValueError(f"--halves: {args.halves!r} is none; there are {', '.join(HALVES)}.")
    set_threads(args.threads)
    out, made = Path(args.out), circumstances()
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:                                  # refuses a foreign folder at once
        begin(out)
        with progress("accuracy", args.quiet) as tell:
            points = all_points(halves, Kept(out / CASES, made), tell)
        write_study(points, made, folder)
    if args.json:
        print((out / "summary.json").read_text(encoding="utf-8"), end="")
        return 0
    print("\n".join(text_answers(out)))
    print(f"-> {out / 'summary.json'}")
    return 0


def _cohort(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.cli.runs import begin
    from morphofold.io import atomic_file, refuse_foreign
    from morphofold.io.locks import alone
    from morphofold.provenance import strict_json
    from morphofold.studies.speed.cohort import Load, measure_load, text_table

    counts, workers = _listed("--subjects", args.subjects, int), _listed("--workers", args.workers, int)
    if not counts or not workers or min(*counts, *workers) < 1 or max(workers) > 1000 or max(counts) > 10**6:
        words = "name at least 1 of each, and 1,000,000 subjects and 1,000 workers at most."
        raise ValueError(f"--subjects {args.subjects} --workers {args.workers}: {words}")
    out, loads = Path(args.out).absolute(), list[Load]()
    refuse_foreign(out)
    begin(out)
    with alone(out):
        for count in counts:
            for several in workers:
                with progress(f"{count} subjects, {several} workers", args.quiet) as tell:
                    loads.append(measure_load(out, count, several, tell))
        said = strict_json({"loads": [load.as_dict() for load in loads]})
        with atomic_file(out / "summary.json") as file:
            file.write_text(said, encoding="utf-8")
    print(said.rstrip() if args.json else "\n".join(text_table(loads)))
    return 0


def _listed(option: str, text: str, kind: Callable[[str], Any]) -> tuple[Any, ...]:
    """The items of a list with commas; empty ones don't count."""
    items = [item.strip() for item in text.split(",") if item.strip()]
    try:
        return tuple(map(kind, items))
    except ValueError:
        what = "whole numbers" if kind is int else "numbers"
        raise ValueError(f"{option}: {text!r} is no list of {what}; separate them by commas.") from None


def _speed(seconds: float) -> tuple[list[dict[str, Any]], list[str]]:
    import numba

    from morphofold.studies.speed.solver import PEERS, PEERS_SOURCE, SIZES, element_speed, speed_body

    threads = list(dict.fromkeys((1, numba.get_num_threads())))
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
    return rows, lines


def _measures(args: argparse.Namespace) -> tuple[list[dict[str, Any]], list[str]]:
    from morphofold.cli.progress import progress
    from morphofold.studies.speed.measures import exponent, measuring_speed
    from morphofold.threads import set_threads

    sizes = sorted(set(_listed("--vertices", args.vertices, int)))
    if not sizes or not 1000 <= sizes[0] <= sizes[-1] <= 10_000_000:
        raise ValueError(f"--vertices: sizes lie between 1,000 and 10,000,000, got {args.vertices!r}.")
    set_threads(args.threads)
    with progress("measure", args.quiet) as tell:
        rows = measuring_speed(sizes, tell)
    whole = [row for row in rows if row["stage"] == "all"]
    stages = list(dict.fromkeys(row["stage"] for row in rows))
    lines = [
        f"seconds with {rows[0]['threads']} threads; the cost grows as the power of n log n, n being vertices",
        f"{'stage':20}" + "".join(f"{n:>12,}" for n in sizes) + f"{'power':>8}",
        *(
            f"{stage:20}" + "".join(f"{row['seconds']:12.2f}" for row in rows if row["stage"] == stage)
            + (f"{exponent(rows, stage):8.2f}" if len(sizes) > 1 else "")
            for stage in stages
        ),
        f"{'memory, GiB':20}" + "".join(f"{row['memory_GiB'] or math.nan:12.2f}" for row in whole),
    ]  # fmt: skip
    return rows, lines


def _effects(seconds: float) -> tuple[list[dict[str, Any]], list[str]]:
    from morphofold.studies.speed.solver import effect_costs

    rows = effect_costs(seconds=seconds)
    lines = [
        "what each effect adds to a step of an octant of demo, one thread",
        f"{'effect':28} {'ms':>8} {'share':>8}",
        *(f"{r['effect']:28} {r['ms']:8.3f} {r['share']:8.1%}" for r in rows),
    ]
    return rows, lines
