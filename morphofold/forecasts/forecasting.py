"""What a run will cost and how wrong it will be, before it begins: ``forecast``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from morphofold.forecasts.calibration import Calibration, calibrate
from morphofold.forecasts.expected import SETTING_UP, STAGES, Forecast
from morphofold.forecasts.memory import memory_GiB
from morphofold.forecasts.sizes import Sizes, sizes_by_rule
from morphofold.forecasts.steps import Steps, steps_of
from morphofold.forecasts.table import costs, doubts, expected_errors, not_studied, table
from morphofold.forecasts.text import setting_words, unstudied

if TYPE_CHECKING:
    from pathlib import Path

    from morphofold.sim.scene import Scene

LEAST = 0.1             # of its range of times, over the expected one
UNEVEN = 1.5            # slower over fastest block of steps, beyond which a machine is called busy


def forecast(source: str | Path | Scene, threads: int | None = None, *, settings: Iterable[str] = ()) -> Forecast:
    """Forecast of a run: its size, time on this machine, memory and errors. Takes a few seconds, writes nothing.

    Parameters
    ----------
    source : str, Path or Scene
        A built-in scene's name, a TOML file, or a scene.
    threads : int, optional
        Threads that the run will have; by default all cores.
    settings : iterable of str
        ``"growth.final=1.8"`` and the like, put over the scene.

    Returns
    -------
    Forecast

    Raises
    ------
    ValueError, FileNotFoundError
        If the scene cannot be had, or its body not be built.
    """
    from morphofold.sim.scene.files import load_scene

    scene = load_scene(source, settings)
    if scene.geometry.shape == "radial":
        from morphofold.forecasts.radial import radial_forecast

        return radial_forecast(scene, threads)
    return forecast_from(scene, calibrate(scene, costs(), threads))


def forecast_from(scene: Scene, found: Calibration) -> Forecast:
    """Forecast of ``scene`` from what was timed: of itself, or scaled from another accuracy or portion of it."""
    itself = scene == found.scene
    sizes = found.sizes if itself or found.layers is None else sizes_by_rule(scene, found.layers)
    steps = found.steps if itself else _scaled_steps(scene, sizes, found)
    phases = _phases(scene, sizes, steps, found)
    seconds = sum(phases.values())
    spread = costs()["spread"]["time"]
    T, layers = scene.thinnest, scene.elements_through_cortex
    total, outside = steps.expected, not_studied(scene, sizes.edge / T)
    fewest, most = round(steps.ramp + steps.fewest), round(steps.ramp + steps.most)
    less, more = ((total - fewest) / max(total, 1), (most - total) / max(total, 1))
    return Forecast(
        scene.name, scene.geometry.shape, setting_words(scene, sizes.edge), sizes.edge, sizes.edge / T,
        None if scene.geometry.shape == "mesh" else layers, sizes.elements, sizes.nodes, total, fewest, most,
        len(scene.stages), seconds,
        seconds * max(LEAST, 1 - math.hypot(spread, less, 1 - found.fastest)),
        seconds * (1 + math.hypot(spread, more, found.slowest - 1)),
        phases, _memory(scene, sizes, found), found.threads,
        {} if outside else expected_errors(sizes.edge / T), outside, _how(scene, found, itself, outside),
        tuple(_doubts(scene, sizes, found)),
    )  # fmt: skip


def _scaled_steps(scene: Scene, sizes: Sizes, found: Calibration) -> Steps:
    """Steps on other edges: a wave takes as many to cross a cell as its diagonal asks for."""
    mine, timed = (_steps_across(s, edge) for s, edge in ((scene, sizes.edge), (found.scene, found.sizes.edge)))
    ratio = mine / timed
    return steps_of(scene, found.steps_per_unit * ratio, found.crossing * ratio, costs())


def _memory(scene: Scene, sizes: Sizes, found: Calibration) -> float:
    single = scene.accuracy.precision == "single"
    return memory_GiB(sizes, bricks=found.layers is not None, single=single, volume=scene.output.volume)


def _steps_across(scene: Scene, edge: float) -> float:
    """Steps in which a wave crosses the cortex, but for a factor, with surface edges so long [mm]."""
    through = costs()["crossing"]["through"] * scene.elements_through_cortex**2
    return math.sqrt(through + (scene.geometry.cortex_thickness / edge) ** 2)


def _phases(scene: Scene, sizes: Sizes, steps: Steps, found: Calibration) -> dict[str, float]:
    """Seconds of the run by phase: those of a step times steps, contact awake, and what is not steps."""
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
    phases[STAGES] = len(scene.stages) * found.slowness * (surface + written)
    phases[SETTING_UP] = found.setting_up * more + found.slowness * stage["starting"]
    return phases


def _doubts(scene: Scene, sizes: Sizes, found: Calibration) -> list[str]:
    said = doubts(scene, sizes.edge / scene.thinnest)
    if scene.real_time:
        said.append("The step of real masses shrinks as elements are squeezed, by how much was seen in one run only.")
    if scene.output.stability:
        said.append("Counting the unstable modes of the stages comes on top, in time and memory (output.stability).")
    if found.slowest > UNEVEN * found.fastest:
        said.append(
            f"Steps took up to {found.slowest / found.fastest:.1f} times as long as others just now: this machine has "
            "other work to do."
        )
    return said


def _how(scene: Scene, found: Calibration, itself: bool, outside: tuple[str, ...]) -> dict[str, str]:
    built = "the body was built and counted"
    if not itself:
        part = getattr(found.scene.geometry, "portion", "")
        part = f"{part} " if part != getattr(scene.geometry, "portion", "") else ""
        built = f"counted by rule; a {part}body of {found.sizes.elements:,} elements was built to be timed"
    errors = f"a table of errors against edges: {table()['errors']['subject']}"
    threads = "one thread" if found.threads == 1 else f"{found.threads} threads"
    return {
        "elements": built,
        "steps": "the pace of growth, and what runs with such growth and stiffness waited for balance",
        "time": f"steps timed here by {threads}, and the checks and maps of a sphere",
        "memory": "bytes per element and vertex, measured in other runs",
        "errors": unstudied(outside) if outside else errors,
    }  # fmt: skip
