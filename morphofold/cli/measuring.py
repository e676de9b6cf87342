"""How a surface is measured: the options that analyze, cohort, bids and sweep have in common."""

from __future__ import annotations

import argparse
from typing import Any

from morphofold.errors import OutOfRange

LENGTHS = {
    "--curvature-scale": "radius of curvature neighbourhoods (default: 3, more on coarse meshes; "
    "of a group, one for all)",
    "--gyral-width": "lengths of the gyral net are shares of it; hold it to compare hinges of several meshes "
    "(default: from each surface; of a group, their median)",
    "--thickness-cap": "upper bound of cortical thickness; FreeSurfer's is 5 (default: none)",
}
SHORTEST, LONGEST = 1e-9, 1e9  # of what may be meant for a length, in any unit
SIDES = {"lh": "lh", "l": "lh", "left": "lh", "rh": "rh", "r": "rh", "right": "rh", "both": "both"}


def add_measuring_args(parser: argparse.ArgumentParser) -> None:
    """--curvature-scale, --gyral-width, --thickness-cap, --accuracy and --no-repair."""
    for option, words in LENGTHS.items():
        parser.add_argument(option, type=float, metavar="MM", help=words)
    parser.add_argument(
        "--accuracy",
        choices=["draft", "standard", "fine"],
        default="standard",
        help="draft: thicknesses and the gyral net are of a thinned copy of a mesh of more than 50,000 vertices; fine: "
        "of a split one of a mesh of less than 40,000 (default: standard, of the mesh as it is)",
    )
    parser.add_argument(
        "--no-repair",
        dest="repair",
        action="store_false",
        help="refuse surfaces with flipped triangles, pinched edges, torn seams and the like (default: they are mended "
        "first, and what was mended is told)",
    )


def add_side_args(parser: argparse.ArgumentParser, who: str) -> None:
    """--hemi and --annot."""
    parser.add_argument(
        "--hemi", metavar="{lh,rh,both}", type=_side, help=f"left, right or both (default: those that {who} has)"
    )
    parser.add_argument(
        "--annot",
        metavar="NAME",
        help="parcellation, label/?h.NAME.annot, as aparc.a2009s (default: aparc, where it is there)",
    )


def _side(word: str) -> str:
    """A hemisphere as FreeSurfer spells it, from any spelling of it."""
    if word.lower() not in SIDES:
        raise argparse.ArgumentTypeError(f"{word!r} is no hemisphere. Pass lh, rh or both.")
    return SIDES[word.lower()]


def measuring_options(args: argparse.Namespace) -> dict[str, Any]:
    """What was asked for, as results record it; standard accuracy, parcellation and repair, and no
    cap, go without saying, so that those of older runs stay. Raises ``OutOfRange`` for what is no length."""
    for option in LENGTHS:
        length = getattr(args, option[2:].replace("-", "_"))
        if length is not None and not SHORTEST <= length <= LONGEST:
            raise OutOfRange(f"{option} {length:g}: is no length. Pass a positive number of mm, or leave it out.")
    asked: dict[str, Any] = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    asked |= {} if args.thickness_cap is None else {"thickness_cap_mm": args.thickness_cap}
    asked |= {} if args.accuracy == "standard" else {"accuracy": args.accuracy}
    asked |= {} if args.repair else {"repair": False}
    return asked if getattr(args, "annot", None) is None else {**asked, "annotation": args.annot}
