"""Cost of an analysis, and of the simulation it measures, as rows for the page: time, memory and expected errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.forecasts.afterwards import SOLVER_PHASES, Cost, cost_beside
from morphofold.forecasts.analysis_cost import ANALYSIS_STAGES, AnalysisCost, cost_of_analysis
from morphofold.forecasts.richardson import Estimate, stored_estimate
from morphofold.forecasts.table import Expected, called
from morphofold.report.pages.contents import Entry
from morphofold.words import percent, span

if TYPE_CHECKING:
    from morphofold.timing import Stages

TimeRows = list[tuple[str, str, str, str]]


def costs(entries: Sequence[Entry], clock: Stages | None = None) -> list[dict[str, Any]]:
    """Costs of each simulation whose folder is still complete, and of the analysis if there is a ``clock``.

    Each has a title, a sentence, times, errors, and how the errors were obtained.
    """
    found = []
    for e in entries:
        stages = [Path(file) for file in e.measures.cortex.files if Path(file).name == "stage.json"]
        cost = cost_beside(stages[0]) if stages else None
        if cost is not None:
            found.append(_entry_of_run(e.name, cost))
            _add_estimate(found[-1], stored_estimate(stages[0]))
    if clock is not None:
        found.append(_entry_of_analysis(cost_of_analysis([e.measures for e in entries], clock)))
    return found


def _entry_of_run(name: str, cost: Cost) -> dict[str, Any]:
    """Cost of a simulation: times of each phase, then of each effect of the scene."""
    parts = []
    if cost.elements is not None:
        parts.append(f"{cost.elements:,} elements")
    if cost.steps:
        parts.append(f"{cost.steps:,} steps")
    times = _time_rows(cost.phases, SOLVER_PHASES) + _time_rows(cost.effects, dict.fromkeys(cost.effects, "effect"))
    times += [(name, "", "", f"effect: {where}") for name, where in cost.within.items()]
    errors = [
        (
            called(name),
            percent(e.error),
            f"{percent(e.low)} to {percent(e.high)}",
            f"{cost.how}{_with_other_settings(e)}",
        )
        for name, e in cost.errors.items()
    ]
    return {
        "title": f"The simulation of {name}",
        "sentence": _cost_sentence(cost, parts),
        "what": "Phase or effect",
        "times": times,
        "errors": errors,
        "range": "Two of three runs",
        "doubts": (f"Errors: {cost.how}.",) if cost.not_studied else cost.doubts,
    }


def _entry_of_analysis(cost: AnalysisCost) -> dict[str, Any]:
    errors = [(name, percent(e.error), "", f"against {e.against}") for name, e in cost.errors.items()]
    sizes = [f"{hemi} of {n:,} vertices" for hemi, n in cost.vertices.items()]
    how = f"Errors: {cost.how}."
    return {
        "title": "The analysis",
        "sentence": _cost_sentence(cost, [" and ".join(sizes), f"accuracy {cost.accuracy}"]),
        "what": "Stage",
        "times": _time_rows(cost.stages, ANALYSIS_STAGES),
        "errors": errors,
        "range": "",
        "doubts": (how, *cost.doubts),
    }


def _cost_sentence(cost: Cost | AnalysisCost, parts: Sequence[str]) -> str:
    threads = "" if cost.threads is None else f" by {cost.threads} thread{'s' if cost.threads > 1 else ''}"
    parts = [f"{span(cost.seconds)}{threads}, without compiling", *parts]
    if cost.memory_GiB is not None:
        parts.append(f"{cost.memory_GiB:.2g} GiB of memory at most, for the whole process")
    return "; ".join(parts) + "."


def _time_rows(taken: Mapping[str, tuple[float, float]], words: Mapping[str, str]) -> TimeRows:
    """Name, time, share and description."""
    return [(name, span(seconds), percent(share), words.get(name, "")) for name, (seconds, share) in taken.items()]


def _with_other_settings(expected: Expected) -> str:
    return f"; other settings change it by {percent(expected.other)}" if expected.other else ""


def _add_estimate(entry: dict[str, Any], estimate: Estimate | None) -> None:
    """Append the errors from a coarser run, the effect of the pace, and the doubts about both."""
    if estimate is not None:
        entry["errors"] = [
            *entry["errors"],
            *(
                (
                    called(name),
                    percent(e.error),
                    "",
                    f"at g = {estimate.growth:g}, {estimate.how} (power {e.power:.2g})",
                )
                for name, e in estimate.errors.items()
                if e.error is not None
            ),
            *(
                (
                    called(name),
                    percent(change),
                    "",
                    f"at g = {estimate.growth:g}, from the coarser run at half the pace",
                )
                for name, change in (estimate.pace or {}).items()
            ),
        ]
        entry["doubts"] = (*entry["doubts"], *estimate.doubts)
