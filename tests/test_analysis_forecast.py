"""Forecasts of analyses: what is counted is exact, times follow their laws; nothing here is a time that was taken."""

import json

import numpy as np
import pytest
from commands import refused

from morphofold.analysis.copies import ACCURACIES, copied
from morphofold.analysis.speed import folded_ball
from morphofold.cli import main
from morphofold.forecasts import analysis as before
from morphofold.forecasts import forecast_analysis
from morphofold.forecasts.analysis_cost import PAGE, STAGES, WRITING
from morphofold.forecasts.table import costs
from morphofold.io import write_surface

MEASURING = [name for name in STAGES if name not in ("reading", WRITING, PAGE)]


@pytest.fixture
def second(monkeypatch):
    """As if every stage of the ball that is timed took a second, and the repeats the same."""
    monkeypatch.setattr(before, "_timed", lambda threads: (dict.fromkeys(MEASURING, 1.0), 1.0, 1))


def test_a_dry_run_writes_nothing_and_says_everything(here, capsys):
    ball = folded_ball(2500)
    (here / "in").mkdir()
    for name in ("white", "pial"):
        write_surface(here / "in" / f"lh.{name}", getattr(ball, name))
    argv = ["analyze", "--white", "in/lh.white", "--pial", "in/lh.pial", "--name", "ball", "--dry-run"]
    assert main([*argv, "--threads", "1"]) == 0
    told = capsys.readouterr().out
    for word in ("2,500 vertices", "memory", "by 1 thread", "error of hinges", "against", "scaled by power laws"):
        assert word in told
    assert main([*argv, "--accuracy", "fine", "--no-report", "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert list(found["seconds_by_stage"]) == [name for name in STAGES if name != PAGE]
    assert found["seconds"] == pytest.approx(sum(found["seconds_by_stage"].values()))
    assert found["fastest"] < found["seconds"] < found["slowest"]
    (lh,) = found["hemispheres"]
    assert (lh["vertices"], lh["measured_on"]) == (2500, copied(ball, ACCURACIES["fine"]).cortex.n_vertices)
    assert [path.name for path in here.iterdir()] == ["in"]


def test_a_forecast_of_both_hemispheres_is_of_twice_the_measuring_of_one(second):
    ball = folded_ball(1000)
    one, two = (forecast_analysis([ball] * n, reading=0.5 * n) for n in (1, 2))
    assert list(one.seconds_by_stage) == list(STAGES)
    starting = costs()["analysis"]["starting"]
    for name in (*MEASURING, "reading"):
        once = starting.get(name, 0.0) / costs()["analysis"]["regions_of_ball"]    # 1 s here: a slow machine
        assert two.seconds_by_stage[name] - once == pytest.approx(2 * (one.seconds_by_stage[name] - once))
    assert one.memory_GiB < two.memory_GiB
    assert forecast_analysis([ball], report=False).memory_GiB < one.memory_GiB


def test_times_follow_the_power_laws_of_the_table(second):
    n, draft = costs()["analysis"]["ball"], ACCURACIES["draft"]
    timed = dict.fromkeys(MEASURING, 1.0)
    here, there = (before._measuring(k * n, k * n, draft, timed) for k in (1, 10))
    for name, law in costs()["analysis"]["stages"].items():
        assert here[name] == pytest.approx(law["times"])
        assert np.log10(there[name] / here[name]) == pytest.approx(law["power"])
    assert here.keys() == there.keys() == set(MEASURING)
    assert 0.3 < here["local gyrification"] < 1                            # of the ball, which is larger than a brain
    on_copy = before._measuring(10 * n, n, draft, timed)
    assert on_copy["gyral thickness"] == here["gyral thickness"]
    assert on_copy["curvature"] == there["curvature"]
    assert on_copy["cortical thickness"] > here["cortical thickness"]      # thinning comes with it
    assert before._measuring(n, n, ACCURACIES["fine"], timed)["local gyrification"] > 10 * here["local gyrification"]


def test_an_uneven_machine_widens_the_range_and_is_said(monkeypatch):
    ball, timed = folded_ball(1000), dict.fromkeys(MEASURING, 1.0)
    found = []
    for uneven in (1.0, 2.0):
        monkeypatch.setattr(before, "_timed", lambda threads, uneven=uneven: (timed, uneven, 1))
        found.append(forecast_analysis([ball]))
    quiet, busy = found
    assert busy.slowest > quiet.slowest > quiet.seconds == busy.seconds
    assert "other work to do" in busy.doubts[-1]
    assert not any("other work" in doubt for doubt in quiet.doubts)


def test_what_can_not_be_measured_can_not_be_forecast(here, capsys):
    with pytest.raises(ValueError, match="no cortex"):
        forecast_analysis([])
    with pytest.raises(ValueError, match="accuracy"):
        forecast_analysis([folded_ball(1000)], accuracy="best")
    refused(capsys, ["analyze", "nobody", "--dry-run"], "nobody")
    refused(capsys, ["analyze", "sim", "--stages", "--dry-run"], "--stages takes a simulation folder")
    assert list(here.iterdir()) == []
