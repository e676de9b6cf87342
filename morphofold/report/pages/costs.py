"""Cost of an analysis, and of the simulation it measures, as rows for the page: time, memory and expected errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from morphofold.forecasts.cost import Cost, cost_beside, cost_of_analysis, share
from morphofold.forecasts.table import Expected, Measured, called
from morphofold.report.pages.contents import Entry
from morphofold.timing import Stages
from morphofold.words import percent, span


def costs(entries: Sequence[Entry], clock: Stages | None = None) -> list[dict[str, Any]]:
    """Costs of each simulation whose folder is still complete, and of the analysis if there is a ``clock``.

    Each has a title, a sentence, times, errors, and how the errors were obtained.
    """
    sections = []
    for e in entries:
        stages = [Path(file) for file in e.measures.cortex.files if Path(file).name == "stage.json"]
        cost = cost_beside(stages[0]) if stages else None
        if cost is not None:
            elements, steps = cost.size["elements"], cost.size["steps"]
            sizes = [f"{elements:,} elements"] if elements is not None else []
            sizes += [f"{steps:,} steps"] if steps else []
            section = _section(f"The simulation of {e.name}", cost, sizes, "Phase or effect", "Two of three runs")
            _add_estimate(section, stages[0])
            sections.append(section)
    if clock is not None:
        cost = cost_of_analysis([e.measures for e in entries], clock)
        hemispheres = " and ".join(f"{hemi} of {n:,} vertices" for hemi, n in cost.size["vertices"].items())
        sections.append(_section("The analysis", cost, [hemispheres, f"accuracy {cost.size['accuracy']}"], "Stage", ""))
    return sections


def _section(title: str, cost: Cost, sizes: Sequence[str], parts: str, error_range: str) -> dict[str, Any]:
    """Section of a cost, with the headings of its parts and of the range of its errors."""
    threads = f" by {cost.threads} thread{'s' if cost.threads > 1 else ''}" if cost.threads is not None else ""
    words = [f"{span(cost.seconds)}{threads}, without compiling", *sizes]
    if cost.memory_GiB is not None:
        words.append(f"{cost.memory_GiB:.2g} GiB of memory at most, for the whole process")
    times = [
        (name, span(seconds), percent(share(seconds, cost.seconds)), cost.labels[name])
        for name, seconds in cost.parts.items()
    ]
    times += [(name, "", "", label) for name, label in cost.labels.items() if name not in cost.parts]
    errors, how, doubts, _ = cost.expected
    by_law = any(isinstance(error, Expected) for error in errors.values())  # whose rows say how
    return {
        "title": title,
        "sentence": "; ".join(words) + ".",
        "what": parts,
        "times": times,
        "errors": [_error_row(name, error, how) for name, error in errors.items()],
        "range": error_range,
        "doubts": (*([f"Errors: {how}."] if how and not by_law else []), *doubts),
    }


def _error_row(name: str, error: Expected | Measured, how: str) -> tuple[str, str, str, str]:
    """Quantity, error, its range, and how it was obtained."""
    if isinstance(error, Measured):
        return name, percent(error.error), "", f"against {error.against}"
    other = f"; other settings change it by {percent(error.other)}" if error.other else ""
    return called(name), percent(error.error), f"{percent(error.low)} to {percent(error.high)}", f"{how}{other}"


def _add_estimate(section: dict[str, Any], stage: Path) -> None:
    """Append the errors from a coarser run, the effect of the pace, and the doubts about both, if there are any."""
    from morphofold.forecasts.richardson import stored_estimate  # loads the solver, which a person does not need

    estimate = stored_estimate(stage)
    if estimate is None:
        return
    growth = f"at g = {estimate.growth:g}, "
    rows = [
        (name, e.error, f"{growth}{estimate.how} (power {e.power:.2g})")
        for name, e in estimate.errors.items()
        if e.error is not None
    ]
    pace = f"{growth}from the coarser run at half the pace"
    rows += [(name, change, pace) for name, change in (estimate.pace or {}).items()]
    section["errors"] += [(called(name), percent(error), "", how) for name, error, how in rows]
    section["doubts"] += estimate.doubts
