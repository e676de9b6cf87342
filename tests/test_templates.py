"""Templates by their names: fs_LR and fsaverage of templateflow or HCP, and CIFTI to and from."""

import json
import shutil
import subprocess
from dataclasses import replace

import made_layouts
import numpy as np
import pytest
from made_cohort import work_here
from made_spaces import write_space
from nibabel import cifti2

from morphofold import errors, io as mio, read_parcellated
from morphofold.cli import main
from morphofold.io.cifti import write_dscalar
from morphofold.io.cortices import read_cortex, sample_path
from morphofold.spheres.template_folders import find_template

STRUCTURES = {"lh": "CIFTI_STRUCTURE_CORTEX_LEFT", "rh": "CIFTI_STRUCTURE_CORTEX_RIGHT"}


@pytest.fixture(scope="module")
def average():
    return {hemi: mio.read_cortex(mio.sample_path("fsaverage5"), hemi) for hemi in ("lh", "rh")}


def turned(sphere):
    """Turned by a right angle: in another space."""
    return replace(sphere, verts=sphere.verts[:, [1, 2, 0]])


@pytest.fixture(params=["templateflow", "HCP"])
def fs_lr(request, tmp_path, average, monkeypatch):
    """A template of the mesh of fsaverage5 named fs_LR, whose space is turned from that of fsaverage; its name."""
    monkeypatch.setenv("TEMPLATEFLOW_HOME", str(tmp_path / "flow"))
    for cortex in average.values():
        spheres = {"": cortex.sphere, "_space-fsaverage": turned(cortex.sphere)}
        if request.param == "templateflow":
            made_layouts.write_templateflow(tmp_path / "flow", "fsLR", cortex, spheres=spheres)
        else:
            made_layouts.write_standard_mesh_atlases(tmp_path / "standard_mesh_atlases", cortex, spheres=spheres)
    return "fsLR" if request.param == "templateflow" else str(tmp_path / "standard_mesh_atlases")


@pytest.fixture
def person(tmp_path, average):
    """A subject of fMRIPrep with spheres in both spaces and no parcellation."""
    for hemi, cortex in average.items():
        made_layouts.write_fmriprep(tmp_path / "prep", "sub-01", cortex)
        start = f"sub-01/anat/sub-01_hemi-{hemi[0].upper()}"
        mio.write_surface(tmp_path / f"prep/{start}_space-fsLR_desc-msmsulc_sphere.surf.gii", cortex.sphere)
        mio.write_surface(tmp_path / f"prep/{start}_desc-reg_sphere.surf.gii", turned(cortex.sphere))
    shutil.rmtree(tmp_path / "prep/sourcedata")
    return tmp_path / "prep/sub-01"


def test_a_map_comes_over_in_the_space_that_subject_and_template_share(fs_lr, person, average):
    template = find_template(fs_lr)
    assert (template.name, template.hemis) == ("fsLR-32k", ["lh", "rh"])
    for hemi, cortex in average.items():
        assert np.array_equal(template.cortex(hemi), cortex.cortex)
        own = read_parcellated(person, hemi, annotation="Test", annotation_from=fs_lr)
        assert np.array_equal(own.regions.labels, cortex.regions.labels)
        assert own.info["annotation_from"] == "fsLR-32k"
    next((person / "anat").glob("*hemi-L_space-fsLR_desc-msmsulc*")).unlink()
    by_fsaverage = read_parcellated(person, "lh", annotation="Test", annotation_from=fs_lr)
    assert np.array_equal(by_fsaverage.regions.labels, average["lh"].regions.labels)
    files = {"white": person / "anat/sub-01_hemi-L_white.surf.gii", "pial": person / "anat/sub-01_hemi-L_pial.surf.gii"}
    sphere = person / "anat/sub-01_hemi-L_desc-reg_sphere.surf.gii"
    of_files = read_parcellated(None, "lh", annotation="Test", annotation_from=fs_lr, sphere=sphere, **files)
    assert np.array_equal(of_files.regions.labels, average["lh"].regions.labels)
    with pytest.raises(errors.MissingPart):
        read_parcellated(None, "lh", annotation="Test", annotation_from=fs_lr, **files)
    sphere.unlink()
    with pytest.raises(FileNotFoundError, match="fsLR or fsaverage"):
        read_parcellated(person, "lh", annotation="Test", annotation_from=fs_lr)
    with pytest.raises(errors.MissingPart, match="Test"):
        read_parcellated(person, "rh", annotation_from=fs_lr)


def test_a_template_is_found_by_name_and_density(tmp_path, average, monkeypatch):
    monkeypatch.setenv("TEMPLATEFLOW_HOME", str(tmp_path))
    monkeypatch.setenv("SUBJECTS_DIR", str(tmp_path / "subjects"))
    for density in ("10k", "41k"):
        made_layouts.write_templateflow(tmp_path, "fsLR", average["lh"], density)
    assert find_template("fsLR-41k").name == "fsLR-41k"
    with pytest.raises(errors.NamedTwice, match="fsLR-10k, fsLR-41k"):
        find_template("fsLR")
    with pytest.raises(errors.NamedTwice):
        find_template("fsLR-8k")
    assert find_template("fsaverage5").folder == sample_path("fsaverage5")
    made_layouts.write_freesurfer(tmp_path / "subjects", "our-average", average["lh"])
    assert find_template("our-average").name == "our-average"
    with pytest.raises(FileNotFoundError, match="fsaverage5 is packaged"):
        find_template("our-other")


def test_group_arrays_and_results_on_fs_lr_are_cifti_too(fs_lr, person, average, cwd, monkeypatch):
    work_here(monkeypatch)
    assert main(["cohort", str(person.parent), "-o", "study", "--space", fs_lr, "--no-report", "-q"]) == 0
    group = cwd / "study/spaces/fsLR-32k/group"
    image = cifti2.load(group / "H.dscalar.nii")
    names, brain = (image.header.get_axis(k) for k in (0, 1))
    assert list(names.name) == ["sub-01"]
    for structure, part, _ in brain.iter_structures():
        (hemi,) = (hemi for hemi in STRUCTURES if STRUCTURES[hemi] == structure)
        expected = np.load(group / f"{hemi}.H.npy")[0][average[hemi].cortex]
        assert np.array_equal(image.get_fdata(dtype=np.float32)[0, part], expected)
    assert mio.read_morph(group / "H.dscalar.nii", "rh")[average["rh"].cortex] == pytest.approx(expected)
    if shutil.which("wb_command") is not None:
        done = subprocess.run(["wb_command", "-file-information", group / "H.dscalar.nii"], capture_output=True)
        assert b"CortexRight:          9361 out of 10242 vertices" in done.stdout, done.stderr


def test_statistics_on_fs_lr_are_cifti_too(cwd, rng):
    maps = {f"{hemi}.H": rng.standard_normal((8, 642)) + 1 for hemi in ("lh", "rh")}
    subjects = write_space(cwd / "study", maps, name="fsLR-32k")
    (cwd / "study/participants.tsv").write_text("\n".join(["participant_id", *subjects, ""]))
    words = ["stats", "study", "--model", "H ~ 1", "--permutations", "9", "--no-report", "-q", "-o", "out"]
    assert main([*words, "--contrast", "1"]) == 0
    by_short_name = [*words[:-1], "again", "--space", "fsLR", "--contrast", "1"]  # as cohort took it
    (cwd / "study/participants.tsv").unlink()  # a mean needs no column
    assert main(by_short_name) == 0
    effect = mio.read_morph(cwd / "out/maps/effect.dscalar.nii", "rh")
    expected = mio.read_morph(cwd / "out/maps/rh.effect.shape.gii")
    assert np.array_equal(effect[np.isfinite(effect)], expected[np.isfinite(effect)])
    assert np.isfinite(effect).sum() > 500


def test_a_template_of_one_hemisphere_is_enough_for_statistics(cwd, rng):
    subjects = write_space(cwd / "study", {"lh.H": rng.standard_normal((8, 642)) + 1}, hemis=("lh",))
    (cwd / "study/participants.tsv").write_text("\n".join(["participant_id", *subjects, ""]))
    words = ["stats", "study", "--model", "H ~ 1", "--permutations", "9", "--no-report", "-q", "-o", "out"]
    assert main([*words, "--contrast", "1"]) == 0
    assert sorted(file.name for file in (cwd / "out/maps").glob("?h.effect")) == ["lh.effect"]


def test_an_analysis_is_written_as_cifti(cwd, capsys):
    words = ["analyze", str(sample_path("fsaverage5")), "--only", "sulcal_depth,regions", "--cifti", "-o", "out"]
    assert main([*words, "--no-report", "-q"]) == 0
    for hemi in ("lh", "rh"):
        depth = mio.read_morph(cwd / f"out/maps/{hemi}.sulcal_depth.shape.gii")
        assert np.array_equal(mio.read_morph(cwd / "out/maps/sulcal_depth.dscalar.nii", hemi), depth, equal_nan=True)
    image = cifti2.load(cwd / "out/maps/regions.pscalar.nii")
    columns, parcels = (image.header.get_axis(k) for k in (0, 1))
    areas = dict(zip(parcels.name, image.get_fdata()[list(columns.name).index("area_mm2")]))
    assert len(areas) == 68
    summary = json.loads((cwd / "out/summary.json").read_text())
    assert summary["rows"]["regions"] == 68
    assert areas["R_insula"] == pytest.approx(float(row_of(cwd / "out/regions.tsv", "rh", "insula")["area_mm2"]), 1e-6)


def row_of(path, hemi, region):
    lines = [line.split("\t") for line in path.read_text().splitlines()]
    rows = [dict(zip(lines[0], line)) for line in lines[1:]]
    return next(row for row in rows if (row["hemi"], row["region"]) == (hemi, region))


def test_files_of_workbench_are_a_pair_with_thickness_mask_and_regions(cwd, average):
    cortex = average["rh"]
    for kind in ("white", "pial"):
        mio.write_surface(cwd / f"R.{kind}.surf.gii", getattr(cortex, kind))
    everywhere = {"rh": np.ones(cortex.n_vertices, bool)}
    for name, values in (("thickness", cortex.maps["thickness"]), ("roi", cortex.cortex.astype(float))):
        write_dscalar(cwd / f"R.{name}.dscalar.nii", {name: {"rh": values}}, everywhere)
    mio.write_annotation(cwd / "R.aparc.label.gii", cortex.regions)
    files = ["--white", "R.white.surf.gii", "--pial", "R.pial.surf.gii", "--thickness", "R.thickness.dscalar.nii"]
    words = [*files, "--mask", "R.roi.dscalar.nii", "--annot", "R.aparc.label.gii", "--hemi", "rh", "--no-report", "-q"]
    assert main(["analyze", *words, "--only", "regions,gyrification_index", "-o", "out"]) == 0
    of_files, of_folder = read_cortex("out", "rh"), cortex
    assert np.array_equal(of_files.cortex, of_folder.cortex)
    assert of_files.maps["thickness"] == pytest.approx(of_folder.maps["thickness"], rel=1e-6)
    assert row_of(cwd / "out/regions.tsv", "rh", "insula")["n_vertices"] == str(
        np.count_nonzero(cortex.regions.labels == cortex.regions.names.index("insula"))
    )


def test_labels_of_cifti_are_the_regions_of_a_hemisphere(tmp_path, average):
    labels = np.concatenate([average[hemi].regions.labels[average[hemi].cortex] + 1 for hemi in STRUCTURES])
    models = [cifti2.BrainModelAxis.from_mask(average[hemi].cortex, STRUCTURES[hemi]) for hemi in STRUCTURES]
    regions = average["lh"].regions
    table = {0: ("???", (1, 1, 1, 0))} | {
        key: (name, (*(rgb / 255), 1)) for key, (name, rgb) in enumerate(zip(regions.names, regions.colours), start=1)
    }
    image = cifti2.Cifti2Image(
        labels[None].astype(np.float32), header=(cifti2.LabelAxis(["aparc"], [table]), models[0] + models[1])
    )
    for hemi in STRUCTURES:
        made_layouts.write_hcp_32k(tmp_path, "100307", average[hemi])
    for file in tmp_path.glob("100307/MNINonLinear/fsaverage_LR32k/*aparc*"):
        file.unlink()
    image.to_filename(tmp_path / "100307/MNINonLinear/fsaverage_LR32k/100307.aparc.32k_fs_LR.dlabel.nii")
    for hemi, cortex in average.items():
        read = mio.read_cortex(tmp_path / "100307/T1w/fsaverage_LR32k", hemi)
        assert read.regions.names == regions.names
        assert np.array_equal(read.regions.labels, np.where(cortex.cortex, cortex.regions.labels, -1))
    left = cifti2.Cifti2Image(labels[None, : len(models[0])], header=(cifti2.LabelAxis(["a"], [table]), models[0]))
    left.to_filename(tmp_path / "left.dlabel.nii")
    with pytest.raises(errors.WrongFile, match="RIGHT"):
        mio.read_annotation(tmp_path / "left.dlabel.nii", "rh")
    assert np.count_nonzero(mio.read_label(tmp_path / "left.dlabel.nii", 10242, "lh")) == len(models[0])
