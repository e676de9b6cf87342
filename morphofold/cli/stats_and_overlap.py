"""``morphofold stats`` and ``overlap``: compare the maps of a study's subjects on a template, and print the result."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from morphofold.cli import command_options
from morphofold.cli.command_options import Answer, Stats, sides
from morphofold.cli.terminal_output import progress
from morphofold.group.map_statistics import Result, Space, cluster_rows, fit_study, summary, write_result
from morphofold.group.overlap import WHOLE, Overlap, overlap, overlap_summary, write_overlap
from morphofold.group.spaces import find_space
from morphofold.group_pages.stats_pages import overlap_report, stats_report
from morphofold.io import refuse_foreign


def run(args: Stats | command_options.Overlap) -> Answer:
    space = find_space(args.study, args.space)
    refuse_foreign(args.out, [space.folder])
    if args.hemi == "both" and len(space.hemis) == 1:  # of a template of one hemisphere
        args.hemi = "lh" if "lh" in space.hemis else "rh"
    answer = _stats(args, space) if isinstance(args, Stats) else _overlap(args, space)
    page = args.out if args.no_report else args.out / "report.html"
    return answer._replace(lines=[*answer.lines, f"-> {page}"])


def _stats(args: Stats, space: Space) -> Answer:
    study_file, space_file = args.study / "participants.tsv", space.folder / "participants.tsv"
    is_enough = space.covariates or args.model.partition("~")[2].strip() == "1"
    participants = args.participants or (space_file if is_enough and not study_file.is_file() else study_file)
    with progress("stats", args.quiet) as on_progress:
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
            progress=on_progress,
        )
        write_result(result, args.out, [participants], report=None if args.no_report else stats_report)
    content = summary(result, [participants])
    return Answer(content, _stats_lines(result, content))


def _stats_lines(result: Result, content: Mapping[str, Any]) -> Iterator[str]:
    n_subjects, vertex_counts = len(result.design.subjects), content["vertices"]
    yield (
        f"{result.shown} ~ {result.formula}, {result.contrast}: {n_subjects} subjects, {vertex_counts['tested']:,} of "
        f"{vertex_counts['all']:,} vertices, {result.inference.df} degrees of freedom"
    )
    for reason, names in content["left_out"].items():
        if names:
            yield f"left out ({reason}): {', '.join(names[:5])}{' ...' * (len(names) > 5)}"
    yield from (f"remark: {remark}" for remark in content["remarks"])
    significant_areas, smallest_p = content["significant_area_mm2"], content["smallest_p"]
    yield (
        f"corrected p <= 0.05: {significant_areas['p_tfce']:.0f} mm2 by TFCE (smallest p {smallest_p['p_tfce']:.3g}), "
        f"{significant_areas['p_height']:.0f} mm2 by height ({smallest_p['p_height']:.3g})"
    )
    for row in [row for row in cluster_rows(result) if row["p"] <= 0.05][:5]:
        yield (
            f"cluster {row['cluster']}, {row['hemi']} {row['region'] or ''}: {row['area_mm2']:.0f} mm2, effect "
            f"{row['effect']:.3g}, t {row['t']:.2f}, p {row['p']:.3g}"
        )


def _overlap(args: command_options.Overlap, space: Space) -> Answer:
    spin: dict[str, int] = {"spins": args.rotations, "seed": args.seed}
    with progress("overlap", args.quiet) as update:
        results = overlap(space, radius=args.radius, fwhm=args.density, hemis=sides(args.hemi), progress=update, **spin)
        content = overlap_summary(space, results, fwhm=args.density, **spin)
        write_overlap(space, results, content, args.out, None if args.no_report else overlap_report)
    return Answer(content, _overlap_lines(results))


def _overlap_lines(results: Sequence[Overlap]) -> Iterator[str]:
    for result in results:
        for row in (row for row in result.rows if row["region"] == WHOLE):
            unit = "" if result.kind == "hinges" else " mm"
            sharing_text = "none are shared"
            if row.get("share") is not None:
                sharing_text = (
                    f"{row['share']:.0%} shared within {result.radius:.3g} mm, by chance {row['chance']:.0%} "
                    f"({row['chance_low']:.0%} to {row['chance_high']:.0%}), p {row['p']:.3g}"
                )
            amount_text = f"{row['amount']:.4g}{unit} in each of {row['subjects']} subjects"
            yield f"{result.kind}, {row['hemi']}: {amount_text}, {sharing_text}"
