"""The simulations of a figure: how a figure requests one, and its entry in an index."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from morphofold.analysis import Measures
from morphofold.progress import Progress
from morphofold.sim.run import Simulation
from morphofold.surface import Cortex

Result = TypeVar("Result")


class Runs(Protocol):
    """What figures need: simulations, measures, and reports of progress.

    ``draft``: bodies are octants on coarser meshes, with the stages that are drawn and no others.
    """

    draft: bool

    def grow(self, name: str, scene: str, settings: Sequence[str]) -> Simulation:
        """The simulation of a built-in scene with changed settings, under its own name; grown if needed."""

    def measure(self, name: str, cortex: Cortex) -> Measures:
        """All measures of a cortex, under its own name; measures of a name that was measured before are reused."""

    def once(self, words: str, work: Callable[[Progress], Result]) -> Result:
        """The result of the work that ``words`` name, done once for all figures. The work gets a callable for its
        progress: the share done, 0 to 1, and a short text."""


def run_record(simulation: Simulation) -> dict[str, Any]:
    """The entry of a simulation in an index: folder, size, time, health."""
    health = simulation.health
    return {
        "scene": simulation.scene.name,
        "folder": f"simulations/{simulation.path.name}",
        "level": simulation.scene.accuracy.level,
        "elements": health.get("elements"),
        "steps": health["steps"],
        "seconds": health["seconds"],
        "healthy": health["healthy"],
        "warnings": health["warnings"],
    }
