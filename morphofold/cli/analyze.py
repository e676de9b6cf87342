"""``morphofold analyze``: measure a cortex, and write the results and a page."""

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from morphofold import results
from morphofold.analysis import Measures, measuring
from morphofold.cli.command_options import Analyze, Answer, Measuring, sides
from morphofold.cli.terminal_output import print_line, progress
from morphofold.errors import MissingPart, OptionsClash, Refusal
from morphofold.forecasts.cost_record import READING_STAGE, analysis_cost_line, cost_of_analysis
from morphofold.group.measure_subject import keywords_of
from morphofold.io import read_cortex, refuse_foreign
from morphofold.io.atomic_folders import mark_as_ours, refuse_overlap
from morphofold.io.cortices import hemispheres
from morphofold.io.files import side_named
from morphofold.mesh_quality.cortex_checks import excluded_file, excluding, shows_side
from morphofold.note_texts import WARNINGS
from morphofold.number_texts import in_one_line, number
from morphofold.progress_callbacks import part_of, parts_of
from morphofold.report import analysis_report
from morphofold.results.layouts import Layout
from morphofold.spheres.template_folders import check_template, read_parcellated
from morphofold.surface import ONE_SURFACE, Cortex
from morphofold.threads import enough_threads, run_parallel
from morphofold.timing import Stages, working_seconds

Work = Callable[[], Any]  # reads or measures a hemisphere
#: label, name and format
PRINTED_SCALARS = (
    ("GI", "gyrification_index", "{:.2f}"),
    ("cortical thickness", "mean_cortical_thickness_mm", "{:.2f} mm"),
    ("gyral thickness", "median_gyral_thickness_mm", "{:.1f} mm"),
)


def run(args: Analyze) -> Answer:
    options = measuring_options(args) | ({} if args.only is None else {"only": args.only.split(",")})
    measure = partial(measuring.measure, **keywords_of(options))
    if args.subject is not None:
        folder = subject_folder(args.subject, args.subjects_dir)
        args.input, args.subject = str(folder), folder.name
    if args.input is None and args.white is None and args.surface is None:
        raise OptionsClash("Nothing to measure: give INPUT, or -s, or --white and --pial, or --surface.")
    parameters = {"hemi": args.hemi, "name": args.name, **options}
    if args.stages:
        return _analyse_stages(Path(args.input or ""), args, parameters, measure)
    target_subject = args.into_subject and results.check_subject(args.input or "")
    clock, failed_hemis = Stages(), dict[str, str]()
    clock.begin(READING_STAGE)
    cortices = _results_of_hemispheres(_hemisphere_readers(args), failed_hemis)
    if args.exclude and not any("excluded" in cortex.info for cortex in cortices):
        print_line(f"{args.exclude}: {cortices[0].name} has no such file, so it is measured whole.", file=sys.stderr)
    clock.end()
    if args.wide:
        results.check_wide(cortices)
    out, write = _folder_and_writer(cortices, args)
    with progress(cortices[0].name, args.quiet) as on_progress:
        progresses = parts_of(part_of(on_progress, 0.0, 0.8), [f"{cortex.hemi} " for cortex in cortices])
        start_time, spent = working_seconds(), Stages()
        work_of_hemi = {
            side.hemi: partial(measure, side, progress=show, clock=spent) for side, show in zip(cortices, progresses)
        }
        measures = _results_of_hemispheres(work_of_hemi, failed_hemis)
        clock.divide(working_seconds() - start_time, spent.seconds)
        on_progress(0.8, "writing")
        clock.begin(READING_STAGE)
        stages = [] if args.no_report or not args.input else [read_cortex(path) for path in _stage_folders(args.input)]
        write_report = not args.no_report and analysis_report
        write(measures, failed=failed_hemis, parameters=parameters, report=write_report, stages=stages, clock=clock)
        on_progress(1.0, "done")
    for hemi, reason in failed_hemis.items():
        print_line(f"{hemi} failed: {reason}", file=sys.stderr)
    summary_path = Layout(out, out.name if args.layout == "bids" else "").path("summary")
    lines = [*_lines(measures, clock), f"-> {summary_path if args.no_report else out / 'report.html'}"]
    lines_on_subject = list(_write_into(target_subject, measures)) if target_subject else []
    for line in lines_on_subject if args.json else ():
        print_line(line, file=sys.stderr)
    return Answer(summary_path, lines + lines_on_subject, 1 if failed_hemis else 0)


def _write_into(target_folder: Path, measures: list[Measures]) -> Iterator[str]:
    """Write into a subject's own folder; a line on what was written, and one on what was not."""
    written_files, foreign_files = results.write_into_subject(measures, target_folder)
    yield f"into {target_folder}: {', '.join(written_files) or 'nothing'}"
    if foreign_files:
        yield f"kept, because morphofold did not write them: {', '.join(foreign_files)}"


def _folder_and_writer(cortices: list[Cortex], args: Analyze) -> tuple[Path, Callable[..., Path]]:
    """Folder of the results, and what writes them; raises if the folder is not ours or holds an input."""
    is_bids = args.layout == "bids"
    is_plain = not is_bids and cortices[0].origin in ("FreeSurfer", "simulation", "files", ONE_SURFACE)
    folder_name = Path(args.input).resolve().name if args.input and is_plain else cortices[0].name
    name = args.name or args.subject or folder_name
    out = args.out or Path(f"{writable_name(name)}-analysis")
    write = partial(results.write_analysis, out=out, mgh=args.mgh, cifti=args.cifti, wide=args.wide)
    if is_bids:
        write, out = partial(results.write_dataset, dataset=out, name=name), results.subject_place(out, name)
    input_files = [file for cortex in cortices for file in cortex.files]
    refuse_foreign(out, [*input_files, args.input] if args.input else input_files)
    return out, write


def _lines(measures: list[Measures], clock: Stages) -> Iterator[str]:
    """A line per hemisphere with its main numbers, or those asked for, its warnings, and the cost."""
    for m in measures:
        texts = [f"{key} {number(m.scalars[key])}" if key in m.scalars else key for key in m.parameters.get("only", ())]
        if not texts:
            texts.append(f"{m.scalars['n_vertices']:,} vertices")
            for label, key, value_format in PRINTED_SCALARS:
                value = m.scalars[key]
                texts.append(f"{label} {'n/a' if value is None else value_format.format(value)}")
        yield f"{m.cortex.called}: {', '.join(texts)}"
        yield from (f"warning: {m.notes[key]} [{key}]" for key in WARNINGS if key in m.notes)
    yield analysis_cost_line(cost_of_analysis(measures, clock))


def _results_of_hemispheres(work_by_hemi: Mapping[str, Work], failed_hemis: dict[str, str]) -> list[Any]:
    """Return the results of the hemispheres; reasons of failures are added to ``failed_hemis``. Raises if all fail.

    With four threads or more they are worked on beside each other.
    """

    def result_or_error(work: Work) -> Any:
        try:
            return work()
        except (ValueError, TypeError, OSError) as error:  # of one hemisphere; the other one is still measured
            return error

    tasks = [partial(result_or_error, work) for work in work_by_hemi.values()]
    results_or_errors = run_parallel(*tasks) if enough_threads(len(tasks)) else [task() for task in tasks]
    errors = {hemi: result for hemi, result in zip(work_by_hemi, results_or_errors) if isinstance(result, Exception)}
    failed_hemis |= {hemi: in_one_line(error) for hemi, error in errors.items()}
    if len(errors) == len(work_by_hemi):
        error = next(iter(errors.values()))
        if len(failed_hemis) == 1:
            raise error
        error_class = type(error) if isinstance(error, Refusal | OSError) else Refusal
        raise error_class(" ".join(f"{hemi} failed: {reason}" for hemi, reason in failed_hemis.items()))
    return [result for result in results_or_errors if not isinstance(result, Exception)]


def _hemisphere_readers(args: Analyze) -> dict[str, Work]:
    """Functions that read each requested hemisphere, from INPUT or from --white and --pial."""
    options = {"name": args.name or args.subject, "annotation": args.annot, "annotation_from": args.annot_from}
    if args.input is None:
        hemi = None if args.hemi == "both" else args.hemi
        surface_files = list(filter(None, (args.surface, args.white, args.pial)))
        if hemi is None and not any(side_named(file.name) for file in surface_files):
            raise OptionsClash(f"{surface_files[0]}: no name shows the hemisphere. Pass --hemi lh or rh.")
        files = {key: getattr(args, key) for key in ("white", "pial", "surface", "thickness", "mask", "sphere")}
        return {"": partial(_read_without, args.exclude, None, hemi, **options, **files)}
    hemis = sides(args.hemi) or hemispheres(Path(args.input))
    return {hemi: partial(_read_without, args.exclude, args.input, hemi, **options) for hemi in hemis}


def _read_without(exclude: str | None, *words: Any, **options: Any) -> Cortex:
    """A cortex without what its file of ``--exclude`` holds."""
    cortex = read_parcellated(*words, **options)
    return excluding(cortex, excluded_file(exclude, cortex.name, cortex.hemi))


def _analyse_stages(
    folder: Path, args: Analyze, parameters: Mapping[str, Any], measure: Callable[..., Measures]
) -> Answer:
    """Analyse all stages of a simulation; existing analyses are kept."""
    stages = _stage_folders(folder)
    if not stages:
        raise MissingPart(f"{folder}: has no stages. Name a folder that `morphofold simulate` wrote.")
    name = args.name or folder.resolve().name
    out = args.out or Path(f"{writable_name(name)}-growth")
    refuse_overlap(out, [folder])
    mark_as_ours(out)
    args.on_interrupt = " Run it again to go on."
    n_reused = 0
    with progress(name, args.quiet) as on_progress:
        for i, stage_folder in enumerate(stages):
            clock = Stages()
            clock.begin(READING_STAGE)
            cortex = read_cortex(stage_folder, name=args.name)
            if results.is_analysis_of(out / stage_folder.name, cortex, parameters):
                n_reused += 1
                continue
            stage_progress = part_of(on_progress, i / len(stages), 1 / len(stages), f"{stage_folder.name} ")
            measures = measure(cortex, progress=stage_progress, clock=clock)
            results.write_analysis([measures], out / stage_folder.name, parameters=parameters, clock=clock)
        on_progress(1.0, "done")
    return Answer(None, [f"{len(stages)} stages, {n_reused} of them measured before -> {out}"])


def _stage_folders(folder: str | Path) -> list[Path]:
    """Folders of all stages of a simulation; empty if the folder is not a simulation."""
    return sorted(stage_file.parent for stage_file in Path(folder).glob("stages/g*/stage.json"))


def writable_name(name: str) -> str:
    """Name of a folder for a subject: separators, line breaks and control characters become dashes."""
    return re.sub(r"[/\\\x00-\x1f\x7f-\x9f]", "-", name).strip(". ") or "unnamed"


def subject_folder(subject_name: str, subjects_dir: str | None) -> Path:
    """Folder of a FreeSurfer subject by its name: in ``subjects_dir``, else in the environment's SUBJECTS_DIR.

    Raises
    ------
    OptionsClash
        If neither is set.
    """
    subjects_folder = subjects_dir or os.environ.get("SUBJECTS_DIR")
    if not subjects_folder:
        raise OptionsClash(
            f"-s {subject_name}: the folder of subjects is not given. Set SUBJECTS_DIR, pass --subjects-dir DIR, or "
            "pass the subject's folder as INPUT."
        )
    return Path(subjects_folder) / subject_name


def measuring_options(args: Measuring) -> dict[str, Any]:
    """Options as results record them. Standard accuracy, parcellation and repair, and no cap, are not recorded, so that
    results of older runs stay valid. Raises if the template of --annot-from has no parcellation."""
    annot, template, exclude = (getattr(args, name, None) for name in ("annot", "annot_from", "exclude"))
    hemi, white, surface = (getattr(args, name, None) for name in ("hemi", "white", "surface"))
    if exclude and not (hemi in ("lh", "rh") or white or surface or shows_side(exclude)):
        raise OptionsClash(f"--exclude {exclude}: shows no hemisphere. Write {{hemi}} in it, or pass --hemi lh or rh.")
    if template is not None:
        template_folder = check_template(template, annot)
        template = str(template_folder.folder) if Path(template).is_dir() else template
    recorded_options = {
        "curvature_scale_mm": args.curvature_scale,
        "gyral_width_mm": args.gyral_width,
        "thickness_cap_mm": args.thickness_cap,
        "accuracy": None if args.accuracy == "standard" else args.accuracy,
        "repair": False if args.no_repair else None,
        "annotation": annot,
        "annotation_from": template,
        "exclude": exclude and os.path.abspath(exclude),
    }
    return {key: value for k, (key, value) in enumerate(recorded_options.items()) if k < 2 or value is not None}
