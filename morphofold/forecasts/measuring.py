"""Cost and errors of measuring a cortex before it begins: ``forecast_analysis``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from morphofold.errors import NothingToDo
from morphofold.forecasts.analysis_cost import PAGE_STAGE, READING_STAGE, WRITING_STAGE
from morphofold.forecasts.calibration import BUSY_MACHINE_RATIO
from morphofold.forecasts.sizes import GiB
from morphofold.forecasts.table import Measured, costs, measured_errors
from morphofold.threads import together
from morphofold.words import span

if TYPE_CHECKING:
    from morphofold.analysis.resampling import Preset
    from morphofold.surface import Cortex

TIMED_REPEATS = 3  # of the measuring that is timed, after one to load kernels
STAGES_ON_RESAMPLED = (
    "cortical thickness",
    "gyral thickness",
    "gyral graph",
)  # stages that draft and fine do on a resampled mesh
VOXEL_STAGE = "local gyrification"  # and the stage whose voxels they change
CURVATURE_TIME_POWER = (
    1.1  # time of curvature as a power of its scale: 0.7 to 1.3 on fsaverage5 and a person, 2 to 20 mm
)


@dataclass(frozen=True)
class Hemisphere:
    """A hemisphere to be measured: vertices of white and pial each, vertices of the mesh on which thicknesses and gyral
    graph are measured, and the expected seconds of its measures."""

    hemi: str
    vertices: int
    measured_on: int
    seconds: float


@dataclass(frozen=True)
class AnalysisForecast:
    """Forecast of an analysis.

    Attributes
    ----------
    name, accuracy : str
    hemispheres : tuple of Hemisphere
    seconds, fastest, slowest : float
        Wall time without compiling, and its plausible range [s].
    seconds_by_stage : mapping
        As in cost.json.
    memory_GiB : float
        Maximum of the whole process.
    threads : int
    errors : mapping
        Quantity to its ``Measured`` relative error.
    how : mapping
        How each of these was obtained, in words.
    doubts : tuple of str
        Why the forecast may be wrong, one sentence each.
    """

    name: str
    accuracy: str
    hemispheres: tuple[Hemisphere, ...]
    seconds: float
    fastest: float
    slowest: float
    seconds_by_stage: Mapping[str, float]
    memory_GiB: float
    threads: int
    errors: Mapping[str, Measured]
    how: Mapping[str, str]
    doubts: tuple[str, ...]

    def __repr__(self) -> str:
        price = f"{span(self.seconds)}, {self.memory_GiB:.2g} GiB on {self.threads} threads"
        return f"AnalysisForecast({self.name!r}, {self.accuracy}: {len(self.hemispheres)} hemispheres, {price})"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)


def forecast_analysis(
    cortices: Sequence[Cortex],
    *,
    accuracy: str = "standard",
    report: bool = True,
    threads: int | None = None,
    reading: float = 0.0,
    curvature_scale: float | None = None,
    repair: bool = True,
    stages: int = 0,
) -> AnalysisForecast:
    """Forecast of an analysis: its time on this machine, memory and errors. Takes a few seconds, writes nothing.

    Parameters
    ----------
    cortices : sequence of Cortex
        The hemispheres to be measured.
    accuracy : {"draft", "standard", "fine"}
    report : bool
        Whether the page will be made.
    threads : int, optional
        Threads of the analysis; by default all cores.
    reading : float
        Seconds that reading the surfaces took.
    curvature_scale : float, optional
        As for :func:`morphofold.analysis.measure` [mm].
    repair : bool
        As for :func:`morphofold.analysis.measure`.
    stages : int
        Number of stages of a simulation that the page will draw; their time is not counted, which ``doubts`` says.

    Raises
    ------
    ValueError
        If there is no cortex, the accuracy is unknown, the number of threads is invalid, or a cortex can't be measured:
        for all reasons for which the measuring would refuse it, except a surface without volume.
    """
    from morphofold.analysis.resampling import accuracy_of
    from morphofold.mesh_quality.repair import measurable

    if not cortices:
        raise NothingToDo("there is no cortex to forecast. Pass at least one.")
    chosen = accuracy_of(accuracy)
    cortices = [measurable(cortex, repair=repair).cortex for cortex in cortices]
    wider = [_curvature_time_ratio(cortex, curvature_scale) for cortex in cortices]
    timed, uneven, threads = _time_small_ball(threads)
    sizes = [(cortex.n_vertices, _resampled_vertices(cortex, chosen)) for cortex in cortices]
    each = [_seconds_of_measuring(n, on, chosen, timed, times) for (n, on), times in zip(sizes, wider)]
    taken = {READING_STAGE: reading} | {name: sum(one[name] for one in each) for name in each[0]}
    for name, beside in costs()["analysis"]["starting"].items():
        taken[name] += _machine_slowness(timed) * beside
    taken |= _seconds_of_writing([n for n, _ in sizes], report, timed)
    seconds, spread = sum(taken.values()), math.hypot(costs()["analysis"]["spread"], uneven - 1)
    expected = measured_errors(cortices, accuracy)
    doubts = list(expected.doubts)
    if report and stages:
        doubts.append(f"The page also reads and draws stages of the simulation ({stages}), which takes further time.")
    if uneven > BUSY_MACHINE_RATIO:
        doubts.append(f"A repeat just took {uneven:.1f} times as long as another: this machine has other work to do.")
    return AnalysisForecast(
        cortices[0].name,
        accuracy,
        tuple(Hemisphere(c.hemi, n, on, sum(one.values())) for c, (n, on), one in zip(cortices, sizes, each)),
        seconds,
        seconds / (1 + spread),
        seconds * (1 + spread),
        taken,
        _peak_memory_GiB(sizes, chosen, report, together(len(sizes), threads)),
        threads,
        expected.errors,
        {
            "time": f"measures of a made-up cortex of {costs()['analysis']['ball']:,} vertices timed here, scaled by "
            "power laws of vertices, one for each stage",
            "memory": "bytes per vertex, measured in other analyses",
            "errors": expected.how,
        },
        tuple(doubts),
    )


def _time_small_ball(threads: int | None) -> tuple[dict[str, float], float, int]:
    """Seconds by stage of measuring a small folded ball as a draft, slowest over fastest repeat, and the threads."""
    from morphofold.analysis.measuring import measure
    from morphofold.shapes.folded_ball import folded_ball
    from morphofold.threads import using_threads
    from morphofold.timing import Stages

    ball, taken = folded_ball(costs()["analysis"]["ball"]), []
    with using_threads(threads) as threads:
        for _ in range(1 + TIMED_REPEATS):
            clock = Stages()
            measure(ball, accuracy="draft", clock=clock)
            taken.append(clock.seconds)
    taken = taken[1:]
    totals = [sum(one.values()) for one in taken]
    return {name: min(one[name] for one in taken) for name in taken[0]}, max(totals) / min(totals), threads


def _resampled_vertices(cortex: Cortex, chosen: Preset) -> int:
    """Vertices of the mesh on which thicknesses and gyral graph are measured, see ``resampling.resampled``."""
    import numpy as np

    from morphofold import geometry

    used, n = len(np.unique(cortex.faces)), cortex.n_vertices
    if chosen.most and used > chosen.most:
        return chosen.most
    return n + len(geometry.edges(cortex.faces)) if used < chosen.least else n


def _curvature_time_ratio(cortex: Cortex, wanted: float | None) -> float:
    """Time of curvature at the wanted scale over that at the usual one; raises if the scale does not fit."""
    from morphofold.analysis.scales import scale_of_curvature

    scale, usual = (scale_of_curvature(cortex, one)[0] for one in (wanted, None))
    return (scale / usual) ** CURVATURE_TIME_POWER


def _seconds_of_measuring(
    n: int, on: int, chosen: Preset, timed: Mapping[str, float], wider: float = 1.0
) -> dict[str, float]:
    """Seconds by stage of measuring a hemisphere of ``n`` vertices, some stages on a resampled mesh of ``on``;
    ``wider`` is the factor of the time of curvature that follows from its scale."""
    laws = costs()["analysis"]
    found = {}
    for name, seconds in timed.items():
        if name == VOXEL_STAGE:
            found[name] = seconds * (laws["per_voxel"] * chosen.voxels**3 + laws["per_vertex"] * n)
        else:
            law = laws["stages"][name]
            size = on if name in STAGES_ON_RESAMPLED else n
            found[name] = seconds * law["times"] * (size / laws["ball"]) ** law["power"]
    found["curvature"] *= wider
    if on < n:
        found["cortical thickness"] += _machine_slowness(timed) * laws["thin_per_vertex"] * n
    return found


def _seconds_of_writing(sizes: Sequence[int], report: bool, timed: Mapping[str, float]) -> dict[str, float]:
    laws, slowness = costs()["analysis"], _machine_slowness(timed)
    found = {WRITING_STAGE: slowness * (laws["write"] + laws["write_per_vertex"] * sum(sizes))}
    if report:
        drawn = laws["page"] + laws["page_second"] * (len(sizes) - 1) + laws["page_per_vertex"] * sum(sizes)
        found[PAGE_STAGE] = slowness * drawn
    return found


def _machine_slowness(timed: Mapping[str, float]) -> float:
    """Time of the tables of the ball, which always use one thread, over that in the stored table."""
    return timed["regions"] / costs()["analysis"]["regions_of_ball"]


def memory_of_analysis(vertices: Sequence[int], *, accuracy: str = "standard", report: bool = True) -> float:
    """Most memory of a process that measures hemispheres of these numbers of vertices, one after the other [GiB]."""
    from morphofold.analysis.resampling import accuracy_of

    chosen = accuracy_of(accuracy)
    return _peak_memory_GiB([(n, 4 * n if n < chosen.least else n) for n in vertices], chosen, report)


def _peak_memory_GiB(sizes: Sequence[tuple[int, int]], chosen: Preset, report: bool, beside: bool = False) -> float:
    """Most memory [GiB] of a process that does only the analysis, of hemispheres after or ``beside`` each other."""
    memory, total = costs()["analysis"]["memory"], sum(n for n, _ in sizes)
    hard = [memory["per_vertex"] * max(size) + memory["per_voxel"] * chosen.voxels**3 for size in sizes]
    most = memory["kept_per_vertex"] * total + (sum(hard) if beside else max(hard))
    measuring: float = memory["process"] + most / GiB
    page = memory["page"] + memory["page_per_hemisphere"] * len(sizes) + memory["page_per_vertex"] * total / GiB
    return max(measuring, page) if report else measuring
