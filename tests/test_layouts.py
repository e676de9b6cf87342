"""Folders as FreeSurfer, fMRIPrep, HCP, dHCP, CAT12 and CIVET lay them out, each of which gives the same cortex."""

import re
from dataclasses import replace

import made_layouts
import numpy as np
import pytest
from made_cohort import table, work_here

from morphofold import errors, io as mio
from morphofold.analysis import measure
from morphofold.cli import main
from morphofold.group.subjects import find_subjects
from morphofold.io.cortices import hemispheres, registered_sphere
from morphofold.io.layouts import subjects_in
from morphofold.shapes import icosphere
from morphofold.surface import Surface
from morphofold.tables import read_table

#: program, function that writes its layout, names of two subjects, folder of the first from that of all
LAYOUTS = {
    "FreeSurfer": (made_layouts.write_freesurfer, ("anna", "ben"), "anna"),
    "FreeSurfer text": (made_layouts.write_text_surfaces, ("anna", "ben"), "anna"),
    "fMRIPrep": (made_layouts.write_fmriprep, ("sub-01", "sub-02"), "sub-01"),
    "fMRIPrep sessions": (made_layouts.write_fmriprep, ("sub-01_ses-1", "sub-01_ses-2"), "sub-01/ses-1/anat"),
    "HCP": (made_layouts.write_hcp, ("100307", "100408"), "100307"),
    "HCP 32k": (made_layouts.write_hcp_32k, ("100307", "100408"), "100307/T1w/fsaverage_LR32k"),
    "dHCP": (made_layouts.write_dhcp, ("sub-CC1_ses-7", "sub-CC2_ses-8"), "sub-CC1/ses-7"),
    "CAT12": (made_layouts.write_cat12, ("anna", "ben"), "anna"),
    "CIVET": (made_layouts.write_civet, ("anna", "ben"), "anna"),
}
NO_LABELS = ("CAT12", "CIVET")


@pytest.fixture(scope="module")
def average():
    return {hemi: mio.read_cortex(mio.sample_path("fsaverage5"), hemi) for hemi in ("lh", "rh")}


@pytest.fixture(params=LAYOUTS)
def layout(request, tmp_path, average):
    """Its program, the folder with two subjects, of which the second has no right hemisphere, and their names."""
    write, names, first = LAYOUTS[request.param]
    for name, hemi in ((names[0], "lh"), (names[0], "rh"), (names[1], "lh")):
        write(tmp_path, name, average[hemi])
    return request.param.split()[0], tmp_path, names, first


def test_every_layout_gives_the_same_cortex(layout, average):
    program, folder, names, first = layout
    assert hemispheres(folder / first) == ("lh", "rh")
    for hemi in ("lh", "rh"):
        cortex, same = mio.read_cortex(folder / first, hemi), average[hemi]
        assert (cortex.name, cortex.hemi, cortex.origin) == (names[0], hemi, program)
        for kind in ("white", "pial"):
            assert np.array_equal(cortex.surface(kind).verts, same.surface(kind).verts)
        assert np.array_equal(cortex.faces, same.faces)
        for name in ("thickness",) if program == "CIVET" else ("thickness", "sulc", "curv"):
            assert np.array_equal(cortex.maps[name], same.maps[name]), name
        if program in NO_LABELS:
            assert (cortex.cortex, cortex.regions) == (None, None)
        else:
            assert np.array_equal(cortex.cortex, same.cortex)
            assert regions_of(cortex) == regions_of(same)


def regions_of(cortex):
    return [cortex.regions.names[label] if label >= 0 else "unknown" for label in cortex.regions.labels]


def test_all_subjects_of_a_folder_are_found_and_each_is_read_where_it_is(layout):
    program, folder, names, _ = layout
    places, left_out = find_subjects(folder)
    assert (tuple(places), left_out) == (names, {})
    assert [hemispheres(place) for place in places.values()] == [("lh", "rh"), ("lh",)]
    assert [mio.read_cortex(place).name for place in places.values()] == list(names)
    assert {subject.layout.program for subject in subjects_in(folder).values()} == {program}


@pytest.mark.parametrize(
    "layout",
    [name if name in ("fMRIPrep", "CIVET") else pytest.param(name, marks=pytest.mark.slow) for name in LAYOUTS],
    indirect=True,  # the arrays of all are compared in every run
)
def test_every_layout_is_measured_by_analyze_and_in_a_cohort_with_the_same_numbers(
    layout, average, tmp_path_factory, monkeypatch
):
    _, folder, names, first = layout
    out = tmp_path_factory.mktemp("out")
    argv = ["--only", "gyrification_index,mean_cortical_thickness_mm", "--accuracy", "draft", "--no-report", "--quiet"]
    assert main(["analyze", str(folder / first), "-o", str(out / "one"), *argv]) == 0
    rows = read_table(out / "one/surfaces.tsv", {"hemi"})
    keys = argv[1].split(",")
    unlabelled = layout[0] in NO_LABELS  # the medial wall is where the thickness is 0
    for row in rows:
        same = average[row["hemi"]]
        cortex = replace(same, cortex=None, regions=None, inflated=None) if unlabelled else same
        scalars = measure(cortex, accuracy="draft", only=keys).scalars
        assert [row[key] for key in keys] == [float(f"{scalars[key]:.7g}") for key in keys]

    work_here(monkeypatch)
    assert main(["cohort", str(folder), "-o", str(out / "all"), "--no-report", "--quiet"]) == 0
    rows = table(out / "all/group/hemispheres.tsv")
    assert [(row["subject"], row["hemi"]) for row in rows] == [(names[0], "lh"), (names[0], "rh"), (names[1], "lh")]


def test_a_folder_of_several_subjects_or_programs_is_refused_with_their_names(tmp_path, average):
    for name in ("sub-01_ses-1", "sub-01_ses-2"):
        made_layouts.write_fmriprep(tmp_path, name, average["lh"])
    with pytest.raises(errors.NamedTwice, match=r"\b2\b.*sub-01/ses-1, .*sub-01/ses-2"):
        mio.read_cortex(tmp_path / "sub-01")
    with pytest.raises(errors.NamedTwice, match=r"\b2\b.*sub-01/ses-1, .*cohort"):
        mio.read_cortex(tmp_path)
    assert mio.read_cortex(tmp_path / "sub-01_ses-2").name == "sub-01_ses-2"
    made_layouts.write_freesurfer(tmp_path / "sub-01", "ses-1", average["lh"])
    for read in (lambda: mio.read_cortex(tmp_path / "sub-01/ses-1"), lambda: find_subjects(tmp_path)):
        with pytest.raises(errors.NamedTwice, match=r"FreeSurfer\b.*\bfMRIPrep"):
            read()
    with pytest.raises(FileNotFoundError, match=r"hemi-R_white\.surf\.gii"):
        mio.read_cortex(tmp_path / "sub-01/ses-2", "rh")


def test_a_dataset_is_measured_from_the_folder_of_fmriprep_in_it(tmp_path, average, monkeypatch):
    made_layouts.write_fmriprep(tmp_path / "study/derivatives/fmriprep", "sub-01", average["lh"])
    work_here(monkeypatch)
    assert main(["bids", str(tmp_path / "study"), str(tmp_path / "out"), "participant", "--no-report", "--quiet"]) == 0
    assert (tmp_path / "out/sub-01/anat/sub-01_hemi-L_white.surf.gii").is_file()
    again = mio.read_cortex(tmp_path / "out/sub-01")
    assert (again.origin, again.name) == ("fMRIPrep", "sub-01")  # as it says itself: a copy of what was measured
    assert np.array_equal(again.maps["thickness"], average["lh"].maps["thickness"])
    assert np.array_equal(again.cortex, average["lh"].cortex)


def test_of_two_meshes_of_hcp_the_own_one_is_read_and_the_other_if_its_folder_is_named(tmp_path, average):
    own, other = average["lh"], average["rh"]
    made_layouts.write_hcp(tmp_path, "100307", own)
    made_layouts.write_hcp_32k(tmp_path, "100307", replace(other, hemi="lh"))
    for folder, same in (("100307", own), ("100307/T1w/Native", own), ("100307/T1w/fsaverage_LR32k", other)):
        cortex = mio.read_cortex(tmp_path / folder, "lh")
        assert np.array_equal(cortex.white.verts, same.white.verts), folder
        assert np.array_equal(cortex.maps["thickness"], same.maps["thickness"]), folder
    assert list(find_subjects(tmp_path)[0]) == ["100307"]


@pytest.mark.parametrize(
    ("write", "name", "sphere"),
    [
        (made_layouts.write_fmriprep, "sub-01", "sub-01/anat/sub-01_hemi-L_desc-reg_sphere.surf.gii"),
        (made_layouts.write_hcp, "1003", "1003/MNINonLinear/Native/1003.L.sphere.reg.native.surf.gii"),
        (made_layouts.write_cat12, "anna", "surf/lh.sphere.reg.anna.gii"),
    ],
)
def test_the_sphere_that_is_registered_to_fsaverage_is_found(tmp_path, average, write, name, sphere):
    write(tmp_path, name, average["lh"])
    with pytest.raises(FileNotFoundError, match=name):
        registered_sphere(tmp_path / name, "lh")
    mio.write_surface(tmp_path / sphere, average["lh"].sphere)
    assert registered_sphere(tmp_path / name, "lh") == (tmp_path / sphere, "fsaverage")


def test_the_parcellation_of_fastsurfer_is_read(tmp_path, average):
    made_layouts.write_freesurfer(tmp_path, "anna", average["lh"])
    aparc = tmp_path / "anna/label/lh.aparc.annot"
    aparc.rename(aparc.with_name("lh.aparc.DKTatlas.mapped.annot"))
    assert mio.read_cortex(tmp_path / "anna").regions.name == "aparc.DKTatlas.mapped"


def test_a_sphere_of_another_mesh_is_named_and_not_used(tmp_path, average):
    cortex = average["lh"]
    made_layouts.write_cat12(tmp_path, "anna", cortex)
    verts, faces = icosphere(2)
    mio.write_surface(tmp_path / "surf/lh.sphere.reg.anna.gii", Surface(verts, faces))
    cortex = mio.read_cortex(tmp_path / "anna", "lh")
    assert cortex.registered is None
    note = measure(cortex, only=["area_pial_mm2"]).notes["sphere_unlike"]
    assert re.search(r"lh\.sphere\.reg\.anna\.gii has 162 vertices, .* 10,242", note)
    files = {kind: tmp_path / f"surf/lh.{kind}.anna.gii" for kind in ("white", "pial")}
    with pytest.raises(errors.Mismatch, match="162 vertices"):
        mio.read_cortex(**files, sphere=tmp_path / "surf/lh.sphere.reg.anna.gii")


def test_white_of_one_mesh_and_pial_of_another_are_refused(tmp_path, average):
    made_layouts.write_hcp(tmp_path, "1003", average["lh"])
    verts, faces = icosphere(3, radius=60.0)
    mio.write_surface(tmp_path / "1003/T1w/Native/1003.L.pial.native.surf.gii", Surface(verts, faces))
    with pytest.raises(errors.UnlikeSurfaces, match=r"10242 vertices and pial .* 642"):
        mio.read_cortex(tmp_path / "1003")


def test_measures_of_civet_say_that_its_surfaces_are_scaled(tmp_path, average):
    made_layouts.write_civet(tmp_path, "anna", average["lh"])
    made_layouts.write_cat12(tmp_path / "cat", "anna", average["lh"])
    only = ["area_pial_mm2"]
    assert "CIVET" in measure(mio.read_cortex(tmp_path / "anna"), only=only).notes["template_space"]
    assert "template_space" not in measure(mio.read_cortex(tmp_path / "cat/anna"), only=only).notes


def test_regions_are_called_by_their_parcellation_whatever_the_program(tmp_path, average):
    made_layouts.write_hcp(tmp_path, "1003", average["lh"])
    made_layouts.write_dhcp(tmp_path, "sub-CC1_ses-7", average["lh"])
    assert mio.read_cortex(tmp_path / "1003").regions.name == "aparc"
    assert mio.read_cortex(tmp_path / "sub-CC1/ses-7").regions.name == "desc-drawem"


def test_a_session_has_the_regions_of_the_person_in_sourcedata(tmp_path, average):
    made_layouts.write_fmriprep(tmp_path, "sub-01_ses-1", average["lh"])
    (tmp_path / "sourcedata/freesurfer/sub-01_ses-1").rename(tmp_path / "sourcedata/freesurfer/sub-01")
    assert mio.read_cortex(tmp_path / "sub-01/ses-1").regions.name == "aparc"
