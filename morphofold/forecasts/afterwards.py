"""Cost of a finished run, by phase and by effect, and its expected errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.forecasts.table import Expected, doubts, expected_errors, headline, not_studied, table, unstudied
from morphofold.words import percent

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

OTHER = "other"
SecondsAndShares = Mapping[str, tuple[float, float]]  # name -> seconds, and share of all

#: phases of the solver's clock that belong to no effect, and what they do
SOLVER_PHASES = {
    "elements": "forces of the elements",
    "advance": "nodal sums, velocities and positions",
    "balance": "how far the body is from equilibrium, every twelve steps",
    "measure": "masses, energies and health, every twelve steps",
    "grow": "growth of the elements",
    "filter": "forces of the surface filter",
    "radial": "equilibria in one dimension",
    OTHER: "building the body; checks, maps and files of the stages; log and checkpoints",
}


@dataclass(frozen=True)
class Cost:
    """Cost of a run.

    Attributes
    ----------
    seconds : float
        Wall time without compiling.
    phases, effects : mapping
        Name to seconds and to their share of all. ``phases`` has ``"other"``, too; ``effects`` has the effects with a
        phase of their own, which ``phases`` leaves out.
    within : mapping
        Effects without a phase of their own, and where their time is counted, in words.
    steps, elements, threads : int or None
    memory_GiB : float or None
    edge_over_T : float or None
        Largest surface edge over the thickness of the (thinnest) cortex; None in one dimension.
    errors : mapping
        Expected relative error by quantity; empty in one dimension, and for a scene that was not studied.
    not_studied : tuple of str
        Properties of the scene that were not studied (:func:`morphofold.forecasts.table.not_studied`).
    how : str
        How the errors were obtained, or why there are none.
    doubts : tuple of str
    """

    seconds: float
    phases: SecondsAndShares
    effects: SecondsAndShares
    within: Mapping[str, str]
    steps: int | None
    elements: int | None
    threads: int | None
    memory_GiB: float | None
    edge_over_T: float | None
    errors: Mapping[str, Expected]
    not_studied: tuple[str, ...]
    how: str
    doubts: tuple[str, ...]


def cost_of(health: Mapping[str, Any], scene: Scene) -> Cost:
    """Cost of a run from its ``health.json`` and scene. Fields that an earlier version did not write are None."""
    seconds, by_phase = float(health["seconds"]), dict(health.get("seconds_by_phase", {}))
    if by_phase:
        by_phase[OTHER] = max(0.0, seconds - sum(by_phase.values()))
    shared = shares(dict(sorted(by_phase.items(), key=lambda item: -item[1])), seconds)
    called = health.get("effects", list(scene.called_effects))
    edge = health.get("surface_edge_mm")
    ratio = None if edge is None else float(edge) / scene.thinnest
    outside = () if ratio is None else not_studied(scene, ratio)
    how = "" if ratio is None else f"before the run, from its edge and a table: {table()['errors']['subject']}"
    return Cost(
        seconds,
        {name: cost for name, cost in shared.items() if name not in called},
        {name: cost for name, cost in shared.items() if name in called},
        {
            name: "within radial" if "radial" in shared else _where_time_is_counted(name)
            for name in called
            if name not in shared
        },
        health.get("steps"),
        health.get("elements"),
        health.get("threads"),
        health.get("peak_memory_GiB"),
        ratio,
        {} if ratio is None or outside else expected_errors(ratio),
        outside,
        unstudied(outside) if outside else how,
        () if ratio is None else tuple(doubts(scene, ratio)),
    )


def shares(seconds: Mapping[str, float], whole: float) -> SecondsAndShares:
    """Seconds by name, each with its share of the whole."""
    return {name: (each, each / whole if whole > 0 else 0.0) for name, each in seconds.items()}


def largest(parts: SecondsAndShares, most: int) -> str:
    """The largest parts with their shares, in words."""
    return ", ".join(
        f"{name} {percent(share)}" for name, (_, share) in sorted(parts.items(), key=lambda item: -item[1][0])[:most]
    )


def _where_time_is_counted(effect: str) -> str:
    """Where the time of an effect without a phase of its own is counted."""
    from morphofold.sim.scene.effects import effect_names, options_of

    return (effect in effect_names() and options_of(effect).counted) or "not timed separately"


def cost_beside(stage: Path) -> Cost | None:
    """Cost of the run that wrote a ``stage.json``; None if its folder is incomplete or does not exist any more."""
    from morphofold.sim.output.stages import read_health
    from morphofold.sim.scene.files import load_scene

    folder = stage.parent.parent.parent
    try:
        return cost_of(read_health(folder), load_scene(folder / "scene.toml"))
    except (OSError, ValueError):
        return None


def cost_line(cost: Cost, most: int = 3) -> str:
    """A line with the largest times and the expected error."""
    taken = largest({**cost.phases, **cost.effects}, most)
    parts = [f"time: {taken}"] if taken else []
    if cost.not_studied:
        parts.append(f"expected error: {cost.how}")
    elif cost.edge_over_T is not None:
        name, expected = headline(cost.edge_over_T)
        parts.append(f"expected error about {percent(expected.error)} ({name}), from its edge and a table")
    return ". ".join(part.removesuffix(".") for part in ("; ".join(parts), *cost.doubts))
