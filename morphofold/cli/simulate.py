"""Grow a scene into folds and write its stages as FreeSurfer-shaped subjects. If a run is not healthy, this is printed
and recorded in health.json. The exit code is still 0, because its files can be looked at."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.cli import add_options, add_scene, add_settings, add_threads
from morphofold.cli.streams import print_json, print_line
from morphofold.errors import OptionsClash

if TYPE_CHECKING:
    from morphofold.forecasts.mesh_choice import MeshChoice
    from morphofold.forecasts.richardson import Estimate
    from morphofold.sim.run import Simulation
    from morphofold.sim.scene import Scene

EXAMPLES = ("morphofold simulate fig5 -o fig5", "morphofold simulate fig5 -o fig5 --resume")


def add_args(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_options(parser, ("-o --out", "DIR", "folder to write (default: the scene's name)"))
    add_settings(parser, "change one value of the scene, e.g. growth.final=1.8; may be repeated")
    add_options(
        parser,
        ("--resume", None, "continue from the checkpoint in DIR; a finished run is left as it is"),
        (
            "--restart-from",
            "RUN",
            "begin at the last stage or the checkpoint of another run with the same mesh (its folder), or at a stage "
            "(RUN/stages/g1.50); material, growth, effects and stages may differ",
        ),
        (
            "--dry-run",
            None,
            "print what the run would take: elements, steps, memory, time, errors; write nothing. Its steps are timed "
            "for a second or two",
        ),
        ("--budget", "TIME", "choose the finest mesh whose run is expected to fit: 90s, 5min, 2h or 1d"),
        (
            "--error",
            "SHARE",
            "choose the coarsest mesh whose expected error (of gyrification index and wavelength) is no larger: a "
            "percentage such as 5%%, or a fraction such as 0.05",
        ),
        (
            "--estimate",
            None,
            "afterwards grow a coarser run in DIR/coarser, in two fifths of the time, and estimate the error from "
            "both; then the coarser run at half the pace in DIR/slower, in about half of the time, to show what the "
            "pace changes",
        ),
    )
    add_threads(parser)
    add_options(
        parser, ("--json", None, "print health.json with the result of --estimate; or the forecast of --dry-run")
    )


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.forecasts.cost import cost_line, cost_of
    from morphofold.sim.output.folder import is_finished
    from morphofold.sim.scene.files import load_scene

    _refuse_option_clashes(args)
    scene = load_scene(args.scene, args.settings)
    if not args.dry_run:
        folder = Path(args.out or scene.name)
        is_finished(folder, scene, args.resume, restart_from=args.restart_from)  # or refuses, before any timing
    chosen = _chosen_mesh(scene, args)
    scene = chosen.scene if chosen else scene
    if args.estimate:
        from morphofold.forecasts.richardson import companions

        companions(scene)  # or refuses, before anything is grown
    if args.dry_run:
        return _dry_run(scene, chosen, args)
    from morphofold.simulation import simulate

    args.on_interrupt = " Run it again with --resume to go on."
    with progress(scene.name, args.quiet) as show:
        simulation = simulate(
            scene, args.out, resume=args.resume, threads=args.threads, progress=show, restart_from=args.restart_from
        )
    if args.json:
        _print_json(simulation, args)
        return 0
    health = simulation.health
    last = health["stages"][-1]
    stages = f"{len(health['stages'])} stages to g = {last['growth']:.2f}"
    print_line(f"{simulation.path}: {stages}, {_run_summary(scene, health)}")
    for warning in health["warnings"]:
        print_line(f"warning: {warning}")
    print_line(cost_line(cost_of(health, scene)))
    if args.estimate:
        print_line(_estimated_error(simulation, args).words)
    return 0


def _print_json(simulation: Simulation, args: argparse.Namespace) -> None:
    """Print a finished run as JSON, even if its estimate fails, which is null then."""

    content = dict(simulation.health)
    try:
        if args.estimate:
            content["estimate"] = None
            content["estimate"] = _estimated_error(simulation, args).as_dict()
    finally:
        print_json(content)


def _refuse_option_clashes(args: argparse.Namespace) -> None:
    """Raise for options that can't be used with a run that continues, or that begins at a stage of another run."""
    fresh = {"--dry-run": args.dry_run, "--budget": args.budget, "--error": args.error}
    for option, given in {**fresh, "--estimate": args.estimate}.items():
        if args.restart_from and given:
            raise OptionsClash(
                f"{option} is for a run that begins ungrown with a mesh of its own; a run with --restart-from has the "
                "mesh of another run. Leave it out."
            )
    for option, given in fresh.items():
        if args.resume and given:
            raise OptionsClash(
                f"{option} is for a new run; --resume continues with the accuracy of the earlier one, which is in "
                "scene.toml of its folder. Leave it out."
            )


def _chosen_mesh(scene: Scene, args: argparse.Namespace) -> MeshChoice | None:
    """The mesh for --budget and --error, which is also printed."""
    if args.budget is None and args.error is None:
        return None
    from morphofold.forecasts.mesh_choice import budget_seconds, choose_mesh, error_share

    budget = None if args.budget is None else budget_seconds(args.budget)
    error = None if args.error is None else error_share(args.error)
    chosen = choose_mesh(scene, budget=budget, error=error, threads=args.threads)
    print_line(f"{scene.name}: {chosen.words}", file=sys.stderr if args.json else sys.stdout)
    return chosen


def _estimated_error(simulation: Simulation, args: argparse.Namespace) -> Estimate:
    from morphofold.cli.progress import progress
    from morphofold.forecasts.richardson import estimate_error

    with progress(f"{simulation.scene.name}, coarser and slower", args.quiet) as show:
        return estimate_error(simulation, threads=args.threads, progress=show)


def _dry_run(scene: Scene, chosen: MeshChoice | None, args: argparse.Namespace) -> int:
    from morphofold.forecasts import forecast
    from morphofold.forecasts.cost import table_of
    from morphofold.forecasts.richardson import companion_forecasts

    found = chosen.forecast if chosen else forecast(scene, args.threads)
    others = companion_forecasts(scene, args.threads) if args.estimate else {}
    if args.json:
        print_json({**found.as_dict(), **{name: run.as_dict() for name, run in others.items()}})
    else:
        print("\n\n".join([table_of(found), *(f"its {name} run, {table_of(run)}" for name, run in others.items())]))
    return 0


def _run_summary(scene: Scene, health: Mapping[str, Any]) -> str:
    from morphofold.sim.health import not_at_rest

    last, shape = health["stages"][-1], scene.geometry.shape
    if shape == "radial":
        return (
            f"in one dimension in {health['seconds']:.1f} s; outer radius {last['mean_radius_mm']:.2f} mm, "
            f"min J {last['min_J']:.3f}"
        )
    states = ["healthy" if health["healthy"] else "NOT healthy", *not_at_rest(health["stages"])]
    return (
        f"{health['elements']:,} {'tetrahedra' if shape == 'mesh' else 'bricks'}, {health['steps']:,} steps in "
        f"{health['seconds']:.0f} s; min J {last['min_J']:.2f}, {last['crossings']} crossings, {', '.join(states)}"
    )
