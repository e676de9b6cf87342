"""Effects that a caller gives beside those of the scene, and who looks on."""

import json
import re

import numpy as np
import pytest
from made_simulations import Stop

import morphofold as mf
from morphofold.cli import main
from morphofold.errors import DoesNotApply, Mismatch, NamedTwice, NotReadable
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import PHASES_OF_RUN, Effect
from morphofold.sim.effects.core_growth import build
from morphofold.sim.output.stage_records import read_volume
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene

TINY = ["geometry.portion=octant", "accuracy.edge=9.82", "growth.rate=4", "growth.final=1.2", "output.stages=[1.1]"]
OFTEN = [*TINY, "output.checkpoint_minutes=1e-6"]
SWELLING = "effects.core_growth={final = 1.05}"


class Breath(Effect):
    """A force outwards that hangs on how many steps there were: it must come back with a checkpoint."""

    name = "breath"

    def __init__(self, strength=0.05):
        self.strength, self.steps = strength, 0

    def add_forces(self, body, x, v, extra):
        self.steps += 1
        extra += self.strength * np.sin(0.1 * self.steps) * body.mass[: len(extra), None] * x[: len(extra)] / 50

    def record(self):
        return {"steps": self.steps}

    def save(self):
        return {"steps": np.array(self.steps)}

    def load(self, arrays):
        self.steps = arrays["steps"].item()


def named(name):
    effect = Effect()
    effect.name = name
    return effect


def positions(out, g=1.2):
    return read_volume(out / "stages" / f"g{g:.2f}" / "volume.vtu")[1]


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def stopping(out):
    def stop(share, text):
        if share > 0.85 and (out / "checkpoint.npz").exists():
            raise Stop

    return stop


def test_an_effect_does_the_same_whether_its_scene_names_it_or_its_caller_gives_it(tmp_path):
    scene = load_scene("demo", [*TINY, SWELLING])
    swelling = build(scene.effects["core_growth"], scene)
    swelling.name = "swelling"
    by_scene = simulate(scene, tmp_path / "a")
    by_caller = mf.simulate("demo", tmp_path / "b", settings=TINY, effects=[swelling])
    without = simulate("demo", tmp_path / "c", settings=TINY)
    np.testing.assert_array_equal(positions(by_scene.path), positions(by_caller.path))
    assert np.abs(positions(by_scene.path) - positions(without.path)).max() > 0.1
    assert by_caller.health["effects"] == ["contact", "perturbation", "symmetry", "swelling"]


def test_a_stopped_run_with_an_effect_of_ones_own_ends_with_the_same_bytes(tmp_path):
    whole = simulate("demo", tmp_path / "whole", settings=OFTEN, effects=[Breath()])
    calm = simulate("demo", tmp_path / "calm", settings=OFTEN)
    out = tmp_path / "stopped"
    with pytest.raises(Stop):
        simulate("demo", out, settings=OFTEN, effects=[Breath()], progress=stopping(out))
    with np.load(out / "checkpoint.npz") as checkpoint:
        assert 0 < checkpoint["breath.steps"] == checkpoint["step"]
    simulate("demo", out, settings=OFTEN, effects=[Breath()], resume=True)
    np.testing.assert_array_equal(positions(whole.path), positions(out))
    assert np.abs(positions(whole.path) - positions(calm.path)).max() > 1e-3
    assert whole.health["seconds_by_phase"]["breath"] > 0
    last = json.loads((out / "log.jsonl").read_text().splitlines()[-1])
    assert last["effects"]["breath"]["steps"] == last["step"]


@pytest.mark.parametrize(("others", "finished"), [([], True), ([Breath(), named("other")], False)])
def test_a_run_is_not_resumed_without_the_same_effects(tmp_path, finished, others):
    out = tmp_path / "run"
    if finished:
        simulate("demo", out, settings=OFTEN, effects=[Breath()])
    else:
        with pytest.raises(Stop):
            simulate("demo", out, settings=OFTEN, effects=[Breath()], progress=stopping(out))
    before = contents(out)
    with pytest.raises(FileExistsError, match="breath"):
        simulate("demo", out, settings=OFTEN, effects=others, resume=True)
    assert contents(out) == before
    assert simulate("demo", out, settings=OFTEN, effects=[Breath()], resume=True).stages == (1.1, 1.2)


def test_a_run_without_effects_of_ones_own_is_not_resumed_with_some(tmp_path):
    out = simulate("demo", tmp_path / "run", settings=TINY).path
    with pytest.raises(FileExistsError, match="breath"):
        simulate("demo", out, settings=TINY, effects=[Breath()], resume=True)


def test_the_command_says_how_to_resume_a_run_with_effects_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    simulate("demo", "run", settings=TINY, effects=[Breath()])
    before = contents(tmp_path)
    command = ["simulate", "demo", "-o", "run", "-q", *(word for s in TINY for word in ("--set", s)), "--resume"]
    assert main(command) == 2
    stderr = capsys.readouterr().err
    assert len(stderr.splitlines()) == 1
    assert "breath" in stderr
    assert "effects=" in stderr
    assert contents(tmp_path) == before


def test_a_checkpoint_is_not_taken_up_by_a_body_of_another_shape(tmp_path):
    """The parameters of an effect of one's own are nowhere; a shape that it makes is in the checkpoint."""

    class Swollen(Effect):
        name = "swollen"

        def __init__(self, by):
            self.by = by

        def reshape(self, bilayer, X):
            return X * (1 + self.by)

    out = tmp_path / "run"
    with pytest.raises(Stop):
        simulate("demo", out, settings=OFTEN, effects=[Swollen(0.01)], progress=stopping(out))
    with pytest.raises(Mismatch, match=r"checkpoint\.npz: .*\b\d+ 0\.50\d* mm\b"):
        simulate("demo", out, settings=OFTEN, effects=[Swollen(0.02)], resume=True)
    simulate("demo", out, settings=OFTEN, effects=[Swollen(0.01)], resume=True)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("", NotReadable), (7, NotReadable), ("contact", NamedTwice), ("symmetry", NamedTwice), ("elements", NamedTwice)],
)
def test_a_name_that_is_none_or_taken_is_refused(name, kind, tmp_path):
    with pytest.raises(kind, match=re.escape(repr(name))):
        simulate("demo", tmp_path / "run", settings=TINY, effects=[named(name)])
    assert not (tmp_path / "run").exists()


def test_a_name_given_twice_is_refused(tmp_path):
    with pytest.raises(NamedTwice, match="breath"):
        simulate("demo", tmp_path / "run", settings=TINY, effects=[Breath(), Breath()])


def test_what_is_no_effect_is_refused(tmp_path):
    with pytest.raises(TypeError, match="Breath"):
        simulate("demo", tmp_path / "run", settings=TINY, effects=[Breath])  # the class, not one of it


def test_every_phase_of_a_run_is_a_name_that_no_effect_may_have(tmp_path):
    health = simulate("demo", tmp_path / "run", settings=TINY).health
    assert set(health["seconds_by_phase"]) - set(health["effects"]) <= set(PHASES_OF_RUN)


def test_who_looks_on_sees_every_state_and_changes_nothing(tmp_path):
    seen = []

    def watch(run):
        assert isinstance(run, Dynamics)
        radius = np.linalg.norm(run.state.x[: run.body.n_surface], axis=1).mean()
        seen.append((run.state.step, run.state.growth, radius, run.state.record["strain_energy"]))

    plain = simulate("demo", tmp_path / "plain", settings=TINY)
    watched = mf.simulate("demo", tmp_path / "looked", settings=TINY, after=watch)
    np.testing.assert_array_equal(positions(plain.path), positions(watched.path))
    step, growth, radius, energy = np.array(seen).T
    np.testing.assert_array_equal(step, STEPS_PER_MEASUREMENT * np.arange(1, len(step) + 1))
    assert step[-1] == watched.health["steps"]
    assert {1.1, 1.2} <= set(growth)
    assert energy[-1] == watched.health["stages"][-1]["strain_energy"]
    for g in (1.1, 1.2):  # Eq. (11) of a smooth shell
        exact = (47.0**3 + g**3 * (50.0**3 - 47.0**3)) ** (1 / 3)
        assert radius[growth == g][-1] == pytest.approx(exact, rel=1e-2)


@pytest.mark.parametrize("given", [{"effects": [Breath()]}, {"after": print}, {"restart_from": "run"}])
def test_a_scene_in_one_dimension_refuses_what_it_has_no_steps_for(given, tmp_path):
    with pytest.raises(DoesNotApply, match="fig3"):
        simulate("fig3", tmp_path / "run", **given)
    assert not (tmp_path / "run").exists()
