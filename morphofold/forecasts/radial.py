"""The forecast of a run in one dimension: next to nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from morphofold.forecasts.memory import memory_GiB
from morphofold.forecasts.sizes import Sizes
from morphofold.forecasts.table import costs
from morphofold.progress import silent

if TYPE_CHECKING:
    from morphofold.forecasts.expected import Forecast
    from morphofold.sim.scene import Scene


def radial_forecast(scene: Scene, threads: int | None) -> Forecast:
    """Solve the final stage of a radial scene, which takes milliseconds, and forecast the run."""
    import numba

    from morphofold.forecasts.calibration import slowness_of_stages
    from morphofold.forecasts.expected import SETTING_UP, STAGES, Forecast
    from morphofold.sim.radial_run import SPHERE_LEVEL, RadialRun
    from morphofold.threads import check_threads, set_threads
    from morphofold.timing import working_seconds

    check_threads(threads)
    nowhere: Any = None
    run = RadialRun(scene, nowhere, silent, lambda: False)
    run.equilibrium(scene.growth.final)
    started = working_seconds()
    run.numbers(run.equilibrium(scene.growth.final), scene.growth.final)
    solving = len(scene.stages) * (working_seconds() - started)
    before = numba.get_num_threads()
    try:
        set_threads(threads)
        threads = numba.get_num_threads()
        slowness = slowness_of_stages(costs())
    finally:
        numba.set_num_threads(before)
    vertices = 10 * 4**SPHERE_LEVEL + 2
    stage = costs()["stage"]
    writing = slowness * len(scene.stages) * (stage["per_vertex"] + stage["write_per_vertex"]) * vertices
    seconds = solving + writing
    return Forecast(
        scene.name, "radial", "one dimension", None, None, None, 0, 0, 0, 0, 0, len(scene.stages), seconds,
        0.5 * seconds, 2 * seconds, {"radial": solving, STAGES: writing, SETTING_UP: 0.0},
        memory_GiB(Sizes(0, 0, vertices, 0.0), bricks=True, single=False, volume=False), threads, {}, (),
        {"time": "the final stage was solved", "memory": "measured in other runs",
         "errors": "equilibria to a part in 1e8 or so; no mesh enters"}, (),
    )  # fmt: skip
