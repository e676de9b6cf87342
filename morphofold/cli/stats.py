"""``morphofold stats``: fit a model at every vertex, write the result, print its summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from morphofold.cli.options import Answer, Stats, sides
from morphofold.cli.progress import progress
from morphofold.inference.spaces import find_space
from morphofold.inference.study import Result, Space, cluster_rows, fit_study, summary, write_result
from morphofold.io import refuse_foreign
from morphofold.report.pages.study_pages import stats_report


def run(args: Stats) -> Answer:
    space = find_space(args.study, args.space)
    participants = args.participants or _usual_participants(args.study, space)
    refuse_foreign(args.out, [space.folder])
    with progress("stats", args.quiet) as show:
        result = fit_study(
            space,
            participants,
            args.model,
            args.contrast,
            blocks=args.blocks,
            whole=args.whole_blocks,
            variance_groups=args.variance_groups,
            hemis=sides(args.hemi),
            asymmetry=args.asymmetry,
            permutations=args.permutations,
            seed=args.seed,
            progress=show,
        )
        write_result(result, args.out, [participants], report=None if args.no_report else stats_report)
    content = summary(result, [participants])
    return Answer(content, [*_lines(result, content), f"-> {args.out if args.no_report else args.out / 'report.html'}"])


def _usual_participants(study: Path, space: Space) -> Path:
    """The table of participants of the study, or the one that cohort wrote with its maps."""
    usual, of_maps = study / "participants.tsv", space.folder / "participants.tsv"
    return of_maps if space.covariates and not usual.is_file() else usual


def _lines(result: Result, numbers: Mapping[str, Any]) -> Iterator[str]:
    subjects, vertices = len(result.design.subjects), numbers["vertices"]
    yield (
        f"{result.shown} ~ {result.formula}, {result.contrast}: {subjects} subjects, {vertices['tested']:,} of "
        f"{vertices['all']:,} vertices, {result.inference.df} degrees of freedom"
    )
    for reason, names in numbers["left_out"].items():
        if names:
            yield f"left out ({reason}): {', '.join(names[:5])}{' ...' * (len(names) > 5)}"
    yield from (f"remark: {remark}" for remark in numbers["remarks"])
    areas, p = numbers["significant_area_mm2"], numbers["smallest_p"]
    yield (
        f"corrected p <= 0.05: {areas['p_tfce']:.0f} mm2 by TFCE (smallest p {p['p_tfce']:.3g}), "
        f"{areas['p_height']:.0f} mm2 by height ({p['p_height']:.3g})"
    )
    for row in [row for row in cluster_rows(result) if row["p"] <= 0.05][:5]:
        yield (
            f"cluster {row['cluster']}, {row['hemi']} {row['region'] or ''}: {row['area_mm2']:.0f} mm2, effect "
            f"{row['effect']:.3g}, t {row['t']:.2f}, p {row['p']:.3g}"
        )
