"""All measures of one cortex, on a model with known answers and on fsaverage5."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from morphofold.analysis import folding_indices, measure, vertex_areas, wavelength
from morphofold.analysis.measures import SCALARS
from morphofold.analysis.notes import of_input
from morphofold.errors import BadMesh, InsideOut, NoCortex, UnlikeSurfaces
from morphofold.geometry import split
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality.checks import check_pair, cortex_label, is_no_cortex
from morphofold.studies import shapes
from morphofold.surface import Cortex, Surface

MAPS = set("H K k1 k2 shape_index curvedness sulcal_depth cortical_thickness gyral_thickness area".split())


def part(cortex, keep):
    """The faces with all corners in ``keep`` (N,)."""
    faces = cortex.faces[keep[cortex.faces].all(axis=1)]
    return Cortex(*(Surface(s.verts, faces, s.name) for s in (cortex.white, cortex.pial)))


def shell(level=4, inner=47.0, outer=50.0, **more):
    """Two concentric spheres."""
    verts, faces = shapes.icosphere(level)
    return Cortex(Surface(inner * verts, faces, "lh.white"), Surface(outer * verts, faces, "lh.pial"), **more)


@pytest.fixture
def average(measured_average):
    return measured_average[0]


def test_volumes_are_those_of_spheres_and_an_open_surface_has_none():
    """Of inscribed polyhedra at two levels: what they lack falls with the square of the edge."""
    exact, lack = {"white": 4 / 3 * np.pi * 47**3, "pial": 4 / 3 * np.pi * 50**3}, []
    for level in (3, 4):
        s = measure(shell(level), only=["volume_white_mm3", "volume_pial_mm3", "gray_volume_mm3"]).scalars
        lack.append([1 - s[f"volume_{name}_mm3"] / volume for name, volume in exact.items()])
        assert s["gray_volume_mm3"] == pytest.approx(s["volume_pial_mm3"] - s["volume_white_mm3"], rel=1e-9)
    np.testing.assert_allclose(np.divide(*lack), 4, rtol=0.02)
    assert max(lack[1]) < 0.003
    opened = measure(
        part(shell(4), np.arange(2562) > 0), only=["volume_white_mm3", "volume_pial_mm3", "gray_volume_mm3"]
    )
    assert opened.scalars["volume_white_mm3"] is opened.scalars["volume_pial_mm3"] is None
    assert {"volume_white_mm3", "volume_pial_mm3"} <= set(opened.notes)
    assert opened.scalars["gray_volume_mm3"] == pytest.approx(s["gray_volume_mm3"], rel=0.01)


@pytest.fixture(scope="module")
def measured_shell():
    return measure(shell())


def test_a_shell_has_the_measures_of_its_spheres(measured_shell):
    s = measured_shell.scalars
    assert set(SCALARS) <= set(s)
    assert (s["n_vertices"], s["euler_characteristic"]) == (2562, 2)
    assert s["area_pial_mm2"] == pytest.approx(4 * np.pi * 50**2, rel=2e-3)
    assert s["area_white_mm2"] == pytest.approx(4 * np.pi * 47**2, rel=2e-3)
    assert s["gyrification_index"] == pytest.approx(1, abs=1e-9)
    assert s["folding_index"] == pytest.approx(0, abs=0.02)  # a root of what vanishes
    assert s["intrinsic_curvature_index"] == pytest.approx(1, abs=3e-3)
    assert s["mean_cortical_thickness_mm"] == pytest.approx(3, rel=2e-3)
    assert s["mean_sulcal_depth_mm"] == pytest.approx(0, abs=1e-9)
    assert np.allclose(measured_shell.maps["H"], 1 / 50)
    assert measured_shell.regions == []


def test_what_cannot_be_had_is_none_and_the_notes_say_why(measured_shell):
    m = measured_shell
    missing = {name for name, value in m.scalars.items() if value is None}
    assert {"median_gyral_thickness_mm", "gyral_to_cortical_slope"} <= missing
    assert all(len(m.notes[name]) > 20 for name in missing)
    assert (m.scalars["n_hinges"], m.scalars["crest_length_mm"], m.hinges, m.crests) == (0, 0.0, [], [])
    assert "n_hinges" in m.notes
    assert "aparc.annot" in m.notes["gyral_to_cortical_r"]  # what there should have been


def test_maps_are_nan_off_the_cortex_and_means_leave_it_out():
    cortex = shell()
    mask = cortex.pial.verts[:, 2] > -20
    white = np.where(mask[:, None], cortex.white.verts, cortex.pial.verts)  # closed medial wall
    closed = Cortex(Surface(white, cortex.faces), cortex.pial)
    labelled = replace(closed, cortex=cortex.pial.verts[:, 2] > 0)
    for case, inside in ((closed, mask), (labelled, labelled.cortex)):
        m = measure(case)
        for name in MAPS - {"area", "gyral_thickness"}:
            assert np.array_equal(np.isfinite(m.maps[name]), inside), name
        assert np.isfinite(m.maps["area"]).all()
        assert m.parameters["cortex_vertices"] == inside.sum()
        assert m.scalars["mean_cortical_thickness_mm"] == pytest.approx(np.nanmean(m.maps["cortical_thickness"]))
    assert m.scalars["mean_cortical_thickness_mm"] == pytest.approx(3, rel=2e-3)


def test_thickness_is_capped_where_that_is_asked_for():
    thick, capped = (
        measure(shell(3, 42.0), thickness_cap=cap, only=["mean_cortical_thickness_mm"]) for cap in (None, 5)
    )
    assert thick.scalars["mean_cortical_thickness_mm"] == pytest.approx(8, rel=0.01)
    assert thick.parameters["cortical_thickness_cap_mm"] is None
    assert "thickness_cap" not in thick.notes
    assert capped.scalars["mean_cortical_thickness_mm"] == capped.parameters["cortical_thickness_cap_mm"] == 5
    assert "100.0%" in capped.notes["thickness_cap"]


def test_the_mean_by_area_does_not_depend_on_where_the_mesh_is_dense():
    """A cortex of 2 mm in the south and 3 in the north, where every triangle is cut in four."""
    verts, faces = shapes.icosphere(4)
    north = (verts[faces][:, :, 2] > 0.05).all(axis=1)
    finer, cut = split(verts, faces[north])
    finer /= np.linalg.norm(finer, axis=1, keepdims=True)
    means = []
    for points, triangles in ((verts, faces), (finer, np.concatenate([faces[~north], cut]))):
        away = np.where(points[:, 2] > 0, 47.0, 48.0)
        white, pial = Surface(away[:, None] * points, triangles), Surface(50 * points, triangles)
        names = ["mean_cortical_thickness_mm", "mean_cortical_thickness_area_weighted_mm"]
        s = measure(Cortex(white, pial), only=names).scalars
        means.append([s[name] for name in names])
    (plain, by_area), (dense, dense_by_area) = means
    assert dense / plain > 1.08
    assert dense_by_area == pytest.approx(by_area, rel=0.005)
    assert plain == pytest.approx(by_area, rel=0.01)


def test_the_curvature_scale_is_what_was_asked_for_or_fits_the_mesh():
    cases = (shell(3), 12, 12), (shell(3), None, pytest.approx(2.5 * 7.5, rel=0.05)), (shell(4, 9.0, 10.0), None, 3.0)
    for cortex, requested, scale in cases:
        assert measure(cortex, curvature_scale=requested, only=["H"]).parameters["curvature_scale_mm"] == scale


def test_fsaverage5_has_plausible_measures_and_all_its_tables(measured_average):
    m, shares = measured_average
    s, cortex = m.scalars, m.cortex
    assert set(m.maps) == MAPS | {"thickness_file", "local_gyrification_index"}
    assert all(v.shape == (10242,) for v in m.maps.values())
    assert s["area_white_mm2"] == pytest.approx(66661.8, abs=0.1)
    assert s["area_pial_mm2"] == pytest.approx(76345.4, abs=0.1)
    assert s["gyrification_index"] == pytest.approx(1.648, abs=0.001)
    assert s["mean_cortical_thickness_mm"] == pytest.approx(2.36, abs=0.1)
    assert 8 < s["median_gyral_thickness_mm"] < 14
    assert 20 < s["wavelength_mm"] < 45
    assert 1.4 < s["mean_local_gyrification_index"] < 2.5  # of an average brain
    width = m.graph.graph["scales"].width
    assert s["spectral_wavelength_mm"] == wavelength(cortex.white.verts, cortex.faces, width)
    assert 0.5 < s["spectral_wavelength_mm"] / s["wavelength_mm"] < 2
    assert len(m.regions) == 34
    assert -1 <= s["gyral_to_cortical_r"] <= 1
    inside = np.isfinite(m.maps["cortical_thickness"])
    assert inside.sum() == 9354
    assert np.corrcoef(m.maps["H"][inside], cortex.maps["curv"][inside])[0, 1] < -0.75
    known = np.isfinite(m.maps["gyral_thickness"])
    assert not known[~cortex.cortex].any()
    assert known[cortex.cortex].mean() > 0.9
    assert re.search(r"\b1\.00\b.*\bGauss-Bonnet\b.* 1\.", m.notes["folding_index"])
    assert m.parameters["folding_scale_mm"] < m.parameters["curvature_scale_mm"]
    assert (shares == sorted(shares), shares[-1]) == (True, 1)


def test_names_load_on_first_use_and_stay_functions():
    """Importing the file that defines a name must not put the module in the name's place."""
    code = (
        "import sys, morphofold.analysis as a; assert 'numba' not in sys.modules and 'scipy' not in sys.modules;"
        "import morphofold.analysis.measures, morphofold.analysis.curvatures, morphofold.analysis.thickness.cortical;"
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
    names = "euler_characteristic gyrification_index median_gyral_thickness_mm mean_cortical_thickness_mm"
    s = measure(cortex, only=names.split()).scalars
    assert s["euler_characteristic"] == 2
    assert 1.73 < s["gyrification_index"] < 1.97
    assert 2.3 < s["median_gyral_thickness_mm"] / s["mean_cortical_thickness_mm"] < 2.8
    # nearly incompressible: what lies between white and pial is the grown volume of the cortex
    white, pial = (np.linalg.det(surface.verts[surface.faces]).sum() / 6 for surface in (cortex.white, cortex.pial))
    assert pial - white == pytest.approx(1.9**3 * 4 / 3 * np.pi * (50**3 - 47**3), rel=0.03)


def test_mean_depth_is_weighted_by_the_pial_area_of_the_cortex(average):
    cortex = average.cortex
    inside = cortex.cortex & np.any(cortex.white.verts != cortex.pial.verts, axis=1)
    depth = average.maps["sulcal_depth"][inside]
    areas = [vertex_areas(s.verts, s.faces)[inside] for s in (cortex.pial, cortex.white)]
    by_pial, by_white = (np.average(depth, weights=w) for w in areas)
    assert min(abs(by_pial - by_white), abs(by_pial - depth.mean())) > 0.1  # or this test says nothing
    assert average.scalars["mean_sulcal_depth_mm"] == pytest.approx(by_pial, rel=1e-9)


def test_folding_indices_are_those_of_white_and_the_maps_those_of_pial():
    bump = shapes.bumpy_sphere(5)
    away = np.linalg.norm(bump.verts, axis=1, keepdims=True)
    pial = Surface(70 * bump.verts / away, bump.faces, "lh.pial")  # a sphere
    m = measure(Cortex(Surface(bump.verts, bump.faces, "lh.white"), pial), curvature_scale=4)
    exact = folding_indices(bump.verts, bump.faces, 4.0)
    assert exact.folding_index > 0.5
    assert m.scalars["folding_index"] == exact.folding_index
    assert m.scalars["intrinsic_curvature_index"] == exact.intrinsic_curvature_index
    assert m.parameters["folding_scale_mm"] == 4
    assert np.allclose(m.maps["H"], 1 / 70, rtol=1e-6)


@pytest.mark.slow
def test_the_wavelength_of_ridges_along_circles_of_latitude_is_their_spacing():
    """Ten ridges in the half circle of the meridian; the way from fundus to fundus goes up and down each of them."""
    cortex, _ = shapes.ridged_sphere(6, width=6.0, ridges=10, height=4.0, radius=50.0)
    theta = np.linspace(0, np.pi, 20001)
    away = 50 * np.abs(theta % (np.pi / 10) - np.pi / 20)
    r = 50 + 4 * np.exp2(-((away / 3) ** 2))
    step = np.hypot(np.diff(r), np.diff(theta) * (r[1:] + r[:-1]) / 2)
    area = 2 * np.pi * np.sum(step * (r * np.sin(theta))[:-1])
    crowns = np.pi / 20 * (2 * np.arange(10) + 1)
    contour = 2 * np.pi * 52 * np.sum(np.sin([crowns - 3 / 50, crowns + 3 / 50]))  # both walls of each
    m = measure(cortex)
    assert m.scalars["wavelength_mm"] == pytest.approx(2 * area / contour, rel=0.02)


def test_an_open_sheet_that_is_inside_out_or_swapped_is_refused():
    """Repair cannot tell the two."""
    whole = shell(3)
    faces = whole.faces[whole.white.verts[whole.faces].mean(axis=1)[:, 2] > 0]
    white, pial = (replace(s, faces=faces) for s in (whole.white, whole.pial))
    assert measure(Cortex(white, pial)).scalars["mean_cortical_thickness_mm"] == pytest.approx(3.0, rel=0.02)
    for turned in ([replace(s, faces=faces[:, ::-1]) for s in (white, pial)], [pial, white]):
        with pytest.raises(InsideOut, match=r"\b100% .*\b\d+, "):
            measure(Cortex(*turned))


def test_vertices_that_no_triangle_uses_change_no_number(average):
    """The same places once more, as joined seams leave them."""
    cortex, n = average.cortex, average.cortex.n_vertices
    again = np.arange(0, n, 20)
    twice = lambda values: np.concatenate([values, values[again]])
    surfaces = {name: replace(s, verts=twice(s.verts)) for name, s in (("white", cortex.white), ("pial", cortex.pial))}
    maps, regions = (
        {k: twice(v) for k, v in cortex.maps.items()},
        replace(cortex.regions, labels=twice(cortex.regions.labels)),
    )
    m = measure(
        replace(cortex, **surfaces, inflated=None, sphere=None, maps=maps, cortex=twice(cortex.cortex), regions=regions)
    )
    assert (m.scalars, m.regions, m.parameters) == (average.scalars, average.regions, average.parameters)
    assert f"{len(again)} of {n + len(again)} vertices" in m.notes["mesh"]
    for name, values in m.maps.items():
        np.testing.assert_array_equal(values[:n], average.maps[name])
        assert np.isnan(values[n:]).all()


def test_surfaces_that_are_inside_out_swapped_or_the_same_are_refused():
    good = shell(3)
    turned = [Surface(s.verts, s.faces[:, ::-1], s.name) for s in (good.white, good.pial)]
    with pytest.raises(InsideOut, match=r"\blh\.white\b.* -4\.\d+e\+05 mm\^3"):
        measure(Cortex(*turned), repair=False)
    with pytest.raises(UnlikeSurfaces, match=r"\b5\d+ mm\^3.* 4\d+ mm\^3"):
        measure(Cortex(good.pial, good.white))
    with pytest.raises(UnlikeSurfaces, match=r"\blh\.white\b.*\b642\b"):
        measure(Cortex(good.white, good.white))


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_surfaces_of_two_hemispheres_are_refused_in_any_unit(unit):
    lh, rh = (read_cortex(sample_path("fsaverage5"), hemi) for hemi in ("lh", "rh"))
    white, left, right = (Surface(unit * s.verts, s.faces, s.name) for s in (lh.white, lh.pial, rh.pial))
    distance = unit * np.median(np.linalg.norm(lh.white.verts - rh.pial.verts, axis=1))
    with pytest.raises(UnlikeSurfaces, match=r"\blh\.white and rh\.pial\b") as refused:
        check_pair(Cortex(white, right))
    assert float(re.search(r"(\S+) mm,", str(refused.value))[1]) == pytest.approx(distance, rel=0.01)
    check_pair(Cortex(white, left))


def test_a_cortex_may_be_as_thick_as_its_core():
    """Growth makes of a fifth of the radius half of it; the distance is along the normals all the same."""
    check_pair(shell(3, 30.0, 60.0))
    check_pair(read_cortex(sample_path("simulated")))
    check_pair(read_cortex(sample_path("S1")))


def test_a_flat_patch_and_a_label_without_a_vertex_are_refused():
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0), indexing="ij")
    verts = np.stack([x.ravel(), y.ravel(), np.zeros(144)], axis=1)
    a = (np.arange(11)[:, None] * 12 + np.arange(11)).ravel()
    faces = np.concatenate([np.stack([a, a + 12, a + 13], 1), np.stack([a, a + 13, a + 1], 1)])
    with pytest.raises(BadMesh, match=r"\b144\b"):
        measure(Cortex(Surface(verts - [0, 0, 2], faces), Surface(verts, faces)))
    with pytest.raises(NoCortex, match=r"\b0 of 642\b"):
        measure(shell(3, cortex=np.zeros(642, dtype=bool)))


def test_open_surfaces_and_several_pieces_have_depth_but_no_gyrification_index():
    whole, names = shell(), ["gyrification_index", "mean_sulcal_depth_mm", "folding_index"]
    open_ = measure(part(whole, whole.pial.verts[:, 2] > -10), only=names)
    twice = np.concatenate([whole.faces, whole.faces + whole.n_vertices])
    pair = [Surface(np.concatenate([s.verts, s.verts + [200, 0, 0]]), twice) for s in (whole.white, whole.pial)]
    two = measure(Cortex(*pair), only=names)
    for m, number in ((open_, ""), (two, " 2 ")):
        assert m.scalars["gyrification_index"] is None
        assert number in m.notes["gyrification_index"]
        assert m.scalars["mean_sulcal_depth_mm"] >= 0
    assert "Gauss-Bonnet" not in open_.notes["folding_index"]
    assert re.search(r"\bGauss-Bonnet\b.* 2\.", two.notes["folding_index"])


def test_a_parcellation_says_where_cortex_is_if_no_label_does(average):
    cortex = average.cortex
    without = replace(cortex, cortex=None)
    mask, word = cortex_label(without)
    assert word == "annotation"
    assert np.mean(mask == cortex.cortex) > 0.98  # FreeSurfer's own label, but for its rim
    notes = of_input(without)
    assert "annotation" in notes["cortex_mask"]
    labels, names = cortex.regions.labels, cortex.regions.names
    for change in (
        {"labels": np.where(cortex.pial.verts[:, 1] > -20, labels, -1)},  # two thirds of the areas
        {"names": tuple(f"area {k}" for k in range(len(names))), "labels": np.maximum(labels, 0)},  # everywhere
    ):
        other = replace(without, regions=replace(cortex.regions, **change))
        assert cortex_label(other)[1] == "thickness"  # the next in order
    assert cortex_label(cortex)[1] == "label"


def test_an_average_is_known_by_its_folder_from_inside_it_and_is_not_taken_for_a_person(average, tmp_path, monkeypatch):
    for folder, file in (("", "surf/lh.white"), ("surf", "lh.white"), ("label", "../surf/lh.white")):
        (tmp_path / "fsaverage5" / folder).mkdir(parents=True, exist_ok=True)
        monkeypatch.chdir(tmp_path / "fsaverage5" / folder)
        assert "average" in of_input(replace(average.cortex, files=(file,)))
    monkeypatch.chdir(tmp_path)
    for file in ("fsaverage_study/bert/surf/lh.white", "fsaverage/notes.txt", "lh.white"):
        assert "average" not in of_input(replace(average.cortex, files=(file,)))


def test_names_of_what_is_no_cortex_are_known():
    walls = (
        "unknown",
        "Medial_wall",
        "Background+FreeSurfer_Defined_Medial_Wall",
        "medial wall",
        "corpuscallosum",
        "???",
    )
    assert all(map(is_no_cortex, walls))
    assert not any(map(is_no_cortex, ("medialorbitofrontal", "insula")))


def test_notes_tell_of_foreign_units_a_missing_label_and_an_unhealthy_simulation(measured_shell):
    names = ["H", "intrinsic_curvature_index"]
    notes = lambda scale=None, **more: measure(shell(**more), only=names, curvature_scale=scale).notes
    plain = notes(units="cm", info={"warnings": []})
    assert "'cm'" in plain["curvature_scale"]
    assert "cortex_mask" in plain
    assert "simulation" not in plain
    simulated = notes(origin="simulation", info={"warnings": ["volume drifts", "min J 0.1"]})
    assert simulated["simulation"] == "volume drifts; min J 0.1"
    assert not {"cortex_mask", "curvature_scale"} & set(simulated)
    labelled = notes(cortex=np.ones(2562, dtype=bool))
    assert "cortex_mask" not in labelled
    assert "parcellation" in labelled
    for size in (1e-3, 1e3):  # metres, micrometres
        m = measure(shell(inner=47 * size, outer=50 * size), only=names)
        assert "do not look like millimetres" in m.notes["curvature_scale"]
        assert m.scalars["intrinsic_curvature_index"] == pytest.approx(1, abs=0.01)
    assert "curvature_scale" not in notes(9)
