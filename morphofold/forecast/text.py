"""Times, shares and forecasts in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from morphofold.forecast.forecasting import Forecast
    from morphofold.forecast.measuring import AnalysisForecast
    from morphofold.forecast.table import Expected
    from morphofold.sim.scene import Scene


def span(seconds: float) -> str:
    """A time in two units at most: ``0.4 s``, ``45 s``, ``4 min 40 s``, ``2 h 5 min``, ``3 d 2 h``."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds < 119.5:
        return f"{seconds:.0f} s"
    for unit, below, part, name in ((60, "s", 10, "min"), (3600, "min", 60, "h"), (86400, "h", 3600, "d")):
        whole, rest = divmod(round(seconds / part) * part, unit)
        if name == "d" or whole < {"min": 60, "h": 24}[name]:
            rest //= {"s": 1, "min": 60, "h": 3600}[below]
            return f"{whole} {name} {rest} {below}" if rest else f"{whole} {name}"
    raise AssertionError                                                # the last unit takes all


def percent(share: float) -> str:
    """A share with two digits at most: ``0.62 %``, ``2.1 %``, ``23 %``."""
    value = 100 * share
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %"


def percent_above(share: float) -> str:
    """A share with two digits, rounded up: what is asked for so is no less than it."""
    step = 10.0 ** (math.floor(math.log10(share)) - 1)
    return percent(math.ceil(share / step - 1e-9) * step)


def unstudied(names: Iterable[str]) -> str:
    """Why no errors are told of a scene, from what ``table.not_studied`` names."""
    return f"not studied for this {', '.join(name.replace('_', ' ') for name in names)}"


def called(quantity: str) -> str:
    """A quantity as tables of errors call it: errors are relative, but for a distance, which is over the thickness."""
    return "pial distance, over T" if quantity == "pial distance" else quantity


def setting_words(scene: Scene, edge: float) -> str:
    """The accuracy of a scene: its level, or where its edge [mm] lies among the levels."""
    from morphofold.sim.scene import LEVELS

    if scene.geometry.shape in ("mesh", "radial"):
        return "the mesh of the file" if scene.geometry.shape == "mesh" else "one dimension"
    if scene.accuracy.edge is None:
        return scene.accuracy.level
    return between_levels(edge / scene.thinnest, LEVELS)


def between_levels(edge_over_T: float, levels: Mapping[str, float]) -> str:
    """Among ``levels``, from the coarsest to the finest, where an edge over the thickness lies."""
    coarser = [name for name, edge in levels.items() if edge >= edge_over_T]
    finer = [name for name, edge in levels.items() if edge <= edge_over_T]
    if not coarser:
        return f"coarser than {finer[0]}"
    if not finer:
        return f"finer than {coarser[-1]}"
    return f"between {coarser[-1]} and {finer[0]}" if coarser[-1] != finer[0] else finer[0]


def table_of(found: Forecast) -> str:
    """A forecast as a short table."""
    rows = [("setting", _setting(found))]
    if found.shape != "radial":
        rows += [
            ("elements", f"{found.elements:,}"),
            ("nodes", f"{found.nodes:,}"),
            ("steps", f"{found.steps:,}  ({found.fewest_steps:,} to {found.most_steps:,})"),
        ]
    rows += _memory_and_time(found, found.seconds_by_phase)
    rows += [
        (f"error of {called(name)}", f"{percent(e.error)}  ({percent(e.low)} to {percent(e.high)}){_beside(e)}")
        for name, e in found.errors.items()
    ]
    return _laid_out(found.scene, rows, found)


def table_of_analysis(found: AnalysisForecast) -> str:
    """The same of an analysis."""
    rows = [("accuracy", found.accuracy)]
    for one in found.hemispheres:
        copy = "" if one.measured_on == one.vertices else f"; thicknesses and net on {one.measured_on:,}"
        rows.append((one.hemi, f"{one.vertices:,} vertices of white and pial each{copy}; {span(one.seconds)}"))
    rows += _memory_and_time(found, found.seconds_by_stage)
    rows += [(f"error of {name}", f"{percent(e.error)}  against {e.against}") for name, e in found.errors.items()]
    return _laid_out(found.name, rows, found)


def _memory_and_time(found: Forecast | AnalysisForecast, parts: Mapping[str, float]) -> list[tuple[str, str]]:
    threads = f"{found.threads} thread{'s' if found.threads > 1 else ''}"
    most = sorted(parts.items(), key=lambda item: -item[1])[:4]
    return [
        ("memory", f"{found.memory_GiB:.2g} GiB"),
        ("time", f"{span(found.seconds)}  ({span(found.fastest)} to {span(found.slowest)}) by {threads}"),
        ("", ", ".join(f"{name} {percent(seconds / found.seconds)}" for name, seconds in most)),
    ]


def _laid_out(name: str, rows: list[tuple[str, str]], found: Forecast | AnalysisForecast) -> str:
    """Rows in two columns, how they were obtained, and doubts."""
    width = max(len(label) for label, _ in rows)
    lines = [f"{name}: forecast"] + [f"  {label:{width}}  {value}" for label, value in rows]
    lines += [f"{what}: {how}" for what, how in found.how.items()]
    return "\n".join([*lines, *found.doubts])


def _beside(expected: Expected) -> str:
    return f", other settings {percent(expected.other)}" if expected.other else ""


def _setting(found: Forecast) -> str:
    if found.edge_over_T is None:
        return found.setting
    layers = f", {found.elements_through_cortex} elements through the cortex" if found.elements_through_cortex else ""
    return f"{found.setting}, edge {found.edge_mm:.3g} mm ({found.edge_over_T:.2f} T){layers}"
