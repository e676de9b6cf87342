"""``morphofold sweep``: a scene grown with many values and seeds on several workers, measured, with phase diagrams.

In go the options, out comes what is printed; the work is in :mod:`morphofold.group`.
"""

import secrets
from contextlib import ExitStack
from pathlib import Path

from morphofold.cli.analyze import measuring_options
from morphofold.cli.command_options import Answer, Sweep
from morphofold.cli.many_tasks import answer_of, open_workers, print_note, run_with_progress
from morphofold.cli.terminal_output import progress
from morphofold.forecasts import forecast
from morphofold.forecasts.forecasting import table_of
from morphofold.group.group_tables import GROUP_FOLDER
from morphofold.group.sweep import Run, grow_and_measure, theory_by_point, write_sweep
from morphofold.group.sweep_grid import Grid, make_grid
from morphofold.group.task_records import TaskFolder
from morphofold.group_pages.phase_page import phase_report
from morphofold.io import begin_collection, refuse_foreign, refuse_no_collection
from morphofold.io.atomic_folders import alone
from morphofold.number_texts import span
from morphofold.report import analysis_report
from morphofold.sim.scene import Scene


def run(args: Sweep) -> Answer:
    options = measuring_options(args)
    grid = make_grid(args.scene, args.vary, seeds=args.seeds, settings=args.set)
    if args.dry_run:
        return _dry_run(grid, args)
    out = args.out.absolute()
    group_folder = out / GROUP_FOLDER
    refuse_no_collection(out, "sweep")
    refuse_foreign(group_folder)  # refuses before hours of work
    run_id, report = secrets.token_hex(4), not args.no_report and analysis_report
    runs = [
        Run(TaskFolder(str(out), p.name, run_id), _with_absolute_mesh_path(p.scene), args.threads, report, options)
        for p in grid.points
    ]
    with ExitStack() as locks:
        with open_workers(args) as workers:
            begin_collection(out, "sweep")  # nothing is written where there are no workers
            locks.enter_context(alone(out))
            print_note(f"{len(runs)} runs, {workers.label}", args)
            outcomes = run_with_progress(workers, "sweep ", grow_and_measure, runs, args)
            with progress("theory", args.quiet) as on_progress:
                theory = theory_by_point(grid, on_progress)
        with progress("phases", args.quiet) as on_progress:
            phases = write_sweep(out, grid, theory, report=phase_report, progress=on_progress)
    warnings_of_run = {run.point.name: run.warnings for run in phases.runs if run.warnings}
    lines = [f"warning: {name}: {'; '.join(warnings)}" for name, warnings in warnings_of_run.items()]
    if len(lines) > 5:
        summary = f"{len(lines)} of {len(runs)} runs are not healthy"
        lines[5:] = [f"warning: {summary}; {group_folder / 'runs.tsv'} lists them"]
    return answer_of(outcomes, "run", group_folder / "report.html", lines, warnings=warnings_of_run)


def _with_absolute_mesh_path(scene: Scene) -> Scene:
    """The scene with an absolute path of its mesh file, so that a worker in any folder finds it."""
    mesh_file = getattr(scene.geometry, "file", None)
    if mesh_file is None or not Path(mesh_file).is_file():  # a sample, by its name
        return scene
    geometry = scene.geometry.model_copy(update={"file": str(Path(mesh_file).absolute())})
    return scene.model_copy(update={"geometry": geometry})


def _dry_run(grid: Grid, args: Sweep) -> Answer:
    scenes = [point.scene for point in grid.points]
    largest_scene = max(scenes, key=lambda scene: (scene.bricks, (scene.growth.final - 1) / scene.growth.rate))
    cost = forecast(largest_scene, args.threads)
    n_runs, n_points = len(scenes), len(grid.scenes)
    content = {"runs": n_runs, "points": n_points, "largest": cost.as_dict()}
    seeds_text = f" times {len(grid.seeds)} seeds" if len(grid.seeds) > 1 else ""
    lines = [
        f"{n_runs} runs: {n_points} points{seeds_text}",
        *f"the largest run, {table_of(cost)}".splitlines(),
        f"all: {span(n_runs * cost.seconds)} of growing on one worker, if all are as large",
    ]
    return Answer(content, lines)
