"""Which vertices are cortex, by the first sign of the medial wall; parcellations carried from a template."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from commands import refused
from made_cohort import write_subject

from morphofold import shapes
from morphofold.analysis.notes import of_input
from morphofold.cli import main
from morphofold.errors import Mismatch, MissingPart
from morphofold.geometry import edges, split
from morphofold.io import read_annotation, read_cortex, read_surface, sample_path, write_annotation, write_surface
from morphofold.mesh_quality.cortex_checks import cortex_label, cortex_mask, wall_of_geometry, wall_of_thickness
from morphofold.mesh_quality.repair import measurable
from morphofold.shapes import icosphere
from morphofold.spheres.template_folders import check_template, read_parcellated
from morphofold.surface import Cortex, Regions, Surface

NOISE = 0.1  # mm, of every coordinate


@pytest.fixture(scope="module")
def average():
    return read_cortex(sample_path("fsaverage5"))


def closed(fraction, *, gap=0.0, level=4, **more):
    """Spheres of 47 and 50 mm, but ``gap`` [mm] on a polar cap with so large a share of the area."""
    verts, faces = shapes.icosphere(level)
    away = np.where(verts[:, 2] > 1 - 2 * fraction, 50.0 - gap, 47.0)
    white, pial = Surface(away[:, None] * verts, faces, "lh.white"), Surface(50 * verts, faces, "lh.pial")
    return Cortex(white, pial, **more)


def noisy(cortex, rng, size=NOISE):
    moved = {
        name: replace(s, verts=s.verts + rng.normal(0, size, s.verts.shape))
        for name, s in (("white", cortex.white), ("pial", cortex.pial))
    }
    return replace(cortex, **moved)


def dice(mask, other):
    return 2 * np.sum(mask & other) / (mask.sum() + other.sum())


def test_the_first_sign_that_there_is_says_where_cortex_is(average):
    sources, cortex = [], average
    for missing in ({}, {"cortex": None}, {"regions": None}, {"maps": {}}):
        cortex = replace(cortex, **missing)
        label, word = cortex_label(cortex)
        sources.append(word)
        assert not label.all()
        assert ("cortex_mask" in of_input(cortex)) == (word != "label")
    assert sources == ["label", "annotation", "thickness", "geometry"]


@pytest.mark.parametrize("hemi", ["rh"])
def test_the_label_of_the_template_comes_over_by_the_registered_sphere(hemi):
    """fsaverage5 gets its own label back, and a coarser mesh of the same sphere the label of its vertices."""
    cortex = read_cortex(sample_path("fsaverage5"), hemi)
    bare = replace(cortex, cortex=None, regions=None, registered=cortex.sphere)
    label, word = cortex_label(bare)
    assert word == "template"
    assert np.array_equal(label, cortex.cortex)
    assert "cortex_mask" in of_input(bare)
    by_template, by_label = measurable(bare), measurable(cortex)
    assert np.array_equal(cortex_mask(by_template.cortex), cortex_mask(by_label.cortex))
    assert cortex_label(by_template.cortex)[1] == "template"


def test_a_sphere_registered_to_another_template_carries_no_label(average):
    rotated = replace(average.sphere, verts=average.sphere.verts @ np.diag([-1.0, -1.0, 1.0]))
    bare = replace(average, cortex=None, regions=None, maps={}, registered=rotated)
    assert cortex_label(bare)[1] == "geometry"
    assert np.array_equal(cortex_label(bare)[0], ~wall_of_geometry(bare))


@pytest.mark.parametrize("hemi", ["lh", "rh"])
def test_the_wall_that_geometry_finds_lies_within_that_of_the_label(hemi):
    cortex = read_cortex(sample_path("fsaverage5"), hemi)
    wall = wall_of_geometry(cortex)
    assert wall[cortex.cortex].sum() < 0.01 * wall.sum()  # of rh one vertex, on the rim
    coincident = np.all(cortex.white.verts == cortex.pial.verts, axis=1)
    assert dice(wall, ~cortex.cortex) > 0.68 > 0.55 > dice(coincident, ~cortex.cortex)
    # the rest is the hippocampus and what is near it, where FreeSurfer's white and pial are millimetres apart


@pytest.mark.parametrize("size", [0.05, 0.2])
def test_noise_of_the_vertices_does_not_tear_the_wall(average, rng, size):
    bare = replace(average, cortex=None, regions=None, maps={})
    rough = noisy(bare, rng, size)
    assert not np.all(rough.white.verts == rough.pial.verts, axis=1).any()
    assert dice(wall_of_geometry(rough), wall_of_geometry(bare)) > 0.97
    assert not wall_of_geometry(rough)[average.cortex].any()


@pytest.mark.parametrize(
    "cortex",
    [
        closed(0.0),
        closed(0.06, gap=1.5),
        closed(0.005, gap=0.1),
        closed(0.3, gap=0.1),
        closed(0.06, gap=0.1, origin="simulation"),
        replace(closed(0.0), white=replace(closed(0.0).white, verts=49.9 / 47 * closed(0.0).white.verts)),
    ],
    ids=["none", "half as thick", "too small", "too large", "simulated", "thin everywhere"],
)
def test_what_does_not_look_like_a_wall_is_cortex(cortex):
    label, word = cortex_label(cortex)
    assert word == ""
    assert label.all()


def test_a_patch_of_zeros_in_the_thickness_is_the_wall_and_scattered_zeros_are_not(rng):
    cortex = closed(0.0)
    patch, few = cortex.pial.verts[:, 2] > 44, rng.random(cortex.n_vertices) < 0.02
    for missing in (0.0, np.nan):
        thickness = np.where(patch, missing, 3.0)
        patched = replace(cortex, maps={"thickness": thickness})
        label, word = cortex_label(patched)
        assert word == "thickness"
        assert np.array_equal(~label, patch)
        gaps = replace(cortex, maps={"thickness": np.where(few, missing, 3.0)})
        assert wall_of_thickness(gaps).sum() == 0


AVERAGE = sample_path("fsaverage5")


def write_sphere(folder, hemi="lh", level=2):
    write_surface(folder / "surf" / f"{hemi}.sphere.reg", Surface(*icosphere(level, radius=100.0)))


@pytest.fixture
def bert(tmp_path):
    """A subject of 162 vertices a hemisphere, with registered spheres and no parcellation."""
    folder = write_subject(tmp_path / "all" / "bert")
    shutil.rmtree(folder / "label")
    for hemi in ("lh", "rh"):
        write_sphere(folder, hemi)
    return folder


@pytest.fixture
def halves(tmp_path):
    """A template of 642 vertices with two parcellations: a south and a north, and all one."""
    folder = tmp_path / "halves"
    verts, faces = icosphere(3, radius=100.0)
    for part in ("surf", "label"):
        (folder / part).mkdir(parents=True)
    colours = np.array([[9, 9, 9], [99, 9, 9]], np.uint8)
    for hemi in ("lh", "rh"):
        for kind in ("sphere.reg", "white"):
            write_surface(folder / "surf" / f"{hemi}.{kind}", Surface(verts, faces))
        for name, labels in (("aparc", (verts[:, 2] > 0).astype(int)), ("aparc.whole", np.zeros(len(verts), int))):
            write_annotation(folder / "label" / f"{hemi}.{name}.annot", Regions(labels, ("south", "north"), colours))
    return folder


def test_on_a_finer_mesh_only_vertices_between_two_regions_are_in_doubt(tmp_path):
    sphere = read_surface(AVERAGE / "surf" / "lh.sphere")
    own = read_annotation(AVERAGE / "label" / "lh.aparc.annot").labels
    ends, (finer, faces) = edges(sphere.faces), split(sphere.verts, sphere.faces)
    finer *= 100 / np.linalg.norm(finer, axis=1, keepdims=True)
    (tmp_path / "finer" / "surf").mkdir(parents=True)
    for name, radius in (("white", 0.5), ("pial", 0.6), ("sphere.reg", 1.0)):
        write_surface(tmp_path / "finer" / "surf" / f"lh.{name}", Surface(radius * finer, faces))
    labels = read_parcellated(tmp_path / "finer", "lh", annotation_from="fsaverage5").regions.labels
    n = len(own)
    np.testing.assert_array_equal(labels[:n], own)
    of_ends = own[ends]
    same = of_ends[:, 0] == of_ends[:, 1]
    np.testing.assert_array_equal(labels[n:][same], of_ends[same, 0])
    assert (labels[n:][:, None] == of_ends).any(axis=1).all()
    assert 0 < (~same).sum() < 0.1 * len(same)


def test_a_coarser_mesh_gets_the_label_of_most_area(bert, halves):
    labels = read_parcellated(bert, "lh", annotation_from=halves).regions.labels
    z = icosphere(2)[0][:, 2]
    np.testing.assert_array_equal(labels[np.abs(z) > 0.1], (z > 0)[np.abs(z) > 0.1])


def test_a_subject_with_a_parcellation_keeps_its_own(bert, halves):
    write_subject(bert)
    own, cortex = read_cortex(bert), read_parcellated(bert, "lh", annotation_from=halves)
    np.testing.assert_array_equal(cortex.regions.labels, own.regions.labels)
    assert (cortex.regions.name, cortex.files, cortex.info) == ("aparc", own.files, own.info)


def test_the_parcellation_that_is_named_is_carried_where_only_another_is_there(bert, halves):
    write_subject(bert)
    regions = read_parcellated(bert, "lh", annotation="whole", annotation_from=halves).regions
    assert regions.name == "aparc.whole.halves"
    assert not regions.labels.any()


def test_what_does_not_fit_is_refused(bert, halves, tmp_path):
    write_sphere(bert, level=3)
    with pytest.raises(Mismatch, match="642 vertices"):
        read_parcellated(bert, "lh", annotation_from=halves)
    (bert / "surf" / "lh.sphere.reg").unlink()
    with pytest.raises(FileNotFoundError, match=r"lh\.sphere\.reg"):
        read_parcellated(bert, "lh", annotation_from=halves)
    with pytest.raises(MissingPart, match=r"lh\.aparc\.whole\.annot"):
        check_template(halves, "a2009s")
    with pytest.raises(FileNotFoundError, match="fsaverage5"):
        check_template(tmp_path / "nowhere")
    for hemi in ("lh", "rh"):
        (halves / "surf" / f"{hemi}.sphere.reg").unlink()
    with pytest.raises(MissingPart, match=r"lh\.sphere"):
        check_template(halves)


def test_an_analysis_says_from_where_its_regions_are(bert, halves, cwd):
    assert main(["analyze", str(bert), "-q", "--no-report", "--annot-from", str(halves), "-o", "out"]) == 0
    summary = json.loads((cwd / "out" / "summary.json").read_text(encoding="utf-8"))
    digests = {row["path"]: row["sha256"] for row in summary["inputs"]}
    for entry in summary["surfaces"]:
        hemi = entry["hemi"]
        assert "template halves" in entry["notes"]["annotation_from"]
        assert (entry["annotation"], entry["info"]["annotation_from"]) == ("aparc.halves", "halves")
        assert digests[str(halves / "label" / f"{hemi}.aparc.annot")]
        assert digests[str(bert / "surf" / f"{hemi}.sphere.reg")]
        assert (cwd / "out" / "label" / f"{hemi}.aparc.halves.annot").is_file()
        assert (cwd / "out" / "stats" / f"{hemi}.aparc.halves.gyral.stats").is_file()
        assert "average" not in entry["notes"]
    assert read_cortex(cwd / "out").regions.name == "aparc.halves"
    assert main(["analyze", str(bert), "-q", "--no-report", "--annot-from", "fsaverage5", "-o", "out"]) == 0
    (entry, _) = json.loads((cwd / "out" / "summary.json").read_text(encoding="utf-8"))["surfaces"]
    assert "average" not in entry["notes"]  # the template is one, and not the subject


@pytest.mark.parametrize("command", ["analyze", "cohort"])
def test_a_template_that_has_none_is_refused_before_anything_is_measured(command, bert, cwd, capsys, monkeypatch):
    monkeypatch.setattr("morphofold.analysis.measuring.measure", lambda *a, **k: pytest.fail("was measured"))
    path = str(bert if command == "analyze" else bert.parent)
    for template, word in (("nowhere", "nowhere: "), ("S1", "lh.aparc.annot"), (str(bert), "lh.aparc.annot")):
        refused(capsys, [command, path, "-q", "-o", "out", "--annot-from", template], word)
    assert not (cwd / "out").exists()


def test_two_files_have_no_registered_sphere(bert, capsys):
    pair = ["--white", str(bert / "surf" / "lh.white"), "--pial", str(bert / "surf" / "lh.pial")]
    refused(capsys, ["analyze", *pair, "--annot-from", "fsaverage5", "-q"], "--annot-from", "[options-clash]")
