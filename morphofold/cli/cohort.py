"""``morphofold cohort``: measure many subjects, bring their maps to a template, write their group."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from morphofold.cli.inputs import measuring_options
from morphofold.cli.options import Answer, Cohort, ManySubjects, sides
from morphofold.cli.progress import progress
from morphofold.cli.workers import answer_of, open_workers, print_note, run_with_progress
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
from morphofold.results.dataset import begin_dataset, refuse_other_dataset, subject_place

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
    folders = by_shown_name(source, names)
    return run_cohort(folders, args.out, args, space=space, covariates=covariates, left_out=left_out)


def by_shown_name(source: Path, names: Sequence[str]) -> dict[str, Path]:
    """Folders of subjects by names that can be written; bytes that are not text are escaped."""
    folders = {printable(name): folder_of(source, name) for name in names}
    if len(folders) < len(names):
        raise NamedTwice(f"{source}: two names are the same after bytes that are not text are escaped. Rename one.")
    return folders


def run_cohort(
    folders: Mapping[str, Path],
    out: Path,
    args: ManySubjects,
    *,
    group: bool = True,
    everyone: Mapping[str, Path] | None = None,
    space: Template | None = None,
    covariates: Covariates = NO_COVARIATES,
    left_out: Mapping[str, str] | None = None,
) -> Answer:
    """Measure subjects and, if ``group``, write their group; the scales are those of ``everyone``.

    With a template, ``space``, also bring their maps over to it. ``covariates`` are those of the subjects, for the
    tables; ``left_out`` are names in their folder, with reasons.
    """
    out, covariates = out.absolute(), covariates.of_sessions(folders)
    more, lines = dict[str, Any](left_out=dict(left_out or {})), list[str]()
    subjects = _participants(folders, out, args)
    results = _results_folders(out, subjects)
    kept_scales(out)  # refuses before hours of work
    with ExitStack() as locks:
        need = max((_memory_needed(subject, args) for subject in subjects[:SUBJECTS_READ_FOR_MEMORY]), default=0.0)
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
                    scales = scales_of(out, fleet, _participants(everyone or folders, out, args), show)
                if scales is not None:
                    print_note(scales.words, args)
                subjects = [replace(subject, options=with_scales(subject.options, scales)) for subject in subjects]
            outcomes = run_with_progress(fleet, "cohort", measure_participant, subjects, args)
            mapped = [] if space is None else _map_on_template(fleet, space, subjects, out, args, covariates)
        if group:
            with progress("group ", args.quiet) as show:
                tables = write_group(out, results, outcomes, report=group_report, progress=show, covariates=covariates)
            _print_not_pooled(tables, args)
            more["remarks"] = tables.remarks_on_group
    if space is not None:
        more["mapped"] = {outcome.name: dict(outcome.failures) for outcome in mapped}
        lines = list(_mapped_lines(mapped, space, out))
    answer = answer_of(outcomes, "subject", out / GROUP_FOLDER / "report.html" if group else out, **more)
    code = max(answer.code, int(any(outcome.failures for outcome in mapped)))
    return Answer(answer.json, [*lines, *answer.lines], code)


def measured_before(out: Path) -> dict[str, Path]:
    """Folders of a BIDS dataset in which the results of all subjects of earlier runs are, or would be."""
    records = (out / "records").glob("*.json")
    names = sorted(path.stem for path in records if not path.name.startswith("."))  # a killed run left a part of one
    if not names:
        raise FileNotFoundError(f"{out}: contains no measured subject. Measure participants first.")
    return {name: subject_place(out, name) for name in names}


def run_group(out: Path, results: Mapping[str, Path], args: ManySubjects, covariates: Covariates) -> Answer:
    """Write the group of subjects that were measured before."""
    with alone(out), progress("group ", args.quiet) as show:
        covariates = covariates.of_sessions(results)
        group = write_group(out, dict(results), report=group_report, progress=show, covariates=covariates)
    _print_not_pooled(group, args)
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


def _participants(folders: Mapping[str, Path], out: Path, args: ManySubjects) -> list[Participant]:
    options, run_id = measuring_options(args), secrets.token_hex(4)
    hemis = sides(args.hemi)
    report: Any = False if args.no_report else analysis_report
    return [
        Participant(
            name, str(folder), TaskFolder(str(out), name, run_id), hemis, args.layout == "bids", report, options
        )
        for name, folder in sorted(folders.items())
    ]


def _map_on_template(
    fleet: Fleet,
    space: Template,
    subjects: Sequence[Participant],
    out: Path,
    args: ManySubjects,
    covariates: Covariates,
) -> list[Outcome]:
    """Bring the maps of measured subjects over to a template, and write one array for each map."""
    folder = out / SPACES / space.place
    tasks = [
        Mapped(s.name, s.folder, s.place, str(s.results), TaskFolder(str(folder), s.name, s.place.run), space)
        for s in subjects
    ]
    outcomes = run_with_progress(fleet, space.name, map_participant, tasks, args)
    write_space(folder, space, tasks, covariates)
    return outcomes


def _mapped_lines(mapped: Sequence[Outcome], space: Template, out: Path) -> Iterator[str]:
    """Which hemispheres have no maps on the template, and why, and where the arrays are."""
    missing = [(outcome.name, part, reason) for outcome in mapped for part, reason in outcome.failures.items()]
    for name, part, reason in missing[:5]:
        yield f"{' '.join(filter(None, (name, part)))} is not on {space.name}: {reason}"
    present = sum(outcome.state != "failed" for outcome in mapped)
    yield f"{present} of {len(mapped)} subjects on {space.name} -> {out / SPACES / space.place / 'group'}"


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
    owners: dict[Path, str] = {}
    for subject in subjects:
        owner = owners.setdefault(subject.results, subject.name)
        if owner != subject.name:
            raise NamedTwice(f"{owner}, {subject.name}: BIDS shortens both to {subject.results.name}. Rename one.")
    return {name: folder for folder, name in owners.items()}


def _memory_needed(subject: Participant, args: ManySubjects) -> float:
    """Memory that measuring a subject will take [GiB]; 0 if it can't be read."""
    try:
        hemis = subject.hemis or hemispheres(Path(subject.folder))
        sizes = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
    except (ValueError, OSError):
        return 0.0
    return memory_of_analysis(sizes, accuracy=args.accuracy, report=not args.no_report)


def _print_not_pooled(group: Group, args: ManySubjects) -> None:
    """Print how many persons there are if there are fewer than subjects, and what was not measured in the same way."""
    if group.persons_words:
        print_note(group.persons_words, args)
    if sentences := group.pooling.sentences:
        few = len(group.pooling.left_out)
        print_note(
            f"warning: {' '.join(sentences)} {few} measures are not fully pooled: see the page of the group.", args
        )
