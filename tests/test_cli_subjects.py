"""analyze on FreeSurfer subjects: found by name, read as they are, never written to."""

import html
import json
import shlex
import shutil

import numpy as np
import pytest
from commands import refused
from made_spaces import write_space

from morphofold.cli import main
from morphofold.io import read_label, read_surface, sample_path, write_surface
from morphofold.io.cortices import hemispheres
from morphofold.results import read_analysis
from morphofold.shapes import icosphere
from morphofold.surface import Surface


@pytest.mark.parametrize(
    "words",
    [
        "analyze bert/surf/.. -o {}",
        "unfold bert -o {}",
        "unfold bert/surf/lh.white -o {}",
        "compare a=bert -o {}",
        "cohort others -o {}",
        "cohort others -o {} --layout bids",
        "bids others {} participant --fs-subjects-dir others",
        "sweep demo --seeds 2 -o {}",
        "stats study --model 'H ~ 1' --contrast 1 -o {}",
        "overlap study -o {}",
        "simulate demo -o {}",
        "demo -o {}",
        "demo --subjects 2 -o {}",
        "reproduce fig3 -o {}",
        "bench cohort --subjects 2 -o {}",
        "theory radius --plot {}.png",
    ],
)
@pytest.mark.parametrize("place", ["bert/surf/x", pytest.param("link/surf/x", marks=pytest.mark.slow)])
def test_no_command_writes_into_a_subject(cwd, capsys, words, place):
    two_sides(cwd / "bert")
    two_sides(cwd / "others" / "anna")
    (cwd / "link").symlink_to("bert")
    write_space(cwd / "study", {"lh.H": np.ones((4, 642))})
    before = sorted(cwd.rglob("*"))
    refused(capsys, shlex.split(words.format(place)), "x", "[options-clash]")
    assert sorted(cwd.rglob("*")) == before


def two_sides(folder):
    """A subject of two spheres, right and left."""
    verts, faces = icosphere(2)
    (folder / "surf").mkdir(parents=True)
    for hemi, x in (("lh", -60.0), ("rh", 60.0)):
        for name, radius in (("white", 47.0), ("pial", 50.0)):
            write_surface(folder / "surf" / f"{hemi}.{name}", Surface(radius * verts + [x, 0, 0], faces))
    return folder


def cannot_be_measured(folder, hemi):
    """The surfaces of one side with a hole, sewn together so that they have one side only."""
    for path in (folder / "surf").glob(f"{hemi}.*"):
        surface = read_surface(path)
        faces = surface.faces.copy()
        a, b = faces[[10, 200]]
        faces = np.delete(faces, [10, 200], axis=0)
        for corner, gone in zip(a, b):
            faces[faces == gone] = corner
        write_surface(path, Surface(surface.verts, faces))


def cut(folder, hemi):
    path = folder / "surf" / f"{hemi}.pial"
    path.write_bytes(path.read_bytes()[:1000])


def lacking(folder, hemi):
    (folder / "surf" / f"{hemi}.white").unlink()


@pytest.mark.parametrize(
    ("fault", "hemi", "layout"),
    [
        (cannot_be_measured, "rh", "plain"),
        pytest.param(cut, "lh", "plain", marks=pytest.mark.slow),
        pytest.param(lacking, "rh", "bids", marks=pytest.mark.slow),
    ],
)
def test_a_side_that_cannot_be_measured_does_not_take_the_other_with_it(cwd, capsys, fault, hemi, layout):
    other = {"lh": "rh", "rh": "lh"}[hemi]
    fault(two_sides(cwd / "bert"), hemi)
    refused(capsys, ["analyze", "bert", "--hemi", hemi, "-q"], "bert")
    assert list(cwd.iterdir()) == [cwd / "bert"]
    assert main(["analyze", "bert", "-q", "-o", "out", "--json", "--layout", layout]) == 1
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert [entry["hemi"] for entry in summary["surfaces"]] == [other]
    ((side, reason),) = summary["failed"].items()
    assert side == hemi
    assert f"bert {hemi}" in reason or f"surf/{hemi}." in reason
    assert captured.err.splitlines() == [f"{hemi} failed: {reason}"]
    page = next((cwd / "out").rglob("report.html")).read_text(encoding="utf-8")
    assert reason in html.unescape(page)
    assert [m.cortex.hemi for m in read_analysis(cwd / "out" / ("sub-bert" if layout == "bids" else "."))] == [other]


@pytest.mark.parametrize("command", ["analyze", pytest.param("cohort", marks=pytest.mark.slow)])
def test_without_repair_a_flipped_triangle_is_refused(cwd, command):
    folder = two_sides(cwd / "all" / "bert")
    for path in (folder / "surf").glob("lh.*"):
        surface = read_surface(path)
        write_surface(path, Surface(surface.verts, np.r_[surface.faces[:1, ::-1], surface.faces[1:]]))
    argv = [command, "all/bert" if command == "analyze" else "all", "-q", "--no-report", "-o", "out"]
    assert main(argv) == 0
    place = cwd / "out" if command == "analyze" else cwd / "out" / "subjects" / "bert"
    summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
    assert [entry["parameters"].get("repaired_flipped_triangles") for entry in summary["surfaces"]] == [1, None]
    assert "repair" not in summary["parameters"]
    assert main([*argv, "--no-repair"]) == 1
    summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
    assert list(summary["failed"]) == ["lh"]
    assert summary["parameters"]["repair"] is False


def test_a_subject_with_one_hemisphere_is_measured_by_it(cwd):
    subject = two_sides(cwd / "bert")
    for name in ("lh.white", "lh.pial"):
        (subject / "surf" / name).unlink()
    assert hemispheres(subject) == ("rh",)
    (subject / "surf" / "rh.pial").unlink()
    assert hemispheres(subject) == ("rh",)  # for the reader to say what is missing


@pytest.mark.slow
def test_a_subject_is_found_by_its_name_or_that_of_a_link_and_its_medial_wall_left_out(cwd, capsys, monkeypatch):
    subject = shutil.copytree(sample_path("fsaverage5"), cwd / "all" / "bert")
    before = sorted((p, p.stat().st_mtime_ns) for p in subject.rglob("*"))
    monkeypatch.setenv("SUBJECTS_DIR", str(subject.parent))
    assert main(["analyze", "-s", "bert/", "-q", "--no-report"]) == 0  # as a shell completes it
    printed = capsys.readouterr().out
    assert "bert lh: 10,242 vertices" in printed
    assert "bert rh: 10,242 vertices" in printed
    for m in read_analysis(cwd / "bert-analysis"):
        wall = ~read_label(subject / "label" / f"{m.cortex.hemi}.cortex.label", 10242)
        assert wall.sum() > 800
        assert all(np.isnan(values[wall]).all() for name, values in m.maps.items() if name != "area")
        assert np.isfinite(m.maps["H"]).mean() > 0.9
    assert sorted((p, p.stat().st_mtime_ns) for p in subject.rglob("*")) == before
    monkeypatch.setenv("SUBJECTS_DIR", str(cwd / "nowhere"))
    (cwd / "all" / "ernie").symlink_to("bert")
    argv = ["analyze", "-s", "ernie", "--sd", "all", "--hemi", "rh", "-q", "--no-report"]
    assert main([*argv, "--wide", "--mgh"]) == 0
    assert capsys.readouterr().out.startswith("ernie rh")
    assert (cwd / "ernie-analysis" / "maps" / "rh.H.mgh").is_file()
    header, row = (cwd / "ernie-analysis" / "regions_wide.tsv").read_text().splitlines()
    assert header.startswith("subject\trh_bankssts_n_vertices\trh_bankssts_area\trh_bankssts_thickness\t")
    assert row.startswith("ernie\t")


def test_an_unknown_subject_is_refused_with_similar_names(cwd, capsys, monkeypatch):
    monkeypatch.setenv("SUBJECTS_DIR", "")
    refused(capsys, ["analyze", "-s", "bert"], "-s bert: ", "SUBJECTS_DIR", "--subjects-dir", "[options-clash]")
    for name in ("anna", "bert_1", "bert_2"):
        (cwd / "all" / name / "surf").mkdir(parents=True)
    refused(capsys, ["analyze", "-s", "bert_22", "--subjects-dir", "all"], "all/bert_22: ", "bert_2, bert_1")
    refused(capsys, ["analyze", "-s", "anna", "--sd", "all"], "lh.white")
    assert [p.name for p in cwd.iterdir()] == ["all"]
