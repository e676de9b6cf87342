"""A cohort: each subject by itself, done once, done anew where something changed; tables of all."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from commands import refused
from made_cohort import HereWorkers, participants, quick_measure, table, work_here, write_subject
from pyarrow import parquet

import morphofold
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.measuring import measure
from morphofold.cli import main
from morphofold.group import group_tables, participant, statistics, tasks
from morphofold.group.group_tables import TIDY_COLUMNS, read_results, write_group
from morphofold.group.participant import (
    MOST_SUBJECTS_READ,
    SCALES_FILE,
    Scales,
    curvature_scale,
    read_scales,
    scales_of,
)
from morphofold.group.workers import Lost, run_tasks
from morphofold.io import atomic_folder, begin_collection, read_cortex, write_annotation, write_morph
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
        tasks = participants(folders or self.folders, self.out, str(self.runs), **options)
        outcomes = run_tasks(workers or HereWorkers(), participant.measure_participant, tasks)
        return {outcome.name: outcome for outcome in outcomes}

    def states(self, *folders, **options):
        return {name: outcome.state for name, outcome in self.measure(*folders, **options).items()}

    def group(self):
        results = {subject.name: subject.results for subject in participants(self.folders, self.out)}
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


@pytest.fixture
def commanded(cwd, monkeypatch):
    """The command in this process: its exit code."""
    work_here(monkeypatch)
    for i, name in enumerate(NAMES):
        write_subject(cwd / "subjects" / name, 1 + i / 10)
    return lambda *words: main(["cohort", "subjects", "-o", "out", "--no-report", "-q", "--json", *words])


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_regions(subject, name):
    """A parcellation into one region."""
    regions = Regions(np.zeros(162, int), ("all",), np.array([[9, 9, 9]], np.uint8))
    for hemi in ("lh", "rh"):
        write_annotation(subject / "label" / f"{hemi}.{name}.annot", regions)


# done once ---------------------------------------------------------------------------------------------------


def test_subjects_without_changes_stay_and_other_options_and_versions_are_measured_anew(measured, monkeypatch):
    before = contents(measured.out)
    assert b"done in" in before["logs/ben.log"]
    with monkeypatch.context() as patch:
        patch.setattr("morphofold.analysis.measuring.measure", None)  # nothing may be measured
        assert measured.states() == dict.fromkeys(NAMES, "reused")
    assert contents(measured.out) == before  # logs, too: they describe the results
    other = {"options": {"curvature_scale_mm": 4.0}}
    assert set(measured.states(**other).values()) == {"done"}
    assert set(measured.states(**other).values()) == {"reused"}
    monkeypatch.setattr(morphofold, "__version__", "0.0.0")
    assert set(measured.states(**other).values()) == {"done"}


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


def test_the_summary_of_an_analysis_is_an_input_too(measured, tmp_path):
    folder = shutil.copytree(measured.out / "subjects" / "ben", tmp_path / "again" / "zoe")  # analysed once more
    assert measured.states([folder]) == {"zoe": "done"}
    summary = json.loads((folder / "summary.json").read_text())
    for entry in summary["surfaces"]:
        entry["units"] = "scene"
    (folder / "summary.json").write_text(json.dumps(summary))
    assert measured.states([folder]) == {"zoe": "done"}
    (entry, _) = json.loads((measured.out / "subjects" / "zoe" / "summary.json").read_text())["surfaces"]
    assert entry["units"] == "scene"


def edit_summary(folder):
    text = (folder / "summary.json").read_text()
    (folder / "summary.json").write_text(text.replace('"gyrification_index": 1.5', '"gyrification_index": 9.9'))


def exchange(folder):
    others = folder.with_name("cleo"), folder.with_name("aside")
    for path, new in zip((folder, *others), (others[1], folder, others[0])):
        os.rename(path, new)


def damage_record(folder):
    (folder.parent.parent / "records" / f"{folder.name}.json").write_text("{")


@pytest.mark.parametrize(
    ("change", "touched"),
    [
        (edit_summary, {"ben"}),
        (exchange, {"ben", "cleo"}),
        (lambda folder: os.truncate(folder / "regions.tsv", 40), {"ben"}),
        (lambda folder: (folder / "surf" / "lh.pial").unlink(), {"ben"}),
        (damage_record, {"ben"}),
        (shutil.rmtree, {"ben"}),
    ],
)
def test_results_that_are_not_as_they_were_written_are_measured_anew(measured, change, touched):
    rows, before = measured.rows(), contents(measured.out / "subjects")
    change(measured.out / "subjects" / "ben")
    outcomes = measured.measure()
    assert {name for name, outcome in outcomes.items() if outcome.changed} <= touched
    assert {name for name, outcome in outcomes.items() if outcome.state != "reused"} == touched
    assert measured.rows() == rows
    assert measured.failures() == {}
    after = contents(measured.out / "subjects")
    assert {name for name in before if before[name] != after.get(name)} <= {f"{name}/cost.json" for name in touched}
    assert set(measured.states().values()) == {"reused"}


def test_files_of_the_user_stay_beside_results_which_go_where_nothing_can_be_measured(measured):
    results = measured.out / "subjects" / "ben"
    (results / "notes.txt").write_text("mine")
    assert set(measured.states().values()) == {"reused"}
    other = {"options": {"gyral_width_mm": 9.0}}
    assert set(measured.states(**other).values()) == {"done"}
    for folder in measured.folders[:2]:
        for hemi in ("lh", "rh"):
            (folder / "surf" / f"{hemi}.white").write_bytes(b"no surface")
    assert measured.states(**other) == {"anna": "failed", "ben": "failed", "cleo": "reused"}
    assert (results / "notes.txt").read_text() == "mine"
    assert not (results / "summary.json").exists()
    assert not results.with_name("anna").exists()
    assert {row["subject"] for row in measured.rows()} == {"cleo"}


# failures ----------------------------------------------------------------------------------------------------


def test_a_bad_subject_stops_no_other_and_its_reason_is_of_the_present(study):
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
    (ben / "surf" / "rh.white").unlink()
    assert "rh.white: no such" in study.measure()["ben"].failures["rh"]


def test_failures_of_the_machine_and_defects_stop_no_other_and_are_tried_again(study, monkeypatch):
    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device", "out")

    def broken(cortex, **options):
        raise KeyError("gyri")

    class Losing(HereWorkers):
        def run(self, work, tasks):
            for task, outcome in super().run(work, tasks):
                yield task, Lost("3 workers died") if task.name == "ben" else outcome

    with monkeypatch.context() as patch:
        patch.setattr("morphofold.results.write_analysis", full)
        outcomes = study.measure()
    assert [outcome.failures for outcome in outcomes.values()] == 3 * [{"": "out: No space left on device."}]
    assert "Traceback" in (study.out / "logs" / "anna.log").read_text()
    with monkeypatch.context() as patch:
        patch.setattr("morphofold.analysis.measuring.measure", broken)
        assert study.measure()["ben"].failures[""].startswith("KeyError: 'gyri' (a defect")
    assert study.states(workers=Losing()) == {"anna": "done", "ben": "failed", "cleo": "done"}
    study.group()
    assert study.failures() == {("ben", "n/a"): "3 workers died"}
    assert study.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}


def test_a_lost_worker_and_the_next_one_at_its_subject_do_not_mix(study, monkeypatch):
    """One of an earlier run with other options; results and record are those of one worker in the end."""
    anna, out, other = study.folders[:1], study.out, {"options": {"curvature_scale_mm": 4.0}}
    begun, go = threading.Event(), threading.Event()

    def measure(cortex, curvature_scale=None, **options):
        if curvature_scale is None:
            begun.set()
            assert go.wait(60)
        return quick_measure(cortex)

    monkeypatch.setattr("morphofold.analysis.measuring.measure", measure)
    lost = threading.Thread(target=study.measure, args=(anna,))
    following = threading.Thread(target=study.measure, args=(anna,), kwargs=other)
    with warnings.catch_warnings():  # what two threads do to them is undone
        lost.start()
        assert begun.wait(60)
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


@pytest.mark.parametrize(
    ("name", "obstruct"),
    [
        ("x" * 251, lambda out: None),
        ("ben", lambda out: (out / "logs" / "ben.log").mkdir()),
        ("ben", lambda out: (out / "subjects" / "ben").write_text("mine")),
    ],
    ids=["long name", "folder for a log", "file for results"],
)
def test_files_that_cannot_be_written_of_one_subject_stop_no_other(commanded, cwd, capsys, name, obstruct):
    out = begin_collection(cwd / "out", "cohort") or cwd / "out"
    (cwd / "subjects" / "ben").rename(cwd / "subjects" / name)
    for folder in ("logs", "records", "subjects"):
        (out / folder).mkdir(exist_ok=True)
    obstruct(out)
    for _ in range(2):  # the next run says the same
        assert commanded() == 1
        summary = json.loads(capsys.readouterr().out)
        assert (summary["with_results"], set(summary["failures"])) == (2, {name})
        reasons = {row["subject"]: row["reason"] for row in table(out / "group" / "failures.tsv")}
        assert set(reasons) == {name}
        assert {row["subject"] for row in table(out / "group" / "measures.tsv")} == {"anna", "cleo"}


def test_damaged_records_count_as_none_and_damaged_results_are_refused(study):
    study.measure(study.folders[:1])
    record, file = study.out / "records" / "anna.json", study.out / "subjects" / "anna" / "summary.json"
    for text in ("", "{", "[]", '{"key": 1, "failures": {}, "results": true, "files": {}}'):
        record.write_text(text)
        assert tasks.read_record(record) == {}
    text = file.read_text()
    for key, value in (("hemi", "left"), ("measures", [1.0]), ("measures", {"n_vertices": "many"}), ("notes", None)):
        summary = json.loads(text)
        summary["surfaces"][1][key] = value
        file.write_text(json.dumps(summary))
        with pytest.raises(ValueError, match=r"anna.summary\.json: "):
            read_results(file.parent)


# tables ------------------------------------------------------------------------------------------------------


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


def test_tables_are_the_same_in_any_order_of_work_and_are_written_in_batches(measured, monkeypatch):
    rows = measured.rows()
    before = contents(measured.out / "group")
    shutil.rmtree(measured.out)
    measured.measure(measured.folders[2:])
    measured.measure(measured.folders[::-1])
    measured.group()
    assert contents(measured.out / "group") == before
    monkeypatch.setattr(group_tables, "SUBJECTS_PER_BATCH", 2)
    assert measured.rows() == rows
    assert parquet.read_metadata(measured.out / "group" / "measures.parquet").num_row_groups == 2


def test_hemispheres_measured_with_other_settings_are_not_pooled(measured):
    """Two subjects by one gyral width and one by another: hinges are pooled of the two, thickness of all three."""
    measured.measure(measured.folders[:1], options={"gyral_width_mm": 11.0})
    group = measured.group()
    assert group.n_measured == 3
    assert group.pooling.counts == {"graph_width_mm": {9.0: 4, 11.0: 2}}
    assert group.pooling.left_out == {"n_hinges": (2, 6)}
    pooled = statistics.measures_of(group)
    assert np.isnan(pooled["n_hinges"]).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert np.isfinite(pooled["mean_cortical_thickness_mm"]).all()
    widths = [row["graph_width_mm"] for row in table(measured.out / "group" / "hemispheres.tsv")]
    assert widths == ["11", "11", "9", "9", "9", "9"]
    values = [r["value"] for r in measured.rows() if (r["region"], r["measure"]) == ("hemisphere", "n_hinges")]
    assert values == ["20"] * 6  # the table has all of them
    measured.measure(measured.folders[:1], options={"accuracy": "draft"})
    group = measured.group()
    assert group.regions["front"][:, :, 0].tolist() == [[2, 2], [2, 2]]
    assert group.pooling.left_out["mean_cortical_thickness_mm"] == (2, 6)


def test_the_same_surfaces_under_two_names_are_found(study):
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
        assert read_results(plain / "subjects" / name) == read_results(bids / f"sub-{name}")


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
    n, mean, sd = study.group().regions["front"][0, 0]
    key = ("lh", "front", "cortical_thickness_mm")
    rows = [row for row in study.rows() if (row["hemi"], row["region"], row["measure"]) == key]
    values = {row["subject"]: float(row["value"]) for row in rows}
    means = [values["ben"], (values["dora_ses1"] + values["dora_ses2"]) / 2]
    assert n == 2
    assert mean == pytest.approx(np.mean(means), rel=1e-6)
    assert sd == pytest.approx(np.std(means), rel=1e-4)


def test_numbers_of_freesurfer_are_in_the_table_of_hemispheres(study):
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


# one curvature scale and one net width -----------------------------------------------------------------------


class NamedLengths:
    """Workers whose hemispheres have the lengths that its subjects are named for: ``"3.0 8"``."""

    def __init__(self):
        self.names = []

    def run(self, work, tasks):
        for task in tasks:
            self.names.append(task.name)
            yield task, [tuple(map(float, task.name.split()))]


def scales_by_name(folder, *names, workers=None):
    (folder / "out").mkdir(exist_ok=True)
    return scales_of(
        folder / "out", workers or NamedLengths(), participants([folder / n for n in names], folder / "out")
    )


def test_the_scale_is_the_coarsest_of_usual_meshes_and_the_width_the_median(tmp_path):
    names = "3.0 7.0", "3.0 7.5", "3.904 8.123456", "3.908 10.4", "7.731 nan"
    expected = Scales(curvature_scale_mm=7.74, gyral_width_mm=7.81, hemispheres=5)  # three digits, rounded up
    assert scales_by_name(tmp_path, *names) == expected
    (tmp_path / "out" / SCALES_FILE).unlink()
    assert scales_by_name(tmp_path, "3 7", "3 8", "3.1 9", "15 30").curvature_scale_mm == 3.1
    options = {"curvature_scale_mm": None, "gyral_width_mm": None}
    assert expected.fill(options) == {**options, "common_curvature_scale_mm": 7.74, "gyral_width_mm": 7.81}
    options = {"curvature_scale_mm": 5.0, "gyral_width_mm": 9.0}
    assert expected.fill(options) == options


def test_the_scales_of_the_first_run_stay_and_are_of_some_subjects(tmp_path):
    """So that a subject more changes no results of the others."""
    assert scales_by_name(tmp_path, "nobody", workers=HereWorkers()) is None
    assert not (tmp_path / "out" / SCALES_FILE).exists()
    workers = NamedLengths()
    first = scales_by_name(tmp_path, *(f"3 {k}" for k in range(1, 1001)), workers=workers)
    assert len(workers.names) == MOST_SUBJECTS_READ
    assert {"3 1", "3 1000"} <= set(workers.names)
    assert scales_by_name(tmp_path, "3 7", "5 20", workers=workers) == first
    assert len(workers.names) == MOST_SUBJECTS_READ
    for text in ("", '{"curvature_scale_mm": 3}', '{"curvature_scale_mm": -1, "gyral_width_mm": 8, "hemispheres": 2}'):
        (tmp_path / "out" / SCALES_FILE).write_text(text)
        with pytest.raises(ValueError, match=SCALES_FILE):
            scales_by_name(tmp_path, "3 7")


def test_scales_are_those_by_which_a_subject_is_measured_unless_its_mesh_is_too_coarse_or_small(tmp_path):
    (subject,) = participants([write_subject(tmp_path / "anna", level=3, hemis=("lh",))], tmp_path / "out")
    cortex = read_cortex(tmp_path / "anna")
    ((scale, width),) = read_scales(subject)
    parameters = measure(cortex).parameters
    assert scale == parameters["curvature_scale_mm"]
    assert width == parameters.get("graph_width_mm", width)
    own = scale_of_curvature(cortex)[0]
    assert curvature_scale(cortex, 1.2 * own) == 1.2 * own
    assert curvature_scale(cortex, 0.9 * own) is None  # too coarse
    assert curvature_scale(cortex, 1000.0) is None  # too small


def test_a_cohort_is_measured_with_one_scale_and_one_width(commanded, cwd, monkeypatch, capsys):
    lengths = {"anna": [(12.0, 20.0)], "ben": [(14.0, 24.0)], "cleo": []}
    monkeypatch.setattr(participant, "read_scales", lambda subject: lengths[subject.name])
    assert commanded() == 0
    assert json.loads(capsys.readouterr().out)["remarks"] == []  # all were measured in the same way
    for name in NAMES:
        summary = json.loads((cwd / "out" / "subjects" / name / "summary.json").read_text())
        assert summary["parameters"]["gyral_width_mm"] == 22.0
        assert [entry["parameters"]["graph_width_mm"] for entry in summary["surfaces"]] == [22.0, 22.0]
    assert commanded("--gyral-width", "9", "--curvature-scale", "30") == 0
    summary = json.loads((cwd / "out" / "subjects" / "anna" / "summary.json").read_text())
    assert [entry["parameters"]["curvature_scale_mm"] for entry in summary["surfaces"]] == [30.0, 30.0]
    (cwd / "out" / SCALES_FILE).write_text("{}")
    capsys.readouterr()
    refused(capsys, ["cohort", "subjects", "-o", "out"], SCALES_FILE)


# the command -------------------------------------------------------------------------------------------------


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


def test_the_command_refuses_folders_of_others(cwd, capsys):
    write_subject(cwd / "subjects" / "anna")
    (cwd / "theirs").mkdir()
    (cwd / "theirs" / "notes.txt").touch()
    for command in (["cohort", "subjects"], ["sweep", "demo", "--seeds", "2"]):
        begin_collection(cwd / command[0], command[0])
        (cwd / command[0] / "group").mkdir()
        (cwd / command[0] / "group" / "notes.txt").touch()
    before = contents(cwd)
    refused(capsys, ["cohort", "subjects", "-o", "theirs"], "theirs", "[exists-already]")
    refused(capsys, ["cohort", "subjects", "-o", "subjects"], "subjects", "[options-clash]")
    refused(capsys, ["cohort", "subjects", "--subjects", "none.txt"], "none.txt", "[no-such-file]")
    for command in (["cohort", "subjects"], ["sweep", "demo", "--seeds", "2"]):
        refused(capsys, [*command, "-o", command[0]], "group: morphofold did not write this folder")
    assert contents(cwd) == before


def test_a_cohort_is_replaced_by_no_other_command_and_replaces_none(tmp_path):
    begin_collection(tmp_path / "study", "cohort")
    (tmp_path / "study" / "kept").touch()
    begin_collection(tmp_path / "study", "cohort")  # the next run
    with pytest.raises(FileExistsError, match=r"\bstudy\b.*\bcohort\b.*\bsweep\b"):
        begin_collection(tmp_path / "study", "sweep")
    with pytest.raises(FileExistsError, match="which is not replaced"), atomic_folder(tmp_path / "study"):
        pass
    assert (tmp_path / "study" / "kept").exists()
    with atomic_folder(tmp_path / "analysis") as folder:
        (folder / "kept").touch()
    with pytest.raises(FileExistsError, match="replaces the folder as a whole"):
        begin_collection(tmp_path / "analysis", "cohort")


def test_where_there_are_no_workers_nothing_is_written(cwd, capsys, monkeypatch):
    write_subject(cwd / "subjects" / "anna")
    monkeypatch.setattr("morphofold.group.workers.SCHEDULER_TIMEOUT_S", 0.2)
    commands = ["cohort", "subjects", "-o", "out"], ["bids", "subjects", "out", "participant"]
    for command in commands:
        refused(capsys, [*command, "--memory", "0.001"], " 0.0 GiB", "[too-large]")
    for command in (*commands, ["sweep", "demo", "--vary", "mu_ratio=1,2", "-o", "out"]):
        refused(capsys, [*command, "--scheduler", "tcp://127.0.0.1:9"], "tcp://127.0.0.1:9")
    assert os.listdir(cwd) == ["subjects"]


def running(folder, out):
    """The command in a process of its own, and the processes of its workers once there are some."""
    import psutil

    words = ["cohort", str(folder), "-o", str(out), "--no-report", "--workers", "2"]
    command = [sys.executable, "-m", "morphofold", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    parent = psutil.Process(process.pid)
    while process.poll() is None and not any((out / "logs").glob("*.log")):
        time.sleep(0.05)
    return process, [p for p in parent.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_workers_and_a_killed_run_leave_the_same_tables(tmp_path):
    import psutil

    folder = tmp_path / "subjects"
    for i in range(8):
        write_subject(folder / f"sub-{i}", 1 + i / 40)
    (folder / "sub-3" / "surf" / "rh.pial").write_bytes(b"no surface")
    process, _ = running(folder, tmp_path / "whole")
    process.communicate()
    assert process.returncode == 1

    out = tmp_path / "out"
    process, workers = running(folder, out)
    assert len(workers) >= 2
    workers[-1].kill()
    while process.poll() is None and len(list((out / "records").glob("*.json"))) < 3:
        time.sleep(0.05)
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(workers, timeout=30)
    assert not alive  # no orphan goes on
    times = {p.name: p.stat().st_mtime_ns for p in (out / "records").glob("*.json")}
    assert 0 < len(times) < 8

    process, _ = running(folder, out)
    output = process.communicate()[0]
    assert "2 workers of 1 thread, at most" in output
    assert re.search(r"8 of 8 subjects have results, \d of them from before, 1 in part -> ", output.splitlines()[-1])
    for name, when in times.items():  # what was done is not done twice
        assert (out / "records" / name).stat().st_mtime_ns == when
    assert contents(out / "group") == contents(tmp_path / "whole" / "group")
    assert not [p.name for p in (out / "subjects").iterdir() if not p.name.startswith((".", "sub-"))]
