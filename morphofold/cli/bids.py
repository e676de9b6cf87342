"""``morphofold bids``: the FreeSurfer subjects of a BIDS dataset, in the two steps of a BIDS-App."""

from __future__ import annotations

from pathlib import Path

from morphofold.cli.cohort import participants_of, run_cohort, write_group_and_notes
from morphofold.cli.options import Answer, Bids
from morphofold.cohort.covariates import find_covariates
from morphofold.cohort.group import GROUP_FOLDER
from morphofold.cohort.subjects import find_subjects
from morphofold.cohort.tables import TAKEN_COLUMNS
from morphofold.io.folders import alone, refuse_overlap
from morphofold.results.dataset import subject_place

FREESURFER_FOLDERS = ("derivatives/freesurfer", "sourcedata/freesurfer", ".")


def run(args: Bids) -> Answer:
    out = args.output_dir
    if args.level == "group":
        return _run_group(out, args)
    source = _subjects_folder(args)
    refuse_overlap(out, [source])
    everyone = participants_of(source, find_subjects(source)[0], out, args)
    labels = [f"sub-{label.removeprefix('sub-')}" for label in args.participant_label]
    called = {p.name: {p.name, p.name.partition(".long.")[0], p.name.partition("_")[0]} for p in everyone}
    if missing := [label for label in labels if not any(label in names for names in called.values())]:
        raise FileNotFoundError(f"{source}: contains no {', '.join(missing)}; it contains {', '.join([*called][:8])}.")
    chosen = [one for one in everyone if not labels or called[one.name].intersection(labels)]
    return run_cohort(chosen, out, args, group=False, everyone=everyone)


def _run_group(out: Path, args: Bids) -> Answer:
    """Write the group of subjects that were measured before."""
    covariates = find_covariates(args.participants, [args.bids_dir], TAKEN_COLUMNS)
    results = measured_before(out)
    with alone(out):
        group = write_group_and_notes(out, results, args, covariates.of_sessions(results))
    failures: dict[str, dict[str, str]] = {}
    for row in group.failures:
        failures.setdefault(row["subject"], {})[row["hemi"] or ""] = row["reason"]
    content = {
        "subjects": len(results),
        "with_results": group.n_measured,
        "failures": failures,
        "remarks": group.remarks_on_group,
        "page": out / GROUP_FOLDER / "report.html",
    }
    partly = f", {len(failures)} of them with failures" if failures else ""
    return Answer(content, [f"{len(results)} subjects{partly} -> {out / GROUP_FOLDER}"], 1 if failures else 0)


def measured_before(out: Path) -> dict[str, Path]:
    """Folders of a BIDS dataset in which the results of all subjects of earlier runs are, or would be."""
    records = (out / "records").glob("*.json")
    names = sorted(path.stem for path in records if not path.name.startswith("."))  # a killed run left a part of one
    if not names:
        raise FileNotFoundError(f"{out}: contains no measured subject. Measure participants first.")
    return {name: subject_place(out, name) for name in names}


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
