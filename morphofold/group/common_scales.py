"""How a group is measured: by one curvature scale and one net width, chosen before the first measurement."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict

from morphofold.analysis import Measures, measuring
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.graph.crest_net import CrestNetBuilder
from morphofold.group.tasks import INPUT_ERRORS
from morphofold.group.workers import Lost, Workers
from morphofold.io.cortices import hemispheres, read_cortex
from morphofold.io.json_files import Count, Length, Record, read_json, write_json
from morphofold.progress import Progress, silent
from morphofold.provenance import Row
from morphofold.surface import Cortex
from morphofold.timing import Stages
from morphofold.words import rounded_up

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
        width = "" if self.gyral_width_mm is None else f", crown width {self.gyral_width_mm:g} mm"
        return f"one curvature scale for all, {self.curvature_scale_mm:g} mm{width} ({SCALES_FILE})"

    def fill(self, options: Options) -> Row:
        """Options for measuring, with these scales where no scale was requested."""
        filled = dict(options)
        if filled["curvature_scale_mm"] is None:
            filled["common_curvature_scale_mm"] = self.curvature_scale_mm
        if filled["gyral_width_mm"] is None:
            filled["gyral_width_mm"] = self.gyral_width_mm
        return filled


def earlier_scales(out: Path) -> Scales | None:
    """The scales of an earlier run, None if there was none; raises ``ValueError`` if they are damaged."""
    path = out / SCALES_FILE
    return Scales(**read_json(path, Scales, "Remove it, and run again.")) if path.exists() else None


def scales_of(out: Path, workers: Workers, subjects: Sequence[Any], progress: Progress = silent) -> Scales | None:
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
    spread = np.unique(np.linspace(0, len(subjects) - 1, MOST_SUBJECTS_READ).round().astype(int))
    lengths: list[tuple[float, float]] = []
    for done, (subject, read) in enumerate(workers.run(read_scales, [subjects[k] for k in spread]), start=1):
        lengths += [] if isinstance(read, Lost) else read
        progress(done / len(spread), f"scales of {subject.name}")
    if not lengths:
        return None
    scale, width = np.array(sorted(lengths)).T
    coarsest = scale[scale <= COARSEST_MESH_RATIO * np.median(scale)].max()
    scales = Scales(  # of three digits, so that the printed values are those used
        curvature_scale_mm=float(f"{rounded_up(coarsest, 3):.6g}"),
        gyral_width_mm=float(f"{np.nanmedian(width):.3g}") if np.isfinite(width).any() else None,
        hemispheres=len(lengths),
    )
    write_json(out / SCALES_FILE, scales.model_dump())
    return scales


def read_scales(subject: Any) -> list[tuple[float, float]]:
    """Curvature scale and crown width [mm] of the readable hemispheres of a ``Participant``; NaN without gyri."""
    lengths = []
    with suppress(*INPUT_ERRORS, OSError):  # measuring it reports the problem
        for hemi in subject.hemis or hemispheres(Path(subject.folder)):
            with suppress(*INPUT_ERRORS, OSError):
                cortex = read_cortex(subject.folder, hemi)
                net = CrestNetBuilder(cortex).scales(None, None)
                lengths.append((scale_of_curvature(cortex)[0], net.width if net else float("nan")))
    return lengths


def measure_as_asked(cortex: Cortex, options: Options, clock: Stages, say: Callable[[str], None]) -> Measures:
    """Measure with ``curvature_scale_mm``, ``gyral_width_mm``, ``thickness_cap_mm`` [mm], ``accuracy`` and ``repair``,
    if ``options`` have them; ``common_curvature_scale_mm`` is used if the mesh is fine and large enough for it."""
    keywords = keywords_of(options)
    if (common := options.get("common_curvature_scale_mm")) is not None:
        keywords["curvature_scale"] = curvature_scale(cortex, common)
    return measuring.measure(
        cortex, **keywords, progress=lambda share, stage: say(stage) if share < 1 else None, clock=clock
    )


def keywords_of(options: Options) -> Row:
    """Recorded options as keywords of :func:`morphofold.analysis.measure`."""
    return {key.removesuffix("_mm"): value for key, value in options.items() if key in MEASURE_OPTIONS}


def curvature_scale(cortex: Cortex, common: float) -> float | None:
    """The common curvature scale [mm], or None (the mesh's own scale) if the mesh is too coarse or too small for it."""
    with suppress(ValueError):
        if scale_of_curvature(cortex)[0] <= common:
            return scale_of_curvature(cortex, common)[0]
    return None
