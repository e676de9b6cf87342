import csv
import struct
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_simulations import MadeRuns, harmonic, made_simulation

from morphofold.cli.options import FIGURES
from morphofold.report.plots import figure_style, theory_plots
from morphofold.sim import theory
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.theory_tables import bifurcation_cases, outer_ratio
from morphofold.studies import paper
from morphofold.studies.paper import paper_folds
from morphofold.studies.paper import paper_theory as paper_theory

KINDS = sorted(figure_style.FORMATS)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cases():
    """Two thicknesses, two mu ratios, both laws."""
    return bifurcation_cases((2.0, 3.0), 50.0, (1.0, 2.0))


def lines(ax):
    """The curves of an axes by the words of the legend."""
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


def looks(ax):
    """Colour and dashes of every curve in the legend."""
    return [(line.get_color(), str(line._unscaled_dash_pattern)) for line in lines(ax).values()]


def test_figure_3a_is_equation_11():
    left, _ = paper_theory.fig3().axes
    ((label, line),) = lines(left).items()
    g, c = line.get_data()
    assert "theory" in label
    np.testing.assert_allclose(np.asarray(c) ** 3, 1 + np.asarray(g) ** 3 * ((50 / 48) ** 3 - 1), rtol=1e-12)
    assert (g[0], g[-1]) == (1, 2)


def test_figure_3b_has_the_highest_compression_in_the_thinnest_cortex():
    _, right = paper_theory.fig3().axes
    curves = [line.get_data() for line in lines(right).values()]
    assert len(curves) == 3
    for x, sigma in curves:
        assert (x[0], x[-1]) == (0, 1)
        assert max(sigma) < 0
    thin, middle, thick = (np.interp(np.linspace(0, 1, 50), *curve) for curve in curves)
    assert (thin < middle).all()
    assert (middle < thick).all()


def test_figure_3b_ends_in_the_stress_of_a_free_surface():
    """sigma_r = 0 there, so sigma_theta/mu = lambda^2 - lambda^-4 with lambda = c/(g C)."""
    _, right = paper_theory.fig3().axes
    for T, line in zip((1, 2, 3), lines(right).values()):
        C_bar = 50 / (50 - T)
        stretch = (1 + 8 * (C_bar**3 - 1)) ** (1 / 3) / (2 * C_bar)
        assert line.get_ydata()[-1] == pytest.approx(stretch**2 - stretch**-4, rel=1e-12)


def test_figure_4_is_equations_12_and_13():
    (ax,) = paper_theory.fig4().axes
    isotropic, tangential = (np.array(line.get_data()) for line in lines(ax).values())
    C, g = isotropic[:, np.isfinite(isotropic[1])]
    np.testing.assert_allclose(g**3 * (1 - 7 / 12 * C**3), 1, rtol=1e-9)
    assert C[-1] == pytest.approx((12 / 7) ** (1 / 3), abs=1e-3)
    C, g = tangential
    np.testing.assert_allclose(g**3 * C**3 - 2.4 * g**2 * (C**3 - 1), 2.4, rtol=1e-12)
    assert np.isfinite(g).all()


def test_figure_4_marks_the_limits_that_the_paper_names():
    (ax,) = paper_theory.fig4().axes
    words = " ".join(text.get_text() for text in ax.texts)
    assert "1.34" in words
    assert "1.20" in words


@pytest.mark.parametrize("draw", [paper_theory.fig3, paper_theory.fig4])
def test_no_curve_of_the_paper_leaves_its_axes_unannounced(draw):
    for ax in draw().axes:
        low, high = ax.get_ylim()
        for label, line in lines(ax).items():
            y = np.asarray(line.get_ydata())
            assert np.nanmin(y) >= low
            assert np.nanmax(y) <= high or "Eq. (12)" in label  # which has no bound


def test_curves_differ_in_colour_and_in_dashes_too():
    for ax in [*paper_theory.fig3().axes, *paper_theory.fig4().axes]:
        colours, dashes = zip(*looks(ax))
        assert len(set(colours)) == len(set(dashes)) == len(colours)


def test_every_axis_is_labelled(cases):
    of_cases = (theory_plots.bifurcation_curves(cases), theory_plots.crease_or_wrinkle(cases))
    for figure in (paper_theory.fig3(), paper_theory.fig4(), *of_cases):
        assert any(ax.get_ylabel() for ax in figure.axes)
        assert any(ax.get_xlabel() for ax in figure.axes)
        for ax in figure.axes:
            shared = ax.get_shared_x_axes().joined(ax, figure.axes[-1]) or ax.get_shared_y_axes().joined(
                ax, figure.axes[0]
            )
            assert shared or (ax.get_xlabel() and ax.get_ylabel())


def test_curves_mark_the_least_growth_and_the_crease_criterion(cases):
    figure = theory_plots.bifurcation_curves(cases)
    assert len(figure.axes) == 4  # two laws, two mu ratios
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    for case in cases:
        ax = next(a for a, t in zip(figure.axes, titles) if case.law in t and t.endswith(f"= {case.mu_ratio:g}"))
        drawn = [np.array(line.get_data()) for line in ax.get_lines()]
        assert any(np.array_equal(d, [[case.bifurcation.mode], [case.bifurcation.g_crit]]) for d in drawn)
        assert any(d.shape == (2, 2) and (d[1] == case.bifurcation.g_crease).all() for d in drawn)


def test_the_map_draws_wrinkles_and_creases_by_thickness(cases):
    for ax, law in zip(theory_plots.crease_or_wrinkle(cases).axes, theory_plots.GROWTH_LAWS):
        crease, one, two = (np.array(line.get_data()) for line in ax.get_lines()[:3])
        mine = [c for c in cases if c.law == law]
        np.testing.assert_array_equal(one[1], [c.bifurcation.g_crit for c in mine if c.mu_ratio == 1])
        np.testing.assert_array_equal(two[0], [0.04, 0.06])
        assert np.interp(0.04, *crease) == pytest.approx(mine[0].bifurcation.g_crease, rel=1e-5)
        assert crease[1, 0] == pytest.approx(2.4 ** (1 / 3), abs=1e-5)


@pytest.mark.slow
def test_the_map_draws_creases_at_the_compressibility_of_the_wrinkles(cases):
    """They depend on the mu ratio then: the core gives way too."""
    soft = bifurcation_cases((2.0, 3.0), 50.0, (1.0, 2.0), ("tangential",), kappa_ratio=20.0, A_over_C=0.4)
    figure = theory_plots.crease_or_wrinkle(soft)
    drawn = [np.asarray(line.get_ydata()) for line in figure.axes[0].get_lines()]
    for mu_ratio in (1.0, 2.0):
        creases = [c.bifurcation.g_crease for c in soft if c.mu_ratio == mu_ratio]
        assert any(np.array_equal(y, creases) for y in drawn)
        assert creases[0] != pytest.approx(float(theory.critical_growth(50 / 48, "tangential")), rel=1e-3)
    assert figure.get_suptitle() == "$A/C$ = 0.4, $\\kappa/\\mu$ = 20"
    assert theory_plots.crease_or_wrinkle(cases).get_suptitle() == ""


def test_titles_say_every_parameter_that_is_not_the_papers():
    figure = theory_plots.stress_figure(1.5, (2.0,), 40.0, g_core=1.1, mu_ratio=3.0, A_over_C=0.5)
    assert figure.get_suptitle() == (
        "$C$ = 40 mm, $g_\\mathrm{core}$ = 1.1, $\\mu_\\mathrm{cortex}/\\mu_\\mathrm{core}$ = 3"
    )
    assert theory_plots.stress_figure().get_suptitle() == ""


def test_shortest_waves_have_their_own_mark_in_both_figures():
    cases = bifurcation_cases((2.0,), 50.0, (0.1, 2.0), ("isotropic",))
    for figure, mark in ((theory_plots.crease_or_wrinkle(cases), "^"), (theory_plots.bifurcation_curves(cases), ">")):
        marks = [line for ax in figure.axes for line in ax.get_lines() if line.get_marker() == mark]
        assert any(cases[0].bifurcation.g_crit in line.get_ydata() for line in marks)
        assert "shortest waves first" in words_of(figure)


def test_a_panel_says_where_no_wrinkles_were_found(cases):
    nan = float("nan")
    stable = replace(cases[0].bifurcation, g_crit=nan, mode=nan, reason="stable")
    some = [replace(cases[0], bifurcation=stable), *cases[1:]]
    for draw in (theory_plots.crease_or_wrinkle, theory_plots.bifurcation_curves):
        texts = [text.get_text() for ax in draw(some).axes for text in ax.texts]
        assert len(texts) == 1
        assert "no wrinkles\nfound up to $g$ = 10, $T/C$ = 0.04" in texts[0]
        assert not any(ax.texts for ax in draw(cases).axes)


def test_first_wrinkles_are_within_the_axes(cases):
    late = [replace(cases[0], bifurcation=replace(cases[0].bifurcation, g_crit=2.3)), *cases[1:]]
    for draw in (theory_plots.crease_or_wrinkle, theory_plots.bifurcation_curves):
        assert draw(late).axes[0].get_ylim()[1] >= 2.3


def words_of(figure):
    """The legend under the panels."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_a_map_of_one_thickness_has_its_marks_in_the_legend(cases):
    figure = theory_plots.crease_or_wrinkle([case for case in cases if case.thickness == 2])
    marks = [handle.get_marker() for handle in figure.legends[0].legend_handles]
    assert marks == ["None", "o", "o"]


def dots(ax):
    """The points drawn as dots, (2, n)."""
    return np.concatenate([line.get_data() for line in ax.get_lines() if line.get_linestyle() == "None"], axis=1)


def test_growths_asked_for_are_dots_on_a_curve_of_a_sensible_range():
    (ax,) = theory_plots.radius_figure([1.5, 2.5]).axes
    ((_, curve),) = lines(ax).items()
    assert (curve.get_xdata()[0], curve.get_xdata()[-1]) == (1, 2.5)
    g, c = dots(ax)
    np.testing.assert_array_equal(g, [1.5, 2.5])
    np.testing.assert_allclose(c**3, 1 + g**3 * ((50 / 48) ** 3 - 1), rtol=1e-12)


def test_ratios_asked_for_are_dots_where_a_crease_forms_and_the_axes_reach():
    (ax,) = theory_plots.critical_figure([1.1, 1.19, 1.25], ["isotropic"]).axes
    np.testing.assert_allclose(dots(ax), [[1.1], theory.critical_growth([1.1])], rtol=1e-12)
    assert ax.get_xlim() == (1, 1.3)


@pytest.mark.parametrize("growth", [1.0, 1.01, 1.3, 2.0, 5.0])
def test_limits_of_the_stress_follow_the_stress_in_round_steps(growth):
    (ax,) = theory_plots.stress_figure(growth).axes
    low, high = ax.get_ylim()
    sigma = np.concatenate([line.get_ydata() for line in lines(ax).values()])
    assert high == 0
    assert low <= sigma.min() <= (0.6 * low if growth > 1 else 0)


def test_what_is_not_found_has_its_reason(cases):
    nan, inf = float("nan"), float("inf")
    whole = cases[0].bifurcation
    assert cases[0].row()["reason"] is None
    for change, reason in (
        ({"g_crit": nan, "mode": nan, "creasing_amplitude": nan, "reason": "stable"}, "stable"),
        ({"mode": inf}, "their degree has no bound"),
        ({"creasing_amplitude": nan}, "these wrinkles live on the interface: no creasing amplitude"),
        ({"g_crease": nan}, "no crease found up to g = 10, or as far as the smooth state could be followed"),
    ):
        assert replace(cases[0], bifurcation=replace(whole, **change)).row()["reason"].endswith(reason)


@pytest.mark.parametrize(
    ("wrinkle", "crease", "first"),
    [
        (1.2, 1.4, "wrinkle"),
        (1.4, 1.2, "crease"),
        (1.2, np.nan, "wrinkle"),
        (np.nan, 1.2, "crease"),
        (np.nan, np.nan, None),
    ],
)
def test_a_row_says_what_needs_the_least_growth(cases, wrinkle, crease, first):
    found = replace(cases[0].bifurcation, g_crit=wrinkle, g_crease=crease)
    assert replace(cases[0], bifurcation=found).row()["first"] == first


def test_a_cortex_as_thick_as_the_sphere_is_refused():
    assert outer_ratio(2, 50) == pytest.approx(50 / 48)
    for thickness in (0, -1, 50, np.nan):
        with pytest.raises(ValueError, match=rf"thickness .* 0 .* 50 mm, .* {thickness:g} mm"):
            outer_ratio(thickness, 50)


def test_no_case_is_no_figure():
    with pytest.raises(ValueError, match="no case to draw"):
        theory_plots.crease_or_wrinkle([])


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_figure_is_the_same_file(tmp_path, kind):
    for name in ("a", "b"):
        figure_style.save(paper_theory.fig4(), tmp_path / f"{name}{kind}")
    first = (tmp_path / f"a{kind}").read_bytes()
    assert first == (tmp_path / f"b{kind}").read_bytes()
    assert b"Date" not in first


def test_a_figure_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"picture\.bmp: .* \.png, \.svg, \.pdf"):
        figure_style.save(paper_theory.fig4(), tmp_path / "picture.bmp")
    assert list(tmp_path.iterdir()) == []


def test_figures_heed_neither_nor_change_the_users_settings(tmp_path):
    import matplotlib

    figure_style.save(paper_theory.fig4(), tmp_path / "plain.png")
    with matplotlib.rc_context({"axes.linewidth": 9, "font.family": "monospace", "xtick.major.size": 20}):
        before = {key: value for key, value in matplotlib.rcParams.items() if key != "backend"}
        figure_style.save(paper_theory.fig4(), tmp_path / "mine.png")
        assert {key: matplotlib.rcParams[key] for key in before} == before
    assert (tmp_path / "mine.png").read_bytes() == (tmp_path / "plain.png").read_bytes()


def test_drawing_needs_no_window_and_no_global_state():
    code = (
        "import sys; from morphofold.studies.paper import theory as paper_theory; paper_theory.fig4(); "
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_command_knows_the_figures_that_can_be_drawn():
    assert list(FIGURES) == list(paper.REPRODUCTIONS)


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


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


@pytest.mark.parametrize(
    ("table", "draw", "panel", "y"),
    [
        ("fig3a", paper_theory.fig3, 0, "c_over_B"),
        ("fig3b", paper_theory.fig3, 1, "sigma_theta_over_mu_cortex"),
        ("fig4", paper_theory.fig4, 0, "g_crease"),
    ],
)
def test_the_table_holds_the_points_of_the_panel(reproduced, table, draw, panel, y):
    rows = [row for row in rows_of(reproduced[0] / f"{table}.tsv") if row["source"] == "theory"]
    drawn = np.concatenate([line.get_ydata() for line in lines(draw().axes[panel]).values()])
    np.testing.assert_allclose([np.nan if r[y] == "n/a" else float(r[y]) for r in rows], drawn, rtol=1e-6)


def test_an_entry_names_the_files_that_are_written(reproduced):
    folder, entries = reproduced
    for entry in entries.values():
        assert all((folder / file).is_file() for file in entry["files"])
    names = [simulation["scene"] for simulation in entries["fig3"]["simulations"]]
    assert names == ["fig3", "fig3-thin", "fig3-thick", "fig7-ratio1"]


def test_radial_elements_of_figure_3_lie_on_the_theory(reproduced):
    radius, stress = (
        [row for row in rows_of(reproduced[0] / f"fig3{panel}.tsv") if row["source"] == paper_theory.ONE_D]
        for panel in "ab"
    )
    assert [float(row["growth"]) for row in radius] == pytest.approx(np.arange(1.1, 2.05, 0.1))
    assert {row["thickness_mm"] for row in stress} == {"1", "2", "3"}
    for row in radius:
        wanted = theory.deformed_radius(float(row["growth"]), 50 / 48)
        assert float(row["c_over_B"]) == pytest.approx(wanted, rel=1e-4)
        assert float(row["over_theory"]) == pytest.approx(float(row["c_over_B"]) / wanted - 1, abs=1e-6)
    for row in stress:
        assert abs(float(row["over_theory"])) < 5e-3


def test_the_stress_of_a_row_is_compared_at_its_own_place(reproduced):
    for row in rows_of(reproduced[0] / "fig3b.tsv"):
        if row["source"] == paper_theory.ONE_D:
            B, C, R = 50 - float(row["thickness_mm"]), 50.0, float(row["R_mm"])
            at = theory.stresses(2.0, B, C, n=4001)
            there = np.interp(B * theory.deformed_radius(2.0, C / B, R_bar=R / B), at.r, at.sigma_theta)
            ratio = float(row["sigma_theta_over_mu_cortex"]) / there
            assert ratio - 1 == pytest.approx(float(row["over_theory"]), abs=1e-5)


def test_a_radius_in_three_dimensions_is_a_mean_and_says_if_the_sphere_is_folded(reproduced):
    rows = [row for row in rows_of(reproduced[0] / "fig3a.tsv") if row["source"] == paper_theory.THREE_D]
    assert [float(row["growth"]) for row in rows] == list(paper_theory.SOLID[1:])
    assert [row["folded"] for row in rows] == ["0"] * 8 + ["1"]
    for row in rows:
        assert float(row["over_theory"]) == pytest.approx(1e-3, abs=2e-5)
    assert float(rows[5]["over_1d"]) == pytest.approx(1e-3 + 2.87e-4, abs=3e-5)  # kappa/mu 50 gives way by 0.0287 %


def test_elements_of_figure_3_are_drawn_where_the_table_says():
    row = {"source": paper_theory.THREE_D, "folded": True, "growth": 1.5, "c_over_B": 1.11}
    left, right = paper_theory.fig3(([row], [])).axes
    drawn = lines(left)["3-D, folded: mean"]
    assert (list(drawn.get_xdata()), list(drawn.get_ydata())) == ([1.5], [1.11])
    assert len(lines(right)) == 3


def test_ten_curves_are_told_apart():
    (ax,) = theory_plots.stress_figure(2.0, range(1, 11)).axes
    assert len(set(looks(ax))) == 10


# folds -------------------------------------------------------------------------------------------------------


def waves(g, verts):
    return 5 * (g - 1) + 3 * (g - 1) * harmonic(verts, 10, 4)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """What figures ask of simulations, and simulations made up for them."""
    monkeypatch.setattr(paper_folds, "STAGES", (1.0, 1.5, 2.0))
    for name in ("FIG6", "FIG7"):
        columns = [replace(column, growth=(1.5, 1.5, 2.0)) for column in getattr(paper_folds, name)]
        monkeypatch.setattr(paper_folds, name, columns)
    monkeypatch.setattr(paper_folds, "FIG5", ((1.5, 1.5, 1.5), (1.5, 1.5, 2.0)))
    asked, there = {}, {}

    def grow(name, scene, settings):
        if name not in asked:
            asked[name] = (scene, tuple(settings))
            folder, warnings = tmp_path / "simulations" / name, ["too hot"] if "thick" in name else []
            there[name] = made_simulation(folder, scene, settings, height=waves, warnings=warnings)
        return there[name]

    return asked, MadeRuns(grow)


@pytest.mark.slow
@pytest.mark.parametrize(("figure", "scenes"), [("fig5", ["fig5"]), ("fig6", ["fig6-thin", "fig5", "fig6-thick"])])
def test_a_figure_of_folds_has_a_picture_and_a_row_per_body_and_stage(made, tmp_path, figure, scenes):
    asked, runs = made
    entry = paper.REPRODUCTIONS[figure](tmp_path, runs)
    assert {name: scene for name, (scene, _) in asked.items()} == {name: name for name in scenes}
    assert all(f"output.stages={list(paper_folds.STAGES)}" in settings for _, settings in asked.values())
    assert entry["files"] == [f"{figure}.png", f"{figure}.tsv"]
    assert runs.shown == [f"measure the folds of {scene}" for scene in scenes]
    paper.REPRODUCTIONS["fig7"](tmp_path, runs)  # fig5 is measured once for all figures
    assert runs.shown[len(scenes) :] == [f"measure the folds of fig7-ratio{r}" for r in (1, 4)]
    rows = rows_of(tmp_path / f"{figure}.tsv")
    assert [(row["scene"], float(row["growth"])) for row in rows] == [
        (scene, g) for scene in scenes for g in paper_folds.STAGES[1:]
    ]
    width, height = struct.unpack(">II", (tmp_path / f"{figure}.png").read_bytes()[16:24])
    assert width > 1200
    assert height > 800
    warned = [simulation["warnings"] for simulation in entry["simulations"] if simulation["warnings"]]
    assert warned == ([["too hot"]] if figure == "fig6" else [])
    assert {simulation["healthy"] for simulation in entry["simulations"]} == (
        {True, False} if figure == "fig6" else {True}
    )


def test_a_draft_grows_only_to_what_is_drawn(made, monkeypatch):
    asked, runs = made
    monkeypatch.setattr(paper_folds, "STAGES", (1.0, 1.25, 1.5, 1.75, 2.0))
    runs.draft = True
    paper_folds.grown("fig6-thin", runs)
    assert "output.stages=[1.0, 1.5, 2.0]" in asked["fig6-thin"][1]


def test_every_growth_that_is_shown_is_a_stage():
    shown = [g for row in paper_folds.FIG5 for g in row]
    shown += [g for column in (*paper_folds.FIG6, *paper_folds.FIG7) for g in column.growth]
    assert set(shown) <= set(paper_folds.STAGES)
    assert paper_folds.STAGES[0] == 1
    assert paper_folds.drawn_stages("fig6-thin") == (1, 1.25, 1.6, 2)
    assert set(paper_folds.drawn_stages("fig5")) == {1, *(g for row in paper_folds.FIG5 for g in row)}


@pytest.mark.parametrize("twin", ["fig6-normal", "fig7-ratio2"])
def test_the_middle_columns_are_the_body_of_figure_5(twin):
    fig5, other = load_scene("fig5"), load_scene(twin)
    for part in ("geometry", "material", "growth", "effects", "accuracy"):
        assert getattr(fig5, part) == getattr(other, part)


def test_figure_7_is_drawn_from_its_columns(made, tmp_path, monkeypatch):
    asked, runs = made
    monkeypatch.setattr(paper_folds, "FIG7", paper_folds.FIG7[:1])
    assert paper.REPRODUCTIONS["fig7"](tmp_path, runs)["files"] == ["fig7.png", "fig7.tsv"]
    assert list(asked) == ["fig7-ratio1"]


def test_columns_differ_as_the_paper_says():
    thin, normal, thick = (load_scene(column.scene) for column in paper_folds.FIG6)
    assert [s.geometry.cortex_thickness / s.geometry.radius for s in (thin, normal, thick)] == [0.02, 0.04, 0.06]
    assert {s.material.mu_ratio for s in (thin, normal, thick)} == {2.0}
    soft, middle, stiff = (load_scene(column.scene) for column in paper_folds.FIG7)
    assert [s.material.mu_ratio for s in (soft, middle, stiff)] == [1.0, 2.0, 4.0]
    assert {s.geometry.cortex_thickness for s in (soft, middle, stiff)} == {2.0}


@pytest.mark.parametrize("column", [*paper_folds.FIG6, *paper_folds.FIG7], ids=lambda column: column.scene)
def test_the_first_picture_comes_soon_after_the_first_wrinkles(column):
    scene = load_scene(column.scene)
    T_over_C = scene.geometry.cortex_thickness / scene.geometry.radius
    assert 0 < column.growth[0] - theory.bifurcation(T_over_C, scene.material.mu_ratio, kappa_ratio=50).g_crit < 0.06
