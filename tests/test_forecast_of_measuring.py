"""Forecasts of analyses: what is counted is exact, times follow their laws; nothing here is a time that was taken."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from commands import refused

from morphofold.analysis.resampling import PRESETS, resampled
from morphofold.analysis.scales import scale_of_curvature
from morphofold.cli import main
from morphofold.errors import NothingToDo, UnknownName
from morphofold.forecasts import forecast_analysis
from morphofold.forecasts import measuring as before
from morphofold.forecasts.analysis_cost import ANALYSIS_STAGES, PAGE_STAGE, WRITING_STAGE
from morphofold.forecasts.table import costs
from morphofold.io import sample_path, write_surface
from morphofold.shapes import icosphere
from morphofold.shapes.folded_ball import folded_ball
from morphofold.surface import Surface

MEASURING = [name for name in ANALYSIS_STAGES if name not in ("reading", WRITING_STAGE, PAGE_STAGE)]


@pytest.fixture
def second(monkeypatch):
    """As if every stage of the ball that is timed took a second, and the repeats the same."""
    monkeypatch.setattr(before, "_time_small_ball", lambda threads: (dict.fromkeys(MEASURING, 1.0), 1.0, 1))


@pytest.mark.slow
def test_a_dry_run_writes_nothing_and_says_everything(here, capsys):
    ball = folded_ball(7000)
    (here / "in").mkdir()
    for name in ("white", "pial"):
        write_surface(here / "in" / f"lh.{name}", getattr(ball, name))
    argv = ["analyze", "--white", "in/lh.white", "--pial", "in/lh.pial", "--name", "ball", "--dry-run"]
    assert main([*argv, "--threads", "1"]) == 0
    printed = capsys.readouterr().out
    for word in ("7,000 vertices", "memory", "with 1 thread", "error of hinges", "against", "scaled by power laws"):
        assert word in printed
    assert main([*argv, "--accuracy", "fine", "--no-report", "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert list(found["seconds_by_stage"]) == [name for name in ANALYSIS_STAGES if name != PAGE_STAGE]
    assert found["seconds"] == pytest.approx(sum(found["seconds_by_stage"].values()))
    assert found["fastest"] < found["seconds"] < found["slowest"]
    (lh,) = found["hemispheres"]
    assert (lh["vertices"], lh["measured_on"]) == (7000, resampled(ball, PRESETS["fine"]).cortex.n_vertices)
    assert [path.name for path in here.iterdir()] == ["in"]


def test_a_forecast_of_both_hemispheres_is_of_twice_the_measuring_of_one(second):
    ball = folded_ball(1000)
    one, two = (forecast_analysis([ball] * n, reading=0.5 * n) for n in (1, 2))
    assert list(one.seconds_by_stage) == list(ANALYSIS_STAGES)
    starting = costs()["analysis"]["starting"]
    for name in (*MEASURING, "reading"):
        once = starting.get(name, 0.0) / costs()["analysis"]["regions_of_ball"]  # 1 s here: a slow machine
        assert two.seconds_by_stage[name] - once == pytest.approx(2 * (one.seconds_by_stage[name] - once))
    assert one.memory_GiB < two.memory_GiB
    assert forecast_analysis([ball], report=False).memory_GiB < one.memory_GiB


def test_times_follow_the_power_laws_of_the_table(second):
    n, draft = costs()["analysis"]["ball"], PRESETS["draft"]
    timed = dict.fromkeys(MEASURING, 1.0)
    here, there = (before._seconds_of_measuring(k * n, k * n, draft, timed) for k in (1, 10))
    for name, law in costs()["analysis"]["stages"].items():
        assert here[name] == pytest.approx(law["times"])
        assert np.log10(there[name] / here[name]) == pytest.approx(law["power"])
    assert here.keys() == there.keys() == set(MEASURING)
    assert 0.3 < here["local gyrification"] < 1  # of the ball, which is larger than a brain
    on_copy = before._seconds_of_measuring(10 * n, n, draft, timed)
    assert on_copy["gyral thickness"] == here["gyral thickness"]
    assert on_copy["curvature"] == there["curvature"]
    assert on_copy["cortical thickness"] > here["cortical thickness"]  # thinning comes with it
    assert (
        before._seconds_of_measuring(n, n, PRESETS["fine"], timed)["local gyrification"]
        > 10 * here["local gyrification"]
    )


def test_an_uneven_machine_widens_the_range_and_is_said(monkeypatch):
    ball, timed = folded_ball(1000), dict.fromkeys(MEASURING, 1.0)
    found = []
    for uneven in (1.0, 2.0):
        monkeypatch.setattr(before, "_time_small_ball", lambda threads, uneven=uneven: (timed, uneven, 1))
        found.append(forecast_analysis([ball]))
    quiet, busy = found
    assert busy.slowest > quiet.slowest > quiet.seconds == busy.seconds
    assert "other work to do" in busy.doubts[-1]
    assert not any("other work" in doubt for doubt in quiet.doubts)


@pytest.mark.parametrize("accuracy", PRESETS)
def test_a_vertex_that_no_face_uses_is_counted_as_the_copy_has_it(accuracy):
    ball, more = folded_ball(1000), [[0.0, 0.0, 99.0]]
    loose = {
        name: Surface(np.vstack([getattr(ball, name).verts, more]), ball.faces, name=name) for name in ("white", "pial")
    }
    cortex, chosen = replace(ball, **loose, maps={}, cortex=None, regions=None), PRESETS[accuracy]
    n = resampled(cortex, chosen).cortex.n_vertices
    assert before._resampled_vertices(cortex, chosen) == n
    assert (n == 1001) == (accuracy != "fine")


def test_curvature_is_forecast_by_its_scale_against_the_usual_one(second):
    ball = folded_ball(1000)
    usual = scale_of_curvature(ball)[0]
    found = [forecast_analysis([ball], curvature_scale=times * usual) for times in (1, 2)]
    once, twice = (one.seconds_by_stage["curvature"] for one in found)
    assert once == forecast_analysis([ball]).seconds_by_stage["curvature"]
    assert twice / once == pytest.approx(2**before.CURVATURE_TIME_POWER)
    assert found[1].seconds - found[0].seconds == pytest.approx(twice - once)


def test_stages_that_the_page_draws_are_said_not_to_be_counted(second, here, capsys):
    for stage in ("g1.80", "g1.90"):
        shutil.copytree(sample_path("simulated"), here / "sim" / "stages" / stage)
    argv = ["analyze", "sim", "--dry-run"]
    assert main(argv) == 0
    assert "draws stages of the simulation (2)" in capsys.readouterr().out
    assert main([*argv, "--no-report"]) == 0
    assert "stages of the simulation" not in capsys.readouterr().out


def test_a_dry_run_refuses_what_the_run_would(here, capsys, monkeypatch):
    monkeypatch.setattr(before, "_time_small_ball", lambda threads: pytest.fail("timed before it refused"))
    ball = folded_ball(1000)
    (here / "in").mkdir()
    (here / "mine").mkdir()
    (here / "mine" / "thesis.txt").write_text("mine")
    for name in ("white", "pial"):
        write_surface(here / "in" / f"lh.{name}", getattr(ball, name))
    argv = ["analyze", "--white", "in/lh.white", "--pial", "in/lh.pial"]
    bids = ["--layout", "bids"]
    for changed, *words in (
        ([*argv, "-o", "in"], "in: ", "-o"),
        ([*argv, "-o", "mine"], "did not write this folder"),
        ([*argv, *bids], "--layout bids", "-o DATASET"),
        ([*argv, *bids, "-o", "mine"], "is not a BIDS dataset"),
        ([*argv, *bids, "-o", "out", "--name", "_"], "'_': "),
        ([*argv, *bids, "-o", "out", "--wide"], "--wide", "--layout bids"),
        ([*argv, "--wide", "-o", "out"], "regions_wide.tsv", "?h.aparc.annot"),
        ([*argv, "--curvature-scale", "0.001", "-o", "out"], "scale 0.001 ", "[out-of-range]"),
        (["analyze", "--white", "in/lh.pial", "--pial", "in/lh.white", "-o", "out"], " mm^3", "[unlike-surfaces]"),
        (
            ["analyze", "--white", "in/lh.white", "--pial", "in/lh.white", "-o", "out"],
            f" {ball.n_vertices} ",
            "[unlike-surfaces]",
        ),
    ):
        refused(capsys, [*changed, "-q"], *words)
        refused(capsys, [*changed, "--dry-run"], *words)
    assert sorted(path.name for path in here.iterdir()) == ["in", "mine"]


def test_errors_of_a_mesh_like_none_that_was_measured_are_not_forecast(second, here, capsys):
    sphere, faces = icosphere(1)
    for name, radius in (("white", 47.0), ("pial", 50.0)):
        write_surface(here / f"lh.{name}", Surface(radius * sphere, faces))
    argv = ["analyze", "--white", "lh.white", "--pial", "lh.pial", "--dry-run"]
    assert main([*argv, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["errors"] == {}
    assert "42 vertices" in found["how"]["errors"]
    assert main(argv) == 0
    assert "error of" not in capsys.readouterr().out


def test_what_can_not_be_measured_can_not_be_forecast(here, capsys):
    with pytest.raises(NothingToDo):
        forecast_analysis([])
    with pytest.raises(UnknownName, match=r"\baccuracy\b.*'best'"):
        forecast_analysis([folded_ball(1000)], accuracy="best")
    refused(capsys, ["analyze", "nobody", "--dry-run"], "nobody")
    refused(capsys, ["analyze", "sim", "--stages", "--dry-run"], "--stages", "--dry-run")
    assert list(here.iterdir()) == []
