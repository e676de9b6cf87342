"""Timing of a scene's steps and stages on this machine for a second or two; forecasts are scaled from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from morphofold.forecasts.sizes import Layers, Sizes, layers_of, sizes_of
from morphofold.forecasts.steps import Steps, steps_of

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

MOST_TIMED_BRICKS = (
    330_000  # most bricks (as a scene counts them) of a body that is built and timed; larger bodies are scaled
)
TIMING_SECONDS = 0.8  # time for which steps are taken
LEAST_AND_MOST_BLOCKS = 3, 60  # of steps, at least and at most
GROWTH_PER_BLOCK = 1e-6  # growth in each block
BUSY_MACHINE_RATIO = 1.5  # slower over fastest block: beyond it a machine is called busy


@dataclass(frozen=True)
class Calibration:
    """Result of the timing.

    Attributes
    ----------
    scene : Scene
        The scene that was built: the scene itself, a smaller part of it, or a coarser one.
    sizes : Sizes
    layers : Layers or None
        None for tetrahedra.
    crossing : float
        Steps in which a wave crosses the cortex.
    steps_per_unit : float
        Steps in which growth rises by 1 at full pace.
    steps : Steps
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
    steps: Steps
    phases: Mapping[str, float]
    fastest: float
    slowest: float
    setting_up: float
    slowness: float
    threads: int


def calibrate(scene: Scene, costs: Mapping[str, Any], threads: int | None = None) -> Calibration:
    """Build the scene's body, or a smaller one like it, and time a few steps and a stage.

    Raises
    ------
    ValueError
        If the body cannot be built, or the number of threads is invalid.
    """
    from morphofold.sim.build import build_body
    from morphofold.sim.dynamics import Dynamics
    from morphofold.sim.effects import build_effects
    from morphofold.threads import using_threads
    from morphofold.timing import working_seconds

    with using_threads(threads):
        small = reduced(scene)
        started = working_seconds()
        effects = build_effects(small)
        body = build_body(small, effects)
        run = Dynamics.of(small, body, effects)
        used = run.threads
        setting_up = working_seconds() - started
        phases, fastest, slowest = _time_steps(run)
        slowness = slowness_of_stages(costs)
    per_unit, bilayer = float(1 / run.rate), body.bilayer
    return Calibration(
        small,
        sizes_of(bilayer),
        layers_of(bilayer) if bilayer.faces.shape[1] == 4 else None,
        body.crossing,
        per_unit,
        steps_of(small, per_unit, body.crossing, costs),
        phases,
        fastest,
        slowest,
        setting_up,
        slowness,
        used,
    )


def reduced(scene: Scene) -> Scene:
    """The scene, or a smaller part of its body, or else a coarser scene, with at most ``MOST_TIMED_BRICKS`` bricks."""
    from morphofold.sim.scene.files import load_scene

    portions = ("full", "half", "quarter", "octant")
    while scene.bricks > MOST_TIMED_BRICKS:
        portion = getattr(scene.geometry, "portion", None)
        if portion in portions[:-1]:
            change = f"geometry.portion={portions[portions.index(portion) + 1]}"
        else:
            change = f"accuracy.edge={1.1 * scene.edge:.6g}"
        scene = load_scene(scene, [change])
    return scene


def _time_steps(run: Any) -> tuple[dict[str, float], float, float]:
    """Seconds per step by phase, and the times of the fastest block of steps and of the slower quarter over them.

    Seconds are those of the faster third of the blocks, because other work of the machine in that second will not last
    for the whole run.
    """
    import numpy as np

    from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT
    from morphofold.timing import working_seconds

    def block() -> dict[str, float]:
        run.seconds.clear()
        run.grow_to(run.state.growth + GROWTH_PER_BLOCK)
        return {name: seconds / STEPS_PER_MEASUREMENT for name, seconds in run.seconds.items()}

    block()  # loads kernels, fills caches
    started = working_seconds()
    taken: list[dict[str, float]] = []
    while len(taken) < LEAST_AND_MOST_BLOCKS[0] or (
        working_seconds() - started < TIMING_SECONDS and len(taken) < LEAST_AND_MOST_BLOCKS[1]
    ):
        taken.append(block())
    totals = np.array([sum(phases.values()) for phases in taken])
    middle = float(np.quantile(totals, 1 / 3))
    shares = {name: float(np.median([phases.get(name, 0.0) for phases in taken])) for name in taken[-1]}
    scale = middle / sum(shares.values())
    phases = {name: scale * seconds for name, seconds in shares.items()}
    return phases, float(totals.min()) / middle, float(np.quantile(totals, 0.75)) / middle


def slowness_of_stages(costs: Mapping[str, Any]) -> float:
    """Time of the checks and maps of a small cortex here, over the time on the machine of the table.

    One thread is used: if the machine has other work, two threads wait for each other, and times vary.
    """
    from numba import set_num_threads

    from morphofold.shapes import icosphere
    from morphofold.sim.health import check_surface
    from morphofold.simulation import freesurfer_maps
    from morphofold.surface import Cortex, Surface
    from morphofold.timing import working_seconds

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
    return float(min(taken) / costs["stage"]["sphere"])
