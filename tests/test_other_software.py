"""What we write opens in software that is not ours: nilearn and Connectome Workbench say of it what is so."""

import gzip
import re
import shutil
import subprocess

import numpy as np
import pytest
from made_simulations import harmonic, made_simulation

from morphofold.analysis import vertex_areas
from morphofold.analysis.measuring import measure
from morphofold.io import read_cortex, read_label, sample_path, write_gifti_map
from morphofold.results import write_analysis, write_dataset
from morphofold.simulation import freesurfer_maps

quiet = pytest.mark.filterwarnings("ignore:.*:UserWarning:nibabel")  # a stage has no volume it came from


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """The last stage of a simulation, a folder like a FreeSurfer subject."""
    out = tmp_path_factory.mktemp("sim") / "made"
    made_simulation(out, "demo", height=lambda g, verts: 3 * (g - 1) * harmonic(verts, 6, 3), describe=freesurfer_maps)
    return sorted((out / "stages").iterdir())[-1]


@pytest.fixture(scope="module")
def analysed(stage, tmp_path_factory):
    """Measures of that stage, and their folder in the plain layout and as a BIDS subject."""
    m, out = measure(read_cortex(stage)), tmp_path_factory.mktemp("analysed")
    plain = write_analysis([m], out / "plain", report=False, mgh=True)
    return m, plain, write_dataset([m], out / "bids", "made", report=False) / "anat" / "sub-made_hemi-L"


@pytest.fixture(scope="module")
def average(tmp_path_factory):
    """The right hemisphere of a FreeSurfer subject with a medial wall, as a BIDS subject."""
    m = measure(read_cortex(sample_path("fsaverage5"), "rh"))
    return m, write_dataset([m], tmp_path_factory.mktemp("average"), "average", report=False) / "anat"


# nilearn ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def nilearn_surface():
    return pytest.importorskip("nilearn.surface", reason="nilearn is not installed: pip install nilearn")


def same_mesh(mesh, surface):
    np.testing.assert_allclose(mesh.coordinates, surface.verts, atol=8e-6)
    np.testing.assert_array_equal(mesh.faces, surface.faces)


@quiet
def test_nilearn_opens_a_simulated_stage_as_a_freesurfer_subject(stage, nilearn_surface):
    cortex = read_cortex(stage)
    for name in ("white", "pial"):
        same_mesh(nilearn_surface.load_surf_mesh(stage / "surf" / f"lh.{name}"), getattr(cortex, name))
    assert set(cortex.maps) == {"thickness", "curv", "sulc", "area"}
    for name, values in freesurfer_maps(cortex).items():
        np.testing.assert_allclose(nilearn_surface.load_surf_data(stage / "surf" / f"lh.{name}"), values, atol=1e-4)
    height = np.linalg.norm(cortex.pial.verts, axis=1)
    curv = nilearn_surface.load_surf_data(stage / "surf" / "lh.curv")
    assert np.corrcoef(curv, height)[0, 1] < -0.9  # positive in sulci, as in FreeSurfer


@quiet
def test_nilearn_opens_the_maps_of_an_analysis_in_each_format(analysed, nilearn_surface, tmp_path):
    m, plain, stem = analysed
    for kind in ("white", "pial"):
        same_mesh(nilearn_surface.load_surf_mesh(plain / "surf" / f"lh.{kind}"), getattr(m.cortex, kind))
        same_mesh(nilearn_surface.load_surf_mesh(f"{stem}_{kind}.surf.gii"), getattr(m.cortex, kind))
    image = nilearn_surface.SurfaceImage(
        {"left": f"{stem}_pial.surf.gii"}, {"left": plain / "maps" / "lh.sulcal_depth.shape.gii"}
    )
    np.testing.assert_allclose(image.data.parts["left"].ravel(), m.maps["sulcal_depth"], atol=1e-5)
    for name, values in m.cortex.maps.items():
        file = plain / "surf" / f"lh.{name}"
        np.testing.assert_allclose(nilearn_surface.load_surf_data(file), values, rtol=1e-6, atol=1e-9)
    for name, values in m.maps.items():
        gifti = nilearn_surface.load_surf_data(plain / "maps" / f"lh.{name}.shape.gii")
        np.testing.assert_allclose(gifti, values, rtol=1e-6, atol=1e-9)
        packed = tmp_path / f"lh.{name}.mgz"  # the one ending of MGH that nilearn takes
        packed.write_bytes(gzip.compress((plain / "maps" / f"lh.{name}.mgh").read_bytes()))
        mgh = nilearn_surface.load_surf_data(packed)
        np.testing.assert_allclose(mgh, np.nan_to_num(values), rtol=1e-6, atol=1e-9)


# Connectome Workbench ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def workbench():
    """Runs ``wb_command`` and gives what it prints."""
    if shutil.which("wb_command") is None:
        pytest.skip("Connectome Workbench is not installed: apt-get install connectome-workbench")

    def run(*arguments):
        done = subprocess.run(["wb_command", *map(str, arguments)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def value_after(text, label):
    """What follows a label and a colon."""
    return re.search(rf"{re.escape(label)}:\s+(.*?)\s*$", text, re.M)[1]


def test_workbench_knows_hemisphere_kind_area_and_sides_of_an_analysis(analysed, workbench, tmp_path):
    m, _, stem = analysed
    for kind, called in (("white", "GrayWhite"), ("pial", "Pial")):
        output = workbench("-file-information", f"{stem}_{kind}.surf.gii")
        assert value_after(output, "Structure") == "CortexLeft"
        assert value_after(output, "Surface Type (Secondary)") == called
        assert value_after(output, "Normal Vectors Correct") == "true"
        area = vertex_areas(getattr(m.cortex, kind).verts, m.cortex.faces).sum()
        assert float(value_after(output, "Surface Area")) == pytest.approx(area, rel=1e-5)
    workbench("-surface-vertex-areas", f"{stem}_white.surf.gii", tmp_path / "area.shape.gii")
    for file in (tmp_path / "area.shape.gii", f"{stem}_area.shape.gii"):  # theirs and ours
        area = float(workbench("-metric-stats", file, "-reduce", "SUM"))
        assert area == pytest.approx(m.maps["area"].sum(), rel=1e-5)


def test_workbench_opens_regions_and_mask_and_counts_their_vertices(average, workbench, tmp_path):
    m, anat = average
    regions, mask = (anat / f"sub-average_hemi-R_{end}.label.gii" for end in ("seg-aparc_dseg", "desc-cortex_mask"))
    for file, key, name in ((regions, 1, m.cortex.regions.names[0]), (mask, 1, "cortex")):
        output = workbench("-file-information", file)
        assert (value_after(output, "Type"), value_after(output, "Structure")) == ("Label", "CortexRight")
        assert int(value_after(output, "Number of Vertices")) == m.cortex.n_vertices
        assert re.search(rf"^\s+0\s+\?\?\?\s.*\n\s+{key}\s+{name}\s", output, re.M)
    for file, name, inside in (
        (regions, "precuneus", m.cortex.regions.labels == m.cortex.regions.names.index("precuneus")),
        (mask, "cortex", m.cortex.cortex),
    ):
        workbench("-gifti-label-to-roi", file, tmp_path / "roi.shape.gii", "-name", name)
        count = float(workbench("-metric-stats", tmp_path / "roi.shape.gii", "-reduce", "SUM"))
        assert count == np.count_nonzero(inside) > 0


def test_workbench_finds_our_mean_thickness_within_the_cortex_label(average, workbench, tmp_path):
    m, anat = average
    file = anat / "sub-average_hemi-R_thickness.shape.gii"
    measured = np.isfinite(m.maps["cortical_thickness"])
    label = read_label(sample_path("fsaverage5") / "label" / "rh.cortex.label", len(measured))
    assert not measured[~label].any()
    assert "CortexRight" in value_after(workbench("-file-information", file), "Structure")
    assert workbench("-metric-stats", file, "-reduce", "MEAN").strip() == "nan"  # the wall is no zero
    write_gifti_map(tmp_path / "rh.roi.shape.gii", measured.astype(float))
    mean = float(workbench("-metric-stats", file, "-reduce", "MEAN", "-roi", tmp_path / "rh.roi.shape.gii"))
    assert mean == pytest.approx(m.scalars["mean_cortical_thickness_mm"], rel=1e-5)
