"""``morphofold demo``: the complete work once, or a folder of made subjects."""

import time

from morphofold import results
from morphofold.analysis import measuring
from morphofold.cli.command_options import Answer, Demo
from morphofold.cli.terminal_output import progress
from morphofold.comparison import compare
from morphofold.io import read_cortex, sample_path
from morphofold.progress_callbacks import parts_of
from morphofold.shapes.population import write_population
from morphofold.sim.scene.scene_files import load_scene
from morphofold.simulation import simulate


def run(args: Demo) -> Answer:
    if args.subjects is not None:
        with progress("subjects", args.quiet) as on_progress:
            write_population(args.out, args.subjects, seed=args.seed or 0, progress=on_progress)
        return Answer(None, [f"{args.subjects} made subjects -> {args.out}"])
    start_time = time.monotonic()
    scene = load_scene(args.scene or "demo")
    with progress("grow   ", args.quiet) as on_progress:
        simulation = simulate(scene, args.out / "simulation", resume=True, threads=args.threads, progress=on_progress)
    cortices = {
        "model": simulation.cortex(),
        "individual": read_cortex(sample_path("S1"), hemi="lh", name="S1"),
        "average": read_cortex(sample_path("fsaverage5"), hemi="lh", name="fsaverage5"),
    }
    with progress("measure", args.quiet) as on_progress:
        progresses = parts_of(on_progress, [f"{name}: " for name in cortices])
        measures = {
            name: measuring.measure(cortices[name], progress=update) for name, update in zip(cortices, progresses)
        }
        on_progress(1.0, "done")
    with progress("write  ", args.quiet) as on_progress:
        for i, (name, m) in enumerate(measures.items()):
            on_progress(i / 4, name)
            results.write_analysis([m], args.out / name)
        on_progress(0.75, "comparison")
        page = compare(measures).report(args.out / "comparison")
        on_progress(1.0, "done")
    lines = [f"{name:10}  GI {m.scalars['gyrification_index']:.2f}  {m.cortex.name}" for name, m in measures.items()]
    return Answer(None, [*lines, f"{time.monotonic() - start_time:.0f} s -> {page}"])
