"""The study of folds: rows of a stage, convergence with the mesh, spread over seeds, slope on thickness, the page."""

import json
import math
import re

import numpy as np
import pytest
from commands import refused
from made_simulations import MadeRuns, harmonic, made_simulation
from matplotlib.image import imread

from morphofold import analysis
from morphofold.shapes import even_directions, icosphere
from morphofold.sim import scene as scenes, theory
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.bench import main
from morphofold.studies.folds import fold_agreement, fold_measures, fold_page, fold_study
from morphofold.studies.folds.fold_agreement import N_DIRECTIONS, correlation, line, outer_radius
from morphofold.studies.folds.fold_pictures import displaced
from morphofold.studies.folds.fold_study import Study, planned, run_study
from morphofold.studies.markdown import read_rows
from morphofold.surface import Cortex, Surface

BODIES = ("fig6-thin", "fig5", "fig6-thick")
STAGES = ["output.stages=[1.0, 1.2, 1.5, 2.0]"]
RMS = {1.0: 0.0, 1.2: 0.19, 1.5: 0.21, 2.0: 2.0}

# rows of the stages of a simulation ---------------------------------------------------------------------------


def waves(g, verts):
    """Degree 8 and order 4, on a sphere that grows."""
    return g - 1 + RMS[g] * harmonic(verts, 8, 4)


@pytest.fixture(scope="module")
def simulation(tmp_path_factory):
    """Waves whose rms grows; T = 2."""
    return made_simulation(tmp_path_factory.mktemp("folds") / "fig5", "fig5", STAGES, height=waves)


@pytest.fixture(scope="module")
def stages(simulation):
    return fold_measures.fold_rows(simulation)


def test_a_row_of_a_stage_has_the_body_the_numbers_of_its_waves_and_the_theory(stages, simulation):
    """cos(4 phi) P_8^4: between its zeros in latitude lie five bands, eight peaks and pits in each pair."""
    assert [row["growth"] for row in stages] == [1.2, 1.5, 2.0]
    exact = theory.bifurcation(2 / 50, 2.0, "isotropic", 50.0)
    for row in stages:
        assert (row["scene"], row["thickness_mm"], row["mu_ratio"], row["law"]) == ("fig5", 2.0, 2.0, "isotropic")
        assert row["height_rms_mm"] == pytest.approx(RMS[row["growth"]], rel=0.01)
        assert (row["theory_g"], row["theory_degree"]) == (exact.g_crit, exact.mode)
        assert row["theory_wavelength_mm"] == pytest.approx(50 * exact.wavelength)
        assert row["film_wavelength_mm"] == pytest.approx(2 * math.pi * 2 * (2 / 3) ** (1 / 3))
    for row in stages[1:]:
        assert row["degree"] == pytest.approx(8, abs=0.05)
        assert row["wavelength_mm"] == pytest.approx(2 * math.pi * 50 / math.sqrt(72), rel=0.01)
        assert row["height_skewness"] == pytest.approx(0, abs=0.01)
        assert row["gyri"] == row["sulci"] == 20
    last = simulation.cortex(2.0)
    assert row["gyrification_index"] == analysis.gyrification_index(last.pial.verts, last.faces)
    assert row["cortical_thickness_mm"] == pytest.approx(3)
    across = analysis.gyral_thickness(last)
    assert row["gyral_thickness_mm"] == across.median or row["note"] == across.reason


def test_what_is_not_folded_has_no_folds_and_says_so(stages):
    first, second, _ = stages
    assert first["note"].startswith("not folded: height rms 0.19 mm is below 0.1 T")
    assert {first[name] for name in ("sulci", "gyri", "degree", "wavelength_mm", "gyral_thickness_mm")} == {None}
    assert first["gyrification_index"] == pytest.approx(1, abs=0.01)
    assert second["wavelength_mm"] is not None


@pytest.mark.parametrize(
    ("log", "expected"),
    [
        ([(1.01, {}), (1.02, {"contact": {"pairs": 0}, "symmetry": {"pressed": 0}})], None),
        ([(1.02, {"contact": {"pairs": 2}}), (1.03, {"contact": {"pairs": 3}})], 1.02),
        ([(1.01, {"contact": {"pairs": 0}}), (1.04, {"symmetry": {"pressed": 1}})], 1.04),
    ],
)
def test_walls_touch_first_where_the_log_has_a_pair_or_a_node_at_a_plane(tmp_path, log, expected):
    rows = [{"growth": g, "effects": effects} for g, effects in log]
    settings = ["output.stages=[1.0, 1.1]", "growth.final=1.1"]
    made = made_simulation(tmp_path / "s", "fig5", settings, log=rows)
    assert fold_measures.fold_rows(made)[0]["first_contact_g"] == expected


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_height_is_weighed_by_area_wherever_the_vertices_are(offset):
    """Height 2 P_2(cos), on an even mesh and on one with finer triangles around a pole: the mean of P_2 over the sphere
    is 0, of its square 1/5, of its cube 2/35."""
    verts, faces = icosphere(4)
    verts = verts + [0.0, 0.0, offset]
    direction = verts / np.linalg.norm(verts, axis=1, keepdims=True)
    sphere, egg = (
        Cortex(
            Surface(0.96 * raised, faces),
            Surface(raised, faces),
            maps={"thickness": np.full(len(raised), 2.0)},
            info={"reference_thickness": 2.0, "health": {"crossings": 0, "deepest_crossing": 0.0}},
        )
        for raised in (50 * direction, direction * (50 + 3 * direction[:, 2:] ** 2 - 1))
    )
    row = fold_measures.fold_measures(sphere, egg)
    assert row["height_rms_mm"] == pytest.approx(2 / 5**0.5, rel=0.01)
    assert row["height_skewness"] == pytest.approx(2 / 35 * 5**1.5, rel=0.02)


def test_every_column_is_explained_or_says_of_which_body_it_is(stages):
    body = {"scene", "level", "portion", "thickness_mm", "T_over_C", "mu_ratio", "kappa_ratio", "law", "growth"}
    assert set(stages[0]) - body - {"note", "deepest_crossing_edges"} == set(fold_measures.COLUMN_TEXTS)


# pictures -----------------------------------------------------------------------------------------------------


def test_displacement_is_measured_from_the_stage_before_growth(tmp_path):
    growing = lambda g, verts: np.full(len(verts), 7 * (g - 1))
    panel = displaced(made_simulation(tmp_path, "fig5", ["output.stages=[1.0, 2.0]"], height=growing), 2.0)
    np.testing.assert_allclose(panel.values, 7, atol=1e-4)
    assert panel.caption == "g = 2.00"
    assert np.linalg.norm(panel.surface.verts, axis=1) == pytest.approx(57, abs=1e-3)


# outer radius and its correlation -----------------------------------------------------------------------------


def test_outer_radius_is_exact_at_vertices_and_on_faces():
    verts, faces = icosphere(2, radius=10.0)
    surface = Surface(verts, faces)
    np.testing.assert_allclose(outer_radius(surface, verts / 10), 10, rtol=1e-12)
    a, b, c = (verts[faces[:, k]] for k in range(3))
    normal, centre = np.cross(b - a, c - a), a + b + c
    along = centre / np.linalg.norm(centre, axis=1)[:, None]
    exact = np.sum(normal * a, axis=1) / np.sum(normal * along, axis=1)
    np.testing.assert_allclose(outer_radius(surface, along), exact, rtol=1e-12)


@pytest.mark.parametrize(("m", "angle"), [(3, 0.0), (3, math.pi / 6), (5, 0.5)])
def test_a_harmonic_of_order_m_turned_by_an_angle_correlates_at_its_cosine(m, angle):
    """<Y cos(m phi), Y cos(m (phi - a))> = cos(m a) on the sphere."""
    verts, faces = icosphere(5, radius=50.0)
    c, s = math.cos(angle), math.sin(angle)
    rotated = verts @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # meshes that have nothing in common

    def radius(points):
        surface = Surface(points * (1 + 0.02 * harmonic(verts, 6, m))[:, None], faces)
        return outer_radius(surface, even_directions(N_DIRECTIONS))

    assert correlation(radius(verts), radius(rotated)) == pytest.approx(math.cos(m * angle), abs=5e-3)


# lines, meshes, seeds -----------------------------------------------------------------------------------------


def test_a_line_has_the_slope_and_error_of_the_textbook():
    """Residuals 1/6, -1/3, 1/6 about 1.5 x - 2/3: s^2 = 1/6 with one degree of freedom, sum (x - 2)^2 = 2."""
    fit = line([1, 2, 3], [1, 2, 4])
    assert (fit.slope, fit.intercept) == (pytest.approx(1.5), pytest.approx(-2 / 3))
    assert fit.standard_error == pytest.approx(math.sqrt(1 / 12))
    assert fit.r == pytest.approx(1.5 * math.sqrt(2 / (14 / 3)))
    assert line([1, 2], [3, 5]).standard_error is None


def fold(scene="fig5", level="draft", seed=0, growth=1.5, **more):
    """A row of folds; wavelengths are 9 T + 1, in theory 8 T, of a film 5 T."""
    T = {"fig6-thin": 1.0, "fig6-thick": 3.0}.get(scene, 2.0)
    body = {"scene": scene, "level": level, "seed": seed, "edge_mm": 1.0, "growth": growth, "thickness_mm": T}
    counts = {"law": "isotropic", "mu_ratio": 2.0, "gyrification_index": 1.5, "gyri": 40, "sulci": 60}
    waves = {"wavelength_mm": 9 * T + 1, "theory_wavelength_mm": 8 * T, "film_wavelength_mm": 5 * T}
    widths = {"gyral_thickness_mm": 5 * T, "cortical_thickness_mm": 2 * T, "note": None}
    return body | counts | waves | widths | more


def test_meshes_are_compared_in_pairs_at_the_first_seed():
    rows = [
        fold(level="draft"),
        fold(level="standard", gyrification_index=1.56, gyri=50, wavelength_mm=17.1),
        fold(level="fine", gyri=50, wavelength_mm=None),
        fold(level="standard", seed=1, gyri=7),
    ]
    wave = np.cos(np.arange(8) * np.pi / 4)
    radii = {("fig5", level, 0, 1.5): r for level, r in zip(("draft", "standard", "fine"), (wave, 3 - wave, 2 * wave))}
    first, second = fold_agreement.convergence_rows(rows, radii, ("draft", "standard", "fine"), 0)
    assert (first["coarser"], first["finer"]) == ("draft", "standard")
    assert (second["coarser"], second["finer"]) == ("standard", "fine")
    assert first["correlation"] == pytest.approx(-1)
    assert first["gyrification_index_change_percent"] == pytest.approx(4)
    assert first["gyri_change_percent"] == pytest.approx(25)
    assert first["wavelength_mm_change_percent"] == pytest.approx(-10)
    assert (first["folded"], second["folded"]) == (True, False)
    assert second["wavelength_mm_change_percent"] is None


def test_spread_over_seeds_is_mean_deviation_and_range_of_what_every_seed_has():
    rows = [fold(seed=k, gyri=n, wavelength_mm=n % 44 or None) for k, n in enumerate((40, 44, 48))]
    (row,) = fold_agreement.spread_rows([*rows, fold(level="fine", gyri=1000)], "draft")
    assert (row["seeds"], row["gyri_mean"], row["gyri_sd"], row["gyri_min"], row["gyri_max"]) == (3, 44, 4, 40, 48)
    assert row["gyrification_index_sd"] == 0
    assert row["wavelength_mm_mean"] is row["wavelength_mm_sd"] is None


def test_the_slope_goes_through_three_thicknesses_and_all_seeds():
    wavelength = {name: fold(name)["wavelength_mm"] for name in BODIES}
    offsets = {0: -0.5, 1: 0.0, 2: 0.5}
    rows = [fold(name, seed=k, wavelength_mm=wavelength[name] + d) for name in BODIES for k, d in offsets.items()]
    wave, width = fold_agreement.slope_rows([*rows, fold("fig7-ratio1", wavelength_mm=500.0)])
    assert (wave["number"], width["number"]) == ("wavelength_mm", "gyral_thickness_mm")
    assert (wave["points"], wave["thicknesses"]) == (9, 3)
    assert (wave["slope"], wave["intercept"]) == (pytest.approx(9), pytest.approx(1))
    assert wave["standard_error"] == pytest.approx(math.sqrt(1.5 / 7 / 6))  # s^2 = 6 (1/4) / (9 - 2), Sxx = 6
    assert (wave["theory_slope"], wave["film_slope"]) == (pytest.approx(8), pytest.approx(5))
    assert (width["slope"], width["theory_slope"]) == (pytest.approx(5), None)


# the plan -----------------------------------------------------------------------------------------------------


def test_other_seeds_are_grown_at_the_second_finest_level_only():
    runs = planned(Study(("fig5", "fig6-thick"), ("fine", "draft", "standard"), (4, 5, 6), "octant", (1.5, 1.3)))
    levels = [(run.level, run.seed) for run in runs if run.scene == "fig5"]
    assert levels == [("draft", 4), ("standard", 4), ("standard", 5), ("standard", 6), ("fine", 4)]
    assert len({run.name for run in runs}) == len(runs) == 10
    for run in runs:
        scene = load_scene(run.scene_source, run.settings)
        assert (scene.accuracy.level, scene.effects["perturbation"].seed) == (run.level, run.seed)
        assert (scene.geometry.portion, scene.stages) == ("octant", (1.0, 1.3, 1.5))
    assert [run.seed for run in planned(Study(("fig5",), ("fine",), (0, 1), "half", (1.5,)))] == [0, 1]


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("--scenes=fig5,ellipsoid", r"ellipsoid: .*'ellipsoid'.*\[does-not-apply\]"),
        ("--scenes=demo", r"demo: .*accuracy\.edge = 1\.97,.*\[options-clash\]"),
        ("--seeds=0,one", r"--seeds: '0,one' .*\[not-readable\]"),
        ("--growth=1.305", r"growth: 1\.305 .*\[out-of-range\]"),
        ("--portion=third", r"third.* --portion.*\[bad-usage\]"),
    ],
)
def test_bench_folds_refuses_before_it_writes(cwd, capsys, option, expected):
    assert re.search(expected, refused(capsys, ["bench", "folds", "-o", "out", option]))
    assert list(cwd.iterdir()) == []


# a study ------------------------------------------------------------------------------------------------------

ANGLE = {"draft": 0.0, "standard": 0.2}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Made-up runs of three bodies: order 3, turned by 0.2 between the levels; wavelengths 9 T + 1, seeds 0.5 apart."""
    out = tmp_path_factory.mktemp("study")

    def grow(name, scene, settings):
        angle = ANGLE[load_scene(scene, settings).accuracy.level]

        def wave(g, verts):
            phi = np.arctan2(verts[:, 1], verts[:, 0])
            return 2 * (g - 1) * (1 - (verts[:, 2] / 50) ** 2) ** 1.5 * np.cos(3 * (phi - angle))

        return made_simulation(out / "simulations" / name, scene, settings, height=wave, warnings=["min J is low"])

    def rows(simulation, show):
        scene = simulation.scene
        seed, level = scene.effects["perturbation"].seed, scene.accuracy.level
        body = fold(scene.name, level, seed, gyrification_index=1.5 if level == "draft" else 1.53)
        body["wavelength_mm"] += 0.5 * seed
        return [{**body, "growth": g} for g in simulation.stages if g > 1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fold_study, "fold_rows", rows)
        summary = run_study(Study(BODIES, ("standard", "draft"), (0, 1), "octant", (1.3, 1.5)), out, MadeRuns(grow))
    return out, summary


def test_a_study_writes_a_row_for_each_run_and_growth_and_how_far_meshes_are_turned(study):
    out, summary = study
    rows = read_rows(out / "folds.tsv")
    assert len(rows) == 3 * 3 * 2
    runs = [("draft", 0), ("draft", 1), ("standard", 0)]
    expected = [(level, seed, g) for level, seed in runs for g in (1.3, 1.5)]
    assert [(r["level"], r["seed"], r["growth"]) for r in rows if r["scene"] == "fig5"] == expected
    assert rows[0]["edge_mm"] == 0.6
    assert {f.name for f in out.iterdir()} == {*summary["files"], "summary.json", "simulations"}
    assert summary["left_out"] == {}
    assert len(summary["warnings"]) == len(summary["simulations"]) == 9
    json.loads((out / "summary.json").read_text(), parse_constant=pytest.fail)
    rows = read_rows(out / "convergence.tsv")
    assert [row["correlation"] for row in rows] == pytest.approx(6 * [math.cos(3 * 0.2)], abs=0.01)


MARKS = "".join(f"## About {name}\n<!-- {name} -->\n<!-- /{name} -->\n" for name in (*fold_page.PARTS, "runs"))


def read_lines(path):
    return path.read_text("utf-8").splitlines()


def part(page, name):
    return re.search(f"<!-- {name} -->(.*)<!-- /{name} -->", page.read_text(), re.S)[1]


def test_the_page_says_in_words_what_the_tables_hold_between_its_marks_and_nowhere_else(study, tmp_path):
    page = tmp_path / "folds.md"
    page.write_text(MARKS)
    assert fold_page.write_page(study[0], page) == [str(page), str(tmp_path / "folds.png")]
    for name, *sentences in (
        ("folds", "At level standard, seed 0; simulated: octant."),
        ("folds", "| fig5 | 1.50 | 1.53 | 40 | 60 | 19.0 | 9.50 | 8.00 | 10.0 | 4.00 |"),
        ("convergence", "**draft and standard** it correlates at 0.95 or more in 0 of 6 folded stages"),
        (
            "convergence",
            "GI changes by 4 % or less in 6, most by +2.0 %",
            "| 1.50 → 1.53 | +2.0 % | 40 → 40 | 60 → 60 |",
        ),
        ("spread", "over the 2 seeds 0 and 1, the standard deviation", "| 19.25 ± 0.35 | 19.00 to 19.50 |"),
        (
            "slope",
            "9.00 ± 0.00 at g = 1.30 and 9.00 ± 0.00 at g = 1.50 mm (level standard)",
            "is 8.00, ",
            "(folds.png)",
        ),
        ("runs", "0 of 9 runs are healthy", "| fig5-octant-standard-seed0 | standard | ", " | min J is low |"),
    ):
        assert all(sentence in part(page, name) for sentence in sentences)
    assert "| fig5 | 1.30 |" not in page.read_text()
    assert [len(read_lines(tmp_path / f"folds-{name}.tsv")) for name in ("folds", "spread", "runs")] == [7, 7, 10]
    image = imread(tmp_path / "folds.png")
    assert image.shape[0] > 400
    assert image.std() > 0.02
    once = page.read_text()
    page.write_text(once.replace("About spread", "My spread").replace("| fig5 | 1.50 |", "| old |"))
    fold_page.write_page(study[0], page)
    assert page.read_text() == once.replace("About spread", "My spread")


@pytest.mark.slow
def test_bench_folds_grows_writes_prints_and_uses_again_what_it_grew(cwd, capsys, monkeypatch):
    monkeypatch.setitem(scenes.LEVELS, "draft", 6.0)  # six edges to a quarter of a great circle
    monkeypatch.setitem(scenes.LEVELS, "standard", 4.5)
    argv = ["folds", "-o", "out", "--scenes", "fig6-thick", "--levels", "standard,draft", "--growth", "1.05,1.1", "-q"]
    assert main([*argv, "--seeds", "0,3"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "no slope.tsv: there is no line through three thicknesses: that takes fig6-thin, fig5" in captured.out
    assert re.search(r"^\| fig6-thick \| 1\.10 \| draft → standard \| [\d.−]+ \| 1\.0", captured.out, re.M)
    runs = cwd / "out" / "simulations"
    names = {f"fig6-thick-octant-{run}" for run in ("draft-seed0", "draft-seed3", "standard-seed0")}
    assert {p.name for p in runs.iterdir()} == names
    written = {name: (runs / name / "health.json").stat().st_mtime_ns for name in names}
    rows = read_rows(cwd / "out" / "folds.tsv")
    assert all(row["note"].startswith("not folded") for row in rows)
    assert main([*argv, "--seeds", "0", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["files"] == ["folds.tsv", "convergence.tsv"]
    assert summary["left_out"]["spread"] == "there is no spread: the only seed is 0"
    assert {name: (runs / name / "health.json").stat().st_mtime_ns for name in names} == written
    assert read_rows(cwd / "out" / "folds.tsv") == [row for row in rows if row["seed"] == 0]
    (cwd / "folds.md").write_text(MARKS)
    fold_page.write_page(cwd / "out", cwd / "folds.md")
    assert "Left out: there is no spread: the only seed is 0." in part(cwd / "folds.md", "spread")
    assert not (cwd / "folds.png").exists()
