"""Before a run: its size, time, memory and errors, and the accuracy that fits; after it: what it cost.

Public names load on first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.forecasts.forecasting import Forecast, forecast
    from morphofold.forecasts.picking import Pick, pick

_PUBLIC = {"Forecast": "forecasting", "forecast": "forecasting", "Pick": "picking", "pick": "picking"}
__all__ = ["Forecast", "Pick", "forecast", "pick"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
