"""Folders that were stopped, damaged, mixed up or run into twice, and what --resume says of them."""

import hashlib
import json
import os
import re
import shutil
import signal

import meshio
import numpy as np
import pytest
from commands import refused_run
from made_simulations import TINY, cut, stop_run, with_arrays
from test_mesh_from_file import ball, write

from morphofold.cli import main
from morphofold.io.folders import LOCK_FILE
from morphofold.sim.output.folder import FolderWriter
from morphofold.sim.output.run_files import clear_run, files_of_run, is_temporary, remove_temporaries
from morphofold.simulation import simulate


@pytest.fixture
def copy_of(tmp_path, monkeypatch):
    """A function that copies a folder here, as ``run``."""
    monkeypatch.chdir(tmp_path)

    def copy(folder):
        shutil.copytree(folder, tmp_path / "run")
        return tmp_path / "run"

    return copy


def resumed(capsys, *options, scene="demo", settings=TINY):
    """What ``simulate --resume`` says where it is refused: one line, exit code 2, nothing written."""
    return refused_run(capsys, *options, scene=scene, settings=settings)


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def flipped(path):
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0x10
    path.write_bytes(raw)


def other_json(path):
    path.write_text('{"a": 1}\n')


def without_a_line(path):
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2] + lines[3:]))


def removed(path):
    path.unlink()


DAMAGE = {
    "checkpoint.npz": [flipped, with_arrays(v=None), with_arrays(x=np.zeros((3, 3)))],
    "log.jsonl": [other_json, without_a_line, removed],
    "stages/g1.10/stage.json": [other_json, removed],
    "stages/g1.10/surf/lh.pial": [flipped, removed],
    "stages/g1.10/files.json": [cut],
    "scene.toml": [cut],
}


@pytest.mark.parametrize(("name", "damage"), [(name, damage) for name, list_ in DAMAGE.items() for damage in list_])
def test_a_damaged_run_is_refused_in_one_line_and_left_as_it_is(stopped_run, copy_of, name, damage, capsys):
    out = copy_of(stopped_run)
    damage(out / name)
    before = contents(out)
    message = resumed(capsys, "--resume")
    assert f"run/{name.partition('/surf')[0].removesuffix('/volume.vtu')}" in message
    if name in ("checkpoint.npz", "log.jsonl") and damage is not removed:
        assert message.endswith(" [damaged-file]\n")
    assert contents(out) == before


def test_the_cure_that_is_told_cures(finished_run, stopped_run, copy_of, capsys):
    out = copy_of(stopped_run)
    flipped(out / "checkpoint.npz")
    assert re.search(r"\brun/checkpoint\.npz: .*\[damaged-file\]$", resumed(capsys, "--resume"))
    (out / "checkpoint.npz").unlink()
    simulate("demo", out, settings=TINY, resume=True)
    for g in ("g1.10", "g1.20"):
        for name in ("lh.white", "lh.pial"):
            ends = [(o / "stages" / g / "surf" / name).read_bytes() for o in (finished_run, out)]
            assert ends[0][ends[0].index(b"\n\n") :] == ends[1][ends[1].index(b"\n\n") :]


def test_a_stage_that_is_gone_is_not_written_with_the_shape_of_a_later_growth(stopped_run, copy_of, capsys):
    out = copy_of(stopped_run)
    shutil.rmtree(out / "stages" / "g1.10")
    message = resumed(capsys, "--resume")
    assert re.search(r"\brun/stages/g1\.10: .*\brun/checkpoint\.npz\b.*\bg = 1\.\d+\b.*\[missing-part\]$", message)
    (out / "checkpoint.npz").unlink()
    assert simulate("demo", out, settings=TINY, resume=True).stages == (1.1, 1.2)


@pytest.mark.parametrize("damage", [cut, other_json])
def test_a_finished_run_whose_health_is_damaged_is_refused(finished_run, copy_of, damage, capsys):
    damage(copy_of(finished_run) / "health.json")
    message = resumed(capsys, "--resume")
    kind = "not-readable" if damage is other_json else "damaged-file"
    assert re.search(rf"\brun/health\.json: .*\[{kind}\]$", message)


@pytest.mark.parametrize(
    ("name", "damage"), [("stage.json", other_json), ("surf/lh.sulc", removed), ("volume.vtu", flipped)]
)
def test_a_finished_run_with_a_damaged_stage_is_refused(finished_run, copy_of, name, damage, capsys):
    damage(copy_of(finished_run) / "stages" / "g1.20" / name)
    message = resumed(capsys, "--resume")
    assert re.search(r"\brun/stages/g1.20\b.* run/stages/g1.20 and run/health\.json\b.*--resume\b", message)


def test_a_finished_run_without_a_stage_is_refused_and_the_cure_makes_it_whole(finished_run, copy_of, capsys):
    out = copy_of(finished_run)
    stage = out / "stages" / "g1.10"
    shutil.rmtree(stage)
    message = resumed(capsys, "--resume")
    assert re.search(r"\brun/stages/g1.10: .*\brun/health\.json\b.*\[missing-part\]$", message)
    (out / "health.json").unlink()
    simulate("demo", out, settings=TINY, resume=True)
    assert (stage / "volume.vtu").stat().st_size == (finished_run / "stages" / "g1.10" / "volume.vtu").stat().st_size


def test_a_stage_of_another_scene_is_refused(finished_run, copy_of, capsys):
    out = copy_of(finished_run)
    shutil.copytree(out / "stages" / "g1.10", out / "stages" / "g1.15")
    (out / "health.json").unlink()
    assert re.search(r"\brun/stages/g1\.15: .*\[mismatch\]$", resumed(capsys, "--resume"))


# one run to a folder -----------------------------------------------------------------------------------------


def test_a_second_run_into_a_folder_is_refused_while_the_first_goes_on(cwd, capsys):
    out, messages = cwd / "run", []

    def second(share, text):
        if messages:
            return
        (out / "scene.toml").rename(cwd / "scene.toml")  # as if the first had not come so far yet
        messages.extend([resumed(capsys), resumed(capsys, "--resume")])
        (cwd / "scene.toml").rename(out / "scene.toml")
        messages.append(resumed(capsys, "--resume"))
        assert re.search(r"\brun: .*\bresume\b", resumed(capsys))

    assert simulate("demo", "run", settings=TINY, progress=second).stages == (1.1, 1.2)
    assert len(messages) == 3
    assert all("run: another run" in line for line in messages)
    assert not (out / LOCK_FILE).exists()


@pytest.fixture(scope="module")
def of_another_seed(tmp_path_factory):
    """A run like ``stopped_run``, of the same mesh and another seed, stopped where that was."""
    return stop_run(tmp_path_factory.mktemp("folder") / "run", [*TINY, "effects.perturbation.seed=5"])


@pytest.mark.parametrize("taken", [["checkpoint.npz", "log.jsonl"], ["stages/g1.10"]], ids=" ".join)
def test_nothing_of_another_run_is_gone_on_from(stopped_run, of_another_seed, copy_of, capsys, taken):
    """All of it has the right shape, and sums that are right."""
    out = copy_of(stopped_run)
    for name in taken:
        if (out / name).is_dir():
            shutil.rmtree(out / name)
            shutil.copytree(of_another_seed / name, out / name)
        else:
            shutil.copy(of_another_seed / name, out / name)
    before = contents(out)
    assert taken[0].partition("/")[0] in resumed(capsys, "--resume")
    assert contents(out) == before


def test_a_checkpoint_of_another_version_is_not_gone_on_from(stopped_run, copy_of, capsys, monkeypatch):
    with_arrays(earliest_rest=None)(copy_of(stopped_run) / "checkpoint.npz")
    monkeypatch.setattr("morphofold.sim.body_run.__version__", "0.0.0")
    assert re.search(r"\brun/checkpoint\.npz: .*\[mismatch\]$", resumed(capsys, "--resume"))


def test_only_what_a_run_wrote_is_cleared(finished_run, copy_of):
    out = copy_of(finished_run)
    (out / "stages" / "g1.10" / "NOTES.txt").write_text("mine")
    before = contents(out)
    with pytest.raises(FileExistsError, match=r"NOTES\.txt"):
        clear_run(out)
    assert contents(out) == before
    (out / "stages" / "g1.10" / "NOTES.txt").unlink()
    (out / "stages" / "g1.10" / ".morphofold").write_text("of a version without lists")
    assert set(files_of_run(finished_run)) == {
        name for name in contents(finished_run) if not name.endswith(".morphofold")
    }
    clear_run(out)
    assert not out.exists()


def test_without_resume_no_checkpoint_is_taken_up(stopped_run, copy_of, capsys, monkeypatch):
    out = copy_of(stopped_run)
    assert re.search(r"\brun: .*\bresume\b", resumed(capsys))
    (out / "scene.toml").unlink()  # then it is nothing that we know
    for options in ((), ("--resume",)):
        assert re.search(r"\brun: (?!.*\bresume\b)", resumed(capsys, *options))


# the mesh file -----------------------------------------------------------------------------------------------


MESH = ["geometry.cortex_thickness=20", "growth.final=1.02", "growth.rate=4"]


def test_a_mesh_file_that_changed_is_refused_until_it_is_put_back(cwd, capsys):
    write(cwd / "body.vtu", *ball(2))
    (cwd / "mesh.toml").write_text('name = "body"\n[geometry]\nshape = "mesh"\nfile = "body.vtu"\n')
    out = simulate("mesh.toml", cwd / "run", settings=MESH).path
    raw = (cwd / "body.vtu").read_bytes()
    mesh = meshio.read("body.vtu")
    mesh.points[-1] *= 1 + 1e-9
    mesh.write("body.vtu")
    message = resumed(capsys, "--resume", scene="mesh.toml", settings=MESH)
    then, now = (hashlib.sha256(content).hexdigest()[:12] for content in (raw, (cwd / "body.vtu").read_bytes()))
    assert re.search(rf"\bbody\.vtu: .*\b{then}\b.*\b{now}\b.*\[mismatch\]$", message)
    (cwd / "body.vtu").write_bytes(raw)
    assert simulate("mesh.toml", out, settings=MESH, resume=True).stages == (1.02,)
    (cwd / "body.vtu").unlink()
    message = resumed(capsys, "--resume", scene="mesh.toml", settings=MESH)
    assert "body.vtu: " in message


def test_a_run_whose_level_stood_for_another_mesh_is_refused(cwd, capsys):
    settings = [*TINY, "accuracy.edge=20"]
    out = cwd / "run"
    simulate("demo", out, settings=settings)
    began = json.loads((out / "inputs.json").read_text())
    assert began == {"accuracy": {"edge": 20.0, "elements_through_cortex": 2}}
    (out / "inputs.json").write_text(json.dumps({"accuracy": {"edge": 24.0, "elements_through_cortex": 3}}))
    message = resumed(capsys, "--resume", settings=settings)
    assert re.search(r"\brun/inputs\.json: .*\b24\.0.*\b20\.0.*\b3\b.*\b2\b.*\[mismatch\]$", message)
    other_json(out / "inputs.json")
    assert "run/inputs.json: " in resumed(capsys, "--resume", settings=settings)


# what a killed run leaves ------------------------------------------------------------------------------------


def test_what_a_killed_run_had_not_finished_writing_is_swept_and_nothing_else(stopped_run, copy_of, tmp_path):
    out = copy_of(stopped_run)
    before = contents(out)
    ours = [
        ".0a1b2c3d.checkpoint.npz",
        ".0a1b2c3d.log.jsonl",
        ".ffffffff.scene.toml",
        "stages/.g1.20.01234567",
        "stages/.g1.10.01234567.old",
    ]
    others = [".0a1b2c3d.mine.npz", ".hidden", ".0a1b2c.log.jsonl", "stages/.g1.20.mine", "0a1b2c3d.log.jsonl"]
    for name in (*ours, *others):
        path = out / name
        if "stages" in name:
            path.mkdir()
            path /= "x"
        path.write_text("x")
    remove_temporaries(out)
    assert {name for name in ours if (out / name).exists()} == set()
    assert {name for name in others if (out / name).exists()} == set(others)
    assert before.items() <= contents(out).items()
    (out / ".0a1b2c3d.checkpoint.npz").write_text("x")
    assert simulate("demo", out, settings=TINY, resume=True).stages == (1.1, 1.2)
    assert not [p for p in out.iterdir() if is_temporary(p)]
    new = tmp_path / "new"
    new.mkdir()
    (new / ".0a1b2c3d.scene.toml").write_text("x")
    (new / LOCK_FILE).write_text("1")
    simulate("fig3", new, settings=["output.stages=[]"])
    assert {p.name for p in new.iterdir()} == {"scene.toml", "log.jsonl", "health.json", "stages"}


# too late to stop --------------------------------------------------------------------------------------------


def test_a_signal_when_the_run_is_finished_stops_what_follows(cwd, monkeypatch, capsys, usual_signals):
    health, number = FolderWriter.health, signal.SIGTERM

    def late(self, *options, **numbers):
        health(self, *options, **numbers)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(FolderWriter, "health", late)
    before = signal.getsignal(number)
    command = ["simulate", "demo", "-o", "run", "-q", *(word for s in TINY for word in ("--set", s))]
    assert main(command) == 130
    assert re.fullmatch(r"morphofold simulate: .*--resume\b.*\n", capsys.readouterr().err)
    assert signal.getsignal(number) is before
    assert main([*command, "--resume"]) == 0
    assert capsys.readouterr().out.startswith("run: 2 stages to g = 1.20")
