"""The gyrification index of a run, corrected for its mesh by the same folds on a coarser one."""

import json
from types import SimpleNamespace

import pytest
from commands import refused

from morphofold import analysis
from morphofold.cli import main
from morphofold.errors import NoSolution
from morphofold.forecasts import estimate_error, richardson
from morphofold.forecasts.cost_record import STUDIED_RANGES
from morphofold.forecasts.sizes import edge_by_rule
from morphofold.report.pages.page_entries import costs
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.output.run_inputs import is_temporary
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.folds.carried_states import indices_by_mesh, limit_of_line

SMALL = ("geometry.portion=octant", "output.stages=[]", "accuracy.edge=6", "growth.final=1.05")


def test_the_error_is_that_of_a_line_in_the_edge(monkeypatch):
    """What the meshes give is made up: indices 2.2 - 0.5 edge."""
    held, entered = [], []

    def mesh(edge):
        elements = SimpleNamespace(state=lambda: {"volume_ratio": edge})
        body = SimpleNamespace(bilayer=SimpleNamespace(edge=edge), elements=elements)
        enter = lambda *state: entered.append(state)
        return SimpleNamespace(body=body, state=SimpleNamespace(x=None), hold=held.append, enter=enter)

    state = SimpleNamespace(growth=1.5, x="x", v="v")
    monkeypatch.setattr(richardson, "carry", lambda *arguments: None)
    monkeypatch.setattr(richardson, "gyrification_of", lambda body, x: 2.2 - 0.5 * body.bilayer.edge)
    stage = richardson.stage_estimate(state, mesh(0.8), mesh(1.2))
    assert entered == [("x", "v", state, 0.8)]  # on its own mesh as it is: means over neighbours would lose pressures
    assert (stage.index, stage.held, stage.coarser) == pytest.approx((1.8, 1.8, 1.6))
    assert held == [richardson.HOLD_TICKS] * 2  # on both meshes
    assert stage.corrected == pytest.approx(2.2)
    assert stage.error == pytest.approx(1.8 / 2.2 - 1)


def test_the_coarser_mesh_has_all_else_the_same_if_the_body_has_cells_enough():
    scene = load_scene("ellipsoid", ["accuracy.edge=2", "accuracy.elements_through_cortex=3"])
    coarse = richardson.coarser(scene)
    assert coarse.edge == pytest.approx(2 * richardson.COARSER_EDGE_RATIO)
    assert load_scene(coarse, ["accuracy.edge=2"]) == scene
    few = lambda edge: load_scene("fig6-thick", [f"accuracy.edge={edge}"])
    assert edge_by_rule(richardson.coarser(few(16))) == pytest.approx(edge_by_rule(few(16)) * 2)  # eight cells, four
    with pytest.raises(NoSolution, match=r"\bfig6-thick\b"):
        richardson.coarser(few(20))  # four, and no body has fewer


def test_what_cannot_be_carried_is_refused_before_anything_is_grown(cwd, capsys, monkeypatch):
    for name, word in (("mesh", "'mesh'"), ("fig3", "'radial'"), ("strip", "closed surface")):
        refused(capsys, ["simulate", name, "--estimate"], "--estimate", word, "[does-not-apply]")
    demo = ["simulate", "demo", "--estimate", "--set"]
    refused(capsys, [*demo, "output.volume=false"], "output.volume", "[does-not-apply]")
    refused(capsys, [*demo, "effects.stress_growth={rate=1.0}"], "stress_growth", "[does-not-apply]")
    refused(capsys, [*demo, "growth.final=1", "--set", "output.stages=[]"], "--estimate", "demo", "[does-not-apply]")
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


def test_an_estimate_is_written_whole_can_be_made_later_and_is_on_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = simulate(load_scene("fig6-thick", SMALL), "run", threads=1)
    (run.path / ".0a1b2c3d.error.json").write_text("what a killed estimate left")
    estimate = estimate_error(run, threads=1)
    assert not [path for path in run.path.iterdir() if is_temporary(path) or path.name == "lock"]
    written = (run.path / "error.json").read_bytes()
    json.loads(written, parse_constant=pytest.fail)
    assert richardson.stored_estimate(run.path) == estimate
    (stage,) = estimate.stages
    pial = run.cortex().pial  # in single precision, the volume in double
    assert stage.index == pytest.approx(analysis.gyrification_index(pial.verts, pial.faces), abs=1e-12)
    assert abs(stage.error) < 2e-3  # a smooth body

    def stopped(fraction, text):
        raise KeyboardInterrupt

    (run.path / "error.json").unlink()
    with pytest.raises(KeyboardInterrupt):
        estimate_error(run, threads=1, progress=stopped)
    assert not (run.path / "error.json").exists()
    assert main(["simulate", "run/scene.toml", "-o", "run", "--resume", "--estimate", "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["estimate"]["stages"][0]["corrected"] == stage.corrected
    assert (run.path / "error.json").read_bytes() == written
    entry = SimpleNamespace(
        name="run", cortex=SimpleNamespace(files=[str(next((run.path / "stages").glob("*/stage.json")))])
    )
    assert costs([entry])[0][2] == estimate  # on the page of an analysis of its last stage
    health = run.path / "health.json"
    health.write_text(health.read_text().replace('"seconds"', '"seconds "'))  # another run's estimate isn't shown
    assert richardson.stored_estimate(run.path) is None


@pytest.mark.slow
def test_the_corrected_index_is_the_limit_of_the_same_folds_on_three_meshes(tmp_path):
    def scene(edge):
        settings = (*SMALL, "growth.final=1.35", f"accuracy.edge={3 * edge}", "accuracy.elements_through_cortex=3")
        return load_scene("fig6-thick", settings)

    run = simulate(scene(0.45), tmp_path / "run", threads=1)
    (stage,) = estimate_error(run, threads=1).stages
    own, *finer = (richardson.meshed(scene(edge)) for edge in (0.45, 0.36, 0.27))
    own.state.x, own.state.growth = richardson.read_volume(next((run.path / "stages").glob("*/volume.vtu")))[1], 1.35
    limit = limit_of_line(indices_by_mesh(own, [richardson.meshed(scene(0.45)), *finer]))
    assert stage.corrected == pytest.approx(limit, rel=0.02)
    assert stage.index < 0.97 * limit
