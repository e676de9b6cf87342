"""``morphofold analyze``: read a cortex, measure it, write the results and a page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from morphofold import results
from morphofold.analysis import Measures, measuring
from morphofold.analysis.asked import asked as check_only
from morphofold.cli.inputs import mark_as_ours, measuring_options, subject_folder, writable_name
from morphofold.cli.options import Analyze, Answer, sides
from morphofold.cli.printing import print_line
from morphofold.cli.progress import progress
from morphofold.cohort.measuring import keywords_of
from morphofold.errors import MissingPart, OptionsClash, Refusal
from morphofold.forecasts.cost import READING_STAGE, analysis_cost_line, cost_of_analysis
from morphofold.io import read_cortex, refuse_foreign
from morphofold.io.cortices import hemispheres
from morphofold.io.files import side_named
from morphofold.io.folders import refuse_overlap
from morphofold.mesh_quality.defects import WARNINGS
from morphofold.progress import Progress, part_of, parts_of
from morphofold.report import analysis_report
from morphofold.results.layouts import Layout
from morphofold.spheres.parcellation import read_parcellated
from morphofold.surface import Cortex
from morphofold.threads import enough_threads, run_parallel
from morphofold.timing import Stages, working_seconds
from morphofold.words import number

HEMISPHERE_ERRORS = (ValueError, TypeError, OSError)  # errors of one hemisphere; the other one is still measured
T = TypeVar("T")


def run(args: Analyze) -> Answer:
    options = measuring_options(args) | ({} if args.only is None else {"only": args.only.split(",")})
    if args.subject is not None:
        folder = subject_folder(args.subject, args.subjects_dir)
        args.input, args.subject = str(folder), folder.name
    if args.input is None and args.white is None:
        raise OptionsClash("Nothing to measure: give INPUT, or -s, or --white and --pial.")
    if args.stages:
        return _analyse_stages(Path(args.input or ""), args, options)
    subject = results.check_subject(args.input) if args.into_subject and args.input is not None else None
    clock, failed = Stages(), dict[str, str]()
    clock.begin(READING_STAGE)
    cortices = _results_of_hemispheres(_hemisphere_readers(args), failed)
    clock.end()
    for cortex in cortices:
        check_only(cortex, options.get("only"))
    if args.wide:
        results.check_wide(cortices)
    name, out = _name_and_folder(cortices, args)
    with progress(cortices[0].name, args.quiet) as show:
        parts = parts_of(part_of(show, 0.0, 0.8), [f"{cortex.hemi} " for cortex in cortices])
        began, spent = working_seconds(), Stages()
        works = {c.hemi: partial(_measure_cortex, c, options, part, spent) for c, part in zip(cortices, parts)}
        measures = _results_of_hemispheres(works, failed)
        clock.divide(working_seconds() - began, spent.seconds)
        show(0.8, "writing")
        clock.begin(READING_STAGE)
        stages = [] if args.no_report else [read_cortex(folder) for folder in _stage_folders(args.input)]
        asked = {"hemi": args.hemi, "name": args.name, **options}
        _write_results(measures, out, name, args, failed=failed, parameters=asked, stages=stages, clock=clock)
        show(1.0, "done")
    for hemi, why in failed.items():
        print_line(f"{hemi} failed: {why}", file=sys.stderr)
    summary = Layout(out, out.name if args.layout == "bids" else "").path("summary")
    lines = [*_lines(measures, clock), f"-> {summary if args.no_report else out / 'report.html'}"]
    if subject is not None:
        written, others = results.write_into_subject(measures, subject)
        lines.append(f"into {subject}: {', '.join(written) or 'nothing'}")
        lines += [f"kept, because morphofold did not write them: {', '.join(others)}"] if others else []
    return Answer(summary, lines, 1 if failed else 0)


def _name_and_folder(cortices: list[Cortex], args: Analyze) -> tuple[str, Path]:
    """Name of the results, and the folder they go to; raises if the folder is not ours or holds an input."""
    bids = args.layout == "bids"
    folder = cortices[0].name if bids or not args.input else Path(args.input).resolve().name
    name = args.name or args.subject or folder
    out = args.out or Path(f"{writable_name(name)}-analysis")
    out = results.subject_place(out, name) if bids else out
    refuse_foreign(
        out, [*(file for cortex in cortices for file in cortex.files), *([args.input] if args.input else [])]
    )
    return name, out


def _write_results(measures: list[Measures], out: Path, name: str, args: Analyze, **fields: Any) -> None:
    report: Any = False if args.no_report else analysis_report
    if args.layout == "bids" and args.out is not None:
        results.write_dataset(measures, args.out, name, report=report, **fields)
    else:
        results.write_analysis(measures, out, report=report, mgh=args.mgh, wide=args.wide, **fields)


def _lines(measures: list[Measures], clock: Stages) -> Iterator[str]:
    """A line per hemisphere, its warnings, and the cost."""
    for m in measures:
        yield f"{m.cortex.called}: {_main_numbers(m)}"
        yield from (f"warning: {m.notes[key]} [{key}]" for key in WARNINGS if key in m.notes)
    yield analysis_cost_line(cost_of_analysis(measures, clock))


def _main_numbers(m: Measures) -> str:
    """The numbers of the line of a hemisphere; those asked for, if only a part was measured."""
    if "only" in m.parameters:
        return ", ".join(f"{k} {number(m.scalars[k])}" if k in m.scalars else k for k in m.parameters["only"])
    index = _formatted_or_na(m.scalars["gyrification_index"], ".2f")
    thickness = _formatted_or_na(m.scalars["mean_cortical_thickness_mm"], ".2f", " mm")
    gyral = _formatted_or_na(m.scalars["median_gyral_thickness_mm"], ".1f", " mm")
    return f"{m.scalars['n_vertices']:,} vertices, GI {index}, cortical thickness {thickness}, gyral thickness {gyral}"


def _formatted_or_na(value: float | None, form: str, unit: str = "") -> str:
    return "n/a" if value is None else f"{value:{form}}{unit}"


def _results_of_hemispheres(works: Mapping[str, Callable[[], T]], failed: dict[str, str]) -> list[T]:
    """Return the results of the hemispheres; reasons of failures are added to ``failed``. Raises if all fail.

    With four threads or more they are worked on beside each other.
    """
    tasks = [partial(_result_or_error, work) for work in works.values()]
    ends = dict(zip(works, run_parallel(*tasks) if enough_threads(len(tasks)) else [task() for task in tasks]))
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


def _hemisphere_readers(args: Analyze) -> dict[str, Callable[[], Cortex]]:
    """Functions that read each requested hemisphere, from INPUT or from --white and --pial."""
    pair = [file for file in (args.white, args.pial) if file is not None]
    if args.input is None:
        if args.hemi not in ("lh", "rh") and not any(side_named(file.name) for file in pair):
            raise OptionsClash(
                f"{args.white}: neither its name nor that of --pial shows the hemisphere. Pass --hemi lh or rh."
            )
        hemi = None if args.hemi == "both" else args.hemi
        return {
            "": partial(read_cortex, white=args.white, pial=args.pial, hemi=hemi, name=args.name, annotation=args.annot)
        }
    reader = partial(
        read_parcellated,
        args.input,
        name=args.name or args.subject,
        annotation=args.annot,
        annotation_from=args.annot_from,
    )
    hemis = sides(args.hemi) or hemispheres(Path(args.input))
    return {hemi: partial(reader, hemi=hemi) for hemi in hemis}


def _analyse_stages(folder: Path, args: Analyze, options: Mapping[str, Any]) -> Answer:
    """Analyse all stages of a simulation; existing analyses are kept."""
    stages = sorted((folder / "stages").glob("g*"))
    if not stages:
        raise MissingPart(f"{folder}: has no stages. Name a folder that `morphofold simulate` wrote.")
    name = args.name or folder.resolve().name
    out = args.out or Path(f"{writable_name(name)}-growth")
    refuse_overlap(out, [folder])
    mark_as_ours(out)
    args.on_interrupt = " Run it again to go on."
    done = 0
    with progress(name, args.quiet) as show:
        for i, stage in enumerate(stages):
            clock = Stages()
            clock.begin(READING_STAGE)
            cortex = read_cortex(stage, name=args.name)
            asked = {"hemi": None, "name": args.name, **options}
            if results.is_analysis_of(out / stage.name, cortex, asked):
                done += 1
                continue
            part = part_of(show, i / len(stages), 1 / len(stages), f"{stage.name} ")
            measures = _measure_cortex(cortex, options, part, clock)
            results.write_analysis([measures], out / stage.name, parameters=asked, clock=clock)
        show(1.0, "done")
    return Answer(None, [f"{len(stages)} stages, {done} of them measured before -> {out}"])


def _measure_cortex(cortex: Cortex, options: Mapping[str, Any], progress: Progress, clock: Stages) -> Measures:
    return measuring.measure(cortex, **keywords_of(options), progress=progress, clock=clock)


def _stage_folders(folder: str | None) -> list[Path]:
    """Folders of all stages of a simulation; empty if the folder is not a simulation."""
    stages = [] if folder is None else sorted((Path(folder) / "stages").glob("g*"))
    return [stage for stage in stages if (stage / "stage.json").is_file()]
