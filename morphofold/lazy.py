"""What is imported when it is first used: public names of packages, and what draws the objects of lower rooms."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any

#: module and function by name, which the package's front door registers for ``report``.
#: ``html(shown)``: a table and a small picture of a ``Cortex``, ``Measures``, ``Comparison`` or ``Simulation``;
#: ``map_picture(measures, name, surface, views, limits)``; ``comparison_page(comparison, folder, progress=)``
DRAWERS: dict[str, tuple[str, str]] = {}


def draw(name: str, *arguments: Any, **options: Any) -> Any:
    """What the function that is registered under a name returns."""
    module, function = DRAWERS[name]
    return getattr(importlib.import_module(module), function)(*arguments, **options)


def importer(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """``__getattr__`` of a package: imports a public name, of a module by name, on first use (PEP 562)."""

    def value_of(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(modules[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return value_of
