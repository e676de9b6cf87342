"""Put analyses side by side: one page with the same colours, bins and axes for all."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from morphofold.cli.streams import print_file, print_line
from morphofold.errors import NamedTwice, NotReadable
from morphofold.progress import part_of

EXAMPLES = ("morphofold compare model=fig5-analysis MRI=average -o both",)


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "analyses",
        metavar="NAME=DIR",
        nargs="+",
        help="a name, and a folder that analyze wrote (in the BIDS layout DATASET/sub-NAME)",
    )
    parser.add_argument("-o", "--out", metavar="DIR", default="comparison", help="folder (default: comparison)")
    parser.add_argument(
        "--group",
        metavar="GROUP=NAME,NAME",
        action="append",
        default=[],
        help="pool the hinges of these analyses, and compare them with other groups; once per group",
    )
    parser.add_argument(
        "--growth",
        metavar="NAME=DIR",
        action="append",
        default=[],
        help="a folder that analyze --stages wrote: draw its numbers over growth; once per body",
    )
    parser.add_argument(
        "--colour",
        metavar="NAME=RRGGBB",
        action="append",
        default=[],
        help="colour of an analysis or a group, as 0072b2; once per colour (default: one per group)",
    )
    parser.add_argument(
        "--spins",
        type=int,
        metavar="N",
        default=500,
        help="rotations of the sphere that test a cortex against the folds of the person it grew from, if both are "
        "compared (default: 500)",
    )
    parser.add_argument("--json", action="store_true", help="print comparison.json")


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.comparison import compare
    from morphofold.io import refuse_foreign
    from morphofold.provenance import printable
    from morphofold.report.pages.person_section import VERDICT_WORDS
    from morphofold.results import read_analysis, read_stages

    named: dict[str, str] = {}
    for item in args.analyses:
        name, equals, folder = item.partition("=")
        if not equals or not name or not folder:
            raise NotReadable(f"{item!r} must have the form NAME=DIR, for example model=fig5-analysis.")
        name = printable(name)
        if name in named:
            raise NamedTwice(f"the name {name!r} is given twice; every analysis needs its own.")
        named[name] = folder
    groups = _by_unique_name("--group", [_parse_group(item) for item in args.group]) or None
    colours = _by_unique_name("--colour", [_parse_colour(item) for item in args.colour])
    grown = _by_unique_name("--growth", [_parse_growth_folder(item) for item in args.growth])
    refuse_foreign(Path(args.out), [*named.values(), *grown.values()])  # refuses before minutes of work
    with progress("compare", args.quiet) as show:
        measures = {}
        for i, (name, folder) in enumerate(named.items()):
            show(0.15 * i / len(named), f"reading {name}")
            measures[name] = read_analysis(folder)
        stages = {name: read_stages(folder) for name, folder in grown.items()}
        show(0.15, "comparing")
        comparison = compare(measures, groups=groups, growth=stages, colours=colours, spins=args.spins)
        page = comparison.report(args.out, progress=part_of(show, 0.25, 0.75))
        show(1.0, "done")
    if args.json:
        print_file(page.with_name("comparison.json"))
        return 0
    for row in comparison.table:
        if row["measure"] in ("gyrification_index", "mean_cortical_thickness_mm", "median_gyral_thickness_mm"):
            values = ", ".join(f"{n} {'n/a' if row[n] is None else f'{row[n]:.2f}'}" for n in comparison.names)
            print_line(f"{row['measure']}: {values}")
    for found in comparison.people:
        depth = found.agreements[0].tested
        print_line(
            f"{found.grown} has gyri and sulci where {found.person} has them on {depth.value:.3f} of the area, before "
            f"growth {depth.control:.3f}, with deepened sulci {found.agreements[0].deepened.control:.3f}: "
            f"{VERDICT_WORDS.get(found.verdict, found.verdict)}"
        )
    print_line(f"-> {page}")
    return 0


def _by_unique_name(option: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    from morphofold.provenance import printable

    found = {printable(name): value for name, value in pairs}
    if len(found) < len(pairs):
        raise NamedTwice(f"{option}: a name is given twice among {', '.join(name for name, _ in pairs)}; give it once.")
    return found


def _parse_group(item: str) -> tuple[str, list[str]]:
    group, equals, names = item.partition("=")
    if not equals or not group or not all(names.split(",")):
        raise NotReadable(f"--group {item!r} must have the form GROUP=NAME,NAME, for example model=thin,thick.")
    from morphofold.provenance import printable

    return group, printable(names).split(",")


def _parse_colour(item: str) -> tuple[str, str]:
    name, equals, colour = item.rpartition("=")
    if not equals or not name:
        raise NotReadable(f"--colour {item!r} must have the form NAME=RRGGBB, for example model=0072b2.")
    return name, "#" + colour.removeprefix("#")


def _parse_growth_folder(item: str) -> tuple[str, str]:
    name, equals, folder = item.partition("=")
    if not equals or not name or not folder:
        raise NotReadable(f"--growth {item!r} must have the form NAME=DIR, for example fig5=fig5-growth.")
    return name, folder
