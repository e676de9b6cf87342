"""The tables of docs/scenes.md: every key of a scene with its type, range and default, taken from the models.

``python -m morphofold.studies.pages.scenes docs/scenes.md`` puts them between the marks of that page.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from morphofold.io import atomic_file
from morphofold.sim import scene

BEGIN, END = "<!-- tables from here -->\n", "<!-- tables to here -->\n"

#: heading -> the table, in the order of the page
TABLES: dict[str, type[BaseModel]] = {
    "At the top": scene.Scene,
    **{f'[geometry] with shape = "{name}"': model for name, model in scene.SHAPES.items()},
    "An item of thickness_spots or spots": scene.Spot,
    "[material]": scene.Material,
    "[growth]": scene.Growth,
    "[effects.contact]": scene.Contact,
    "[effects.perturbation]": scene.Perturbation,
    "[effects.notch]": scene.Notch,
    "[effects.core_growth]": scene.CoreGrowth,
    "[effects.regional_growth]": scene.RegionalGrowth,
    "[effects.ramp]": scene.Ramp,
    "[effects.enclosure]": scene.Enclosure,
    "[effects.inertia]": scene.Inertia,
    "[effects.bulk_viscosity]": scene.BulkViscosity,
    "[accuracy]": scene.Accuracy,
    "[output]": scene.Output,
}

#: (model, key) -> unit and meaning; a key of any model that has no entry of its own stands under an empty name
MEANINGS: dict[tuple[str, str], tuple[str, str]] = {
    ("Scene", "name"): ("", "name of the scene, and of its folder by default"),
    ("Scene", "title"): ("", "one line for people"),
    ("", "shape"): ("", "which body"),
    ("", "cortex_thickness"): ("mm", "of the cortex before growth"),
    ("MeshFile", "cortex_thickness"): ("mm", "of the cortex before growth; with a `label` it sets the imperfection"),
    ("", "radius"): ("mm", "of the outer (pial) surface"),
    ("", "hole_radius"): ("mm", "of the hole in the middle, whose wall is held fixed; inside the core"),
    ("", "portion"): ("", "part that is simulated, cut by symmetry planes; output is mirrored to the whole"),
    ("", "thickness_spots"): ("", "regions of another thickness, factors times `cortex_thickness`"),
    ("Ellipsoid", "semi_axes"): ("mm", "of the outer (pial) surface, along x, y and z"),
    ("Ellipsoid", "hole_share"): ("", "size of the hole over that of the outer surface"),
    ("Patch", "size"): ("mm", "along x and y; the sides are symmetry planes"),
    ("", "depth"): ("mm", "of cortex and core together; the base is held fixed"),
    ("Strip", "length"): ("mm", "along x; plane strain across"),
    ("MeshFile", "file"): ("", "tetrahedra in any format that meshio reads: a path, or one of data_samples"),
    ("MeshFile", "scale"): ("", "lengths of the file times this are mm"),
    ("MeshFile", "label"): ("", "cell data that say what is cortex; without it, what lies within `cortex_thickness`"),
    ("MeshFile", "cortex_label"): ("", "value of `label` in the cortex"),
    ("MeshFile", "held"): ("", "what never moves: the inner surface (a ventricle), or nothing"),
    ("Spot", "centre"): ("mm", "a point of the outer surface"),
    ("Spot", "radius"): ("mm", "beyond it the factor is 1"),
    ("Spot", "factor"): ("", "at the centre"),
    ("Material", "mu_ratio"): ("", "shear modulus of the cortex over that of the core"),
    ("Material", "kappa_ratio"): ("", "bulk over shear modulus, in both layers"),
    ("Growth", "law"): ("", "in all directions, or along the surface only"),
    ("Growth", "final"): ("", "growth stretch at the end: a ratio of lengths"),
    ("Growth", "rate"): ("", "pace, times that by default; lower is slower and calmer"),
    ("Perturbation", "amplitude"): ("", "rms of the imperfection over the thickness"),
    ("Perturbation", "seed"): ("", "another seed, another pattern"),
    ("Perturbation", "wavelength"): ("mm", "of its waves in space; by default theory's first wrinkles over 1.28"),
    ("Notch", "at"): ("mm", "points of the pial surface, the nearest nodes stand for them; in a strip their x counts"),
    ("Notch", "line"): ("", "one groove along straight lines from each point to the next, not a pit at each"),
    ("Notch", "depth"): ("", "of the groove over the thickness"),
    ("Notch", "width"): ("mm", "from edge to edge; by default the thickness"),
    ("CoreGrowth", "final"): ("", "growth stretch of the core when the cortex has reached its own"),
    ("RegionalGrowth", "spots"): ("", "regions where the cortex takes `factor` times the growth g - 1"),
    ("Ramp", "shape"): ("", "how growth rises; without the table, linearly"),
    ("Enclosure", "gap"): ("mm", "between the body at first and a rigid shell around it; the grown body must fit"),
    ("Inertia", "density"): ("", "density of the body; 1 is that of the unit of time"),
    ("Inertia", "duration"): ("", "time for growth to rise by 1, in times of a shear wave across 1 mm of core"),
    ("Inertia", "damping"): ("", "rate at which velocities decay, per that time"),
    ("BulkViscosity", "linear"): ("", "coefficient of the linear term"),
    ("BulkViscosity", "quadratic"): ("", "coefficient of the quadratic term"),
    ("Accuracy", "level"): ("", "sets the surface edge, as a share of the (thinnest) cortex"),
    ("Accuracy", "elements_through_cortex"): (
        "", "layers of bricks in the cortex; by default 2 with edges longer than half of it, 3 else",
    ),
    ("Accuracy", "edge"): ("mm", "largest surface edge, instead of that of the level"),
    ("Accuracy", "precision"): ("", "of the forces of bricks: single is good to 1e-5 and a third faster"),
    ("Output", "stages"): ("", "growth stretches where the body rests and is written, the final one too; 0.01 apart"),
    ("Output", "volume"): ("", "write the body of each stage as VTK too"),
    ("Output", "stability"): ("", "count the unstable modes of each stage; by default of strips alone: it takes long"),
    ("Output", "checkpoint_minutes"): ("min", "between checkpoints"),
}  # fmt: skip


def tables() -> str:
    """All the tables as Markdown."""
    parts = [_effects_by_shape()]
    for heading, model in TABLES.items():
        rows = _rows(model)
        head = ["| key | type | unit | range | default | meaning |", "|---|---|---|---|---|---|"]
        parts.append("\n".join([f"### {heading}", "", *([*head, *rows] if rows else ["No options."])]))
    return "\n\n".join(parts) + "\n"


def write(page: Path) -> None:
    """Put the tables between the marks of ``page``.

    Raises
    ------
    ValueError
        If the page lacks the marks.
    """
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page}: lacks {BEGIN.strip()} and {END.strip()}; put these lines where the tables belong.")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    with atomic_file(page) as file:
        file.write_text(f"{before}{BEGIN}\n{tables()}\n{END}{after}", encoding="utf-8")


def _effects_by_shape() -> str:
    effects = list(scene.Effects.model_fields)
    lines = ["### Which shapes take which effects", "", f"| shape | {' | '.join(effects)} |",
             "|---|" + "---|" * len(effects)]  # fmt: skip
    for shape in scene.SHAPES:
        takes = scene.EFFECTS_OF.get(shape, effects)
        lines.append(f"| {shape} | {' | '.join('yes' if effect in takes else '-' for effect in effects)} |")
    return "\n".join(lines)


def _rows(model: type[BaseModel]) -> list[str]:
    rows = []
    keys = model.model_json_schema()["properties"]
    for key, schema in sorted(keys.items(), key=lambda item: item[0] != "shape"):       # else as in the model
        if "$ref" in schema or "oneOf" in schema or (key, model) == ("effects", scene.Scene):
            continue                                                    # a table of its own
        plain = next((s for s in schema.get("anyOf", ()) if s.get("type") != "null"), schema)
        unit, meaning = MEANINGS.get((model.__name__, key)) or MEANINGS["", key]
        field = model.model_fields[key]
        default = "needed" if field.is_required() else "-" if field.default is None else f"`{_toml(field.default)}`"
        kind, span = _kind_and_range(plain)
        rows.append(f"| `{key}` | {kind} | {unit} | {span} | {default} | {meaning} |")
    return rows


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return str(list(value)) if isinstance(value, tuple) else str(value).lower()


def _kind_and_range(schema: Mapping[str, Any]) -> tuple[str, str]:
    """What a value is, and between what it may lie, of a JSON schema."""
    if "const" in schema or "enum" in schema:
        return "text", ", ".join(f'`"{word}"`' for word in schema.get("enum", [schema.get("const")]))
    if schema["type"] == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} numbers", _kind_and_range(schema["prefixItems"][0])[1]
        items = schema["items"]
        count = "one or more" if schema.get("minItems") else ""
        if "prefixItems" in items:
            return "list of points", count
        return ("list of spots", count) if "$ref" in items else ("list of numbers", _kind_and_range(items)[1])
    if schema["type"] == "string":
        least, most = schema.get("minLength", 0), schema.get("maxLength")
        return "text", f"{least} to {most} characters" if most else f"{least} character or more" if least else ""
    signs = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    kind = {"number": "number", "integer": "whole number", "boolean": "true or false"}[schema["type"]]
    if "minimum" in schema and "maximum" in schema:
        return kind, f"{_number(schema['minimum'])} to {_number(schema['maximum'])}"
    return kind, ", ".join(f"{sign} {_number(schema[name])}" for name, sign in signs.items() if name in schema)


def _number(value: float) -> str:
    return "2^63" if value == 2**63 else f"{value:.0f}" if value == int(value) else f"{value:g}"


if __name__ == "__main__":
    write(Path(sys.argv[1]))
