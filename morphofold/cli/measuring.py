"""How a surface is measured: the options that analyze, cohort, bids and sweep have in common."""

from __future__ import annotations

import argparse


def add_measuring_args(parser: argparse.ArgumentParser) -> None:
    """--curvature-scale, --gyral-width, --thickness-cap and --accuracy."""
    parser.add_argument(
        "--curvature-scale", type=float, metavar="MM",
        help="radius of curvature neighbourhoods (default: 3, more on coarse meshes)",
    )  # fmt: skip
    parser.add_argument(
        "--gyral-width", type=float, metavar="MM",
        help="lengths of the gyral net are shares of it; hold it to compare hinges of meshes of one brain, or of a "
        "group (default: from each surface)",
    )  # fmt: skip
    parser.add_argument(
        "--thickness-cap", type=float, metavar="MM",
        help="upper bound of cortical thickness; FreeSurfer's is 5 (default: none)",
    )  # fmt: skip
    parser.add_argument(
        "--accuracy", choices=["draft", "standard", "fine"], default="standard",
        help="draft: thicknesses and the gyral net are of a thinned copy of a mesh of more than 50,000 vertices; fine: "
        "of a split one of a mesh of less than 40,000 (default: standard, of the mesh as it is)",
    )  # fmt: skip


def measuring_options(args: argparse.Namespace) -> dict[str, float | str | None]:
    """What was asked for, as results record it; the standard accuracy and no cap go without saying, so that those of
    older runs stay. Raises ``ValueError`` for what is no length."""
    for option in ("--curvature-scale", "--gyral-width", "--thickness-cap"):
        length = getattr(args, option[2:].replace("-", "_"))
        if length is not None and not 0 < length < float("inf"):
            raise ValueError(f"{option} {length:g}: is no length. Pass a positive number of mm, or leave it out.")
    asked = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    if args.thickness_cap is not None:
        asked["thickness_cap_mm"] = args.thickness_cap
    return asked if args.accuracy == "standard" else {**asked, "accuracy": args.accuracy}
