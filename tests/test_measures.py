"""All measures of one cortex, or some of them, on models with known answers and on fsaverage5; what changes nothing."""

import re
from dataclasses import replace

import numba
import numpy as np
import pandas as pd
import pytest
from made_changes import CHANGES, changed
from made_measures import made_measures
from scipy.spatial import cKDTree

from morphofold.analysis import folding_indices, measure, vertex_areas, wavelength
from morphofold.analysis.measures_result import COLUMNS, FRAMES, SCALARS, column_type
from morphofold.analysis.measuring import STEPS
from morphofold.analysis.notes import of_input
from morphofold.analysis.steps import steps_for
from morphofold.errors import BadMesh, InsideOut, NoCortex, NothingToDo, UnknownName, UnlikeSurfaces
from morphofold.geometry import vertex_normals
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality.cortex_checks import check_pair, cortex_label, is_no_cortex
from morphofold.report.pages.page_writer import methods_of
from morphofold.shapes import icosphere
from morphofold.studies import known_shapes
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Cortex, Regions, Surface
from morphofold.threads import using_threads

MAPS = set("H K k1 k2 shape_index curvedness sulcal_depth cortical_thickness gyral_thickness area".split())


def part(cortex, keep):
    """The faces with all corners in ``keep`` (N,)."""
    faces = cortex.faces[keep[cortex.faces].all(axis=1)]
    return Cortex(*(Surface(s.verts, faces, s.name) for s in (cortex.white, cortex.pial)))


def shell(level=4, inner=47.0, outer=50.0, **more):
    """Two concentric spheres."""
    verts, faces = known_shapes.icosphere(level)
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
    has_width = np.isfinite(m.maps["gyral_thickness"])
    assert not has_width[~cortex.cortex].any()
    assert has_width[cortex.cortex].mean() > 0.9
    assert re.search(r"\b1\.00\b.*\bGauss-Bonnet\b.* 1\.", m.notes["folding_index"])
    assert m.parameters["folding_scale_mm"] < m.parameters["curvature_scale_mm"]
    assert (shares == sorted(shares), shares[-1]) == (True, 1)


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


def test_folding_indices_are_those_of_white_and_the_maps_those_of_pial():
    bump = known_shapes.bumpy_sphere(5)
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
    cortex, _ = known_shapes.ridged_sphere(6, width=6.0, ridges=10, height=4.0, radius=50.0)
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
    for pair in ([replace(s, faces=faces[:, ::-1]) for s in (white, pial)], [pial, white]):
        with pytest.raises(InsideOut, match=r"\b100% .*\b\d+, "):
            measure(Cortex(*pair))


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
    inside_out = [Surface(s.verts, s.faces[:, ::-1], s.name) for s in (good.white, good.pial)]
    with pytest.raises(InsideOut, match=r"\blh\.white\b.* -4\.\d+e\+05 mm\^3"):
        measure(Cortex(*inside_out), repair=False)
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
    check_pair(shell(3, 30.0, 60.0))  # growth makes of a fifth of the radius half of it, along the normals all the same


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


def test_a_parcellation_says_where_cortex_is_unless_it_is_of_a_few_areas_or_of_all(average):
    without, regions = replace(average.cortex, cortex=None), average.cortex.regions
    mask, word = cortex_label(without)
    assert word == "annotation"
    assert np.mean(mask == average.cortex.cortex) > 0.98  # FreeSurfer's own label, but for its rim
    some = {"labels": np.where(without.pial.verts[:, 1] > -20, regions.labels, -1)}  # two thirds of the areas
    everywhere = {"names": tuple(map(str, range(len(regions.names)))), "labels": np.maximum(regions.labels, 0)}
    for change in (some, everywhere):
        assert cortex_label(replace(without, regions=replace(regions, **change)))[1] == "thickness"  # next in order


def test_an_average_is_known_by_its_folder_from_inside_it_and_is_not_taken_for_a_person(average, tmp_path, monkeypatch):
    for folder, file in (("", "surf/lh.white"), ("surf", "lh.white"), ("label", "../surf/lh.white")):
        (tmp_path / "fsaverage5" / folder).mkdir(parents=True, exist_ok=True)
        monkeypatch.chdir(tmp_path / "fsaverage5" / folder)
        assert "average" in of_input(replace(average.cortex, files=(file,)))
    monkeypatch.chdir(tmp_path)
    for file in ("fsaverage_study/bert/surf/lh.white", "fsaverage/notes.txt", "lh.white"):
        assert "average" not in of_input(replace(average.cortex, files=(file,)))


def test_names_of_what_is_no_cortex_are_known():
    walls = "unknown,Medial_wall,Background+FreeSurfer_Defined_Medial_Wall,medial wall,corpuscallosum,???"
    assert all(map(is_no_cortex, walls.split(",")))
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


def types(frame):
    return {column: str(kind) for column, kind in frame.dtypes.items()}


def test_scalars_are_one_row_with_the_numbers_of_freesurfer_beside_them():
    row = made_measures(info={"etiv_mm3": 1.5e6, "surface_holes": 7, "g": 2.0}).to_frame()
    assert tuple(row) == FRAMES["scalars"]
    assert len(row) == 1
    assert row.loc[0, ["name", "hemi", "euler_characteristic", "surface_holes"]].tolist() == ["bump", "lh", 2, 7]
    assert row.at[0, "etiv_mm3"] == 1.5e6
    assert row.at[0, "gyrification_index"] == 1.25


def test_what_cannot_be_computed_is_missing_and_not_zero():
    row = made_measures().to_frame()
    names = [name for name in SCALARS if made_measures().scalars[name] is not None]
    assert row[names].notna().all(axis=None)
    assert (
        row[[name for name in FRAMES["scalars"] if name not in ("name", "hemi", "verdict", *names)]]
        .isna()
        .all(axis=None)
    )
    assert made_measures().to_frame("regions")["n_hinges"].isna().all()


@pytest.mark.parametrize("table", FRAMES)
def test_a_table_without_rows_has_its_columns_with_their_types(table):
    empty = replace(made_measures(), regions=[], crests=[], hinges=[], arms=[]).to_frame(table)
    assert len(empty) == (table == "scalars")
    assert types(empty) == types(made_measures().to_frame(table))
    assert types(empty) == {column: column_type(column) for column in FRAMES[table]}


@pytest.mark.parametrize("table", COLUMNS)
def test_a_frame_holds_every_number_of_its_table(measured_average, table):
    average, _ = measured_average
    rows, frame = getattr(average, table), average.to_frame(table)
    assert len(rows) > 3
    assert {key for row in rows for key in row} <= set(frame)  # nothing is left out
    for column in COLUMNS[table]:
        assert [None if pd.isna(x) else x for x in frame[column]] == [row.get(column) for row in rows]
    assert set(frame["name"]) == {"fsaverage5"}


@pytest.mark.parametrize("table", FRAMES)
def test_the_columns_of_whole_numbers_are_those_that_count_or_number(measured_average, table):
    average, _ = measured_average
    rows = [average.scalars] if table == "scalars" else getattr(average, table)
    whole = {key for row in rows for key, value in row.items() if isinstance(value, int)}
    parts = {key for row in rows for key, value in row.items() if isinstance(value, float)}
    assert whole
    assert {column_type(key) for key in whole} == {"Int64"}
    assert {column_type(key) for key in parts} <= {"float64"}


def test_frames_of_two_subjects_are_put_together_and_keep_their_types():
    first, second = (
        made_measures(hemi, name=name).to_frame("hinges") for hemi, name in (("lh", "anna"), ("rh", "ben"))
    )
    both = pd.concat([first, second], ignore_index=True)
    assert types(both) == types(first)
    assert list(both[["name", "hemi"]].itertuples(index=False, name=None)) == [("anna", "lh"), ("ben", "rh")]


def test_a_table_that_does_not_exist_is_refused_by_name():
    with pytest.raises(UnknownName, match="scalars, regions, crests, hinges, arms"):
        made_measures().to_frame("vertices")


def test_means_are_weighted_by_the_areas_of_the_cortex(average):
    """Depth by pial area, thickness by that of white and pial."""
    cortex = average.cortex
    inside = np.isfinite(average.maps["sulcal_depth"])
    pial, white = (vertex_areas(s.verts, s.faces)[inside] for s in (cortex.pial, cortex.white))
    cases = (
        ("sulcal_depth", "mean_sulcal_depth_mm", pial),
        ("cortical_thickness", "mean_cortical_thickness_area_weighted_mm", white + pial),
    )
    for name, mean, weights in cases:
        values = average.maps[name][inside]
        assert abs(np.average(values, weights=weights) - values.mean()) > 0.01  # or this test says nothing
        assert average.scalars[mean] == pytest.approx(np.average(values, weights=weights), rel=1e-9)


NAMES = [name for step in STEPS for name in step.makes]
#: of each kind of step one; the others are slow
COMMON = ("surfaces", "cortical thickness", "gyral graph", "crests", "slopes")
MAKERS = [
    pytest.param(step, id=step.name, marks=() if step.name in COMMON else pytest.mark.slow)
    for step in STEPS
    if step.makes
]


@pytest.fixture(scope="module")
def cortex():
    """A folded ball with five regions and a thickness of its own."""
    ball = folded_ball(2500)
    labels = np.digitize(ball.pial.verts[:, 2], [-30.0, -10.0, 10.0, 30.0])
    regions = Regions(labels, ("a", "b", "c", "d", "e"), np.zeros((5, 3), dtype=np.uint8))
    return replace(ball, regions=regions, maps={"thickness": np.full(ball.n_vertices, 3.0)})


@pytest.fixture(scope="module")
def whole(cortex):
    return measure(cortex)


def same(value, other):
    """Whether two values are the same bit for bit."""
    if isinstance(value, np.ndarray):
        return value.tobytes() == other.tobytes()
    return repr(value) == repr(other)


def value_of(m, name):
    return m.maps[name] if name in m.maps else m.scalars[name] if name in m.scalars else getattr(m, name)


def test_every_number_map_and_table_can_be_asked_for_once(whole):
    assert sorted(NAMES) == sorted({*whole.maps, *SCALARS, *COLUMNS})


@pytest.mark.parametrize("step", MAKERS)
def test_what_is_asked_for_is_the_same_bit_for_bit_and_nothing_else_is_there(cortex, whole, step):
    m = measure(cortex, only=step.makes)
    for name in step.makes:
        assert same(value_of(m, name), value_of(whole, name)), name
    rest = set(NAMES) - set(step.makes)
    assert not rest & set(m.maps)
    assert all(m.scalars[name] is None for name in rest & set(SCALARS))
    assert all(getattr(m, table) == [] for table in rest & set(COLUMNS))
    assert m.parameters["only"] == list(step.makes)
    shared = m.parameters.keys() & whole.parameters.keys()
    assert all(same(m.parameters[name], whole.parameters[name]) for name in shared)
    assert all(name in m.notes["only"] for name in step.makes)
    assert {name for name in m.notes if name in step.makes and m.scalars.get(name, 0) is None} <= set(whole.notes)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_one_thread_gives_the_same_bits_as_several(cortex, whole):
    with using_threads(1):
        alone = measure(cortex)
    assert all(same(values, whole.maps[name]) for name, values in alone.maps.items())
    assert (alone.scalars, alone.hinges, alone.crests) == (whole.scalars, whole.hinges, whole.crests)


def test_the_reason_for_an_empty_map_stays():
    verts, faces = icosphere(3)
    shell = Cortex(Surface(47 * verts, faces), Surface(50 * verts, faces))
    m = measure(shell, only=["gyral_thickness"])
    assert np.isnan(m.maps["gyral_thickness"]).all()
    assert m.notes["median_gyral_thickness_mm"] == measure(shell).notes["median_gyral_thickness_mm"]


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("gyrification_index", {"surfaces", "hull"}),
        ("gyral_thickness", {"surfaces", "operators", "resampling", "cortical thickness", "gyral thickness"}),
        ("n_hinges", {"surfaces", "operators", "resampling", "self-crossings", "gyral graph"}),
        (
            "regions",
            {step.name for step in STEPS} - {"depth", "hull", "folding", "hinges", "crests", "slopes", "shapes"},
        ),
        ("shapes", {"surfaces", "operators", "depth", "curvature", "cortical thickness", "resampling", "shapes"}),
    ],
)
def test_only_the_steps_that_a_name_needs_run(name, steps):
    assert {step.name for step in steps_for([name], STEPS)} == steps


@pytest.mark.parametrize(
    ("only", "kind"), [(["gyral_thicknes"], UnknownName), ([], NothingToDo), ("H", TypeError), ([3], UnknownName)]
)
def test_an_unknown_name_is_refused_before_anything_is_measured(cortex, only, kind):
    with pytest.raises(kind):
        measure(cortex, only=only)


def test_the_methods_of_a_page_name_only_what_was_measured(cortex):
    m = measure(cortex, only=["cortical_thickness"])
    sentences, _ = methods_of([m])
    assert "Cortical thickness" in sentences
    assert not any(word in sentences for word in ("Gyral thickness", "Curvature", "gyrification", "depth"))


# largest change points any vertex, of the 90th percentile of a map: curvature is fitted, and solvers stop points 1e-6
MAP_BOUND = 1e-5
# contours of voxels are not mirrored triangle by triangle
MIRRORED_LOCAL_GYRIFICATION_BOUND = 2e-3
HINGE_BOUND_MM = 1e-4
TABLE_BOUND = 2e-3  # relative, of an angle, a curvature or a strength; lengths and thicknesses: 1e-5
NUMBERING = {"hinge", "crest", "from_hinge", "to_hinge", "arm", "vertex", "x", "y", "z"}
SMOOTH = {"length_mm", "gyral_thickness_mm", "cortical_thickness_mm", "area_mm2", "gray_volume_mm3", "thickness_mm"}


@pytest.fixture(scope="module", params=[pytest.param("fsaverage5", marks=pytest.mark.slow), "simulated"])
def before(request):
    cortex = read_cortex(sample_path(request.param), hemi="lh")
    return cortex, measure(cortex, accuracy="draft")


@pytest.mark.parametrize("change", [*CHANGES[:2], *(pytest.param(c, marks=pytest.mark.slow) for c in CHANGES[2:])])
def test_what_changes_nothing_moves_no_map_and_no_row(before, change):
    cortex, measures = before
    new, vertex, back = changed(cortex, change)
    other = measure(new, accuracy="draft")
    for name, values in measures.maps.items():
        voxels = change == "mirror" and name == "local_gyrification_index"
        bound = (MIRRORED_LOCAL_GYRIFICATION_BOUND if voxels else MAP_BOUND) * np.nanpercentile(np.abs(values), 90)
        np.testing.assert_allclose(other.maps[name][vertex], values, rtol=0, atol=bound, err_msg=name)
    assert [k for k, v in other.scalars.items() if v is None] == [k for k, v in measures.scalars.items() if v is None]
    for name, value in ((k, v) for k, v in measures.scalars.items() if v is not None):
        assert other.scalars[name] == pytest.approx(value, rel=1e-4, abs=1e-9), name
    for name in ("regions", "crests", "hinges", "arms", "shapes"):
        assert_same_rows(getattr(measures, name), getattr(other, name), name)
    points, other_points = (np.array([[row[k] for k in "xyz"] for row in m.hinges]) for m in (measures, other))
    away, nearest = cKDTree(back(other_points)).query(points)
    assert away.max() < HINGE_BOUND_MM
    assert [other.hinges[k]["shape"] for k in nearest] == [row["shape"] for row in measures.hinges]


def test_noise_moves_no_arm_of_a_body_with_three_planes_of_symmetry():
    verts, faces = icosphere(4)
    bumps = np.cos(6 * verts).prod(axis=1)
    verts = verts * (50 + 3 * bumps + 2 * np.cos(14 * verts[:, 2]))[:, None]
    cortex = Cortex(Surface(verts - 2 * vertex_normals(verts, faces), faces), Surface(verts, faces))
    measures, other = (measure(c, accuracy="draft").arms for c in (cortex, changed(cortex, "noise")[0]))
    angles = [np.sort([row["angle_deg"] for row in rows]) for rows in (measures, other)]
    np.testing.assert_allclose(*angles, rtol=TABLE_BOUND)


def assert_same_rows(measures, other, name):
    """Columns of two tables as sets, because rows are in the order of positions."""
    assert len(other) == len(measures), name
    for key in {key for row in measures for key in row} - NUMBERING:
        values, theirs = ([row.get(key) for row in rows] for rows in (measures, other))
        if any(isinstance(value, str) for value in values):
            assert sorted(map(str, theirs)) == sorted(map(str, values)), (name, key)
        else:
            a, b = (np.sort(np.array(values, dtype=np.float64)) for values in (values, theirs))
            bound = 1e-5 if key in SMOOTH else TABLE_BOUND
            np.testing.assert_allclose(b, a, rtol=bound, atol=1e-6 * np.nanmax(np.abs(a), initial=0), err_msg=key)
