"""``morphofold simulate``: grow a scene, or forecast what it takes."""

import sys
from collections.abc import Iterator
from pathlib import Path

from morphofold.cli.command_options import Answer, Simulate
from morphofold.cli.terminal_output import print_answer, print_line, progress
from morphofold.forecasts import forecast
from morphofold.forecasts.cost_record import cost_line, cost_of
from morphofold.forecasts.forecasting import table_of
from morphofold.forecasts.mesh_choice import MeshChoice, budget_seconds, choose_mesh, error_share
from morphofold.forecasts.richardson import coarser, estimate_error
from morphofold.sim.output.simulation_folder import is_finished
from morphofold.sim.run import Simulation
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.stage_checks import REST_BOUND, not_at_rest
from morphofold.simulation import simulate


def run(args: Simulate) -> Answer:
    scene = load_scene(args.scene, args.set)
    if not args.dry_run:
        is_finished(args.out or Path(scene.name), scene, args.resume, restart_from=args.restart_from)  # or refuses
    mesh_choice = _chosen_mesh(scene, args)
    scene = mesh_choice.scene if mesh_choice else scene
    if args.estimate:
        coarser(scene)  # or refuses, before anything is grown
    if args.dry_run:
        return _dry_run(scene, mesh_choice, args)
    with progress(scene.name, args.quiet) as update:
        simulation = simulate(
            scene, args.out, resume=args.resume, threads=args.threads, progress=update, restart_from=args.restart_from
        )
    content, lines = simulation.health, _lines(simulation, scene)
    if not args.estimate:
        return Answer(content, lines)
    print_answer(Answer(None, lines), as_json=args.json)  # the run is finished, whatever becomes of its estimate
    with progress(f"{scene.name}, on a coarser mesh", args.quiet) as update:
        estimate = estimate_error(simulation, threads=args.threads, progress=update)
    return Answer({**content, "estimate": estimate.as_dict()}, [estimate.words])


def _lines(simulation: Simulation, scene: Scene) -> Iterator[str]:
    health, shape = simulation.health, scene.geometry.shape
    last = health["stages"][-1]
    other_warnings = [text for text in health["warnings"] if not text.startswith(REST_BOUND)]  # rest has its own words
    if shape == "radial":
        summary = (
            f"in one dimension in {health['seconds']:.1f} s; outer radius {last['mean_radius_mm']:.2f} mm, "
            f"min J {last['min_J']:.3f}"
        )
    else:
        state = "healthy" if health["healthy"] else "NOT healthy" if other_warnings else ""
        states = [text for text in (state, *not_at_rest(health["stages"])) if text]
        summary = (
            f"{health['elements']:,} {'tetrahedra' if shape == 'mesh' else 'bricks'}, {health['steps']:,} steps in "
            f"{health['seconds']:.0f} s; min J {last['min_J']:.2f}, {last['crossings']} crossings, {', '.join(states)}"
        )
    yield f"{simulation.path}: {len(health['stages'])} stages to g = {last['growth']:.2f}, {summary}"
    yield from (f"warning: {warning}" for warning in other_warnings)
    yield cost_line(cost_of(health, scene))


def _chosen_mesh(scene: Scene, args: Simulate) -> MeshChoice | None:
    """The mesh for --budget and --error, which is also printed."""
    if args.budget is None and args.error is None:
        return None
    budget = None if args.budget is None else budget_seconds(args.budget)
    error = None if args.error is None else error_share(args.error)
    mesh_choice = choose_mesh(scene, budget=budget, error=error, threads=args.threads)
    print_line(f"{scene.name}: {mesh_choice.words}", file=sys.stderr if args.json else sys.stdout)
    return mesh_choice


def _dry_run(scene: Scene, mesh_choice: MeshChoice | None, args: Simulate) -> Answer:
    cost = mesh_choice.forecast if mesh_choice else forecast(scene, args.threads)
    return Answer(cost.as_dict(), table_of(cost).splitlines())
