"""``morphofold overlap``: where subjects have hinges and crests, and how many they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from morphofold.cli.options import Answer, sides
from morphofold.cli.options import Overlap as Options
from morphofold.cli.progress import progress
from morphofold.inference.overlap import WHOLE, Overlap, overlap
from morphofold.inference.overlap_files import overlap_summary, write_overlap
from morphofold.inference.spaces import find_space
from morphofold.io import refuse_foreign
from morphofold.report.pages.study_pages import overlap_report


def run(args: Options) -> Answer:
    space = find_space(args.study, args.space)
    refuse_foreign(args.out, [space.folder])
    chance: dict[str, int] = {"spins": args.rotations, "seed": args.seed}
    with progress("overlap", args.quiet) as show:
        results = overlap(space, radius=args.radius, fwhm=args.density, hemis=sides(args.hemi), progress=show, **chance)
        summary = overlap_summary(space, results, fwhm=args.density, **chance)
        write_overlap(space, results, summary, args.out, None if args.no_report else overlap_report)
    return Answer(summary, [*_lines(results), f"-> {args.out if args.no_report else args.out / 'report.html'}"])


def _lines(results: Sequence[Overlap]) -> Iterator[str]:
    for result in results:
        for row in (row for row in result.rows if row["region"] == WHOLE):
            unit = "" if result.kind == "hinges" else " mm"
            share = "none are shared"
            if row.get("share") is not None:
                share = (
                    f"{row['share']:.0%} shared within {result.radius:.3g} mm, by chance {row['chance']:.0%} "
                    f"({row['chance_low']:.0%} to {row['chance_high']:.0%}), p {row['p']:.3g}"
                )
            amount = f"{row['amount']:.4g}{unit} in each of {row['subjects']} subjects"
            yield f"{result.kind}, {row['hemi']}: {amount}, {share}"
