"""``morphofold cohort``, ``bids`` and ``sweep``: many tasks on workers, in a folder that collects their results."""

import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from morphofold.cli.cortex import measuring_options
from morphofold.cli.options import Answer, Bids, Cohort, ManySubjects, ManyTasks, Sweep, sides
from morphofold.cli.printing import print_line, progress
from morphofold.cohort import fleet as fleets
from morphofold.cohort.covariates import NO_COVARIATES, Covariates, find_covariates
from morphofold.cohort.grid import Grid, make_grid
from morphofold.cohort.group import GROUP_FOLDER, write_group
from morphofold.cohort.participant import Participant, measure_participant
from morphofold.cohort.phases import theory_by_place, write_sweep
from morphofold.cohort.running import Task, run_tasks
from morphofold.cohort.scales import SCALES_FILE, kept_scales, scales_of, with_scales
from morphofold.cohort.space import SPACES, Mapped, map_participant, write_space
from morphofold.cohort.subjects import find_subjects, folder_of, left_out_words, named_subjects
from morphofold.cohort.sweep import Run, grow_and_measure, memory_of_run
from morphofold.cohort.tables import TAKEN_COLUMNS, Group
from morphofold.cohort.tasks import Outcome, TaskFolder
from morphofold.cohort.templates import Template, template
from morphofold.errors import NamedTwice
from morphofold.forecasts import forecast
from morphofold.forecasts.cost import memory_of_analysis
from morphofold.forecasts.forecasting import table_of
from morphofold.io import begin_collection, read_surface, refuse_foreign, refuse_no_collection
from morphofold.io.cortices import cortex_files, hemispheres
from morphofold.io.folders import alone, refuse_overlap
from morphofold.provenance import printable
from morphofold.report import analysis_report
from morphofold.report.pages.group_page import group_report
from morphofold.report.pages.phase_page import phase_report
from morphofold.results.layouts import begin_dataset, refuse_other_dataset, subject_place
from morphofold.sim.scene import Scene
from morphofold.words import span

SUBJECTS_READ_FOR_MEMORY = 3  # subjects, to find the memory that one takes
FREESURFER_FOLDERS = ("derivatives/freesurfer", "sourcedata/freesurfer", ".")


def run(args: Cohort | Bids | Sweep) -> Answer:
    if isinstance(args, Sweep):
        return _sweep(args)
    return _cohort(args) if isinstance(args, Cohort) else _bids(args)


def _cohort(args: Cohort) -> Answer:
    source = args.subjects_dir.absolute()
    names, left_out = find_subjects(source)
    if args.subjects is not None:
        names, left_out = named_subjects(args.subjects), {}
    refuse_overlap(args.out, [source])
    space = None if args.space is None else template(args.space, args.smooth, xhemi=args.xhemi)
    if left_out:
        print_note(f"left out: {left_out_words(left_out)}", args)
    covariates = find_covariates(args.participants, [source], TAKEN_COLUMNS)
    subjects = participants_of(source, names, args.out, args)
    return run_cohort(subjects, args.out, args, space=space, covariates=covariates, left_out=left_out)


def participants_of(source: Path, names: Sequence[str], out: Path, args: ManySubjects) -> list[Participant]:
    """Subjects to measure, by names that can be written; bytes that are not text are escaped."""
    options, run_id = measuring_options(args), secrets.token_hex(4)
    report = not args.no_report and analysis_report
    return [
        Participant(
            printable(name),
            str(folder_of(source, name)),
            TaskFolder(str(out.absolute()), printable(name), run_id),
            sides(args.hemi),
            args.layout == "bids",
            report,
            options,
        )
        for name in sorted(names, key=printable)
    ]


def run_cohort(
    subjects: list[Participant],
    out: Path,
    args: ManySubjects,
    *,
    everyone: Sequence[Participant] = (),
    space: Template | None = None,
    covariates: Covariates = NO_COVARIATES,
    **more: Any,
) -> Answer:
    """Measure subjects and, but for ``bids``, write their group; the scales are those of ``everyone``.

    With a template, ``space``, also bring their maps over to it. ``covariates`` are those of the subjects, for the
    tables; the JSON says ``more``.
    """
    group = isinstance(args, Cohort)  # of bids, several may measure participants at once
    out = out.absolute()
    results = _results_folders(out, subjects)
    covariates = covariates.of_sessions(results)
    kept_scales(out)  # refuses before hours of work
    with ExitStack() as locks:
        need = max(_memory_needed(subject, args) for subject in subjects[:SUBJECTS_READ_FOR_MEMORY])
        with open_workers(args, need) as fleet:
            if args.layout == "bids":  # nothing is written where there are no workers
                begin_dataset(out, ignoring=("group", "logs", "records", "lock", SPACES, SCALES_FILE))
            else:
                begin_collection(out, "cohort")
            if group:
                locks.enter_context(alone(out))
            print_note(f"{len(subjects)} subjects, {fleet.words}", args)
            if None in (args.curvature_scale, args.gyral_width):
                with progress("scales", args.quiet) as show:
                    scales = scales_of(out, fleet, everyone or subjects, show)
                if scales is not None:
                    print_note(scales.words, args)
                subjects = [replace(subject, options=with_scales(subject.options, scales)) for subject in subjects]
            outcomes = run_with_progress(fleet, "cohort", measure_participant, subjects, args)
            mapped, lines = _map_on_template(fleet, space, subjects, out, args, covariates)
        if group:
            more["remarks"] = write_group_and_notes(out, results, args, covariates, outcomes).remarks_on_group
    if space is not None:
        more["mapped"] = mapped
    page = out / GROUP_FOLDER / "report.html" if group else out
    answer = answer_of(outcomes, "subject", page, lines, **more)
    return answer._replace(code=max(answer.code, int(any(mapped.values()))))


def write_group_and_notes(
    out: Path, results: Mapping[str, Path], args: ManySubjects, covariates: Covariates, outcomes: Sequence[Outcome] = ()
) -> Group:
    """Write the group; print how many persons there are if there are fewer than subjects, and what was not measured in
    the same way."""
    with progress("group ", args.quiet) as show:
        group = write_group(out, results, outcomes, report=group_report, progress=show, covariates=covariates)
    if group.persons_words:
        print_note(group.persons_words, args)
    if sentences := group.pooling.sentences:
        few = f"{len(group.pooling.left_out)} measures are not fully pooled: see the page of the group."
        print_note(f"warning: {' '.join(sentences)} {few}", args)
    return group


def _map_on_template(
    fleet: fleets.Fleet,
    space: Template | None,
    subjects: Sequence[Participant],
    out: Path,
    args: ManySubjects,
    covariates: Covariates,
) -> tuple[dict[str, Mapping[str, str]], list[str]]:
    """Bring the maps of measured subjects over to a template, and write one array for each map.

    Returns by subject the hemispheres that have no maps there, and why; and lines about them and the arrays.
    """
    if space is None:
        return {}, []
    folder = out / SPACES / space.place
    tasks = [
        Mapped(s.name, s.folder, s.place, str(s.results), TaskFolder(str(folder), s.name, s.place.run), space)
        for s in subjects
    ]
    outcomes = run_with_progress(fleet, space.name, map_participant, tasks, args)
    write_space(folder, space, tasks, covariates)
    missing = {outcome.name: outcome.failures for outcome in outcomes}
    lines = [line for name in missing for line in failure_lines(name, missing[name], f" is not on {space.name}")]
    present = sum(outcome.state != "failed" for outcome in outcomes)
    return missing, [*lines[:5], f"{present} of {len(outcomes)} subjects on {space.name} -> {folder / 'group'}"]


def _results_folders(out: Path, subjects: Sequence[Participant]) -> dict[str, Path]:
    """Folder for the results of each subject.

    Raises
    ------
    FileExistsError
        If morphofold did not write a folder.
    NotReadable, NamedTwice
        If BIDS, which shortens names, leaves nothing of a name, or two names become the same: by that, or where bytes
        that are not text are escaped.
    """
    if subjects[0].bids:
        refuse_other_dataset(out)
    else:
        refuse_no_collection(out, "cohort")
    refuse_foreign(out / GROUP_FOLDER)  # before hours of work, not after them
    for subject, other in pairwise(sorted(subjects, key=lambda subject: subject.results)):
        if subject.results == other.results:
            raise NamedTwice(f"{subject.folder}, {other.folder}: both become {subject.results.name}. Rename one.")
    return {subject.name: subject.results for subject in subjects}


def _memory_needed(subject: Participant, args: ManySubjects) -> float:
    """Memory that measuring a subject will take [GiB]; 0 if it can't be read."""
    try:
        hemis = subject.hemis or hemispheres(Path(subject.folder))
        sizes = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
    except (ValueError, OSError):
        return 0.0
    return memory_of_analysis(sizes, accuracy=args.accuracy, report=not args.no_report)


def _bids(args: Bids) -> Answer:
    out = args.output_dir
    if args.level == "group":
        return _bids_group(out, args)
    source = _subjects_folder(args)
    refuse_overlap(out, [source])
    everyone = participants_of(source, find_subjects(source)[0], out, args)
    labels = [f"sub-{label.removeprefix('sub-')}" for label in args.participant_label]
    called = {p.name: {p.name, p.name.partition(".long.")[0], p.name.partition("_")[0]} for p in everyone}
    if missing := [label for label in labels if not any(label in names for names in called.values())]:
        raise FileNotFoundError(f"{source}: contains no {', '.join(missing)}; it contains {', '.join([*called][:8])}.")
    chosen = [one for one in everyone if not labels or called[one.name].intersection(labels)]
    return run_cohort(chosen, out, args, everyone=everyone, left_out={})


def _bids_group(out: Path, args: Bids) -> Answer:
    """Write the group of subjects that were measured before."""
    covariates = find_covariates(args.participants, [args.bids_dir], TAKEN_COLUMNS)
    results = measured_before(out)
    with alone(out):
        group = write_group_and_notes(out, results, args, covariates.of_sessions(results))
    failures: dict[str, dict[str, str]] = {}
    for row in group.failures:
        failures.setdefault(row["subject"], {})[row["hemi"] or ""] = row["reason"]
    content = {
        "subjects": len(results),
        "with_results": group.n_measured,
        "failures": failures,
        "remarks": group.remarks_on_group,
        "page": out / GROUP_FOLDER / "report.html",
    }
    partly = f", {len(failures)} of them with failures" if failures else ""
    return Answer(content, [f"{len(results)} subjects{partly} -> {out / GROUP_FOLDER}"], 1 if failures else 0)


def measured_before(out: Path) -> dict[str, Path]:
    """Folders of a BIDS dataset in which the results of all subjects of earlier runs are, or would be."""
    names = sorted(path.stem for path in (out / "records").glob("[!.]*.json"))  # a killed run left a part of one
    if not names:
        raise FileNotFoundError(f"{out}: contains no measured subject. Measure participants first.")
    return {name: subject_place(out, name) for name in names}


def _subjects_folder(args: Bids) -> Path:
    """Folder of the FreeSurfer subjects of the dataset."""
    if args.fs_subjects_dir is not None:
        return args.fs_subjects_dir.absolute()
    dataset = args.bids_dir.absolute()
    if not dataset.is_dir():
        raise FileNotFoundError(f"{dataset}: no such dataset.")
    for folder in (dataset / name for name in FREESURFER_FOLDERS):
        if any(folder.glob("*/surf")) or any(folder.glob("sub-*/ses-*/surf")):
            return folder
    raise FileNotFoundError(
        f"{dataset}: there are no FreeSurfer subjects in {', '.join(FREESURFER_FOLDERS)}. Pass their folder with "
        "--fs-subjects-dir, or run FreeSurfer or fMRIPrep first."
    )


def _sweep(args: Sweep) -> Answer:
    options = measuring_options(args)
    grid = make_grid(args.scene, args.vary, seeds=args.seeds, settings=args.set)
    if args.dry_run:
        return _dry_run(grid, args)
    out = args.out.absolute()
    group = out / GROUP_FOLDER
    refuse_no_collection(out, "sweep")
    refuse_foreign(group)  # refuses before hours of work
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
        bad = f"{len(unhealthy)} of {len(runs)} runs are not healthy"
        lines.append(f"warning: {bad}; {group / 'runs.tsv'} lists them")
    return answer_of(outcomes, "run", group / "report.html", lines, warnings=unhealthy)


def _with_absolute_mesh_path(scene: Scene) -> Scene:
    """The scene with an absolute path of its mesh file, so that a worker in any folder finds it."""
    file = getattr(scene.geometry, "file", None)
    if file is None or not Path(file).is_file():  # a sample, by its name
        return scene
    geometry = scene.geometry.model_copy(update={"file": str(Path(file).absolute())})
    return scene.model_copy(update={"geometry": geometry})


def _dry_run(grid: Grid, args: Sweep) -> Answer:
    scenes = [point.scene for point in grid.points]
    largest = max(scenes, key=lambda scene: (scene.bricks, (scene.growth.final - 1) / scene.growth.rate))
    cost = forecast(largest, args.threads)
    memory = memory_of_run(largest, args.accuracy, not args.no_report)
    runs, points = len(scenes), len(grid.places)
    content = {"runs": runs, "points": points, "memory_GiB": memory or None, "largest": cost.as_dict()}
    seeds = f" times {len(grid.seeds)} seeds" if len(grid.seeds) > 1 else ""
    measuring = f"; a worker that also measures needs {memory:.2g} GiB" if memory else ""
    lines = [
        f"{runs} runs: {points} points{seeds}",
        *f"the largest run, {table_of(cost)}".splitlines(),
        f"all: {span(runs * cost.seconds)} of growing on one worker, if all are as large{measuring}",
    ]
    return Answer(content, lines)


def open_workers(args: ManyTasks, need: float) -> AbstractContextManager[fleets.Fleet]:
    """The workers that the options name, each of which needs the memory ``need`` [GiB]."""
    return fleets.open_fleet(
        workers=args.workers, threads=args.threads, memory=args.memory, scheduler=args.scheduler, need=need
    )


def run_with_progress(
    fleet: fleets.Fleet, label: str, work: Callable[[Any], Outcome], tasks: Sequence[Task], args: ManyTasks
) -> list[Outcome]:
    with progress(label, args.quiet) as show:
        return run_tasks(fleet, work, tasks, show, lambda text: print_note(text, args))


def print_note(text: str, args: ManyTasks) -> None:
    """Print a line on standard error, unless the command is quiet."""
    if not args.quiet:
        print_line(text, file=sys.stderr)


def answer_of(outcomes: Sequence[Outcome], what: str, page: Path, before: Sequence[str], **more: Any) -> Answer:
    """Lines ``before``, the first failures, how many have results; as JSON all failures and ``more``. Code 1 if any
    failed."""
    incomplete = sorted((one for one in outcomes if one.failures), key=lambda one: one.state != "failed")
    failures = {outcome.name: dict(outcome.failures) for outcome in incomplete}
    failed = sum(outcome.state == "failed" for outcome in incomplete)
    with_results = len(outcomes) - failed
    counts = {
        "from_before": sum(outcome.state == "reused" for outcome in outcomes),
        "changed": sum(outcome.changed for outcome in outcomes),
        "failed": failed,
        "in_part": len(incomplete) - failed,
    }
    content = {f"{what}s": len(outcomes), "with_results": with_results, **counts, "failures": failures, "page": page}
    texts = "of them from before", "done again, because their files had changed", "failed", "in part"
    numbers = [f"{count} {text}" for count, text in zip(counts.values(), texts) if count]
    last = ", ".join([f"{with_results} of {len(outcomes)} {what}s have results", *numbers])
    lines = [line for name in list(failures)[:5] for line in failure_lines(name, failures[name])]
    return Answer(content | more, [*before, *lines, f"{last} -> {page}"], 1 if failures else 0)


def failure_lines(name: str, failures: Mapping[str, str], text: str = "") -> list[str]:
    """The failed parts of a task, and why, with ``text`` between them."""
    return [f"{name} {part}".rstrip() + f"{text}: {reason}" for part, reason in failures.items()]
