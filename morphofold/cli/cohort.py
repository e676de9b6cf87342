"""``morphofold cohort``: measure many subjects, bring their maps to a template, write their group."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from morphofold.cli.inputs import measuring_options
from morphofold.cli.options import Answer, Cohort, ManySubjects, sides
from morphofold.cli.progress import progress
from morphofold.cli.workers import answer_of, failure_lines, open_workers, print_note, run_with_progress
from morphofold.cohort.covariates import NO_COVARIATES, Covariates, find_covariates
from morphofold.cohort.fleet import Fleet
from morphofold.cohort.group import GROUP_FOLDER, write_group
from morphofold.cohort.participant import Participant, measure_participant
from morphofold.cohort.scales import SCALES_FILE, kept_scales, scales_of, with_scales
from morphofold.cohort.space import SPACES, Mapped, map_participant, write_space
from morphofold.cohort.subjects import find_subjects, folder_of, left_out_words, named_subjects
from morphofold.cohort.tables import TAKEN_COLUMNS, Group
from morphofold.cohort.tasks import Outcome, TaskFolder
from morphofold.cohort.templates import Template, template
from morphofold.errors import NamedTwice
from morphofold.forecasts.cost import memory_of_analysis
from morphofold.io import begin_collection, read_surface, refuse_foreign, refuse_no_collection
from morphofold.io.cortices import cortex_files, hemispheres
from morphofold.io.folders import alone, refuse_overlap
from morphofold.provenance import printable
from morphofold.report import analysis_report
from morphofold.report.pages.group_page import group_report
from morphofold.results.dataset import begin_dataset, refuse_other_dataset

SUBJECTS_READ_FOR_MEMORY = 3  # subjects, to find the memory that one takes


def run(args: Cohort) -> Answer:
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
    folders = {printable(name): folder_of(source, name) for name in names}
    if len(folders) < len(names):
        raise NamedTwice(f"{source}: two names are the same after bytes that are not text are escaped. Rename one.")
    options, run_id = measuring_options(args), secrets.token_hex(4)
    hemis, report = sides(args.hemi), not args.no_report and analysis_report
    return [
        Participant(
            name,
            str(folder),
            TaskFolder(str(out.absolute()), name, run_id),
            hemis,
            args.layout == "bids",
            report,
            options,
        )
        for name, folder in sorted(folders.items())
    ]


def run_cohort(
    subjects: list[Participant],
    out: Path,
    args: ManySubjects,
    *,
    group: bool = True,
    everyone: Sequence[Participant] = (),
    space: Template | None = None,
    covariates: Covariates = NO_COVARIATES,
    left_out: Mapping[str, str] | None = None,
) -> Answer:
    """Measure subjects and, if ``group``, write their group; the scales are those of ``everyone``.

    With a template, ``space``, also bring their maps over to it. ``covariates`` are those of the subjects, for the
    tables; ``left_out`` are names in their folder, with reasons.
    """
    out, results = out.absolute(), _results_folders(out.absolute(), subjects)
    covariates = covariates.of_sessions(results)
    more: dict[str, object] = {"left_out": left_out or {}}
    mapped, lines = dict[str, Mapping[str, str]](), list[str]()
    kept_scales(out)  # refuses before hours of work
    with ExitStack() as locks:
        need = max(_memory_needed(subject, args) for subject in subjects[:SUBJECTS_READ_FOR_MEMORY])
        with open_workers(args, need) as fleet:
            if args.layout == "bids":  # nothing is written where there are no workers
                begin_dataset(out, ignoring=("group", "logs", "records", "lock", SPACES, SCALES_FILE))
            else:
                begin_collection(out, "cohort")
            if group:  # several may measure participants at once
                locks.enter_context(alone(out))
            print_note(f"{len(subjects)} subjects, {fleet.words}", args)
            if None in (args.curvature_scale, args.gyral_width):
                with progress("scales", args.quiet) as show:
                    scales = scales_of(out, fleet, everyone or subjects, show)
                if scales is not None:
                    print_note(scales.words, args)
                subjects = [replace(subject, options=with_scales(subject.options, scales)) for subject in subjects]
            outcomes = run_with_progress(fleet, "cohort", measure_participant, subjects, args)
            if space is not None:
                mapped, lines = _map_on_template(fleet, space, subjects, out, args, covariates)
        if group:
            more["remarks"] = write_group_and_notes(out, results, args, covariates, outcomes).remarks_on_group
    if space is not None:
        more["mapped"] = mapped
    answer = answer_of(outcomes, "subject", out / GROUP_FOLDER / "report.html" if group else out, **more)
    return answer._replace(lines=[*lines, *answer.lines], code=max(answer.code, int(any(mapped.values()))))


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
    fleet: Fleet,
    space: Template,
    subjects: Sequence[Participant],
    out: Path,
    args: ManySubjects,
    covariates: Covariates,
) -> tuple[dict[str, Mapping[str, str]], list[str]]:
    """Bring the maps of measured subjects over to a template, and write one array for each map.

    Returns by subject the hemispheres that have no maps there, and why; and lines about them and the arrays.
    """
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
        If BIDS, which shortens names, leaves nothing of a name, or the same of two.
    """
    if any(subject.bids for subject in subjects):
        refuse_other_dataset(out)
    else:
        refuse_no_collection(out, "cohort")
    refuse_foreign(out / GROUP_FOLDER)  # before hours of work, not after them
    results = {subject.name: subject.results for subject in subjects}
    for one, other in pairwise(sorted(results, key=results.__getitem__)):
        if results[one] == results[other]:
            raise NamedTwice(f"{one}, {other}: BIDS shortens both to {results[one].name}. Rename one.")
    return results


def _memory_needed(subject: Participant, args: ManySubjects) -> float:
    """Memory that measuring a subject will take [GiB]; 0 if it can't be read."""
    try:
        hemis = subject.hemis or hemispheres(Path(subject.folder))
        sizes = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
    except (ValueError, OSError):
        return 0.0
    return memory_of_analysis(sizes, accuracy=args.accuracy, report=not args.no_report)
