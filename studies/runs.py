"""The simulations of figures and studies: grown in a folder of results, used again, and how an index lists them."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from morphofold import analysis, simulation
from morphofold.analysis import Measures
from morphofold.cli.terminal_output import progress
from morphofold.io.atomic_folders import mark_as_ours
from morphofold.progress_callbacks import Progress
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Sphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import LARGEST_REST_DISTANCE_OVER_T, REST_BOUND, not_at_rest
from morphofold.surface import Cortex
from morphofold.threads import set_threads

Result = TypeVar("Result")
SIMULATIONS_FOLDER = "simulations"


class Runs:
    """Grows scenes in ``out``/simulations/NAME, each once, and continues from checkpoints.

    Simulations are in ``out`` itself. The folder that replaces ``out`` keeps them, so an interrupt loses none. Drafts
    are octants on coarser meshes and have names of their own. An invalid number of threads is refused at once, before
    anything is written.
    """

    def __init__(self, out: Path, *, threads: int | None, quiet: bool, draft: bool = False):
        set_threads(threads)
        self._out, self.draft, self._threads, self._quiet = out, draft, threads, quiet
        self._done: dict[str, Any] = {}
        self.seconds_growing = 0.0

    def grow(self, run_name: str, scene_name: str, settings: Sequence[str]) -> Simulation:
        """The simulation of a scene with changed settings, under its own name; grown if needed."""
        mark_as_ours(self._out)
        if self.draft:
            run_name, settings = f"{run_name}-octant-draft", [*settings, "accuracy.level=draft"]
            if isinstance(load_scene(scene_name, settings).geometry, Sphere):
                settings = [*settings, "geometry.portion=octant"]
        start_time = time.perf_counter()
        with progress(run_name, self._quiet) as on_progress:
            try:
                return simulation.simulate(
                    scene_name,
                    self._out / SIMULATIONS_FOLDER / run_name,
                    settings=settings,
                    resume=True,
                    threads=self._threads,
                    progress=on_progress,
                )
            except UnstableError as error:
                raise UnstableError(f"{run_name}: {error}", error.sound) from error  # which of many
            finally:
                self.seconds_growing += time.perf_counter() - start_time

    def measure(self, name: str, cortex: Cortex) -> Measures:
        """All measures of a cortex, under its own name; measures of a name that was measured before are reused."""
        accuracy = "draft" if self.draft else "standard"
        return self.once(f"measure {name}", lambda notify: analysis.measure(cortex, accuracy=accuracy, progress=notify))

    def once(self, work_label: str, compute: Callable[[Progress], Result]) -> Result:
        """The result of the work of this label, done once for all figures; the work gets its progress."""
        if work_label not in self._done:
            with progress(work_label, self._quiet) as on_progress:
                self._done[work_label] = compute(on_progress)
        return self._done[work_label]


def run_record(simulation: Simulation) -> dict[str, Any]:
    """The entry of a simulation in an index: folder, size, time, health; stages that do not rest in one warning."""
    health = simulation.health
    restless = [row for row in health["stages"] if (row.get(REST_BOUND) or 0.0) > LARGEST_REST_DISTANCE_OVER_T]
    warnings = [warning for warning in health["warnings"] if not warning.startswith(REST_BOUND)]
    return {
        "scene": simulation.scene.name,
        "folder": f"simulations/{simulation.path.name}",
        "level": simulation.scene.accuracy.level,
        "elements": health.get("elements"),
        "steps": health["steps"],
        "seconds": health["seconds"],
        "healthy": health["healthy"],
        "warnings": [*not_at_rest(restless), *warnings],
    }
