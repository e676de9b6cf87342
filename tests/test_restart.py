"""Runs that begin where another one stood."""

import json
import shutil

import numpy as np
import pytest
from commands import refused_run
from made_simulations import TINY, cut, stop_run, with_arrays

import morphofold as mf
from morphofold.cli import main
from morphofold.digests_and_json import sha256_of
from morphofold.errors import Mismatch
from morphofold.forecasts.richardson import estimate_error
from morphofold.sim.effects import Effect
from morphofold.sim.output.run_inputs import scene_digest
from morphofold.sim.output.stage_records import read_volume
from morphofold.sim.run import simulate

FURTHER = [*TINY, "growth.final=1.3", "output.stages=[1.05, 1.1, 1.2, 1.25]"]


class Look(Effect):
    """Keeps the first state that a run measures."""

    name = "look"
    state = None

    def refresh(self, run):
        if self.state is None:
            self.state = (run.state.x.copy(), run.state.v.copy(), run.state.growth, run.body.growth)


def positions(out, g):
    return read_volume(out / "stages" / f"g{g:.2f}" / "volume.vtu")[1]


def largest_distance(run, other, g):
    """Between the nodes of two runs [mm]."""
    return np.linalg.norm(positions(run.path, g) - positions(other.path, g), axis=1).max()


def test_equilibrium_is_the_same_by_way_of_a_restart(tmp_path):
    """Before folds the body has one equilibrium at each growth and material, however it came there."""
    slow = [*TINY, "growth.rate=0.2", "growth.final=1.15"]
    stiff = [*slow, "material.mu_ratio=2"]
    soft = simulate("demo", tmp_path / "soft", settings=slow)
    again = simulate("demo", tmp_path / "again", settings=slow, restart_from=soft.path / "stages" / "g1.10")
    hard = simulate("demo", tmp_path / "hard", settings=stiff)
    hardened = simulate("demo", tmp_path / "hardened", settings=stiff, restart_from=soft.path / "stages" / "g1.10")
    assert largest_distance(soft, hard, 1.15) > 0.05  # what there is to tell apart [mm]
    assert largest_distance(soft, again, 1.15) < 1e-4
    assert largest_distance(hard, hardened, 1.15) < 5e-3  # both rest within 0.05 T of 8 mm


def test_a_run_begins_at_rest_at_the_last_stage_and_its_folder_says_so(finished_run, tmp_path):
    look = Look()
    run = simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=finished_run, effects=[look])
    x, v, growth, body_growth = look.state
    np.testing.assert_array_equal(x, positions(finished_run, 1.2))
    assert not v.any()
    assert growth == body_growth == 1.2
    assert run.stages == (1.2, 1.25, 1.3)  # none below where it began
    assert [stage["growth"] for stage in run.health["stages"]] == [1.2, 1.25, 1.3]
    lines = [json.loads(line) for line in (run.path / "log.jsonl").read_text().splitlines()]
    assert lines[0]["growth"] >= 1.2
    file = finished_run / "stages" / "g1.20" / "volume.vtu"
    assert json.loads((run.path / "inputs.json").read_text())["restart"] == {
        "file": str(file),
        "sha256": sha256_of(file),
        "scene_sha256": scene_digest(finished_run),
        "growth": 1.2,
    }
    stage = json.loads((run.path / "stages" / "g1.25" / "stage.json").read_text())
    assert stage["scene_sha256"] == scene_digest(run.path)  # which the start is part of
    assert simulate("demo", run.path, settings=FURTHER, resume=True, effects=[look]).stages == run.stages
    with pytest.raises(ValueError, match="restart"):  # its scene does not say all
        estimate_error(run)
    plain = tmp_path / "plain"
    with pytest.raises(FileExistsError, match=str(plain)):
        simulate("demo", run.path, settings=FURTHER, resume=True, restart_from=plain, effects=[look])
    with pytest.raises(FileExistsError, match=str(run.path)):
        simulate("demo", finished_run, settings=TINY, resume=True, restart_from=run.path)


def test_a_run_begins_with_the_velocities_of_a_checkpoint_or_at_a_later_stage(finished_run, stopped_run, tmp_path):
    out, look = shutil.copytree(stopped_run, tmp_path / "stopped"), Look()
    simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=out, effects=[look])
    with np.load(out / "checkpoint.npz") as checkpoint:
        assert 1.1 < checkpoint["growth"] <= 1.2
        assert checkpoint["v"].any()
        for value, name in zip(look.state, ("x", "v", "growth")):
            np.testing.assert_array_equal(value, checkpoint[name])
    shutil.copytree(finished_run / "stages" / "g1.20", out / "stages" / "g1.20")
    look = Look()
    simulate("demo", tmp_path / "later", settings=FURTHER, restart_from=out, effects=[look])
    assert look.state[2] == 1.2


def test_a_restarted_run_that_is_stopped_ends_with_the_same_bytes(finished_run, tmp_path):
    """It needs the other run no more, unless its checkpoint is gone: then it begins at the same state again."""
    whole = simulate("demo", tmp_path / "whole", settings=FURTHER, restart_from=finished_run)
    moved = shutil.copytree(finished_run, tmp_path / "moved")
    out = stop_run(tmp_path / "run", FURTHER, restart_from=moved)
    again = shutil.copytree(out, tmp_path / "again")
    (again / "checkpoint.npz").unlink()
    file = moved / "stages" / "g1.20" / "volume.vtu"
    raw = file.read_bytes()
    file.write_bytes((finished_run / "stages" / "g1.10" / "volume.vtu").read_bytes())
    with pytest.raises(Mismatch, match=sha256_of(file)[:12]):
        simulate("demo", again, settings=FURTHER, resume=True)
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"volume\.vtu"):
        simulate("demo", again, settings=FURTHER, resume=True)
    simulate("demo", out, settings=FURTHER, resume=True)
    file.write_bytes(raw)
    simulate("demo", again, settings=FURTHER, resume=True, restart_from=moved)
    for run in (out, again):
        np.testing.assert_array_equal(positions(run, 1.3), positions(whole.path, 1.3))


# refusals ----------------------------------------------------------------------------------------------------


def refused(capsys, *options, settings=FURTHER, scene="demo"):
    """What the command says where it is refused: one line, exit code 2."""
    return refused_run(capsys, *options, scene=scene, settings=settings)


@pytest.mark.parametrize(
    ("settings", "numbers"),
    [
        (["accuracy.edge=6.55"], ["427", "889", "[mismatch]"]),
        (["geometry.hole_radius=24.9"], ["0.1 mm", "[mismatch]"]),
        (["effects.perturbation.seed=1"], [" mm ", "[mismatch]"]),
        (["growth.final=1.12", "output.stages=[]"], ["g = 1.2", "1.12", "[out-of-range]"]),
    ],
    ids=lambda value: value[0],
)
def test_another_mesh_or_a_smaller_final_growth_is_refused_with_numbers(finished_run, cwd, capsys, settings, numbers):
    message = refused(capsys, "--restart-from", str(finished_run), settings=[*FURTHER, *settings])
    for number in numbers:
        assert number in message
    assert not (cwd / "run").exists()


def test_another_material_with_the_wavelength_that_is_told_can_be_restarted_with(cwd, capsys):
    """That of the imperfection hangs on the material unless it is set."""
    bare = [setting for setting in FURTHER if "wavelength" not in setting]
    simulate("demo", "other", settings=[*bare, "growth.final=1.1", "output.stages=[]"])
    stiffer = [*bare, "material.mu_ratio=2"]
    message = refused(capsys, "--restart-from", "other", settings=stiffer)
    wavelength = message.partition("effects.perturbation.wavelength = ")[2].partition(",")[0]
    argv = ["simulate", "demo", "-o", "run", "-q", "--restart-from", "other"]
    settings = [*stiffer, f"effects.perturbation.wavelength={wavelength}"]
    assert main([*argv, *(word for s in settings for word in ("--set", s))]) == 0
    assert mf.read_cortex("run").info["g"] == 1.3


def test_where_there_is_no_state_it_is_said(finished_run, cwd, capsys):
    assert "nowhere" in refused(capsys, "--restart-from", "nowhere")
    simulate("fig3", "radial", settings=["output.stages=[1.05]", "growth.final=1.1"])
    for name in ("radial", "radial/stages/g1.05"):
        message = refused(capsys, "--restart-from", name)
        assert f"{name}: " in message
        assert "[missing-part]" in message
    message = refused(capsys, "--restart-from", str(finished_run), settings=[], scene="fig3")
    assert "fig3" in message
    assert "[does-not-apply]" in message
    assert not (cwd / "run").exists()


def test_options_that_choose_a_mesh_are_refused(finished_run, cwd, capsys):
    assert "--dry-run" in refused(capsys, "--restart-from", str(finished_run), "--dry-run")


@pytest.mark.parametrize(
    "damage",
    [
        cut,
        with_arrays(reference=None),
        with_arrays(x=np.zeros((427, 2))),
        with_arrays(growth=np.array(np.nan)),
        with_arrays(x=np.array([None], dtype=object)),
    ],
)
def test_a_damaged_checkpoint_is_not_begun_at(stopped_run, cwd, capsys, damage):
    shutil.copytree(stopped_run, "other")
    damage(cwd / "other" / "checkpoint.npz")
    assert "other/checkpoint.npz" in refused(capsys, "--restart-from", "other")
    assert not (cwd / "run").exists()


@pytest.mark.parametrize("name", ["volume.vtu", "stage.json", "surf/lh.pial"])
def test_a_damaged_stage_is_not_begun_at(finished_run, cwd, capsys, name):
    shutil.copytree(finished_run, "other")
    cut(cwd / "other" / "stages" / "g1.20" / name)
    assert "other/stages/g1.20" in refused(capsys, "--restart-from", "other")
    assert not (cwd / "run").exists()
