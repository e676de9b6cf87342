"""List the built-in scenes and the effects that each uses, or print one as TOML with all its values."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

EXAMPLES = ("morphofold scenes", "morphofold scenes fig5")
SCENE_KINDS = ("Figures of the paper", "The same, growing along the surface only", "Spheres", "Other bodies")
TABLE_HEADINGS = ("name", "shape", "cortex", "mu ratio", "growth", "to", "effects")


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE", nargs="?", help="print this one: a built-in scene or a TOML file")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    from morphofold.sim.scene.files import load_scene, scene_names, to_toml

    if args.scene is not None:
        scene = load_scene(args.scene)
        print(json.dumps(scene.model_dump(exclude_none=True), indent=1) if args.json else to_toml(scene).rstrip())
        return 0
    scenes = [load_scene(name) for name in scene_names()]
    if args.json:
        print(json.dumps([{"name": s.name, "title": s.title, "effects": tuple(s.effects)} for s in scenes], indent=1))
    else:
        print(_scene_table(scenes))
    return 0


def _kind_of_scene(scene: Scene) -> str:
    if scene.name.startswith("fig"):
        return SCENE_KINDS[1] if scene.growth.law == "tangential" else SCENE_KINDS[0]
    return SCENE_KINDS[2] if scene.geometry.shape == "sphere" else SCENE_KINDS[3]


def _scene_row(scene: Scene) -> tuple[str, ...]:
    geometry = scene.geometry
    shape = " ".join(filter(None, (getattr(geometry, "portion", "").replace("full", ""), geometry.shape)))
    thickness, ratio, final = geometry.cortex_thickness, scene.material.mu_ratio, scene.growth.final
    effects = ", ".join(scene.effects) or "-"
    return scene.name, shape, f"{thickness:g} mm", f"{ratio:g}", scene.growth.law, f"{final:.2f}", effects


def _scene_table(scenes: list[Scene]) -> str:
    """Table of the scenes by kind, in columns."""
    rows = {scene.name: _scene_row(scene) for scene in scenes}
    widths = [max(map(len, column)) for column in zip(TABLE_HEADINGS, *rows.values())]

    def line(row: tuple[str, ...]) -> str:
        return "  ".join(f"{text:{width}}" for text, width in zip(row, widths)).rstrip()

    lines = [line(TABLE_HEADINGS)]
    for kind in SCENE_KINDS:
        lines += ["", kind, *(line(rows[scene.name]) for scene in scenes if _kind_of_scene(scene) == kind)]
    return "\n".join(lines)
