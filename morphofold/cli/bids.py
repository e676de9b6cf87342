"""``morphofold bids``: the FreeSurfer subjects of a BIDS dataset, in the two steps of a BIDS-App."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from morphofold.cli.cohort import by_shown_name, measured_before, run_cohort, run_group
from morphofold.cli.options import Answer, Bids
from morphofold.cohort.covariates import find_covariates
from morphofold.cohort.subjects import find_subjects
from morphofold.cohort.tables import TAKEN_COLUMNS
from morphofold.io.folders import refuse_overlap

FREESURFER_FOLDERS = ("derivatives/freesurfer", "sourcedata/freesurfer", ".")


def run(args: Bids) -> Answer:
    out = args.output_dir
    if args.level == "group":
        covariates = find_covariates(args.participants, [args.bids_dir], TAKEN_COLUMNS)
        return run_group(out, measured_before(out), args, covariates)
    source = _subjects_folder(args)
    refuse_overlap(out, [source])
    everyone = _participant_folders(source, [])
    return run_cohort(_participant_folders(source, args.participant_label), out, args, group=False, everyone=everyone)


def _subjects_folder(args: Bids) -> Path:
    """Folder of the FreeSurfer subjects of the dataset."""
    if args.fs_subjects_dir is not None:
        return args.fs_subjects_dir.absolute()
    dataset = args.bids_dir.absolute()
    if not dataset.is_dir():
        raise FileNotFoundError(f"{dataset}: no such dataset.")
    for folder in (dataset / name for name in FREESURFER_FOLDERS):
        if any(any(folder.glob(subject)) for subject in ("*/surf", "sub-*/ses-*/surf")):
            return folder
    raise FileNotFoundError(
        f"{dataset}: there are no FreeSurfer subjects in {', '.join(FREESURFER_FOLDERS)}. Pass their folder with "
        "--fs-subjects-dir, or run FreeSurfer or fMRIPrep first."
    )


def _participant_folders(source: Path, labels: Sequence[str]) -> dict[str, Path]:
    """Folders of the participants, by name; a participant with several sessions has several."""
    names, _ = find_subjects(source)
    sessions = {
        label: [n for n in names if label in (n, n.partition(".long.")[0], n.partition("_")[0])]
        for label in (f"sub-{label.removeprefix('sub-')}" for label in labels)
    }
    missing = [label for label, its in sessions.items() if not its]
    if missing:
        raise FileNotFoundError(f"{source}: contains no {', '.join(missing)}; it contains {', '.join(names[:8])}.")
    labelled = list(dict.fromkeys(name for its in sessions.values() for name in its))
    return by_shown_name(source, labelled if labels else names)
