"""Figs. 3 to 7: curves of the equations, elements beside them, folds of bodies made up."""

import csv
import struct
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from made_simulations import MadeRuns, harmonic, made_simulation

from morphofold.report.plots import figure_style, theory_plots
from morphofold.results.theory_tables import bifurcation_cases
from morphofold.sim import theory
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import paper
from morphofold.studies.paper import paper_folds, paper_theory


def lines(ax):
    """The curves of an axes by their labels in the legend."""
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


def read_rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


# wrinkles and creases -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cases():
    """Two thicknesses, two mu ratios, both laws."""
    return bifurcation_cases((2.0, 3.0), 50.0, (1.0, 2.0))


@pytest.mark.slow
def test_curves_mark_the_least_growth_and_the_crease_criterion(cases):
    figure = theory_plots.bifurcation_curves(cases)
    assert len(figure.axes) == 4  # two laws, two mu ratios
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    for case in cases:
        ax = next(a for a, t in zip(figure.axes, titles) if case.law in t and t.endswith(f"= {case.mu_ratio:g}"))
        plotted = [np.array(line.get_data()) for line in ax.get_lines()]
        assert any(np.array_equal(d, [[case.bifurcation.mode], [case.bifurcation.g_crit]]) for d in plotted)
        assert any(d.shape == (2, 2) and (d[1] == case.bifurcation.g_crease).all() for d in plotted)


@pytest.mark.slow
def test_the_map_draws_wrinkles_and_creases_by_thickness(cases):
    for ax, law in zip(theory_plots.crease_or_wrinkle(cases).axes, theory_plots.GROWTH_LAWS):
        crease, *wrinkles = (np.array(line.get_data()) for line in ax.get_lines()[:3])
        of_law = [c for c in cases if c.law == law]
        np.testing.assert_array_equal(wrinkles[0][1], [c.bifurcation.g_crit for c in of_law if c.mu_ratio == 1])
        np.testing.assert_array_equal(wrinkles[1][0], [0.04, 0.06])
        assert np.interp(0.04, *crease) == pytest.approx(of_law[0].bifurcation.g_crease, rel=1e-5)
        assert crease[1, 0] == pytest.approx(2.4 ** (1 / 3), abs=1e-5)


@pytest.mark.slow
def test_the_map_draws_creases_at_the_compressibility_of_the_wrinkles(cases):
    """They depend on the mu ratio then: the core gives way too."""
    soft = bifurcation_cases((2.0, 3.0), 50.0, (1.0, 2.0), ("tangential",), kappa_ratio=20.0, A_over_C=0.4)
    figure = theory_plots.crease_or_wrinkle(soft)
    plotted = [np.asarray(line.get_ydata()) for line in figure.axes[0].get_lines()]
    for mu_ratio in (1.0, 2.0):
        creases = [c.bifurcation.g_crease for c in soft if c.mu_ratio == mu_ratio]
        assert any(np.array_equal(y, creases) for y in plotted)
        assert creases[0] != pytest.approx(float(theory.critical_growth(50 / 48, "tangential")), rel=1e-3)
    assert figure.get_suptitle() == "$A/C$ = 0.4, $\\kappa/\\mu$ = 20"
    assert theory_plots.crease_or_wrinkle(cases).get_suptitle() == ""


@pytest.mark.slow
def test_a_row_has_a_reason_for_what_is_missing_and_says_what_needs_the_least_growth(cases):
    nan = float("nan")
    assert cases[0].row()["reason"] is None
    for change, expected in (
        ({"g_crit": nan, "mode": nan, "creasing_amplitude": nan, "reason": "stable"}, {"reason": "stable"}),
        ({"mode": float("inf")}, {"reason": "the shortest waves come first: their degree has no bound"}),
        ({"g_crit": 1.2, "g_crease": 1.4}, {"first": "wrinkle"}),
        ({"g_crit": 1.4, "g_crease": 1.2}, {"first": "crease"}),
        ({"g_crit": nan, "g_crease": 1.2}, {"first": "crease"}),
        ({"g_crit": nan, "g_crease": nan}, {"first": None}),
    ):
        row = replace(cases[0], bifurcation=replace(cases[0].bifurcation, **change)).row()
        assert {name: row[name] for name in expected} == expected


@pytest.mark.parametrize("kind", sorted(figure_style.FORMATS))
def test_the_same_figure_is_the_same_file_whatever_the_users_settings(tmp_path, kind):
    figure_style.save(paper_theory.fig4(), tmp_path / f"a{kind}")
    with matplotlib.rc_context({"axes.linewidth": 9, "font.family": "monospace", "xtick.major.size": 20}):
        before = {key: value for key, value in matplotlib.rcParams.items() if key != "backend"}
        figure_style.save(paper_theory.fig4(), tmp_path / f"b{kind}")
        assert {key: matplotlib.rcParams[key] for key in before} == before
    first = (tmp_path / f"a{kind}").read_bytes()
    assert first == (tmp_path / f"b{kind}").read_bytes()
    assert b"Date" not in first


# Figs. 3 and 4 ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """The folder of Figs. 3 and 4, the sphere in three dimensions made up: g c/C is 0.1 % too large, folded at 1.6."""
    folder = tmp_path_factory.mktemp("figures")

    def grow(name, scene, settings):
        def height(g, verts):
            smooth = 1.001 * float(theory.deformed_radius(g, 50 / 48)) * 48 - 50 if g > 1 else 0.0
            return smooth + (0.5 if g == 1.6 else 0.01) * harmonic(verts, 12, 5)

        return made_simulation(folder / name, scene, settings, height=height)

    return folder, {name: paper.REPRODUCTIONS[name](folder, MadeRuns(grow)) for name in ("fig3", "fig4")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "draw", "panel", "y"),
    [
        ("fig3a", paper_theory.fig3, 0, "c_over_B"),
        ("fig3b", paper_theory.fig3, 1, "sigma_theta_over_mu_cortex"),
        ("fig4", paper_theory.fig4, 0, "g_crease"),
    ],
)
def test_the_table_holds_the_points_of_the_panel(reproduced, table, draw, panel, y):
    rows = [row for row in read_rows(reproduced[0] / f"{table}.tsv") if row["source"] == "theory"]
    plotted = np.concatenate([line.get_ydata() for line in lines(draw().axes[panel]).values()])
    np.testing.assert_allclose([np.nan if r[y] == "n/a" else float(r[y]) for r in rows], plotted, rtol=1e-6)


@pytest.mark.slow
def test_radial_elements_of_figure_3_lie_on_the_theory(reproduced):
    """Stresses are compared at their own radius."""
    radius, stress = (
        [row for row in read_rows(reproduced[0] / f"fig3{panel}.tsv") if row["source"] == paper_theory.ONE_D]
        for panel in "ab"
    )
    assert [float(row["growth"]) for row in radius] == pytest.approx(np.arange(1.1, 2.05, 0.1))
    for row in radius:
        exact = theory.deformed_radius(float(row["growth"]), 50 / 48)
        assert float(row["c_over_B"]) == pytest.approx(exact, rel=1e-4)
        assert float(row["over_theory"]) == pytest.approx(float(row["c_over_B"]) / exact - 1, abs=1e-6)
    assert {row["thickness_mm"] for row in stress} == {"1", "2", "3"}
    for row in stress:
        B, C, R = 50 - float(row["thickness_mm"]), 50.0, float(row["R_mm"])
        curve = theory.stresses(2.0, B, C, n=4001)
        exact = np.interp(B * theory.deformed_radius(2.0, C / B, R_bar=R / B), curve.r, curve.sigma_theta)
        assert float(row["sigma_theta_over_mu_cortex"]) / exact - 1 == pytest.approx(
            float(row["over_theory"]), abs=1e-5
        )
        assert abs(float(row["over_theory"])) < 5e-3


@pytest.mark.slow
def test_a_radius_in_three_dimensions_is_a_mean_and_says_if_the_sphere_is_folded(reproduced):
    rows = [row for row in read_rows(reproduced[0] / "fig3a.tsv") if row["source"] == paper_theory.THREE_D]
    assert [float(row["growth"]) for row in rows] == list(paper_theory.SOLID_GROWTHS[1:])
    assert [row["folded"] for row in rows] == ["0"] * 8 + ["1"]
    for row in rows:
        assert float(row["over_theory"]) == pytest.approx(1e-3, abs=2e-5)
    assert float(rows[5]["over_1d"]) == pytest.approx(1e-3 + 2.87e-4, abs=3e-5)  # kappa/mu 50 gives way by 0.0287 %


# folds --------------------------------------------------------------------------------------------------------


def waves(g, verts):
    return 5 * (g - 1) + 3 * (g - 1) * harmonic(verts, 10, 4)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Scene and settings of each simulation that figures ask for, by name; and the runs, made up for them."""
    monkeypatch.setattr(paper_folds, "STAGE_GROWTHS", (1.0, 1.5, 2.0))
    for name in ("FIG6", "FIG7"):
        columns = [replace(column, growths=(1.5, 1.5, 2.0)) for column in getattr(paper_folds, name)]
        monkeypatch.setattr(paper_folds, name, columns)
    monkeypatch.setattr(paper_folds, "FIG5", ((1.5, 1.5, 1.5), (1.5, 1.5, 2.0)))
    scenes, simulations = {}, {}

    def grow(name, scene, settings):
        if name not in scenes:
            scenes[name] = (scene, tuple(settings))
            folder, warnings = tmp_path / "simulations" / name, ["too hot"] if "thick" in name else []
            simulations[name] = made_simulation(folder, scene, settings, height=waves, warnings=warnings)
        return simulations[name]

    return scenes, MadeRuns(grow)


@pytest.mark.slow
@pytest.mark.parametrize(("figure", "bodies"), [("fig5", ["fig5"]), ("fig6", ["fig6-thin", "fig5", "fig6-thick"])])
def test_a_figure_of_folds_has_a_picture_and_a_row_per_body_and_stage(made, tmp_path, figure, bodies):
    scenes, runs = made
    entry = paper.REPRODUCTIONS[figure](tmp_path, runs)
    assert {name: scene for name, (scene, _) in scenes.items()} == {name: name for name in bodies}
    assert all(f"output.stages={list(paper_folds.STAGE_GROWTHS)}" in settings for _, settings in scenes.values())
    assert entry["files"] == [f"{figure}.png", f"{figure}.tsv"]
    assert runs.shown == [f"measure the folds of {body}" for body in bodies]
    paper.REPRODUCTIONS["fig7"](tmp_path, runs)  # fig5 is measured once for all figures
    assert runs.shown[len(bodies) :] == [f"measure the folds of fig7-ratio{r}" for r in (1, 4)]
    rows = [(row["scene"], float(row["growth"])) for row in read_rows(tmp_path / f"{figure}.tsv")]
    assert rows == [(body, g) for body in bodies for g in paper_folds.STAGE_GROWTHS[1:]]
    width, height = struct.unpack(">II", (tmp_path / f"{figure}.png").read_bytes()[16:24])
    assert width > 1200
    assert height > 800
    warnings = {simulation["scene"]: simulation["warnings"] for simulation in entry["simulations"]}
    assert warnings == {body: ["too hot"] if "thick" in body else [] for body in bodies}


def test_a_draft_grows_only_to_what_is_drawn(made, monkeypatch):
    scenes, runs = made
    monkeypatch.setattr(paper_folds, "STAGE_GROWTHS", (1.0, 1.25, 1.5, 1.75, 2.0))
    runs.draft = True
    paper_folds.grow_scene("fig6-thin", runs)
    assert "output.stages=[1.0, 1.5, 2.0]" in scenes["fig6-thin"][1]


def test_every_growth_that_is_drawn_is_a_stage():
    growths = [g for row in paper_folds.FIG5 for g in row]
    growths += [g for column in (*paper_folds.FIG6, *paper_folds.FIG7) for g in column.growths]
    assert set(growths) <= set(paper_folds.STAGE_GROWTHS)
    assert paper_folds.drawn_stages("fig6-thin") == (1, 1.25, 1.6, 2)


@pytest.mark.slow
@pytest.mark.parametrize("column", [*paper_folds.FIG6, *paper_folds.FIG7], ids=lambda column: column.scene)
def test_the_first_picture_comes_soon_after_the_first_wrinkles(column):
    scene = load_scene(column.scene)
    T_over_C = scene.geometry.cortex_thickness / scene.geometry.radius
    assert 0 < column.growths[0] - theory.bifurcation(T_over_C, scene.material.mu_ratio, kappa_ratio=50).g_crit < 0.06
