"""Reproduce figures of the paper (Razavi et al. 2015), each with the table of its points, and an index of them all."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from morphofold.cli import add_threads
from morphofold.cli.streams import print_file
from morphofold.errors import OptionsClash, UnknownName

EXAMPLES = ("morphofold reproduce fig3 fig4 -o theory", "morphofold reproduce all -o reproduce --draft")
#: figure -> what it shows; report/paper.py draws them
FIGURES = {
    "fig3": "outer radius against growth, tangential stress through the cortex (theory and finite elements)",
    "fig4": "growth at which creases can form (theory)",
    "fig5": "a sphere folding, six stages (simulation)",
    "fig6": "thin, normal and thick cortex, three stages (simulations)",
    "fig7": "shear moduli 1, 2 and 4 to 1, three stages (simulations)",
    "fig8": "gyral against cortical thickness of brains and models (MRI, simulations)",
    "fig9": "three-hinge patterns of models and of a person (MRI, simulations)",
    "fig8-grown": "Fig. 8 by experiment: hemispheres with an even cortex and with their own thickness (20 simulations)",
}
GROWN = "fig8-grown"
NOT_IN_ALL = (GROWN,)  # it takes an hour


def add_args(parser: argparse.ArgumentParser) -> None:
    shown = "; ".join(f"{name}: {words}" for name, words in FIGURES.items())
    parser.add_argument(
        "figures", metavar="FIGURE", nargs="+", help=f"{shown}; or all, which leaves out {', '.join(NOT_IN_ALL)}"
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="DIR",
        default="reproduce",
        help="folder to write; figures and simulations of an earlier run there are kept (default: reproduce)",
    )
    parser.add_argument(
        "--draft",
        action="store_true",
        help="octants on coarser meshes, tables of the growths that are drawn: three minutes on two cores",
    )
    parser.add_argument(
        "--subject",
        metavar="DIR",
        action="append",
        help=f"a FreeSurfer subject whose hemispheres are grown for {GROWN} instead of fsaverage5's; may be repeated",
    )
    add_threads(parser)
    parser.add_argument("--json", action="store_true", help="print summary.json")


def run(args: argparse.Namespace) -> int:
    every = [name for name in FIGURES if name not in NOT_IN_ALL] if "all" in args.figures else []
    figures = list(dict.fromkeys([*every, *(name for name in args.figures if name != "all")]))
    for name in figures:
        if name not in FIGURES:
            raise UnknownName(f"{name!r} is not a figure that can be reproduced; there are {', '.join(FIGURES)}.")
    if args.subject and GROWN not in figures:
        raise OptionsClash(f"--subject is for {GROWN}, which is not drawn. Name it, or leave --subject out.")
    from morphofold import __version__
    from morphofold.cli.runs import Runs
    from morphofold.io import atomic_folder, refuse_foreign
    from morphofold.io.folders import alone
    from morphofold.provenance import sha256_of, strict_json
    from morphofold.studies.indexes import keep_figures
    from morphofold.studies.paper import REPRODUCTIONS
    from morphofold.studies.paper.report import write_paper_report

    out = Path(args.out)
    runs = Runs(out, draft=args.draft, threads=args.threads, quiet=args.quiet)
    args.on_interrupt = " Run it again to go on."
    refuse_foreign(out)
    place = Path(os.path.realpath(out))
    # the lock is beside the folder, which is replaced: figures that another run drew meanwhile would be lost
    with alone(place.parent, f".{place.name}.lock"), atomic_folder(out) as folder:
        kept = keep_figures(out, folder, FIGURES, figures)
        drawn = {}
        for name in figures:
            begun, growing = time.perf_counter(), runs.seconds_growing
            own = {"subjects": args.subject} if name == GROWN and args.subject else {}
            entry = REPRODUCTIONS[name](folder, runs, **own)
            seconds = time.perf_counter() - begun - (runs.seconds_growing - growing)
            digests = {file: sha256_of(folder / file) for file in entry["files"]}
            drawn[name] = {"morphofold": __version__, "seconds": round(seconds, 2), **entry, "sha256": digests}
        index = {
            "morphofold": __version__,
            "paper": "Razavi et al. 2015, Phys. Rev. E 92, 032701",
            "lengths": "mm; the paper gives none, and only ratios matter",
            "figures": {**kept, **drawn},
        }
        (folder / "summary.json").write_text(strict_json(index), encoding="utf-8")
        write_paper_report(folder, index)
    if args.json:
        print_file(out / "summary.json")
        return 0
    for name in figures:
        print(f"{name}: {FIGURES[name]}")
        for entry in drawn[name].get("simulations", ()):
            for warning in entry["warnings"]:
                print(f"{name}: warning: {entry['scene']}: {warning}")
    for name in kept:
        print(f"{name}: kept from an earlier run")
    print(f"-> {out / 'report.html'}")
    return 0
