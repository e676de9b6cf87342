"""The study of folds: convergence with the mesh, spread over seeds, slope on thickness; ``run.py bench folds``."""

import json
import math
import re

import numpy as np
import pytest
from made_folds import joined
from made_simulations import MadeRuns, harmonic, made_simulation
from matplotlib.image import imread

from morphofold.errors import MissingPart, NamedTwice, OpenSurface
from morphofold.shapes import even_directions, icosphere
from morphofold.sim import scene as scenes
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.bench import Folds, main
from morphofold.studies.folds import fold_page as fold_page
from morphofold.studies.folds import fold_statistics
from morphofold.studies.folds import fold_study as fold_study
from morphofold.studies.folds.fold_statistics import DIRECTIONS, correlation, line, outer_radius
from morphofold.studies.folds.fold_study import Study, planned, run_study
from morphofold.studies.markdown import read_rows
from morphofold.surface import Surface

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change

BODIES = ("fig6-thin", "fig5", "fig6-thick")

# outer radius and its correlation -----------------------------------------------------------------------------


def test_directions_are_unit_even_and_no_mirror_images_of_each_other():
    d = even_directions(DIRECTIONS)
    assert d.shape == (4000, 3)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(d.T @ d / len(d), np.eye(3) / 3, atol=1e-3)
    assert len(np.unique(np.abs(d).round(9), axis=0)) == 4000


def test_outer_radius_is_exact_at_vertices_and_on_faces():
    verts, faces = icosphere(2, radius=10.0)
    surface = Surface(verts, faces)
    np.testing.assert_allclose(outer_radius(surface, verts / 10), 10, rtol=1e-12)
    a, b, c = (verts[faces[:, k]] for k in range(3))
    plane = np.cross(b - a, c - a)
    centre = a + b + c
    along = centre / np.linalg.norm(centre, axis=1)[:, None]
    want = np.sum(plane * a, axis=1) / np.sum(plane * along, axis=1)
    np.testing.assert_allclose(outer_radius(surface, along), want, rtol=1e-12)


def test_outer_radius_is_the_first_hit_from_outside_however_many_lie_below():
    verts, faces = icosphere(1, radius=10.0)
    shells = joined(*(verts * (1 + k / 100) for k in range(70)), faces=faces)  # more hits than there is room for
    np.testing.assert_allclose(outer_radius(shells, verts / 10), 16.9, rtol=1e-12)


def test_a_surface_that_does_not_enclose_the_origin_is_refused():
    verts, faces = icosphere(2)
    with pytest.raises(OpenSurface, match=r"ball: .*\[-?\d"):
        outer_radius(Surface(verts + 5.0, faces, name="ball"), even_directions(10))


@pytest.mark.parametrize(("m", "angle"), [(3, 0.0), (3, 0.2), (3, math.pi / 6), (5, 0.5), (6, math.pi / 6)])
def test_a_harmonic_of_order_m_turned_by_an_angle_correlates_at_its_cosine(m, angle):
    """<Y cos(m phi), Y cos(m (phi - a))> = cos(m a) on the sphere."""
    verts, faces = icosphere(5, radius=50.0)
    c, s = math.cos(angle), math.sin(angle)
    turned = verts @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # meshes that have nothing in common

    def radius(points):
        surface = Surface(points * (1 + 0.02 * harmonic(verts, 6, m))[:, None], faces)
        return outer_radius(surface, even_directions(DIRECTIONS))

    assert correlation(radius(verts), radius(turned)) == pytest.approx(math.cos(m * angle), abs=5e-3)


def test_a_constant_correlates_with_nothing():
    assert correlation(np.full(5, 2.0), np.arange(5.0)) is None


# lines, meshes, seeds -----------------------------------------------------------------------------------------


def test_a_line_has_the_slope_and_error_of_the_textbook():
    """Residuals 1/6, -1/3, 1/6 about 1.5 x - 2/3: s^2 = 1/6 with one degree of freedom, sum (x - 2)^2 = 2."""
    found = line([1, 2, 3], [1, 2, 4])
    assert found.slope == pytest.approx(1.5)
    assert found.intercept == pytest.approx(-2 / 3)
    assert found.standard_error == pytest.approx(math.sqrt(1 / 12))
    assert found.r == pytest.approx(1.5 * math.sqrt(2 / (14 / 3)))
    assert line([1, 2], [3, 5]).standard_error is None


def fold(scene="fig5", level="draft", seed=0, growth=1.5, **more):
    """A row of folds; wavelengths are 9 T + 1, in theory 8 T, of a film 5 T."""
    T = {"fig6-thin": 1.0, "fig6-thick": 3.0}.get(scene, 2.0)
    return {
        "scene": scene,
        "level": level,
        "seed": seed,
        "edge_mm": 1.0,
        "growth": growth,
        "thickness_mm": T,
        "law": "isotropic",
        "mu_ratio": 2.0,
        "gyrification_index": 1.5,
        "gyri": 40,
        "sulci": 60,
        "wavelength_mm": 9 * T + 1,
        "gyral_thickness_mm": 5 * T,
        "cortical_thickness_mm": 2 * T,
        "theory_wavelength_mm": 8 * T,
        "film_wavelength_mm": 5 * T,
        "note": None,
        **more,
    }


def test_meshes_are_compared_in_pairs_at_the_first_seed():
    rows = [
        fold(level="draft"),
        fold(level="standard", gyrification_index=1.56, gyri=50, wavelength_mm=17.1),
        fold(level="fine", gyri=50, wavelength_mm=None),
        fold(level="standard", seed=1, gyri=7),
    ]
    wave = np.cos(np.arange(8) * np.pi / 4)
    radius = {"draft": wave, "standard": 3 - wave, "fine": 2 * wave}
    radii = {("fig5", level, 0, 1.5): values for level, values in radius.items()}
    first, second = fold_statistics.convergence_rows(rows, radii, ("draft", "standard", "fine"), 0)
    assert (first["coarser"], first["finer"]) == ("draft", "standard")
    assert (second["coarser"], second["finer"]) == ("standard", "fine")
    assert first["correlation"] == pytest.approx(-1)
    assert first["gyrification_index_change_percent"] == pytest.approx(4)
    assert first["gyri_change_percent"] == pytest.approx(25)
    assert first["wavelength_mm_change_percent"] == pytest.approx(-10)
    assert (first["folded"], second["folded"]) == (True, False)
    assert second["wavelength_mm_change_percent"] is None


def test_spread_over_seeds_is_mean_deviation_and_range():
    rows = [fold(seed=k, gyri=n) for k, n in enumerate((40, 44, 48))] + [fold(level="fine", gyri=1000)]
    (row,) = fold_statistics.spread_rows(rows, "draft")
    assert (row["seeds"], row["gyri_mean"], row["gyri_sd"], row["gyri_min"], row["gyri_max"]) == (3, 44, 4, 40, 48)
    assert row["gyrification_index_sd"] == 0


def test_there_is_no_spread_of_what_one_seed_does_not_have():
    rows = [fold(seed=0), fold(seed=1), fold(seed=2, wavelength_mm=None)]
    (row,) = fold_statistics.spread_rows(rows, "draft")
    assert row["wavelength_mm_mean"] is row["wavelength_mm_sd"] is None
    assert row["gyri_mean"] == 40


def test_the_slope_goes_through_three_thicknesses_and_all_seeds():
    off = {0: -0.5, 1: 0.0, 2: 0.5}
    wave = {name: fold(name)["wavelength_mm"] for name in BODIES}
    rows = [fold(name, seed=k, wavelength_mm=wave[name] + d) for name in BODIES for k, d in off.items()]
    rows.append(fold("fig7-ratio1", wavelength_mm=500.0))
    wave, width = fold_statistics.slope_rows(rows)
    assert (wave["number"], width["number"], wave["points"], wave["thicknesses"]) == (
        "wavelength_mm",
        "gyral_thickness_mm",
        9,
        3,
    )
    assert (wave["slope"], wave["intercept"]) == (pytest.approx(9), pytest.approx(1))
    assert wave["standard_error"] == pytest.approx(math.sqrt(1.5 / 7 / 6))  # s^2 = 6 (1/4) / (9 - 2), Sxx = 6
    assert (wave["theory_slope"], wave["film_slope"]) == (pytest.approx(8), pytest.approx(5))
    assert width["slope"] == pytest.approx(5)
    assert width["theory_slope"] is None


def test_there_is_no_line_without_three_bodies_that_are_folded():
    assert fold_statistics.slope_rows([fold("fig6-thin"), fold("fig5")]) == []
    wave, width = fold_statistics.slope_rows([fold(n, wavelength_mm=None if n == "fig5" else 1.0) for n in BODIES])
    assert wave["slope"] is None
    assert wave["theory_slope"] == pytest.approx(8)
    assert width["slope"] == pytest.approx(5)


# the plan -----------------------------------------------------------------------------------------------------


def test_other_seeds_are_grown_at_the_second_finest_level_only():
    runs = planned(Study(("fig5", "fig6-thick"), ("fine", "draft", "standard"), (4, 5, 6), "octant", (1.5, 1.3)))
    asked = [(run.level, run.seed) for run in runs if run.scene == "fig5"]
    assert asked == [("draft", 4), ("standard", 4), ("standard", 5), ("standard", 6), ("fine", 4)]
    assert len({run.name for run in runs}) == len(runs) == 10
    for run in runs:
        scene = load_scene(run.source, run.settings)
        assert (scene.accuracy.level, scene.effects["perturbation"].seed) == (run.level, run.seed)
        assert (scene.geometry.portion, scene.stages) == ("octant", (1.0, 1.3, 1.5))
    assert [run.seed for run in planned(Study(("fig5",), ("fine",), (0, 1), "half", (1.5,)))] == [0, 1]


def test_the_default_study_can_be_planned():
    names = Folds(out="out").scenes.split(",")
    assert len(names) == 10
    runs = planned(Study(tuple(names), ("draft", "standard", "fine"), (0, 1, 2), "octant", (1.3, 2.0)))
    assert len(runs) == 50


@pytest.fixture
def cwd(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--scenes", "fig55", r"'fig55'.* fig5\?"),
        ("--scenes", "fig3", r"fig3: .*'radial'.*\[does-not-apply\]"),
        ("--scenes", "fig5,ellipsoid", r"ellipsoid: .*'ellipsoid'.*\[does-not-apply\]"),
        ("--scenes", "demo", r"demo: .*accuracy\.edge = 1\.97,.*\[options-clash\]"),
        ("--scenes", ",", r"scenes: .*\[nothing-to-do\]"),
        ("--scenes", "fig5,fig5", r"scenes: fig5,fig5 .*\[named-twice\]"),
        ("--levels", "draft,superb", r"levels: 'superb' .* draft, standard, fine\. \[unknown-name\]"),
        ("--levels", ",", r"levels: .*\[nothing-to-do\]"),
        ("--seeds", "0,one", r"--seeds: '0,one' .*\[not-readable\]"),
        ("--seeds", "-1", r"seeds: -1 .*\[out-of-range\]"),
        ("--growth", "1.5,x", r"--growth: '1\.5,x' .*\[not-readable\]"),
        ("--growth", "1.0,1.5", r"growth: 1 .* 4, .*\[out-of-range\]"),
        ("--growth", "nan", r"growth: nan .* 4, .*\[out-of-range\]"),
        ("--growth", "9", r"growth: 9 .* 4, .*\[out-of-range\]"),
        ("--growth", "1.305", r"growth: 1\.305 .*\[out-of-range\]"),
        ("--portion", "third", r"portion: 'third' .* full, half, quarter, octant\. \[unknown-name\]"),
    ],
)
def test_bench_folds_refuses_before_it_writes(cwd, capsys, option, value, words):
    assert main(["folds", "-o", "out", f"{option}={value}"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert re.search(words, captured.err)
    assert list(cwd.iterdir()) == []


def test_a_scene_that_no_seed_changes_is_refused(cwd):
    (cwd / "calm.toml").write_text('name = "calm"\n[geometry]\nportion = "octant"\n')
    with pytest.raises(MissingPart, match=r"calm: .*\[effects\.perturbation\]"):
        planned(Study(("calm.toml",), ("draft",), (0,), "octant", (1.5,)))


def test_two_scenes_of_one_name_are_refused(cwd):
    (cwd / "mine.toml").write_text('like = "fig5"\nname = "fig5"\n')
    with pytest.raises(NamedTwice, match=r"\bfig5\b"):
        planned(Study(("fig5", "mine.toml"), ("draft",), (0,), "octant", (1.5,)))


# a study ------------------------------------------------------------------------------------------------------

ANGLE = {"draft": 0.0, "standard": 0.2}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Made-up runs of three bodies: order 3, turned by 0.2 between the levels; wavelengths 9 T + 1, seeds 0.5 apart."""
    out = tmp_path_factory.mktemp("study")
    asked = Study(BODIES, ("standard", "draft"), (0, 1), "octant", (1.3, 1.5))

    def grow(name, scene, settings):
        turn = ANGLE[load_scene(scene, settings).accuracy.level]

        def wave(g, verts):
            phi = np.arctan2(verts[:, 1], verts[:, 0])
            belt = 1 - (verts[:, 2] / 50) ** 2
            return 2 * (g - 1) * belt**1.5 * np.cos(3 * (phi - turn))

        return made_simulation(out / "simulations" / name, scene, settings, height=wave, warnings=["min J is low"])

    def rows(simulation, show):
        scene = simulation.scene
        seed, level = scene.effects["perturbation"].seed, scene.accuracy.level
        body = fold(scene.name, level, seed)
        body["wavelength_mm"] += 0.5 * seed
        body["gyrification_index"] = 1.5 if level == "draft" else 1.53
        return [{**body, "growth": g} for g in simulation.stages if g > 1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fold_study, "fold_rows", rows)
        summary = run_study(asked, out, MadeRuns(grow))
    return out, summary


def test_a_study_writes_a_row_for_each_run_and_growth(study):
    out, summary = study
    rows = read_rows(out / "folds.tsv")
    assert len(rows) == 3 * 3 * 2
    runs = [("draft", 0), ("draft", 1), ("standard", 0)]
    asked = [(level, seed, g) for level, seed in runs for g in (1.3, 1.5)]
    assert [(r["level"], r["seed"], r["growth"]) for r in rows if r["scene"] == "fig5"] == asked
    assert rows[0]["edge_mm"] == 0.6
    assert {f.name for f in out.iterdir()} == {*summary["files"], "summary.json", "simulations"}
    assert summary["left_out"] == {}
    assert len(summary["warnings"]) == len(summary["simulations"]) == 9
    json.loads((out / "summary.json").read_text(), parse_constant=pytest.fail)


def test_a_study_finds_how_far_the_meshes_are_turned(study):
    rows = read_rows(study[0] / "convergence.tsv")
    assert len(rows) == 3 * 2
    for row in rows:
        assert row["correlation"] == pytest.approx(math.cos(3 * 0.2), abs=0.01)
        assert row["gyrification_index_change_percent"] == pytest.approx(2)


def test_a_study_finds_spread_and_slope(study):
    out, _ = study
    for row in read_rows(out / "spread.tsv"):
        assert row["level"] == "draft"
        assert row["wavelength_mm_sd"] == pytest.approx(0.5 / math.sqrt(2))
    slopes = [r for r in read_rows(out / "slope.tsv") if r["number"] == "wavelength_mm"]
    assert [(r["level"], r["points"]) for r in slopes] == [("draft", 6)] * 2 + [("standard", 3)] * 2
    assert all(r["slope"] == pytest.approx(9) for r in slopes)


def part(page, name):
    return re.search(f"<!-- {name} -->(.*)<!-- /{name} -->", page.read_text(), re.S)[1]


def test_the_page_says_in_words_what_the_tables_hold(study, tmp_path):
    page = tmp_path / "folds.md"
    assert fold_page.write_page(study[0], page) == [str(page), str(tmp_path / "folds.png")]
    assert "At level standard, seed 0; simulated: octant." in part(page, "folds")
    assert "| fig5 | 1.50 | 1.53 | 40 | 60 | 19.0 | 9.50 | 8.00 | 10.0 | 4.00 |" in part(page, "folds")
    words = part(page, "convergence")
    assert "**draft and standard** it correlates at 0.95 or more in 0 of 6 folded stages" in words
    assert "GI changes by 4 % or less in 6, most by +2.0 %" in words
    assert "| 1.50 → 1.53 | +2.0 % | 40 → 40 | 60 → 60 |" in words
    assert "over the 2 seeds 0 and 1, the standard deviation" in part(page, "spread")
    assert "| 19.25 ± 0.35 | 19.00 to 19.50 |" in part(page, "spread")
    words = part(page, "slope")
    assert "9.00 ± 0.00 at g = 1.30 and 9.00 ± 0.00 at g = 1.50 mm (level standard)" in words
    assert "is 8.00, " in words
    assert " 5.00" in words
    assert "(folds.png)" in words
    assert "0 of 9 runs are healthy" in part(page, "runs")
    assert "fig5-octant-draft-seed1`, draft: " in part(page, "runs")
    picture = imread(tmp_path / "folds.png")
    assert picture.shape[0] > 400
    assert picture.std() > 0.02


def test_the_page_is_renewed_between_its_marks_and_nowhere_else(study, tmp_path):
    page = tmp_path / "folds.md"
    fold_page.write_page(study[0], page)
    once = page.read_text()
    page.write_text(once.replace("## Between seeds", "## Between seeds\n\nMine.").replace("| fig5 | 1.50 |", "| old |"))
    fold_page.write_page(study[0], page)
    assert page.read_text() == once.replace("## Between seeds", "## Between seeds\n\nMine.")


def test_a_page_without_marks_is_refused_and_stays_as_it_was(study, tmp_path):
    page = tmp_path / "folds.md"
    page.write_text("<!-- folds -->\n<!-- /folds -->\n")
    with pytest.raises(MissingPart, match=r"folds\.md: .*<!-- convergence -->.*<!-- /convergence -->"):
        fold_page.write_page(study[0], page)
    assert page.read_text() == "<!-- folds -->\n<!-- /folds -->\n"
    assert [p.name for p in tmp_path.iterdir()] == ["folds.md"]


def test_the_page_of_something_else_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"`python3 run\.py bench folds`"):
        fold_page.write_page(tmp_path, tmp_path / "page.md")
    (tmp_path / "summary.json").write_text('{"morphofold": "1", "figures": {}}')
    with pytest.raises(ValueError, match=r"summary\.json: parameters"):
        fold_page.write_page(tmp_path, tmp_path / "page.md")
    assert not (tmp_path / "page.md").exists()


def test_stages_that_are_not_folded_are_told_and_not_judged():
    rows = [fold(level=level, wavelength_mm=None, gyri=None) for level in ("draft", "standard")]
    radii = {("fig5", level, 0, 1.5): np.arange(4.0) for level in ("draft", "standard")}
    summary = {"parameters": {"directions": 4, "levels": ["draft", "standard"], "seeds": [0], "portion": "octant"}}
    compared = fold_statistics.convergence_rows(rows, radii, ("draft", "standard"), 0)
    sentences = fold_page.PARTS["convergence"].sentences(compared, summary)
    assert "Between draft and standard no stage is folded on both." in sentences
    assert "2 of 2 stages of all runs are not folded yet" in fold_page.PARTS["folds"].sentences(rows, summary)


# grown for true -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bench_folds_grows_writes_prints_and_uses_again_what_it_grew(cwd, capsys, monkeypatch):
    monkeypatch.setitem(scenes.LEVELS, "draft", 6.0)  # six edges to a quarter of a great circle
    monkeypatch.setitem(scenes.LEVELS, "standard", 4.5)
    argv = ["folds", "-o", "out", "--scenes", "fig6-thick", "--levels", "standard,draft", "--seeds", "0,3"]
    argv += ["--growth", "1.05,1.1", "-q"]
    assert main(argv) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "no slope.tsv: there is no line through three thicknesses: that takes fig6-thin, fig5" in captured.out
    assert re.search(r"^fig6-thick +1\.10 +draft → standard +[\d.−]+ +1\.0", captured.out, re.M)
    runs = cwd / "out" / "simulations"
    names = {f"fig6-thick-octant-{run}" for run in ("draft-seed0", "draft-seed3", "standard-seed0")}
    assert {p.name for p in runs.iterdir()} == names
    written = {name: (runs / name / "health.json").stat().st_mtime_ns for name in names}
    rows = read_rows(cwd / "out" / "folds.tsv")
    assert all(row["note"].startswith("not folded") for row in rows)
    assert main([*argv[:-5], "--seeds", "0", "--growth", "1.05,1.1", "--json", "-q"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["files"] == ["folds.tsv", "convergence.tsv"]
    assert summary["left_out"]["spread"] == "there is no spread: the only seed is 0"
    assert not (cwd / "out" / "spread.tsv").exists()
    assert {name: (runs / name / "health.json").stat().st_mtime_ns for name in names} == written
    assert read_rows(cwd / "out" / "folds.tsv") == [row for row in rows if row["seed"] == 0]
    page = cwd / "folds.md"
    fold_page.write_page(cwd / "out", page)
    assert "Left out: there is no spread: the only seed is 0." in part(page, "spread")
    assert not (cwd / "folds.png").exists()


def test_flags_of_bench_stand_on_either_side_of_what_is_measured(capsys):
    assert main(["-q", "effects", "--seconds", "0"]) == 2
    assert re.search(r"--seconds .* 3600, .* 0\.0\. \[out-of-range\]", capsys.readouterr().err)
    assert main(["effects", "--seconds", "9999", "--json", "-q"]) == 2
