"""Grow a scene with many values and seeds, measure every run, and write tables and phase diagrams with the lines of
theory. Run it again to do the runs that are missing or have changed. Exit code 1: some runs have no measures; runs.tsv
gives the reasons."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.cli import add_options, add_scene, add_settings
from morphofold.cli.cohort import add_group_args
from morphofold.cli.measuring import measuring_options
from morphofold.cli.streams import print_json, print_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from morphofold.cohort.grid import Grid, SweepPoint
    from morphofold.cohort.phases import Phases
    from morphofold.cohort.sweep import Run
    from morphofold.sim.scene import Scene

EXAMPLES = (
    "morphofold sweep demo --vary cortex_thickness=2,3,4 --vary mu_ratio=1,2,4 --seeds 3 --dry-run",
    "morphofold sweep demo --vary cortex_thickness=2,3,4 --vary mu_ratio=1,2,4 --seeds 3 -o phases",
)


def add_args(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--vary",
        metavar="KEY=VALUE,...",
        action="append",
        default=[],
        help="a key of the scene and its values, e.g. mu_ratio=1,2,4 or growth.final=1.6,1.8; may be repeated",
    )
    parser.add_argument("--seeds", type=int, metavar="N", help="seeds 0 to N-1 at every point (default: the scene's)")
    add_settings(parser, "change one value of the scene for all runs, e.g. accuracy.level=draft; may be repeated")
    parser.add_argument("-o", "--out", metavar="DIR", default="sweep", help="folder (default: sweep)")
    add_options(parser, ("--dry-run", None, "print the number of runs, and what the largest would take; write nothing"))
    add_group_args(parser, "run", "the sweep")


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.cohort import ended
    from morphofold.cohort.grid import make_grid

    measuring_options(args)  # refuses before a scene is read
    grid = make_grid(args.scene, args.vary, seeds=args.seeds, settings=args.settings)
    if args.dry_run:
        return _dry_run(grid, args)
    out = Path(args.out).absolute()
    runs, outcomes, phases = _grow_and_measure_all(grid, out, args)
    unhealthy = [run for run in phases.runs if run.warnings]
    for found in [] if args.json else unhealthy[:5]:
        print_line(f"warning: {found.point.name}: {'; '.join(found.warnings)}")
    if len(unhealthy) > 5 and not args.json:
        print(f"warning: {len(unhealthy)} of {len(runs)} runs are not healthy; {out / 'group' / 'runs.tsv'} lists them")
    warnings = {found.point.name: found.warnings for found in unhealthy}
    return ended(outcomes, "run", out / "group" / "report.html", as_json=args.json, warnings=warnings)


def _grow_and_measure_all(grid: Grid, out: Path, args: argparse.Namespace) -> tuple[list[Run], list[Any], Phases]:
    from contextlib import ExitStack

    from morphofold.cli.cohort import fleet_asked, print_note
    from morphofold.cli.progress import progress
    from morphofold.cohort.phases import GROUP_FOLDER, theory_by_place, write_sweep
    from morphofold.cohort.running import run_tasks
    from morphofold.cohort.sweep import grow_and_measure, memory_of_run
    from morphofold.io import begin_collection, refuse_foreign, refuse_no_collection
    from morphofold.io.folders import alone
    from morphofold.report.pages.phase_page import phase_report

    refuse_no_collection(out, "sweep")
    refuse_foreign(out / GROUP_FOLDER)  # refuses before hours of work
    runs = runs_of(grid.points, out, args)
    need = max(memory_of_run(point.scene, args.accuracy, not args.no_report) for point in grid.points)
    with ExitStack() as held:
        with fleet_asked(args, need) as fleet:
            begin_collection(out, "sweep")  # nothing is written where there are no workers
            held.enter_context(alone(out))
            args.on_interrupt = " Run it again to go on."
            print_note(f"{len(runs)} runs, {fleet.words}", args.quiet)
            with progress("sweep ", args.quiet) as show:
                outcomes = run_tasks(fleet, grow_and_measure, runs, show, lambda text: print_note(text, args.quiet))
            with progress("theory", args.quiet) as show:
                theory = theory_by_place(fleet, grid, show)
        with progress("phases", args.quiet) as show:
            phases = write_sweep(out, grid, theory, outcomes, report=phase_report, progress=show)
    return runs, outcomes, phases


def runs_of(points: Sequence[SweepPoint], out: Path, args: argparse.Namespace) -> list[Run]:
    """A task for each point."""
    import secrets

    from morphofold.cohort.sweep import Run
    from morphofold.cohort.tasks import TaskFolder
    from morphofold.report import analysis_report

    report: Any = False if args.no_report else analysis_report
    options, run_id = measuring_options(args), secrets.token_hex(4)
    return [
        Run(
            TaskFolder(str(out), point.name, run_id),
            _with_absolute_mesh_path(point.scene),
            args.threads,
            report,
            options,
        )
        for point in points
    ]


def _with_absolute_mesh_path(scene: Scene) -> Scene:
    """The scene with an absolute path of its mesh file, so that a worker in any folder finds it."""
    file = getattr(scene.geometry, "file", None)
    if file is None or not Path(file).is_file():  # a sample, by its name
        return scene
    geometry = scene.geometry.model_copy(update={"file": str(Path(file).absolute())})
    return scene.model_copy(update={"geometry": geometry})


def _dry_run(grid: Grid, args: argparse.Namespace) -> int:
    from morphofold.cohort.sweep import memory_of_run
    from morphofold.forecasts import forecast
    from morphofold.forecasts.cost import table_of
    from morphofold.words import span

    def size(point: SweepPoint) -> tuple[float, float]:
        growth = point.scene.growth
        return point.scene.bricks, (growth.final - 1) / growth.rate

    largest = max(grid.points, key=size)
    found = forecast(largest.scene, args.threads)
    memory = memory_of_run(largest.scene, args.accuracy, not args.no_report)
    if args.json:
        answer = {"runs": len(grid.points), "points": len(grid.places), "memory_GiB": memory or None}
        print_json({**answer, "largest": found.as_dict()})
        return 0
    seeds = f" times {len(grid.seeds)} seeds" if len(grid.seeds) > 1 else ""
    print(f"{len(grid.points)} runs: {len(grid.places)} points{seeds}")
    print(f"the largest run, {table_of(found)}")
    measuring = f"; a worker that also measures needs {memory:.2g} GiB" if memory else ""
    print(f"all: {span(len(grid.points) * found.seconds)} of growing on one worker, if all are as large{measuring}")
    return 0
