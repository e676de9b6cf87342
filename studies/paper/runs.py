"""The simulations behind a figure: how a figure asks for one, and what an index says of it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from morphofold.analysis import Measures
from morphofold.progress import Progress
from morphofold.sim.run import Simulation
from morphofold.surface import Cortex


class Runs(Protocol):
    """What figures ask for: simulations, measures, and someone to tell of long work."""

    def grow(self, name: str, scene: str, settings: Sequence[str]) -> Simulation:
        """The simulation of a built-in scene, with settings put over it, under a name of its own; grown if need be."""

    def measure(self, name: str, cortex: Cortex) -> Measures:
        """All measures of a cortex, under a name of its own; those of a name that was measured before are kept."""

    def telling(self, words: str) -> AbstractContextManager[Progress]:
        """Someone who is told the share done, 0 to 1, and a few words, of the work that ``words`` name."""


def run_record(simulation: Simulation) -> dict[str, Any]:
    """What an index says of a simulation: where it lies, size, time, health."""
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
