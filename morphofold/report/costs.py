"""What a simulation cost, as rows for its page: by phase, by effect, and the error that was to be expected."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from morphofold.forecasts.afterwards import PHASES, Cost, cost_beside
from morphofold.forecasts.table import Expected
from morphofold.forecasts.twin import Estimate, estimate_beside
from morphofold.forecasts.words import percent, span
from morphofold.report.contents import Entry


def costs(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Per simulation whose folder is still there and whole: a sentence, times, errors, and how these were had."""
    found = []
    for e in entries:
        stages = [Path(file) for file in e.measures.cortex.files if Path(file).name == "stage.json"]
        cost = cost_beside(stages[0]) if stages else None
        if cost is not None:
            found.append({"entry": e, "said": _said(cost), "times": _times(cost), **_errors(cost)})
            _add_estimate(found[-1], estimate_beside(stages[0]))
    return found


def _said(cost: Cost) -> str:
    threads = "" if cost.threads is None else f" by {cost.threads} thread{'s' if cost.threads > 1 else ''}"
    parts = [f"{span(cost.seconds)}{threads}, compiling left out"]
    if cost.elements is not None:
        parts.append(f"{cost.elements:,} elements")
    if cost.steps:
        parts.append(f"{cost.steps:,} steps")
    if cost.memory_GiB is not None:
        parts.append(f"{cost.memory_GiB:.2g} GiB of memory at most, of the whole process")
    return "; ".join(parts) + "."


def _times(cost: Cost) -> list[tuple[str, str, str, str]]:
    """Name, time, share and remark: of each phase, then of each effect that the scene called for."""
    rows = [(name, span(s), percent(share), PHASES.get(name, "")) for name, (s, share) in cost.phases.items()]
    rows += [(name, span(s), percent(share), "effect") for name, (s, share) in cost.effects.items()]
    return rows + [(name, "", "", f"effect: {where}") for name, where in cost.within.items()]


def _beside(expected: Expected) -> str:
    return f"; other settings change it by {percent(expected.other)}" if expected.other else ""


def _errors(cost: Cost) -> dict[str, Any]:
    """Errors of the quantities, each with how it was obtained."""
    rows = [
        (name, percent(e.error), f"{percent(e.low)} to {percent(e.high)}", f"{cost.how}{_beside(e)}")
        for name, e in cost.errors.items()
    ]
    return {"errors": rows, "doubts": cost.doubts}


def _add_estimate(said: dict[str, Any], estimate: Estimate | None) -> None:
    """Errors from a coarser twin below those of the table, with what they leave open."""
    if estimate is not None:
        said["errors"] = [*said["errors"], *(
            (name, percent(e.error), "", f"at g = {estimate.growth:g}, {estimate.how} (to the {e.power:.2g})")
            for name, e in estimate.errors.items() if e.error is not None
        )]  # fmt: skip
        said["doubts"] = (*said["doubts"], *estimate.doubts)
