"""analyze on FreeSurfer subjects: found by name, read as they are, never written to."""

import shutil

import numpy as np
import pytest
from commands import refused

from morphofold.cli import main
from morphofold.io import read_label, sample_path
from morphofold.io.cortices import hemispheres
from morphofold.results import read_analysis


def subjects(folder, *names):
    """FreeSurfer subjects in ``folder``: copies of fsaverage5's surfaces and labels."""
    for name in names:
        shutil.copytree(sample_path("fsaverage5"), folder / name)
    return folder


@pytest.mark.parametrize(("lost", "left"), [("pial", "white"), ("white", "pial")])
def test_half_a_hemisphere_is_refused_and_not_left_out(here, capsys, monkeypatch, lost, left):
    monkeypatch.setenv("SUBJECTS_DIR", str(subjects(here, "bert")))
    (here / "bert" / "surf" / f"lh.{lost}").unlink()
    said = f"bert: surf/lh.{left} is there and surf/lh.{lost} is not. Restore it, or pass --hemi rh"
    refused(capsys, ["analyze", "-s", "bert", "-o", "out"], said)
    refused(capsys, ["analyze", "bert", "-o", "out"], said)
    assert not (here / "out").exists()


def test_a_subject_with_one_hemisphere_is_measured_by_it(here):
    subjects(here, "bert")
    for name in ("lh.white", "lh.pial"):
        (here / "bert" / "surf" / name).unlink()
    assert hemispheres(here / "bert") == ("rh",)
    (here / "bert" / "surf" / "rh.pial").unlink()
    assert hemispheres(here / "bert") == ("rh",)                        # for the reader to say what is missing


@pytest.mark.slow
def test_a_subject_is_found_by_name_with_both_hemispheres_and_its_medial_wall_left_out(here, capsys, monkeypatch):
    there = subjects(here / "all", "bert")
    before = sorted((p, p.stat().st_mtime_ns) for p in there.rglob("*"))
    monkeypatch.setenv("SUBJECTS_DIR", str(there))
    assert main(["analyze", "-s", "bert/", "-q", "--no-report"]) == 0       # as a shell completes it
    told = capsys.readouterr().out
    assert "bert lh: 10,242 vertices" in told
    assert "bert rh: 10,242 vertices" in told
    for m in read_analysis(here / "bert-analysis"):
        wall = ~read_label(there / "bert" / "label" / f"{m.cortex.hemi}.cortex.label", 10242)
        assert wall.sum() > 800
        assert all(np.isnan(values[wall]).all() for name, values in m.maps.items() if name != "area")
        assert np.isfinite(m.maps["H"]).mean() > 0.9
    assert sorted((p, p.stat().st_mtime_ns) for p in there.rglob("*")) == before


@pytest.mark.slow
def test_the_name_of_a_subject_is_that_of_its_link(here, capsys, monkeypatch):
    monkeypatch.setenv("SUBJECTS_DIR", str(here / "nowhere"))
    (subjects(here / "all", "bert") / "ernie").symlink_to("bert")
    argv = ["analyze", "-s", "ernie", "--sd", "all", "--hemi", "rh", "-q", "--no-report"]
    assert main([*argv, "--wide", "--mgh"]) == 0
    assert capsys.readouterr().out.startswith("ernie rh")
    assert (here / "ernie-analysis" / "surf" / "rh.pial").is_file()
    assert (here / "ernie-analysis" / "maps" / "rh.H.mgh").is_file()
    header, row = (here / "ernie-analysis" / "regions_wide.tsv").read_text().splitlines()
    assert header.startswith("subject\trh_bankssts_n_vertices\trh_bankssts_area\trh_bankssts_thickness\t")
    assert row.startswith("ernie\t")


def test_a_subject_that_cannot_be_found_is_refused_with_those_that_are_there(here, capsys, monkeypatch):
    monkeypatch.delenv("SUBJECTS_DIR", raising=False)
    refused(capsys, ["analyze", "-s", "bert"], "SUBJECTS_DIR", "--subjects-dir")
    monkeypatch.setenv("SUBJECTS_DIR", "")
    refused(capsys, ["analyze", "-s", "bert"], "SUBJECTS_DIR", "--subjects-dir")
    refused(capsys, ["analyze", "-s", "bert", "--sd", "nowhere"], "nowhere", "no such folder")
    for name in ("anna", "bert_1", "bert_2", *(f"z{i}" for i in range(9))):
        (here / "all" / name / "surf").mkdir(parents=True)
    (here / "all" / "bert_logs").mkdir()
    told = "In --subjects-dir are bert_2, bert_1, anna, z0, z1, z2, z3, z4 and 4 more."
    refused(capsys, ["analyze", "-s", "bert_22", "--subjects-dir", "all"], "bert_22: no such subject", told)
    refused(capsys, ["analyze", "-s", "all/anna", "--sd", "."], "is no name of a folder", "INPUT")
    refused(capsys, ["analyze", "-s", "anna", "--sd", "all"], "lh.white")
    refused(capsys, ["analyze", "all/anna", "-s", "anna", "--sd", "all"], "in place of INPUT")
    refused(capsys, ["analyze", "-s", "anna", "--white", "a", "--pial", "b", "--sd", "all"], "in place of INPUT")
    refused(capsys, ["analyze", "all/anna", "--sd", "all"], "--subjects-dir goes with -s")
    assert [p.name for p in here.iterdir()] == ["all"]


def test_an_analysis_is_refused_inside_its_subject_before_anything_is_measured(here, capsys, monkeypatch):
    there = subjects(here / "all", "bert") / "bert"
    before = sorted(there.rglob("*"))
    monkeypatch.setattr("morphofold.analysis.measures.measure", lambda *a, **k: pytest.fail("was measured"))
    for out in ("all/bert/morphofold", "all/bert/surf"):
        refused(capsys, ["analyze", "-s", "bert", "--sd", "all", "-q", "-o", out], "all/bert")
    monkeypatch.chdir(there)
    refused(capsys, ["analyze", "-s", "bert", "--sd", "..", "-q"], "bert-analysis lies in the folder of the input")
    assert sorted(there.rglob("*")) == before
