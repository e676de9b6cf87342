"""The error of a run by its coarser coarse: exact where it is known, none between two patterns; nothing is lost."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from commands import refused, run_json
from made_simulations import harmonic

from morphofold import analysis
from morphofold.cli import main
from morphofold.errors import NoSolution
from morphofold.forecasts import estimate_error, richardson
from morphofold.forecasts.cost_record import STUDIED_RANGES
from morphofold.forecasts.sizes import edge_by_rule
from morphofold.report.pages.page_entries import costs
from morphofold.shapes import icosphere
from morphofold.sim.dynamics import REST_DISTANCE_OVER_T, UnstableError
from morphofold.sim.output.run_inputs import is_temporary
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene
from morphofold.surface import Surface

SMALL = ("geometry.portion=octant", "output.stages=[]", "output.volume=false", "accuracy.edge=6", "growth.final=1.05")


def made(edge, degree=12, height=3.0, warnings=()):
    """A sphere of 50 mm with waves of a degree, as the last stage of a run."""
    verts, faces = icosphere(4, 50.0)
    return richardson.Grown(
        Surface(verts * (1 + height / 50 * harmonic(verts, degree, 5))[:, None], faces), edge, list(warnings)
    )


def test_an_error_that_goes_with_a_power_of_the_edge_is_estimated_exactly():
    power, slope = richardson.CONVERGENCE_POWERS["pial distance"], 0.02
    sphere = lambda edge: richardson.Grown(
        Surface(icosphere(4, 50 + slope * edge**power)[0], icosphere(4)[1]), edge, []
    )
    estimate = richardson.errors_from_runs(load_scene("fig6-thick"), sphere(2.0), sphere(3.0))
    assert estimate.ratio == 1.5
    assert estimate.errors["gyrification index"].error == pytest.approx(0, abs=1e-9)
    assert estimate.errors["pial distance"].error == pytest.approx(slope * 2**power / 3, rel=0.01)  # over T = 3 mm


def test_another_pattern_gives_no_error_however_near_the_numbers_lie():
    run = made(2.0)
    rotated = Surface(run.pial.verts * [1, -1, -1], run.pial.faces)
    estimate = richardson.errors_from_runs(load_scene("fig6-thick"), run, richardson.Grown(rotated, 3.0, []))
    assert estimate.errors["gyrification index"].change == pytest.approx(0, abs=1e-12)
    assert estimate.errors["pial distance"].change > richardson.SAME_PATTERN_DISTANCE
    assert {e.error for e in estimate.errors.values()} == {None}
    assert "another pattern" in estimate.words


def test_what_the_pace_changes_is_recorded_as_it_stands():
    run, coarse, slow = made(2.0), made(3.0, height=2.8), made(3.0, height=2.7)
    scene = load_scene("fig6-thick")
    estimate = richardson.errors_from_runs(scene, run, coarse, slow)
    usual, slower = (analysis.gyrification_index(s.pial.verts, s.pial.faces) for s in (coarse, slow))
    assert estimate.pace == {
        "gyrification index": pytest.approx((usual - slower) / usual),
        "pial distance": richardson.distance(coarse.pial, slow.pial) / 3,
    }
    without = richardson.errors_from_runs(scene, run, coarse)
    assert without.pace is None
    assert (estimate.errors, estimate.doubts) == (without.errors, without.doubts)
    of_patch = richardson.errors_from_runs(load_scene("patch", ["growth.final=2"]), run, coarse, slow)
    assert set(of_patch.pace) == set(of_patch.errors) == {"pial distance"}  # an open body has no index
    assert (of_patch.not_studied, len(of_patch.doubts)) == (("shape",), 1)


def test_another_pattern_at_another_pace_is_doubted_and_leaves_the_error_of_the_mesh():
    coarse = made(3.0, height=2.8)
    rotated = richardson.Grown(Surface(coarse.pial.verts * [1, -1, -1], coarse.pial.faces), 3.0, ["not calm"])
    estimate = richardson.errors_from_runs(load_scene("fig6-thick"), made(2.0), coarse, rotated)
    assert estimate.pace["pial distance"] > richardson.SAME_PATTERN_DISTANCE
    assert estimate.errors == richardson.errors_from_runs(load_scene("fig6-thick"), made(2.0), coarse).errors
    ill, pattern = estimate.doubts
    assert "slower run isn't healthy: not calm" in ill
    assert "depend on the pace" in pattern


@pytest.mark.parametrize(
    ("setting", "slower"), [("growth.rate=1.9e-3", False), ("growth.rate=2e-3", True), ("effects.inertia={}", False)]
)
def test_no_slower_run_where_time_is_real_or_no_pace_is_as_slow(setting, slower):
    assert ("slower" in richardson.companions(load_scene("fig6-thick", [setting]))) is slower


def test_the_coarser_run_is_the_same_scene_with_longer_edges_if_it_has_cells_enough():
    scene = load_scene("ellipsoid", ["accuracy.edge=2", "accuracy.elements_through_cortex=3"])
    coarse = richardson.coarser(scene)
    assert coarse.edge == pytest.approx(3)
    assert load_scene(coarse, ["accuracy.edge=2", "output.volume=true"]) == scene
    few = lambda edge: load_scene("fig6-thick", [f"accuracy.edge={edge}"])
    assert edge_by_rule(richardson.coarser(few(14))) == pytest.approx(edge_by_rule(few(14)) * 2)  # eight cells, four
    with pytest.raises(NoSolution, match=r"\bfig6-thick\b"):
        richardson.coarser(few(20))  # four, and no body has fewer


def test_what_has_no_coarser_run_is_refused_before_anything_is_grown(cwd, capsys, monkeypatch):
    refused(capsys, ["simulate", "mesh", "--estimate"], "--estimate", "'mesh'", "[does-not-apply]")
    refused(capsys, ["simulate", "fig3", "--estimate"], "--estimate", "'radial'", "[does-not-apply]")
    still = ["simulate", "demo", "--estimate", "--set", "growth.final=1", "--set", "output.stages=[]"]
    refused(capsys, still, "--estimate", "demo", "[does-not-apply]")
    few = ["simulate", "fig6-thick", "--estimate", "--set", "accuracy.edge=25"]
    refused(capsys, few, "accuracy.edge", "fig6-thick", "[no-solution]")
    refused(capsys, [*few, "--dry-run"], "fig6-thick", "[no-solution]")
    monkeypatch.setitem(STUDIED_RANGES, "thickness", (0.0, 1.0))
    thick = ["simulate", "fig6-thick", "--estimate", "--set", "geometry.cortex_thickness=20", "--json"]
    assert main([*thick, "--error", "99%", "--threads", "1"]) == 2  # a mesh that was picked, too
    assert "[no-solution]" in capsys.readouterr().err
    assert list(cwd.iterdir()) == []


@pytest.mark.parametrize(("error", "code"), [(UnstableError("it burst.", {}), 1), (KeyboardInterrupt, 130)])
def test_a_finished_run_is_printed_though_its_estimate_fails(cwd, monkeypatch, capsys, error, code):
    def failing(*_, **__):
        raise error

    monkeypatch.setattr("morphofold.cli.simulate.estimate_error", failing)
    argv = ["simulate", "fig6-thick", "-o", "run", "-q", "--threads", "1", "--estimate", "--set", "accuracy.edge=9"]
    argv += [word for setting in SMALL if "edge" not in setting for word in ("--set", setting)]
    assert main(argv) == code
    captured = capsys.readouterr()
    assert "1 stages to g = 1.05" in captured.out
    assert "expected error" in captured.out
    assert len(captured.err.strip().splitlines()) == 1


def test_a_forecast_counts_the_other_runs_beside_the_run(capsys):
    settings = [word for setting in (*SMALL[:3], "accuracy.edge=3.5") for word in ("--set", setting)]
    argv = ["simulate", "fig6-thick", *settings, "--dry-run", "--estimate", "--threads", "1"]
    content = run_json([*argv, "--json"], capsys)
    coarse, slower = content["coarser"], content["slower"]
    assert coarse["elements"] < content["elements"] / 1.5
    assert slower["elements"] == coarse["elements"]
    assert coarse["steps"] < slower["steps"] < 2 * coarse["steps"]
    assert content["errors"]
    assert (coarse["errors"], slower["errors"]) == ({}, {})


def test_an_estimate_goes_on_after_a_stop_and_is_on_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = simulate(load_scene("fig6-thick", SMALL), "run", threads=1)
    (run.path / ".0a1b2c3d.error.json").write_text("what a killed estimate left")
    whole = estimate_error(run, threads=1)
    assert not [path for path in run.path.iterdir() if is_temporary(path) or path.name == "lock"]
    written = (run.path / "error.json").read_bytes()
    stage = next((run.path / "stages").glob("*/stage.json"))
    assert richardson.stored_estimate(run.path) == whole
    content = json.loads(written, parse_constant=pytest.fail)
    assert content["not_studied"] == ["edge", "growth"]
    assert content["pace"] == whole.pace
    assert whole.pace["gyrification index"] < 1e-3  # a smooth body at rest forgets its pace,
    assert 0 < whole.pace["pial distance"] < REST_DISTANCE_OVER_T / 10  # as far as it is at rest, over T

    def stopped(fraction, text):
        if fraction > 0.8:
            raise KeyboardInterrupt

    again = simulate(load_scene("fig6-thick", SMALL), "again", threads=1)
    with pytest.raises(KeyboardInterrupt):
        estimate_error(again, threads=1, progress=stopped)
    assert not (again.path / "error.json").exists()
    of_the_coarser = (again.path / "coarser" / "health.json").read_bytes()
    settings = [word for setting in SMALL for word in ("--set", setting)]
    argv = ["simulate", "fig6-thick", "-o", "again", *settings, "--threads", "1", "-q", "--estimate"]
    assert main([*argv, "--resume"]) == 0
    assert "from a coarser run" in capsys.readouterr().out
    resumed = json.loads((again.path / "error.json").read_text())
    assert resumed == {**json.loads(written), "health_sha256": resumed["health_sha256"]}
    assert (again.path / "coarser" / "health.json").read_bytes() == of_the_coarser
    of_the_slower = (run.path / "slower" / "health.json").read_bytes()
    assert main(["simulate", "run/scene.toml", "-o", "run", "--resume", "--estimate", "--json", "-q"]) == 0
    printed = json.loads(capsys.readouterr().out)["estimate"]
    assert (printed["ratio"], printed["pace"]) == (whole.ratio, whole.pace)
    assert (run.path / "slower" / "health.json").read_bytes() == of_the_slower

    entry = SimpleNamespace(name="run", cortex=SimpleNamespace(files=[str(stage)]))
    assert costs([entry])[0][2] == whole  # on the page of an analysis of its last stage
    (run.path / "error.json").write_text(json.dumps({**content, "pace": None}))
    assert richardson.stored_estimate(run.path) == replace(whole, pace=None)  # of a scene without a slower run
    (run.path / "error.json").write_text(json.dumps({**content, "pace": {"pial distance": "small"}}))
    assert richardson.stored_estimate(run.path) is None
    (run.path / "error.json").write_bytes(written)
    health = run.path / "health.json"
    health.write_text(health.read_text().replace('"seconds"', '"seconds "'))  # another run's estimate isn't shown
    assert richardson.stored_estimate(run.path) is None


@pytest.mark.slow
def test_the_estimated_error_of_the_index_is_that_against_a_far_finer_mesh(tmp_path):
    """0.77 times the true one was seen. Later or on coarser meshes the coarse folds into another pattern."""

    def grown(edge):
        settings = (*SMALL, "growth.final=1.35", f"accuracy.edge={3 * edge}", "accuracy.elements_through_cortex=3")
        return simulate(load_scene("fig6-thick", settings), tmp_path / f"{edge}", threads=1)

    run, fine = grown(0.45), grown(0.27)
    index = estimate_error(run, threads=1).errors["gyrification index"]
    coarse, exact = (analysis.gyrification_index(s.cortex().pial.verts, s.cortex().faces) for s in (run, fine))
    true = abs(coarse / exact - 1)
    against_the_finer = index.error * (1 - 0.6**index.power)  # whose own error isn't seen against it
    assert true > 0.02
    assert true / 2 < against_the_finer < 2 * true
