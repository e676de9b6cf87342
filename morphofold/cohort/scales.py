"""One curvature scale and one net width for a cohort: chosen before its first run measures, and kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ConfigDict

from morphofold.cohort.tasks import REFUSALS
from morphofold.io import atomic_file
from morphofold.io.cortices import hemispheres, read_cortex
from morphofold.io.json_files import Count, Length, Record, read_json
from morphofold.progress import Progress, silent
from morphofold.provenance import strict_json

if TYPE_CHECKING:
    from morphofold.cohort.fleet import Fleet
    from morphofold.cohort.participant import Participant

FILE = "scales.json"
MOST = 50  # subjects that are looked at, spread evenly over their names
MUCH_COARSER = 2.0  # times the median, beyond which a mesh is too coarse to set the scale of all


class Scales(Record):
    """The lengths that all of a cohort are measured with [mm], and of how many hemispheres they are."""

    model_config = ConfigDict(frozen=True)

    curvature_scale_mm: Length
    gyral_width_mm: Length | None
    hemispheres: Count

    @property
    def words(self) -> str:
        width = "" if self.gyral_width_mm is None else f", gyral width of the net {self.gyral_width_mm:g} mm"
        return f"one curvature scale for all, {self.curvature_scale_mm:g} mm{width} ({FILE})"


def scales_of(out: Path, fleet: Fleet, subjects: Sequence[Participant], progress: Progress = silent) -> Scales | None:
    """The scales of a cohort: those that its first run has chosen, or now chosen and kept.

    The curvature scale is the coarsest of those that ``measure`` would take, which all meshes bear, but for meshes more
    than twice as coarse as the median; the gyral width is the median, which one odd subject does not set. Both are of
    50 subjects at most. None if none of them can be read.

    Raises
    ------
    ValueError
        If ``out/scales.json`` is not as it was written.
    """
    if (kept := kept_scales(out)) is not None:
        return kept
    from morphofold.cohort.fleet import Job, Lost

    chosen = [subjects[k] for k in np.unique(np.linspace(0, len(subjects) - 1, MOST).round().astype(int))]
    found: list[tuple[float, float]] = []
    for done, (job, looked) in enumerate(fleet.run(look, [Job(one.name, one) for one in chosen]), start=1):
        found += [] if isinstance(looked, Lost) else looked
        progress(done / len(chosen), f"scales of {job.name}")
    if not found:
        return None
    scale, width = np.array(sorted(found)).T
    known = width[np.isfinite(width)]
    scales = Scales(
        curvature_scale_mm=_digits(scale[scale <= MUCH_COARSER * np.median(scale)].max(), np.ceil),
        gyral_width_mm=_digits(np.median(known), np.round) if known.size else None,
        hemispheres=len(found),
    )
    with atomic_file(out / FILE) as file:
        file.write_text(strict_json(scales.model_dump()), encoding="utf-8")
    return scales


def look(subject: Participant) -> list[tuple[float, float]]:
    """Curvature scale and gyral width [mm] of the hemispheres of a subject that can be read; NaN without gyri."""
    from morphofold.analysis.graph.crest_net import CrestNetBuilder
    from morphofold.analysis.measuring import scale_of_curvature

    found = []
    try:
        hemis = subject.hemis or hemispheres(Path(subject.folder))
    except (*REFUSALS, OSError):  # measuring it says what is wrong with it
        return []
    for hemi in hemis:
        try:
            cortex = read_cortex(subject.folder, hemi)
            lengths = CrestNetBuilder(cortex).scales(None, None)
            found.append((scale_of_curvature(cortex)[0], lengths.width if lengths else float("nan")))
        except (*REFUSALS, OSError):
            continue
    return found


def with_scales(options: Mapping[str, Any], scales: Scales | None) -> dict[str, Any]:
    """Options of measuring, with the scales of the cohort where none were asked for."""
    options = dict(options)
    if scales is not None:
        if options.get("curvature_scale_mm") is None:
            options["common_curvature_scale_mm"] = scales.curvature_scale_mm
        if options.get("gyral_width_mm") is None:
            options["gyral_width_mm"] = scales.gyral_width_mm
    return options


def kept_scales(out: Path) -> Scales | None:
    """The scales of an earlier run, None if there was none; raises ``ValueError`` if they are damaged."""
    path = out / FILE
    if not os.path.lexists(path):
        return None
    return Scales(**read_json(path, Scales, "Remove it, and run again."))


def _digits(length: float, how: Callable[[Any], Any]) -> float:
    """A length in three digits, so that what is told is what is taken."""
    unit = 10.0 ** (np.floor(np.log10(length)) - 2)
    return float(f"{how(length / unit - 1e-9 * (how is np.ceil)) * unit:.6g}")
