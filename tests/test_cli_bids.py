"""bids: a dataset's participants and their group, called as BIDS-Apps are."""

import json
import shutil

import pytest
from commands import refused
from made_cohort import work_here, write_subject

from morphofold.cli import main
from morphofold.cli.cohort_and_bids import measured_before
from morphofold.io.atomic_folders import alone
from morphofold.results.layouts import begin_dataset, subject_place


@pytest.fixture
def dataset(cwd):
    """A BIDS dataset, data, with three FreeSurfer subjects."""
    for i, name in enumerate(("sub-01", "sub-02_ses-a", "sub-02_ses-b")):
        write_subject(cwd / "data/derivatives/freesurfer" / name, 1 + i / 10, hemis=("lh",))
    return cwd / "data/derivatives/freesurfer"


def test_impossible_datasets_are_refused(cwd, dataset, capsys):
    (cwd / "theirs").mkdir()
    (cwd / "theirs" / "notes.txt").touch()
    refused(capsys, ["bids", "data", "out", "group"], "out: ")
    refused(capsys, ["bids", "data", "theirs", "participant"], "theirs: ", "dataset_description.json")
    words = "data/derivatives/freesurfer: ", " sub-03;", "sub-01, sub-02_ses-a"
    refused(capsys, ["bids", "data", "out", "participant", "--participant-label", "03"], *words)
    assert sorted(p.name for p in cwd.iterdir()) == ["data", "theirs"]


def test_the_options_of_bids_apps_choose_sessions_and_the_source_is_named(cwd, dataset, capsys, monkeypatch):
    work_here(monkeypatch)
    (cwd / "data/dataset_description.json").write_text('{"Name": "x", "License": "CC0", "DatasetDOI": "doi:10.1/x"}')
    words = ["bids", "data", "out", "participant", "--participant_label", "02", "--no-report", "-q", "-w", "work"]
    refused(capsys, [*words, "--session-label", "c"], "ses-c")
    assert main([*words, "--session-label", "b", "--skip-bids-validation"]) == 0
    assert [folder.name for folder in sorted((cwd / "out").glob("sub-*"))] == ["sub-02sesb"]
    assert not (cwd / "work").exists()
    description = json.loads((cwd / "out/dataset_description.json").read_text())
    assert (description["License"], description["SourceDatasets"]) == ("CC0", [{"DOI": "doi:10.1/x"}])


def test_names_that_become_the_same_are_refused_before_any_work(cwd, dataset, capsys):
    for name, code in (("sub-02sesa", "named-twice"), ("---", "not-readable")):  # as sub-02_ses-a; nothing left
        write_subject(dataset / name, hemis=("lh",))
        refused(capsys, ["bids", "data", "out", "participant", "--no-report", "-q"], name, f"[{code}]")
        assert not (cwd / "out").exists()
        shutil.rmtree(dataset / name)
    for name in ("\udcff", r"\udcff"):  # the byte 0xff, and its escape spelt out
        write_subject(cwd / "all" / name, hemis=("lh",))
    refused(capsys, ["cohort", "all", "-o", "out", "-q"], "Rename one.", "[named-twice]")
    assert not (cwd / "out").exists()


def test_a_part_of_a_record_is_no_subject_and_a_dataset_is_not_listed_for_each_of_its_subjects(cwd, monkeypatch):
    """Else the time of a cohort grows with the square of its subjects."""
    begin_dataset(cwd)
    (cwd / "records").mkdir()
    for name in ("sub-01.json", ".3f2a9c0d.sub-01.json", ".3f2a9c0e.sub-02.json"):  # a killed run left two
        (cwd / "records" / name).touch()
    assert list(measured_before(cwd)) == ["sub-01"]
    monkeypatch.setattr("pathlib.Path.iterdir", None)
    assert subject_place(cwd, "sub-01") == cwd / "sub-01"


def test_participants_may_be_measured_by_several_at_once_and_a_group_by_one(cwd, dataset, capsys, monkeypatch):
    work_here(monkeypatch)
    begin_dataset(cwd / "out")
    with alone(cwd / "out"):
        assert main(["bids", "data", "out", "participant", "--no-report", "-q"]) == 0
        assert capsys.readouterr().out.startswith("3 of 3 subjects have results -> ")
        refused(capsys, ["bids", "data", "out", "group"], "out: another run")


@pytest.mark.slow
@pytest.mark.parametrize("place", ["derivatives/freesurfer", "sourcedata/freesurfer", "."])
def test_participants_then_group(cwd, dataset, capsys, place):
    dataset.rename(cwd / "subjects")
    shutil.rmtree(cwd / "data")
    shutil.copytree(cwd / "subjects", cwd / "data" / place)
    argv = ["bids", "data", "out", "participant", "--no-report", "--workers", "1", "-q"]
    assert main([*argv, "--participant-label", "02"]) == 0
    assert capsys.readouterr().out.startswith("2 of 2 subjects have results -> ")
    assert main([*argv, "--participant-label", "sub-01", "02"]) == 0
    assert capsys.readouterr().out.startswith("3 of 3 subjects have results, 2 of them from before -> ")
    assert main(["bids", "data", "out", "group", "-q"]) == 0
    assert capsys.readouterr().out.startswith("3 subjects -> ")
    rows = (cwd / "out" / "group" / "measures.tsv").read_text().splitlines()
    assert {row.split("\t")[0] for row in rows[1:]} == {"sub-01", "sub-02_ses-a", "sub-02_ses-b"}
    assert "group" in (cwd / "out" / ".bidsignore").read_text().split()
