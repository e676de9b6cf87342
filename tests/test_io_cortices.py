"""A cortex from a subject, a simulation, an analysis or two files: what is read, and what does not go together."""

import hashlib
import json
import re
import shutil
from dataclasses import replace

import nibabel as nib
import numpy as np
import pytest

from morphofold.analysis.measures import Measures
from morphofold.errors import (
    DamagedFile,
    DoesNotApply,
    Mismatch,
    NotFinite,
    NotReadable,
    OptionsClash,
    UnlikeSurfaces,
    WrongFile,
)
from morphofold.io import cortices, read_cortex, sample_path, write_morph, write_surface
from morphofold.results import write_analysis
from morphofold.shapes import icosphere
from morphofold.surface import Surface


def test_two_files_make_a_cortex_with_the_hemisphere_that_they_name():
    folder = sample_path("fsaverage5/surf")
    c = read_cortex(white=folder / "rh.white", pial=folder / "rh.pial")
    assert (c.hemi, c.origin, c.maps) == ("rh", "files", {})
    with pytest.raises(UnlikeSurfaces, match=r"lh\.white\b.*\blh, .*rh\.pial\b.*\brh\b"):
        read_cortex(white=folder / "lh.white", pial=folder / "rh.pial")
    with pytest.raises(WrongFile, match=r"lh\.white: .*\blh, .*\brh\b.*\blh\b"):
        read_cortex(white=folder / "lh.white", pial=folder / "lh.pial", hemi="rh")


def test_the_surf_folder_itself_stands_for_its_subject():
    assert read_cortex(sample_path("fsaverage5/surf")).regions is not None


def simulation(folder, growths=(1.2, 1.8, 9.5, 10.0)):
    verts, faces = icosphere(1, radius=50.0)
    for g in growths:
        stage = folder / "stages" / f"g{g:.2f}"
        (stage / "surf").mkdir(parents=True)
        write_surface(stage / "surf" / "lh.white", Surface(verts, faces))
        write_surface(stage / "surf" / "lh.pial", Surface(verts * 1.04, faces))
        write_morph(stage / "surf" / "lh.thickness", np.full(len(verts), 2.0))
        facts = {"name": "fig5", "g": g, "portion": 0.125, "units": "mm", "law": "isotropic", "mu_ratio": 2.0}
        (stage / "stage.json").write_text(json.dumps(facts))
    return folder


def test_a_simulation_reads_as_its_last_stage(tmp_path):
    c = read_cortex(simulation(tmp_path / "out"))
    assert (c.origin, c.name, c.hemi, c.units, c.portion) == ("simulation", "fig5 g10.00", "lh", "mm", 0.125)
    assert (c.info["g"], c.info["law"], c.info["mu_ratio"]) == (10.0, "isotropic", 2.0)
    assert c.maps["thickness"].tolist() == [2.0] * 42


def test_one_stage_of_a_simulation_can_be_named(tmp_path):
    assert read_cortex(simulation(tmp_path) / "stages" / "g1.20").info["g"] == 1.2


def test_a_simulation_without_a_stage_says_so(tmp_path):
    (tmp_path / "stages" / ".g1.20.half").mkdir(parents=True)
    with pytest.raises(FileNotFoundError, match=re.escape(str(tmp_path / "stages"))):
        read_cortex(tmp_path)


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("{", DamagedFile, r"stage\.json: "),
        ("[]", NotReadable, r"stage\.json: "),
        ('{"portion": 0}', NotReadable, r"stage\.json: portion: .*\b0\b"),
        ('{"portion": "1"}', NotReadable, r"stage\.json: portion: .*'1'"),
    ],
)
def test_a_damaged_stage_record_is_refused(tmp_path, text, kind, expected):
    stage = simulation(tmp_path) / "stages" / "g1.80"
    (stage / "stage.json").write_text(text)
    with pytest.raises(kind, match=expected):
        read_cortex(stage)


@pytest.mark.parametrize(
    ("name", "count", "write"),
    [
        ("surf/lh.thickness", "41", lambda path: write_morph(path, np.ones(41))),
        ("surf/lh.inflated", "162", lambda path: write_surface(path, Surface(*icosphere(2)))),
        (
            "label/lh.aparc.annot",
            "10,242",
            lambda path: shutil.copy(sample_path(f"fsaverage5/label/{path.name}"), path),
        ),
    ],
)
def test_a_file_of_another_subject_is_refused_by_name_when_a_cortex_is_read(tmp_path, name, count, write):
    stage = simulation(tmp_path) / "stages" / "g1.80"
    (stage / "label").mkdir()
    write(stage / name)
    with pytest.raises(Mismatch, match=rf"{name} \D*\b{count} .*surf/lh\.white 42\b"):
        read_cortex(stage)


def test_white_and_pial_of_two_subjects_are_refused():
    with pytest.raises(UnlikeSurfaces, match=r"\b10242\b.*\b152893\b"):
        read_cortex(white=sample_path("fsaverage5/surf/lh.white"), pial=sample_path("S1/lh.pial.surf.gii"))


@pytest.mark.parametrize("arguments", [{}, {"white": "lh.white"}, {"path": "x", "white": "w", "pial": "p"}])
def test_neither_or_both_ways_to_name_a_cortex_are_refused(arguments):
    with pytest.raises(TypeError, match="white="):
        read_cortex(**arguments)


def test_a_missing_hemisphere_says_what_was_looked_for():
    with pytest.raises(FileNotFoundError, match=r"rh\.white: .*\brh\.white\.surf\.gii\b"):
        read_cortex(sample_path("S1"), "rh")


def test_the_other_hemisphere_is_no_misspelling(tmp_path):
    for name in ("rh.pial", "lh.sulc", "lh.white"):
        shutil.copy(sample_path(f"fsaverage5/surf/{name}"), tmp_path)
    with pytest.raises(FileNotFoundError, match=r"lh\.pial: .*lh\.sulc, lh\.white, rh\.pial"):  # all there are
        read_cortex(tmp_path)


def test_a_missing_folder_says_what_is_missing_in_which(tmp_path):
    with pytest.raises(FileNotFoundError, match=rf"subject: .*\bnowhere\b.*{re.escape(str(tmp_path))}\."):
        read_cortex(tmp_path / "nowhere" / "such" / "subject")


def test_an_analysis_folder_reads_back_with_what_its_surfaces_were(tmp_path):
    """Origin, portion and info decide how a cortex is measured, so measuring an analysis again changes nothing."""
    (tmp_path / "surf").mkdir()
    stage = sample_path("simulated")
    for name in ("lh.white", "lh.pial"):
        (tmp_path / "surf" / name).write_bytes((stage / "surf" / name).read_bytes())
    entry = {"hemi": "lh", "name": "mine", "origin": "simulation", "units": "mm", "portion": 0.5, "info": {"g": 1.9}}
    (tmp_path / "summary.json").write_text(json.dumps({"morphofold": "0", "surfaces": [entry]}))
    cortex = read_cortex(tmp_path)
    assert (cortex.name, cortex.origin, cortex.portion, cortex.info) == ("mine", "simulation", 0.5, {"g": 1.9})
    (tmp_path / "summary.json").write_text(json.dumps({"surfaces": [{**entry, "portion": 7}]}))
    with pytest.raises(NotReadable, match=r"summary\.json: surfaces\.0\.portion: .*\b7\b"):
        read_cortex(tmp_path)


def test_an_analysis_folder_has_the_parcellation_that_it_was_made_with(tmp_path):
    cortex = read_cortex(sample_path("fsaverage5"))
    regions = replace(cortex.regions, name="aparc.a2009s")
    write_analysis([Measures(replace(cortex, regions=regions), {}, {})], tmp_path / "out", report=False)
    assert read_cortex(tmp_path / "out").regions.name == "aparc.a2009s"
    (tmp_path / "out/label/lh.aparc.a2009s.annot").unlink()
    with pytest.raises(FileNotFoundError, match=r"label/lh\.aparc\.a2009s\.annot"):
        read_cortex(tmp_path / "out")


@pytest.mark.parametrize("name", ["rh.white", "sub-01_hemi-R_white.surf.gii", "100307.R.white.surf.gii"])
def test_the_hemisphere_is_told_by_the_names_of_a_pair(tmp_path, name):
    cortex = read_cortex(sample_path("fsaverage5"), hemi="rh")
    white, pial = tmp_path / name, tmp_path / name.replace("white", "pial")
    write_surface(white, cortex.white)
    write_surface(pial, cortex.pial)
    assert read_cortex(white=white, pial=pial).hemi == "rh"
    with pytest.raises(WrongFile, match=rf"{re.escape(name)}: .*\brh, .*\blh\b"):
        read_cortex(white=white, pial=pial, hemi="lh")


def test_a_simulation_has_no_right_hemisphere_and_says_so():
    with pytest.raises(DoesNotApply, match=r"simulated: .*\blh\b"):
        read_cortex(sample_path("simulated"), hemi="rh")


def pair_of_spheres(folder):
    verts, faces = icosphere(1, radius=50.0)
    (folder / "surf").mkdir(parents=True)
    write_surface(folder / "surf" / "lh.white", Surface(verts, faces))
    write_surface(folder / "surf" / "lh.pial", Surface(verts * 1.04, faces))
    write_morph(folder / "surf" / "lh.thickness", np.full(len(verts), 2.0))
    return folder


def test_the_records_of_a_cortex_are_of_the_bytes_that_were_read(tmp_path):
    folder = pair_of_spheres(tmp_path / "anna")
    pial = folder / "surf" / "lh.pial"
    digest = hashlib.sha256(pial.read_bytes()).hexdigest()
    for cortex in (read_cortex(folder), read_cortex(white=folder / "surf" / "lh.white", pial=pial)):
        assert [row["path"] for row in cortex.inputs] == list(cortex.files)
        assert {row["path"]: row["sha256"] for row in cortex.inputs}[str(pial)] == digest


@pytest.mark.parametrize(
    ("name", "as_pair"),
    [("lh.white", False), ("lh.pial", False), ("lh.thickness", False), ("lh.white", True), ("lh.pial", True)],
)
def test_a_file_that_changes_while_it_is_read_is_refused(tmp_path, monkeypatch, name, as_pair):
    folder = pair_of_spheres(tmp_path / "anna")
    place, read = folder / "surf" / name, cortices.read_surface

    def and_then_changes(path):
        found = read(path)
        raw = place.read_bytes()  # to another of the same size that can be read
        place.write_bytes(raw.replace(b"created", b"CREATED") if b"created" in raw else raw[:-4] + bytes(4))
        return found

    monkeypatch.setattr(cortices, "read_surface", and_then_changes)
    pair = {kind: folder / "surf" / f"lh.{kind}" for kind in ("white", "pial")}
    asked = pair if as_pair else {"path": folder}
    with pytest.raises(OSError, match=re.escape(str(place))):
        read_cortex(**asked)


def test_a_folder_whose_name_is_no_text_is_read_under_a_name_that_can_be_written(tmp_path):
    folder = pair_of_spheres(tmp_path / "caf\udce9")
    cortex = read_cortex(folder)
    assert cortex.name == "caf\\udce9"
    assert cortex.name.encode("utf-8")


# --- what FreeSurfer says of a subject, and which parcellation is read

STATS = """\
# Title Segmentation Statistics
# Measure lhSurfaceHoles, lhSurfaceHoles, Number of defect holes in lh surfaces prior to fixing, 23, unitless
# Measure rhSurfaceHoles, rhSurfaceHoles, Number of defect holes in rh surfaces prior to fixing, 41, unitless
# Measure EstimatedTotalIntraCranialVol, eTIV, Estimated Total Intracranial Volume, 1534567.890123, mm^3
  1   4     14046    14046.0  Left-Lateral-Ventricle     30.1      9.2      4.0     68.0     64.0
"""


@pytest.fixture
def bert(tmp_path):
    return shutil.copytree(sample_path("fsaverage5"), tmp_path / "bert")


def with_stats(subject, content):
    (subject / "stats").mkdir(exist_ok=True)
    (subject / "stats" / "aseg.stats").write_bytes(content if isinstance(content, bytes) else content.encode())
    return subject


def test_intracranial_volume_and_holes_of_each_side_are_read(bert):
    with_stats(bert, STATS)
    for hemi, holes in (("lh", 23), ("rh", 41)):
        cortex = read_cortex(bert, hemi)
        assert cortex.info == {"etiv_mm3": 1534567.890123, "surface_holes": holes}
        assert str(bert / "stats" / "aseg.stats") in cortex.files  # so that its digest is recorded


def test_the_volumes_of_a_hemisphere_and_of_the_brain_are_read_under_names_of_their_own(bert):
    names = (
        "lhCortex",
        "rhCortex",
        "Cortex",
        "lhCerebralWhiteMatter",
        "TotalGray",
        "SubCortGray",
        "BrainSegNotVentSurf",
    )
    names += ("SupraTentorial", "SupraTentorialNotVent", "BrainSeg", "BrainSegNotVent")
    lines = [f"# Measure {name}, {name}Vol, Some words, {k}000.5, mm^3" for k, name in enumerate(names)]
    assert read_cortex(with_stats(bert, "\n".join(lines)), "lh").info == {
        "freesurfer_cortex_mm3": 0.5,
        "freesurfer_white_matter_mm3": 3000.5,
        "freesurfer_total_gray_mm3": 4000.5,
        "freesurfer_subcortical_gray_mm3": 5000.5,
        "freesurfer_supratentorial_mm3": 7000.5,
        "freesurfer_brain_mm3": 9000.5,
        "freesurfer_brain_without_ventricles_mm3": 10000.5,
    }


@pytest.mark.parametrize(
    ("content", "known"),
    [
        (b"", set()),
        (STATS.replace("1534567.890123", "nan").encode(), {"surface_holes"}),
        (STATS.replace("1534567.890123", "-3").encode(), {"surface_holes"}),
        (STATS.replace("1534567.890123", "1e999").encode(), {"surface_holes"}),
        (STATS.replace("1534567.890123", "1e300").replace(" 23,", " 1e300,").encode(), set()),
        (STATS.replace(" 23,", " many,").encode(), {"etiv_mm3"}),
        (STATS[: STATS.index("23,") + 1].encode(), set()),  # cut within a number
        (b"\xff\xfe" + STATS.encode().replace(b"Title", b"\x00\xff"), {"etiv_mm3", "surface_holes"}),
        (b"# Measure lhSurfaceHoles\n# Measure\n# Measure ,,,,\n,\n", set()),
        (b"# Measure lhSurfaceHoles, , , " + b"9" * 5000 + b", unitless", set()),
        (b"x" * 10_000_000, set()),
    ],
)
def test_what_damaged_statistics_do_not_say_is_left_out(bert, content, known):
    assert set(read_cortex(with_stats(bert, content), "lh").info) == known


def test_the_parcellation_that_is_named_is_read(bert):
    label = bert / "label"
    for hemi in ("lh", "rh"):
        shutil.copy(label / f"{hemi}.aparc.annot", label / f"{hemi}.aparc.a2009s.annot")
    usual, named, short = (read_cortex(bert, annotation=name) for name in (None, "aparc.a2009s", "a2009s"))
    assert (usual.regions.name, named.regions.name, short.regions.name) == ("aparc", "aparc.a2009s", "aparc.a2009s")
    assert str(label / "lh.aparc.a2009s.annot") in named.files


@pytest.mark.parametrize("name", ["economo", "", "../surf/lh.white"])
def test_a_parcellation_that_is_named_and_not_there_is_refused(bert, name):
    with pytest.raises(FileNotFoundError, match=r"lh\.aparc\.annot"):
        read_cortex(bert, annotation=name)


def test_a_pair_of_files_has_no_parcellation_to_name(bert):
    with pytest.raises(OptionsClash, match=re.escape(str(bert / "surf" / "lh.white"))):
        read_cortex(white=bert / "surf" / "lh.white", pial=bert / "surf" / "lh.pial", annotation="aparc")


@pytest.mark.parametrize("name", ["thickness", "curv", "sulc", "area"])
@pytest.mark.parametrize("ending", ["", ".shape.gii"])
def test_an_infinite_value_of_a_map_is_refused_by_the_name_of_its_file_and_nan_is_unknown(tmp_path, name, ending):
    verts, faces = icosphere(1)
    for surface, radius in (("white", 47.0), ("pial", 50.0)):
        write_surface(tmp_path / f"lh.{surface}", Surface(radius * verts, faces))
    file, values = tmp_path / f"lh.{name}{ending}", np.full(42, 2.0, dtype=np.float32)

    def write():
        if ending:
            array = nib.gifti.GiftiDataArray(values, intent="NIFTI_INTENT_SHAPE", datatype="NIFTI_TYPE_FLOAT32")
            nib.save(nib.GiftiImage(darrays=[array]), file)
        else:
            nib.freesurfer.write_morph_data(file, values)

    values[7] = np.inf
    write()
    with pytest.raises(NotFinite, match=rf"lh\.{name}{re.escape(ending)}: 1 of 42\b.*\b7\b"):
        read_cortex(tmp_path)
    values[7] = np.nan
    write()
    cortex = read_cortex(tmp_path)
    assert np.flatnonzero(np.isnan(cortex.maps[name])).tolist() == [7]
    with pytest.raises(NotFinite, match=rf"\b{name}: 1 of 42\b.*\b3\b"):
        replace(cortex, maps={name: np.where(np.arange(42) == 3, -np.inf, 2.0)})
