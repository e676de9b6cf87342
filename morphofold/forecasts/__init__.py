"""Before a run: its size, time, memory and errors, the accuracy that fits; after it: what it cost, and how wrong it is.

Public names load on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.forecasts.forecasting import Forecast, forecast
    from morphofold.forecasts.picking import Pick, pick
    from morphofold.forecasts.twin import Estimate, estimate_error

_PUBLIC = {
    "Forecast": "forecasting", "forecast": "forecasting", "Pick": "picking", "pick": "picking", "Estimate": "twin",
    "estimate_error": "twin",
}  # fmt: skip
__all__ = ["Estimate", "Forecast", "Pick", "estimate_error", "forecast", "pick"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
