"""A cohort: each subject by itself, done once, done anew where something changed; tables that say it all."""

import csv
import errno
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from commands import refused
from made_cohort import HereFleet, participants, quick_measure, write_subject
from pyarrow import parquet

import morphofold
from morphofold.cli import main
from morphofold.cohort import participant, statistics, tables, tasks
from morphofold.cohort.fleet import Lost
from morphofold.cohort.group import write_group
from morphofold.cohort.running import run_tasks
from morphofold.cohort.subjects import find_subjects, folder_of, named_subjects
from morphofold.cohort.tables import TIDY_COLUMNS, read_results
from morphofold.errors import NamedTwice, NothingToDo, NotReadable, WrongFile
from morphofold.inference.sessions import person_and_session
from morphofold.io import atomic_folder, begin_collection, write_annotation, write_morph
from morphofold.results import read_analysis
from morphofold.surface import Regions
from morphofold.tables import read_table


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", quick_measure)


@pytest.fixture
def three(tmp_path):
    return [write_subject(tmp_path / "subjects" / name, 1 + i / 10) for i, name in enumerate(("anna", "ben", "cleo"))]


def measured(folders, out, run="1", **options):
    done = run_tasks(HereFleet(), participant.measure_participant, participants(folders, out, run, **options))
    return {one.name: one for one in done}


def states(outcomes):
    return {name: one.state for name, one in outcomes.items()}


def grouped(folders, out):
    write_group(out, {one.name: one.results for one in participants(folders, out)}, report=False)
    with (out / "group" / "measures.tsv").open(newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def failures(out):
    with (out / "group" / "failures.tsv").open(newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_every_number_is_one_row(three, tmp_path, quick):
    out = tmp_path / "out"
    assert states(measured(three, out)) == dict.fromkeys(("anna", "ben", "cleo"), "done")
    rows = grouped(three, out)
    assert list(rows[0]) == list(TIDY_COLUMNS)
    keys = [(r["subject"], r["hemi"], r["region"], r["measure"]) for r in rows]
    assert len(set(keys)) == len(keys)
    found = dict(zip(keys, (r["value"] for r in rows)))
    for name, size in (("anna", 1.0), ("ben", 1.1), ("cleo", 1.2)):
        (lh, rh) = read_analysis(out / "subjects" / name)
        assert float(found[name, "rh", "hemisphere", "mean_cortical_thickness_mm"]) == pytest.approx(
            rh.scalars["mean_cortical_thickness_mm"], rel=1e-6
        )
        assert lh.scalars["mean_cortical_thickness_mm"] == pytest.approx(4 * size, rel=0.1)
        back = float(found[name, "lh", "back", "cortical_thickness_mm"])
        assert back == pytest.approx(1 + lh.scalars["mean_cortical_thickness_mm"], rel=1e-6)
    assert found["anna", "lh", "hemisphere", "wavelength_mm"] == "n/a"
    assert failures(out) == []


def test_parquet_says_the_same_as_text(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    rows = grouped(three, out)
    table = parquet.read_table(out / "group" / "measures.parquet")
    assert table.column_names == list(TIDY_COLUMNS)
    assert len(table) == len(rows)
    for entry, row in zip(table.to_pylist(), rows):
        assert [entry[k] for k in TIDY_COLUMNS[:-1]] == [row[k] for k in TIDY_COLUMNS[:-1]]
        assert row["value"] == ("n/a" if entry["value"] is None else f"{entry['value']:.7g}")


def test_one_bad_subject_stops_no_other(three, tmp_path, quick):
    out = tmp_path / "out"
    (three[1] / "surf" / "rh.pial").write_bytes(b"no surface")
    shutil.rmtree(three[2] / "surf")
    found = measured(three, out)
    assert states(found) == {"anna": "done", "ben": "done", "cleo": "failed"}
    rows = grouped(three, out)
    assert {(r["subject"], r["hemi"]) for r in rows} == {("anna", "lh"), ("anna", "rh"), ("ben", "lh")}
    reasons = {(r["subject"], r["hemi"]): r["reason"] for r in failures(out)}
    assert set(reasons) == {("ben", "rh"), ("cleo", "lh"), ("cleo", "rh")}
    assert "rh.pial" in reasons["ben", "rh"]
    assert "lh.white" in reasons["cleo", "lh"]
    assert "rh.white" in reasons["cleo", "rh"]
    log = (out / "logs" / "ben.log").read_text()
    assert "rh failed: " in log
    assert "done in" in log
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "reused", "cleo": "failed"}


def test_what_has_not_changed_stays_as_it_is(three, tmp_path, quick, monkeypatch):
    out = tmp_path / "out"
    measured(three, out)
    before = contents(out)
    assert b"done in" in before["logs/ben.log"]
    monkeypatch.setattr("morphofold.analysis.measuring.measure", None)  # nothing may be measured
    assert states(measured(three, out, "2")) == dict.fromkeys(("anna", "ben", "cleo"), "reused")
    assert contents(out) == before  # logs, too: they tell of what is there


@pytest.mark.parametrize("name", ["surf/lh.white", "surf/rh.thickness", "label/lh.aparc.annot"])
def test_a_changed_input_is_measured_anew(three, tmp_path, quick, name):
    out = tmp_path / "out"
    measured(three, out)
    before = (three[1] / name).read_bytes()
    other = write_subject(tmp_path / "other", 1.3)
    write_morph(other / "surf" / "rh.thickness", np.full(162, 3.0))
    regions = Regions(np.zeros(162, int), ("all",), np.array([[9, 9, 9]], np.uint8))
    write_annotation(other / "label" / "lh.aparc.annot", regions)
    shutil.copy(other / name, three[1] / name)
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "done", "cleo": "reused"}
    (three[1] / name).write_bytes(before)
    assert states(measured(three, out, "3"))["ben"] == "done"


@pytest.mark.parametrize("name", ["surf/rh.thickness", "label/lh.aparc.annot"])
def test_an_input_that_comes_or_goes_is_a_change(three, tmp_path, quick, name):
    out = tmp_path / "out"
    measured(three, out)
    held = (three[1] / name).rename(tmp_path / "held")
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "done", "cleo": "reused"}
    held.rename(three[1] / name)
    assert states(measured(three, out, "3"))["ben"] == "done"


def test_what_an_analysis_says_of_its_surfaces_is_an_input_too(three, tmp_path, quick):
    measured(three, tmp_path / "first")
    folder = tmp_path / "first" / "subjects" / "ben"  # analysed, and analysed again
    assert states(measured([folder], tmp_path / "out")) == {"ben": "done"}
    summary = json.loads((folder / "summary.json").read_text())
    for entry in summary["surfaces"]:
        entry["units"] = "scene"
    (folder / "summary.json").write_text(json.dumps(summary))
    assert states(measured([folder], tmp_path / "out", "2")) == {"ben": "done"}
    (entry, _) = json.loads((tmp_path / "out" / "subjects" / "ben" / "summary.json").read_text())["surfaces"]
    assert entry["units"] == "scene"


def test_the_reason_is_that_of_the_surface_that_is_missing_now(three, tmp_path, quick):
    out, surf = tmp_path / "out", three[0] / "surf"
    (surf / "rh.white").rename(surf / "held")
    assert "rh.white: no such" in measured(three, out)["anna"].failures["rh"]
    (surf / "held").rename(surf / "rh.white")
    (surf / "rh.pial").unlink()
    assert "rh.pial: no such" in measured(three, out, "2")["anna"].failures["rh"]
    assert states(measured(three, out, "3"))["anna"] == "reused"


def test_a_subject_that_may_not_be_looked_into_fails_by_itself(three, tmp_path, quick, monkeypatch):
    from pathlib import Path

    look = Path.is_dir

    def is_dir(path, **how):
        if three[1] in path.parents:
            raise PermissionError(13, "Permission denied", str(path))
        return look(path, **how)

    monkeypatch.setattr(Path, "is_dir", is_dir)
    assert find_subjects(three[0].parent)[0] == ["anna", "ben", "cleo"]
    found = measured(three, tmp_path / "out")
    assert states(found) == {"anna": "done", "ben": "failed", "cleo": "done"}
    assert "Permission denied" in found["ben"].failures[""]
    assert "Permission denied" in (tmp_path / "out" / "logs" / "ben.log").read_text()


def test_other_options_and_versions_are_measured_anew(three, tmp_path, quick, monkeypatch):
    out = tmp_path / "out"
    measured(three, out)
    other = {"options": {"curvature_scale_mm": 4.0}}
    assert set(states(measured(three, out, "2", **other)).values()) == {"done"}
    assert set(states(measured(three, out, "3", **other)).values()) == {"reused"}
    monkeypatch.setattr(morphofold, "__version__", "0.0.0")
    assert set(states(measured(three, out, "4", **other)).values()) == {"done"}


def test_results_that_are_lost_are_measured_anew(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    shutil.rmtree(out / "subjects" / "ben")
    (out / "records" / "cleo.json").write_text("{")
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "done", "cleo": "done"}


def another_number(folder, other):
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    summary["surfaces"][0]["measures"]["gyrification_index"] = 9.9
    path.write_text(json.dumps(summary))


def exchanged(folder, other):
    for one, two in ((folder, folder.with_name("held")), (other, folder), (folder.with_name("held"), other)):
        os.rename(one, two)


def lost_surface(folder, other):
    (folder / "surf" / "lh.pial").unlink()


def test_a_subject_whose_list_of_files_is_damaged_fails_alone(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    folder = out / "subjects" / "ben"
    (folder / ".morphofold").write_text("")  # what is in the folder is then somebody's
    kept = (folder / "summary.json").read_bytes()
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "failed", "cleo": "reused"}
    assert (folder / "summary.json").read_bytes() == kept


@pytest.mark.parametrize("change", [another_number, exchanged, lost_surface])
def test_results_that_are_not_as_they_were_written_are_measured_anew(three, tmp_path, quick, capsys, change):
    out = tmp_path / "out"
    measured(three, out)
    rows, before = grouped(three, out), contents(out / "subjects")
    change(out / "subjects" / "ben", out / "subjects" / "cleo")
    touched = {"ben", "cleo"} if change is exchanged else {"ben"}
    if change in (another_number, exchanged):  # tables are of no such numbers until then
        assert {row["subject"] for row in grouped(three, out)}.isdisjoint(touched)
        assert {row["subject"] for row in failures(out)} == touched
    found = measured(three, out, "2")
    assert {name for name, one in found.items() if one.changed} == touched
    assert states(found) == {name: "done" if name in touched else "reused" for name in ("anna", "ben", "cleo")}
    assert grouped(three, out) == rows
    after = contents(out / "subjects")
    assert {name for name in before if before[name] != after.get(name)} <= {f"{one}/cost.json" for one in touched}
    assert not any(one.changed for one in measured(three, out, "3").values())


def test_a_file_of_its_user_stays_beside_results_and_is_no_change_of_them(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    notes = out / "subjects" / "ben" / "notes.txt"
    notes.write_text("mine")
    assert set(states(measured(three, out, "2")).values()) == {"reused"}
    assert set(states(measured(three, out, "3", options={"gyral_width_mm": 9.0})).values()) == {"done"}
    assert notes.read_text() == "mine"
    shutil.rmtree(three[1] / "surf")
    assert states(measured(three, out, "4"))["ben"] == "failed"
    assert notes.read_text() == "mine"
    assert not (notes.parent / "summary.json").exists()


def test_inputs_that_change_while_they_are_measured_are_no_result(three, tmp_path, quick, monkeypatch):
    """They were exchanged after the key was taken of them: the record would be of the old, the numbers of the new."""
    out, read, other = tmp_path / "out", participant.read_parcellated, write_subject(tmp_path / "other", 1.3)

    def late(folder, *args, **options):
        if folder.endswith("ben"):
            shutil.copy(other / "surf" / "lh.pial", f"{folder}/surf/lh.pial")
        return read(folder, *args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(participant, "read_parcellated", late)
        found = measured(three, out)
    assert states(found) == {"anna": "done", "ben": "failed", "cleo": "done"}
    assert "lh.pial" in found["ben"].failures[""]
    assert states(measured(three, out, "2"))["ben"] == "done"


@pytest.fixture
def commanded(here, quick, monkeypatch):
    """The command in this process, its exit code and what it says."""

    def run(*words):
        return main(["cohort", "subjects", "-o", "out", "--no-report", "-q", "--json", *words])

    @contextmanager
    def open_fleet(**asked):
        yield HereFleet()

    monkeypatch.setattr("morphofold.cohort.fleet.open_fleet", open_fleet)
    for i, name in enumerate(("anna", "ben", "cleo")):
        write_subject(here / "subjects" / name, 1 + i / 10)
    return run


def test_a_folder_whose_name_is_no_text_is_a_subject_like_others(commanded, here, capsys):
    (here / "subjects" / "ben").rename(here / "subjects" / "\udcff")
    (here / "subjects" / "\udcff" / "surf" / "rh.pial").unlink()
    assert commanded() == 1
    summary = json.loads(capsys.readouterr().out)
    assert (summary["subjects"], summary["with_results"]) == (3, 3)
    assert set(summary["failures"]["\\udcff"]) == {"rh"}
    rows = [line.split("\t") for line in (here / "out/group/measures.tsv").read_text(encoding="utf-8").splitlines()]
    assert {row[0] for row in rows[1:]} == {"anna", "\\udcff", "cleo"}
    for path in (here / "out").rglob("*"):
        assert not path.is_file() or path.suffix == ".parquet" or "\udcff" not in path.name
    (here / "out/subjects/\\udcff/summary.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "bad", ["long name", "folder for a record", "folder for a log", "link for a log", "link for a lock", "file for all"]
)
def test_what_cannot_be_written_of_one_subject_stops_no_other(commanded, here, capsys, bad):
    name, out, victim = "ben", here / "out", here / "victim"
    victim.write_text("mine")
    if bad == "long name":
        name = 251 * "x"
        (here / "subjects" / "ben").rename(here / "subjects" / name)
    elif bad == "folder for a record":
        assert commanded() == 0
        capsys.readouterr()
        (out / "records" / "ben.json").unlink()
        (out / "records" / "ben.json").mkdir()
    else:
        for folder in ("logs", "records", "subjects"):
            (out / folder).mkdir(parents=True)
        (out / ".morphofold-collection").write_text("cohort: made")
    if bad == "folder for a log":
        (out / "logs" / "ben.log").mkdir()
    elif bad == "link for a log":
        (out / "logs" / "ben.log").symlink_to("/dev/full")
    elif bad == "link for a lock":
        (out / "records" / "ben.lock").symlink_to(victim)
    elif bad == "file for all":
        (out / "subjects" / "ben").write_text("mine")
    for _ in range(2):  # the next run tells the same
        assert commanded() == 1
        summary = json.loads(capsys.readouterr().out)
        assert (summary["with_results"], set(summary["failures"])) == (2, {name})
        assert {row["subject"] for row in failures(out)} == {name}
        assert [row["reason"] for row in failures(out)] == [" ".join(summary["failures"][name][""].split())]
        with (out / "group" / "measures.tsv").open() as file:
            assert {row["subject"] for row in csv.DictReader(file, delimiter="\t")} == {"anna", "cleo"}
    assert victim.read_text() == "mine"


@pytest.mark.parametrize("name", ["summary.json", "regions.tsv"])
def test_damaged_results_are_measured_anew_and_told_until_then(three, tmp_path, quick, name):
    out = tmp_path / "out"
    measured(three, out)
    whole = grouped(three, out)
    file = out / "subjects" / "ben" / name
    file.write_bytes(file.read_bytes()[:-40])
    assert {row["subject"] for row in grouped(three, out)} == {"anna", "cleo"}
    (failure,) = failures(out)
    assert (failure["subject"], failure["hemi"]) == ("ben", "n/a")
    assert name in failure["reason"]
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "done", "cleo": "reused"}
    assert grouped(three, out) == whole
    assert failures(out) == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("hemi", "left"),
        ("measures", [1.0]),
        ("measures", {"n_vertices": "many"}),
        ("measures", {"n_vertices": [1]}),
        ("measures", {"n_vertices": np.nan}),
        ("measures", {"n_vertices": 10**400}),
        ("notes", None),
    ],
)
def test_results_that_are_json_and_not_ours_are_refused(three, tmp_path, quick, key, value):
    measured(three[:1], tmp_path / "out")
    file = tmp_path / "out" / "subjects" / "anna" / "summary.json"
    summary = json.loads(file.read_text())
    summary["surfaces"][1][key] = value
    file.write_text(json.dumps(summary))
    with pytest.raises(ValueError, match=r"anna.summary\.json: "):
        read_results(file.parent)


@pytest.mark.parametrize(("old", "new"), [("\t10\t", "\t1O\t"), ("gyral_thickness_mm", "gyral"), ("front", "n/a")])
def test_a_damaged_number_in_a_table_is_told_and_measured_anew(three, tmp_path, quick, old, new):
    out = tmp_path / "out"
    measured(three, out)
    whole = grouped(three, out)
    file = out / "subjects" / "anna" / "regions.tsv"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    assert {row["subject"] for row in grouped(three, out)} == {"ben", "cleo"}
    assert "regions.tsv: line 2" in failures(out)[0]["reason"]
    assert states(measured(three, out, "2"))["anna"] == "done"
    assert grouped(three, out) == whole


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"key": "a"}',
        '{"key": 1, "failures": {}, "results": true}',
        "[" * 10**5,
        '{"key": "a", "failures": {"lh": 5}, "results": false}',
        "\ud800",
        '{"key": "a", "failures": {}, "results": true, "files": {}}',
        '{"key": "a", "failures": {}, "results": false, "files": {}}',
    ],
)
def test_a_damaged_record_is_none(tmp_path, text):
    (tmp_path / "anna.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    assert tasks.read_record(tmp_path / "anna.json") == {}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_for_a_record_is_none_and_waits_for_nobody(tmp_path):
    os.mkfifo(tmp_path / "anna.json")
    assert tasks.read_record(tmp_path / "anna.json") == {}


@pytest.mark.parametrize("there", ["file", "link to nothing"])
def test_where_records_can_not_be_nobody_is_waited_for(three, tmp_path, quick, monkeypatch, there):
    out = tmp_path / "out"
    out.mkdir()
    if there == "file":
        (out / "records").write_text("mine")
    else:
        (out / "records").symlink_to(tmp_path / "nowhere")
    monkeypatch.setattr(tasks.time, "sleep", lambda seconds: pytest.fail("waited"))
    outcome = participant.measure_participant(participants(three[:1], out)[0])
    assert outcome.state == "failed"
    assert str(out / "records") in outcome.failures[""]


def test_a_full_disk_is_told_in_words(three, tmp_path, quick, monkeypatch):
    def full(*args, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(tmp_path / "out" / "x"))

    monkeypatch.setattr("morphofold.results.write_analysis", full)
    outcome = participant.measure_participant(participants(three[:1], tmp_path / "out")[0])
    assert outcome.failures == {"": f"{tmp_path / 'out' / 'x'}: {os.strerror(errno.ENOSPC)}."}


def test_results_of_what_can_no_longer_be_measured_go(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    for hemi in ("lh", "rh"):
        (three[0] / "surf" / f"{hemi}.white").write_bytes(b"no surface")
    assert states(measured(three, out, "2"))["anna"] == "failed"
    assert not (out / "subjects" / "anna").exists()
    assert "anna" not in {row["subject"] for row in grouped(three, out)}


def test_somebody_elses_folder_stays_where_a_subject_cannot_be_measured(three, tmp_path, quick):
    place = tmp_path / "out" / "subjects" / "anna"
    place.mkdir(parents=True)
    (place / "notes.txt").write_text("mine")
    assert "did not write this folder" in measured(three, tmp_path / "out")["anna"].failures[""]
    shutil.rmtree(three[0] / "surf")
    assert set(measured(three, tmp_path / "out", "2")["anna"].failures) == {"lh", "rh"}
    assert (place / "notes.txt").read_text() == "mine"


def test_what_the_machine_is_to_blame_for_is_tried_again(three, tmp_path, quick, monkeypatch):
    out = tmp_path / "out"

    def full(*args, **options):
        raise OSError(28, "No space left on device", "out")

    with monkeypatch.context() as patch:
        patch.setattr("morphofold.results.write_analysis", full)
        found = measured(three, out)
    assert set(states(found).values()) == {"failed"}
    assert "No space left" in found["anna"].failures[""]
    assert "Traceback" in (out / "logs" / "anna.log").read_text()
    assert set(states(measured(three, out, "2")).values()) == {"done"}


def test_a_defect_is_told_as_such_and_stops_no_other(three, tmp_path, quick, monkeypatch):
    def broken(cortex, **options):
        if cortex.name == "ben":
            raise KeyError("gyri")
        return quick_measure(cortex, **options)

    monkeypatch.setattr("morphofold.analysis.measuring.measure", broken)
    found = measured(three, tmp_path / "out")
    assert states(found) == {"anna": "done", "ben": "failed", "cleo": "done"}
    assert found["ben"].failures[""].startswith("KeyError: 'gyri' (a defect")


def test_a_subject_that_is_lost_with_its_workers_is_told_and_tried_again(three, tmp_path, quick):
    class Losing(HereFleet):
        def run(self, work, jobs):
            for job, outcome in super().run(work, jobs):
                yield job, Lost("3 workers died") if job.name == "ben" else outcome

    out = tmp_path / "out"
    found = run_tasks(Losing(), participant.measure_participant, participants(three, out))
    assert [one.state for one in found] == ["done", "failed", "done"]
    grouped(three, out)
    assert [(r["subject"], r["reason"]) for r in failures(out)] == [("ben", "3 workers died")]
    assert states(measured(three, out, "2")) == {"anna": "reused", "ben": "done", "cleo": "reused"}


def test_a_worker_given_up_for_lost_and_the_next_one_at_its_subject_do_not_mix(three, tmp_path, quick, monkeypatch):
    """One of an earlier run with other options; results and record are those of one worker in the end."""
    out, other = tmp_path / "out", {"options": {"curvature_scale_mm": 4.0}}
    at_it, go = threading.Event(), threading.Event()

    def measure(cortex, curvature_scale=None, **options):
        if curvature_scale is None:
            at_it.set()
            assert go.wait(60)
        return quick_measure(cortex)

    monkeypatch.setattr("morphofold.analysis.measuring.measure", measure)
    monkeypatch.setattr(tasks, "PAUSE_BETWEEN_CHECKS", 0.01)
    lost = threading.Thread(target=measured, args=(three[:1], out))
    following = threading.Thread(target=measured, args=(three[:1], out, "2"), kwargs=other)
    with warnings.catch_warnings():  # what two threads do to them is undone
        lost.start()
        assert at_it.wait(60)
        following.start()
        while following.is_alive() and "waiting: " not in (out / "logs" / "anna.log").read_text():
            time.sleep(0.01)
        go.set()
        lost.join()
        following.join()
    summary = json.loads((out / "subjects" / "anna" / "summary.json").read_text())
    assert summary["parameters"]["curvature_scale_mm"] == 4.0
    assert states(measured(three[:1], out, "3", **other)) == {"anna": "reused"}
    assert sorted(os.listdir(out / "records")) == ["anna.json"]


def test_attempts_are_counted_in_the_log(three, tmp_path, quick, monkeypatch):
    out = tmp_path / "out"

    class Killed(BaseException):
        pass

    def killed(*args, **options):
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr("morphofold.analysis.measuring.measure", killed)
        with pytest.raises(Killed):
            measured(three[:1], out)
    assert measured(three[:1], out)["anna"].attempt == 2
    assert measured(three[:1], out, "2")["anna"].attempt == 1  # another run of the command


def test_tables_are_the_same_however_the_work_went(three, tmp_path, quick):
    first, second = tmp_path / "first", tmp_path / "second"
    measured(three, first)
    measured(three[::-1][:1], second)
    measured(three[::-1], second, "2")
    for out in (first, second):
        grouped(three, out)
    assert contents(first / "group") == contents(second / "group")


def test_one_batch_of_subjects_is_held_at_a_time(three, tmp_path, quick, monkeypatch):
    out = tmp_path / "out"
    measured(three, out)
    whole = grouped(three, out)
    monkeypatch.setattr(tables, "SUBJECTS_PER_BATCH", 2)
    sizes, write = [], tables.TidyWriter.write
    monkeypatch.setattr(tables.TidyWriter, "write", lambda self, rows: (sizes.append(len(rows)), write(self, rows)))
    assert grouped(three, out) == whole
    assert len(sizes) == 2
    assert sum(sizes) == len(whole)


def test_numbers_of_hemispheres_measured_unlike_are_not_pooled(three, tmp_path, quick):
    """Two subjects by one gyral width and one by another: hinges are pooled of the two, thickness of all three."""
    out = tmp_path / "out"
    measured(three, out)
    measured(three[:1], out, "2", options={"gyral_width_mm": 11.0})
    group = write_group(out, {one.name: one.results for one in participants(three, out)}, report=False)
    assert group.n_measured == 3
    assert group.pooling.counts == {"graph_width_mm": {9.0: 4, 11.0: 2}}
    assert group.pooling.left_out == {"n_hinges": (2, 6)}
    pooled = statistics.measures_of(group)
    assert np.isnan(pooled["n_hinges"]).tolist() == [[True] * 2, [False] * 2, [False] * 2]
    assert np.isfinite(pooled["mean_cortical_thickness_mm"]).all()
    rows = read_table(out / "group" / "hemispheres.tsv", ("subject", "hemi", "morphofold", "cortex_mask", "accuracy"))
    assert [row["graph_width_mm"] for row in rows] == [11, 11, 9, 9, 9, 9]
    values = [r["value"] for r in grouped(three, out) if (r["region"], r["measure"]) == ("hemisphere", "n_hinges")]
    assert values == ["20"] * 6  # the table has all of them


def test_regions_of_hemispheres_measured_unlike_are_not_averaged(three, tmp_path, quick):
    out = tmp_path / "out"
    measured(three, out)
    measured(three[:1], out, "2", options={"accuracy": "draft"})
    group = write_group(out, {one.name: one.results for one in participants(three, out)}, report=False)
    assert group.regions["front"][:, :, 0].tolist() == [[2, 2], [2, 2]]
    measured(three[:2], out, "3", options={"accuracy": "draft"})
    group = write_group(out, {one.name: one.results for one in participants(three, out)}, report=False)
    assert group.pooling.left_out["mean_cortical_thickness_mm"] == (2, 6)
    assert group.regions["front"][:, :, 0].tolist() == [[2, 2], [2, 2]]


def test_subjects_that_are_the_same_are_found(three, tmp_path, quick):
    shutil.copytree(three[0], three[0].with_name("zoe"))
    folders = [*three, three[0].with_name("zoe")]
    out = tmp_path / "out"
    measured(folders, out)
    group = write_group(out, {one.name: one.results for one in participants(folders, out)}, report=False)
    assert group.same == [["anna", "zoe"]]


def test_the_bids_layout_holds_the_same_numbers(three, tmp_path, quick):
    from morphofold.results.dataset import begin_dataset

    plain, bids = tmp_path / "plain", tmp_path / "bids"
    begin_dataset(bids, ignoring=("group", "logs", "records"))
    measured(three, plain)
    assert set(states(measured(three, bids, bids=True)).values()) == {"done"}
    assert set(states(measured(three, bids, "2", bids=True)).values()) == {"reused"}
    assert (bids / "sub-anna" / "anat").is_dir()
    for name in ("anna", "cleo"):
        one, other = read_results(plain / "subjects" / name), read_results(bids / f"sub-{name}")
        assert [e["measures"] for e in one.entries] == [e["measures"] for e in other.entries]
        assert one.surfaces == other.surfaces


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
        ("sub-01_ses-2.long.sub-01", ("sub-01", "ses-2")),
        ("sub-01_ses-pre", ("sub-01", "ses-pre")),
        ("anna_tp2", ("anna", "tp2")),
        ("anna.visit_03", ("anna", "visit_03")),
        ("smith_tpatel", ("smith_tpatel", "")),
        ("sub-v01", ("sub-v01", "")),
        ("HC_v02", ("HC_v02", "")),
        ("HC_v12", ("HC_v12", "")),
        ("anna_v2", ("anna", "v2")),
        ("sub-v01_ses-2", ("sub-v01", "ses-2")),
        ("study_v2_007", ("study_v2_007", "")),
        ("sub-01_ses-1.long.sub-01_base", ("sub-01", "ses-1")),
        ("sub-01", ("sub-01", "")),
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
    found, left_out = find_subjects(tmp_path)
    assert found == [
        *("anna_1.long.anna", "ben", "ben_1", "ben_2", "sub-03_ses-1", "sub-05", "sub-04_ses-1", "sub-04_ses-2")
    ]
    assert {k: v.split()[0] for k, v in left_out.items()} == {
        **{"anna": "base", "anna_1": "cross-sectional", "anna_2": "cross-sectional", "ben_base": "base"}
    }
    assert folder_of(tmp_path, "sub-04_ses-2") == tmp_path / "sub-04" / "ses-2"
    assert folder_of(tmp_path, "sub-03_ses-1") == tmp_path / "sub-03_ses-1"


def test_a_person_with_several_sessions_counts_once(commanded, here, capsys):
    for k, size in ((1, 1.5), (2, 1.7)):
        write_subject(here / "subjects" / f"dora_ses{k}.long.dora", size)
        write_subject(here / "subjects" / f"dora_ses{k}", 5.0)
    write_subject(here / "subjects" / "dora", 5.0)
    assert commanded("--curvature-scale", "8", "--gyral-width", "9") == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer["left_out"]) == {"dora", "dora_ses1", "dora_ses2"}
    assert len(answer["remarks"]) == 1
    group = here / "out" / "group"
    rows = read_table(group / "surfaces.tsv", ("subject", "person", "session", "hemi"))
    assert {(row["person"], row["session"]) for row in rows} == {
        *((name, None) for name in ("anna", "ben", "cleo")),
        *(("dora", session) for session in ("ses1", "ses2")),
    }
    spread = {(r["measure"], r["hemi"]): r for r in read_table(group / "distributions.tsv", ("measure", "hemi"))}
    thickness = spread["mean_cortical_thickness_mm", "lh"]
    assert thickness["n"] == 4
    one = [
        np.mean([r["mean_cortical_thickness_mm"] for r in rows if (r["person"], r["hemi"]) == (who, "lh")])
        for who in ("anna", "ben", "cleo", "dora")
    ]
    assert thickness["mean"] == pytest.approx(np.mean(one), rel=1e-5)
    assert thickness["sd"] == pytest.approx(np.std(one, ddof=1), rel=1e-5)


def test_regions_of_a_person_with_several_sessions_count_once(three, tmp_path, quick):
    names = {"anna": "dora_ses1.long.dora", "cleo": "dora_ses2.long.dora"}
    folders = [f.rename(f.with_name(names[f.name])) if f.name in names else f for f in three]
    measured(folders, tmp_path / "out")
    results = {one.name: one.results for one in participants(folders, tmp_path / "out")}
    group = write_group(tmp_path / "out", results, report=False)
    means = [
        [
            float(r["value"])
            for r in grouped(folders, tmp_path / "out")
            if (r["hemi"], r["region"], r["measure"]) == ("lh", "front", "cortical_thickness_mm")
            and r["subject"].startswith(who)
        ]
        for who in ("ben", "dora")
    ]
    n, mean, sd = group.regions["front"][0, 0]
    assert n == 2
    assert mean == pytest.approx(np.mean([np.mean(m) for m in means]), rel=1e-6)
    assert sd == pytest.approx(np.std([np.mean(m) for m in means]), rel=1e-4)


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        (b"anna\nben\nanna\n", NamedTwice, " anna "),
        (b"# none\n\n", NothingToDo, ""),
        (b"../anna\n", NotReadable, "'\\.\\./anna'"),
        (b"\xff\xfe\x00", WrongFile, "UTF-8"),
    ],
)
def test_lists_of_subjects_that_are_none(tmp_path, text, kind, expected):
    file = tmp_path / "list.txt"
    file.write_bytes(text)
    with pytest.raises(kind, match=rf"list\.txt: .*{expected}"):
        named_subjects(file)


def test_lists_of_subjects(tmp_path):
    file = tmp_path / "list.txt"
    file.write_text("\ufeffben  # the second\n\nanna/\n", encoding="utf-8")
    assert named_subjects(file) == ["ben", "anna"]


def test_the_command_refuses_what_it_cannot_do(here, capsys):
    write_subject(here / "subjects" / "anna")
    (here / "theirs").mkdir()
    (here / "theirs" / "notes.txt").touch()
    for words, expected in (
        (["nowhere"], "no such folder"),
        (["subjects", "-o", "theirs"], "did not write this folder"),
        (["subjects", "-o", "subjects"], "is, or holds, the input"),
        (["subjects", "--workers", "0"], "[out-of-range]"),
        (["subjects", "--gyral-width", "-1"], "got -1. [out-of-range]"),
        (["subjects", "--subjects", "none.txt"], "no such file"),
    ):
        refused(capsys, ["cohort", *words], expected)
    assert sorted(os.listdir(here / "theirs")) == ["notes.txt"]
    assert sorted(os.listdir(here)) == ["subjects", "theirs"]


@pytest.mark.parametrize("command", [["cohort", "subjects"], ["sweep", "demo", "--seeds", "2"]])
def test_a_group_that_is_somebody_elses_is_refused_before_anything_is_measured(here, capsys, command):
    write_subject(here / "subjects" / "anna")
    begin_collection(here / "out", command[0])
    (here / "out" / "group").mkdir()
    (here / "out" / "group" / "notes.txt").touch()
    before = contents(here / "out")
    refused(capsys, [*command, "-o", "out"], "group: morphofold did not write this folder")
    assert contents(here / "out") == before


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


def test_where_there_are_no_workers_nothing_is_written(here, capsys, monkeypatch):
    write_subject(here / "subjects" / "anna")
    monkeypatch.setattr("morphofold.cohort.fleet.SCHEDULER_TIMEOUT_S", 0.2)
    for words, expected in (
        (["--scheduler", "tcp://127.0.0.1:9"], ("tcp://127.0.0.1:9",)),
        (["--memory", "0.001"], (" 0.0 GiB", "[too-large]")),
    ):
        refused(capsys, ["cohort", "subjects", "-o", "out", *words], *expected)
        refused(capsys, ["sweep", "demo", "--vary", "mu_ratio=1,2", "-o", "out", *words], *expected)
        refused(capsys, ["bids", "subjects", "out", "participant", *words], *expected)
    assert os.listdir(here) == ["subjects"]


@pytest.mark.slow
def test_the_command_from_end_to_end(here, capsys):
    for i, name in enumerate(("anna", "ben")):
        write_subject(here / "subjects" / name, 1 + i / 10)
    (here / "subjects" / "ben" / "surf" / "lh.pial").write_bytes(b"no surface")
    asked = ["cohort", "subjects", "-o", "out", "--no-report", "--workers", "1"]
    assert main(asked) == 1
    captured = capsys.readouterr()
    assert "1 worker of 1 thread, at most" in captured.err
    assert captured.out.splitlines()[-1].startswith("2 of 2 subjects have results, 1 in part -> ")
    before = contents(here / "out" / "group")
    write_subject(here / "subjects" / "ben", 1.1)
    assert main([*asked, "-q"]) == 0
    assert capsys.readouterr().out.startswith("2 of 2 subjects have results, 1 of them from before -> ")
    assert contents(here / "out" / "group") != before
    assert json.loads((here / "out" / "records" / "ben.json").read_text())["failures"] == {}
    (here / "subjects" / "ben" / "surf" / "lh.pial").write_bytes(b"no surface")
    assert main([*asked, "-q", "--json"]) == 1
    summary = json.loads(capsys.readouterr().out)
    assert [summary[k] for k in ("subjects", "with_results", "from_before", "failed", "in_part")] == [2, 2, 1, 0, 1]
    assert "lh.pial" in summary["failures"]["ben"]["lh"]
    assert contents(here / "out" / "group") == before


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


@pytest.mark.slow
def test_two_runs_into_one_folder_are_refused(tmp_path):
    folder = tmp_path / "subjects"
    for i in range(4):
        write_subject(folder / f"sub-{i}")
    process, _ = running(folder, tmp_path / "out", "--workers", "1")
    second, _ = running(folder, tmp_path / "out", "--workers", "1")
    output = second.communicate()[0]
    assert second.returncode == 2
    assert "another run is writing here" in output
    process.communicate()
    assert process.returncode == 0


def test_the_parcellation_is_one_of_the_options_that_results_follow_from(three, tmp_path, quick):
    out, asked = tmp_path / "out", {"annotation": "aparc.a2009s"}
    label = three[0] / "label"
    for hemi in ("lh", "rh"):
        regions = Regions(np.zeros(162, int), ("all",), np.array([[9, 9, 9]], np.uint8))
        write_annotation(label / f"{hemi}.aparc.a2009s.annot", regions)
    assert states(measured(three[:2], out)) == {"anna": "done", "ben": "done"}
    assert states(measured(three[:2], out, "2", options=asked)) == {"anna": "done", "ben": "failed"}
    assert read_results(out / "subjects" / "anna").hows[0][-1] == "aparc.a2009s"
    assert {row["region"] for row in read_results(out / "subjects" / "anna").regions} == {"all"}
    assert states(measured(three[:2], out, "3", options=asked)) == {"anna": "reused", "ben": "failed"}
    for hemi in ("lh", "rh"):
        shutil.copy(label / f"{hemi}.aparc.a2009s.annot", three[1] / "label")
    assert states(measured(three[:2], out, "4", options=asked)) == {"anna": "reused", "ben": "done"}


def test_what_freesurfer_says_of_a_brain_is_in_the_table_of_hemispheres(three, tmp_path, quick):
    (three[0] / "stats").mkdir()
    (three[0] / "stats" / "aseg.stats").write_text(
        "# Measure EstimatedTotalIntraCranialVol, eTIV, Estimated Total Intracranial Volume, 1500000.5, mm^3\n"
        "# Measure rhSurfaceHoles, rhSurfaceHoles, Number of defect holes in rh surfaces prior to fixing, 7, unitless\n"
    )
    out = tmp_path / "out"
    measured(three, out)
    grouped(three, out)
    words = ("subject", "hemi", "morphofold", "cortex_mask", "accuracy", "annotation")
    rows = read_table(out / "group" / "hemispheres.tsv", words)
    assert [(row["subject"], row["hemi"]) for row in rows[:2]] == [("anna", "lh"), ("anna", "rh")]
    found = [(row["etiv_mm3"], row["surface_holes"]) for row in rows[:3]]
    assert found == [(1500000, None), (1500000, 7), (None, None)]
    (three[0] / "stats" / "aseg.stats").unlink()
    assert states(measured(three, out, "2"))["anna"] == "done"  # it is an input like the surfaces
