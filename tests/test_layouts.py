"""Folders as FreeSurfer, fMRIPrep, HCP, dHCP, CAT12 and CIVET lay them out, each of which gives the same cortex."""

from dataclasses import replace

import made_layouts
import numpy as np
import pytest

from morphofold import errors, io as mio
from morphofold.group.subjects import find_subjects
from morphofold.io.cortices import hemispheres
from morphofold.io.layouts import subjects_in

#: program, function that writes its layout, names of two subjects, folder of the first from that of all
LAYOUTS = {
    "FreeSurfer": (made_layouts.write_freesurfer, ("anna", "ben"), "anna"),
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
