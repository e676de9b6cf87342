"""What is imported when it is first used: public names of packages, and what draws the objects of lower rooms."""

import importlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

#: module and function by name, which the package's front door registers for ``report`` and ``studies``.
#: ``html(shown)``: a table and a small picture of a ``Cortex``, ``Measures``, ``Comparison`` or ``Simulation``;
#: ``map_picture(measures, name, surface, views, limits)``; ``comparison_page(comparison, folder, progress=)``;
#: ``reproduce(options)``: the command of that name
DRAWERS: dict[str, tuple[str, str]] = {}


def draw(name: str, *arguments: Any, **options: Any) -> Any:
    """What the function that is registered under a name returns."""
    module, function = DRAWERS[name]
    return getattr(importlib.import_module(module), function)(*arguments, **options)


def public_names(file: str) -> dict[str, str]:
    """Public names of a package, and their modules: those that its ``__init__.py`` imports for type checkers alone."""
    import ast

    if_blocks = [node for node in ast.parse(Path(file).read_text("utf-8")).body if isinstance(node, ast.If)]
    imports = [line for block in if_blocks for line in block.body if isinstance(line, ast.ImportFrom)]
    return {alias.name: str(line.module) for line in imports for alias in line.names}


def importer(
    package: str, modules: Mapping[str, str], wrapped: Callable[[Any], Any] = lambda value: value
) -> Callable[[str], Any]:
    """``__getattr__`` of a package: imports a public name, of a module by name, on first use (PEP 562)."""

    def value_of(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = wrapped(getattr(importlib.import_module(modules[name]), name))
        setattr(sys.modules[package], name, value)
        return value

    return value_of
