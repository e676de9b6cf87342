"""What draws objects of lower rooms: functions by name, which the package's front door registers for ``report``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: ``html(shown)``: a table and a small picture of a ``Cortex``, ``Measures``, ``Comparison`` or ``Simulation``;
#: ``map_picture(measures, name, surface, views, limits)``; ``comparison_page(comparison, folder, progress=)``
DRAWERS: dict[str, Callable[..., Any]] = {}


def draw(name: str, *arguments: Any, **options: Any) -> Any:
    """What the function that is registered under a name returns."""
    return DRAWERS[name](*arguments, **options)
