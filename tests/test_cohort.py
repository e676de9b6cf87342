"""A cohort: each subject by itself, done once, done anew where something changed; tables that say it all."""

import errno
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from commands import refused
from made_cohort import HereWorkers, participants, quick_measure, table, work_here, write_subject
from pyarrow import parquet

import morphofold
from morphofold.cli import main
from morphofold.errors import NothingToDo
from morphofold.group import group_tables, participant, statistics, tasks
from morphofold.group.design import person_and_session
from morphofold.group.group_tables import TIDY_COLUMNS, read_results, write_group
from morphofold.group.subjects import find_subjects, folder_of, named_subjects
from morphofold.group.workers import Lost, run_tasks
from morphofold.io import atomic_folder, begin_collection, write_annotation, write_morph
from morphofold.results import read_analysis
from morphofold.results.layouts import begin_dataset
from morphofold.surface import Regions

NAMES = ("anna", "ben", "cleo")


class Study:
    """Three subjects, measured one after the other in this process; each time by another run of the command."""

    def __init__(self, folder):
        self.folders = [write_subject(folder / "subjects" / n, 1 + k / 10) for k, n in enumerate(NAMES)]
        self.out, self.runs = folder / "out", 0

    def measure(self, folders=None, workers=None, **options):
        """Outcomes by the names of subjects."""
        self.runs += 1
        asked = participants(folders or self.folders, self.out, str(self.runs), **options)
        outcomes = run_tasks(workers or HereWorkers(), participant.measure_participant, asked)
        return {outcome.name: outcome for outcome in outcomes}

    def states(self, *folders, **options):
        return {name: done.state for name, done in self.measure(*folders, **options).items()}

    def group(self):
        results = {asked.name: asked.results for asked in participants(self.folders, self.out)}
        return write_group(self.out, results, report=False)

    def rows(self):
        """The table of all numbers, as text."""
        self.group()
        return table(self.out / "group" / "measures.tsv")

    def failures(self):
        """Reasons by subject and hemisphere, of the last tables."""
        rows = table(self.out / "group" / "failures.tsv")
        return {(row["subject"], row["hemi"]): row["reason"] for row in rows}


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)
    return Study(tmp_path)


@pytest.fixture
def measured(study):
    """A study whose subjects are measured."""
    assert study.states() == dict.fromkeys(NAMES, "done")
    return study


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_every_number_is_one_row_of_a_text_and_of_a_parquet_table(measured):
    rows = measured.rows()
    assert list(rows[0]) == list(TIDY_COLUMNS)
    values = {(r["subject"], r["hemi"], r["region"], r["measure"]): r["value"] for r in rows}
    assert len(values) == len(rows)
    for name, size in zip(NAMES, (1.0, 1.1, 1.2)):
        lh, rh = (m.scalars["mean_cortical_thickness_mm"] for m in read_analysis(measured.out / "subjects" / name))
        assert lh == pytest.approx(4 * size, rel=0.1)
        right = float(values[name, "rh", "hemisphere", "mean_cortical_thickness_mm"])
        assert right == pytest.approx(rh, rel=1e-6)
        assert float(values[name, "lh", "back", "cortical_thickness_mm"]) == pytest.approx(1 + lh, rel=1e-6)
    assert values["anna", "lh", "hemisphere", "wavelength_mm"] == "n/a"
    assert measured.failures() == {}
    entries = parquet.read_table(measured.out / "group" / "measures.parquet")
    assert entries.column_names == list(TIDY_COLUMNS)
    text = [{**e, "value": "n/a" if e["value"] is None else f"{e['value']:.7g}"} for e in entries.to_pylist()]
    assert text == rows


def test_one_bad_subject_stops_no_other(study):
    _, ben, cleo = study.folders
    (ben / "surf" / "rh.pial").write_bytes(b"no surface")
    shutil.rmtree(cleo / "surf")
    assert study.states() == {"anna": "done", "ben": "done", "cleo": "failed"}
    assert {(r["subject"], r["hemi"]) for r in study.rows()} == {("anna", "lh"), ("anna", "rh"), ("ben", "lh")}
    reasons = study.failures()
    assert set(reasons) == {("ben", "rh"), ("cleo", "lh"), ("cleo", "rh")}
    for (_, hemi), reason in reasons.items():
        assert f"{hemi}." in reason
    assert "rh failed: " in (study.out / "logs" / "ben.log").read_text()
    assert study.states() == {"anna": "reused", "ben": "reused", "cleo": "failed"}


def test_what_has_not_changed_stays_as_it_is(measured, monkeypatch):
    before = contents(measured.out)
    assert b"done in" in before["logs/ben.log"]
    monkeypatch.setattr("morphofold.analysis.measuring.measure", None)  # nothing may be measured
    assert measured.states() == dict.fromkeys(NAMES, "reused")
    assert contents(measured.out) == before  # logs, too: they tell of what is there


@pytest.mark.parametrize("name", ["surf/lh.white", "surf/rh.thickness", "label/lh.aparc.annot"])
def test_an_input_that_changes_goes_or_comes_is_measured_anew(measured, tmp_path, name):
    other = write_subject(tmp_path / "other", 1.3)
    write_morph(other / "surf" / "rh.thickness", np.full(162, 3.0))
    write_regions(other, "aparc")
    file = measured.folders[1] / name
    shutil.copy(file, tmp_path / "before")
    shutil.copy(other / name, file)
    assert measured.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}
    if name != "surf/lh.white":
        file.unlink()
        assert measured.states()["ben"] == "done"
    shutil.copy(tmp_path / "before", file)
    assert measured.states()["ben"] == "done"


def write_regions(subject, name):
    """A parcellation into one region."""
    regions = Regions(np.zeros(162, int), ("all",), np.array([[9, 9, 9]], np.uint8))
    for hemi in ("lh", "rh"):
        write_annotation(subject / "label" / f"{hemi}.{name}.annot", regions)


def test_what_an_analysis_says_of_its_surfaces_is_an_input_too(measured, tmp_path):
    folder = shutil.copytree(measured.out / "subjects" / "ben", tmp_path / "again" / "zoe")  # analysed once more
    assert measured.states([folder]) == {"zoe": "done"}
    summary = json.loads((folder / "summary.json").read_text())
    for entry in summary["surfaces"]:
        entry["units"] = "scene"
    (folder / "summary.json").write_text(json.dumps(summary))
    assert measured.states([folder]) == {"zoe": "done"}
    (entry, _) = json.loads((measured.out / "subjects" / "zoe" / "summary.json").read_text())["surfaces"]
    assert entry["units"] == "scene"


def test_the_reason_is_that_of_the_surface_that_is_missing_now(study):
    surf = study.folders[0] / "surf"
    (surf / "rh.white").rename(surf / "held")
    assert "rh.white: no such" in study.measure()["anna"].failures["rh"]
    (surf / "held").rename(surf / "rh.white")
    (surf / "rh.pial").unlink()
    assert "rh.pial: no such" in study.measure()["anna"].failures["rh"]
    assert study.states()["anna"] == "reused"


def test_a_subject_that_may_not_be_looked_into_fails_by_itself(study, monkeypatch):
    usual, ben = Path.is_dir, study.folders[1]

    def is_dir(path, **options):
        if ben in path.parents:
            raise PermissionError(13, "Permission denied", str(path))
        return usual(path, **options)

    monkeypatch.setattr(Path, "is_dir", is_dir)
    assert find_subjects(ben.parent)[0] == list(NAMES)
    outcomes = study.measure()
    assert [outcome.state for outcome in outcomes.values()] == ["done", "failed", "done"]
    assert "Permission denied" in outcomes["ben"].failures[""]
    assert "Permission denied" in (study.out / "logs" / "ben.log").read_text()


def test_other_options_and_versions_are_measured_anew(measured, monkeypatch):
    other = {"options": {"curvature_scale_mm": 4.0}}
    assert set(measured.states(**other).values()) == {"done"}
    assert set(measured.states(**other).values()) == {"reused"}
    monkeypatch.setattr(morphofold, "__version__", "0.0.0")
    assert set(measured.states(**other).values()) == {"done"}


def edited(name, old, new):
    """A change of the text of a file of results."""

    def edit(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return edit


def cut(name):
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-40])


def exchange(folder):
    others = folder.with_name("cleo"), folder.with_name("held")
    for path, new in zip((folder, *others), (others[1], folder, others[0])):
        os.rename(path, new)


def damage_record(folder):
    (folder.parent.parent / "records" / f"{folder.name}.json").write_text("{")


@pytest.mark.parametrize(
    ("change", "touched", "reason"),
    [
        (edited("summary.json", '"gyrification_index": 1.5', '"gyrification_index": 9.9'), {"ben"}, "summary.json"),
        (exchange, {"ben", "cleo"}, "summary.json"),
        (cut("summary.json"), {"ben"}, "summary.json"),
        (cut("regions.tsv"), {"ben"}, "regions.tsv"),
        (edited("regions.tsv", "\t11\t", "\t1O\t"), {"ben"}, "regions.tsv: line 2"),
        (edited("regions.tsv", "gyral_thickness_mm", "gyral"), {"ben"}, "regions.tsv: "),
        (edited("regions.tsv", "front", "n/a"), {"ben"}, "regions.tsv: changed"),
        (lambda folder: (folder / "surf" / "lh.pial").unlink(), {"ben"}, None),
        (damage_record, {"ben"}, None),
        (shutil.rmtree, {"ben"}, None),
    ],
)
def test_results_that_are_not_as_they_were_written_are_measured_anew(measured, change, touched, reason):
    rows, before = measured.rows(), contents(measured.out / "subjects")
    change(measured.out / "subjects" / "ben")
    if reason is not None:  # tables are of no such numbers until then
        assert {row["subject"] for row in measured.rows()} == {*NAMES} - touched
        assert {subject for subject, _ in measured.failures()} == touched
        assert reason in measured.failures()["ben", "n/a"]
    outcomes = measured.measure()
    assert {name for name, outcome in outcomes.items() if outcome.changed} <= touched
    assert {name for name, outcome in outcomes.items() if outcome.state != "reused"} == touched
    assert measured.rows() == rows
    assert measured.failures() == {}
    after = contents(measured.out / "subjects")
    assert {name for name in before if before[name] != after.get(name)} <= {f"{name}/cost.json" for name in touched}
    assert set(measured.states().values()) == {"reused"}


def test_a_file_of_its_user_stays_beside_results_and_is_no_change_of_them(measured):
    notes = measured.out / "subjects" / "ben" / "notes.txt"
    notes.write_text("mine")
    assert set(measured.states().values()) == {"reused"}
    assert set(measured.states(options={"gyral_width_mm": 9.0}).values()) == {"done"}
    assert notes.read_text() == "mine"
    shutil.rmtree(measured.folders[1] / "surf")
    assert measured.states()["ben"] == "failed"
    assert notes.read_text() == "mine"
    assert not (notes.parent / "summary.json").exists()


def test_inputs_that_change_while_they_are_measured_are_no_result(study, tmp_path, monkeypatch):
    """They were exchanged after the key was taken of them: the record would be of the old, the numbers of the new."""
    read, other = participant.read_parcellated, write_subject(tmp_path / "other", 1.3)

    def late(folder, *args, **options):
        if folder.endswith("ben"):
            shutil.copy(other / "surf" / "lh.pial", f"{folder}/surf/lh.pial")
        return read(folder, *args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(participant, "read_parcellated", late)
        outcomes = study.measure()
    assert [outcome.state for outcome in outcomes.values()] == ["done", "failed", "done"]
    assert "lh.pial" in outcomes["ben"].failures[""]
    assert study.states()["ben"] == "done"


@pytest.fixture
def commanded(cwd, monkeypatch):
    """The command in this process, its exit code and what it says."""
    work_here(monkeypatch)
    for i, name in enumerate(NAMES):
        write_subject(cwd / "subjects" / name, 1 + i / 10)
    return lambda *words: main(["cohort", "subjects", "-o", "out", "--no-report", "-q", "--json", *words])


def test_a_folder_whose_name_is_no_text_is_a_subject_like_others(commanded, cwd, capsys):
    (cwd / "subjects" / "ben").rename(cwd / "subjects" / "\udcff")
    (cwd / "subjects" / "\udcff" / "surf" / "rh.pial").unlink()
    assert commanded() == 1
    summary = json.loads(capsys.readouterr().out)
    assert (summary["subjects"], summary["with_results"]) == (3, 3)
    assert set(summary["failures"]["\\udcff"]) == {"rh"}
    assert {row["subject"] for row in table(cwd / "out/group/measures.tsv")} == {"anna", "\\udcff", "cleo"}
    assert not [path for path in (cwd / "out").rglob("*") if "\udcff" in path.name]
    (cwd / "out/subjects/\\udcff/summary.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "obstruct"),
    [
        ("x" * 251, lambda out, victim: None),
        ("ben", lambda out, victim: (out / "records" / "ben.json").mkdir()),
        ("ben", lambda out, victim: (out / "logs" / "ben.log").mkdir()),
        ("ben", lambda out, victim: (out / "records" / "ben.lock").symlink_to(victim)),
        ("ben", lambda out, victim: (out / "subjects" / "ben").write_text("mine")),
    ],
    ids=["long name", "folder for a record", "folder for a log", "link for a lock", "file for all"],
)
def test_what_cannot_be_written_of_one_subject_stops_no_other(commanded, cwd, capsys, name, obstruct):
    out, victim = begin_collection(cwd / "out", "cohort") or cwd / "out", cwd / "victim"
    victim.write_text("mine")
    (cwd / "subjects" / "ben").rename(cwd / "subjects" / name)
    for folder in ("logs", "records", "subjects"):
        (out / folder).mkdir(exist_ok=True)
    obstruct(out, victim)
    for _ in range(2):  # the next run tells the same
        assert commanded() == 1
        summary = json.loads(capsys.readouterr().out)
        assert (summary["with_results"], set(summary["failures"])) == (2, {name})
        reasons = {row["subject"]: row["reason"] for row in table(out / "group" / "failures.tsv")}
        assert reasons == {name: " ".join(summary["failures"][name][""].split())}
        assert {row["subject"] for row in table(out / "group" / "measures.tsv")} == {"anna", "cleo"}
    assert victim.read_text() == "mine"


def test_results_that_are_json_and_not_ours_are_refused(study):
    study.measure(study.folders[:1])
    file = study.out / "subjects" / "anna" / "summary.json"
    text = file.read_text()
    wrong = [("hemi", "left"), ("measures", [1.0]), ("notes", None)]
    wrong += [("measures", {"n_vertices": value}) for value in ("many", [1], np.nan, 10**400)]
    for key, value in wrong:
        summary = json.loads(text)
        summary["surfaces"][1][key] = value
        file.write_text(json.dumps(summary))
        with pytest.raises(ValueError, match=r"anna.summary\.json: "):
            read_results(file.parent)


def test_a_damaged_record_is_none(tmp_path):
    record = tmp_path / "anna.json"
    known = '{"key": "a", "failures": %s, "results": %s, "files": {}}'
    wrong = known.replace('"a"', "1") % ("{}", "true"), known % ('{"lh": 5}', "false")
    for text in ("", "{", "[]", '{"key": "a"}', *wrong):
        record.write_text(text)
        assert tasks.read_record(record) == {}


def test_where_records_can_not_be_nobody_is_waited_for(study):
    study.out.mkdir()
    (study.out / "records").write_text("mine")
    outcome = participant.measure_participant(participants(study.folders[:1], study.out)[0])
    assert outcome.state == "failed"
    assert str(study.out / "records") in outcome.failures[""]


def test_results_of_what_can_no_longer_be_measured_go(measured):
    for hemi in ("lh", "rh"):
        (measured.folders[0] / "surf" / f"{hemi}.white").write_bytes(b"no surface")
    assert measured.states()["anna"] == "failed"
    assert not (measured.out / "subjects" / "anna").exists()
    assert "anna" not in {row["subject"] for row in measured.rows()}


def test_somebody_elses_folder_stays_where_a_subject_cannot_be_measured(study):
    place = study.out / "subjects" / "anna"
    place.mkdir(parents=True)
    (place / "notes.txt").write_text("mine")
    assert study.states()["anna"] == "failed"
    shutil.rmtree(study.folders[0] / "surf")
    assert set(study.measure()["anna"].failures) == {"lh", "rh"}
    assert (place / "notes.txt").read_text() == "mine"


def test_what_the_machine_is_to_blame_for_is_tried_again(study, monkeypatch):
    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device", "out")

    with monkeypatch.context() as patch:
        patch.setattr("morphofold.results.write_analysis", full)
        outcomes = study.measure()
    assert [outcome.failures for outcome in outcomes.values()] == 3 * [{"": "out: No space left on device."}]
    assert "Traceback" in (study.out / "logs" / "anna.log").read_text()
    assert set(study.states().values()) == {"done"}


def test_a_defect_is_told_as_such_and_stops_no_other(study, monkeypatch):
    def broken(cortex, **options):
        if cortex.name == "ben":
            raise KeyError("gyri")
        return quick_measure(cortex, **options)

    monkeypatch.setattr("morphofold.analysis.measuring.measure", broken)
    outcomes = study.measure()
    assert [outcome.state for outcome in outcomes.values()] == ["done", "failed", "done"]
    assert outcomes["ben"].failures[""].startswith("KeyError: 'gyri' (a defect")


def test_a_subject_that_is_lost_with_its_workers_is_told_and_tried_again(study):
    class Losing(HereWorkers):
        def run(self, work, tasks):
            for task, outcome in super().run(work, tasks):
                yield task, Lost("3 workers died") if task.name == "ben" else outcome

    assert study.states(workers=Losing()) == {"anna": "done", "ben": "failed", "cleo": "done"}
    study.group()
    assert study.failures() == {("ben", "n/a"): "3 workers died"}
    assert study.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}


def test_a_worker_given_up_for_lost_and_the_next_one_at_its_subject_do_not_mix(study, monkeypatch):
    """One of an earlier run with other options; results and record are those of one worker in the end."""
    anna, out, other = study.folders[:1], study.out, {"options": {"curvature_scale_mm": 4.0}}
    at_it, go = threading.Event(), threading.Event()

    def measure(cortex, curvature_scale=None, **options):
        if curvature_scale is None:
            at_it.set()
            assert go.wait(60)
        return quick_measure(cortex)

    monkeypatch.setattr("morphofold.analysis.measuring.measure", measure)
    lost = threading.Thread(target=study.measure, args=(anna,))
    following = threading.Thread(target=study.measure, args=(anna,), kwargs=other)
    with warnings.catch_warnings():  # what two threads do to them is undone
        lost.start()
        assert at_it.wait(60)
        following.start()
        time.sleep(0.2)
        assert following.is_alive()
        go.set()
        lost.join()
        following.join()
    summary = json.loads((out / "subjects" / "anna" / "summary.json").read_text())
    assert summary["parameters"]["curvature_scale_mm"] == 4.0
    assert study.states(anna, **other) == {"anna": "reused"}
    assert sorted(os.listdir(out / "records")) == ["anna.json"]


def test_tables_are_the_same_however_the_work_went_and_hold_a_batch_of_subjects_at_a_time(measured, monkeypatch):
    rows = measured.rows()
    tables_before = contents(measured.out / "group")
    shutil.rmtree(measured.out)
    measured.measure(measured.folders[2:])
    measured.measure(measured.folders[::-1])
    measured.group()
    assert contents(measured.out / "group") == tables_before
    monkeypatch.setattr(group_tables, "SUBJECTS_PER_BATCH", 2)
    assert measured.rows() == rows
    assert parquet.read_metadata(measured.out / "group" / "measures.parquet").num_row_groups == 2


def test_numbers_of_hemispheres_measured_unlike_are_not_pooled(measured):
    """Two subjects by one gyral width and one by another: hinges are pooled of the two, thickness of all three."""
    measured.measure(measured.folders[:1], options={"gyral_width_mm": 11.0})
    group = measured.group()
    assert group.n_measured == 3
    assert group.pooling.counts == {"graph_width_mm": {9.0: 4, 11.0: 2}}
    assert group.pooling.left_out == {"n_hinges": (2, 6)}
    pooled = statistics.measures_of(group)
    assert np.isnan(pooled["n_hinges"]).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert np.isfinite(pooled["mean_cortical_thickness_mm"]).all()
    assert [row["graph_width_mm"] for row in table(measured.out / "group" / "hemispheres.tsv")] == 2 * ["11"] + 4 * [
        "9"
    ]
    values = [r["value"] for r in measured.rows() if (r["region"], r["measure"]) == ("hemisphere", "n_hinges")]
    assert values == ["20"] * 6  # the table has all of them


def test_regions_of_hemispheres_measured_unlike_are_not_averaged(measured):
    for count in (1, 2):
        measured.measure(measured.folders[:count], options={"accuracy": "draft"})
        group = measured.group()
        assert group.regions["front"][:, :, 0].tolist() == [[2, 2], [2, 2]]
        assert group.pooling.left_out["mean_cortical_thickness_mm"] == (2, 6)


def test_subjects_that_are_the_same_are_found(study):
    study.folders.append(shutil.copytree(study.folders[0], study.folders[0].with_name("zoe")))
    study.measure()
    assert study.group().same == [["anna", "zoe"]]


def test_the_bids_layout_holds_the_same_numbers(measured, tmp_path):
    plain, bids = measured.out, tmp_path / "bids"
    begin_dataset(bids, ignoring=("group", "logs", "records"))
    measured.out = bids
    assert set(measured.states(bids=True).values()) == {"done"}
    assert set(measured.states(bids=True).values()) == {"reused"}
    assert (bids / "sub-anna" / "anat").is_dir()
    for name in ("anna", "cleo"):
        assert read_results(plain / "subjects" / name)[0] == read_results(bids / f"sub-{name}")[0]


def test_subjects_are_found_and_templates_left_out(tmp_path):
    write_subject(tmp_path / "anna")
    write_subject(tmp_path / "fsaverage5")
    (tmp_path / "half" / "mri").mkdir(parents=True)  # FreeSurfer stopped in it
    (tmp_path / "notes").mkdir()
    (tmp_path / "table.csv").touch()
    (tmp_path / "fsaverage").symlink_to("anna")
    (tmp_path / "lh.EC_average").symlink_to("anna")
    templates = dict.fromkeys(("fsaverage", "fsaverage5", "lh.EC_average"), "template")
    assert find_subjects(tmp_path) == (["anna", "half"], templates)
    with pytest.raises(NothingToDo, match="notes"):
        find_subjects(tmp_path / "notes")
    with pytest.raises(FileNotFoundError, match="none"):
        find_subjects(tmp_path / "none")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("anna", ("anna", "")),
        ("anna_ses1.long.anna", ("anna", "ses1")),
        ("scan7.long.anna_base", ("anna_base", "scan7")),
        ("sub-01_ses-2.long.sub-01_base", ("sub-01", "ses-2")),
        ("anna_tp2", ("anna", "tp2")),
        ("anna.visit_03", ("anna", "visit_03")),
        ("anna_v2", ("anna", "v2")),
        ("smith_tpatel", ("smith_tpatel", "")),
        ("sub-v01_ses-2", ("sub-v01", "ses-2")),
        ("HC_v12", ("HC_v12", "")),
        ("study_v2_007", ("study_v2_007", "")),
    ],
)
def test_the_person_and_the_session_by_a_name(name, expected):
    assert person_and_session(name) == expected


def test_of_longitudinal_runs_bases_and_other_runs_of_their_time_points_are_left_out(tmp_path):
    names = ("anna", "anna_1", "anna_2", "anna_1.long.anna", "ben", "ben_base", "ben_1", "ben_2", "sub-03_ses-1")
    for name in names:
        (tmp_path / name / "surf").mkdir(parents=True)
    (tmp_path / "anna" / "base-tps").write_text("anna_1\nanna_2\n")  # the longitudinal run of anna_2 is missing
    (tmp_path / "ben_base" / "base-tps").write_text("ben_1\nben_2\n")  # ben has none yet
    for name in ("sub-04/ses-1", "sub-04/ses-2", "sub-05"):
        (tmp_path / name / "surf").mkdir(parents=True)
    names_of_runs, left_out = find_subjects(tmp_path)
    assert names_of_runs == [
        *("anna_1.long.anna", "ben", "ben_1", "ben_2", "sub-03_ses-1", "sub-05", "sub-04_ses-1", "sub-04_ses-2")
    ]
    assert {k: v.split()[0] for k, v in left_out.items()} == {
        **{"anna": "base", "anna_1": "cross-sectional", "anna_2": "cross-sectional", "ben_base": "base"}
    }
    assert folder_of(tmp_path, "sub-04_ses-2") == tmp_path / "sub-04" / "ses-2"
    assert folder_of(tmp_path, "sub-03_ses-1") == tmp_path / "sub-03_ses-1"


def test_a_person_with_several_sessions_counts_once(commanded, cwd, capsys):
    for k, size in ((1, 1.5), (2, 1.7)):
        write_subject(cwd / "subjects" / f"dora_ses{k}.long.dora", size)
        write_subject(cwd / "subjects" / f"dora_ses{k}", 5.0)
    write_subject(cwd / "subjects" / "dora", 5.0)
    assert commanded("--curvature-scale", "8", "--gyral-width", "9") == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer["left_out"]) == {"dora", "dora_ses1", "dora_ses2"}
    assert len(answer["remarks"]) == 1
    rows = [row for row in table(cwd / "out/group/surfaces.tsv") if row["hemi"] == "lh"]
    persons = [(name, "n/a") for name in NAMES] + [("dora", "ses1"), ("dora", "ses2")]
    assert [(row["person"], row["session"]) for row in rows] == persons
    values = [float(row["mean_cortical_thickness_mm"]) for row in rows]
    means = [*values[:3], np.mean(values[3:])]
    spread = table(cwd / "out/group/distributions.tsv")
    (thickness,) = (r for r in spread if (r["measure"], r["hemi"]) == ("mean_cortical_thickness_mm", "lh"))
    assert thickness["n"] == "4"
    assert float(thickness["mean"]) == pytest.approx(np.mean(means), rel=1e-5)
    assert float(thickness["sd"]) == pytest.approx(np.std(means, ddof=1), rel=1e-5)


def test_regions_of_a_person_with_several_sessions_count_once(study):
    anna, ben, cleo = study.folders
    study.folders = [anna.rename(anna.with_name("dora_ses1")), ben, cleo.rename(cleo.with_name("dora_ses2"))]
    study.measure()
    regions = study.group().regions["front"]
    key = ("lh", "front", "cortical_thickness_mm")
    rows = [row for row in study.rows() if (row["hemi"], row["region"], row["measure"]) == key]
    values = {row["subject"]: float(row["value"]) for row in rows}
    means = [values["ben"], (values["dora_ses1"] + values["dora_ses2"]) / 2]
    n, mean, sd = regions[0, 0]
    assert n == 2
    assert mean == pytest.approx(np.mean(means), rel=1e-6)
    assert sd == pytest.approx(np.std(means), rel=1e-4)


def test_lists_of_subjects(tmp_path):
    file = tmp_path / "list.txt"
    file.write_text("\ufeffben  # the second\n\nanna/\n", encoding="utf-8")
    assert named_subjects(file) == ["ben", "anna"]


def test_the_command_refuses_what_it_cannot_do(cwd, capsys):
    write_subject(cwd / "subjects" / "anna")
    (cwd / "theirs").mkdir()
    (cwd / "theirs" / "notes.txt").touch()
    before = sorted(cwd.rglob("*"))
    refused(capsys, ["cohort", "subjects", "-o", "theirs"], "theirs", "[exists-already]")
    refused(capsys, ["cohort", "subjects", "-o", "subjects"], "subjects", "[options-clash]")
    refused(capsys, ["cohort", "subjects", "--subjects", "none.txt"], "none.txt", "[no-such-file]")
    assert sorted(cwd.rglob("*")) == before


@pytest.mark.parametrize("command", [["cohort", "subjects"], ["sweep", "demo", "--seeds", "2"]])
def test_a_group_that_is_somebody_elses_is_refused_before_anything_is_measured(cwd, capsys, command):
    write_subject(cwd / "subjects" / "anna")
    begin_collection(cwd / "out", command[0])
    (cwd / "out" / "group").mkdir()
    (cwd / "out" / "group" / "notes.txt").touch()
    before = contents(cwd / "out")
    refused(capsys, [*command, "-o", "out"], "group: morphofold did not write this folder")
    assert contents(cwd / "out") == before


def test_a_cohort_is_replaced_by_no_other_command_and_replaces_none(tmp_path):
    begin_collection(tmp_path / "study", "cohort")
    (tmp_path / "study" / "kept").touch()
    begin_collection(tmp_path / "study", "cohort")  # the next run
    with pytest.raises(FileExistsError, match=r"\bstudy\b.*\bcohort\b.*\bsweep\b"):
        begin_collection(tmp_path / "study", "sweep")
    with (
        pytest.raises(FileExistsError, match="is a cohort or a sweep, which is not replaced"),
        atomic_folder(tmp_path / "study"),
    ):
        pass
    assert (tmp_path / "study" / "kept").exists()
    with atomic_folder(tmp_path / "analysis") as folder:
        (folder / "kept").touch()
    with pytest.raises(FileExistsError, match="replaces the folder as a whole"):
        begin_collection(tmp_path / "analysis", "cohort")


def test_where_there_are_no_workers_nothing_is_written(cwd, capsys, monkeypatch):
    write_subject(cwd / "subjects" / "anna")
    monkeypatch.setattr("morphofold.group.workers.SCHEDULER_TIMEOUT_S", 0.2)
    for words, expected in (
        (["--scheduler", "tcp://127.0.0.1:9"], ("tcp://127.0.0.1:9",)),
        (["--memory", "0.001"], (" 0.0 GiB", "[too-large]")),
    ):
        refused(capsys, ["cohort", "subjects", "-o", "out", *words], *expected)
        refused(capsys, ["sweep", "demo", "--vary", "mu_ratio=1,2", "-o", "out", *words], *expected)
        refused(capsys, ["bids", "subjects", "out", "participant", *words], *expected)
    assert os.listdir(cwd) == ["subjects"]


@pytest.mark.slow
def test_the_command_from_end_to_end(cwd, capsys):
    for i, name in enumerate(("anna", "ben")):
        write_subject(cwd / "subjects" / name, 1 + i / 10)
    pial = cwd / "subjects" / "ben" / "surf" / "lh.pial"
    pial.write_bytes(b"no surface")
    asked = ["cohort", "subjects", "-o", "out", "--no-report", "--workers", "1"]
    assert main([*asked, "--json"]) == 1
    captured = capsys.readouterr()
    assert "1 worker of 1 thread, at most" in captured.err
    summary = json.loads(captured.out)
    assert [summary[k] for k in ("subjects", "with_results", "from_before", "failed", "in_part")] == [2, 2, 0, 0, 1]
    assert "lh.pial" in summary["failures"]["ben"]["lh"]
    before = contents(cwd / "out" / "group")
    write_subject(cwd / "subjects" / "ben", 1.1)
    assert main([*asked, "-q"]) == 0
    assert capsys.readouterr().out.startswith("2 of 2 subjects have results, 1 of them from before -> ")
    assert contents(cwd / "out" / "group") != before
    assert json.loads((cwd / "out" / "records" / "ben.json").read_text())["failures"] == {}


def running(folder, out, *words):
    """The command in a process of its own, and the processes of its workers once there are some."""
    import psutil

    command = [sys.executable, "-m", "morphofold", "cohort", str(folder), "-o", str(out), "--no-report", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    me = psutil.Process(process.pid)
    while process.poll() is None and not any((out / "logs").glob("*.log")):
        time.sleep(0.05)
    return process, [p for p in me.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_workers_and_a_killed_run_leave_the_same_tables(tmp_path):
    import psutil

    folder = tmp_path / "subjects"
    for i in range(8):
        write_subject(folder / f"sub-{i}", 1 + i / 40)
    (folder / "sub-3" / "surf" / "rh.pial").write_bytes(b"no surface")
    whole, process = tmp_path / "whole", running(folder, tmp_path / "whole", "--workers", "2")[0]
    process.communicate()
    assert process.returncode == 1

    out = tmp_path / "out"
    process, workers = running(folder, out, "--workers", "2")
    assert len(workers) >= 2
    workers[-1].kill()
    while process.poll() is None and len(list((out / "records").glob("*.json"))) < 3:
        time.sleep(0.05)
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(workers, timeout=30)
    assert not alive  # no orphan goes on
    done = {p.name: p.stat().st_mtime_ns for p in (out / "records").glob("*.json")}
    assert 0 < len(done) < 8

    process, _ = running(folder, out, "--workers", "2")
    output = process.communicate()[0]
    assert "from before" in output.splitlines()[-1]
    for name, when in done.items():  # what was done is not done twice
        assert (out / "records" / name).stat().st_mtime_ns == when
    assert contents(out / "group") == contents(whole / "group")
    assert not [p.name for p in (out / "subjects").iterdir() if not p.name.startswith((".", "sub-"))]


def test_what_freesurfer_says_of_a_brain_is_in_the_table_of_hemispheres(study):
    stats = study.folders[0] / "stats" / "aseg.stats"
    stats.parent.mkdir()
    stats.write_text(
        "# Measure EstimatedTotalIntraCranialVol, eTIV, Estimated Total Intracranial Volume, 1500000.5, mm^3\n"
        "# Measure rhSurfaceHoles, rhSurfaceHoles, Number of defect holes in rh surfaces prior to fixing, 7, unitless\n"
    )
    study.measure()
    study.group()
    rows = table(study.out / "group" / "hemispheres.tsv")[:3]
    assert [(row["subject"], row["hemi"]) for row in rows] == [("anna", "lh"), ("anna", "rh"), ("ben", "lh")]
    values = [(row["etiv_mm3"], row["surface_holes"]) for row in rows]
    assert values == [("1500000", "n/a"), ("1500000", "7"), ("n/a", "n/a")]
    stats.unlink()
    assert study.states()["anna"] == "done"  # it is an input like the surfaces
