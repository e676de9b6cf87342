"""Maps, regions and masks that came with a cortex in other conventions are read in FreeSurfer's, and named cleanly."""

import shutil
import warnings

import numpy as np
import pytest

from morphofold.io import read_annotation, read_cortex, read_morph, sample_path, write_annotation, write_gifti_map
from morphofold.io.cortices import OPPOSITE, in_freesurfer_signs
from morphofold.io.gifti import write_surface as write_gifti_surface
from morphofold.shapes import icosphere
from morphofold.surface import Regions, Surface

MAPS = ("thickness", "curv", "sulc")


@pytest.fixture(scope="module")
def average():
    return {hemi: read_cortex(sample_path("fsaverage5"), hemi=hemi) for hemi in ("lh", "rh")}


def read_quietly(folder, hemi="lh"):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_cortex(folder, hemi)


@pytest.mark.parametrize("hemi", ["lh", "rh"])
def test_maps_of_freesurfer_stay(hemi):
    folder = sample_path("fsaverage5")
    cortex = read_quietly(folder, hemi)
    for name in MAPS:
        assert np.array_equal(cortex.maps[name], read_morph(folder / "surf" / f"{hemi}.{name}")), name


@pytest.mark.parametrize("hemi", ["lh", "rh"])
@pytest.mark.parametrize("inward", [False, True])
def test_maps_of_hcp_are_reversed_with_a_warning_whatever_the_order_of_corners(tmp_path, average, hemi, inward):
    cortex = average[hemi]
    for kind in ("white", "pial"):
        surface = cortex.surface(kind)
        faces = surface.faces[:, ::-1] if inward else surface.faces
        write_gifti_surface(tmp_path / f"{hemi}.{kind}.surf.gii", Surface(surface.verts, faces))
    for name in MAPS:
        write_gifti_map(tmp_path / f"{hemi}.{name}.shape.gii", -cortex.maps[name])
    with pytest.warns(UserWarning, match="sign") as given:
        found = read_cortex(tmp_path, hemi)
    assert len(given) == 3
    for name in MAPS:
        np.testing.assert_allclose(found.maps[name], cortex.maps[name], atol=1e-6)


def test_only_a_clear_correlation_reverses_a_map(average, rng):
    """The right sign correlates by 0.6 and more; noise that hides it does not make it the opposite."""
    cortex, files = average["lh"], dict.fromkeys(MAPS, "file")
    noise = rng.standard_normal(len(cortex.white.verts))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for values in (noise, np.zeros_like(noise), np.full_like(noise, np.nan), cortex.maps["sulc"] + 10 * noise):
            kept = in_freesurfer_signs({"sulc": values, "curv": values}, cortex.white, files)
            assert np.array_equal(kept["sulc"], values, equal_nan=True)
        in_freesurfer_signs({"thickness": np.where(noise > 1, -1.0, 2.0)}, cortex.white, files)
    assert OPPOSITE == pytest.approx(-0.3)
    some = np.where(noise > 1, np.nan, -cortex.maps["sulc"])  # unknown at a sixth of the vertices
    with pytest.warns(UserWarning, match="file"):
        found = in_freesurfer_signs({"sulc": some}, cortex.white, files)["sulc"]
    assert np.array_equal(found, -some, equal_nan=True)


def test_a_simulation_has_its_own_signs():
    folder = sample_path("simulated")
    assert np.array_equal(read_quietly(folder).maps["sulc"], read_morph(folder / "surf/lh.sulc"))


# --- regions and masks of HCP


@pytest.fixture
def pair(tmp_path):
    verts, faces = icosphere(3, radius=50.0)
    (tmp_path / "surf").mkdir()
    for kind, scale in (("white", 1.0), ("pial", 1.05)):
        write_gifti_surface(tmp_path / f"surf/lh.{kind}.surf.gii", Surface(scale * verts, faces))
    return tmp_path, verts


@pytest.mark.parametrize("place", ["label", "surf"])
def test_regions_and_a_mask_in_gifti_are_read(pair, place):
    folder, verts = pair
    (folder / "label").mkdir()
    wall = verts[:, 0] > 40
    regions = Regions(
        np.where(wall, -1, (verts[:, 2] > 0).astype(int)), ("below", "above"), np.eye(2, 3, dtype=np.uint8)
    )
    write_annotation(folder / place / "lh.aparc.label.gii", regions)
    write_gifti_map(folder / place / "lh.atlasroi.shape.gii", (~wall).astype(float))
    cortex = read_cortex(folder)
    assert np.array_equal(cortex.regions.labels, regions.labels)
    assert (cortex.regions.names, cortex.regions.name) == (("below", "above"), "aparc")
    assert np.array_equal(cortex.cortex, ~wall)


def test_a_mask_of_another_subject_is_refused(pair):
    folder, _ = pair
    write_gifti_map(folder / "surf/lh.atlasroi.shape.gii", np.ones(10))
    with pytest.raises(ValueError, match="atlasroi") as caught:
        read_cortex(folder)
    assert caught.value.code == "mismatch"


def test_freesurfers_label_goes_before_the_mask_of_hcp(tmp_path):
    folder = shutil.copytree(sample_path("fsaverage5"), tmp_path / "a")
    write_gifti_map(folder / "label/lh.atlasroi.shape.gii", np.zeros(10242))
    assert read_cortex(folder).cortex.any()


# --- names


@pytest.mark.parametrize("text", ["\x1b[31m", "\n", "\u2028", "\x9b", "\u202e"])
def test_names_from_files_are_one_line_without_controls(tmp_path, text):
    colours = np.array([[1, 2, 3], [4, 5, 6]], dtype=np.uint8)
    path = tmp_path / "lh.a.annot"
    write_annotation(path, Regions(np.array([0, 1, 0]), (f"a{text}b", "c"), colours))
    assert all(name.isprintable() for name in read_annotation(path).names)
    path = path.rename(tmp_path / f"lh.a{text}.annot")
    assert read_annotation(path).name.isprintable()
    assert read_cortex(sample_path("fsaverage5"), name=f"x{text}y").name.isprintable()
