"""Cost of a run or an analysis after it: seconds by phase, effect or stage, memory, and expected errors; as a line for
the terminal, as JSON, and in words for pages."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numba import get_num_threads

from morphofold.analysis.measures import Measures
from morphofold.analysis.resampling import accuracy_of
from morphofold.forecasts.table import COSTS, Errors, GiB, errors_of_run, headline, measured_errors
from morphofold.sim.output.stages import read_health
from morphofold.sim.scene import Scene
from morphofold.sim.scene.effects import effect_names, options_of
from morphofold.sim.scene.files import load_scene
from morphofold.timing import Stages, peak_memory
from morphofold.words import percent, span

OTHER = "other"
READING_STAGE, WRITING_STAGE, PAGE_STAGE = "reading", "writing", "page"
#: phases of the solver's clock that belong to no effect, and stages of an analysis, and what they do
SOLVER_PHASES, ANALYSIS_STAGES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).values()


@dataclass(frozen=True)
class Cost:
    """Cost of a run or an analysis.

    Attributes
    ----------
    size : mapping
        Of a run its ``elements`` and ``steps``, None if an early version did not write them; of an analysis its
        ``vertices`` by hemisphere and its ``accuracy``.
    threads : int or None
    seconds : float
        Wall time without compiling [s].
    parts : mapping
        Seconds of each phase and effect of a run, or of each stage of an analysis.
    labels : mapping
        What each part does, in words; and where the time of an effect is counted that is no part of its own.
    memory_GiB : float or None
        Most that the process has held.
    expected : Errors
    """

    size: Mapping[str, Any]
    threads: int | None
    seconds: float
    parts: Mapping[str, float]
    labels: Mapping[str, str]
    memory_GiB: float | None
    expected: Errors

    def as_dict(self) -> dict[str, Any]:
        """Plain values of an analysis, for JSON."""
        return {
            **self.size,
            "threads": self.threads,
            "seconds": self.seconds,
            "stages": {name: {"seconds": t, "share": share(t, self.seconds)} for name, t in self.parts.items()},
            "memory_GiB": self.memory_GiB,
            "errors": {name: asdict(error) for name, error in self.expected.errors.items()},
            "how": self.expected.how,
            "doubts": self.expected.doubts,
        }


def cost_of(health: Mapping[str, Any], scene: Scene) -> Cost:
    """Cost of a run from its ``health.json`` and scene."""
    seconds, taken = float(health["seconds"]), dict(health.get("seconds_by_phase", {}))
    if taken:
        taken[OTHER] = max(0.0, seconds - sum(taken.values()))
    effects = health.get("effects", list(scene.called_effects))
    parts = dict(sorted(taken.items(), key=lambda part: (part[0] in effects, -part[1])))
    labels = {name: SOLVER_PHASES.get(name, "") for name in parts}
    for effect in effects:
        counted = options_of(effect).counted if effect in effect_names() else ""
        where = "within radial" if "radial" in parts else counted or "not timed separately"
        labels[effect] = "effect" if effect in parts else f"effect: {where}"
    edge = health.get("surface_edge_mm")
    return Cost(
        {"elements": health.get("elements"), "steps": health.get("steps")},
        health.get("threads"),
        seconds,
        parts,
        labels,
        health.get("peak_memory_GiB"),
        errors_of_run(scene, None if edge is None else float(edge) / scene.thinnest),
    )


def cost_beside(stage: Path) -> Cost | None:
    """Cost of the run that wrote a ``stage.json``; None if its folder is incomplete or does not exist any more."""
    folder = stage.parents[2]
    try:
        return cost_of(read_health(folder), load_scene(folder / "scene.toml"))
    except (OSError, ValueError):
        return None


def cost_of_analysis(measures: Sequence[Measures], clock: Stages) -> Cost:
    """Cost of an analysis of at least one hemisphere; ends the stage that its clock is timing."""
    clock.end()
    accuracy = str(measures[0].parameters["accuracy"])
    return Cost(
        {"vertices": {m.cortex.hemi: m.cortex.n_vertices for m in measures}, "accuracy": accuracy},
        get_num_threads(),
        sum(clock.seconds.values()),
        dict(clock.seconds),
        {name: ANALYSIS_STAGES.get(name, "") for name in clock.seconds},
        peak_memory(),
        measured_errors([m.cortex for m in measures], accuracy),
    )


def memory_of_analysis(vertices: Sequence[int], *, accuracy: str = "standard", report: bool = True) -> float:
    """Most memory of a process that measures hemispheres of these numbers of vertices, one after the other [GiB]."""
    chosen, memory, total = accuracy_of(accuracy), COSTS["analysis"], sum(vertices)
    largest_mesh = max(4 * n if n < chosen.least else n for n in vertices)
    most = memory["kept_per_vertex"] * total + memory["per_vertex"] * largest_mesh
    measuring: float = memory["process"] + (most + memory["per_voxel"] * chosen.voxels**3) / GiB
    page = memory["page"] + memory["page_per_hemisphere"] * len(vertices) + memory["page_per_vertex"] * total / GiB
    return max(measuring, page) if report else measuring


def share(seconds: float, total: float) -> float:
    """A share of a total time; 0 if no time was taken."""
    return seconds / total if total > 0 else 0.0


def largest(parts: Mapping[str, float], total: float, most: int = 3) -> str:
    """The largest parts of a time with their shares, in words."""
    longest = sorted(parts.items(), key=lambda part: -part[1])[:most]
    return ", ".join(f"{name} {percent(share(seconds, total))}" for name, seconds in longest)


def cost_line(cost: Cost) -> str:
    """A line with the largest times of a run and its expected error."""
    errors, how, doubts, not_studied = cost.expected
    words = [f"time: {largest(cost.parts, cost.seconds)}"] if cost.parts else []
    if not_studied:
        words.append(f"expected error: {how}")
    elif errors:
        name, expected = headline(errors)
        words.append(f"expected error about {percent(expected.error)} ({name}), from its edge and a table")
    return ". ".join(part.removesuffix(".") for part in ("; ".join(words), *doubts))


def analysis_cost_line(cost: Cost) -> str:
    """A line with the largest times of an analysis and its largest expected error: the least may be small by chance."""
    line, errors = f"time: {span(cost.seconds)}, {largest(cost.parts, cost.seconds)}; ", cost.expected.errors
    if not errors:
        return f"{line}errors: {cost.expected.how}"
    worst = max(errors, key=lambda name: errors[name].error)
    return (
        f"{line}expected errors up to {percent(errors[worst].error)} ({worst}), by one person's hemisphere and its mesh"
    )
