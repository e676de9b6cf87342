"""One subject of a cohort: read, measured, and written as by ``analyze``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from morphofold.group.measure_options import measure_as_asked
from morphofold.group.tasks import INPUT_ERRORS, Outcome, Say, TaskFolder, digest, perform
from morphofold.io import files_of, remove_folder
from morphofold.io.cortices import cortex_files, hemispheres
from morphofold.provenance import sha256_of
from morphofold.results.analyses import DrawPage
from morphofold.spheres.parcellation import carried_files, read_parcellated
from morphofold.words import in_one_line

if TYPE_CHECKING:
    from morphofold.analysis.measures import Measures
    from morphofold.timing import Stages


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
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def results(self) -> Path:
        """The folder of this subject's results."""
        return results_of(Path(self.place.out), self.name, bids=self.bids)


def results_of(out: Path, name: str, *, bids: bool) -> Path:
    """The folder of a subject's results; raises for a name without a character that BIDS allows."""
    from morphofold.results import subject_place

    return subject_place(out, name) if bids else out / "subjects" / name


def measure_participant(subject: Participant) -> Outcome:
    """Measure the hemispheres of a subject, unless this was done for the same files with the same options.

    A hemisphere that cannot be measured fails alone: the other is measured, and the outcome has the reason.
    """
    hemis = subject.hemis or _hemispheres_of_subject(subject)
    asked = {"hemis": list(hemis), "bids": subject.bids, "report": bool(subject.report), **subject.options}
    seen: dict[str, str] = {}  # digests of its files, by path

    def key() -> str:
        files = {hemi: _hemisphere_files(subject, hemi) for hemi in hemis}
        half = {hemi: _incomplete_hemisphere_files(subject, hemi) for hemi in hemis if not files[hemi]}
        named = {f"{hemi} {what}": path for hemi, found in files.items() for what, path in found.items()}
        seen.update((str(path), sha256_of(path)) for path in named.values())
        return digest({**asked, "half": half, "files": {what: seen[str(path)] for what, path in named.items()}})

    return perform(
        subject.place,
        key,
        lambda: files_of(subject.results),
        lambda say, changed: _measure_and_write(subject, hemis, say, seen),
        parts=len(hemis),
    )


def _hemispheres_of_subject(subject: Participant) -> tuple[str, ...]:
    """The hemispheres that a subject has; both if one is incomplete (it then fails alone) or if none is found."""
    try:
        found = hemispheres(Path(subject.folder))
    except OSError:  # the search for its files reports it
        found = ()
    return found if any(_hemisphere_files(subject, hemi) for hemi in found) else ("lh", "rh")


def _hemisphere_files(subject: Participant, hemi: str) -> dict[str, Path]:
    """All files read for a hemisphere; none if a surface is missing."""
    try:
        annotation, template = _parcellation_asked(subject)
        carried = carried_files(subject.folder, hemi, template, annotation)
        found = cortex_files(subject.folder, hemi, annotation=None if carried else annotation) | carried
    except INPUT_ERRORS:
        return {}  # reading it reports why
    summary_file = Path(subject.folder) / "summary.json"  # of a folder written by analyze
    return {**found, "summary": summary_file} if summary_file.is_file() else found


def _parcellation_asked(subject: Participant) -> tuple[str | None, str | None]:
    """The name of the parcellation, and the template that it is carried over from where it is missing."""
    return subject.options.get("annotation"), subject.options.get("annotation_from")


def _incomplete_hemisphere_files(subject: Participant, hemi: str) -> list[str]:
    """Names of the files present for an incomplete hemisphere; the reason of its failure depends on them."""
    folder = Path(subject.folder)
    there = [path.name for at in (folder, folder / "surf", folder / "label") for path in at.glob(f"{hemi}.*")]
    surfaces = (f"{hemi}.white", f"{hemi}.pial")
    return sorted(name for name in there if name.startswith(surfaces) or name.endswith(".annot"))


def _measure_and_write(
    subject: Participant, hemis: tuple[str, ...], say: Say, seen: Mapping[str, str]
) -> dict[str, str]:
    """Write the results of the hemispheres that can be measured; return the failures of the others."""
    from morphofold.results import write_analysis, write_dataset
    from morphofold.timing import Stages

    clock, measured, failures = Stages(), [], {}
    for hemi in hemis:
        try:
            measured.append(_measure_hemisphere(subject, hemi, say, clock, seen))
        except INPUT_ERRORS as error:
            failures[hemi] = in_one_line(error)
            say(f"{hemi} failed: {failures[hemi]}")
    place = subject.results
    if not measured:
        remove_folder(place)  # results of earlier files
        return failures
    say("writing")
    asked = {"hemi": None, "name": None, **subject.options}
    if subject.bids:
        write_dataset(
            measured,
            subject.place.out,
            subject.name,
            failed=failures,
            parameters=asked,
            report=subject.report,
            clock=clock,
        )
    else:
        place.parent.mkdir(parents=True, exist_ok=True)
        write_analysis(measured, place, failed=failures, parameters=asked, report=subject.report, clock=clock)
    return failures


def _measure_hemisphere(subject: Participant, hemi: str, say: Say, clock: Stages, seen: Mapping[str, str]) -> Measures:
    from morphofold.forecasts.cost import READING_STAGE

    say(f"{hemi} reading")
    clock.begin(READING_STAGE)
    annotation, template = _parcellation_asked(subject)
    cortex = read_parcellated(subject.folder, hemi, name=subject.name, annotation=annotation, annotation_from=template)
    for row in cortex.inputs:
        if seen.get(row["path"]) != row["sha256"]:
            raise OSError(f"{row['path']}: changed while it was measured. Run it again.")
    clock.end()
    return measure_as_asked(cortex, subject.options, clock, lambda what: say(f"{hemi} {what}"))
