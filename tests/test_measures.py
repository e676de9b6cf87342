"""All measures of one cortex, on a model with known answers and on fsaverage5."""

import subprocess
import sys

import numpy as np
import pytest

from morphofold import shapes
from morphofold.analysis import measure
from morphofold.analysis.measures import SCALARS, _gyral_on_cortical
from morphofold.io import read_cortex, sample_path
from morphofold.surface import Cortex, Surface

MAPS = {
    "H", "K", "k1", "k2", "shape_index", "curvedness", "sulcal_depth", "cortical_thickness", "gyral_thickness", "area",
}  # fmt: skip


def shell(level=4, inner=47.0, outer=50.0, **more):
    """Two concentric spheres."""
    verts, faces = shapes.icosphere(level)
    return Cortex(Surface(inner * verts, faces, "lh.white"), Surface(outer * verts, faces, "lh.pial"), **more)


@pytest.fixture(scope="module")
def average():
    steps = []
    measures = measure(read_cortex(sample_path("fsaverage5")), progress=lambda what, share: steps.append((what, share)))
    return measures, steps


def test_a_shell_has_the_measures_of_its_spheres():
    m = measure(shell())
    s = m.scalars
    assert set(SCALARS) <= set(s)
    assert (s["n_vertices"], s["euler_characteristic"]) == (2562, 2)
    assert s["area_pial_mm2"] == pytest.approx(4 * np.pi * 50**2, rel=2e-3)
    assert s["area_white_mm2"] == pytest.approx(4 * np.pi * 47**2, rel=2e-3)
    assert s["gyrification_index"] == pytest.approx(1, abs=1e-9)
    assert s["folding_index"] == pytest.approx(0, abs=1e-6)
    assert s["intrinsic_curvature_index"] == pytest.approx(1, abs=3e-3)
    assert s["mean_cortical_thickness_mm"] == pytest.approx(3, rel=2e-3)
    assert s["mean_sulcal_depth_mm"] == pytest.approx(0, abs=1e-9)
    assert np.allclose(m.maps["H"], 1 / 50)
    assert m.regions == []


def test_what_cannot_be_had_is_none_and_the_notes_say_why():
    m = measure(shell())
    missing = {name for name, value in m.scalars.items() if value is None}
    assert {"n_hinges", "crest_length_mm", "median_gyral_thickness_mm", "gyral_to_cortical_slope"} <= missing
    assert all(len(m.notes[name]) > 20 for name in missing)
    assert "Crest lines and hinges are not measured" in m.notes["n_hinges"]
    assert "three regions" in m.notes["gyral_to_cortical_r"]


def test_maps_are_nan_off_the_cortex_and_means_leave_it_out():
    cortex = shell()
    mask = cortex.pial.verts[:, 2] > -20
    white = np.where(mask[:, None], cortex.white.verts, cortex.pial.verts)       # closed medial wall
    closed = Cortex(Surface(white, cortex.faces), cortex.pial)
    told = Cortex(Surface(white, cortex.faces), cortex.pial, cortex=cortex.pial.verts[:, 2] > 0)
    for case, inside in ((closed, mask), (told, told.cortex)):
        m = measure(case)
        for name in MAPS - {"area", "gyral_thickness"}:
            assert np.array_equal(np.isfinite(m.maps[name]), inside), name
        assert np.isfinite(m.maps["area"]).all()
        assert m.parameters["cortex_vertices"] == inside.sum()
        assert m.scalars["mean_cortical_thickness_mm"] == pytest.approx(np.nanmean(m.maps["cortical_thickness"]))
    assert measure(told).scalars["mean_cortical_thickness_mm"] == pytest.approx(3, rel=2e-3)


def test_freesurfers_bound_on_thickness_is_for_its_own_subjects_only():
    thick = measure(shell(3, 42.0))
    assert thick.scalars["mean_cortical_thickness_mm"] == pytest.approx(8, rel=0.01)
    assert thick.parameters["cortical_thickness_cap_mm"] is None
    capped = measure(shell(3, 42.0, origin="FreeSurfer"))
    assert capped.scalars["mean_cortical_thickness_mm"] == 5
    assert capped.parameters["cortical_thickness_cap_mm"] == 5


def test_the_curvature_scale_is_what_was_asked_for_or_fits_the_mesh():
    assert measure(shell(3), curvature_scale=12).parameters["curvature_scale_mm"] == 12
    coarse = measure(shell(3)).parameters["curvature_scale_mm"]
    assert coarse == pytest.approx(2.5 * 7.5, rel=0.05)
    fine = measure(shell(4, 9.0, 10.0)).parameters["curvature_scale_mm"]
    assert fine == 3.0


def test_fsaverage5_has_plausible_measures_and_all_its_tables(average):
    m, steps = average
    s = m.scalars
    assert set(m.maps) == MAPS | {"thickness_file"}
    assert all(v.shape == (10242,) for v in m.maps.values())
    assert s["area_white_mm2"] == pytest.approx(66661.8, abs=0.1)
    assert s["area_pial_mm2"] == pytest.approx(76345.4, abs=0.1)
    assert s["gyrification_index"] == pytest.approx(1.648, abs=0.001)
    assert s["mean_cortical_thickness_mm"] == pytest.approx(2.36, abs=0.1)
    assert 8 < s["median_gyral_thickness_mm"] < 14
    assert 20 < s["wavelength_mm"] < 45
    assert len(m.regions) == 34
    assert -1 <= s["gyral_to_cortical_r"] <= 1
    cortex = np.isfinite(m.maps["cortical_thickness"])
    assert cortex.sum() == 9354
    assert np.corrcoef(m.maps["H"][cortex], m.cortex.maps["curv"][cortex])[0, 1] < -0.75
    shares = [share for _, share in steps]
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_the_slope_over_regions_is_that_of_least_squares(rng):
    x, y = rng.uniform(1, 4, 20), rng.uniform(5, 15, 20)
    rows = [{"cortical_thickness_mm": float(a), "gyral_thickness_mm": float(b)} for a, b in zip(x, y, strict=True)]
    slope, r, note = _gyral_on_cortical([*rows, {"cortical_thickness_mm": 3.0, "gyral_thickness_mm": None}])
    assert slope == pytest.approx(np.polyfit(x, y, 1)[0])
    assert r == pytest.approx(np.corrcoef(x, y)[0, 1])
    assert "20 regions" in note


def test_names_load_on_first_use_and_stay_functions():
    """Importing the file that defines a name must not put the module in the name's place."""
    code = (
        "import sys, morphofold.analysis as a; assert 'numba' not in sys.modules and 'scipy' not in sys.modules;"
        "import morphofold.analysis.measures, morphofold.analysis._curvature, morphofold.analysis.thickness;"
        "assert all(not isinstance(getattr(a, n), type(sys)) for n in a.__all__);"
        "assert set(a.__all__) == set(a._PUBLIC) == set(dir(a));"
        "a.no_such_name"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "AttributeError: module 'morphofold.analysis' has no attribute 'no_such_name'" in done.stderr


def test_the_simulated_sample_is_folded_as_an_independent_study_of_the_same_body_found():
    """T = 3, g = 1.9: GI 1.73 to 1.97 over three meshes and two elements; gyri 2.4 to 2.7 cortices wide."""
    cortex = read_cortex(sample_path("simulated"))
    assert (cortex.origin, cortex.portion, cortex.info["g"]) == ("simulation", 0.5, 1.9)
    s = measure(cortex).scalars
    assert s["euler_characteristic"] == 2
    assert 1.73 < s["gyrification_index"] < 1.97
    assert 2.3 < s["median_gyral_thickness_mm"] / s["mean_cortical_thickness_mm"] < 2.8
    # nearly incompressible: what lies between white and pial is the grown volume of the cortex
    volume = [np.einsum("ij,ij->", *_corner_areas(surface)) / 3 for surface in (cortex.white, cortex.pial)]
    assert volume[1] - volume[0] == pytest.approx(1.9**3 * 4 / 3 * np.pi * (50**3 - 47**3), rel=0.03)


def _corner_areas(surface):
    """Centroids of the faces, and their area vectors."""
    a, b, c = (surface.verts[surface.faces[:, k]] for k in range(3))
    return (a + b + c) / 3, np.cross(b - a, c - a) / 2
