"""Cost of a finished analysis, by stage, and the expected errors of its measures; memory that one will need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from morphofold.errors import NothingToDo
from morphofold.forecasts.afterwards import SecondsAndShares, largest, shares
from morphofold.forecasts.sizes import GiB
from morphofold.forecasts.table import Measured, costs, measured_errors
from morphofold.words import percent, span

if TYPE_CHECKING:
    from morphofold.analysis import Measures
    from morphofold.timing import Stages

READING_STAGE, WRITING_STAGE, PAGE_STAGE = "reading", "writing", "page"

#: stages of an analysis, and what they do
ANALYSIS_STAGES = {
    READING_STAGE: "surfaces, maps and labels",
    "areas": "areas, depth of sulci, gyrification; checks of the surfaces",
    "cortical thickness": "and the resampled mesh of draft or fine",
    "curvature": "of pial and white surface, folding indices",
    "gyral thickness": "width of gyri, wavelength",
    "gyral graph": "crests, hinges, their arms, wavelength of the spectrum",
    "local gyrification": "closing of the volume in voxels",
    "regions": "tables of regions, crests, hinges and arms",
    WRITING_STAGE: "digests of the input, surfaces, maps, tables",
    PAGE_STAGE: "pictures, charts, interactive surfaces; not putting them into one file",
}


@dataclass(frozen=True)
class AnalysisCost:
    """Cost of an analysis.

    Attributes
    ----------
    vertices : mapping
        Hemisphere to its number of vertices.
    accuracy : str
    threads : int
    seconds : float
        Wall time without compiling, of all stages.
    stages : mapping
        Name to seconds of all hemispheres and to their share of all, in the order of the work.
    memory_GiB : float or None
        Most that the process has held.
    errors : mapping
        Expected relative error by quantity.
    how : str
        How the errors were obtained.
    doubts : tuple of str
    """

    vertices: Mapping[str, int]
    accuracy: str
    threads: int
    seconds: float
    stages: SecondsAndShares
    memory_GiB: float | None
    errors: Mapping[str, Measured]
    how: str
    doubts: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        stages = {name: {"seconds": seconds, "share": share} for name, (seconds, share) in self.stages.items()}
        return {**asdict(self), "stages": stages}


def cost_of_analysis(measures: Sequence[Measures], clock: Stages) -> AnalysisCost:
    """Cost of an analysis from its clock; ends the stage that the clock is timing.

    Raises
    ------
    NothingToDo
        If there are no measures.
    """
    from numba import get_num_threads

    from morphofold.timing import peak_memory

    if not measures:
        raise NothingToDo("there are no measures, so there is no cost. Pass those of at least one hemisphere.")
    clock.end()
    seconds = sum(clock.seconds.values())
    accuracy = str(measures[0].parameters["accuracy"])
    return AnalysisCost(
        {m.cortex.hemi: m.cortex.n_vertices for m in measures},
        accuracy,
        get_num_threads(),
        seconds,
        shares(clock.seconds, seconds),
        peak_memory(),
        *measured_errors((m.cortex for m in measures), accuracy),
    )


def analysis_cost_line(cost: AnalysisCost, most: int = 3) -> str:
    """A line with the largest times and the largest expected error: the least one may be small by chance."""
    line = f"time: {span(cost.seconds)}, {largest(cost.stages, most)}; "
    if not cost.errors:
        return f"{line}errors: {cost.how}"
    worst = max(cost.errors, key=lambda name: cost.errors[name].error)
    error = percent(cost.errors[worst].error)
    return f"{line}expected errors up to {error} ({worst}), by one person's hemisphere and its mesh"


def memory_of_analysis(vertices: Sequence[int], *, accuracy: str = "standard", report: bool = True) -> float:
    """Most memory of a process that measures hemispheres of these numbers of vertices, one after the other [GiB]."""
    from morphofold.analysis.resampling import accuracy_of

    chosen, memory, total = accuracy_of(accuracy), costs()["analysis"], sum(vertices)
    largest_mesh = max(4 * n if n < chosen.least else n for n in vertices)
    most = (
        memory["kept_per_vertex"] * total + memory["per_vertex"] * largest_mesh + memory["per_voxel"] * chosen.voxels**3
    )
    measuring: float = memory["process"] + most / GiB
    page = memory["page"] + memory["page_per_hemisphere"] * len(vertices) + memory["page_per_vertex"] * total / GiB
    return max(measuring, page) if report else measuring
