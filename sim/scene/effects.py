"""The effects that a scene can name, and their tables; each effect is one file of ``morphofold.sim.effects``."""

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

from morphofold.sim.scene.tables import EffectOptions

EFFECTS_PACKAGE = "morphofold.sim.effects"
#: order in which hooks are called, where it matters; other effects follow by name
HOOK_ORDER = (
    "contact",
    "corner_barrier",
    "perturbation",
    "notch",
    "core_growth",
    "stress_growth",
    "regional_growth",
    "growth_map",
    "stiffness_map",
    "ramp",
    "skull",
    "midline",
    "inertia",
    "bulk_viscosity",
)

#: added by contact at symmetry planes, and by strips; a scene cannot name them
IMPLIED_EFFECTS = ("symmetry", "plane_strain")


@cache
def effect_names() -> tuple[str, ...]:
    """Names of all effects that a scene can use, in the order of their hooks; imports none of them."""
    there = (module.name for module in pkgutil.iter_modules(import_module(EFFECTS_PACKAGE).__path__))
    return tuple(sorted((name for name in there if name not in IMPLIED_EFFECTS), key=_hook_order_of))


def effects_of(shape: str) -> dict[str, type[EffectOptions]]:
    """The tables of the effects that a geometry can have, by name."""
    found = {name: options_of(name) for name in effect_names()}
    return {name: options for name, options in found.items() if shape in options.shapes}


def options_of(name: str) -> type[EffectOptions]:
    """The table of an effect, read from its file."""
    return import_module(f"{EFFECTS_PACKAGE}.{name}").Options


def read_effects(tables: Any) -> Any:
    """Options from tables by name, in the order of the hooks; the file of each effect reads its table."""
    if not isinstance(tables, Mapping):
        return tables  # pydantic refuses it
    found: dict[str, EffectOptions] = {}
    problems: list[InitErrorDetails] = []
    for name in sorted(tables, key=lambda name: _hook_order_of(str(name))):
        if name not in effect_names():
            problems.append(InitErrorDetails(type="extra_forbidden", loc=(name,), input=tables[name]))
            continue
        try:
            found[name] = options_of(name).model_validate(tables[name])
        except ValidationError as error:
            problems += [
                InitErrorDetails(type=e["type"], loc=(name, *e["loc"]), input=e["input"], ctx=e.get("ctx", {}))
                for e in error.errors()
            ]
    if problems:
        raise ValidationError.from_exception_data("effects", problems)
    return found


def _hook_order_of(name: str) -> tuple[int, str]:
    return (HOOK_ORDER.index(name) if name in HOOK_ORDER else len(HOOK_ORDER), name)
