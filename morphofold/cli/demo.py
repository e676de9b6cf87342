"""The complete work once: grow a folded cortex, measure it and two real hemispheres, write the comparison. With
--subjects, make a folder of subjects for trying cohort, stats and overlap."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from morphofold.cli import add_threads
from morphofold.errors import OptionsClash
from morphofold.progress import part_of

EXAMPLES = ("morphofold demo -o demo",)


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", metavar="DIR", default="demo", help="folder to write (default: demo)")
    parser.add_argument("--scene", help="scene to grow (default: demo)")
    parser.add_argument(
        "--subjects",
        type=int,
        metavar="N",
        help="write N made subjects into DIR instead, whose left cortex thins with age, for trying cohort and stats",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="of the made subjects (default: 0)")
    add_threads(parser)


def run(args: argparse.Namespace) -> int:
    from morphofold.analysis.measuring import measure
    from morphofold.cli.progress import progress
    from morphofold.comparison import compare
    from morphofold.io import read_cortex, sample_path
    from morphofold.results import write_analysis
    from morphofold.sim.scene.files import load_scene
    from morphofold.simulation import simulate
    from morphofold.threads import set_threads

    set_threads(args.threads)
    if args.subjects is not None and args.scene is not None:
        raise OptionsClash("--subjects makes subjects and grows no scene. Leave out --scene.")
    if args.subjects is None and args.seed is not None:
        raise OptionsClash("--seed is that of made subjects. Pass --subjects, too, or leave it out.")
    if args.subjects is not None:
        return write_subjects(args)
    out, started = Path(args.out), time.monotonic()
    scene = load_scene(args.scene or "demo")
    args.on_interrupt = " Run it again to go on."
    with progress("grow   ", args.quiet) as show:
        simulation = simulate(scene, out / "simulation", resume=True, threads=args.threads, progress=show)
    cortices = {
        "model": simulation.cortex(),
        "individual": read_cortex(sample_path("S1"), hemi="lh", name="S1"),
        "average": read_cortex(sample_path("fsaverage5"), hemi="lh", name="fsaverage5"),
    }
    measures = {}
    with progress("measure", args.quiet) as show:
        for i, (name, cortex) in enumerate(cortices.items()):
            part = part_of(show, i / len(cortices), 1 / len(cortices), f"{name}: ")
            measures[name] = measure(cortex, progress=part)
        show(1.0, "done")
    with progress("write  ", args.quiet) as show:
        for i, (name, m) in enumerate(measures.items()):
            show(i / 4, name)
            write_analysis([m], out / name)
        show(0.75, "comparison")
        page = compare(measures).report(out / "comparison")
        show(1.0, "done")
    for name, m in measures.items():
        print(f"{name:10}  GI {m.scalars['gyrification_index']:.2f}  {m.cortex.name}")
    print(f"{time.monotonic() - started:.0f} s -> {page}")
    return 0


def write_subjects(args: argparse.Namespace) -> int:
    """Write a folder of made subjects."""
    from morphofold.cli.progress import progress
    from morphofold.shapes.population import write_population

    with progress("subjects", args.quiet) as show:
        write_population(args.out, args.subjects, seed=args.seed or 0, progress=show)
    print(f"{args.subjects} made subjects -> {args.out}")
    return 0
