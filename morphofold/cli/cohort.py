"""Measure every subject of a folder on several workers, and put them into tables and a page of the group. Run again, it
goes on with what is missing or has changed. Exit code 1: some subjects have no measures, and failures.tsv says why."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from morphofold.cohort.participant import Participant
    from morphofold.cohort.tasks import Outcome


LOOKED_AT = 3           # subjects, for the memory that one takes


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("subjects_dir", metavar="SUBJECTS_DIR", help="folder that holds the subjects")
    parser.add_argument(
        "--subjects", metavar="FILE", help="text file with one subject in a line (default: all in SUBJECTS_DIR)"
    )
    parser.add_argument("--hemi", choices=["lh", "rh", "both"], help="default: those that each subject has")
    parser.add_argument("-o", "--out", metavar="DIR", default="cohort", help="folder (default: cohort)")
    parser.add_argument(
        "--layout", choices=["plain", "bids"], default="plain", help="of the subjects; bids: DIR is a BIDS dataset"
    )
    add_measuring_args(parser)
    add_worker_args(parser)


def add_measuring_args(parser: argparse.ArgumentParser, one: str = "subject", all: str = "the group") -> None:
    """What measuring a subject takes."""
    parser.add_argument(
        "--curvature-scale", type=float, metavar="MM",
        help="radius of curvature neighbourhoods (default: 3, more on coarse meshes)",
    )  # fmt: skip
    parser.add_argument(
        "--gyral-width", type=float, metavar="MM",
        help="lengths of the gyral net are shares of it; hold it to compare hinges of the group (default: from each "
        "surface)",
    )  # fmt: skip
    parser.add_argument(
        "--accuracy", choices=["draft", "standard", "fine"], default="standard", help="as for analyze",
    )  # fmt: skip
    parser.add_argument("--no-report", action="store_true", help=f"no page of each {one}; that of {all} is drawn")


def add_worker_args(parser: argparse.ArgumentParser) -> None:
    """Who does the work."""
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes (default: as many as cores and memory allow)"
    )
    parser.add_argument("--threads", type=int, metavar="N", default=1, help="threads of each worker (default: 1)")
    parser.add_argument(
        "--memory", type=float, metavar="GIB",
        help="a worker that takes more is stopped, and its work begun anew (default: its share of the machine)",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster that runs already, as tcp://host:8786"
    )
    parser.add_argument(
        "--slurm", type=int, metavar="N", help="ask SLURM for N jobs, as ~/.config/dask/jobqueue.yaml describes them"
    )


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.paths import refuse_overlap
    from morphofold.cohort.subjects import find_subjects, named_subjects

    source, out = Path(args.subjects_dir).absolute(), Path(args.out)
    found, templates = find_subjects(source)
    names = found if args.subjects is None else named_subjects(Path(args.subjects))
    refuse_overlap(out, [source])
    if templates and args.subjects is None:
        print(f"left out: {', '.join(templates)} (templates; --subjects can name them)")
    return run_cohort({name: source / name for name in names}, out, args)


def run_cohort(folders: dict[str, Path], out: Path, args: argparse.Namespace, *, group: bool = True) -> int:
    """Measure subjects and, where it is wanted, write their group."""
    import secrets

    from morphofold.cli.progress import progress
    from morphofold.cohort.fleet import open_fleet
    from morphofold.cohort.group import write_group
    from morphofold.cohort.participant import Participant, measure_participant
    from morphofold.cohort.running import run_tasks
    from morphofold.cohort.tasks import Place
    from morphofold.sim.folder_lock import alone

    check_lengths(args)
    options = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    options |= {} if args.accuracy == "standard" else {"accuracy": args.accuracy}
    hemis = ("lh", "rh") if args.hemi == "both" else (args.hemi,) if args.hemi else ()
    bids, report, run_id = args.layout == "bids", not args.no_report, secrets.token_hex(4)
    out = out.absolute()
    subjects = [
        Participant(name, str(folder), Place(str(out), name, run_id), hemis, bids, report, options)
        for name, folder in sorted(folders.items())
    ]
    refuse_namesakes(subjects)
    begin_cohort(out, bids=bids)
    args.on_interrupt = " Run it again to go on."
    with alone(out):
        with open_fleet(
            workers=args.workers, threads=args.threads, memory=args.memory, scheduler=args.scheduler,
            slurm=args.slurm, need=memory_needed(subjects, args.accuracy, report),
        ) as fleet, progress("cohort", args.quiet) as tell:  # fmt: skip
            if not args.quiet:
                print(f"{len(subjects)} subjects, {fleet.words}", file=sys.stderr)
            outcomes = run_tasks(fleet, measure_participant, subjects, tell, lambda text: told(text, args.quiet))
        if group:
            with progress("group ", args.quiet) as tell:
                write_group(out, {one.name: one.results for one in subjects}, progress=tell)
    return ended(outcomes, "subject", out / "group" / "report.html" if group else out)


def measured_before(out: Path, *, bids: bool) -> dict[str, Path]:
    """Where the results of all subjects of earlier runs are, or would be."""
    from morphofold.cohort.participant import results_of

    names = sorted(path.stem for path in (out / "records").glob("*.json"))
    if not names:
        raise FileNotFoundError(f"{out}: holds no subject that was measured. Measure participants first.")
    return {name: results_of(out, name, bids=bids) for name in names}


def run_group(out: Path, results: dict[str, Path], args: argparse.Namespace) -> int:
    """Write the group of what was measured before."""
    from morphofold.cli.progress import progress
    from morphofold.cohort.group import write_group
    from morphofold.sim.folder_lock import alone

    with alone(out), progress("group ", args.quiet) as tell:
        group = write_group(out, results, progress=tell)
    failed = len({row["subject"] for row in group.failures})
    print(f"{len(results)} subjects{f', {failed} of them with failures' if failed else ''} -> {out / 'group'}")
    return 1 if failed else 0


def begin_cohort(out: Path, *, bids: bool) -> None:
    """Make or take the folder of a cohort; raise if it is somebody else's."""
    from morphofold.cli.runs import begin
    from morphofold.io import refuse_foreign
    from morphofold.results.bids import begin_dataset

    if bids:
        begin_dataset(out, ignoring=("group", "logs", "records", "lock"))
        return
    refuse_foreign(out)
    begin(out)


def refuse_namesakes(subjects: Sequence[Participant]) -> None:
    """Raise ``ValueError`` if the results of two subjects would have one place."""
    names: dict[Path, str] = {}
    for one in subjects:
        if (other := names.setdefault(one.results, one.name)) != one.name:
            raise ValueError(f"{other}, {one.name}: BIDS shortens both to {one.results.name}. Rename one of them.")


def memory_needed(subjects: Sequence[Participant], accuracy: str, report: bool) -> float:
    """Memory that the largest of the first few subjects will take [GiB]; 0 if none of them can be read."""
    from morphofold.forecasts.analysis import memory_of_analysis
    from morphofold.io import read_surface
    from morphofold.io.cortices import cortex_files, hemispheres

    found = []
    for subject in subjects:
        try:
            hemis = subject.hemis or hemispheres(Path(subject.folder))
            sizes = [len(read_surface(cortex_files(subject.folder, hemi)["white"]).verts) for hemi in hemis]
        except (ValueError, OSError):
            continue
        found.append(memory_of_analysis(sizes, accuracy=accuracy, report=report))
        if len(found) == LOOKED_AT:
            break
    return max(found, default=0.0)


def told(text: str, quiet: bool) -> None:
    if not quiet:
        print(text, file=sys.stderr)


def ended(outcomes: Sequence[Outcome], what: str, page: Path) -> int:
    """Say how many of how many, and the first that failed; the exit code."""
    failed = [one for one in outcomes if one.state == "failed"]
    partly = [one for one in outcomes if one.state != "failed" and one.failures]
    for one in (failed + partly)[:5]:
        for part, why in one.failures.items():
            print(f"{' '.join(filter(None, (one.name, part)))}: {why}")
    before = sum(one.state == "reused" for one in outcomes)
    words = [f"{len(outcomes) - len(failed)} of {len(outcomes)} {what}s have results"]
    words += [f"{before} of them from before"] if before else []
    words += [f"{len(failed)} failed"] if failed else []
    words += [f"{len(partly)} in part"] if partly else []
    print(f"{', '.join(words)} -> {page}")
    return 1 if failed or partly else 0


def check_lengths(args: argparse.Namespace) -> None:
    for option, length in (("--curvature-scale", args.curvature_scale), ("--gyral-width", args.gyral_width)):
        if length is not None and not 0 < length < float("inf"):
            raise ValueError(f"{option} {length:g}: is no length. Pass a positive number of mm, or leave it out.")
