"""Cost and errors of a run before it begins: ``forecast``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from morphofold.forecasts.calibration import BUSY_MACHINE_RATIO, Calibration, calibrate, slowness_of_stages
from morphofold.forecasts.sizes import Sizes, memory_GiB, sizes_by_rule
from morphofold.forecasts.steps import Steps, steps_of
from morphofold.forecasts.table import Expected, costs, doubts, expected_errors, larger, not_studied, table, unstudied
from morphofold.words import span

if TYPE_CHECKING:
    from pathlib import Path

    from morphofold.sim.scene import Scene

STAGES_PHASE = "stages"  # phases of a run that the solver's clock does not have: checks, maps and files of its stages,
SETTING_UP_PHASE = "set-up"  # and building its body
LEAST_TIME_RATIO = 0.1  # least time of the range, over the expected time


@dataclass(frozen=True)
class Forecast:
    """Forecast of a run.

    Attributes
    ----------
    scene, shape, setting : str
        Its name and shape, and its accuracy in words: ``"standard"``, or the levels between which its edge lies.
    edge_mm, edge_over_T : float or None
        Largest surface edge [mm], and over the thickness of the (thinnest) cortex; None in one dimension.
    elements_through_cortex : int or None
        None in one dimension, and for a mesh from a file.
    elements, nodes, steps, stages : int
    fewest_steps, most_steps : int
    seconds, fastest, slowest : float
        Wall time without compiling, and its plausible range [s].
    seconds_by_phase : mapping
        As in health.json, with ``"set-up"`` and ``"stages"``.
    memory_GiB : float
        Maximum of the whole process.
    threads : int
    errors : mapping
        Quantity to its ``Expected`` relative error; empty in one dimension, and for a scene that was not studied.
    not_studied : tuple of str
        Properties of the scene that were not studied (:func:`morphofold.forecasts.table.not_studied`).
    how : mapping
        How each of these was obtained, in words.
    doubts : tuple of str
        Why the forecast may be wrong, one sentence each.
    """

    scene: str
    shape: str
    setting: str
    edge_mm: float | None
    edge_over_T: float | None
    elements_through_cortex: int | None
    elements: int
    nodes: int
    steps: int
    fewest_steps: int
    most_steps: int
    stages: int
    seconds: float
    fastest: float
    slowest: float
    seconds_by_phase: Mapping[str, float]
    memory_GiB: float
    threads: int
    errors: Mapping[str, Expected]
    not_studied: tuple[str, ...]
    how: Mapping[str, str]
    doubts: tuple[str, ...]

    def __repr__(self) -> str:
        size = f"{self.elements:,} elements, {self.steps:,} steps"
        price = f"{span(self.seconds)}, {self.memory_GiB:.2g} GiB on {self.threads} threads"
        return f"Forecast({self.scene!r}, {self.setting}: {size}, {price})"

    @property
    def headline(self) -> tuple[str, Expected] | None:
        """The quantity of ``HEADLINE`` with the largest error, and that error."""
        return larger(self.errors) if self.errors else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "not_studied": list(self.not_studied), "doubts": list(self.doubts)}


def forecast(source: str | Path | Scene, threads: int | None = None, *, settings: Iterable[str] = ()) -> Forecast:
    """Forecast of a run: its size, time on this machine, memory and errors. Takes a few seconds, writes nothing.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in scene's name, a TOML file, or a scene.
    threads : int, optional
        Threads of the run; by default all cores.
    settings : iterable of str
        Changes of the scene, such as ``"growth.final=1.8"``.

    Returns
    -------
    Forecast

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene cannot be read, or its body cannot be built.
    """
    from morphofold.sim.scene.files import load_scene

    scene = load_scene(source, settings)
    if scene.geometry.shape == "radial":
        return _radial_forecast(scene, threads)
    return forecast_from(scene, calibrate(scene, costs(), threads))


def forecast_from(scene: Scene, found: Calibration) -> Forecast:
    """Forecast of ``scene`` from a timing of itself, or scaled from another accuracy or portion of it."""
    itself = scene == found.scene
    sizes = found.sizes if itself or found.layers is None else sizes_by_rule(scene, found.layers)
    steps = found.steps if itself else _scaled_steps(scene, sizes, found)
    phases = _seconds_by_phase(scene, sizes, steps, found)
    seconds = sum(phases.values())
    spread = costs()["spread"]["time"]
    T, layers = scene.thinnest, scene.elements_through_cortex
    total, outside = steps.expected, not_studied(scene, sizes.edge / T)
    fewest, most = round(steps.ramp + steps.fewest), round(steps.ramp + steps.most)
    less, more = ((total - fewest) / max(total, 1), (most - total) / max(total, 1))
    single, bricks = scene.accuracy.precision == "single", found.layers is not None
    memory = memory_GiB(sizes, bricks=bricks, single=single, volume=scene.output.volume)
    return Forecast(
        scene.name,
        scene.geometry.shape,
        _accuracy_words(scene, sizes.edge),
        sizes.edge,
        sizes.edge / T,
        None if scene.geometry.shape == "mesh" else layers,
        sizes.elements,
        sizes.nodes,
        total,
        fewest,
        most,
        len(scene.stages),
        seconds,
        seconds * max(LEAST_TIME_RATIO, 1 - math.hypot(spread, less, 1 - found.fastest)),
        seconds * (1 + math.hypot(spread, more, found.slowest - 1)),
        phases,
        memory,
        found.threads,
        {} if outside else expected_errors(sizes.edge / T),
        outside,
        _sources_of_forecast(scene, found, itself, outside),
        tuple(_forecast_doubts(scene, sizes, found)),
    )


def _scaled_steps(scene: Scene, sizes: Sizes, found: Calibration) -> Steps:
    """Steps with other edges: the number in which a wave crosses a cell depends on the cell's diagonal."""
    mine, timed = (_steps_across_cortex(s, edge) for s, edge in ((scene, sizes.edge), (found.scene, found.sizes.edge)))
    ratio = mine / timed
    return steps_of(scene, found.steps_per_unit * ratio, found.crossing * ratio, costs())


def _steps_across_cortex(scene: Scene, edge: float) -> float:
    """Steps in which a wave crosses the cortex, up to a factor, with surface edges of length ``edge`` [mm]."""
    import numpy as np

    known, T = costs()["crossing"], scene.geometry.cortex_thickness
    layers = scene.elements_through_cortex
    mass = np.interp(edge * layers / T, known["flatness"], known["mass"])
    mass /= np.interp(2 * edge / T / (layers + 1), known["coarseness"], known["lightness"])
    return math.sqrt(mass * (known["through"] * layers**2 + (T / edge) ** 2))


def _seconds_by_phase(scene: Scene, sizes: Sizes, steps: Steps, found: Calibration) -> dict[str, float]:
    """Seconds of the run by phase: time of a step times steps, active contact, and work outside of steps."""
    more = sizes.elements / found.sizes.elements
    phases = {name: more * each * steps.expected for name, each in found.phases.items()}
    if "grow" in phases:
        phases["grow"] *= steps.growing / max(steps.expected, 1)
    if "contact" in phases:
        phases["contact"] += float(steps.awake) * sum(phases.values())
    stage = costs()["stage"]
    surface = stage["checks"] + stage["folded"] * stage["per_vertex"] * sizes.vertices
    written = stage["write_per_vertex"] * sizes.vertices
    written += stage["write_per_element"] * sizes.elements if scene.output.volume else 0.0
    phases[STAGES_PHASE] = len(scene.stages) * found.slowness * (surface + written)
    phases[SETTING_UP_PHASE] = found.setting_up * more + found.slowness * stage["starting"]
    return phases


def _forecast_doubts(scene: Scene, sizes: Sizes, found: Calibration) -> list[str]:
    sentences = doubts(scene, sizes.edge / scene.thinnest)
    if scene.real_time:
        sentences.append(
            "With real masses the step shrinks as elements are squeezed; by how much was seen in one run only."
        )
    if scene.output.stability:
        sentences.append("Counting the unstable modes of the stages takes further time and memory (output.stability).")
    if found.slowest > BUSY_MACHINE_RATIO * found.fastest:
        sentences.append(
            f"Some steps just took up to {found.slowest / found.fastest:.1f} times as long as others: this machine has "
            "other work to do."
        )
    return sentences


def _sources_of_forecast(scene: Scene, found: Calibration, itself: bool, outside: tuple[str, ...]) -> dict[str, str]:
    built = "the body was built and counted"
    if not itself:
        part = getattr(found.scene.geometry, "portion", "")
        part = f"{part} " if part != getattr(scene.geometry, "portion", "") else ""
        built = f"counted by rule; a {part}body of {found.sizes.elements:,} elements was built and timed"
    errors = f"a table of errors against edges: {table()['errors']['subject']}"
    threads = "one thread" if found.threads == 1 else f"{found.threads} threads"
    return {
        "elements": built,
        "steps": "the pace of growth, and how long runs with such growth and stiffness waited for equilibrium",
        "time": f"steps timed here with {threads}, and the checks and maps of a sphere",
        "memory": "bytes per element and vertex, measured in other runs",
        "errors": unstudied(outside) if outside else errors,
    }


def _accuracy_words(scene: Scene, edge: float) -> str:
    """The accuracy of a scene in words: its level, or the levels between which its edge [mm] lies, coarser first."""
    from morphofold.sim.scene import LEVELS

    if scene.geometry.shape == "mesh":
        return "the mesh of the file"
    if scene.accuracy.edge is None:
        return scene.accuracy.level
    coarser = [name for name, of in LEVELS.items() if of >= edge / scene.thinnest]
    finer = [name for name, of in LEVELS.items() if of <= edge / scene.thinnest]
    if not coarser:
        return f"coarser than {finer[0]}"
    if not finer:
        return f"finer than {coarser[-1]}"
    return f"between {coarser[-1]} and {finer[0]}" if coarser[-1] != finer[0] else finer[0]


def _radial_forecast(scene: Scene, threads: int | None) -> Forecast:
    """Forecast of a run in one dimension: its final stage is solved, in milliseconds."""
    from morphofold.progress import silent
    from morphofold.sim.radial_run import ICOSPHERE_LEVEL, RadialRun
    from morphofold.threads import using_threads
    from morphofold.timing import working_seconds

    nowhere: Any = None
    with using_threads(threads) as threads:
        run = RadialRun(scene, nowhere, silent, lambda: False)
        run.equilibrium(scene.growth.final)
        started = working_seconds()
        run.numbers(run.equilibrium(scene.growth.final), scene.growth.final)
        solving = len(scene.stages) * (working_seconds() - started)
        slowness = slowness_of_stages(costs())
    vertices = 10 * 4**ICOSPHERE_LEVEL + 2
    stage = costs()["stage"]
    writing = slowness * len(scene.stages) * (stage["per_vertex"] + stage["write_per_vertex"]) * vertices
    seconds = solving + writing
    return Forecast(
        scene.name,
        "radial",
        "one dimension",
        None,
        None,
        None,
        0,
        0,
        0,
        0,
        0,
        len(scene.stages),
        seconds,
        0.5 * seconds,
        2 * seconds,
        {"radial": solving, STAGES_PHASE: writing, SETTING_UP_PHASE: 0.0},
        memory_GiB(Sizes(0, 0, vertices, 0.0), bricks=True, single=False, volume=False),
        threads,
        {},
        (),
        {
            "time": "the final stage was solved",
            "memory": "measured in other runs",
            "errors": "equilibria to about a part in 1e8; there is no mesh",
        },
        (),
    )
