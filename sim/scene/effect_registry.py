"""The effects and materials that a scene can name: each is one file, which is imported only if a scene names it."""

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

from pydantic import create_model

from morphofold.sim.scene.table_bases import EffectOptions, Table, check_keys, read_variant

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
DEFAULT_MATERIAL = "neo-hookean"
FILES_WITHOUT_MATERIAL = ("elastic",)  # files of the package that are not materials


@cache
def effect_names() -> tuple[str, ...]:
    """Names of all effects that a scene can use, in the order of their hooks; imports none of them."""
    return tuple(sorted(_files_of("effects") - {*IMPLIED_EFFECTS}, key=_hook_order_of))


@cache
def material_names() -> tuple[str, ...]:
    """Names of all materials, the default one first."""
    names = (name.replace("_", "-") for name in _files_of("materials") - {*FILES_WITHOUT_MATERIAL})
    return tuple(sorted(names, key=lambda name: (name != DEFAULT_MATERIAL, name)))


def _files_of(package: str) -> set[str]:
    return {module.name for module in pkgutil.iter_modules(import_module(f"morphofold.sim.{package}").__path__)}


def effects_of(shape: str) -> dict[str, type[EffectOptions]]:
    """The tables of the effects that a geometry can have, by name."""
    options_by_name = {name: options_of(name) for name in effect_names()}
    return {name: options for name, options in options_by_name.items() if shape in options.shapes}


def options_of(name: str, package: str = "effects") -> type[Any]:
    """The table of an effect, or of a material, read from its file."""
    return import_module(f"morphofold.sim.{package}.{name.replace('-', '_')}").Options


def read_effects(tables: Any) -> Any:
    """Options from tables by name, in the order of the hooks; the file of each effect reads its table."""
    names = sorted(check_keys(tables, effect_names()), key=_hook_order_of) if isinstance(tables, Mapping) else ()
    field_types: dict[str, Any] = {name: (options_of(name), ...) for name in names}
    return dict(create_model("Effects", __base__=Table, **field_types).model_validate(tables))


def read_material(table: Any) -> Any:
    """Options from a table, read by the file of the material that it names."""
    return read_variant(table, "model", DEFAULT_MATERIAL, material_names(), lambda name: options_of(name, "materials"))


def _hook_order_of(name: str) -> tuple[int, str]:
    return (HOOK_ORDER.index(name) if name in HOOK_ORDER else len(HOOK_ORDER), name)
