"""Folders that were stopped, damaged, mixed up or run into twice, and what --resume says of them."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import refused_run
from made_simulations import TINY, cut, stop_run, with_arrays
from test_mesh_from_file import ball, write

from morphofold.io.atomic_folders import LOCK_FILE
from morphofold.sim.output.run_inputs import clear_run, files_of_run, is_temporary, remove_temporaries
from morphofold.simulation import simulate


@pytest.fixture
def copy_of(tmp_path, monkeypatch):
    """A function that copies a folder to ``run`` in the working directory."""
    monkeypatch.chdir(tmp_path)
    return lambda folder: Path(shutil.copytree(folder, tmp_path / "run"))


def refused(capsys, says, scene="demo", settings=TINY):
    """``simulate --resume`` is refused in one line that says so, with exit code 2, and nothing is written."""
    assert re.search(says, refused_run(capsys, "--resume", scene=scene, settings=settings))


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


REST = r".* run/stages/g1\.20 and run/health\.json\b.*--resume\b"
DAMAGE = [  # in a run that was stopped, and in one that is finished: of what it says
    ("stopped_run", "checkpoint.npz", flipped, r"\[damaged-file\]$"),
    ("stopped_run", "checkpoint.npz", with_arrays(x=np.zeros((3, 3))), r"\[damaged-file\]$"),
    ("stopped_run", "log.jsonl", without_a_line, r"\[damaged-file\]$"),
    ("stopped_run", "log.jsonl", Path.unlink, ""),
    ("stopped_run", "stages/g1.10/stage.json", other_json, ""),
    ("stopped_run", "stages/g1.10/surf/lh.pial", flipped, ""),
    ("stopped_run", "stages/g1.10/files.json", cut, ""),
    ("stopped_run", "scene.toml", cut, ""),
    ("finished_run", "health.json", cut, r"\[damaged-file\]$"),
    ("finished_run", "health.json", other_json, r"\[not-readable\]$"),
    ("finished_run", "stages/g1.20/stage.json", other_json, REST),
    ("finished_run", "stages/g1.20/surf/lh.sulc", Path.unlink, REST),
    ("finished_run", "stages/g1.20/volume.vtu", flipped, REST),
]


@pytest.mark.parametrize(("run", "name", "damage", "says"), DAMAGE)
def test_a_damaged_run_is_refused_in_one_line_and_left_as_it_is(run, name, damage, says, copy_of, capsys, request):
    out = copy_of(request.getfixturevalue(run))
    damage(out / name)
    before = contents(out)
    part = re.sub(r"(stages/g1\.20|/surf)(/.*)?$", r"\1", name).removesuffix("/surf")
    refused(capsys, rf"\brun/{re.escape(part)}\b.*{says}")
    assert contents(out) == before


@pytest.mark.parametrize(
    ("run", "spoil", "cure", "says"),
    [
        ("stopped_run", flipped, "checkpoint.npz", r"checkpoint\.npz: .*\[damaged-file\]$"),
        # a stage that is gone is not written with the shape of a later growth
        ("stopped_run", None, "checkpoint.npz", r"stages/g1\.10: .*\brun/checkpoint\.npz\b.*\bg = 1\.\d+"),
        ("finished_run", None, "health.json", r"stages/g1\.10: .*\brun/health\.json\b.*\[missing-part\]$"),
    ],
)
def test_the_cure_that_is_told_makes_a_run_whole(finished_run, run, spoil, cure, says, copy_of, capsys, request):
    out = copy_of(request.getfixturevalue(run))
    spoil(out / cure) if spoil else shutil.rmtree(out / "stages" / "g1.10")
    refused(capsys, rf"\brun/{says}")
    (out / cure).unlink()
    assert simulate("demo", out, settings=TINY, resume=True).stages == (1.1, 1.2)
    for name in ("g1.10/surf/lh.white", "g1.20/surf/lh.pial"):
        files = [(folder / "stages" / name).read_bytes() for folder in (finished_run, out)]
        assert files[0].partition(b"\n\n")[2] == files[1].partition(b"\n\n")[2]


def test_a_stage_of_another_scene_is_refused(finished_run, copy_of, capsys):
    out = copy_of(finished_run)
    shutil.copytree(out / "stages" / "g1.10", out / "stages" / "g1.15")
    (out / "health.json").unlink()
    refused(capsys, r"\brun/stages/g1\.15: .*\[mismatch\]$")


def test_a_second_run_into_a_folder_is_refused_while_the_first_goes_on(cwd, capsys):
    refusals = []

    def second(fraction, text):
        if not refusals:
            for options in ([], ["--resume"]):
                refusals.append(refused_run(capsys, *options, scene="demo", settings=TINY))

    assert simulate("demo", "run", settings=TINY, progress=second).stages == (1.1, 1.2)
    assert ["run: another run" in message for message in refusals] == [False, True]
    assert not (cwd / "run" / LOCK_FILE).exists()


@pytest.fixture(scope="module")
def of_another_seed(tmp_path_factory):
    """A run like ``stopped_run``, of the same mesh and another seed, stopped where that was."""
    return stop_run(tmp_path_factory.mktemp("folder") / "run", [*TINY, "effects.perturbation.seed=5"])


@pytest.mark.parametrize("parts", [("checkpoint.npz", "log.jsonl"), ("stages/g1.10",)], ids=" ".join)
def test_nothing_of_another_run_is_gone_on_from(stopped_run, of_another_seed, copy_of, capsys, parts):
    """All of it has the right shape, and sums that are right."""
    out = copy_of(stopped_run)
    for name, content in contents(of_another_seed).items():
        if name.startswith(parts):
            (out / name).write_bytes(content)
    refused(capsys, parts[0].partition("/")[0])


def test_a_checkpoint_of_another_version_is_not_gone_on_from(stopped_run, copy_of, capsys, monkeypatch):
    with_arrays(earliest_rest=None)(copy_of(stopped_run) / "checkpoint.npz")
    monkeypatch.setattr("morphofold.sim.body_run.__version__", "0.0.0")
    refused(capsys, r"\brun/checkpoint\.npz: .*\[mismatch\]$")


def test_only_what_a_run_wrote_is_cleared(finished_run, copy_of):
    out = copy_of(finished_run)
    (out / "stages" / "g1.10" / "NOTES.txt").write_text("mine")
    before = contents(out)
    with pytest.raises(FileExistsError, match=r"NOTES\.txt"):
        clear_run(out)
    assert contents(out) == before
    (out / "stages" / "g1.10" / "NOTES.txt").unlink()
    (out / "stages" / "g1.10" / ".morphofold").write_text("of a version without lists")
    assert {*files_of_run(finished_run)} == {name for name in before if not name.endswith((".morphofold", "NOTES.txt"))}
    clear_run(out)
    assert not out.exists()


def test_without_resume_no_checkpoint_is_taken_up(stopped_run, copy_of, capsys):
    out = copy_of(stopped_run)
    assert re.search(r"\brun: .*\bresume\b", refused_run(capsys, scene="demo", settings=TINY))
    (out / "scene.toml").unlink()  # then it is nothing that we know
    refused(capsys, r"\brun: (?!.*\bresume\b)")


# the mesh file -----------------------------------------------------------------------------------------------


def test_a_mesh_file_that_changed_is_refused_until_it_is_put_back(cwd, capsys):
    settings = ["geometry.cortex_thickness=20", "growth.final=1.02", "growth.rate=4"]
    body = write(cwd / "body.vtu", *ball(2))
    (cwd / "mesh.toml").write_text('name = "body"\n[geometry]\nshape = "mesh"\nfile = "body.vtu"\n')
    out = simulate("mesh.toml", cwd / "run", settings=settings).path
    raw = body.read_bytes()
    write(body, *ball(1))
    then, now = (hashlib.sha256(content).hexdigest()[:12] for content in (raw, body.read_bytes()))
    changed = rf"\bbody\.vtu: .*\b{then}\b.*\b{now}\b.*\[mismatch\]$"
    refused(capsys, changed, scene="mesh.toml", settings=settings)
    body.write_bytes(raw)
    assert simulate("mesh.toml", out, settings=settings, resume=True).stages == (1.02,)


def test_a_run_whose_level_stood_for_another_mesh_is_refused(cwd, capsys):
    settings = [*TINY, "accuracy.edge=20"]
    inputs = simulate("demo", cwd / "run", settings=settings).path / "inputs.json"
    assert json.loads(inputs.read_text()) == {"accuracy": {"edge": 20.0, "elements_through_cortex": 2}}
    inputs.write_text(json.dumps({"accuracy": {"edge": 24.0, "elements_through_cortex": 3}}))
    changed = r"\brun/inputs\.json: .*\b24\.0.*\b20\.0.*\b3\b.*\b2\b.*\[mismatch\]$"
    refused(capsys, changed, settings=settings)


# what a killed run leaves ------------------------------------------------------------------------------------


def test_what_a_killed_run_had_not_finished_writing_is_swept_and_nothing_else(stopped_run, copy_of):
    out = copy_of(stopped_run)
    before = contents(out)
    ours = [".0a1b2c3d.checkpoint.npz", ".ffffffff.scene.toml", "stages/.g1.20.01234567", "stages/.g1.10.01234567.old"]
    others = [".0a1b2c3d.mine.npz", ".hidden", ".0a1b2c.log.jsonl", "stages/.g1.20.mine", "0a1b2c3d.log.jsonl"]
    for name in (*ours, *others):
        path = out / name
        if "stages" in name:
            path.mkdir()
            path /= "x"
        path.write_text("x")
    remove_temporaries(out)
    assert [name for name in (*ours, *others) if (out / name).exists()] == others
    assert before.items() <= contents(out).items()
    (out / ".0a1b2c3d.checkpoint.npz").write_text("x")
    assert simulate("demo", out, settings=TINY, resume=True).stages == (1.1, 1.2)
    assert not [p for p in out.iterdir() if is_temporary(p)]
