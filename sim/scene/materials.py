"""The materials that a scene can name, and their tables; each is one file of ``morphofold.sim.materials``."""

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from morphofold.sim.scene.tables import MaterialOptions

MATERIALS_PACKAGE = "morphofold.sim.materials"
DEFAULT_MATERIAL = "neo-hookean"
FILES_WITHOUT_MATERIAL = ("elastic",)  # files of the package that are not materials


@cache
def material_names() -> tuple[str, ...]:
    """Names of all materials, the default one first."""
    there = (module.name for module in pkgutil.iter_modules(import_module(MATERIALS_PACKAGE).__path__))
    names = (name.replace("_", "-") for name in there if name not in FILES_WITHOUT_MATERIAL)
    return tuple(sorted(names, key=lambda name: (name != DEFAULT_MATERIAL, name)))


def options_of(name: str) -> type[MaterialOptions]:
    """The table of a material, read from its file."""
    return import_module(f"{MATERIALS_PACKAGE}.{name.replace('-', '_')}").Options


def read_material(table: Any) -> Any:
    """Options from a table, read by the file of the material that it names; ``model`` may be left out for the default
    one."""
    if isinstance(table, MaterialOptions):
        return table
    if not isinstance(table, Mapping):
        return options_of(DEFAULT_MATERIAL).model_validate(table)  # this refuses it
    name = table.get("model", DEFAULT_MATERIAL)
    if name not in material_names():
        known = " or ".join(repr(one) for one in material_names())
        problem = InitErrorDetails(
            type=PydanticCustomError("material", "must be {known}", {"known": known}),
            loc=(DEFAULT_MATERIAL, "model"),
            input=name,
        )
        raise ValidationError.from_exception_data("material", [problem])
    try:
        return options_of(name).model_validate(table)
    except ValidationError as error:
        raise ValidationError.from_exception_data(
            "material",
            [
                InitErrorDetails(type=e["type"], loc=(name, *e["loc"]), input=e["input"], ctx=e.get("ctx", {}))
                for e in error.errors()
            ],
        ) from None
