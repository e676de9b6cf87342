"""Before a run or an analysis: its time, memory and errors, and the accuracy that fits; after it: what it cost, and how
wrong it is.

Public names load on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.forecasts.expected import Forecast
    from morphofold.forecasts.forecasting import forecast
    from morphofold.forecasts.measuring import AnalysisForecast, forecast_analysis
    from morphofold.forecasts.mesh_choice import Pick, pick
    from morphofold.forecasts.richardson import Estimate, estimate_error

_PUBLIC = {
    "AnalysisForecast": "measuring", "Estimate": "richardson", "Forecast": "expected", "Pick": "mesh_choice",
    "estimate_error": "richardson", "forecast": "forecasting", "forecast_analysis": "measuring", "pick": "mesh_choice",
}  # fmt: skip
__all__ = [
    "AnalysisForecast", "Estimate", "Forecast", "Pick", "estimate_error", "forecast", "forecast_analysis", "pick",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
