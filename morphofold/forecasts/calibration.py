"""Steps of a run: their number, and their time on this machine, from which forecasts are scaled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numba import set_num_threads

from morphofold.forecasts.sizes import Layers, Sizes, layers_of, sizes_of
from morphofold.forecasts.table import costs
from morphofold.shapes import icosphere
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics, limited_pace, next_growth, patience, soft_start
from morphofold.sim.effects import build_effects
from morphofold.sim.effects import ramp as ramps
from morphofold.sim.equilibrium.wrinkles import first_wrinkles, slow_growth
from morphofold.sim.health import check_surface
from morphofold.sim.scene import Scene
from morphofold.sim.scene.files import load_scene
from morphofold.simulation import freesurfer_maps
from morphofold.surface import Cortex, Surface
from morphofold.threads import using_threads
from morphofold.timing import working_seconds

#: most bricks (as a scene counts them) of a body that is built and timed; larger bodies are scaled
MOST_TIMED_BRICKS = 330_000
TIMING_SECONDS = 0.8  # time for which steps are taken
LEAST_AND_MOST_BLOCKS = 3, 60  # of steps, at least and at most
GROWTH_PER_BLOCK = 1e-6  # growth in each block
BUSY_MACHINE_RATIO = 1.5  # slower over fastest block: beyond it a machine is called busy
PORTIONS = ("full", "half", "quarter", "octant")


class Calibration(NamedTuple):
    """Result of the timing.

    Attributes
    ----------
    scene : Scene
        The scene that was built: the scene itself, a smaller part of it, or a coarser one.
    sizes : Sizes
    layers : Layers or None
        None for tetrahedra.
    crossing, steps_per_unit : float
        Steps in which a wave crosses the cortex, and steps in which growth rises by 1 at full pace; both over
        :func:`relative_crossing`.
    phases : mapping
        Seconds per step by phase.
    fastest, slowest : float
        Time of the fastest block of steps, and of the slower quarter, over the time in ``phases``.
    setting_up : float
        Seconds to build the body.
    slowness : float
        Time of the checks and maps of a sphere, over the time on the machine of the table.
    threads : int
    """

    scene: Scene
    sizes: Sizes
    layers: Layers | None
    crossing: float
    steps_per_unit: float
    phases: Mapping[str, float]
    fastest: float
    slowest: float
    setting_up: float
    slowness: float
    threads: int


def calibrate(scene: Scene, threads: int | None = None) -> Calibration:
    """Build the scene's body, or a smaller one like it, and time a few steps and a stage.

    Raises
    ------
    ValueError
        If the body cannot be built, or the number of threads is invalid.
    """
    with using_threads(threads):
        small = reduced(scene)
        started = working_seconds()
        effects = build_effects(small)
        body = build_body(small, effects)
        run = Dynamics.of(small, body, effects)
        used = run.threads
        setting_up = working_seconds() - started
        phases, fastest, slowest = _time_steps(run)
        slowness = slowness_of_stages()
    bilayer = body.bilayer
    layers, sizes = layers_of(bilayer) if bilayer.faces.shape[1] == 4 else None, sizes_of(bilayer)
    relative = relative_crossing(small, sizes.edge)
    return Calibration(
        small,
        sizes,
        layers,
        body.crossing / relative,
        1 / run.rate / relative,
        phases,
        fastest,
        slowest,
        setting_up,
        slowness,
        used,
    )


def reduced(scene: Scene) -> Scene:
    """The scene, or a smaller part of its body, or else a coarser scene, with at most ``MOST_TIMED_BRICKS`` bricks."""
    while scene.bricks > MOST_TIMED_BRICKS:
        portion = getattr(scene.geometry, "portion", None)
        if portion in PORTIONS[:-1]:
            change = f"geometry.portion={PORTIONS[PORTIONS.index(portion) + 1]}"
        else:
            change = f"accuracy.edge={1.1 * scene.edge:.6g}"
        scene = load_scene(scene, [change])
    return scene


def _time_steps(run: Dynamics) -> tuple[dict[str, float], float, float]:
    """Seconds per step by phase, and the times of the fastest block of steps and of the slower quarter over them.

    Seconds are those of the block than which a third are faster, because other work of the machine in that second will
    not last for the whole run.
    """

    def block() -> dict[str, float]:
        run.seconds.clear()
        run.grow_to(run.state.growth + GROWTH_PER_BLOCK)
        return {name: seconds / STEPS_PER_MEASUREMENT for name, seconds in run.seconds.items()}

    block()  # loads kernels, fills caches
    started = working_seconds()
    taken: list[dict[str, float]] = []
    least, most = LEAST_AND_MOST_BLOCKS
    while len(taken) < least or (working_seconds() - started < TIMING_SECONDS and len(taken) < most):
        taken.append(block())
    taken.sort(key=lambda phases: sum(phases.values()))
    totals = [sum(phases.values()) for phases in taken]
    typical = len(taken) // 3
    slower = totals[3 * len(taken) // 4]
    return taken[typical], totals[0] / totals[typical], slower / totals[typical]


def slowness_of_stages() -> float:
    """Time of the checks and maps of a small cortex here, over the time on the machine of the table.

    One thread is used: if the machine has other work, two threads wait for each other, and times vary.
    """
    verts, faces = icosphere(4)
    white, pial = (Surface(r * verts, faces, name=f"lh.{name}") for r, name in ((46, "white"), (50, "pial")))
    cortex = Cortex(white, pial, name="calibration", origin="simulation")
    set_num_threads(1)
    taken = []
    for _ in range(3):
        started = working_seconds()
        check_surface(pial)
        freesurfer_maps(cortex)
        taken.append(working_seconds() - started)
    return float(min(taken) / costs()["stage"]["sphere"])


def relative_crossing(scene: Scene, edge: float) -> float:
    """Steps in which a wave crosses the cortex, up to a factor, with surface edges of length ``edge`` [mm]."""
    law, T, layers = costs()["crossing"], scene.geometry.cortex_thickness, scene.elements_through_cortex
    mass = np.interp(edge * layers / T, law["flatness"], law["mass"])
    mass /= np.interp(2 * edge / T / (layers + 1), law["coarseness"], law["lightness"])
    return math.sqrt(mass * (law["through"] * layers**2 + (T / edge) ** 2))


class Steps(NamedTuple):
    """Steps of a run.

    Attributes
    ----------
    ramp : int
        Steps while the cortex grows as fast as its pace allows.
    resting, waiting : float
        Further steps: growth stops at a stage until the body is at rest, and waits for balance while folds form.
    fewest, most : float
        Fewest and most steps of both together that runs took.
    touching : float
        Time that active contact adds to a step, as a share of the step, mean over all steps.
    """

    ramp: int
    resting: float
    waiting: float
    fewest: float
    most: float
    touching: float

    @property
    def expected(self) -> int:
        """All steps."""
        return round(self.ramp + self.resting + self.waiting)


def steps_of(scene: Scene, crossing: float, per_unit: float) -> Steps:
    """Steps that a scene takes. Of its effects, a ramp and inertia change the pace, and contact adds time to steps.

    Parameters
    ----------
    scene : Scene
    crossing : float
        Steps in which a wave crosses the cortex: one tick of the clock that sets the pace.
    per_unit : float
        Steps for growth to rise by 1 at full pace.
    """
    waiting, resting, contact = costs()["waiting"], costs()["resting"], costs()["contact"]
    per_growth = contact["per_growth"] if "contact" in scene.effects else 0.0
    touching = lambda growth: max(0.0, growth - contact["from"]) * per_growth
    growths = _growths_of_ramp(scene, per_unit)
    ramp = STEPS_PER_MEASUREMENT * sum(map(len, growths))
    touched = STEPS_PER_MEASUREMENT * sum(touching(growth) for stage in growths for growth in stage)
    if scene.real_time:  # real masses: the step shrinks as bricks do
        more, rests = ramp * costs()["inertia"]["per_growth"] * (scene.growth.final - 1), [0.0]
    else:
        wrinkled = first_wrinkles(scene).growth
        ticks = [STEPS_PER_MEASUREMENT * len(stage) / crossing for stage in growths]  # up to each stage
        longest = [patience(), *map(patience, ticks[1:])]
        rests = [
            crossing * (resting["smooth"] if stage <= wrinkled else min(max(most, resting["brief"]), resting["folded"]))
            for most, stage in zip(longest, scene.stages)
        ]
        touched += sum(rest * touching(stage) for rest, stage in zip(rests, scene.stages))
        folded = (scene.growth.final - waiting["from"]) / (waiting["to"] - waiting["from"])
        stiff = scene.material.mu_ratio ** waiting["stiffness_power"]
        more = min(max(folded, 0.0), 1.0) * waiting["ticks"] * stiff * scene.growth.rate * crossing
    rested = sum(rests)
    fewest, most = (more * waiting[key] + rested * resting[key] for key in ("fewest", "most"))
    return Steps(ramp, rested, more, fewest, most, touched / (ramp + rested) if ramp else 0.0)


def _growths_of_ramp(scene: Scene, per_unit: float) -> list[list[float]]:
    """Growth after every ``STEPS_PER_MEASUREMENT`` steps up to each stage, at the pace of a body in balance."""
    ramp, slow = scene.effects.get("ramp"), slow_growth(scene)
    shape = None if ramp is None else ramps.build(ramp, scene)
    growth, stages = 1.0, []
    for stage in scene.stages:
        growths = []
        while growth < stage:
            pace = limited_pace(1.0 if scene.real_time else soft_start(growth), growth, slow)
            pace *= shape.pace(growth) if shape else 1.0
            growth = next_growth(growth, stage, STEPS_PER_MEASUREMENT * pace / per_unit)
            growths.append(growth)
        stages.append(growths)
    return stages
