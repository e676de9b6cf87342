import json
import re
import subprocess
import sys

import numpy as np
import pytest

from morphofold.cli import main
from morphofold.cli.options import range_values
from morphofold.sim import theory, theory_tables
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


def refused(capsys, argv, expected):
    """A command that says one line, like what is expected."""
    assert main(argv.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert re.search(expected, captured.err)


def test_radius_prints_equation_11_for_the_papers_sphere(capsys):
    arguments, rows = table(capsys, "radius")
    assert "T = 2 mm, C = 50 mm" in arguments
    assert [row[1] for row in rows] == [f"{1 + i / 10:.4f}" for i in range(11)]
    for _, g, c_over_B, c_over_C in rows:
        expected = (1 + float(g) ** 3 * ((50 / 48) ** 3 - 1)) ** (1 / 3)
        assert float(c_over_B) == pytest.approx(expected, abs=1e-6)
        assert float(c_over_C) == pytest.approx(expected * 48 / 50, abs=1e-6)


def test_stress_is_continuous_and_vanishes_outside_whatever_the_mu_ratio(capsys):
    rows = answer_of(capsys, "stress", "--mu-ratio", "3", "--points", "5", "--law", "both", "--thickness", "1", "4")[
        "rows"
    ]
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
    first, second, third = answer_of(capsys, "critical", "--ratio", "1.1", "1.15", "1.2", "--law", "isotropic")["rows"]
    assert first["g_crease"] ** 3 * (1 - 7 / 12 * 1.1**3) == pytest.approx(1, rel=1e-12)
    assert first["reason"] is None
    assert second["g_biot"] is None
    assert "C/B = 1.124" in second["reason"]
    assert third["g_crease"] is None
    assert "C/B = 1.197" in third["reason"]
    by_thickness = answer_of(capsys, "critical", "--thickness", "2", "--radius", "50")["rows"]
    assert by_thickness == answer_of(capsys, "critical", "--ratio", str(50 / 48))["rows"]


def test_critical_prints_a_dash_where_no_crease_forms(capsys):
    _, rows = table(capsys, "critical", "--ratio", "1.25")
    (_, _, _, crease, biot, note), tangential, (number, *reason) = rows
    assert (crease, biot) == ("–", "–")
    assert note == number == "[1]"
    assert " ".join(reason).startswith("no crease")
    g = float(tangential[3])
    assert g**3 * 1.25**3 - 2.4 * g**2 * (1.25**3 - 1) - 2.4 == pytest.approx(0, abs=1e-3)  # four decimals


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
        assert (row["outer_radius_mm"], row["hole_ratio"], row["kappa_ratio"]) == (50, 0.5, "inf")
        assert row["g_crease"] == pytest.approx(float(theory.critical_growth(50 / 48)), rel=1e-9)
        assert row["first"] == ("wrinkle" if row["g_crit"] < row["g_crease"] else "crease")
    assert [row["first"] for row in rows] == ["crease", "wrinkle"]


def test_bifurcation_says_inf_where_the_shortest_waves_come_first(capsys):
    answer = answer_of(capsys, "bifurcation", "--thickness", "2", "--mu-ratio", "0.1", "--law", "isotropic")
    (row,) = answer["rows"]
    (biot,) = answer_of(capsys, "critical", "--thickness", "2", "--law", "isotropic")["rows"]
    assert row["degree"] == "inf"
    assert row["g_crit"] == pytest.approx(biot["g_biot"], rel=1e-6)
    assert "shortest waves" in row["reason"]
    assert answer["parameters"]["kappa_ratio"] == "inf"  # which strict JSON has no number for


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


@pytest.mark.parametrize("word", ["two", "1:2", "1:2:2.5", "1:2:99999999", "nan", "0"])
def test_what_is_no_number_and_no_range_is_refused(capsys, word):
    for question, unreadable in (("radius", "not-readable"), ("stress", "bad-usage")):
        code = "out-of-range" if word in ("nan", "0") else unreadable
        refused(capsys, f"theory {question} --growth {word}", rf"--growth.* \[{code}\]")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("radius --thickness 60", r"thickness .* 0 .* 50 mm, .* 60 mm"),
        ("stress --mu-ratio 0", r"--mu-ratio .* 0\.0001 .* 10000, .* 0\. \[out-of-range\]"),
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
    refused(capsys, f"theory {arguments}", expected)
    assert not any(cwd.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "start"),
    [
        ("stress --plot it.pdf --law both", b"%PDF"),
        ("bifurcation --thickness 2 3 --mu-ratio 2 --plot it.png", b"\x89PNG"),
        ("bifurcation --thickness 3 --mu-ratio 0.1 2 --law isotropic --curve --plot it.PNG", b"\x89PNG"),
    ],
)
def test_every_question_can_be_drawn(cwd, capsys, arguments, start):
    name = arguments.split("--plot ")[1].split()[0]
    assert main(["theory", *arguments.split()]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"-> {name}"
    assert (cwd / name).read_bytes().startswith(start)
    assert [p.name for p in cwd.iterdir()] == [name]


@pytest.mark.parametrize(
    ("module", "name", "error", "arguments"),
    [
        (theory, "bifurcation", smooth_sphere.ConvergenceError("no smooth state"), ()),
        (statics, "bifurcation_of_scene", statics.ConvergenceError("no path", np.zeros((1, 3)), 1.38), OCTANT),
    ],
)
def test_a_solver_that_finds_no_state_ends_with_1_and_says_so(capsys, monkeypatch, module, name, error, arguments):
    def lost(*_, **__):
        raise error

    monkeypatch.setattr(module, name, lost)
    assert main(["theory", "bifurcation", *arguments, "-q"]) == 1
    assert capsys.readouterr().err == f"morphofold theory: {error}\n"


def test_a_question_that_is_not_drawn_loads_no_plotting():
    code = (
        "import sys; from morphofold.cli import main; main(['theory', 'critical']); "
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


# the body of a scene


@pytest.mark.slow
def test_the_body_of_a_scene_stands_beside_the_theory_of_its_own_sphere(capsys, monkeypatch):
    calls, once = [], statics.bifurcation_of_scene
    monkeypatch.setattr(
        statics, "bifurcation_of_scene", lambda scene, **o: calls.append((scene, once(scene, **o))) or calls[-1][1]
    )
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
    answers = {}
    for portion in ("quarter", "octant"):
        scene = load_scene("demo", ["material.mu_ratio=4", f"geometry.portion={portion}"])
        answers[portion] = theory_tables._theory_of_scene(scene)
    exact = theory.bifurcation(3 / 50, 4.0, "isotropic", 50.0)
    assert answers["quarter"] == (exact.g_crit, exact.mode, "")
    assert exact.mode == 11
    sphere = smooth_sphere.SmoothSphere(3 / 50, 4.0, "isotropic", 50.0)
    g = [wrinkling.critical_growth_of_degree(sphere, degree) for degree in (10, 12)]
    assert answers["octant"] == (pytest.approx(min(g), rel=1e-10), 10, "")


def test_where_there_is_no_theory_beside_a_body_the_reason_is_told():
    spots = "geometry.thickness_spots=[{centre = [0, 0, 50], radius = 9, factor = 0.5}]"
    for scene, settings in (("strip", []), ("mesh", []), ("demo", [spots]), ("demo", ["geometry.hole_radius=0.01"])):
        g, degree, reason = theory_tables._theory_of_scene(load_scene(scene, settings))
        assert np.isnan([g, degree]).all()
        assert reason


def test_a_strip_is_told_without_theory_and_with_its_progress(capsys):
    answer = main(["theory", "bifurcation", *STRIP, "--json"])
    captured = capsys.readouterr()
    (row,) = json.loads(captured.out)["rows"]
    assert answer == 0
    assert 1.1 < row["g_crit"] < 1.3
    assert row["g_theory"] is None
    assert "stable at g = 1.05000" in captured.err
