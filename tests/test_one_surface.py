"""One surface alone: all that needs no second one is measured of it, the rest is None with its reason."""

import numpy as np
import pytest
from commands import refused

from morphofold import errors, io as mio
from morphofold.analysis import measure, measuring
from morphofold.cli import main
from morphofold.results import read_analysis
from morphofold.surface import Cortex, Surface

SCALE = 8.0  # mm of curvature, for surfaces of unlike meshes


@pytest.fixture(scope="module")
def average():
    return mio.read_cortex(mio.sample_path("fsaverage5"), "lh")


@pytest.fixture(scope="module")
def pair(average):
    return measure(average, curvature_scale=SCALE)


def test_pial_alone_has_the_numbers_of_pial_in_the_pair(average, pair):
    alone = measure(Cortex.of_surface(average.pial, cortex=average.cortex), curvature_scale=SCALE)
    for name in (*measuring.CURVATURE_MAPS, "sulcal_depth", "local_gyrification_index"):
        assert np.array_equal(alone.maps[name], pair.maps[name], equal_nan=True), name
    for name in ("gyrification_index", "area_pial_mm2", "volume_pial_mm3", "mean_sulcal_depth_mm"):
        assert alone.scalars[name] == pair.scalars[name], name
    assert 1.0 < alone.scalars["median_gyral_thickness_mm"] / pair.scalars["median_gyral_thickness_mm"] < 1.1
    assert {name for name in pair.maps if name not in alone.maps} == {"cortical_thickness", "thickness_file"}
    for name in measuring.SCALARS_OF_TWO_SURFACES:
        assert (alone.scalars[name], alone.notes[name]) == (None, alone.notes["one_surface"]), name
    assert alone.shapes == []


def test_white_alone_has_the_net_of_the_pair(average, pair):
    alone = measure(Cortex.of_surface(average.white, cortex=average.cortex), curvature_scale=SCALE)
    for name in ("n_hinges", "n_hinges_high", "crest_length_mm", "spectral_wavelength_mm", *measuring.FOLDING_INDICES):
        assert alone.scalars[name] == pair.scalars[name], name
    assert [row["vertex"] for row in alone.hinges] == [row["vertex"] for row in pair.hinges]


def test_a_surface_is_measured_as_it_is_given(average):
    only = ["gyrification_index", "curvedness"]
    assert measure(average.pial, only=only).scalars["gyrification_index"] > 1.5
    with pytest.raises(errors.UnknownName):
        measure(average.pial, only=["cortical_thickness"])
    lone = Surface(average.pial.verts, average.faces[:, ::-1])  # inside out, which is repaired as of a pair
    assert measure(lone, only=only).parameters["repaired_flipped_triangles"] == len(average.faces)


def test_the_command_writes_a_surface_with_mask_and_regions_that_can_be_measured_again(cwd, capsys):
    sample = mio.sample_path("fsaverage5")
    files = ["--mask", str(sample / "label" / "lh.cortex.label"), "--annot", str(sample / "label" / "lh.aparc.annot")]
    words = ["analyze", "--surface", str(sample / "surf" / "lh.pial"), *files]
    assert main([*words, "-o", "alone", "--quiet"]) == 0
    (alone,) = read_analysis("alone")
    assert alone.cortex.is_one_surface
    assert len(alone.regions) == 34
    assert len(alone.hinges) > 20
    assert all(row["gray_volume_mm3"] is None and row["area_mm2"] > 0 for row in alone.regions)
    assert main(["analyze", "alone", "-o", "again", "--no-report", "--quiet"]) == 0
    (again,) = read_analysis("again")
    assert again.cortex.is_one_surface
    assert again.scalars["gyrification_index"] == pytest.approx(alone.scalars["gyrification_index"], rel=1e-6)
    capsys.readouterr()
    refused(capsys, [*words, "--white", "lh.white"], "--surface")
    refused(capsys, ["analyze", "--surface", str(cwd / "alone" / "summary.json"), "-o", "x"], "options-clash")
