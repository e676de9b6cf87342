"""Options of measuring a surface, which analyze, cohort, bids and sweep have in common."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from morphofold.errors import OutOfRange

LENGTH_OPTIONS = {
    "--curvature-scale": "radius of the neighbourhoods for curvature (default: 3, more on coarse meshes; "
    "in a group, one for all)",
    "--gyral-width": "crown width, to which the lengths of the gyral graph are proportional; set it to compare hinges "
    "of several meshes (default: from each surface; in a group, their median)",
    "--thickness-cap": "upper bound of cortical thickness; FreeSurfer's is 5 (default: none)",
}
SHORTEST_LENGTH, LONGEST_LENGTH = 1e-9, 1e9  # limits of a plausible length, in any unit
HEMISPHERE_SPELLINGS = {"lh": "lh", "l": "lh", "left": "lh", "rh": "rh", "r": "rh", "right": "rh", "both": "both"}


def add_measuring_args(parser: argparse.ArgumentParser) -> None:
    """--curvature-scale, --gyral-width, --thickness-cap, --accuracy and --no-repair."""
    for option, words in LENGTH_OPTIONS.items():
        parser.add_argument(option, type=float, metavar="MM", help=words)
    parser.add_argument(
        "--accuracy",
        choices=["draft", "standard", "fine"],
        default="standard",
        help="mesh for thicknesses and gyral graph. draft: meshes of more than 50,000 vertices are thinned; fine: "
        "meshes of less than 40,000 are split; standard: the mesh as it is (default: standard)",
    )
    parser.add_argument(
        "--no-repair",
        dest="repair",
        action="store_false",
        help="refuse surfaces with flipped triangles, pinched edges, torn seams and similar defects (default: they are "
        "repaired first, and the repairs are reported)",
    )


def add_side_args(parser: argparse.ArgumentParser, who: str, *, parcellation: bool = True) -> None:
    """--hemi, and --annot and --annot-from if regions are measured."""
    parser.add_argument(
        "--hemi",
        metavar="{lh,rh,both}",
        type=_hemisphere_of_spelling,
        help=f"left, right or both (default: the hemispheres of {who})",
    )
    if parcellation:
        parser.add_argument(
            "--annot",
            metavar="NAME",
            help="parcellation, label/?h.NAME.annot, such as aparc.a2009s (default: aparc, if it exists)",
        )
        parser.add_argument(
            "--annot-from",
            metavar="TEMPLATE",
            help="without that file, carry the parcellation over from a template by ?h.sphere.reg: fsaverage5, or the "
            "folder of another",
        )


def _hemisphere_of_spelling(word: str) -> str:
    """FreeSurfer's spelling of a hemisphere, from any spelling."""
    if word.lower() not in HEMISPHERE_SPELLINGS:
        raise argparse.ArgumentTypeError(f"{word!r} is not a hemisphere. Pass lh, rh or both.")
    return HEMISPHERE_SPELLINGS[word.lower()]


def measuring_options(args: argparse.Namespace) -> dict[str, Any]:
    """Options as results record them. Standard accuracy, parcellation and repair, and no cap, are not recorded, so that
    results of older runs stay valid. Raises ``OutOfRange`` for an implausible length."""
    for option in LENGTH_OPTIONS:
        length = getattr(args, option[2:].replace("-", "_"))
        if length is not None and not SHORTEST_LENGTH <= length <= LONGEST_LENGTH:
            raise OutOfRange(f"{option} {length:g}: is not a length. Pass a positive number of mm, or leave it out.")
    asked: dict[str, Any] = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    asked |= {} if args.thickness_cap is None else {"thickness_cap_mm": args.thickness_cap}
    asked |= {} if args.accuracy == "standard" else {"accuracy": args.accuracy}
    asked |= {} if args.repair else {"repair": False}
    asked |= {} if getattr(args, "annot", None) is None else {"annotation": args.annot}
    return asked | _template_option(args)


def _template_option(args: argparse.Namespace) -> dict[str, Any]:
    """The template of --annot-from: the name of a sample, or the path of a folder; raises if it has no parcellation."""
    from morphofold.spheres.parcellation import check_template

    if getattr(args, "annot_from", None) is None:
        return {}
    folder = check_template(args.annot_from, args.annot)
    return {"annotation_from": str(folder) if Path(args.annot_from).is_dir() else args.annot_from}
