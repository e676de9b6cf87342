"""The simulations behind a figure: how a figure asks for one, and what an index says of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from morphofold.sim.run import Simulation


class Grow(Protocol):
    """Gives the simulation of a built-in scene, with settings put over it, under a name of its own; grows it if need
    be."""

    def __call__(self, name: str, scene: str, settings: Sequence[str]) -> Simulation: ...


def told(simulation: Simulation) -> dict[str, Any]:
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
