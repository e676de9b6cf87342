"""One subject of a cohort: read, measured, and written as by ``analyze``."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from morphofold import results
from morphofold.analysis import Measures
from morphofold.forecasts.cost import READING_STAGE
from morphofold.group.common_scales import Options, measure_as_asked
from morphofold.group.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform
from morphofold.io import files_of, remove_folder
from morphofold.io.cortices import cortex_files, hemispheres
from morphofold.provenance import Row, sha256_of
from morphofold.results.analyses import DrawPage
from morphofold.results.layouts import subject_place
from morphofold.spheres.templates import carried_files, read_parcellated
from morphofold.timing import Stages
from morphofold.words import in_one_line


@dataclass(frozen=True)
class Participant:
    """A subject to measure.

    Attributes
    ----------
    name : str
    folder : str
        Folder of the subject.
    place : TaskFolder
    hemis : tuple of {"lh", "rh"}
        Empty: the hemispheres that it has.
    bids : bool
        Write to ``out/sub-NAME`` of a BIDS dataset; otherwise to ``out/subjects/NAME``.
    report : callable or False
        Draws its own page and pictures, as for :func:`morphofold.results.write_analysis`.
    options : mapping
        ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` [mm], ``accuracy``, ``repair``, ``annotation``
        and ``annotation_from``, as for ``analyze``.
    """

    name: str
    folder: str
    place: TaskFolder
    hemis: tuple[str, ...] = ()
    bids: bool = False
    report: DrawPage | Literal[False] = False
    options: Options = field(default_factory=dict)

    @property
    def results(self) -> Path:
        """The folder of this subject's results; raises for a name without a character that BIDS allows."""
        out = Path(self.place.out)
        return subject_place(out, self.name) if self.bids else out / "subjects" / self.name

    @property
    def parcellation(self) -> Row:
        """The name of the parcellation, and the template that it is carried over from where it is missing."""
        return {key: self.options.get(key) for key in ("annotation", "annotation_from")}


def measure_participant(subject: Participant) -> Outcome:
    """Measure the hemispheres of a subject, unless this was done for the same files with the same options.

    A hemisphere that cannot be measured fails alone: the other is measured, and the outcome has the reason.
    """
    hemis = subject.hemis or _hemispheres_of_subject(subject)
    parameters = {"hemis": list(hemis), "bids": subject.bids, "report": bool(subject.report), **subject.options}
    digests: dict[str, str] = {}  # of its files, by path

    def key() -> str:
        files = {hemi: _hemisphere_files(subject, hemi) for hemi in hemis}
        half = {hemi: _names_of_files(subject, hemi) for hemi in hemis if not files[hemi]}
        named = {f"{hemi} {kind}": str(path) for hemi in hemis for kind, path in files[hemi].items()}
        digests.update((path, sha256_of(Path(path))) for path in named.values())
        return digest({**parameters, "half": half, "files": {kind: digests[path] for kind, path in named.items()}})

    return perform(
        subject.place,
        key,
        lambda: files_of(subject.results),
        lambda say, changed: _measure_and_write(subject, hemis, say, digests),
        parts=len(hemis),
    )


def _hemispheres_of_subject(subject: Participant) -> tuple[str, ...]:
    """The hemispheres that a subject has; both if one is incomplete (it then fails alone) or if none is found."""
    try:
        hemis = hemispheres(Path(subject.folder))
    except OSError:  # the search for its files reports it
        hemis = ()
    return hemis if any(_hemisphere_files(subject, hemi) for hemi in hemis) else ("lh", "rh")


def _hemisphere_files(subject: Participant, hemi: str) -> dict[str, Path]:
    """All files read for a hemisphere; none if a surface is missing."""
    annotation, template = subject.parcellation.values()
    try:
        carried = carried_files(subject.folder, hemi, template, annotation)
        files = cortex_files(subject.folder, hemi, annotation=None if carried else annotation) | carried
    except INPUT_ERRORS:
        return {}  # reading it reports why
    summary_file = Path(subject.folder) / "summary.json"  # of a folder written by analyze
    return {**files, "summary": summary_file} if summary_file.is_file() else files


def _names_of_files(subject: Participant, hemi: str) -> list[str]:
    """Names of the files present for an incomplete hemisphere; the reason of its failure depends on them."""
    return sorted(path.name for part in ("", "surf", "label") for path in Path(subject.folder, part).glob(f"{hemi}.*"))


def _measure_and_write(
    subject: Participant, hemis: tuple[str, ...], say: Say, digests: Mapping[str, str]
) -> dict[str, str]:
    """Write the results of the hemispheres that can be measured; return the failures of the others."""
    clock, measures, failures = Stages(), list[Measures](), dict[str, str]()
    for hemi in hemis:
        try:
            measures.append(_measure_hemisphere(subject, hemi, say, clock, digests))
        except INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            say(f"{hemi} failed: {failures[hemi]}")
    if not measures:
        remove_folder(subject.results)  # results of earlier files
        return failures
    say("writing")
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


def _measure_hemisphere(
    subject: Participant, hemi: str, say: Say, clock: Stages, digests: Mapping[str, str]
) -> Measures:
    say(f"{hemi} reading")
    clock.begin(READING_STAGE)
    cortex = read_parcellated(subject.folder, hemi, name=subject.name, **subject.parcellation)
    for row in cortex.inputs:
        if digests.get(row["path"]) != row["sha256"]:
            raise OSError(f"{row['path']}: changed while it was measured. Run it again.")
    clock.end()
    return measure_as_asked(cortex, subject.options, clock, lambda stage: say(f"{hemi} {stage}"))
