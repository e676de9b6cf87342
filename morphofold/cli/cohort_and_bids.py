"""``morphofold cohort`` and ``bids``: subjects measured on several workers into one folder, and the group of all.

In go the options, out comes what is printed; the work is in :mod:`morphofold.group`.
"""

import secrets
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

from morphofold.cli.analyze import measuring_options
from morphofold.cli.command_options import Answer, Bids, Cohort, ManySubjects, sides
from morphofold.cli.many_tasks import Failures, answer_of, failure_lines, open_workers, print_note, run_with_progress
from morphofold.cli.terminal_output import progress
from morphofold.digests_and_json import printable
from morphofold.errors import NamedTwice
from morphofold.forecasts.cost_record import memory_of_analysis
from morphofold.group.design import names_of_row, person_and_session
from morphofold.group.group_tables import GROUP_FOLDER, TAKEN_COLUMNS, Group, write_group
from morphofold.group.measure_subject import SCALES_FILE, Participant, earlier_scales, measure_participant, scales_of
from morphofold.group.spaces import SPACES_FOLDER, Mapped, Template, map_participant, template, write_space
from morphofold.group.subjects import (
    NO_COVARIATES,
    Covariates,
    find_covariates,
    find_subjects,
    left_out_words,
    named_subjects,
)
from morphofold.group.task_records import TaskFolder
from morphofold.group.workers import Workers
from morphofold.group_pages.cohort_page import group_report
from morphofold.io import begin_collection, read_surface, refuse_foreign, refuse_no_collection
from morphofold.io.atomic_folders import alone, refuse_overlap
from morphofold.io.cortices import cortex_files, hemispheres
from morphofold.io.layouts import subjects_in
from morphofold.report import analysis_report
from morphofold.results.layouts import begin_dataset, refuse_other_dataset, subject_place

SUBJECTS_READ_FOR_MEMORY = 3  # subjects, to find the memory that one takes
#: of a dataset, in which reconstructed subjects are looked for, in this order
SUBJECTS_FOLDERS = (
    "derivatives/freesurfer",
    "sourcedata/freesurfer",
    ".",
    "derivatives/*",
    "derivatives",
    "sourcedata/*",
)


def run(args: Cohort) -> Answer:
    subjects_dir = args.subjects_dir.absolute()
    places, left_out = find_subjects(subjects_dir)
    if args.subjects is not None:
        places = {name: places.get(name, subjects_dir / name) for name in named_subjects(args.subjects)}
        left_out = {}
    refuse_overlap(args.out, [subjects_dir])
    space = None if args.space is None else template(args.space, args.smooth)
    if left_out:
        print_note(f"left out: {left_out_words(left_out)}", args)
    covariates = find_covariates(args.participants, [subjects_dir], TAKEN_COLUMNS)
    subjects = participants_of(places, args.out, args)
    return run_cohort(subjects, subjects, args.out, args, space, covariates, left_out=left_out)


def bids(args: Bids) -> Answer:
    out = args.output_dir
    if args.level == "group":
        return _bids_group(out, args)
    subjects_dir = _subjects_folder(args)
    refuse_overlap(out, [subjects_dir])
    everyone = participants_of(find_subjects(subjects_dir)[0], out, args)
    labels = [label.removeprefix("sub-") for label in args.participant_label]
    names_of_subject = {subject.name: names_of_row(subject.name) for subject in everyone}
    if missing := [f"sub-{label}" for label in labels if label not in chain(*names_of_subject.values())]:
        raise FileNotFoundError(
            f"{subjects_dir}: contains no {', '.join(missing)}; it contains {', '.join([*names_of_subject][:8])}."
        )
    chosen = [subject for subject in everyone if not labels or {*labels}.intersection(names_of_subject[subject.name])]
    if sessions := {label.removeprefix("ses-") for label in args.session_label}:
        session_of = {subject.name: person_and_session(subject.name)[1].removeprefix("ses-") for subject in chosen}
        if missing := sorted(sessions - {*session_of.values()}):
            raise FileNotFoundError(f"{subjects_dir}: no chosen participant has the session ses-{missing[0]}.")
        chosen = [subject for subject in chosen if session_of[subject.name] in sessions]
    return run_cohort(chosen, everyone, out, args, left_out={})


def participants_of(places: Mapping[str, Path], out: Path, args: ManySubjects) -> list[Participant]:
    """Subjects to measure, with their folders, by names that can be written; bytes that are not text are escaped."""
    options, run_id = measuring_options(args), secrets.token_hex(4)
    write_report = not args.no_report and analysis_report
    return [
        Participant(
            printable(name),
            str(place),
            TaskFolder(str(out.absolute()), printable(name), run_id),
            sides(args.hemi),
            args.layout == "bids",
            write_report,
            options,
        )
        for name, place in sorted(places.items(), key=lambda item: printable(item[0]))
    ]


def run_cohort(
    subjects: list[Participant],
    everyone: Sequence[Participant],
    out: Path,
    args: ManySubjects,
    space: Template | None = None,
    covariates: Covariates = NO_COVARIATES,
    **more_content: Any,
) -> Answer:
    """Measure subjects and, but for ``bids``, write their group; the scales are those of ``everyone``.

    With a template, ``space``, also bring their maps over to it. ``covariates`` are those of the subjects, for the
    tables; the JSON says ``more_content``.
    """
    writes_group = isinstance(args, Cohort)  # of bids, several may measure participants at once
    out = out.absolute()
    results = _results_folders(out, subjects)
    covariates = covariates.of_sessions(results)
    if args.exclude is not None:
        n_masked = sum(any(map(subject.excluded_file, subject.hemis or ("lh", "rh"))) for subject in everyone)
        if not n_masked:
            raise FileNotFoundError(f"{args.exclude}: no subject has such a file. Correct --exclude.")
        print_note(f"a part of {n_masked} of {len(everyone)} subjects is left out ({args.exclude})", args)
    earlier_scales(out)  # refuses before hours of work
    with ExitStack() as locks:
        memory_needed = max(_memory_needed(subject, args) for subject in subjects[:SUBJECTS_READ_FOR_MEMORY])
        with open_workers(args, memory_needed) as worker_pool:
            if args.layout == "bids":  # nothing is written where there are no workers
                source = args.bids_dir if isinstance(args, Bids) else None
                begin_dataset(out, source, ("group", "logs", "records", "lock", SPACES_FOLDER, SCALES_FILE))
            else:
                begin_collection(out, "cohort")
            if writes_group:
                locks.enter_context(alone(out))
            print_note(f"{len(subjects)} subjects, {worker_pool.label}", args)
            if None in (args.curvature_scale, args.gyral_width):
                with progress("scales", args.quiet) as on_progress:
                    scales = scales_of(out, worker_pool, everyone, on_progress)
                if scales is not None:
                    print_note(scales.label, args)
                    subjects = [replace(subject, options=scales.fill(subject.options)) for subject in subjects]
            outcomes = run_with_progress(worker_pool, "cohort", measure_participant, subjects, args)
            unmapped, lines = dict[str, Failures](), list[str]()
            if space is not None:
                unmapped["mapped"], lines = _map_on_template(worker_pool, space, subjects, out, args, covariates)
        if writes_group:
            more_content["remarks"] = write_group_and_notes(out, results, args, covariates).remarks_on_group
    page = out / GROUP_FOLDER / "report.html" if writes_group else out
    return answer_of(outcomes, "subject", page, lines, **more_content, **unmapped)


def write_group_and_notes(out: Path, results: Mapping[str, Path], args: ManySubjects, covariates: Covariates) -> Group:
    """Write the group; print how many persons there are if there are fewer than subjects, and what was not measured in
    the same way."""
    with progress("group ", args.quiet) as on_progress:
        group = write_group(out, results, report=group_report, progress=on_progress, covariates=covariates)
    if group.persons_words:
        print_note(group.persons_words, args)
    if sentences := group.pooling.sentences:
        pooling_note = f"{len(group.pooling.left_out)} measures are not fully pooled: see the page of the group."
        print_note(f"warning: {' '.join(sentences)} {pooling_note}", args)
    return group


def _map_on_template(
    workers: Workers,
    space: Template,
    subjects: Sequence[Participant],
    out: Path,
    args: ManySubjects,
    covariates: Covariates,
) -> tuple[Failures, list[str]]:
    """Bring the maps of measured subjects over to a template, and write one array for each map.

    Returns by subject the hemispheres that have no maps there, and why; and lines about them and the arrays.
    """
    space_folder = out / SPACES_FOLDER / space.folder_name
    tasks = [Mapped(subject, replace(subject.task_folder, out=str(space_folder)), space) for subject in subjects]
    outcomes = run_with_progress(workers, space.name, map_participant, tasks, args)
    write_space(space_folder, space, tasks, covariates)
    failures = {outcome.name: outcome.failures for outcome in outcomes}
    lines = failure_lines(failures, f" is not on {space.name}")
    n_mapped = sum(outcome.state != "failed" for outcome in outcomes)
    return failures, [*lines[:5], f"{n_mapped} of {len(outcomes)} subjects on {space.name} -> {space_folder / 'group'}"]


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
        vertex_counts = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
    except (ValueError, OSError):
        return 0.0
    return memory_of_analysis(vertex_counts, accuracy=args.accuracy, report=not args.no_report)


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
    failures_text = f", {len(failures)} of them with failures" if failures else ""
    return Answer(content, [f"{len(results)} subjects{failures_text} -> {out / GROUP_FOLDER}"], int(bool(failures)))


def measured_before(out: Path) -> dict[str, Path]:
    """Folders of a BIDS dataset in which the results of all subjects of earlier runs are, or would be."""
    names = sorted(path.stem for path in (out / "records").glob("[!.]*.json"))  # a killed run left a part of one
    if not names:
        raise FileNotFoundError(f"{out}: contains no measured subject. Measure participants first.")
    return {name: subject_place(out, name) for name in names}


def _subjects_folder(args: Bids) -> Path:
    """Folder of the reconstructed subjects of the dataset."""
    if args.fs_subjects_dir is not None:
        return args.fs_subjects_dir.absolute()
    dataset = args.bids_dir.absolute()
    if not dataset.is_dir():
        raise FileNotFoundError(f"{dataset}: no such dataset.")
    for pattern in SUBJECTS_FOLDERS:
        for folder in [dataset] if pattern == "." else sorted(dataset.glob(pattern)):
            if folder.is_dir() and folder != args.output_dir.absolute() and subjects_in(folder):
                return folder
    raise FileNotFoundError(
        f"{dataset}: there are no reconstructed subjects in {', '.join(SUBJECTS_FOLDERS)}. Pass their folder with "
        "--fs-subjects-dir, or run FreeSurfer, fMRIPrep or another program with surfaces first."
    )
