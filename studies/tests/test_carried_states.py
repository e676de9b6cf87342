"""The limit of gyrification indices at equal folds."""

import re
from pathlib import Path

import pytest

from morphofold.forecasts.cost_record import TABLE, expected_errors
from morphofold.sim.dynamics import State
from morphofold.sim.scene import LEVELS
from morphofold.studies.folds.carried_states import indices_by_mesh, law_of_page, limit_of_line, meshed, octant


def test_a_smooth_sphere_stays_one_on_other_meshes():
    run, *others = (meshed(octant("demo", 0, f"accuracy.edge={edge}")) for edge in (4.0, 6.0, 8.0))
    run.state = State(1.02 * run.body.X, 0 * run.body.X, growth=1.02)
    indices = indices_by_mesh(run, others)
    assert sorted(indices) == pytest.approx([other.body.bilayer.edge / other.body.thickness for other in others])
    assert [*indices.values()] == pytest.approx([1.0, 1.0], abs=2e-3)


def test_the_limit_is_that_of_a_line_through_the_indices():
    assert limit_of_line({0.6: 1.4, 0.4: 1.6}) == pytest.approx(2.0)
    assert limit_of_line({0.6: 1.4, 0.4: 1.6, 0.2: 1.8}) == pytest.approx(2.0)


def test_forecasts_expect_the_errors_of_the_page():
    page = Path(__file__).parents[2].joinpath("docs", "folds.md").read_text("utf-8")
    law, expected = law_of_page(page), TABLE["errors"]["quantities"]["gyrification index"]
    assert {key: expected[key] for key in law} == pytest.approx(law)
    standard, fine = (expected_errors(edge)["gyrification index"] for edge in (0.46, 0.28))
    assert standard.low < 0.046 < 0.092 < standard.high  # the least and the largest error of a run of the page
    assert fine.low < 0.032 < 0.0589 < fine.high
    assert standard.error == pytest.approx(0.059, rel=0.05)  # the mean


def test_the_presets_of_the_page_of_accuracy_lie_within_what_a_dry_run_prints():
    page = Path(__file__).parents[2].joinpath("docs", "accuracy.md").read_text("utf-8")
    (row,) = re.findall(r"^\| [^|]*octant \| gyrification index, g = 2 \| limit of its folds \|(.*)$", page, re.M)
    presets = zip(("draft", "standard", "fine", "finest"), row.strip(" |").split("|"), strict=True)
    errors = {level: float(re.findall(r"([\d.]+) %", cell)[0]) / 100 for level, cell in presets}
    for level, error in errors.items():
        expected = expected_errors(LEVELS[level])["gyrification index"]
        assert expected.low < error < expected.high
    assert errors["finest"] < errors["fine"] < errors["standard"] < errors["draft"]
