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
    module_name, function_name = DRAWERS[name]
    return getattr(importlib.import_module(module_name), function_name)(*arguments, **options)


def public_names(init_file: str) -> dict[str, str]:
    """Public names of a package, and their modules: those that its ``__init__.py`` imports for type checkers alone."""
    import ast

    if_blocks = [node for node in ast.parse(Path(init_file).read_text("utf-8")).body if isinstance(node, ast.If)]
    imports = [statement for block in if_blocks for statement in block.body if isinstance(statement, ast.ImportFrom)]
    return {alias.name: str(statement.module) for statement in imports for alias in statement.names}


def importer(
    package: str, module_by_name: Mapping[str, str], wrap: Callable[[Any], Any] = lambda value: value
) -> Callable[[str], Any]:
    """``__getattr__`` of a package: imports a public name, of a module by name, on first use (PEP 562)."""

    def value_of(name: str) -> Any:
        if name not in module_by_name:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            module = importlib.import_module(module_by_name[name])
        except ModuleNotFoundError as error:
            from morphofold.optional_packages import with_cure

            raise with_cure(error) from None
        value = wrap(getattr(module, name))
        setattr(sys.modules[package], name, value)
        return value

    return value_of
