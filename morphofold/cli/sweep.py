"""``morphofold sweep``: grow a scene with many values and seeds, measure the runs, write their phase diagrams."""

from __future__ import annotations

import secrets
from contextlib import ExitStack
from pathlib import Path

from morphofold.cli.inputs import measuring_options
from morphofold.cli.options import Answer, Sweep
from morphofold.cli.progress import progress
from morphofold.cli.workers import answer_of, open_workers, print_note, run_with_progress
from morphofold.cohort.grid import Grid, SweepPoint, make_grid
from morphofold.cohort.phases import GROUP_FOLDER, theory_by_place, write_sweep
from morphofold.cohort.sweep import Run, grow_and_measure, memory_of_run
from morphofold.cohort.tasks import TaskFolder
from morphofold.forecasts import forecast
from morphofold.forecasts.forecasting import table_of
from morphofold.io import begin_collection, refuse_foreign, refuse_no_collection
from morphofold.io.folders import alone
from morphofold.report import analysis_report
from morphofold.report.pages.phase_page import phase_report
from morphofold.sim.scene import Scene
from morphofold.words import span


def run(args: Sweep) -> Answer:
    options = measuring_options(args)
    grid = make_grid(args.scene, args.vary, seeds=args.seeds, settings=args.set)
    if args.dry_run:
        return _dry_run(grid, args)
    out = args.out.absolute()
    refuse_no_collection(out, "sweep")
    refuse_foreign(out / GROUP_FOLDER)  # refuses before hours of work
    run_id, report = secrets.token_hex(4), not args.no_report and analysis_report
    runs = [
        Run(TaskFolder(str(out), p.name, run_id), _with_absolute_mesh_path(p.scene), args.threads, report, options)
        for p in grid.points
    ]
    need = max(memory_of_run(run.scene, args.accuracy, not args.no_report) for run in runs)
    with ExitStack() as locks:
        with open_workers(args, need) as fleet:
            begin_collection(out, "sweep")  # nothing is written where there are no workers
            locks.enter_context(alone(out))
            print_note(f"{len(runs)} runs, {fleet.words}", args)
            outcomes = run_with_progress(fleet, "sweep ", grow_and_measure, runs, args)
            with progress("theory", args.quiet) as show:
                theory = theory_by_place(fleet, grid, show)
        with progress("phases", args.quiet) as show:
            phases = write_sweep(out, grid, theory, outcomes, report=phase_report, progress=show)
    unhealthy = {run.point.name: run.warnings for run in phases.runs if run.warnings}
    lines = [f"warning: {name}: {'; '.join(warnings)}" for name, warnings in list(unhealthy.items())[:5]]
    if len(unhealthy) > 5:
        table = out / "group" / "runs.tsv"
        lines.append(f"warning: {len(unhealthy)} of {len(runs)} runs are not healthy; {table} lists them")
    answer = answer_of(outcomes, "run", out / "group" / "report.html", warnings=unhealthy)
    return answer._replace(lines=[*lines, *answer.lines])


def _with_absolute_mesh_path(scene: Scene) -> Scene:
    """The scene with an absolute path of its mesh file, so that a worker in any folder finds it."""
    file = getattr(scene.geometry, "file", None)
    if file is None or not Path(file).is_file():  # a sample, by its name
        return scene
    geometry = scene.geometry.model_copy(update={"file": str(Path(file).absolute())})
    return scene.model_copy(update={"geometry": geometry})


def _dry_run(grid: Grid, args: Sweep) -> Answer:
    def size(point: SweepPoint) -> tuple[float, float]:
        growth = point.scene.growth
        return point.scene.bricks, (growth.final - 1) / growth.rate

    largest = max(grid.points, key=size)
    cost = forecast(largest.scene, args.threads)
    memory = memory_of_run(largest.scene, args.accuracy, not args.no_report)
    content = {"runs": len(grid.points), "points": len(grid.places), "memory_GiB": memory or None}
    seeds = f" times {len(grid.seeds)} seeds" if len(grid.seeds) > 1 else ""
    measuring = f"; a worker that also measures needs {memory:.2g} GiB" if memory else ""
    lines = [
        f"{len(grid.points)} runs: {len(grid.places)} points{seeds}",
        *f"the largest run, {table_of(cost)}".splitlines(),
        f"all: {span(len(grid.points) * cost.seconds)} of growing on one worker, if all are as large{measuring}",
    ]
    return Answer({**content, "largest": cost.as_dict()}, lines)
