"""One subject of a cohort: read, measured, and written as by ``analyze``; and how a group is measured: by one curvature
scale and one net width, chosen before the first measurement."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict

from morphofold import results
from morphofold.analysis import Measures, measuring
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.graph.net_builder import CrestNetBuilder
from morphofold.digests_and_json import Row, sha256_of
from morphofold.forecasts.cost_record import READING_STAGE
from morphofold.group.task_records import INPUT_ERRORS, Outcome, TaskFolder, TaskLog, digest, perform
from morphofold.group.workers import Lost, Workers
from morphofold.io import files_of, remove_folder
from morphofold.io.cortices import cortex_files, hemispheres, read_cortex
from morphofold.io.json_files import Count, Length, Record, read_json, write_json
from morphofold.mesh_quality.cortex_checks import excluded_file, excluding
from morphofold.number_texts import in_one_line, rounded_up
from morphofold.progress_callbacks import Progress, logged
from morphofold.results.analysis_files import DrawPage
from morphofold.results.layouts import subject_place
from morphofold.spheres.template_folders import carried_files, read_parcellated
from morphofold.surface import Cortex
from morphofold.timing import Stages

SCALES_FILE = "scales.json"
MOST_SUBJECTS_READ = 50  # most subjects used to choose the scales, spread evenly over their names
MEASURE_OPTIONS = {"curvature_scale_mm", "gyral_width_mm", "thickness_cap_mm", "accuracy", "repair", "only"}
COARSEST_MESH_RATIO = 2.0  # meshes coarser than this many times the median do not set the common scale

Options = Mapping[str, Any]  # of measuring, as results record them


class Scales(Record):
    """The lengths for measuring all of a cohort [mm], and the number of hemispheres that they are from."""

    model_config = ConfigDict(frozen=True)

    curvature_scale_mm: Length
    gyral_width_mm: Length | None
    hemispheres: Count

    @property
    def label(self) -> str:
        width_text = "" if self.gyral_width_mm is None else f", crown width {self.gyral_width_mm:g} mm"
        return f"one curvature scale for all, {self.curvature_scale_mm:g} mm{width_text} ({SCALES_FILE})"

    def fill(self, options: Options) -> Row:
        """Options for measuring, with these scales where no scale was requested."""
        filled_options = dict(options)
        if filled_options["curvature_scale_mm"] is None:
            filled_options["common_curvature_scale_mm"] = self.curvature_scale_mm
        if filled_options["gyral_width_mm"] is None:
            filled_options["gyral_width_mm"] = self.gyral_width_mm
        return filled_options


def earlier_scales(out: Path) -> Scales | None:
    """The scales of an earlier run, None if there was none; raises ``ValueError`` if they are damaged."""
    path = out / SCALES_FILE
    return Scales(**read_json(path, Scales, "Remove it, and run again.")) if path.exists() else None


def scales_of(out: Path, workers: Workers, subjects: Sequence[Any], progress: Progress = logged) -> Scales | None:
    """The scales of a cohort of ``Participant``: those of its first run, or chosen and written now.

    The curvature scale is the coarsest that ``measure`` would use for any mesh, except meshes more than twice as coarse
    as the median, so it suits all other meshes. The crown width is the median, so one unusual subject does not set it.
    Both are from 50 subjects at most. None if no subject can be read.

    Raises
    ------
    ValueError
        If ``out/scales.json`` is damaged.
    """
    if (scales := earlier_scales(out)) is not None:
        return scales
    chosen = np.unique(np.linspace(0, len(subjects) - 1, MOST_SUBJECTS_READ).round().astype(int))
    scales_and_widths: list[tuple[float, float]] = []
    for n_done, (subject, pairs) in enumerate(workers.run(read_scales, [subjects[row] for row in chosen]), start=1):
        scales_and_widths += [] if isinstance(pairs, Lost) else pairs
        progress(n_done / len(chosen), f"scales of {subject.name}")
    if not scales_and_widths:
        return None
    mesh_scales, crown_widths = np.array(sorted(scales_and_widths)).T
    coarsest_scale = mesh_scales[mesh_scales <= COARSEST_MESH_RATIO * np.median(mesh_scales)].max()
    scales = Scales(  # of three digits, so that the printed values are those used
        curvature_scale_mm=float(f"{rounded_up(coarsest_scale, 3):.6g}"),
        gyral_width_mm=float(f"{np.nanmedian(crown_widths):.3g}") if np.isfinite(crown_widths).any() else None,
        hemispheres=len(scales_and_widths),
    )
    write_json(out / SCALES_FILE, scales.model_dump())
    return scales


def read_scales(subject: Any) -> list[tuple[float, float]]:
    """Curvature scale and crown width [mm] of the readable hemispheres of a ``Participant``; NaN without gyri."""
    scales_and_widths = []
    with suppress(*INPUT_ERRORS, OSError):  # measuring it reports the problem
        for hemi in subject.hemis or hemispheres(Path(subject.folder)):
            cortex = read_cortex(subject.folder, hemi)
            crest_net = CrestNetBuilder(cortex).scales(None, None)
            scales_and_widths.append((scale_of_curvature(cortex)[0], crest_net.width if crest_net else np.nan))
    return scales_and_widths


def measure_as_asked(cortex: Cortex, options: Options, clock: Stages, log: Callable[[str], None]) -> Measures:
    """Measure with ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` [mm], ``accuracy`` and ``repair``,
    if ``options`` have them; ``common_curvature_scale_mm`` is used if the mesh is fine and large enough for it."""
    keywords = keywords_of(options)
    if (common_scale := options.get("common_curvature_scale_mm")) is not None:
        keywords["curvature_scale"] = curvature_scale(cortex, common_scale)
    return measuring.measure(
        cortex, **keywords, progress=lambda share_done, stage: log(stage) if share_done < 1 else None, clock=clock
    )


def keywords_of(options: Options) -> Row:
    """Recorded options as keywords of :func:`morphofold.analysis.measure`."""
    return {key.removesuffix("_mm"): value for key, value in options.items() if key in MEASURE_OPTIONS}


def curvature_scale(cortex: Cortex, common_scale: float) -> float | None:
    """The common curvature scale [mm], or None (the mesh's own scale) if the mesh is too coarse or too small for it."""
    with suppress(ValueError):
        if scale_of_curvature(cortex)[0] <= common_scale:
            return scale_of_curvature(cortex, common_scale)[0]
    return None


@dataclass(frozen=True)
class Participant:
    """A subject to measure.

    Attributes
    ----------
    name : str
    folder : str
        Folder of the subject.
    task_folder : TaskFolder
    hemis : tuple of {"lh", "rh"}
        Empty: the hemispheres that it has.
    bids : bool
        Write to ``out/sub-NAME`` of a BIDS dataset; otherwise to ``out/subjects/NAME``.
    report : callable or False
        Draws its own page and pictures, as for :func:`morphofold.results.write_analysis`.
    options : mapping
        ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` [mm], ``accuracy``, ``repair``, ``annotation``,
        ``annotation_from`` and ``exclude``, as for ``analyze``.
    """

    name: str
    folder: str
    task_folder: TaskFolder
    hemis: tuple[str, ...] = ()
    bids: bool = False
    report: DrawPage | Literal[False] = False
    options: Options = field(default_factory=dict)

    @property
    def results(self) -> Path:
        """The folder of this subject's results; raises for a name without a character that BIDS allows."""
        out = Path(self.task_folder.out)
        return subject_place(out, self.name) if self.bids else out / "subjects" / self.name

    @property
    def parcellation(self) -> Row:
        """The name of the parcellation, and the template that it is carried over from where it is missing."""
        return {key: self.options.get(key) for key in ("annotation", "annotation_from")}

    def excluded_file(self, hemi: str) -> Path | None:
        """What is left out of a hemisphere, if there is such a file."""
        return excluded_file(self.options.get("exclude"), self.name, hemi)


def measure_participant(subject: Participant) -> Outcome:
    """Measure the hemispheres of a subject, unless this was done for the same files with the same options.

    A hemisphere that cannot be measured fails alone: the other is measured, and the outcome has the reason.
    """
    hemis = subject.hemis or _hemispheres_of_subject(subject)
    parameters = {"hemis": list(hemis), "bids": subject.bids, "report": bool(subject.report), **subject.options}
    parameters.pop("exclude", None)  # its files count

    def key() -> str:
        digests: Row = {}
        for hemi in hemis:
            files = _hemisphere_files(subject, hemi)
            digests[hemi] = files if isinstance(files, str) else {kind: sha256_of(path) for kind, path in files.items()}
        return digest({**parameters, "files": digests})

    return perform(
        subject.task_folder,
        key,
        lambda: files_of(subject.results),
        lambda log, _: _measure_and_write(subject, hemis, log),
        n_parts=len(hemis),
    )


def _hemispheres_of_subject(subject: Participant) -> tuple[str, ...]:
    """The hemispheres that a subject has; both if one is incomplete (it then fails alone) or if none is found."""
    with suppress(OSError):  # the search for its files reports it
        hemis = hemispheres(Path(subject.folder))
        if any(isinstance(_hemisphere_files(subject, hemi), dict) for hemi in hemis):
            return hemis
    return ("lh", "rh")


def _hemisphere_files(subject: Participant, hemi: str) -> dict[str, Path] | str:
    """All files read for a hemisphere; or the reason, if a surface is missing."""
    annotation, template = subject.parcellation.values()
    try:
        carried_paths = carried_files(subject.folder, hemi, template, annotation)
        files = cortex_files(subject.folder, hemi, annotation=None if carried_paths else annotation) | carried_paths
    except INPUT_ERRORS as error:
        return str(error)
    if mask_file := subject.excluded_file(hemi):
        files["excluded"] = mask_file
    summary_file = Path(subject.folder) / "summary.json"  # of a folder written by analyze
    return {**files, "summary": summary_file} if summary_file.is_file() else files


def _measure_and_write(subject: Participant, hemis: tuple[str, ...], log: TaskLog) -> dict[str, str]:
    """Write the results of the hemispheres that can be measured; return the failures of the others."""
    clock, measures, failures = Stages(), list[Measures](), dict[str, str]()
    for hemi in hemis:
        try:
            log(f"{hemi} reading")
            clock.begin(READING_STAGE)
            cortex = read_parcellated(subject.folder, hemi, name=subject.name, **subject.parcellation)
            cortex = excluding(cortex, subject.excluded_file(hemi))
            clock.end()
            log_stage = lambda stage, hemi=hemi: log(f"{hemi} {stage}")
            measures.append(measure_as_asked(cortex, subject.options, clock, log_stage))
        except INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            log(f"{hemi} failed: {failures[hemi]}")
    if not measures:
        remove_folder(subject.results)  # results of earlier files
        return failures
    log("writing")
    results.write_analysis(
        measures,
        subject.results,
        failed=failures,
        parameters={"hemi": None, "name": None, **subject.options},
        report=subject.report,
        clock=clock,
        subject=subject.name if subject.bids else "",
    )
    return failures
