"""``morphofold unfold``: the files that it writes, what they hold, and what it refuses."""

import json
import shutil

import numpy as np
import pytest
from commands import refused

from morphofold import shapes
from morphofold.cli import main
from morphofold.geometry import vertex_areas
from morphofold.io import read_morph, read_surface, sample_path, write_surface
from morphofold.io.cortices import read_folded
from morphofold.surface import Surface
from morphofold.tables import read_table
from morphofold.unfolding.unfold import unfold

EGG = [3.0, 2.0, 2.0]


@pytest.fixture
def subject(cwd):
    """A copy of the sample with the files that unfolding reads."""
    source = sample_path("fsaverage5")
    for folder, names in (("surf", ("white", "sphere")), ("label", ("aparc.annot", "cortex.label"))):
        (cwd / "subject" / folder).mkdir(parents=True)
        for name in names:
            shutil.copy(source / folder / f"lh.{name}", cwd / "subject" / folder)
    return cwd / "subject"


def test_an_unfolding_has_surfaces_maps_tables_and_a_page_the_same_each_time(subject, cwd, capsys):
    argv = ["unfold", "subject", "--level", "0.05", "--radius", "50", "-q"]
    assert main([*argv, "-o", "out"]) == 0
    printed, out = capsys.readouterr().out, cwd / "out"
    assert main([*argv, "-o", "again"]) == 0
    files = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert files == {name: (cwd / "again" / name).read_bytes() for name in files}
    assert set(files) == {
        *(f"surf/lh.{name}" for name in ("smooth", "sphere", "area_ratio")),
        *("unfold.tsv", "regions.tsv", "report.html", "figures/area_ratio.png", "summary.json", ".morphofold"),
    }
    white, sphere = (read_surface(subject / "surf" / f"lh.{name}") for name in ("white", "sphere"))
    unfolded = unfold(white, sphere, 0.05, radius=50)
    smooth = read_surface(out / "surf" / "lh.smooth")
    np.testing.assert_allclose(smooth.verts, unfolded.smooth().verts, atol=1e-4)
    np.testing.assert_array_equal(smooth.faces, white.faces)
    np.testing.assert_allclose(read_morph(out / "surf" / "lh.area_ratio"), unfolded.area_ratio(), rtol=1e-6)
    assert np.linalg.norm(read_surface(out / "surf" / "lh.sphere").verts, axis=1) == pytest.approx(100, abs=1e-4)
    (row,) = read_table(out / "unfold.tsv", ["hemi"])
    assert row["radius_mm"] == pytest.approx(50)
    assert row["area_mm2"] == pytest.approx(vertex_areas(smooth.verts, smooth.faces).sum(), rel=1e-6)
    assert row["thickest_cortex_mm"] == pytest.approx(row["least_convex_radius_mm"] / 1.3, rel=1e-6)
    assert row["crossings"] == 0
    assert f"{row['folded_area_mm2']:,.0f} mm2" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary["hemispheres"][0]) == set(summary["columns"])
    assert {record["path"].rpartition("/")[2] for record in summary["inputs"]} == {
        *("lh.white", "lh.sphere", "lh.aparc.annot", "lh.cortex.label")
    }
    rows = read_table(out / "regions.tsv", ["hemi", "region"])
    outside = (read_folded(subject, "lh").regions.labels < 0).any()
    for column in ("folded_percent", "smooth_percent"):
        total = sum(row[column] for row in rows)
        assert total == pytest.approx(100, abs=1e-3) if not outside else total < 100
    for row in rows:
        assert row["area_ratio"] == pytest.approx(row["folded_percent"] / row["smooth_percent"], rel=1e-5)


def test_a_closed_surface_without_a_sphere_gets_one_and_its_name_steers_no_terminal(cwd, capsys):
    verts, faces = shapes.icosphere(4)
    write_surface(cwd / "a\x1b[31m\nb.off", Surface(verts * EGG, faces))
    assert main(["unfold", "a\x1b[31m\nb.off", "-o", "o\nut", "-q", "--level", "0.01"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (len(lines), all(line.isprintable() for line in lines)) == (2, True)
    out = cwd / "o\nut"
    assert not (out / "regions.tsv").exists()
    assert json.loads((out / "summary.json").read_text())["notes"] == {"lh": {}}  # none on a medial wall
    np.testing.assert_allclose(np.linalg.norm(read_surface(out / "surf/lh.sphere").verts, axis=1), 100, atol=1e-4)
    size = np.ptp(read_surface(out / "surf/lh.smooth").verts, axis=0)
    assert size[0] / size[1] == pytest.approx(1.5, rel=0.05)


def test_both_hemispheres_of_the_sample(cwd):
    assert main(["unfold", str(sample_path("fsaverage5")), "-o", "out", "-q", "--json"]) == 0
    assert [row["hemi"] for row in read_table(cwd / "out" / "unfold.tsv", ["hemi"])] == ["lh", "rh"]


def test_a_level_out_of_range_is_refused_before_a_sphere_is_made(cwd, capsys, monkeypatch):
    write_surface("egg.off", Surface(shapes.icosphere(4)[0] * EGG, shapes.icosphere(4)[1]))
    monkeypatch.setattr("morphofold.unfolding.spheres.sphere_of", lambda *_: pytest.fail("was made before"))
    refused(capsys, ["unfold", "egg.off", "-o", "out", "-q", "--level", "7"], "[out-of-range]")


def with_island(path, centre, radius):
    """A surface with a ball beside it, in the same file."""
    surface, (verts, faces) = read_surface(path), shapes.icosphere(2)
    faces = np.concatenate([surface.faces, faces + len(surface.verts)])
    write_surface(path, Surface(np.concatenate([surface.verts, radius * verts + centre]), faces))


def test_a_speck_is_left_out_and_changes_no_number(subject):
    (subject / "label" / "lh.cortex.label").rename(subject / "label" / "other")
    (subject / "label" / "lh.aparc.annot").unlink()
    assert main(["unfold", "subject", "-o", "one", "-q"]) == 0
    with_island(subject / "surf" / "lh.white", [150.0, 0, 0], 2.0)
    with_island(subject / "surf" / "lh.sphere", [0.0, 0, 0], 100.0)
    assert main(["unfold", "subject", "-o", "two", "-q"]) == 0
    one, two = (json.loads((subject.parent / name / "summary.json").read_text()) for name in ("one", "two"))
    assert one["hemispheres"] == two["hemispheres"]
    assert "repair" in two["notes"]["lh"]
    assert "repair" not in one["notes"]["lh"]
    n = 10242
    ratio, before = (read_morph(subject.parent / name / "surf" / "lh.area_ratio") for name in ("two", "one"))
    assert len(before) == n < len(ratio)  # at the vertices of the file
    np.testing.assert_array_equal(ratio[:n], before)
    assert (ratio[n:] == 0).all()
    smooth, before = (read_surface(subject.parent / name / "surf" / "lh.smooth") for name in ("two", "one"))
    np.testing.assert_array_equal(smooth.verts[:n], before.verts)
    np.testing.assert_array_equal(smooth.faces, before.faces)


@pytest.mark.slow  # tests/test_medial_wall.py has the order of the marks
def test_what_marks_the_cortex_is_told(subject, cwd):
    source = sample_path("fsaverage5")
    for name in ("pial", "thickness"):
        shutil.copy(source / "surf" / f"lh.{name}", subject / "surf")
    shutil.copy(source / "surf" / "lh.sphere", subject / "surf" / "lh.sphere.reg")
    masks = []
    for mark in ("label/lh.cortex.label", "label/lh.aparc.annot", "surf/lh.sphere.reg", "surf/lh.thickness", None):
        assert main(["unfold", "subject", "-o", "out", "-q"]) == 0
        summary = json.loads((cwd / "out" / "summary.json").read_text())
        masks.append(summary["cortex_mask"]["lh"])
        assert ("cortex_mask" in summary["notes"]["lh"]) == (masks[-1] != "label")
        if mark:
            (subject / mark).unlink()
    assert masks == ["label", "annotation", "template", "thickness", "geometry"]


def without_sphere(subject):
    for place in ("surf/lh.sphere", "label/lh.aparc.annot", "label/lh.cortex.label"):
        (subject / place).unlink()
    return subject / "surf" / "lh.white"


@pytest.mark.parametrize(
    ("spoil", "options", "word"),
    [
        (lambda s: with_island(without_sphere(s), [200.0, 0, 0], 20.0), "-o out", "[several-pieces]"),
        (lambda s: None, "-o out --sphere sphere.reg", "lh.sphere.reg"),
        (lambda s: shutil.copy(s / "surf" / "lh.white", s / "surf" / "lh.sphere"), "-o out", "from the origin"),
        (lambda s: None, "-o out --radius=-2", "radius"),
        (lambda s: None, "-o subject", "subject"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(subject, cwd, capsys, spoil, options, word):
    spoil(subject)
    before = sorted(cwd.rglob("*"))
    refused(capsys, ["unfold", "subject", "-q", *options.split()], word)
    assert sorted(cwd.rglob("*")) == before
