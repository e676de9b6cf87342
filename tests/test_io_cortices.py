"""A cortex from a subject, a simulation, an analysis or two files: what is read, and what does not go together."""

import hashlib
import json
import re
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
from made_subjects import AXES, write_subject
from made_surfaces import area

from morphofold import errors, io as mio
from morphofold.analysis.measures_result import Measures
from morphofold.io.cortices import in_freesurfer_signs, read_folded
from morphofold.io.files import side_named
from morphofold.io.gifti import write_surface as write_gifti_surface
from morphofold.io.json_files import Record, read_json
from morphofold.results import write_analysis
from morphofold.shapes import icosphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Regions, Surface

FSAVERAGE5 = mio.sample_path("fsaverage5")


def pair_of_spheres(folder):
    verts, faces = icosphere(1, radius=50.0)
    (folder / "surf").mkdir(parents=True)
    mio.write_surface(folder / "surf" / "lh.white", Surface(verts, faces))
    mio.write_surface(folder / "surf" / "lh.pial", Surface(verts * 1.04, faces))
    mio.write_morph(folder / "surf" / "lh.thickness", np.full(len(verts), 2.0))
    return folder


# --- pairs of files


def test_two_files_make_a_cortex_with_the_hemisphere_that_they_name(tmp_path):
    folder = FSAVERAGE5 / "surf"
    for pial, message in (
        (folder / "rh.pial", r"lh\.white\b.*\blh, .*rh\.pial\b.*\brh\b"),
        (mio.sample_path("S1/lh.pial.surf.gii"), r"\b10242\b.*\b152893\b"),
    ):
        with pytest.raises(errors.UnlikeSurfaces, match=message):
            mio.read_cortex(white=folder / "lh.white", pial=pial)
    white, pial = (tmp_path / f"sub-01_hemi-R_{kind}.surf.gii" for kind in ("white", "pial"))
    for path, kind in ((white, "white"), (pial, "pial")):
        mio.write_surface(path, mio.read_surface(folder / f"rh.{kind}"))
    cortex = mio.read_cortex(white=white, pial=pial)
    assert (cortex.hemi, cortex.origin, cortex.maps) == ("rh", "files", {})
    with pytest.raises(errors.WrongFile, match=rf"{re.escape(white.name)}: .*\brh, .*\blh\b"):
        mio.read_cortex(white=white, pial=pial, hemi="lh")


@pytest.mark.parametrize("arguments", [{}, {"white": "lh.white"}, {"path": "x", "white": "w", "pial": "p"}])
def test_neither_or_both_ways_to_name_a_cortex_are_refused(arguments):
    with pytest.raises(TypeError, match="white="):
        mio.read_cortex(**arguments)


SIDES = {
    "lh": "lh.white LH.ply s_white_surface_left_81920.obj sub-01_hemi-L_white.surf.gii hemi-l.gii lh_white.off "
    "100307.L.white.32k_fs_LR.surf.gii sub_Lwhite.gii CortexLeft.vtk tpl-fsLR_hemi-L.gii sub-R_hemi-L_white.gii",
    "rh": "rh.pial sub-01_hemi-right_wm.surf.gii R.white 1_R_white.gii sub_Rhemi.gii alright_hemi-R.gii rightWhite.ply",
    None: "white.gii bright.ply Rhesus.white upright.vtk Lhasa.ply leftover.stl lhwhite.gii fs_LR.gii left_right.ply "
    "lh.rh.white hemi-L_hemi-R.gii 1.L.R.gii sub-L_white.gii T1R.gii sub-right01.ply",
}


@pytest.mark.parametrize("side", SIDES)
def test_a_side_is_read_in_any_usual_spelling_and_never_guessed(side):
    assert {name: side_named(name) for name in SIDES[side].split()} == dict.fromkeys(SIDES[side].split(), side)


# --- simulations and analyses


@pytest.fixture
def simulation(tmp_path):
    """A simulation of four stages on a sphere."""
    for g in (1.2, 1.8, 9.5, 10.0):
        stage = pair_of_spheres(tmp_path / "stages" / f"g{g:.2f}")
        facts = {"name": "fig5", "g": g, "portion": 0.125, "units": "mm", "law": "isotropic", "mu_ratio": 2.0}
        (stage / "stage.json").write_text(json.dumps(facts))
    return tmp_path


def test_a_simulation_reads_as_its_last_stage_or_one_that_is_named(simulation):
    cortex = mio.read_cortex(simulation)
    last = ("simulation", "fig5 g10.00", "lh", "mm", 0.125)
    assert (cortex.origin, cortex.name, cortex.hemi, cortex.units, cortex.portion) == last
    assert (cortex.info["g"], cortex.info["law"], cortex.info["mu_ratio"]) == (10.0, "isotropic", 2.0)
    assert cortex.maps["thickness"].tolist() == [2.0] * 42
    assert mio.read_cortex(simulation / "stages" / "g1.20").info["g"] == 1.2
    with pytest.raises(errors.DoesNotApply, match=r"simulated: .*\blh\b"):
        mio.read_cortex(mio.sample_path("simulated"), hemi="rh")


@pytest.mark.parametrize(
    ("name", "count", "write"),
    [
        ("surf/lh.thickness", "41", lambda path: mio.write_morph(path, np.ones(41))),
        ("surf/lh.inflated", "162", lambda path: mio.write_surface(path, Surface(*icosphere(2)))),
        ("label/lh.aparc.annot", "10,242", lambda path: shutil.copy(FSAVERAGE5 / "label" / path.name, path)),
    ],
)
def test_a_file_of_another_subject_is_refused_by_name_when_a_cortex_is_read(tmp_path, name, count, write):
    folder = pair_of_spheres(tmp_path / "anna")
    (folder / "label").mkdir()
    write(folder / name)
    with pytest.raises(errors.Mismatch, match=rf"{re.escape(name)}\b\D*\b{count}\b.*\b42\b"):
        mio.read_cortex(folder)


def test_an_analysis_folder_reads_back_with_what_its_surfaces_and_parcellation_were(tmp_path):
    """Origin, portion and info decide how a cortex is measured, so measuring an analysis again changes nothing."""
    cortex, facts = mio.read_cortex(FSAVERAGE5), {"origin": "simulation", "portion": 0.5, "info": {"g": 1.9}}
    cortex = replace(cortex, regions=replace(cortex.regions, name="aparc.a2009s"), **facts)
    write_analysis([Measures(cortex, {}, {})], tmp_path / "out", report=False)
    again = mio.read_cortex(tmp_path / "out")
    assert {key: getattr(again, key) for key in facts} == facts
    assert again.regions.name == "aparc.a2009s"
    (tmp_path / "out/label/lh.aparc.a2009s.annot").unlink()
    with pytest.raises(FileNotFoundError, match=r"label/lh\.aparc\.a2009s\.annot"):
        mio.read_cortex(tmp_path / "out")


# --- folders of subjects


def test_a_missing_file_or_folder_is_named_with_what_lies_beside_it(tmp_path):
    for name in ("rh.pial", "lh.sulc", "lh.white"):
        shutil.copy(FSAVERAGE5 / "surf" / name, tmp_path)
    missing = (
        ((mio.sample_path("S1"), "rh"), r"rh\.white: .*\brh\.white\.surf\.gii\b"),
        ((tmp_path / "nowhere" / "subject",), rf"subject: .*\bnowhere\b.*{re.escape(str(tmp_path))}\."),
        ((tmp_path,), r"lh\.pial: .*lh\.sulc, lh\.white, rh\.pial"),  # rh is no misspelling
    )
    for arguments, message in missing:
        with pytest.raises(FileNotFoundError, match=message):
            mio.read_cortex(*arguments)
    with pytest.raises(FileNotFoundError, match=r"\bbert\b.*\bS1, .*\bfsaverage5\b"):
        mio.sample_path("bert")


def test_the_records_of_a_cortex_are_of_the_bytes_that_were_read(tmp_path):
    folder = pair_of_spheres(tmp_path / "anna")
    pial = folder / "surf" / "lh.pial"
    digest = hashlib.sha256(pial.read_bytes()).hexdigest()
    for cortex in (mio.read_cortex(folder), mio.read_cortex(white=folder / "surf" / "lh.white", pial=pial)):
        assert [row["path"] for row in cortex.inputs] == list(cortex.files)
        assert {row["path"]: row["sha256"] for row in cortex.inputs}[str(pial)] == digest


@pytest.mark.parametrize("text", ["\x1b[31m", "\n", "\u202e"])
def test_names_from_files_are_one_line_without_controls(tmp_path, text):
    path, colours = tmp_path / f"lh.a{text}.annot", np.array([[1, 2, 3], [4, 5, 6]], dtype=np.uint8)
    mio.write_annotation(path, Regions(np.array([0, 1, 0]), (f"a{text}b", "c"), colours))
    regions, cortex = mio.read_annotation(path), mio.read_cortex(FSAVERAGE5, name=f"x{text}y")
    assert all(name.isprintable() for name in (*regions.names, regions.name, cortex.name))


@pytest.mark.parametrize("name", ["thickness", "sulc"])
def test_an_infinite_value_of_a_map_is_refused_by_the_name_of_its_file_and_nan_is_unknown(tmp_path, name):
    folder = pair_of_spheres(tmp_path)
    file, values = folder / f"surf/lh.{name}", np.full(42, 2.0)
    values[7] = 1e30
    mio.write_morph(file, values)  # no writer writes infinity
    file.write_bytes(file.read_bytes().replace(np.array(1e30, ">f4").tobytes(), np.array(np.inf, ">f4").tobytes()))
    with pytest.raises(errors.NotFinite, match=rf"lh\.{name}: 1 of 42\b.*\b7\b"):
        mio.read_cortex(folder)
    values[7] = np.nan
    mio.write_morph(file, values, nan=np.nan)
    cortex = mio.read_cortex(folder)
    assert np.flatnonzero(np.isnan(cortex.maps[name])).tolist() == [7]


# --- what FreeSurfer says of a subject, and which parcellation is read

STATS = """\
# Title Segmentation Statistics
# Measure lhSurfaceHoles, lhSurfaceHoles, Number of defect holes in lh surfaces prior to fixing, 23, unitless
# Measure rhSurfaceHoles, rhSurfaceHoles, Number of defect holes in rh surfaces prior to fixing, 41, unitless
# Measure EstimatedTotalIntraCranialVol, eTIV, Estimated Total Intracranial Volume, 1534567.890123, mm^3
  1   4     14046    14046.0  Left-Lateral-Ventricle     30.1      9.2      4.0     68.0     64.0
"""


def info_of(subject, content, hemi="lh"):
    """What is known of a subject with this aseg.stats."""
    (subject / "stats").mkdir(exist_ok=True)
    (subject / "stats" / "aseg.stats").write_bytes(content if isinstance(content, bytes) else content.encode())
    cortex = mio.read_cortex(subject, hemi)
    assert str(subject / "stats" / "aseg.stats") in cortex.files  # so that its digest is recorded
    return cortex.info


def test_volumes_and_holes_of_each_side_are_read(tmp_path):
    bert = pair_of_spheres(tmp_path / "bert")
    for kind in ("white", "pial"):
        shutil.copy(bert / f"surf/lh.{kind}", bert / f"surf/rh.{kind}")
    for hemi, holes in (("lh", 23), ("rh", 41)):
        assert info_of(bert, STATS, hemi) == {"etiv_mm3": 1534567.890123, "surface_holes": holes}
    keys = {
        "Cortex": "cortex",
        "CerebralWhiteMatter": "white_matter",
        "TotalGray": "total_gray",
        "SubCortGray": "subcortical_gray",
        "SupraTentorial": "supratentorial",
        "BrainSeg": "brain",
        "BrainSegNotVent": "brain_without_ventricles",
    }
    others = ("BrainSegNotVentSurf", "SupraTentorialNotVent", "rhCortex")  # are not read
    names = [*others, "lhCortex", "lhCerebralWhiteMatter", *list(keys)[2:]]
    lines = [f"# Measure {name}, {name}Vol, Some text, {k}000.5, mm^3" for k, name in enumerate(names)]
    expected = {f"freesurfer_{key}_mm3": 1000 * k + 0.5 for k, key in enumerate(keys.values(), start=3)}
    assert info_of(bert, "\n".join(lines)) == expected


@pytest.mark.parametrize(
    ("content", "keys"),
    [
        (STATS.replace("1534567.890123", "nan"), {"surface_holes"}),
        (STATS.replace("1534567.890123", "1e300").replace(" 23,", " many,"), set()),
        (STATS[: STATS.index("23,") + 1], set()),  # cut within a number
        (b"\xff\xfe" + STATS.encode().replace(b"Title", b"\x00\xff"), {"etiv_mm3", "surface_holes"}),
    ],
)
def test_what_damaged_statistics_do_not_say_is_left_out(tmp_path, content, keys):
    assert set(info_of(pair_of_spheres(tmp_path / "bert"), content)) == keys


def test_the_parcellation_that_is_named_is_read_and_one_that_is_not_there_is_refused(tmp_path):
    bert = shutil.copytree(FSAVERAGE5, tmp_path / "bert")
    shutil.copy(bert / "label/lh.aparc.annot", bert / "label/lh.aparc.a2009s.annot")
    usual, named, short = (mio.read_cortex(bert, annotation=name) for name in (None, "aparc.a2009s", "a2009s"))
    assert [cortex.regions.name for cortex in (usual, named, short)] == ["aparc", "aparc.a2009s", "aparc.a2009s"]
    assert str(bert / "label/lh.aparc.a2009s.annot") in named.files
    for name in ("economo", "", "../surf/lh.white"):
        with pytest.raises(FileNotFoundError, match=r"lh\.aparc\.annot"):
            mio.read_cortex(bert, annotation=name)


def test_a_pair_takes_the_other_files_of_its_hemisphere():
    surf, label = FSAVERAGE5 / "surf", FSAVERAGE5 / "label"
    files = {"thickness": surf / "lh.thickness", "mask": label / "lh.cortex.label"}
    pair = {"white": surf / "lh.white", "pial": surf / "lh.pial"}
    cortex, same = mio.read_cortex(**pair, **files, annotation=label / "lh.aparc.annot"), mio.read_cortex(FSAVERAGE5)
    assert np.array_equal(cortex.maps["thickness"], same.maps["thickness"])
    assert np.array_equal(cortex.cortex, same.cortex)
    assert np.array_equal(cortex.regions.labels, same.regions.labels)
    with pytest.raises(errors.UnlikeSurfaces, match=r"\blh\b.*\brh\b"):
        mio.read_cortex(**pair, thickness=surf / "rh.thickness")
    with pytest.raises(errors.Mismatch, match=r"\b10,242\b"):
        mio.read_cortex(**pair, sphere=mio.sample_path("S1/lh.pial.surf.gii"))
    with pytest.raises(errors.OptionsClash, match="white and pial"):
        mio.read_cortex(FSAVERAGE5, **files)


# --- lost links and files that were not fetched


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A subject with small surfaces, a map, a label and an annotation on both sides."""
    folder, (verts, faces) = tmp_path_factory.mktemp("made"), icosphere(4)
    for hemi in ("lh", "rh"):
        write_subject(folder, hemi, axes=AXES, thickness=lambda s: 2 + s[:, 0])
        mio.write_surface(folder / "surf" / f"{hemi}.pial", Surface(verts * (AXES + 2), faces))
    return folder


@pytest.fixture
def subject(made, tmp_path):
    return shutil.copytree(made, tmp_path / "bert")


LEFT_OF_A_LINK = {
    "nothing": None,
    "text": b"lh.pial.T1",
    "Cygwin": b"!<symlink>\xff\xfe" + "lh.pial.T1\0".encode("utf-16-le"),
    "link of another machine": "/home/me/subjects/bert/surf/lh.pial.T1",
}


@pytest.mark.parametrize("left", LEFT_OF_A_LINK.values(), ids=[*LEFT_OF_A_LINK])
@pytest.mark.parametrize("kind", ["T1", "FLAIR"])
def test_a_pial_surface_whose_link_is_lost_is_read(subject, left, kind):
    pial = subject / "surf" / "lh.pial"
    verts = mio.read_surface(pial).verts
    file = pial.rename(pial.with_name(f"lh.pial.{kind}"))
    if isinstance(left, bytes):
        pial.write_bytes(left)
    elif left is not None:
        pial.symlink_to(left)
    with pytest.warns(UserWarning, match=rf"lh\.pial\.{kind}\b"):
        cortex = mio.read_cortex(subject)
    assert (cortex.pial.verts == verts).all()
    assert cortex.files[1] == str(file)
    with pytest.warns(UserWarning, match=kind):
        assert (read_folded(subject, "lh", surface="pial").white.verts == verts).all()


def test_the_refined_pial_surface_is_that_of_the_link_and_a_damaged_one_is_not_replaced(subject):
    pial = subject / "surf/lh.pial"
    shutil.copy(pial, pial.with_name("lh.pial.T2"))
    pial.rename(pial.with_name("lh.pial.T1"))
    with pytest.warns(UserWarning, match=r"lh\.pial\.T2"):  # -T2pial links it
        mio.read_surface(pial)
    pial.write_bytes(pial.with_name("lh.pial.T1").read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"lh\.pial: "):
        mio.read_surface(pial)
    pial.unlink()
    pial.symlink_to("lh.pial.T1")  # not lost: no warning
    assert read_quietly(subject).files[1] == str(pial)


KEY = "annex/objects/SHA256E-s369000--0123456789abcdef.white"
POINTERS = {
    "link of DataLad": f"../../.git/{KEY}",
    "file of git-annex": f"/{KEY}\n".encode(),
    "git-lfs": b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 369000\n",
}


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("surf/lh.white", mio.read_surface),
        ("surf/lh.pial", lambda file: mio.read_cortex(file.parents[1])),
        ("label/lh.aparc.annot", mio.read_annotation),
        ("label/lh.cortex.label", lambda file: read_folded(file.parents[1], "lh")),
        ("scene.toml", load_scene),
        ("stage.json", lambda file: read_json(file, Record, "")),
    ],
)
def test_a_file_that_was_not_fetched_is_called_so(subject, name, read):
    for kind, pointer in POINTERS.items():
        file = subject / name
        file.unlink(missing_ok=True)
        file.write_bytes(pointer) if isinstance(pointer, bytes) else file.symlink_to(pointer)
        with pytest.raises(errors.NotFetched, match="lfs pull" if kind == "git-lfs" else "datalad get"):
            read(file)


# --- conventions: signs of maps, regions and masks of HCP

MAPS = ("thickness", "curv", "sulc")


def read_quietly(folder, hemi="lh"):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return mio.read_cortex(folder, hemi)


def test_maps_of_freesurfer_and_of_a_simulation_have_the_signs_of_their_files():
    for folder, hemi in ((FSAVERAGE5, "lh"), (FSAVERAGE5, "rh"), (mio.sample_path("simulated"), "lh")):
        cortex = read_quietly(folder, hemi)
        for name in cortex.maps.keys() & {*MAPS}:
            assert np.array_equal(cortex.maps[name], mio.read_morph(folder / "surf" / f"{hemi}.{name}")), name


@pytest.mark.parametrize(("hemi", "inward"), [("lh", False), ("rh", True)])
def test_maps_of_hcp_are_reversed_with_a_warning_whatever_the_order_of_corners(tmp_path, hemi, inward):
    average = mio.read_cortex(FSAVERAGE5, hemi)
    for kind in ("white", "pial"):
        surface = average.surface(kind)
        faces = surface.faces[:, ::-1] if inward else surface.faces
        write_gifti_surface(tmp_path / f"{hemi}.{kind}.surf.gii", Surface(surface.verts, faces))
    for name in MAPS:
        mio.write_gifti_map(tmp_path / f"{hemi}.{name}.shape.gii", -average.maps[name])
    with pytest.warns(UserWarning, match="sign") as messages:
        cortex = mio.read_cortex(tmp_path, hemi)
    assert len(messages) == 3
    for name in MAPS:
        np.testing.assert_allclose(cortex.maps[name], average.maps[name], atol=1e-6)


def test_only_a_clear_correlation_reverses_a_map(rng):
    """The right sign correlates by 0.6 and more; noise that hides it does not make it the opposite."""
    average, files = mio.read_cortex(FSAVERAGE5), dict.fromkeys(MAPS, "file")
    noise = rng.standard_normal(len(average.white.verts))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for values in (noise, np.zeros_like(noise), np.full_like(noise, np.nan), average.maps["sulc"] + 10 * noise):
            signed = in_freesurfer_signs({"sulc": values, "curv": values}, average.white, files)
            assert np.array_equal(signed["sulc"], values, equal_nan=True)
    some = np.where(noise > 1, np.nan, -average.maps["sulc"])  # unknown at a sixth of the vertices
    with pytest.warns(UserWarning, match="file"):
        signed = in_freesurfer_signs({"sulc": some}, average.white, files)
    assert np.array_equal(signed["sulc"], -some, equal_nan=True)


@pytest.mark.parametrize("parent", ["label", "surf"])
def test_regions_and_a_mask_in_gifti_are_read(tmp_path, parent):
    folder = pair_of_spheres(tmp_path / "a")
    (folder / "label").mkdir()
    verts = mio.read_surface(folder / "surf/lh.white").verts
    wall = verts[:, 0] > 40
    regions = Regions(np.where(wall, -1, verts[:, 2] > 0), ("below", "above"), np.eye(2, 3, dtype=np.uint8))
    mio.write_annotation(folder / parent / "lh.aparc.label.gii", regions)
    mio.write_gifti_map(folder / parent / "lh.atlasroi.shape.gii", (~wall).astype(float))
    cortex = mio.read_cortex(folder)
    assert np.array_equal(cortex.regions.labels, regions.labels)
    assert (cortex.regions.names, cortex.regions.name) == (("below", "above"), "aparc")
    assert np.array_equal(cortex.cortex, ~wall)


def test_freesurfers_label_goes_before_the_mask_of_hcp(subject):
    mio.write_gifti_map(subject / "label/lh.atlasroi.shape.gii", np.zeros(2562))
    assert mio.read_cortex(subject).cortex.any()


# --- samples


@pytest.mark.parametrize(
    ("hemi", "white", "pial", "thickness", "cortex", "precentral"),
    [("lh", 66661.8, 76345.4, 2.3351, 9354, 2.445), ("rh", 66619.2, 76671.8, 2.3502, 9361, 2.432)],
)
def test_fsaverage5_has_the_known_counts_areas_and_thickness(hemi, white, pial, thickness, cortex, precentral):
    average = mio.read_cortex(FSAVERAGE5 / "surf", hemi)  # which stands for its subject
    assert (average.name, average.origin, average.hemi) == ("fsaverage5", "FreeSurfer", hemi)
    assert (average.n_vertices, len(average.faces), average.cortex.sum()) == (10242, 20480, cortex)
    assert (len(average.regions.names), len(average.files)) == (36, 10)
    assert [area(average.white), area(average.pial)] == pytest.approx([white, pial], abs=0.05)
    assert set(average.maps) == {"thickness", "curv", "sulc", "area"}
    t = average.maps["thickness"]
    assert t[t > 0].mean() == pytest.approx(thickness, abs=5e-5)
    assert average.inflated is not None
    in_precentral = average.regions.labels == average.regions.names.index("precentral")
    assert t[in_precentral].mean() == pytest.approx(precentral, abs=5e-4)


def test_the_individual_hemisphere_has_the_known_counts_and_areas():
    cortex = mio.read_cortex(mio.sample_path("S1"))
    assert (cortex.n_vertices, len(cortex.faces), cortex.hemi, cortex.name) == (152893, 305782, "lh", "S1")
    assert (cortex.origin, cortex.maps, cortex.regions, cortex.cortex) == ("files", {}, None, None)
    assert area(cortex.white) == pytest.approx(91471.5, abs=0.05)


def test_every_sample_travels_with_its_origin_and_licence():
    table = mio.sample_path("README.md").read_text()
    for folder in (p for p in mio.sample_path().iterdir() if p.is_dir() and not p.name.startswith(("_", "."))):
        from_elsewhere = f"`{folder.name}/`" in table
        assert from_elsewhere == bool(list(folder.glob("LICENSE*"))), folder.name
        assert (folder / "README.md").is_file() or not from_elsewhere, folder.name
    assert "`fsaverage5/`" in table
