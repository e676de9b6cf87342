"""A cohort: each subject by itself, done once, done anew where something changed; tables of all."""

import errno
import json
import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import refused
from made_cohort import HereWorkers, participants, quick_measure, table, work_here, write_subject
from pyarrow import parquet

import morphofold
from morphofold.analysis.curvatures import scale_of_curvature
from morphofold.analysis.measuring import measure
from morphofold.cli import main
from morphofold.group import group_distributions, group_tables, measure_subject
from morphofold.group.change_per_year import changes, scan_years
from morphofold.group.group_tables import TIDY_COLUMNS, read_results, write_group
from morphofold.group.measure_subject import (
    MOST_SUBJECTS_READ,
    SCALES_FILE,
    Scales,
    curvature_scale,
    read_scales,
    scales_of,
)
from morphofold.group.workers import Lost, run_tasks
from morphofold.io import atomic_folder, begin_collection, read_cortex, write_morph
from morphofold.results import read_analysis
from morphofold.results.layouts import begin_dataset

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
        outcomes = run_tasks(workers or HereWorkers(), measure_subject.measure_participant, tasks)
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
    return lambda *options: main(["cohort", "subjects", "-o", "out", "--no-report", "-q", "--json", *options])


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


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


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("surf/lh.white", lambda file: shutil.copy(file.parents[2] / "cleo" / "surf" / "lh.white", file)),
        ("surf/rh.thickness", lambda file: write_morph(file, np.full(162, 3.0))),
        ("label/lh.aparc.annot", os.unlink),
    ],
)
def test_an_input_that_changes_goes_or_comes_is_measured_anew(measured, name, change):
    file = measured.folders[1] / name
    before = file.read_bytes()
    change(file)
    assert measured.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}
    file.write_bytes(before)
    assert measured.states()["ben"] == "done"


def test_the_summary_of_an_analysis_is_an_input_too(measured, tmp_path):
    folder = shutil.copytree(measured.out / "subjects" / "ben", tmp_path / "again" / "zoe")  # analysed once more
    assert measured.states([folder]) == {"zoe": "done"}
    summary = folder / "summary.json"
    summary.write_text(summary.read_text().replace('"units": "mm"', '"units": "scene"'))
    assert measured.states([folder]) == {"zoe": "done"}
    assert {m.cortex.units for m in read_analysis(measured.out / "subjects" / "zoe")} == {"scene"}


def edit_summary(folder):
    file = folder / "summary.json"
    file.write_text(file.read_text().replace('"gyrification_index": 1.5', '"gyrification_index": 9.9'))


@pytest.mark.parametrize(
    "change",
    [
        edit_summary,
        lambda folder: os.truncate(folder / "regions.tsv", 40),
        lambda folder: (folder.parent.parent / "records" / "ben.json").write_text("{"),
        shutil.rmtree,
    ],
)
def test_results_that_are_not_as_they_were_written_are_measured_anew(measured, change):
    rows, before = measured.rows(), contents(measured.out / "subjects")
    change(measured.out / "subjects" / "ben")
    assert measured.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}
    assert measured.rows() == rows
    assert measured.failures() == {}
    after = contents(measured.out / "subjects")
    assert {name for name in before if before[name] != after.get(name)} <= {"ben/cost.json"}
    assert set(measured.states().values()) == {"reused"}


def test_files_of_the_user_stay_beside_results_which_go_where_nothing_can_be_measured(measured):
    results = measured.out / "subjects" / "ben"
    (results / "notes.txt").write_text("of the user")
    assert set(measured.states().values()) == {"reused"}
    for folder in measured.folders[:2]:
        for hemi in ("lh", "rh"):
            (folder / "surf" / f"{hemi}.white").write_bytes(b"no surface")
    assert measured.states() == {"anna": "failed", "ben": "failed", "cleo": "reused"}
    assert set(os.listdir(results)) == {"notes.txt", ".morphofold"}
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
    assert all(f"{hemi}." in reason for (_, hemi), reason in reasons.items())
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
    with monkeypatch.context() as patch:
        patch.setattr("morphofold.analysis.measuring.measure", broken)
        assert study.measure()["ben"].failures[""].startswith("KeyError: 'gyri' (a defect")
    assert study.states(workers=Losing()) == {"anna": "done", "ben": "failed", "cleo": "done"}
    study.group()
    assert study.failures() == {("ben", "n/a"): "3 workers died"}
    assert study.states() == {"anna": "reused", "ben": "done", "cleo": "reused"}


# tables ------------------------------------------------------------------------------------------------------


def test_every_number_is_one_row_of_a_text_and_of_a_parquet_table(measured):
    rows = measured.rows()
    values = {(r["subject"], r["hemi"], r["region"], r["measure"]): r["value"] for r in rows}
    assert len(values) == len(rows)
    for name in NAMES:
        lh, rh = (m.scalars["mean_cortical_thickness_mm"] for m in read_analysis(measured.out / "subjects" / name))
        right = float(values[name, "rh", "hemisphere", "mean_cortical_thickness_mm"])
        assert right == pytest.approx(rh, rel=1e-6)
        assert float(values[name, "lh", "back", "cortical_thickness_mm"]) == pytest.approx(1 + lh, rel=1e-6)
    assert values["anna", "lh", "hemisphere", "wavelength_mm"] == "n/a"
    entries = parquet.read_table(measured.out / "group" / "measures.parquet")
    assert entries.column_names == list(rows[0]) == list(TIDY_COLUMNS)
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
    assert group.pooling.left_out == {"n_hinges": (2, 6)}
    pooled = group_distributions.measures_of(group)
    assert np.isnan(pooled["n_hinges"]).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert np.isfinite(pooled["mean_cortical_thickness_mm"]).all()
    values = [r["value"] for r in measured.rows() if (r["region"], r["measure"]) == ("hemisphere", "n_hinges")]
    assert values == ["20"] * 6  # the table has all of them
    measured.measure(measured.folders[:1], options={"accuracy": "draft"})
    assert measured.group().regions["front"][:, :, 0].tolist() == [[2, 2], [2, 2]]


def test_the_same_surfaces_under_two_names_are_found(study):
    study.folders.append(shutil.copytree(study.folders[0], study.folders[0].with_name("zoe")))
    study.measure()
    assert study.group().same_surfaces == [["anna", "zoe"]]


def test_the_bids_layout_holds_the_same_numbers(measured, tmp_path):
    plain, bids = measured.out, tmp_path / "bids"
    begin_dataset(bids, ignored_lines=("group", "logs", "records"))
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
    assert commanded("--curvature-scale", "8", "--gyral-width", "9") == 0
    assert set(json.loads(capsys.readouterr().out)["left_out"]) == {"dora_ses1", "dora_ses2"}
    rows = [row for row in table(cwd / "out/group/surfaces.tsv") if row["hemi"] == "lh"]
    persons = [(name, "n/a") for name in NAMES] + [("dora", "ses1"), ("dora", "ses2")]
    assert [(row["person"], row["session"]) for row in rows] == persons
    values = [float(row["mean_cortical_thickness_mm"]) for row in rows]
    means = [*values[:3], np.mean(values[3:])]
    spread = table(cwd / "out/group/distributions.tsv")
    (thickness,) = (r for r in spread if (r["measure"], r["hemi"]) == ("mean_cortical_thickness_mm", "lh"))
    numbers = [float(thickness[key]) for key in ("n", "mean", "sd")]
    assert numbers == pytest.approx([4, np.mean(means), np.std(means, ddof=1)], rel=1e-5)


def test_regions_of_a_person_with_several_sessions_count_once(study):
    anna, ben, cleo = study.folders
    study.folders = [anna.rename(anna.with_name("dora_ses1")), ben, cleo.rename(cleo.with_name("dora_ses2"))]
    study.measure()
    key = ("lh", "front", "cortical_thickness_mm")
    rows = [row for row in study.rows() if (row["hemi"], row["region"], row["measure"]) == key]
    values = {row["subject"]: float(row["value"]) for row in rows}
    means = [values["ben"], (values["dora_ses1"] + values["dora_ses2"]) / 2]
    assert study.group().regions["front"][0, 0] == pytest.approx([2, np.mean(means), np.std(means)], rel=1e-4)


def test_numbers_of_freesurfer_are_in_the_table_of_hemispheres(study):
    stats = study.folders[0] / "stats" / "aseg.stats"
    stats.parent.mkdir()
    stats.write_text("# Measure rhSurfaceHoles, rhSurfaceHoles, Number of defect holes, 7, unitless\n")
    study.measure()
    study.group()
    rows = table(study.out / "group" / "hemispheres.tsv")[:3]
    values = [(row["subject"], row["hemi"], row["surface_holes"]) for row in rows]
    assert values == [("anna", "lh", "n/a"), ("anna", "rh", "7"), ("ben", "lh", "n/a")]
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
    out = folder / "out"
    out.mkdir(exist_ok=True)
    return scales_of(out, workers or NamedLengths(), participants([folder / name for name in names], out))


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
    workers = NamedLengths()
    first = scales_by_name(tmp_path, *(f"3 {k}" for k in range(1, 1001)), workers=workers)
    assert scales_by_name(tmp_path, "3 7", "5 20", workers=workers) == first
    assert len(workers.names) == MOST_SUBJECTS_READ
    (tmp_path / "out" / SCALES_FILE).write_text('{"curvature_scale_mm": 3}')
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
    monkeypatch.setattr(measure_subject, "read_scales", lambda subject: lengths[subject.name])
    assert commanded() == 0
    assert json.loads(capsys.readouterr().out)["remarks"] == []  # all were measured in the same way
    widths = [row["graph_width_mm"] for row in table(cwd / "out/group/hemispheres.tsv")]
    assert widths == ["22"] * 6
    assert commanded("--gyral-width", "9", "--curvature-scale", "30") == 0
    (left, _) = read_analysis(cwd / "out/subjects/anna")
    assert left.parameters["curvature_scale_mm"] == 30.0


# the command -------------------------------------------------------------------------------------------------


def test_the_command_refuses_folders_of_others(cwd, capsys):
    write_subject(cwd / "subjects" / "anna")
    (cwd / "theirs").mkdir()
    (cwd / "theirs" / "notes.txt").touch()
    begin_collection(cwd / "cohort", "cohort")
    (cwd / "cohort" / "group").mkdir()
    (cwd / "cohort" / "group" / "notes.txt").touch()
    before = contents(cwd)
    refused(capsys, ["cohort", "subjects", "-o", "theirs"], "theirs", "[exists-already]")
    refused(capsys, ["cohort", "subjects", "-o", "subjects"], "subjects", "[options-clash]")
    refused(capsys, ["cohort", "subjects", "--subjects", "none.txt"], "none.txt", "[no-such-file]")
    refused(capsys, ["cohort", "subjects", "-o", "cohort"], "group: morphofold did not write this folder")
    assert contents(cwd) == before


def test_a_cohort_is_replaced_by_no_other_command_and_replaces_none(tmp_path):
    begin_collection(tmp_path / "study", "cohort")
    begin_collection(tmp_path / "study", "cohort")  # the next run
    with pytest.raises(FileExistsError, match=r"\bstudy\b.*\bcohort\b.*\bsweep\b"):
        begin_collection(tmp_path / "study", "sweep")
    with pytest.raises(FileExistsError), atomic_folder(tmp_path / "study"):
        pass
    with atomic_folder(tmp_path / "analysis") as folder:
        (folder / "summary.json").touch()
    with pytest.raises(FileExistsError):
        begin_collection(tmp_path / "analysis", "cohort")


def test_where_there_are_no_workers_nothing_is_written(cwd, capsys, monkeypatch):
    write_subject(cwd / "subjects" / "anna")
    monkeypatch.setattr("morphofold.group.workers.SCHEDULER_TIMEOUT_S", 0.2)
    for command in (["cohort", "subjects", "-o", "out"], ["bids", "subjects", "out", "participant"]):
        refused(capsys, [*command, "--memory", "0.001"], " 0.0 GiB", "[too-large]")
        refused(capsys, [*command, "--scheduler", "tcp://127.0.0.1:9"], "tcp://127.0.0.1:9")
    assert os.listdir(cwd) == ["subjects"]


def running(folder, out):
    """The command in a process of its own, and the processes of its workers once there are some."""
    import psutil

    command = [sys.executable, "-m", "morphofold", "cohort", folder, "-o", out, "--no-report", "--workers", "2"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    parent = psutil.Process(process.pid)
    while process.poll() is None and not any((out / "logs").glob("*.log")):
        time.sleep(0.05)
    return process, [p for p in parent.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_workers_and_a_killed_run_leave_the_same_tables(tmp_path):
    import psutil

    folder, out = tmp_path / "subjects", tmp_path / "out"
    for i in range(8):
        write_subject(folder / f"sub-{i}", 1 + i / 40)
    (folder / "sub-3" / "surf" / "rh.pial").write_bytes(b"no surface")
    process, _ = running(folder, tmp_path / "whole")
    assert process.wait() == 1

    process, workers = running(folder, out)
    workers[-1].kill()
    while process.poll() is None and len(list((out / "records").glob("*.json"))) < 3:
        time.sleep(0.05)
    process.kill()
    process.wait()
    _, alive = psutil.wait_procs(workers, timeout=30)
    assert not alive  # no orphan goes on
    times = {path: path.stat().st_mtime_ns for path in (out / "records").glob("*.json")}
    assert 0 < len(times) < 8

    process, _ = running(folder, out)
    assert process.wait() == 1
    assert {path: path.stat().st_mtime_ns for path in times} == times  # what was done is not done twice
    assert contents(out / "group") == contents(tmp_path / "whole" / "group")


def test_change_per_year_is_the_slope_over_the_time_of_the_scans(commanded, cwd):
    ages = {"1": 10.0, "2": 10.5, "3": 13.0}
    for session, age in ages.items():
        write_subject(cwd / "subjects" / f"dora_ses-{session}", 1 + 0.1 * (age - 10))
    (cwd / "subjects/participants.tsv").write_text("participant_id\tage\ndora\tn/a\nanna\t8\nben\t9\ncleo\t9\n")
    (cwd / "subjects/sub-dora").mkdir()
    lines = ["session_id\tage", *(f"ses-{session}\t{age}" for session, age in ages.items()), ""]
    (cwd / "subjects/sub-dora/sub-dora_sessions.tsv").write_text("\n".join(lines))
    assert commanded("--curvature-scale", "8", "--gyral-width", "9") == 0
    surfaces = {(r["subject"], r["hemi"]): r for r in table(cwd / "out/group/surfaces.tsv")}
    assert [surfaces[f"dora_ses-{session}", "lh"]["age"] for session in ages] == ["10", "10.5", "13"]
    rows = {(r["person"], r["hemi"], r["measure"]): r for r in table(cwd / "out/group/change.tsv")}
    assert {key[0] for key in rows} == {"dora"}
    thickness, at_10 = rows["dora", "lh", "mean_cortical_thickness_mm"], surfaces["dora_ses-1", "lh"]
    slope = 0.1 * float(at_10["mean_cortical_thickness_mm"])
    mean = float(at_10["mean_cortical_thickness_mm"]) * (1 + 0.1 * np.mean([age - 10 for age in ages.values()]))
    assert [thickness["n_scans"], thickness["years"]] == ["3", "3"]
    numbers = [float(thickness[key]) for key in ("per_year", "percent_per_year", "mean")]
    assert numbers == pytest.approx([slope, 100 * slope / mean, mean], rel=1e-5)
    assert float(rows["dora", "rh", "gyrification_index"]["per_year"]) == 0


def test_dates_of_scans_give_their_time_and_ages_where_a_person_has_none():
    person = np.array([0, 0, 1, 1])
    dates = [{"age": 30, "acq_time": date} for date in ("2019-01-01", "2020-01-01T12:00:00", "2021-05-05", None)]
    years = scan_years(dates, person)
    assert years[1] - years[0] == pytest.approx(365.5 / 365.25)
    assert years[2:].tolist() == [30, 30]
    (row,) = changes(["a", "b"], person, years, {"x": np.array([[1.0, np.nan], [3.0, 2.0], [4.0, 4.0], [5.0, 5.0]])})
    assert (row["person"], row["hemi"], row["n_scans"]) == ("a", "lh", 2)
    assert row["per_year"] == pytest.approx(2 * 365.25 / 365.5)
    assert changes(["a", "b"], person, scan_years([{"age": 30}] * 4, person), {"x": np.ones((4, 2))}) == []
    whole_years = [{"age": 30, "acq_time": "2019-01-01"}, {"age": 30, "acq_time": "2019-12-01"}, {"age": 8}, {"age": 9}]
    times = scan_years(whole_years, person)
    assert [times[1] - times[0], times[3] - times[2]] == pytest.approx([334 / 365.25, 1])
