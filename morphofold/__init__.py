"""Grow folded cortices, read real ones, and measure both with the same code."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from morphofold.display import DRAWERS

__version__ = "0.3.0"

# In a checkout the rooms sim/, analysis/ and studies/ lie beside this folder. The tracked symlinks already lead
# there; this line covers checkouts without symlinks. It never fires in an installed wheel.
_checkout_root = Path(__file__).resolve().parent.parent
if (_checkout_root / "pyproject.toml").is_file() and (_checkout_root / "sim" / "__init__.py").is_file():
    __path__.append(str(_checkout_root))

_PUBLIC = {
    "Cortex": "morphofold.surface",
    "Surface": "morphofold.surface",
    "read_cortex": "morphofold.io",
    "read_surface": "morphofold.io",
    "sample_path": "morphofold.io",
    "measure": "morphofold.analysis.measuring",
    "Measures": "morphofold.analysis.measures",
    "compare": "morphofold.comparison",
    "simulate": "morphofold.simulation",
    "forecast": "morphofold.forecasts",
    "estimate_error": "morphofold.forecasts",
}
__all__ = ["__version__", *_PUBLIC]


def _lazily(module: str, name: str) -> Callable[..., Any]:
    """A function of a module that is imported when it is first called."""
    return lambda *arguments, **options: getattr(importlib.import_module(module), name)(*arguments, **options)


DRAWERS.setdefault("html", _lazily("morphofold.report.notebook", "html_of"))
DRAWERS.setdefault("map_picture", _lazily("morphofold.report.notebook", "plot"))
DRAWERS.setdefault("comparison_page", _lazily("morphofold.report", "comparison_report"))


def __getattr__(name: str):
    """Import a public name on first use, so that ``import morphofold`` stays instant (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'morphofold' has no attribute {name!r}")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
