"""Measure every subject of a folder on several workers, and write tables and a page of the group. All subjects are
measured with the same curvature scale and the same crown width. Run it again to measure subjects that are missing or
have changed. Exit code 1: some subjects have no measures; failures.tsv gives the reasons."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.cli.measuring import add_measuring_args, add_side_args, measuring_options
from morphofold.cli.streams import print_json, print_line
from morphofold.errors import NamedTwice, OptionsClash

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from contextlib import AbstractContextManager

    from morphofold.cohort.covariates import Covariates
    from morphofold.cohort.fleet import Fleet
    from morphofold.cohort.participant import Participant
    from morphofold.cohort.tables import Group
    from morphofold.cohort.tasks import Outcome
    from morphofold.cohort.templates import Template

EXAMPLES = (
    "morphofold cohort $SUBJECTS_DIR -o study",
    "morphofold cohort $SUBJECTS_DIR -o study --space fsaverage5 --smooth 10",
)
SUBJECTS_READ_FOR_MEMORY = 3  # subjects, to find the memory that one takes


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("subjects_dir", metavar="SUBJECTS_DIR", help="folder that holds the subjects")
    parser.add_argument(
        "--subjects", metavar="FILE", help="text file with one subject per line (default: all in SUBJECTS_DIR)"
    )
    add_side_args(parser, "each subject")
    parser.add_argument("-o", "--out", metavar="DIR", default="cohort", help="folder (default: cohort)")
    parser.add_argument(
        "--layout",
        choices=["plain", "bids"],
        default="plain",
        help="layout of the subjects; bids: DIR is a BIDS dataset",
    )
    parser.add_argument(
        "--space",
        metavar="TEMPLATE",
        help="bring maps over to a template by ?h.sphere.reg: fsaverage5, or the folder of another",
    )
    parser.add_argument(
        "--smooth", metavar="MM", type=float, help="with --space: smooth them on it, full width at half maximum"
    )
    parser.add_argument(
        "--xhemi",
        action="store_true",
        help="with --space: both hemispheres on the left of a symmetric template, by FreeSurfer's surfreg --xhemi",
    )
    add_participants_arg(parser, "SUBJECTS_DIR")
    add_group_args(parser)


def add_participants_arg(parser: argparse.ArgumentParser, place: str) -> None:
    """--participants, by default participants.tsv in the folder ``place``."""
    parser.add_argument(
        "--participants",
        metavar="FILE",
        help="table with a row for each participant_id, whose columns (age, sex) the tables of the group repeat "
        f"(default: {place}/participants.tsv, if it exists)",
    )


def add_group_args(parser: argparse.ArgumentParser, one: str = "subject", all: str = "the group") -> None:
    """Add the options of measuring, of the pages and of the workers."""
    add_measuring_args(parser)
    parser.add_argument(
        "--no-report", action="store_true", help=f"no page for each {one}; the page of {all} is written"
    )
    add_worker_args(parser)
    parser.add_argument(
        "--json", action="store_true", help=f"print how many {one}s have results, which failed, and why"
    )


def add_worker_args(parser: argparse.ArgumentParser) -> None:
    """Add the options of the workers."""
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes (default: as many as cores and memory allow)"
    )
    parser.add_argument("--threads", type=int, metavar="N", default=1, help="threads of each worker (default: 1)")
    parser.add_argument(
        "--memory",
        type=float,
        metavar="GIB",
        help="memory of a worker; one that takes more is stopped and starts again (default: its share of the machine)",
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a running Dask cluster, such as tcp://host:8786"
    )


def run(args: argparse.Namespace) -> int:
    from morphofold.cohort.covariates import find_covariates
    from morphofold.cohort.subjects import find_subjects, left_out_words, named_subjects
    from morphofold.cohort.tables import TAKEN_COLUMNS
    from morphofold.cohort.templates import template
    from morphofold.io.folders import refuse_overlap

    source, out = Path(args.subjects_dir).absolute(), Path(args.out)
    found, left_out = find_subjects(source)
    if args.subjects is not None:
        found, left_out = named_subjects(Path(args.subjects)), {}
    refuse_overlap(out, [source])
    for option, value in (("--smooth", args.smooth), ("--xhemi", args.xhemi or None)):
        if value is not None and args.space is None:
            raise OptionsClash(f"{option} is for maps on a template, but none is named. Pass --space and its folder.")
    on = None if args.space is None else template(args.space, args.smooth, xhemi=args.xhemi)
    if left_out:
        print_note(f"left out: {left_out_words(left_out)}", args.quiet)
    covariates = find_covariates(args.participants, [source], TAKEN_COLUMNS)
    return run_cohort(by_shown_name(source, found), out, args, on=on, covariates=covariates, left_out=left_out)


def by_shown_name(source: Path, names: Sequence[str]) -> dict[str, Path]:
    """Folders of subjects by names that can be written; bytes that are not text are escaped."""
    from morphofold.cohort.subjects import folder_of
    from morphofold.provenance import printable

    found = {printable(name): folder_of(source, name) for name in names}
    if len(found) < len(names):
        raise NamedTwice(f"{source}: two names are the same after bytes that are not text are escaped. Rename one.")
    return found


def run_cohort(
    folders: dict[str, Path],
    out: Path,
    args: argparse.Namespace,
    *,
    group: bool = True,
    everyone: dict[str, Path] | None = None,
    on: Template | None = None,
    covariates: Covariates | None = None,
    left_out: Mapping[str, str] | None = None,
) -> int:
    """Measure subjects and, if ``group``, write their group; the scales are those of ``everyone``.

    With a template, ``on``, also bring their maps over to it. ``covariates`` are those of the subjects, for the tables;
    ``left_out`` are names in their folder, with reasons.
    """
    import secrets
    from contextlib import ExitStack
    from dataclasses import replace

    from morphofold.cli.progress import progress
    from morphofold.cohort.covariates import NO_COVARIATES
    from morphofold.cohort.group import write_group
    from morphofold.cohort.participant import Participant, measure_participant
    from morphofold.cohort.running import failed, run_tasks
    from morphofold.cohort.scales import kept_scales, scales_of, with_scales
    from morphofold.cohort.tasks import TaskFolder
    from morphofold.io.folders import alone
    from morphofold.report import analysis_report
    from morphofold.report.pages.group_page import group_report

    options = measuring_options(args)
    hemis = ("lh", "rh") if args.hemi == "both" else (args.hemi,) if args.hemi else ()
    bids, run_id = args.layout == "bids", secrets.token_hex(4)
    report: Any = False if args.no_report else analysis_report
    covariates = (covariates or NO_COVARIATES).of_sessions(folders)
    out, more = out.absolute(), dict[str, Any](left_out=dict(left_out or {}))
    subjects, looked_at = (
        [
            Participant(name, str(folder), TaskFolder(str(out), name, run_id), hemis, bids, report, options)
            for name, folder in sorted(some.items())
        ]
        for some in (folders, everyone or folders)
    )
    places, reasons = places_of(out, subjects)
    kept_scales(out)  # refuses before hours of work
    with ExitStack() as held:
        with fleet_asked(args, memory_needed(subjects, args.accuracy, bool(report))) as fleet:
            begin_cohort(out, bids=bids)  # nothing is written where there are no workers
            if group:  # several may measure participants at once
                held.enter_context(alone(out))
            args.on_interrupt = " Run it again to go on."
            print_note(f"{len(subjects)} subjects, {fleet.words}", args.quiet)
            if None in (args.curvature_scale, args.gyral_width):
                with progress("scales", args.quiet) as show:
                    scales = scales_of(out, fleet, looked_at, show)
                if scales is not None:
                    print_note(scales.words, args.quiet)
                subjects = [replace(one, options=with_scales(options, scales)) for one in subjects]
            with progress("cohort", args.quiet) as show:
                possible = [one for one in subjects if one.name not in reasons]
                outcomes = run_tasks(
                    fleet, measure_participant, possible, show, lambda text: print_note(text, args.quiet)
                )
            outcomes += [failed(one.place, reasons[one.name]) for one in subjects if one.name in reasons]
            mapped = [] if on is None else map_on_template(fleet, on, possible, out, args, covariates)
        if group:
            with progress("group ", args.quiet) as show:
                found = write_group(out, places, outcomes, report=group_report, progress=show, covariates=covariates)
            print_not_pooled(found, args.quiet)
            more["remarks"] = found.remarks_on_group
    page = out / "group" / "report.html" if group else out
    if on is not None:
        more["mapped"] = {one.name: dict(one.failures) for one in mapped}
        print_mapped(mapped, on, out, args)
    code = ended(outcomes, "subject", page, as_json=args.json, **more)
    return max(code, int(any(one.failures for one in mapped)))


def map_on_template(
    fleet: Fleet,
    on: Template,
    subjects: Sequence[Participant],
    out: Path,
    args: argparse.Namespace,
    covariates: Covariates,
) -> list[Outcome]:
    """Bring the maps of measured subjects over to a template, and write one array for each map."""
    from morphofold.cli.progress import progress
    from morphofold.cohort.running import run_tasks
    from morphofold.cohort.space import SPACES, Mapped, map_participant, write_space
    from morphofold.cohort.tasks import TaskFolder

    place = out / SPACES / on.place
    tasks = [
        Mapped(one.name, one.folder, one.place, str(one.results), TaskFolder(str(place), one.name, one.place.run), on)
        for one in subjects
    ]
    with progress(on.name, args.quiet) as show:
        found = run_tasks(fleet, map_participant, tasks, show, lambda text: print_note(text, args.quiet))
        write_space(place, on, tasks, covariates)
    return found


def print_mapped(mapped: Sequence[Outcome], on: Template, out: Path, args: argparse.Namespace) -> None:
    """Print which hemispheres have no maps on the template, and why, and where the arrays are."""
    from morphofold.cohort.space import SPACES

    missing = [(one.name, part, why) for one in mapped for part, why in one.failures.items()]
    if args.json:
        return
    for name, part, why in missing[:5]:
        print_line(f"{' '.join(filter(None, (name, part)))} is not on {on.name}: {why}")
    there = sum(one.state != "failed" for one in mapped)
    print_line(f"{there} of {len(mapped)} subjects on {on.name} -> {out / SPACES / on.place / 'group'}")


def fleet_asked(args: argparse.Namespace, need: float) -> AbstractContextManager[Fleet]:
    """The workers that were asked for, each of which needs the memory ``need`` [GiB]."""
    from morphofold.cohort.fleet import open_fleet

    return open_fleet(
        workers=args.workers, threads=args.threads, memory=args.memory, scheduler=args.scheduler, need=need
    )


def measured_before(out: Path, *, bids: bool) -> dict[str, Path]:
    """Folders in which the results of all subjects of earlier runs are, or would be."""
    there = (out / "records").glob("*.json")
    names = sorted(path.stem for path in there if not path.name.startswith("."))  # a killed run left a part of one
    if not names:
        raise FileNotFoundError(f"{out}: contains no measured subject. Measure participants first.")
    return {name: _results_folder_or_reason(out, name, bids=bids)[0] for name in names}


def run_group(out: Path, results: dict[str, Path], args: argparse.Namespace, covariates: Covariates) -> int:
    """Write the group of subjects that were measured before."""
    from morphofold.cli.progress import progress
    from morphofold.cohort.group import write_group
    from morphofold.io.folders import alone
    from morphofold.report.pages.group_page import group_report

    with alone(out), progress("group ", args.quiet) as show:
        covariates = covariates.of_sessions(results)
        group = write_group(out, results, report=group_report, progress=show, covariates=covariates)
    print_not_pooled(group, args.quiet)
    failed = len({row["subject"] for row in group.failures})
    if args.json:
        who: dict[str, dict[str, str]] = {}
        for row in group.failures:
            who.setdefault(row["subject"], {})[row["hemi"] or ""] = row["reason"]
        answer = {"subjects": len(results), "with_results": group.n_measured, "failures": who}
        print_json({**answer, "remarks": group.remarks_on_group, "page": out / "group" / "report.html"})
    else:
        print_line(f"{len(results)} subjects{f', {failed} of them with failures' if failed else ''} -> {out / 'group'}")
    return 1 if failed else 0


def places_of(out: Path, subjects: Sequence[Participant]) -> tuple[dict[str, Path], dict[str, str]]:
    """Folder for the results of each subject, and reasons why some have none: BIDS shortens names.

    Raises
    ------
    FileExistsError
        If morphofold did not write a folder.
    """
    from morphofold.cohort.group import GROUP_FOLDER
    from morphofold.io import refuse_foreign, refuse_no_collection
    from morphofold.results.dataset import refuse_other_dataset

    if not any(one.bids for one in subjects):
        refuse_no_collection(out, "cohort")
    else:
        refuse_other_dataset(out)
    refuse_foreign(out / GROUP_FOLDER)  # before hours of work, not after them
    places: dict[str, Path] = {}
    reasons: dict[str, str] = {}
    taken: dict[Path, str] = {}
    for one in subjects:
        place, reason = _results_folder_or_reason(out, one.name, bids=one.bids)
        other = taken.setdefault(place, one.name)
        if other != one.name:
            reason = f"{other}, {one.name}: BIDS shortens both to {place.name}. Rename one of them."
        places[one.name] = place
        reasons |= {one.name: reason} if reason else {}
    return places, reasons


def _results_folder_or_reason(out: Path, name: str, *, bids: bool) -> tuple[Path, str]:
    """Folder for the results of a subject and ""; if it can have none, a folder that does not exist, and the reason."""
    from morphofold.cohort.participant import results_of

    try:
        return results_of(out, name, bids=bids), ""
    except (ValueError, OSError) as error:
        return out / "records" / name, str(error)


def begin_cohort(out: Path, *, bids: bool) -> None:
    """Make the folder of a cohort, or use an existing one."""
    from morphofold.cohort.scales import SCALES_FILE
    from morphofold.cohort.space import SPACES
    from morphofold.io import begin_collection
    from morphofold.results.dataset import begin_dataset

    if bids:
        begin_dataset(out, ignoring=("group", "logs", "records", "lock", SPACES, SCALES_FILE))
    else:
        begin_collection(out, "cohort")


def memory_needed(subjects: Sequence[Participant], accuracy: str, report: bool) -> float:
    """Memory that the largest of the first few subjects will take [GiB]; 0 if none of them can be read."""
    from morphofold.forecasts.cost import memory_of_analysis
    from morphofold.io import read_surface
    from morphofold.io.cortex_files import cortex_files, hemispheres

    found = []
    for subject in subjects:
        try:
            hemis = subject.hemis or hemispheres(Path(subject.folder))
            sizes = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
        except (ValueError, OSError):
            continue
        found.append(memory_of_analysis(sizes, accuracy=accuracy, report=report))
        if len(found) == SUBJECTS_READ_FOR_MEMORY:
            break
    return max(found, default=0.0)


def print_not_pooled(group: Group, quiet: bool) -> None:
    """Print how many persons there are if there are fewer than subjects, and what was not measured in the same way."""
    if group.persons_words:
        print_note(group.persons_words, quiet)
    if answer := group.pooling.sentences:
        few = len(group.pooling.left_out)
        print_note(
            f"warning: {' '.join(answer)} {few} measures are not fully pooled: see the page of the group.", quiet
        )


def print_note(text: str, quiet: bool) -> None:
    if not quiet:
        print_line(text, file=sys.stderr)


def ended(outcomes: Sequence[Outcome], what: str, page: Path, *, as_json: bool, **more: Any) -> int:
    """Print how many have results, and the first failures, or everything and ``more`` as JSON; return the exit code."""
    failed = [one for one in outcomes if one.state == "failed"]
    partly = [one for one in outcomes if one.state != "failed" and one.failures]
    before, changed = sum(one.state == "reused" for one in outcomes), sum(one.changed for one in outcomes)
    if as_json:
        answer: dict[str, Any] = {f"{what}s": len(outcomes), "with_results": len(outcomes) - len(failed)}
        who = {one.name: dict(one.failures) for one in failed + partly}
        answer |= {"from_before": before, "changed": changed, "failed": len(failed), "in_part": len(partly)}
        answer |= {"failures": who, "page": page}
        print_json({**answer, **more})
        return 1 if failed or partly else 0
    for one in (failed + partly)[:5]:
        for part, why in one.failures.items():
            print_line(f"{' '.join(filter(None, (one.name, part)))}: {why}")
    words = [f"{len(outcomes) - len(failed)} of {len(outcomes)} {what}s have results"]
    words += [f"{before} of them from before"] if before else []
    words += [f"{changed} done again, because their files had changed"] if changed else []
    words += [f"{len(failed)} failed"] if failed else []
    words += [f"{len(partly)} in part"] if partly else []
    print_line(f"{', '.join(words)} -> {page}")
    return 1 if failed or partly else 0
