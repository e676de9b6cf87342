"""Grow a scene into folds and write its stages as FreeSurfer-shaped subjects. A run that is not healthy says so, in
health.json too, and ends with exit code 0: what it wrote is there to be looked at."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE", help="a built-in scene (see morphofold scenes) or a TOML file")
    parser.add_argument("-o", "--out", metavar="DIR", help="folder to write (default: the scene's name)")
    parser.add_argument(
        "--set", dest="settings", metavar="TABLE.KEY=VALUE", action="append", default=[],
        help="change one value of the scene, e.g. growth.final=1.8; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint in DIR; a finished run is left as it is",
    )  # fmt: skip
    parser.add_argument("--threads", type=int, metavar="N", help="threads (default: all cores)")
    parser.add_argument("--json", action="store_true", help="print health.json")


def run(args: argparse.Namespace) -> int:
    if args.out == "":
        raise ValueError("-o: no folder is named; give one to write, such as -o mine.")
    from morphofold.cli.progress import progress
    from morphofold.sim.scene_file import load_scene
    from morphofold.simulation import simulate

    scene = load_scene(args.scene, args.settings)
    args.on_interrupt = " Run it again with --resume to go on."
    with progress(scene.name, args.quiet) as tell:
        simulation = simulate(scene, args.out, resume=args.resume, threads=args.threads, progress=tell)
    health = simulation.health
    if args.json:
        print(json.dumps(health, indent=1))
        return 0
    last = health["stages"][-1]
    stages = f"{len(health['stages'])} stages to g = {last['growth']:.2f}"
    print(f"{simulation.path}: {stages}, {_what_was_done(scene, health)}")
    for warning in health["warnings"]:
        print(f"warning: {warning}")
    return 0


def _what_was_done(scene: Scene, health: Mapping[str, Any]) -> str:
    last, shape = health["stages"][-1], scene.geometry.shape
    if shape == "radial":
        return (
            f"in one dimension in {health['seconds']:.1f} s; outer radius {last['mean_radius_mm']:.2f} mm, "
            f"min J {last['min_J']:.3f}"
        )
    return (
        f"{health['elements']:,} {'tetrahedra' if shape == 'mesh' else 'bricks'}, {health['steps']:,} steps in "
        f"{health['seconds']:.0f} s; min J {last['min_J']:.2f}, {last['crossings']} crossings, "
        f"{'healthy' if health['healthy'] else 'NOT healthy'}"
    )
