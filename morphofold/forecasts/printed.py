"""A forecast as a short table for the terminal."""

from __future__ import annotations

from morphofold.forecasts.afterwards import largest, shares
from morphofold.forecasts.forecasting import Forecast
from morphofold.forecasts.table import Expected, called
from morphofold.words import percent, span


def table_of(found: Forecast) -> str:
    """A forecast as a short table."""
    rows = [("setting", _setting_text(found))]
    if found.shape != "radial":
        rows += [
            ("elements", f"{found.elements:,}"),
            ("nodes", f"{found.nodes:,}"),
            ("steps", f"{found.steps:,}  ({found.fewest_steps:,} to {found.most_steps:,})"),
        ]
    threads = f"{found.threads} thread{'s' if found.threads > 1 else ''}"
    rows += [
        ("memory", f"{found.memory_GiB:.2g} GiB"),
        ("time", f"{span(found.seconds)}  ({span(found.fastest)} to {span(found.slowest)}) with {threads}"),
        ("", largest(shares(found.seconds_by_phase, found.seconds), 4)),
    ]
    rows += [
        (
            f"error of {called(name)}",
            f"{percent(e.error)}  ({percent(e.low)} to {percent(e.high)}){_with_other_settings(e)}",
        )
        for name, e in found.errors.items()
    ]
    width = max(len(label) for label, _ in rows)
    lines = [f"{found.scene}: forecast"] + [f"  {label:{width}}  {value}" for label, value in rows]
    lines += [f"{what}: {how}" for what, how in found.how.items()]
    return "\n".join([*lines, *found.doubts])


def _with_other_settings(expected: Expected) -> str:
    return f", other settings {percent(expected.other)}" if expected.other else ""


def _setting_text(found: Forecast) -> str:
    if found.edge_over_T is None:
        return found.setting
    layers = f", {found.elements_through_cortex} elements through the cortex" if found.elements_through_cortex else ""
    return f"{found.setting}, edge {found.edge_mm:.3g} mm ({found.edge_over_T:.2f} T){layers}"
