"""List the built-in scenes and the effects that each calls for."""

from __future__ import annotations

import argparse
import json


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    from morphofold.sim.scene import load_scene, scene_names

    scenes = [load_scene(name) for name in scene_names()]
    if args.json:
        print(json.dumps([{"name": s.name, "title": s.title, "effects": s.effects.named} for s in scenes], indent=1))
        return 0
    width = max(len(s.name) for s in scenes)
    for s in scenes:
        where = " ".join(filter(None, (getattr(s.geometry, "portion", ""), s.geometry.shape)))
        print(
            f"{s.name:{width}}  {s.title}: {where}, cortex {s.geometry.cortex_thickness:g} mm, mu ratio "
            f"{s.material.mu_ratio:g}, {s.growth.law} growth to {s.growth.final:g}; "
            f"effects: {', '.join(s.effects.named) or 'none'}"
        )
    return 0
