"""The limit of gyrification indices at equal folds."""

import json
import re
from pathlib import Path

import pytest

from morphofold.forecasts.cost_record import TABLE, expected_errors
from morphofold.sim.dynamics import State
from morphofold.sim.scene import LEVELS
from morphofold.studies.folds import carried_states
from morphofold.studies.folds.carried_states import indices_by_mesh, law_of_rows, limit_of_line, meshed, octant


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
    table = Path(__file__).parents[2].joinpath("docs", "folds-carried.tsv").read_text("utf-8")
    rows = [line.split("\t") for line in table.splitlines()[1:]]
    law, expected = law_of_rows(rows), TABLE["errors"]["quantities"]["gyrification index"]
    assert {key: expected[key] for key in law} == pytest.approx(law)
    standard, fine = (expected_errors(edge)["gyrification index"] for edge in (0.46, 0.28))
    assert standard.low < 0.046 < 0.0929 < standard.high  # the least and the largest error of a run of the page
    assert fine.low < 0.032 < 0.0569 < fine.high
    assert standard.error == pytest.approx(0.059, rel=0.05)  # the mean


def test_the_page_and_the_forecasts_are_written_from_the_runs(tmp_path, monkeypatch):
    page, forecasts = tmp_path / "page.md", tmp_path / "table.json"
    page.write_text("<!-- carried -->\n<!-- /carried -->\n", "utf-8")
    forecasts.write_text(json.dumps({"errors": {"quantities": {"gyrification index": {"range": [0, 1]}}}}), "utf-8")
    indices = "0.50 T: 1.800, 0.40 T: 1.840, 0.25 T: 1.900", "2.000", "2.000"
    rows_of_page = lambda name, seed: [
        [name, seed, "2", level, f"1.9 ({e} %)", "2.0 (+0.0 %)", *indices]
        for level, e in (("standard", -10.0), ("fine", -5.0))
    ]
    monkeypatch.setattr(carried_states, "SCENES", ("fig5",))
    monkeypatch.setattr(carried_states, "rows_of_page", rows_of_page)
    carried_states.main(page, forecasts, [5, 6])
    assert page.read_text("utf-8").count("| fig5 | 5 | 2 |") == 2
    assert "| fig5 | 6 |" not in page.read_text("utf-8")
    assert tmp_path.joinpath("page-carried.tsv").read_text("utf-8").count("\nfig5\t") == 4
    law = json.loads(forecasts.read_text("utf-8"))["errors"]["quantities"]["gyrification index"]
    assert (law["coefficient"], law["power"], law["range"]) == (pytest.approx(0.2), 1.0, [0, 1])
    assert law["spread"] == pytest.approx(0.0, abs=1e-12)


def test_the_presets_of_the_page_of_accuracy_lie_within_what_a_dry_run_prints():
    page = Path(__file__).parents[2].joinpath("docs", "accuracy.md").read_text("utf-8")
    (row,) = re.findall(r"^\| [^|]*octant \| gyrification index, g = 2 \| limit of its folds \|(.*)$", page, re.M)
    presets = zip(("draft", "standard", "fine", "finest"), row.strip(" |").split("|"), strict=True)
    errors = {level: float(re.findall(r"([\d.]+) %", cell)[0]) / 100 for level, cell in presets}
    for level, error in errors.items():
        expected = expected_errors(LEVELS[level])["gyrification index"]
        assert expected.low < error < expected.high
    assert errors["finest"] < errors["fine"] < errors["standard"] < errors["draft"]
