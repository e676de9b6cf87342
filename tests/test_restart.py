"""Runs that begin where another one stood."""

import json
import shutil

import numpy as np
import pytest
from commands import refused_run
from made_simulations import Stop

import morphofold as mf
from morphofold.cli import main
from morphofold.errors import Mismatch
from morphofold.forecasts.richardson import estimate_error
from morphofold.provenance import sha256_of
from morphofold.sim.effects import Effect
from morphofold.sim.output.run_files import scene_digest
from morphofold.sim.output.stages import read_volume
from morphofold.sim.run import simulate

TINY = [
    "geometry.portion=octant",
    "accuracy.edge=9.82",
    "growth.rate=4",
    "growth.final=1.15",
    "output.stages=[1.1]",
    "effects.perturbation.wavelength=20",
    "output.checkpoint_minutes=1e-6",
]
FURTHER = [*TINY, "growth.final=1.25", "output.stages=[1.05, 1.1, 1.15, 1.2]"]


class Look(Effect):
    """Keeps the first state that a run measures."""

    name = "look"
    state = None

    def refresh(self, run):
        if self.state is None:
            self.state = (run.state.x.copy(), run.state.v.copy(), run.state.growth, run.body.growth)


def positions(out, g):
    return read_volume(out / "stages" / f"g{g:.2f}" / "volume.vtu")[1]


def apart(one, other, g):
    """Largest distance between the nodes of two runs [mm]."""
    return np.linalg.norm(positions(one.path, g) - positions(other.path, g), axis=1).max()


def stopping(out, share=0.85):
    def stop(done, text):
        if done > share and (out / "checkpoint.npz").exists():
            raise Stop

    return stop


def stop(out, share=0.85, settings=TINY, **given):
    with pytest.raises(Stop):
        simulate("demo", out, settings=settings, progress=stopping(out, share), **given)
    return out


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A finished run to g = 1.15."""
    return simulate("demo", tmp_path_factory.mktemp("restart") / "other", settings=TINY).path


def test_equilibrium_is_the_same_by_way_of_a_restart(tmp_path):
    """Before folds the body has one equilibrium at each growth and material, however it came there."""
    slow = [*TINY, "growth.rate=0.1"]
    stiff = [*slow, "material.mu_ratio=2"]
    soft = simulate("demo", tmp_path / "soft", settings=slow)
    again = simulate("demo", tmp_path / "again", settings=slow, restart_from=soft.path / "stages" / "g1.10")
    hard = simulate("demo", tmp_path / "hard", settings=stiff)
    hardened = simulate("demo", tmp_path / "hardened", settings=stiff, restart_from=soft.path / "stages" / "g1.10")
    assert apart(soft, hard, 1.15) > 0.05  # what there is to tell apart [mm]
    assert apart(soft, again, 1.15) < 1e-4  # seen: 5e-6, forces have 32 bits
    assert apart(hard, hardened, 1.15) < 5e-3  # both rest within 0.05 T of 8 mm


def test_a_run_begins_at_rest_at_the_positions_and_the_growth_of_the_last_stage(other, tmp_path):
    look = Look()
    run = simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=other, effects=[look])
    x, v, growth, grown = look.state
    np.testing.assert_array_equal(x, positions(other, 1.15))
    assert not v.any()
    assert growth == grown == 1.15
    assert run.stages == (1.15, 1.2, 1.25)  # none below where it began
    assert [stage["growth"] for stage in run.health["stages"]] == [1.15, 1.2, 1.25]
    lines = [json.loads(line) for line in (run.path / "log.jsonl").read_text().splitlines()]
    assert lines[0]["growth"] >= 1.15
    assert simulate("demo", run.path, settings=FURTHER, resume=True, effects=[look]).stages == run.stages


def test_a_run_begins_with_the_velocities_of_a_checkpoint(tmp_path):
    out, look = stop(tmp_path / "stopped"), Look()
    simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=out, effects=[look])
    with np.load(out / "checkpoint.npz") as checkpoint:
        assert 1.1 < checkpoint["growth"] <= 1.15
        assert checkpoint["v"].any()
        for mine, name in zip(look.state, ("x", "v", "growth")):
            np.testing.assert_array_equal(mine, checkpoint[name])


def test_a_stage_written_after_the_checkpoint_is_taken(other, tmp_path):
    out = stop(tmp_path / "stopped")
    shutil.copytree(other / "stages" / "g1.15", out / "stages" / "g1.15")
    look = Look()
    simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=out, effects=[look])
    assert look.state[2] == 1.15


def test_the_folder_says_where_its_run_began(other, tmp_path):
    run = simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=other / "stages" / "g1.10")
    file = other / "stages" / "g1.10" / "volume.vtu"
    assert json.loads((run.path / "inputs.json").read_text())["restart"] == {
        "file": str(file),
        "sha256": sha256_of(file),
        "scene_sha256": scene_digest(other),
        "growth": 1.1,
    }
    stage = json.loads((run.path / "stages" / "g1.20" / "stage.json").read_text())
    assert stage["scene_sha256"] == scene_digest(run.path)  # which the start is part of


def test_a_restarted_run_that_is_stopped_ends_with_the_same_bytes_and_needs_the_other_no_more(other, tmp_path):
    whole = simulate("demo", tmp_path / "whole", settings=FURTHER, restart_from=other)
    moved = shutil.copytree(other, tmp_path / "moved")
    out = stop(tmp_path / "run", 0.85, FURTHER, restart_from=moved)
    shutil.rmtree(moved)
    simulate("demo", out, settings=FURTHER, resume=True)
    np.testing.assert_array_equal(positions(out, 1.25), positions(whole.path, 1.25))


def test_without_a_checkpoint_the_same_state_is_begun_at_again_or_none(other, tmp_path):
    whole = simulate("demo", tmp_path / "whole", settings=FURTHER, restart_from=other)
    moved = shutil.copytree(other, tmp_path / "moved")
    out = stop(tmp_path / "run", 0.85, FURTHER, restart_from=moved)
    (out / "checkpoint.npz").unlink()
    file = moved / "stages" / "g1.15" / "volume.vtu"
    raw = file.read_bytes()
    file.write_bytes((other / "stages" / "g1.10" / "volume.vtu").read_bytes())
    with pytest.raises(Mismatch, match=sha256_of(file)[:12]):
        simulate("demo", out, settings=FURTHER, resume=True)
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"volume\.vtu"):
        simulate("demo", out, settings=FURTHER, resume=True)
    file.write_bytes(raw)
    simulate("demo", out, settings=FURTHER, resume=True, restart_from=moved)
    np.testing.assert_array_equal(positions(out, 1.25), positions(whole.path, 1.25))


def test_a_run_is_not_resumed_as_one_that_began_elsewhere(other, tmp_path):
    run = simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=other)
    plain = simulate("demo", tmp_path / "plain", settings=TINY)
    for out, settings, place in ((run.path, FURTHER, plain.path), (plain.path, TINY, other)):
        with pytest.raises(FileExistsError, match=str(place)):
            simulate("demo", out, settings=settings, resume=True, restart_from=place)


# refusals ----------------------------------------------------------------------------------------------------


def refused(capsys, *words, settings=FURTHER, scene="demo"):
    """What the command says where it is refused: one line, exit code 2."""
    return refused_run(capsys, *words, scene=scene, settings=settings)


@pytest.mark.parametrize(
    ("settings", "numbers"),
    [
        (["accuracy.edge=6.55"], ["427", "889", "[mismatch]"]),
        (["geometry.hole_radius=24.9"], ["0.1 mm", "[mismatch]"]),
        (["effects.perturbation.seed=1"], [" mm ", "[mismatch]"]),
        (["growth.final=1.12", "output.stages=[]"], ["g = 1.15", "1.12", "[out-of-range]"]),
    ],
    ids=lambda value: value[0],
)
def test_another_mesh_or_a_smaller_final_growth_is_refused_with_numbers(other, cwd, capsys, settings, numbers):
    message = refused(capsys, "--restart-from", str(other), settings=[*FURTHER, *settings])
    for number in numbers:
        assert number in message
    assert not (cwd / "run").exists()


def test_another_material_with_the_wavelength_that_is_told_can_be_restarted_with(cwd, capsys):
    """That of the imperfection hangs on the material unless it is set."""
    bare = [s for s in FURTHER if "wavelength" not in s]
    simulate("demo", "other", settings=[*bare, "growth.final=1.1", "output.stages=[]"])
    stiffer = [*bare, "material.mu_ratio=2"]
    message = refused(capsys, "--restart-from", "other", settings=stiffer)
    wavelength = message.partition("effects.perturbation.wavelength = ")[2].partition(",")[0]
    argv = ["simulate", "demo", "-o", "run", "-q", "--restart-from", "other"]
    settings = [*stiffer, f"effects.perturbation.wavelength={wavelength}"]
    assert main([*argv, *(word for s in settings for word in ("--set", s))]) == 0
    assert mf.read_cortex("run").info["g"] == 1.25


def test_where_there_is_no_state_it_is_said(other, cwd, capsys):
    assert "nowhere" in refused(capsys, "--restart-from", "nowhere")
    simulate("fig3", "radial", settings=["output.stages=[]", "growth.final=1.1"])
    simulate("demo", "bare", settings=[*TINY, "output.volume=false"])
    for name in ("radial", "bare", "bare/stages/g1.10"):
        message = refused(capsys, "--restart-from", name)
        assert f"{name}: " in message
        assert "[missing-part]" in message
    message = refused(capsys, "--restart-from", str(other), settings=[], scene="fig3")
    assert "fig3" in message
    assert "[does-not-apply]" in message
    assert not (cwd / "run").exists()


@pytest.mark.parametrize("option", [["--dry-run"], ["--budget", "1min"], ["--error", "5%"], ["--estimate"]])
def test_options_that_choose_a_mesh_are_refused(other, cwd, capsys, option):
    assert option[0] in refused(capsys, "--restart-from", str(other), *option)


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def with_arrays(**changes):
    def damage(path):
        with np.load(path) as file:
            arrays = {**file, **changes}
        np.savez(path, **{name: array for name, array in arrays.items() if array is not None})

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        cut,
        with_arrays(reference=None),
        with_arrays(x=np.zeros((427, 2))),
        with_arrays(v=np.zeros((3, 3))),
        with_arrays(growth=np.array(np.nan)),
        with_arrays(v=np.full((427, 3), np.inf)),
        with_arrays(x=np.array([None], dtype=object)),
        with_arrays(growth=np.array("one")),
    ],
)
def test_a_damaged_checkpoint_is_not_begun_at(stopped, cwd, capsys, damage):
    shutil.copytree(stopped, "other")
    damage(cwd / "other" / "checkpoint.npz")
    assert "other/checkpoint.npz" in refused(capsys, "--restart-from", "other")
    assert not (cwd / "run").exists()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    return stop(tmp_path_factory.mktemp("restart") / "stopped")


@pytest.mark.parametrize("name", ["volume.vtu", "stage.json", "surf/lh.pial"])
def test_a_damaged_stage_is_not_begun_at(other, cwd, capsys, name):
    shutil.copytree(other, "other")
    cut(cwd / "other" / "stages" / "g1.15" / name)
    assert "other/stages/g1.15" in refused(capsys, "--restart-from", "other")
    assert not (cwd / "run").exists()


def test_no_error_is_estimated_of_a_run_whose_scene_does_not_tell_all(other, tmp_path):
    run = simulate("demo", tmp_path / "run", settings=FURTHER, restart_from=other)
    with pytest.raises(ValueError, match="restart"):
        estimate_error(run)
    assert not (run.path / "coarser").exists()
