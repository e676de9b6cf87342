"""Where the subjects of a study have hinges and crests, and how many a subject shares with another, against chance.
Maps are those that `cohort --space` wrote. Chance is what random rotations of each subject on the sphere give."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from morphofold.cli import add_options, add_threads
from morphofold.cli.streams import print_json, print_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from morphofold.inference.overlap import Overlap

EXAMPLES = ("morphofold overlap study -o shared",)


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", metavar="STUDY", help="folder that cohort --space wrote")
    add_options(parser, ("--space", "NAME", "folder in STUDY/spaces (default: the only one)"))
    parser.add_argument(
        "--radius",
        type=float,
        metavar="MM",
        help="a hinge is shared if the other subject has one within this distance (default: half the crown width)",
    )
    parser.add_argument(
        "--density", type=float, metavar="MM", default=10.0, help="smoothing of the densities (default: 10)"
    )
    parser.add_argument("--hemi", choices=["lh", "rh", "both"], default="both", help="hemispheres (default: both)")
    parser.add_argument("--rotations", type=int, metavar="N", default=1000, help="(default: 1000)")
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the rotations (default: 0)")
    parser.add_argument("-o", "--out", metavar="DIR", default="overlap", help="folder to write (default: overlap)")
    add_options(parser, ("--no-report", None, "table and maps only, no page or pictures"))
    add_threads(parser)
    parser.add_argument("--json", action="store_true", help="print summary.json")


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.inference.overlap import overlap
    from morphofold.inference.overlap_files import overlap_summary, write_overlap
    from morphofold.inference.spaces import find_space
    from morphofold.io import refuse_foreign
    from morphofold.report.pages.study_pages import overlap_report
    from morphofold.threads import set_threads

    set_threads(args.threads)
    space, out = find_space(args.study, args.space), Path(args.out)
    refuse_foreign(out, [space.folder])
    hemis = ("lh", "rh") if args.hemi == "both" else (args.hemi,)
    with progress("overlap", args.quiet) as show:
        found = overlap(
            space,
            radius=args.radius,
            fwhm=args.density,
            hemis=hemis,
            spins=args.rotations,
            seed=args.seed,
            progress=show,
        )
        summary = overlap_summary(space, found, fwhm=args.density, spins=args.rotations, seed=args.seed)
        write_overlap(space, found, summary, out, None if args.no_report else overlap_report)
    if args.json:
        print_json(summary)
    else:
        _print_overlap(found, out)
    return 0


def _print_overlap(found: Sequence[Overlap], out: Path) -> None:
    from morphofold.inference.overlap import WHOLE

    for one in found:
        for row in (row for row in one.rows if row["region"] == WHOLE):
            unit = "" if one.kind == "hinges" else " mm"
            share = "none are shared"
            if row.get("share") is not None:
                share = (
                    f"{row['share']:.0%} shared within {one.radius:.3g} mm, by chance {row['chance']:.0%} "
                    f"({row['chance_low']:.0%} to {row['chance_high']:.0%}), p {row['p']:.3g}"
                )
            print_line(
                f"{one.kind}, {row['hemi']}: {row['amount']:.4g}{unit} in each of {row['subjects']} subjects, {share}"
            )
    page = out / "report.html"
    print_line(f"-> {page if page.is_file() else out}")
