"""Unfold a cortex to a smooth surface with the same vertices, by heat flow on its sphere: the body that it would have
grown from, and where its area comes from."""

from __future__ import annotations

import argparse
from pathlib import Path

from morphofold.cli import add_options
from morphofold.cli.measuring import add_side_args
from morphofold.cli.streams import print_file, print_line
from morphofold.progress import part_of

EXAMPLES = ("morphofold unfold $SUBJECTS_DIR/bert -o bert-unfolded",)


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "input", metavar="INPUT", help="folder of a FreeSurfer subject, or a file with a closed surface"
    )
    add_side_args(parser, "INPUT", parcellation=False)
    parser.add_argument(
        "--level",
        type=float,
        metavar="W",
        default=0.03,
        help="time of the heat flow on the unit sphere, 0.005 to 0.3; 0.02 keeps hints of the largest sulci, 0.08 only "
        "the shape of the hemisphere (default: 0.03)",
    )
    parser.add_argument(
        "--radius",
        type=float,
        metavar="MM",
        help="scale the smooth surface to the area of this sphere (default: as is)",
    )
    add_options(
        parser,
        ("--surface", "NAME", "folded surface, surf/?h.NAME (default: white)"),
        (
            "--sphere",
            "NAME",
            "its sphere, surf/?h.NAME, or a file if INPUT is one (default: sphere; where there is none, one is made, "
            "which takes two minutes for 150,000 vertices)",
        ),
        ("-o --out", "DIR", "folder to write (default: NAME-unfolded here)"),
        ("--json", None, "print summary.json"),
    )


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.paths import writable_name
    from morphofold.cli.progress import progress
    from morphofold.io import refuse_foreign
    from morphofold.io.cortices import hemispheres
    from morphofold.io.files import side_named
    from morphofold.io.folded import read_folded
    from morphofold.mesh_quality.repair import unfoldable
    from morphofold.report.pages.study_pages import unfold_report
    from morphofold.results.unfolding import Unfolded, write_unfolding
    from morphofold.unfolding.spheres import sphere_of
    from morphofold.unfolding.unfold import check_options, unfold

    check_options(args.level, args.radius)
    source = Path(args.input)
    found = hemispheres(source) if source.is_dir() else (side_named(source.name) or "lh",)
    hemis = ("lh", "rh") if args.hemi == "both" else (args.hemi,) if args.hemi else found
    with progress("unfold", args.quiet) as show:
        show(0.0, "reading")
        read = [unfoldable(read_folded(source, hemi, surface=args.surface, sphere=args.sphere)) for hemi in hemis]
        out = Path(args.out or f"{writable_name(read[0].cortex.name)}-unfolded")
        refuse_foreign(out, [source])
        unfolded = []
        for k, one in enumerate(read):
            white, sphere = one.cortex.white, one.cortex.sphere
            share = part_of(show, 0.1 + 0.5 * k / len(read), 0.5 / len(read), f"{one.cortex.hemi}: ")
            share(0.0, "heat flow")
            unfolded.append(
                Unfolded(one, unfold(white, sphere or sphere_of(white, share), args.level, radius=args.radius))
            )
        show(0.6, "writing")
        summary = write_unfolding(unfolded, out, unfold_report)
        show(1.0, "done")
    if args.json:
        print_file(out / "summary.json")
        return 0
    for row in summary["hemispheres"]:
        print_line(
            f"{summary['name']} {row['hemi']}: {row['folded_area_mm2']:,.0f} mm2 folded, {row['area_mm2']:,.0f} mm2 "
            f"smooth; a cortex of up to {row['thickest_cortex_mm']:.2g} mm fits"
        )
        for key, note in summary["notes"][row["hemi"]].items():
            print_line(f"warning: {note} [{key}]")
    print_line(f"-> {out / 'report.html'}")
    return 0
