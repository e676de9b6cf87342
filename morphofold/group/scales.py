"""One curvature scale and one net width for a cohort, chosen before the first measurement and then kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ConfigDict

from morphofold.group.tasks import INPUT_ERRORS
from morphofold.io.cortices import hemispheres, read_cortex
from morphofold.io.json_files import Count, Length, Record, read_json, write_json
from morphofold.progress import Progress, silent

if TYPE_CHECKING:
    from morphofold.group.fleet import Fleet
    from morphofold.group.participant import Participant

SCALES_FILE = "scales.json"
MOST_SUBJECTS_READ = 50  # most subjects used to choose the scales, spread evenly over their names
COARSEST_MESH_RATIO = 2.0  # meshes coarser than this many times the median do not set the common scale


class Scales(Record):
    """The lengths for measuring all of a cohort [mm], and the number of hemispheres that they are from."""

    model_config = ConfigDict(frozen=True)

    curvature_scale_mm: Length
    gyral_width_mm: Length | None
    hemispheres: Count

    @property
    def words(self) -> str:
        width = "" if self.gyral_width_mm is None else f", crown width {self.gyral_width_mm:g} mm"
        return f"one curvature scale for all, {self.curvature_scale_mm:g} mm{width} ({SCALES_FILE})"


def scales_of(out: Path, fleet: Fleet, subjects: Sequence[Participant], progress: Progress = silent) -> Scales | None:
    """The scales of a cohort: those chosen by its first run; if there are none, they are chosen now and kept.

    The curvature scale is the coarsest that ``measure`` would use for any mesh, except meshes more than twice as coarse
    as the median, so it suits all other meshes. The crown width is the median, so one unusual subject does not set it.
    Both are from 50 subjects at most. None if no subject can be read.

    Raises
    ------
    ValueError
        If ``out/scales.json`` is damaged.
    """
    if (kept := kept_scales(out)) is not None:
        return kept
    from morphofold.group.fleet import Job, Lost

    chosen = [subjects[k] for k in np.unique(np.linspace(0, len(subjects) - 1, MOST_SUBJECTS_READ).round().astype(int))]
    found: list[tuple[float, float]] = []
    for done, (job, looked) in enumerate(fleet.run(look, [Job(one.name, one) for one in chosen]), start=1):
        found += [] if isinstance(looked, Lost) else looked
        progress(done / len(chosen), f"scales of {job.name}")
    if not found:
        return None
    scale, width = np.array(sorted(found)).T
    known = width[np.isfinite(width)]
    scales = Scales(
        curvature_scale_mm=_rounded_to_three_digits(
            scale[scale <= COARSEST_MESH_RATIO * np.median(scale)].max(), np.ceil
        ),
        gyral_width_mm=_rounded_to_three_digits(np.median(known), np.round) if known.size else None,
        hemispheres=len(found),
    )
    write_json(out / SCALES_FILE, scales.model_dump())
    return scales


def look(subject: Participant) -> list[tuple[float, float]]:
    """Curvature scale and crown width [mm] of the hemispheres of a subject that can be read; NaN without gyri."""
    from morphofold.analysis.curvatures import scale_of_curvature
    from morphofold.analysis.graph.crest_net import CrestNetBuilder

    found = []
    try:
        hemis = subject.hemis or hemispheres(Path(subject.folder))
    except (*INPUT_ERRORS, OSError):  # measuring it reports the problem
        return []
    for hemi in hemis:
        try:
            cortex = read_cortex(subject.folder, hemi)
            lengths = CrestNetBuilder(cortex).scales(None, None)
            found.append((scale_of_curvature(cortex)[0], lengths.width if lengths else float("nan")))
        except (*INPUT_ERRORS, OSError):
            continue
    return found


def with_scales(options: Mapping[str, Any], scales: Scales | None) -> dict[str, Any]:
    """Options for measuring, with the scales of the cohort where no scale was requested."""
    options = dict(options)
    if scales is not None:
        if options.get("curvature_scale_mm") is None:
            options["common_curvature_scale_mm"] = scales.curvature_scale_mm
        if options.get("gyral_width_mm") is None:
            options["gyral_width_mm"] = scales.gyral_width_mm
    return options


def kept_scales(out: Path) -> Scales | None:
    """The scales of an earlier run, None if there was none; raises ``ValueError`` if they are damaged."""
    path = out / SCALES_FILE
    if not os.path.lexists(path):
        return None
    return Scales(**read_json(path, Scales, "Remove it, and run again."))


def _rounded_to_three_digits(length: float, how: Callable[[Any], Any]) -> float:
    """A length rounded to three digits, so that the printed value is the one used."""
    unit = 10.0 ** (np.floor(np.log10(length)) - 2)
    return float(f"{how(length / unit - 1e-9 * (how is np.ceil)) * unit:.6g}")
