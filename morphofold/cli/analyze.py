"""Measure one cortex: curvature, thickness, gyral thickness, gyrification and regions, with a page to look at. Exit
code 1: only one of two hemispheres could be measured; summary.json and the page give the reason."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from morphofold.cli import add_options, add_threads
from morphofold.cli.measuring import add_measuring_args, add_side_args, measuring_options
from morphofold.cli.streams import print_file, print_line
from morphofold.errors import MissingPart, OptionsClash, Refusal
from morphofold.progress import Progress, part_of, parts_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from morphofold.analysis import Measures
    from morphofold.surface import Cortex
    from morphofold.timing import Stages

EXAMPLES = (
    "morphofold analyze subjects/bert -o bert",
    "morphofold analyze --white lh.white.surf.gii --pial lh.pial.surf.gii --hemi lh -o mine",
)
HEMISPHERE_ERRORS = (ValueError, TypeError, OSError)  # errors of one hemisphere; the other one is still measured
T = TypeVar("T")


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="INPUT", nargs="?", help="FreeSurfer subject, simulation or analysis folder")
    add_options(
        parser,
        ("-s --subject", "SUBJECT", "FreeSurfer subject by its name, instead of INPUT"),
        ("--subjects-dir --sd", "DIR", "folder that holds SUBJECT (default: the variable SUBJECTS_DIR)"),
    )
    add_side_args(parser, "INPUT")
    add_options(
        parser,
        ("--white", "FILE", "white surface, with --pial instead of INPUT"),
        ("--pial", "FILE", "pial surface, with --white instead of INPUT"),
        ("--name", "NAME", "name in the tables and on the page (default: INPUT's name)"),
    )
    add_measuring_args(parser)
    add_options(
        parser,
        (
            "--stages",
            None,
            "measure every stage of a simulation, each into its own folder in DIR, for compare --growth; no pages. "
            "Stages that an earlier run measured from the same files are kept",
        ),
        (
            "--only",
            "NAMES",
            "scalars, maps and tables to measure, in the time that these need, such as gyral_thickness,n_hinges "
            "(default: all)",
        ),
        ("--no-report", None, "tables and maps only, no page or pictures"),
        ("--mgh", None, "also write maps as MGH (FreeSurfer's own format and GIFTI are always written); plain layout"),
        ("--wide", None, "also write regions_wide.tsv: one row, a column per region and measure; plain layout"),
    )
    parser.add_argument(
        "--layout",
        choices=["plain", "bids"],
        default="plain",
        help="bids: DIR is a BIDS derivatives dataset; sub-NAME is added to it, or replaced in it",
    )
    add_options(
        parser,
        ("-o --out", "DIR", "folder to write (default: NAME-analysis here)"),
        (
            "--into-subject",
            None,
            "also write surf/?h.gyral_thickness, surf/?h.pial_lgi and stats/?h.aparc.gyral.stats into the FreeSurfer "
            "subject; files that morphofold did not write are kept",
        ),
    )
    add_threads(parser)
    add_options(parser, ("--json", None, "print summary.json (in BIDS the provenance file)"))


def run(args: argparse.Namespace) -> int:
    from morphofold.analysis.asked import asked as check_asked
    from morphofold.cli.progress import progress
    from morphofold.forecasts.cost import READING_STAGE
    from morphofold.io import read_cortex
    from morphofold.results import check_wide
    from morphofold.threads import set_threads
    from morphofold.timing import Stages, working_seconds

    set_threads(args.threads)
    options = measuring_options(args) | ({} if args.only is None else {"only": args.only.split(",")})
    _set_input_folder(args)
    if args.stages:
        return _analyse_stages(args, options)
    _refuse_clashes(args)
    subject = _subject_to_write(args)
    clock, failed = Stages(), dict[str, str]()
    clock.begin(READING_STAGE)
    cortices = _results_of_hemispheres(_hemisphere_readers(args), failed)
    clock.end()
    for cortex in cortices:
        check_asked(cortex, options.get("only"))
    if args.wide:
        check_wide(cortices)
    called, out = _name_and_folder(cortices, args)
    with progress(cortices[0].name, args.quiet) as show:
        shares = parts_of(part_of(show, 0.0, 0.8), [f"{cortex.hemi} " for cortex in cortices])
        began, spent = working_seconds(), Stages()
        works = {c.hemi: partial(_measure_cortex, c, options, share, spent) for c, share in zip(cortices, shares)}
        measures = _results_of_hemispheres(works, failed)
        clock.divide(working_seconds() - began, spent.seconds)
        show(0.8, "writing")
        clock.begin(READING_STAGE)
        stages = [] if args.no_report else [read_cortex(place) for place in _stage_folders(args.input)]
        asked = {"hemi": args.hemi, "name": args.name, **options}
        _write_results(measures, out, called, args, failed=failed, parameters=asked, stages=stages, clock=clock)
        show(1.0, "done")
    code = _print_failed(failed)
    _print_measured(measures, out, clock, args)
    if subject is not None:
        _write_into_subject(measures, subject, args)
    return code


def _subject_to_write(args: argparse.Namespace) -> Path | None:
    """The folder of the subject for --into-subject; raises if nothing can be written there."""
    from morphofold.results import check_subject

    if not args.into_subject:
        return None
    if args.input is None:
        raise OptionsClash("--into-subject needs a FreeSurfer subject as INPUT.")
    return check_subject(args.input)


def _write_into_subject(measures: list[Measures], subject: Path, args: argparse.Namespace) -> None:
    from morphofold.results import write_into_subject

    written, kept = write_into_subject(measures, subject)
    where = sys.stderr if args.json else sys.stdout
    print_line(f"into {subject}: {', '.join(written) or 'nothing'}", file=where)
    if kept:
        print_line(f"kept, because morphofold did not write them: {', '.join(kept)}", file=where)


def _refuse_clashes(args: argparse.Namespace) -> None:
    """Raise for options that can't be used with --layout bids, or with --only."""
    if args.only is not None and args.into_subject:
        raise OptionsClash("--only asks for a part, but --into-subject needs the whole. Leave out one.")
    if args.layout == "bids" and args.out is None:
        raise OptionsClash("--layout bids adds a subject to a dataset, but no dataset is named. Pass -o DATASET.")
    if args.layout == "bids" and (args.mgh or args.wide):
        raise OptionsClash("--mgh and --wide belong to the plain layout. Leave them out, or leave out --layout bids.")


def _name_and_folder(cortices: list[Cortex], args: argparse.Namespace) -> tuple[str, Path]:
    """Name of the results, and the folder they go to; raises if the folder is not ours or holds an input."""
    from morphofold.cli.paths import writable_name
    from morphofold.io import refuse_foreign
    from morphofold.results import subject_place

    bids = args.layout == "bids"
    folder = cortices[0].name if bids or not args.input else Path(args.input).resolve().name
    called = args.name or args.subject or folder
    out = subject_place(Path(args.out), called) if bids else Path(args.out or f"{writable_name(called)}-analysis")
    refuse_foreign(out, [file for cortex in cortices for file in cortex.files] + [args.input] * bool(args.input))
    return called, out


def _write_results(measures: list[Measures], out: Path, called: str, args: argparse.Namespace, **fields: Any) -> None:
    from morphofold.report import analysis_report
    from morphofold.results import write_analysis, write_dataset

    report: Any = False if args.no_report else analysis_report
    if args.layout == "bids":
        write_dataset(measures, args.out, called, report=report, **fields)
    else:
        write_analysis(measures, out, report=report, mgh=args.mgh, wide=args.wide, **fields)


def _print_measured(measures: list[Measures], out: Path, clock: Stages, args: argparse.Namespace) -> None:
    """Print the summary as JSON; or a line per hemisphere, its warnings, and the cost."""
    from morphofold.forecasts.cost import analysis_cost_line, cost_of_analysis
    from morphofold.mesh_quality.defects import WARNINGS

    bids = args.layout == "bids"
    summary = out / (f"anat/{out.name}_desc-morphofold_provenance.json" if bids else "summary.json")
    if args.json:
        print_file(summary)
        return
    for m in measures:
        print_line(f"{m.cortex.called}: {_main_numbers(m)}")
        for key in WARNINGS:
            if key in m.notes:
                print_line(f"warning: {m.notes[key]} [{key}]")
    print_line(analysis_cost_line(cost_of_analysis(measures, clock)))
    print_line(f"-> {summary if args.no_report else out / 'report.html'}")


def _main_numbers(m: Measures) -> str:
    """The numbers of the line of a hemisphere; those asked for, if only a part was measured."""
    if "only" in m.parameters:
        from morphofold.words import number

        return ", ".join(f"{k} {number(m.scalars[k])}" if k in m.scalars else k for k in m.parameters["only"])
    index = _formatted_or_na(m.scalars["gyrification_index"], ".2f")
    thickness = _formatted_or_na(m.scalars["mean_cortical_thickness_mm"], ".2f", " mm")
    gyral = _formatted_or_na(m.scalars["median_gyral_thickness_mm"], ".1f", " mm")
    return f"{m.scalars['n_vertices']:,} vertices, GI {index}, cortical thickness {thickness}, gyral thickness {gyral}"


def _results_of_hemispheres(works: Mapping[str, Callable[[], T]], failed: dict[str, str]) -> list[T]:
    """Return the results of the hemispheres; reasons of failures are added to ``failed``. Raises if all fail.

    With four threads or more they are worked on beside each other.
    """
    from morphofold.threads import beside, together

    tasks = [partial(_result_or_error, work) for work in works.values()]
    ends = dict(zip(works, beside(*tasks) if together(len(tasks)) else [task() for task in tasks]))
    wrong = {hemi: end for hemi, end in ends.items() if isinstance(end, Exception)}
    failed |= {hemi: " ".join(str(error).split()) for hemi, error in wrong.items()}
    for error in wrong.values() if len(wrong) == len(works) else ():
        if len(failed) == 1:
            raise error
        kind = type(error) if isinstance(error, Refusal | OSError) else Refusal
        raise kind(" ".join(f"{hemi} failed: {why}" for hemi, why in failed.items()))
    return [end for end in ends.values() if not isinstance(end, Exception)]


def _result_or_error(work: Callable[[], T]) -> T | Exception:
    try:
        return work()
    except HEMISPHERE_ERRORS as error:
        return error


def _print_failed(failed: Mapping[str, str]) -> int:
    """Print which hemispheres failed and why; return the exit code."""
    for hemi, why in failed.items():
        print_line(f"{hemi} failed: {why}", file=sys.stderr)
    return 1 if failed else 0


def _hemisphere_readers(args: argparse.Namespace) -> dict[str, Callable[[], Cortex]]:
    """Functions that read each requested hemisphere, from INPUT or from --white and --pial."""
    from morphofold.io import read_cortex
    from morphofold.io.cortex_files import hemispheres
    from morphofold.io.files import side_named
    from morphofold.spheres.parcellation import read_parcellated

    if args.input is None:
        if args.annot_from is not None:
            raise OptionsClash("--annot-from needs a subject as INPUT, which has surf/?h.sphere.reg.")
        if args.hemi not in ("lh", "rh") and not any(side_named(Path(p).name) for p in (args.white, args.pial)):
            raise OptionsClash(
                f"{args.white}: neither its name nor that of --pial shows the hemisphere. Pass --hemi lh or rh."
            )
        hemi = None if args.hemi == "both" else args.hemi
        return {
            "": partial(read_cortex, white=args.white, pial=args.pial, hemi=hemi, name=args.name, annotation=args.annot)
        }
    named = ("lh", "rh") if args.hemi == "both" else (args.hemi,)
    hemis = named if args.hemi else hemispheres(Path(args.input))
    one = partial(
        read_parcellated,
        args.input,
        name=args.name or args.subject,
        annotation=args.annot,
        annotation_from=args.annot_from,
    )
    return {hemi: partial(one, hemi=hemi) for hemi in hemis}


def _formatted_or_na(value: float | None, form: str, unit: str = "") -> str:
    return "n/a" if value is None else f"{value:{form}}{unit}"


def _set_input_folder(args: argparse.Namespace) -> None:
    """Set INPUT to the folder that -s names; raise unless there is INPUT or a pair of surfaces."""
    from morphofold.cli.paths import subject_folder

    pair = [file for file in (args.white, args.pial) if file is not None]
    if args.subject is not None:
        if args.input is not None or pair:
            raise OptionsClash(f"-s {args.subject} replaces INPUT, --white and --pial; give only one of them.")
        folder = subject_folder(args.subject, args.subjects_dir)
        args.input, args.subject = str(folder), folder.name
    elif args.subjects_dir is not None:
        raise OptionsClash("--subjects-dir needs -s SUBJECT, which is missing.")
    if (args.input is None) == (not pair):
        raise OptionsClash("give either INPUT, or -s, or --white and --pial.")
    if len(pair) == 1:
        raise OptionsClash("--white and --pial are needed together; one of them is missing.")


def _analyse_stages(args: argparse.Namespace, options: Mapping[str, Any]) -> int:
    """Analyse all stages of a simulation; existing analyses are kept."""
    from morphofold.cli.paths import writable_name
    from morphofold.cli.progress import progress
    from morphofold.cli.runs import begin
    from morphofold.forecasts.cost import READING_STAGE
    from morphofold.io import read_cortex
    from morphofold.io.folders import refuse_overlap
    from morphofold.results import is_analysis_of, write_analysis
    from morphofold.timing import Stages

    others = (args.json, args.mgh, args.wide, args.into_subject, args.only is not None)
    if args.input is None or args.hemi or args.annot or args.annot_from or any(others) or args.layout != "plain":
        raise OptionsClash(
            "--stages needs a simulation folder as INPUT, and can't be used with --hemi, --annot, --annot-from, "
            "--json, --mgh, --wide, --into-subject, --only or another layout."
        )
    folder = Path(args.input)
    places = sorted((folder / "stages").glob("g*"))
    if not places:
        raise MissingPart(f"{folder}: has no stages. Name a folder that `morphofold simulate` wrote.")
    called = args.name or folder.resolve().name
    out = Path(args.out or f"{writable_name(called)}-growth")
    refuse_overlap(out, [folder])
    begin(out)
    args.on_interrupt = " Run it again to go on."
    done = 0
    with progress(called, args.quiet) as show:
        for i, place in enumerate(places):
            clock = Stages()
            clock.begin(READING_STAGE)
            cortex = read_cortex(place, name=args.name)
            share = part_of(show, i / len(places), 1 / len(places), f"{place.name} ")
            asked = {"hemi": None, "name": args.name, **options}
            if is_analysis_of(out / place.name, cortex, asked):
                done += 1
                continue
            found = _measure_cortex(cortex, options, share, clock)
            write_analysis([found], out / place.name, parameters=asked, clock=clock)
        show(1.0, "done")
    print_line(f"{len(places)} stages, {done} of them measured before -> {out}")
    return 0


def _measure_cortex(cortex: Cortex, options: Mapping[str, Any], progress: Progress, clock: Stages) -> Measures:
    from morphofold.analysis.measuring import measure
    from morphofold.cohort.measuring import keywords_of

    return measure(cortex, **keywords_of(options), progress=progress, clock=clock)


def _stage_folders(folder: str | None) -> list[Path]:
    """Folders of all stages of a simulation; empty if the folder is not a simulation."""
    places = [] if folder is None else sorted((Path(folder) / "stages").glob("g*"))
    return [place for place in places if (place / "stage.json").is_file()]
