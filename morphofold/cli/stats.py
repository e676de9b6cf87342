"""Test a linear model at every vertex of the maps that `cohort --space` wrote. P values are corrected for the whole
cortex by permutations: of single vertices, of clusters, and by threshold-free cluster enhancement."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from morphofold.cli import add_options, add_threads
from morphofold.cli.streams import print_json, print_line
from morphofold.errors import OptionsClash

if TYPE_CHECKING:
    from morphofold.inference.study import Result, Space

EXAMPLES = ('morphofold stats study --model "gyral_thickness ~ age + sex" --contrast age -o age',)


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", metavar="STUDY", help="folder that cohort --space wrote")
    parser.add_argument(
        "--model",
        metavar="MODEL",
        required=True,
        help="map and regressors, columns of the participants: 'gyral_thickness ~ age + sex'; '~ 1' is the mean",
    )
    parser.add_argument(
        "--contrast",
        metavar="C",
        required=True,
        help="what is tested: a regressor (age), weights of columns ('group[T.b] - group[T.c]'), or 1, the intercept",
    )
    add_options(
        parser,
        (
            "--participants",
            "FILE",
            "table with a row for each participant_id (default: STUDY/participants.tsv, else that of cohort)",
        ),
        (
            "--blocks",
            "COLUMN",
            "exchange subjects only within equal values of a column: site, family (default: person, if names show it)",
        ),
        ("--whole-blocks", None, "exchange blocks as wholes, for regressors that are the same within a block"),
        ("--variance-groups", "COLUMN", "groups that may differ in residual variance: Welch's t, and changes of sign"),
        ("--space", "NAME", "folder in STUDY/spaces (default: the only one)"),
    )
    parser.add_argument("--hemi", choices=["lh", "rh", "both"], help="hemispheres (default: both)")
    parser.add_argument(
        "--asymmetry",
        choices=["difference", "index"],
        help="test left - right, or 2 (left - right) / (left + right), on a symmetric template",
    )
    parser.add_argument("--permutations", type=int, metavar="N", default=1000, help="(default: 1000)")
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the permutations (default: 0)")
    parser.add_argument("-o", "--out", metavar="DIR", default="stats", help="folder to write (default: stats)")
    add_options(parser, ("--no-report", None, "tables and maps only, no page or pictures"))
    add_threads(parser)
    parser.add_argument("--json", action="store_true", help="print summary.json")


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.progress import progress
    from morphofold.inference.spaces import find_space
    from morphofold.inference.study import fit_study, summary, write_result
    from morphofold.io import refuse_foreign
    from morphofold.report.pages.study_pages import stats_report
    from morphofold.threads import set_threads

    if args.whole_blocks and args.blocks is None:
        raise OptionsClash("--whole-blocks needs the column that names the blocks. Pass --blocks COLUMN, too.")
    if args.asymmetry and args.hemi:
        raise OptionsClash("--asymmetry compares both hemispheres. Leave out --hemi.")
    set_threads(args.threads)
    space = find_space(args.study, args.space)
    participants = _participants(args, space)
    refuse_foreign(Path(args.out), [space.folder])
    hemis = (args.hemi,) if args.hemi in ("lh", "rh") else ("lh", "rh")
    with progress("stats", args.quiet) as show:
        found = fit_study(
            space,
            participants,
            args.model,
            args.contrast,
            blocks=args.blocks,
            whole=args.whole_blocks,
            variance_groups=args.variance_groups,
            hemis=hemis,
            asymmetry=args.asymmetry,
            permutations=args.permutations,
            seed=args.seed,
            progress=show,
        )
        write_result(found, args.out, [participants], report=None if args.no_report else stats_report)
    if args.json:
        print_json(summary(found, [participants]))
    else:
        _print_result(found, Path(args.out))
    return 0


def _participants(args: argparse.Namespace, space: Space) -> Path:
    """The table of participants: the one given, that of the study, or the one that cohort wrote with its maps."""
    usual, of_maps = Path(args.study) / "participants.tsv", space.folder / "participants.tsv"
    if args.participants is not None:
        return Path(args.participants)
    return of_maps if space.covariates and not usual.is_file() else usual


def _print_result(found: Result, out: Path) -> None:
    from morphofold.inference.study import cluster_rows, summary

    said = summary(found)
    subjects, vertices = len(found.design.subjects), said["vertices"]
    print_line(
        f"{found.shown} ~ {found.formula}, {found.contrast}: {subjects} subjects, {vertices['tested']:,} of "
        f"{vertices['all']:,} vertices, {found.inference.df} degrees of freedom"
    )
    for reason, names in said["left_out"].items():
        if names:
            print_line(f"left out ({reason}): {', '.join(names[:5])}{' ...' * (len(names) > 5)}")
    for remark in said["remarks"]:
        print_line(f"remark: {remark}")
    areas = said["significant_area_mm2"]
    print_line(
        f"corrected p <= 0.05: {areas['p_tfce']:.0f} mm2 by TFCE (smallest p {said['smallest_p']['p_tfce']:.3g}), "
        f"{areas['p_height']:.0f} mm2 by height ({said['smallest_p']['p_height']:.3g})"
    )
    for row in [row for row in cluster_rows(found) if row["p"] <= 0.05][:5]:
        print_line(
            f"cluster {row['cluster']}, {row['hemi']} {row['region'] or ''}: {row['area_mm2']:.0f} mm2, effect "
            f"{row['effect']:.3g}, t {row['t']:.2f}, p {row['p']:.3g}"
        )
    page = out / "report.html"
    print_line(f"-> {page if page.is_file() else out}")
