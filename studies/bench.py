"""Benchmarks of a checkout: speed, what accuracy costs, and how well folds agree.

``python3 run.py bench`` sets everything up and runs one; in an environment that is set up, ``python -m
morphofold.studies.bench`` does the same.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal

import numba
from cyclopts import App

from morphofold.cli import new_app, run_app
from morphofold.cli.command_options import Answer, Out, Printing, Switch, Threaded, Whole
from morphofold.cli.terminal_output import progress
from morphofold.errors import NothingToDo, NotReadable, OptionsClash, OutOfRange, UnknownName
from morphofold.io import atomic_folder, refuse_foreign
from morphofold.io.atomic_folders import alone, mark_as_ours
from morphofold.io.files import existing_file
from morphofold.io.json_files import write_json
from morphofold.sim.scene import LEVELS
from morphofold.studies.runs import Runs
from morphofold.threads import set_threads

FOLDING_SCENES = ("fig5", "fig6-thin", "fig6-thick", "fig7-ratio1", "fig7-ratio4")
TANGENTIAL_SCENES = tuple(f"{name}-tangential" for name in FOLDING_SCENES)
CASES_FOLDER = "cases"  # of an accuracy study, in its folder


@dataclass
class Speed(Printing):
    """Element-steps per second on this machine, bricks and tetrahedra.

    For example:

    - `python3 run.py bench speed`
    """

    _: KW_ONLY
    seconds: float = 2.0
    """Time per case."""


@dataclass
class Effects(Printing):
    """What each effect adds to a step on this machine.

    For example:

    - `python3 run.py bench effects`
    """

    _: KW_ONLY
    seconds: float = 2.0
    """Time per case."""


@dataclass
class Measures(Printing, Threaded):
    """Seconds of each measure on this machine, from 10,000 to 1,000,000 vertices.

    The surface is a sphere with ridges along an irregular net.

    For example:

    - `python3 run.py bench measures --vertices 10000,40000`
    """

    rules = ("--peers excludes --against",)
    _: KW_ONLY
    vertices: str = "10000,40000,160000,400000,1000000"
    """Sizes, separated by commas; the last takes minutes."""
    against: Path | None = None
    """Time every measure against that of another version, in turn: the python of an environment that has it; with one
    size in --vertices."""
    repeats: Whole = 5
    """Pairs of --against for each measure."""
    peers: Switch = False
    """Race the other programs that are installed (extra bench; Connectome Workbench), on 163,842 vertices."""


@dataclass
class Cohort(Printing):
    """What many subjects cost in addition to their measuring: small made-up subjects, on local workers.

    Each subject is a hemisphere of 162 vertices; its tables are as large as for FreeSurfer's first atlas.

    For example:

    - `python3 run.py bench cohort --subjects 20 --workers 1,2 -o load`
    """

    _: KW_ONLY
    subjects: str = "100,400"
    """Numbers of subjects, separated by commas; 10000 take half an hour."""
    workers: str = "1,2"
    """Numbers of workers."""
    out: Out
    """Folder to write; made-up subjects there are kept."""


@dataclass
class Folds(Printing, Threaded):
    """Agreement of folds between meshes and between seeds; wavelength against cortical thickness.

    Grows every scene at every level of accuracy from the first seed of its imperfection. At the second-finest level (or
    the only one) it also grows the scene from the other seeds. This gives convergence with the mesh and spread over
    seeds, and grows the finest mesh only once. Runs are in OUT/simulations; existing runs are used again, and
    interrupted runs continue. Writes folds.tsv, convergence.tsv, spread.tsv, slope.tsv and summary.json.

    For example:

    - `python3 run.py bench folds --scenes fig5 --levels draft,standard --seeds 0,1 -o folds`
    """

    _: KW_ONLY
    scenes: str = ",".join((*FOLDING_SCENES, *TANGENTIAL_SCENES))
    """Spheres, separated by commas."""
    levels: str = "draft,standard,fine"
    """Levels of accuracy."""
    seeds: str = "0,1,2"
    """Seeds of the imperfection."""
    portion: Literal["octant", "quarter", "half", "full"] = "octant"
    """Part of the sphere."""
    growth: str = "1.3,1.5,1.75,2.0"
    """Stretches at which folds are measured."""
    out: Out
    """Folder to write; simulations of an earlier study there are kept."""


@dataclass
class Accuracy(Printing, Threaded):
    """What accuracy costs in time: error against seconds, for many settings and for other programs.

    Solver: radius, stress and onset against theory, folds against the finest mesh or setting. It varies mesh size,
    elements through the cortex, kappa/mu, pace (alone, and with the mesh), stiffness of contact, kind of element and
    precision. Analysis: shapes with known answers, a real hemisphere against its own refinement, and the other programs
    that are installed (extra bench). Takes about forty minutes on two idle cores. Cases that were done on the same
    machine are used again, so an interrupted study continues. Writes points.tsv, laws.tsv, presets.tsv, budget.tsv,
    peers.tsv, figures/ and summary.json.

    For example:

    - `python3 run.py bench accuracy --halves measuring -o accuracy`
    """

    _: KW_ONLY
    halves: str = "measuring,solver"
    """Halves of the study, separated by commas."""
    out: Out
    """Folder to write; cases of an earlier study there are kept."""


@dataclass
class Hemisphere(Printing, Threaded):
    """Cost and folds of an unfolded hemisphere on several meshes; a ferret beside published stages.

    For example:

    - `python3 run.py bench hemisphere -o hemisphere`
    """

    _: KW_ONLY
    levels: str = "draft,standard,fine"
    """Levels of accuracy, from coarse to fine, or none; all three take half an hour."""
    thickness: str = "2.5,3,4"
    """Thicknesses of the cortex at a radius of 50 mm."""
    ferret: str = "none"
    """Published surfaces of a growing ferret's brain, separated by commas, the first one of which grows."""
    out: Out
    """Folder to write; simulations of an earlier study there are kept."""


def app() -> App:
    """Return the parser of all benchmarks."""
    parser = new_app("run.py bench", __doc__)
    for benchmark in BENCHMARKS:
        parser.command(benchmark, name=benchmark.__name__.lower())
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one benchmark and return its exit code, as a command of morphofold does."""
    return run_app(app(), _run, argv)


def _run(args: Printing) -> Answer:
    answer = BENCHMARKS[type(args)](args)
    return answer._replace(lines="\n".join(answer.lines).splitlines())


def _run_folds_study(args: Folds) -> Answer:
    from morphofold.studies.folds.fold_page import text_tables
    from morphofold.studies.folds.fold_study import Study, planned, run_study

    study = Study(
        _parsed_list("--scenes", args.scenes, str),
        _parsed_list("--levels", args.levels, str),
        _parsed_list("--seeds", args.seeds, int),
        args.portion,
        _parsed_list("--growth", args.growth, float),
    )
    planned(study)  # refuses before anything is written
    out = args.out
    runs = Runs(out, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:
        summary = run_study(study, folder, runs)
    report_lines = [
        "\n\n".join(text_tables(out)),
        "",
        *(f"no {table_name}.tsv: {reason}" for table_name, reason in summary["left_out"].items()),
        *(f"warning: {warning}" for warning in summary["warnings"]),
        f"-> {out / 'summary.json'}",
    ]
    return Answer(out / "summary.json", report_lines)


def _run_hemisphere_study(args: Hemisphere) -> Answer:
    from morphofold.studies.person.hemisphere_study import run_study

    levels = () if args.levels == "none" else _parsed_list("--levels", args.levels, str)
    thicknesses = _parsed_list("--thickness", args.thickness, float)
    if not set(levels) <= set(LEVELS):
        raise UnknownName(f"--levels: {args.levels!r} is unknown; there are {', '.join(LEVELS)}.")
    ferret_paths = () if args.ferret == "none" else _parsed_list("--ferret", args.ferret, str)
    surface_paths = [existing_file(path, "surface") for path in ferret_paths]
    if not (levels and thicknesses) and not surface_paths:
        raise NothingToDo("nothing is grown. Give --levels and --thickness, or --ferret.")
    out = args.out
    runs = Runs(out, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:
        file_names = run_study(levels, thicknesses, surface_paths, folder, runs)
        write_json(folder / "summary.json", {"files": file_names})
    table_texts = [(out / file).read_text(encoding="utf-8") for file in file_names if file.endswith(".tsv")]
    return Answer(out / "summary.json", [*table_texts, f"-> {out / 'summary.json'}"])


def _run_accuracy_study(args: Accuracy) -> Answer:
    from morphofold.studies.accuracy.accuracy_page import text_answers
    from morphofold.studies.accuracy.accuracy_report import write_study
    from morphofold.studies.accuracy.accuracy_study import HALVES, Cases, all_points, circumstances

    halves = _parsed_list("--halves", args.halves, str)
    if not halves or not set(halves) <= set(HALVES):
        raise UnknownName(f"--halves: {args.halves!r} is unknown; there are {', '.join(HALVES)}.")
    set_threads(args.threads)
    out, machine_info = args.out, circumstances()
    args.on_interrupt = " Run it again to go on."
    with atomic_folder(out) as folder:  # refuses a foreign folder at once
        mark_as_ours(out)
        with progress("accuracy", args.quiet) as on_progress:
            error_points = all_points(halves, Cases(out / CASES_FOLDER, machine_info), on_progress)
        write_study(error_points, machine_info, folder)
    return Answer(out / "summary.json", [*text_answers(out), f"-> {out / 'summary.json'}"])


def _time_cohort(args: Cohort) -> Answer:
    from morphofold.studies.speed.cohort_speed import measure_load, text_table

    sizes, workers = _parsed_list("--subjects", args.subjects, int), _parsed_list("--workers", args.workers, int)
    if not sizes or not workers or min(*sizes, *workers) < 1 or max(workers) > 1000 or max(sizes) > 10**6:
        allowed_text = "give at least 1 of each, and at most 1,000,000 subjects and 1,000 workers."
        raise OutOfRange(f"--subjects {args.subjects} --workers {args.workers}: {allowed_text}")
    out, load_rows = args.out.absolute(), list[dict[str, Any]]()
    refuse_foreign(out)
    mark_as_ours(out)
    with alone(out):
        for n_subjects in sizes:
            for n_workers in workers:
                with progress(f"{n_subjects} subjects, {n_workers} workers", args.quiet) as on_progress:
                    load_rows.append(measure_load(out, n_subjects, n_workers, on_progress))
        write_json(out / "summary.json", {"loads": load_rows})
    return Answer(out / "summary.json", text_table(load_rows))


def _checked_seconds(args: Speed | Effects) -> float:
    if not 0 < args.seconds < 3600:
        raise OutOfRange(f"--seconds must be a positive number below 3600, got {args.seconds}.")
    return args.seconds


def _parsed_list(option: str, text: str, item_type: Callable[[str], Any]) -> tuple[Any, ...]:
    """Items of a list separated by commas; empty items are ignored."""
    items = [item.strip() for item in text.split(",") if item.strip()]
    try:
        return tuple(map(item_type, items))
    except ValueError:
        type_text = "whole numbers" if item_type is int else "numbers"
        raise NotReadable(f"{option}: {text!r} is not a list of {type_text}; separate them by commas.") from None


def _time_solver(args: Speed) -> Answer:
    from morphofold.studies.speed.solver_speed import CELL_COUNTS, element_speed, speed_body
    from morphofold.studies.speed.speed_page import elements_part

    seconds, thread_counts = _checked_seconds(args), list(dict.fromkeys((1, numba.get_num_threads())))
    speed_rows = [
        speed_row
        for element, cell_counts in CELL_COUNTS.items()
        for n_cells in cell_counts
        for speed_row in element_speed(speed_body(element, n_cells), thread_counts, seconds)
    ]
    return Answer(speed_rows, elements_part(speed_rows))


def _time_effects(args: Effects) -> Answer:
    from morphofold.studies.speed.solver_speed import effect_costs
    from morphofold.studies.speed.speed_page import effects_part

    effect_rows = effect_costs(seconds=_checked_seconds(args))
    return Answer(effect_rows, effects_part(effect_rows))


def _time_measures(args: Measures) -> Answer:
    from morphofold.studies.folded_ball import folded_ball
    from morphofold.studies.speed.measuring_page import pairs_part, peers_part, steps_part
    from morphofold.studies.speed.measuring_race import race
    from morphofold.studies.speed.measuring_speed import measuring_speed
    from morphofold.studies.speed.paired import paired_speed

    vertex_counts = sorted(set(_parsed_list("--vertices", args.vertices, int)))
    if not vertex_counts or not 1000 <= vertex_counts[0] <= vertex_counts[-1] <= 10_000_000:
        raise OutOfRange(f"--vertices: sizes lie between 1,000 and 10,000,000, got {args.vertices!r}.")
    if args.repeats < 1:
        raise OutOfRange(f"--repeats must be 1 or more, got {args.repeats}.")
    if args.against is not None and len(vertex_counts) != 1:
        raise OptionsClash("--against compares two installations at one size: name it with --vertices.")
    set_threads(args.threads)
    with progress("measure", args.quiet) as on_progress:
        if args.peers:
            rows, page_part_of = race(repeats=args.repeats, progress=on_progress), peers_part
        elif args.against is not None:
            cortex = folded_ball(vertex_counts[0])
            rows = paired_speed(cortex, args.against, repeats=args.repeats, threads=args.threads, progress=on_progress)
            page_part_of = pairs_part
        else:
            rows, page_part_of = measuring_speed(vertex_counts, on_progress), steps_part
    return Answer(rows, page_part_of(rows))


BENCHMARKS: dict[type[Printing], Callable[[Any], Answer]] = {
    Speed: _time_solver,
    Effects: _time_effects,
    Measures: _time_measures,
    Cohort: _time_cohort,
    Folds: _run_folds_study,
    Accuracy: _run_accuracy_study,
    Hemisphere: _run_hemisphere_study,
}

if __name__ == "__main__":
    sys.exit(main())
