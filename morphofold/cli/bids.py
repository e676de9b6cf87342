"""Measure the FreeSurfer subjects of a BIDS dataset. It is called like a BIDS-App: `participant` measures subjects,
`group` writes tables and a page of all results. The same as cohort --layout bids, in two steps."""

from __future__ import annotations

import argparse
from pathlib import Path

from morphofold.cli.cohort import add_group_args, add_participants_arg
from morphofold.cli.measuring import add_side_args

EXAMPLES = (
    "morphofold bids data data/derivatives/morphofold participant --participant-label 01 02",
    "morphofold bids data data/derivatives/morphofold group",
)
FREESURFER_FOLDERS = ("derivatives/freesurfer", "sourcedata/freesurfer", ".")


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bids_dir", metavar="BIDS_DIR", help="dataset")
    parser.add_argument("output_dir", metavar="OUTPUT_DIR", help="derivatives dataset to write")
    parser.add_argument("level", choices=["participant", "group"], help="step to run")
    parser.add_argument(
        "--participant-label", metavar="LABEL", nargs="+", default=[], help="participants, without sub- (default: all)"
    )
    parser.add_argument(
        "--fs-subjects-dir",
        metavar="DIR",
        help="folder of the FreeSurfer subjects (default: derivatives/freesurfer or sourcedata/freesurfer in BIDS_DIR, "
        "or BIDS_DIR itself)",
    )
    add_side_args(parser, "each subject")
    add_participants_arg(parser, "BIDS_DIR")
    add_group_args(parser)
    parser.set_defaults(layout="bids")


def run(args: argparse.Namespace) -> int:
    from morphofold.cli.cohort import measured_before, run_cohort, run_group
    from morphofold.cohort.covariates import find_covariates
    from morphofold.cohort.tables import TAKEN_COLUMNS
    from morphofold.io.folders import refuse_overlap

    out = Path(args.output_dir)
    if args.level == "group":
        results = measured_before(out, bids=True)
        return run_group(out, results, args, find_covariates(args.participants, [Path(args.bids_dir)], TAKEN_COLUMNS))
    source = _subjects_folder(args)
    refuse_overlap(out, [source])
    everyone = _participant_folders(source, [])
    return run_cohort(_participant_folders(source, args.participant_label), out, args, group=False, everyone=everyone)


def _subjects_folder(args: argparse.Namespace) -> Path:
    """Folder of the FreeSurfer subjects of the dataset."""
    if args.fs_subjects_dir is not None:
        return Path(args.fs_subjects_dir).absolute()
    folder = Path(args.bids_dir).absolute()
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such dataset.")
    for place in FREESURFER_FOLDERS:
        if any(any(folder.joinpath(place).glob(found)) for found in ("*/surf", "sub-*/ses-*/surf")):
            return folder / place
    raise FileNotFoundError(
        f"{folder}: there are no FreeSurfer subjects in {', '.join(FREESURFER_FOLDERS)}. Pass their folder with "
        "--fs-subjects-dir, or run FreeSurfer or fMRIPrep first."
    )


def _participant_folders(source: Path, labels: list[str]) -> dict[str, Path]:
    """Folders of the participants, by name; a participant with several sessions has several."""
    from morphofold.cli.cohort import by_shown_name
    from morphofold.cohort.subjects import find_subjects

    names, _ = find_subjects(source)
    found = {
        label: [n for n in names if label in (n, n.partition(".long.")[0], n.partition("_")[0])]
        for label in map(_with_sub_prefix, labels)
    }
    missing = [label for label, its in found.items() if not its]
    if missing:
        raise FileNotFoundError(f"{source}: contains no {', '.join(missing)}; it contains {', '.join(names[:8])}.")
    return by_shown_name(source, list(dict.fromkeys(n for its in found.values() for n in its)) if labels else names)


def _with_sub_prefix(label: str) -> str:
    return f"sub-{label.removeprefix('sub-')}"
