"""Forecasts of a run: its time, memory and errors, and the mesh that fits; afterwards the cost of a run or an analysis,
and its errors.
"""

import importlib
from typing import Any

_PUBLIC = {
    "Estimate": "richardson",
    "Forecast": "cost",
    "MeshChoice": "mesh_choice",
    "choose_mesh": "mesh_choice",
    "estimate_error": "richardson",
    "forecast": "forecasting",
}
__all__ = ["Estimate", "Forecast", "MeshChoice", "choose_mesh", "estimate_error", "forecast"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use: an analysis, which has a cost too, does not load the solver."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'morphofold.forecasts' has no attribute {name!r}")
    return getattr(importlib.import_module(f"morphofold.forecasts.{_PUBLIC[name]}"), name)
