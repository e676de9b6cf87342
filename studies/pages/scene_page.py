"""The tables of docs/scenes.md: every key of a scene with its type, range and default, taken from the models.

``python -m morphofold.studies.pages.scene_page docs/scenes.md`` writes them between the marks of that page.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from morphofold.errors import MissingPart
from morphofold.io.files import write_text
from morphofold.sim import scene
from morphofold.sim.effects.fibres import Bundle
from morphofold.sim.scene.effect_registry import DEFAULT_MATERIAL, effect_names, effects_of, material_names, options_of
from morphofold.sim.scene.table_bases import (
    LONGEST_LENGTH_MM,
    SHORTEST_LENGTH_MM,
    MaterialOptions,
    SphereMap,
    Spot,
    unit_of,
)

BEGIN, END = "<!-- tables from here -->\n", "<!-- tables to here -->\n"
LENGTH_RANGE = f"{SHORTEST_LENGTH_MM:g} to {LONGEST_LENGTH_MM:.0f}"
CHOOSING_KEYS = ("shape", "model")  # each names the table, as its heading does; the page says what they choose
#: tables that take up the keys of another, which are not repeated: what the page calls that one, and its model
BASES: tuple[tuple[str, type[BaseModel]], ...] = (("a map", SphereMap), ("[material]", MaterialOptions))


def _heading(material: str) -> str:
    return "[material]" if material == DEFAULT_MATERIAL else f'[material] with model = "{material}"'


#: heading -> the table, in the order of the page
MODEL_OF_HEAD: dict[str, type[BaseModel]] = {
    "At the top": scene.Scene,
    **{f'[geometry] with shape = "{name}"': model for name, model in scene.SHAPES.items()},
    "An item of thickness_spots or spots": Spot,
    "A map: thickness_map of a sphere, an ellipsoid or a cortex": SphereMap,
    **{_heading(name): options_of(name, "materials") for name in material_names()},
    "[growth]": scene.Growth,
    **{f"[effects.{name}]": options_of(name) for name in effect_names()},
    "An item of bundles of [effects.fibres]": Bundle,
    "[accuracy]": scene.Accuracy,
    "[output]": scene.Output,
}


def tables() -> str:
    """All tables as Markdown."""
    sections = [_effects_by_shape()]
    for heading, model in MODEL_OF_HEAD.items():
        base_name, base_keys = _base(heading, model)
        lines = _rows(model, base_keys)
        head_lines = ["| key | value | default | meaning |", "|---|---|---|---|"]
        if base_name:
            intro_lines = [f"The keys of {base_name}, and:", ""] if lines else [f"The keys of {base_name}."]
        else:
            intro_lines = [] if lines else ["No options."]
        sections.append("\n".join([f"### {heading}", "", *intro_lines, *([*head_lines, *lines] if lines else [])]))
    return "\n\n".join(sections) + "\n"


def write(page: Path) -> None:
    """Write the tables between the marks of ``page``.

    Raises
    ------
    MissingPart
        If the page lacks the marks.
    """
    page_text = page.read_text(encoding="utf-8")
    if BEGIN not in page_text or END not in page_text:
        raise MissingPart(f"{page}: lacks {BEGIN.strip()} and {END.strip()}; put these lines where the tables belong.")
    text_before, text_after = page_text.split(BEGIN)[0], page_text.split(END)[1]
    write_text(page, f"{text_before}{BEGIN}\n{tables()}\n{END}{text_after}")


def _effects_by_shape() -> str:
    effect_list = effect_names()
    lines = [
        "### Which shapes take which effects",
        "",
        f"| shape | {' | '.join(effect_list)} |",
        "|---|" + "---|" * len(effect_list),
    ]
    shapes_by_cells: dict[str, list[str]] = {}  # those that take the same effects share a row
    for shape in scene.SHAPES:
        shape_effects = effects_of(shape)
        cells_text = " | ".join("yes" if effect in shape_effects else "-" for effect in effect_list)
        shapes_by_cells.setdefault(cells_text, []).append(shape)
    return "\n".join([*lines, *(f"| {', '.join(shapes)} | {cells} |" for cells, shapes in shapes_by_cells.items())])


def _base(heading: str, model: type[BaseModel]) -> tuple[str, set[str]]:
    """What the page calls the table whose keys a model takes up, and these keys; nothing if there is none above it."""
    for name, base in BASES:
        if issubclass(model, base) and model is not base and heading != name:
            return name, {*base.model_fields}
    return "", set()


def _rows(model: type[BaseModel], left_out: set[str]) -> list[str]:
    lines = []
    schemas = model.model_json_schema()["properties"]
    for key, schema in sorted(schemas.items(), key=lambda pair: pair[0] != "shape"):  # otherwise the order of the model
        if "$ref" in schema or (model is scene.Scene and key in ("geometry", "material", "effects")):
            continue  # has its own table
        if key in left_out or (key in CHOOSING_KEYS and "const" in schema):
            continue
        value_schema = next((choice for choice in schema.get("anyOf", ()) if choice.get("type") != "null"), schema)
        field = model.model_fields[key]
        default = "needed" if field.is_required() else "-" if field.default is None else f"`{_toml(field.default)}`"
        value_text = _value(*_kind_and_range(value_schema), unit_of(model, key))
        lines.append(f"| `{key}` | {value_text} | {default} | {field.description} |")
    return lines


def _value(kind: str, range_text: str, unit: str) -> str:
    """What a key takes, in one cell; the kind is left out where the range shows it, the range of a length always."""
    if unit == "mm" and range_text == LENGTH_RANGE:
        return kind.replace("number", "length")
    if kind == "list of texts":
        return f"list of {range_text}"
    if kind.startswith("list"):
        return ", ".join(filter(None, (kind, range_text, unit)))
    parts = ("" if kind in ("number", "text") and range_text else kind, f"{range_text} {unit}".strip())
    return ", ".join(filter(None, parts))


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return str(list(value)) if isinstance(value, tuple) else str(value).lower()


def _kind_and_range(schema: Mapping[str, Any]) -> tuple[str, str]:
    """Type and range of a value, from its JSON schema."""
    if "const" in schema or "enum" in schema:
        return "text", ", ".join(f'`"{choice}"`' for choice in schema.get("enum", [schema.get("const")]))
    if "$ref" in schema:
        return "map", ""
    if schema["type"] == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers", _kind_and_range(schema["prefixItems"][0])[1]
        item_schema = schema["items"]
        count_text = "one or more" if schema.get("minItems") else ""
        if "prefixItems" in item_schema:
            return "list of points", count_text
        if "$ref" in item_schema:
            return f"list of {item_schema['$ref'].rpartition('/')[2].lower()}s", count_text
        type_text, range_text = _kind_and_range(item_schema)
        return ("list of texts" if type_text == "text" else "list of numbers"), range_text
    if schema["type"] == "string":
        least, most = schema.get("minLength", 0), schema.get("maxLength")  # most texts are only not empty
        return "text", f"{least} to {most} characters" if most else ""
    sign_of_key = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    type_text = {"number": "number", "integer": "whole number", "boolean": "true or false"}[schema["type"]]
    if "minimum" in schema and "maximum" in schema:
        return type_text, f"{_number(schema['minimum'])} to {_number(schema['maximum'])}"
    return type_text, ", ".join(f"{sign} {_number(schema[key])}" for key, sign in sign_of_key.items() if key in schema)


def _number(value: float) -> str:
    return "2^63" if value == 2**63 else f"{value:.0f}" if value == int(value) else f"{value:g}"


if __name__ == "__main__":
    write(Path(sys.argv[1]))
