"""The effects that a scene may name, one file of ``morphofold.sim.effects`` each, and their tables."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module, util
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

from morphofold.sim.scene.tables import EffectOptions

PACKAGE = "morphofold.sim.effects"
#: in which hooks are called, where it matters; others follow by name
ORDER = (
    "contact", "perturbation", "notch", "core_growth", "regional_growth", "ramp", "enclosure", "inertia",
    "bulk_viscosity",
)  # fmt: skip


@cache
def effect_names() -> tuple[str, ...]:
    """Names of all effects that a scene can call for, in the order of their hooks; imports every one."""
    spec = util.find_spec(PACKAGE)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    there = (module.name for module in pkgutil.iter_modules(spec.submodule_search_locations))
    return tuple(sorted((name for name in there if options_of(name) is not None), key=_place))


def effects_of(shape: str) -> dict[str, type[EffectOptions]]:
    """The tables of the effects that a geometry can have, by name."""
    found = {name: options_of(name) for name in effect_names()}
    return {name: options for name, options in found.items() if options is not None and shape in options.shapes}


def options_of(name: str) -> type[EffectOptions] | None:
    """The table of an effect, from its file; None if a scene cannot call for it, or there is none of that name."""
    if not name.isidentifier() or util.find_spec(f"{PACKAGE}.{name}") is None:
        return None
    return getattr(import_module(f"{PACKAGE}.{name}"), "Options", None)


def read_effects(tables: Any) -> Any:
    """Tables by name as options, each read by the file of its effect, in the order of their hooks."""
    if not isinstance(tables, Mapping):
        return tables                                                   # which pydantic refuses
    found: dict[str, EffectOptions] = {}
    problems: list[InitErrorDetails] = []
    for name in sorted(tables, key=_place):
        model, table = options_of(name), tables[name]
        try:
            if model is None:
                raise ValidationError.from_exception_data("effects", [{"type": "extra_forbidden", "input": table}])
            found[name] = model.model_validate(table)
        except ValidationError as error:
            problems += [
                InitErrorDetails(type=e["type"], loc=(name, *e["loc"]), input=e["input"], ctx=e.get("ctx", {}))
                for e in error.errors()
            ]
    if problems:
        raise ValidationError.from_exception_data("effects", problems)
    return found


def _place(name: str) -> tuple[int, str]:
    return (ORDER.index(name) if name in ORDER else len(ORDER), name)
