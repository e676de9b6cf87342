import json
import re

import numpy as np
import pytest

from morphofold.cli import main
from morphofold.cli.command_options import range_values
from morphofold.results import theory_tables
from morphofold.sim import theory
from morphofold.sim.build import build_bilayer
from morphofold.sim.equilibrium import statics
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.sphere_theory import smooth_sphere, wrinkling

OCTANT = ["--body", "demo", "--set", "geometry.portion=octant", "--set", "accuracy.edge=8"]
STRIP = ["--body", "strip", "--set", "geometry.length=22", "--set", "accuracy.edge=1.25"]
STRIP += ["--set", "accuracy.elements_through_cortex=2"]


def answer_of(capsys, *arguments):
    """The answer to a question as strict JSON."""
    assert main(["theory", *arguments, "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return json.loads(captured.out, parse_constant=pytest.fail)


def table(capsys, *arguments):
    """The answer as printed: words before the table, then one list of cells per row."""
    assert main(["theory", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("law "))
    return " ".join(lines[:start]), [line.split() for line in lines[start + 1 :]]


def test_radius_prints_equation_11_for_the_papers_sphere(capsys):
    heading, rows = table(capsys, "radius")
    assert "T = 2 mm, C = 50 mm" in heading
    _, g, *radii = np.array(rows).T
    assert g.tolist() == [f"{1 + i / 10:.4f}" for i in range(11)]
    c_over_B = (1 + g.astype(float) ** 3 * ((50 / 48) ** 3 - 1)) ** (1 / 3)
    np.testing.assert_allclose(np.array(radii, dtype=float), [c_over_B, c_over_B * 48 / 50], atol=1e-6)


def test_stress_is_continuous_and_vanishes_outside_whatever_the_mu_ratio(capsys):
    arguments = ("--mu-ratio", "3", "--points", "5", "--law", "both", "--thickness", "1", "4")
    rows = answer_of(capsys, "stress", *arguments)["rows"]
    assert len(rows) == 2 * 2 * 2 * 5
    for core, cortex in zip(*(rows[i::10] for i in (4, 5))):
        assert (core["layer"], core["position"], cortex["layer"], cortex["position"]) == ("core", 1, "cortex", 0)
        assert core["sigma_r_over_mu_core"] == pytest.approx(cortex["sigma_r_over_mu_core"], rel=1e-12)
    for row in rows[9::10]:
        assert row["sigma_r_over_mu_core"] == 0
        stretch = row["r_mm"] / (2 * row["R_mm"])
        assert row["sigma_theta_over_mu_cortex"] == pytest.approx(stretch**2 - stretch**-4, rel=1e-12)
        assert row["sigma_theta_over_mu_core"] == pytest.approx(3 * row["sigma_theta_over_mu_cortex"], rel=1e-12)


def test_critical_says_why_there_is_no_number_and_takes_a_thickness_for_a_ratio(capsys):
    rows = answer_of(capsys, "critical", "--ratio", "1.1", "1.15", "1.2", "--law", "isotropic")["rows"]
    assert rows[0]["g_crease"] ** 3 * (1 - 7 / 12 * 1.1**3) == pytest.approx(1, rel=1e-12)
    lacking = [(row["g_crease"] is None, row["g_biot"] is None, row["reason"] is None) for row in rows]
    assert lacking == [(False, False, True), (False, True, False), (True, True, False)]
    assert "C/B = 1.124" in rows[1]["reason"]
    assert "C/B = 1.197" in rows[2]["reason"]
    by_thickness = answer_of(capsys, "critical", "--thickness", "2", "--radius", "50")["rows"]
    assert by_thickness == answer_of(capsys, "critical", "--ratio", str(50 / 48))["rows"]


def test_critical_prints_a_dash_where_no_crease_forms(capsys):
    _, ((_, _, _, crease, biot, note), _, (number, *reason)) = table(capsys, "critical", "--ratio", "1.25")
    assert (crease, biot, note, number, reason[:2]) == ("–", "–", "[1]", "[1]", ["no", "crease"])


def test_bifurcation_puts_wrinkles_beside_creases_and_says_which_come_first(capsys):
    rows = answer_of(capsys, "bifurcation", "--thickness", "2", "--mu-ratio", "0.5", "2", "--law", "isotropic")["rows"]
    assert [row["mu_ratio"] for row in rows] == [0.5, 2.0]
    for row in rows:
        exact = theory.bifurcation(2 / 50, row["mu_ratio"], "isotropic")
        assert row["g_crit"] == pytest.approx(exact.g_crit, rel=1e-12)
        assert row["degree"] == exact.mode
        assert row["wavelength_over_T"] == pytest.approx(2 * np.pi / np.sqrt(exact.mode * (exact.mode + 1)) * 25)
        assert row["wavelength_deformed_over_T"] > row["wavelength_over_T"]
        for name in ("wavelength", "wavelength_deformed"):
            assert row[f"{name}_mm"] == pytest.approx(2 * row[f"{name}_over_T"], rel=1e-12)
        assert row["g_crease"] == pytest.approx(float(theory.critical_growth(50 / 48)), rel=1e-9)
        assert row["first"] == ("wrinkle" if row["g_crit"] < row["g_crease"] else "crease")
    assert [row["first"] for row in rows] == ["crease", "wrinkle"]


def test_bifurcation_says_inf_where_the_shortest_waves_come_first(capsys):
    answer = answer_of(capsys, "bifurcation", "--thickness", "2", "--mu-ratio", "0.1", "--law", "isotropic")
    (row,) = answer["rows"]
    assert row["degree"] == answer["parameters"]["kappa_ratio"] == "inf"  # which strict JSON has no number for
    assert row["g_crit"] == pytest.approx(float(theory.critical_growth(50 / 48, ratio=theory.BIOT)), rel=1e-6)
    assert "shortest waves" in row["reason"]


def test_the_curve_has_its_least_growth_where_the_answer_is(capsys):
    arguments = ("bifurcation", "--thickness", "3", "--mu-ratio", "2", "--law", "tangential")
    (answer,) = answer_of(capsys, *arguments)["rows"]
    curve = answer_of(capsys, *arguments, "--curve")["rows"]
    least = min((row for row in curve if row["g_crit"] is not None), key=lambda row: row["g_crit"])
    assert (least["degree"], least["g_crit"]) == (answer["degree"], answer["g_crit"])
    assert {type(row["degree"]) for row in curve} == {int}
    assert all(" g = 10" in row["reason"] for row in curve if row["g_crit"] is None)


def test_numbers_come_one_by_one_or_as_a_range():
    assert range_values(["1:2:11", "3"]) == [*(round(1 + i / 10, 1) for i in range(11)), 3.0]
    assert range_values(["2:1:3"]) == [2.0, 1.5, 1.0]
    assert range_values(["1", "1.0", "2"]) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("radius --growth two", r"--growth.* \[not-readable\]"),
        ("stress --growth 1:2:2.5", r"--growth.* \[bad-usage\]"),
        ("radius --growth nan", r"--growth.* \[out-of-range\]"),
        ("radius --thickness 60", r"thickness .* 0 .* 50 mm, .* 60 mm"),
        ("critical --ratio 3 --core-growth 1.1", r" A/C = 0\.5, .* C/B = 3\b"),
        ("stress --thickness 1:20:11 --plot it.png", r"--plot .* 10 .*--thickness, .* 11\. \[too-large\]"),
        ("bifurcation --plot picture.gif", r"picture\.gif"),
        ("bifurcation --body radial", r" radial: .*--body\b.* \[does-not-apply\]"),
        ("bifurcation --body demo --set growth.law=round", r"growth\.law\b.*round"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused_before_it_is_computed(cwd, capsys, monkeypatch, arguments, expected):
    for name in ("bifurcation", "stresses"):
        monkeypatch.setattr(theory, name, pytest.fail)
    monkeypatch.setattr(statics, "bifurcation_of_scene", pytest.fail)
    assert main(["theory", *arguments.split()]) == 2
    out, message = capsys.readouterr()
    assert (out, message.count("\n"), list(cwd.iterdir())) == ("", 1, [])
    assert re.search(expected, message)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "name", "start"),
    [
        ("stress --law both", "it.pdf", b"%PDF"),
        ("bifurcation --thickness 3 --mu-ratio 0.1 2 --law isotropic --curve", "it.PNG", b"\x89PNG"),
    ],
)
def test_every_question_can_be_drawn(cwd, capsys, arguments, name, start):
    assert main(["theory", *arguments.split(), "--plot", name]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"-> {name}"
    assert (cwd / name).read_bytes().startswith(start)


def test_a_solver_that_finds_no_state_ends_with_1_and_says_so(capsys, monkeypatch):
    def lost(*_, **__):
        raise smooth_sphere.ConvergenceError("no smooth state")

    monkeypatch.setattr(theory, "bifurcation", lost)
    assert main(["theory", "bifurcation", "-q"]) == 1
    assert capsys.readouterr().err == "morphofold theory: no smooth state\n"


# the body of a scene


@pytest.mark.slow
def test_the_body_of_a_scene_stands_beside_the_theory_of_its_own_sphere(capsys, monkeypatch):
    calls, bifurcation = [], statics.bifurcation_of_scene
    noted = lambda scene, **options: calls.append((scene, bifurcation(scene, **options))) or calls[-1][1]
    monkeypatch.setattr(statics, "bifurcation_of_scene", noted)
    answer = answer_of(capsys, "bifurcation", *OCTANT, "--set", "geometry.hole_radius=20", "-q")
    (row,), ((scene, body),) = answer["rows"], calls
    assert scene == load_scene("demo", ["geometry.portion=octant", "accuracy.edge=8", "geometry.hole_radius=20"])
    exact = theory.bifurcation(3 / 50, 1.0, "isotropic", 50.0, A_over_C=0.4)
    assert (row["g_theory"], row["degree_theory"]) == (exact.g_crit, exact.mode)
    assert [row[name] for name in ("g_crit", "rounded", "degree")] == [body.g_crit, body.rounded, body.degree]
    assert row["difference_percent"] == pytest.approx(100 * (body.g_crit / exact.g_crit - 1), rel=1e-12)
    assert 0 < row["difference_percent"] < 5  # a mesh of 756 bricks
    assert row["degree"] == pytest.approx(exact.mode, rel=0.3)
    assert (row["wavelength_mm"], row["wavelength_over_T"]) == (body.wavelength, body.wavelength / 3)
    assert row["elements"] == build_bilayer(scene).mesh.nelements
    assert row["edge_over_T"] == pytest.approx(np.pi / 2 * 50 / 12 / 3)  # cells along a quarter: a multiple of 4
    assert row["reason"] is None
    assert "mu_ratio" not in answer["parameters"]  # it is the scene's


@pytest.mark.slow
def test_an_octant_is_held_against_the_even_degrees_it_has():
    """T = 3 and a cortex four times as stiff: degree 11 comes first in a quarter."""
    quarter, octant = (
        theory_tables._theory_of_scene(load_scene("demo", ["material.mu_ratio=4", f"geometry.portion={portion}"]))
        for portion in ("quarter", "octant")
    )
    exact = theory.bifurcation(3 / 50, 4.0, "isotropic", 50.0)
    assert quarter == (exact.g_crit, exact.mode, "")
    assert exact.mode == 11
    sphere = smooth_sphere.SmoothSphere(3 / 50, 4.0, "isotropic", 50.0)
    g = [wrinkling.critical_growth_of_degree(sphere, degree) for degree in (10, 12)]
    assert octant == (pytest.approx(min(g), rel=1e-10), 10, "")


def test_where_there_is_no_theory_beside_a_body_the_reason_is_told():
    spots = "geometry.thickness_spots=[{centre = [0, 0, 50], radius = 9, factor = 0.5}]"
    for scene, settings in (("strip", []), ("mesh", []), ("demo", [spots]), ("demo", ["geometry.hole_radius=0.01"])):
        g, degree, reason = theory_tables._theory_of_scene(load_scene(scene, settings))
        assert np.isnan([g, degree]).all()
        assert reason


def test_a_strip_is_told_without_theory_and_with_its_progress(capsys):
    assert main(["theory", "bifurcation", *STRIP, "--json"]) == 0
    out, progress = capsys.readouterr()
    (row,) = json.loads(out)["rows"]
    assert (1.1 < row["g_crit"] < 1.3, row["g_theory"]) == (True, None)
    assert "stable at g = 1.05000" in progress
