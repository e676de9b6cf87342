"""The simulations in a folder of results: they are grown there, used again, and kept when the folder is replaced."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from morphofold import analysis, simulation
from morphofold.analysis import Measures
from morphofold.cli.progress import progress
from morphofold.io import atomic_folder
from morphofold.progress import Progress
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Sphere
from morphofold.sim.scene.files import load_scene
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

    def grow(self, name: str, scene: str, settings: Sequence[str]) -> Simulation:
        begin(self._out)
        if self.draft:
            name, settings = f"{name}-octant-draft", [*settings, "accuracy.level=draft"]
            if isinstance(load_scene(scene, settings).geometry, Sphere):
                settings = [*settings, "geometry.portion=octant"]
        begun = time.perf_counter()
        with self.showing(name) as show:
            try:
                return simulation.simulate(
                    scene,
                    self._out / SIMULATIONS_FOLDER / name,
                    settings=settings,
                    resume=True,
                    threads=self._threads,
                    progress=show,
                )
            except UnstableError as error:
                raise UnstableError(f"{name}: {error}", error.sound) from error  # which of many
            finally:
                self.seconds_growing += time.perf_counter() - begun

    def measure(self, name: str, cortex: Cortex) -> Measures:
        accuracy = "draft" if self.draft else "standard"
        return self.once(f"measure {name}", lambda show: analysis.measure(cortex, accuracy=accuracy, progress=show))

    def once(self, label: str, work: Callable[[Progress], Result]) -> Result:
        if label not in self._done:
            with self.showing(label) as show:
                self._done[label] = work(show)
        return self._done[label]

    def showing(self, label: str) -> AbstractContextManager[Progress]:
        return progress(label, self._quiet)


def begin(out: Path) -> None:
    """Mark an empty or new folder as ours, so that parts can be written into it before the whole."""
    if not out.is_dir() or not any(out.iterdir()):
        with atomic_folder(out):
            pass
