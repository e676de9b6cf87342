import errno
import fcntl
import os
import re
import subprocess
import sys

import pytest

from morphofold.errors import WrongFile
from morphofold.io import locks
from morphofold.io.locks import LOCK_FILE, alone


def test_a_folder_is_held_by_one_and_free_again_afterwards(tmp_path):
    folder = tmp_path / "run"
    with alone(folder):
        with pytest.raises(FileExistsError, match=rf"run: .*\b{os.getpid()}\b"):
            with alone(folder):
                pytest.fail("held twice")
        assert (folder / LOCK_FILE).exists()  # the refused one took nothing away
        with alone(tmp_path / "another"):
            pass
    assert not (folder / LOCK_FILE).exists()
    with alone(folder):
        pass


def test_a_folder_that_was_made_and_left_empty_goes_again_and_one_that_was_there_or_is_filled_stays(tmp_path):
    there = tmp_path / "there"
    there.mkdir()
    for folder in (there, tmp_path / "a" / "b", tmp_path / "filled"):
        with pytest.raises(ZeroDivisionError), alone(folder):
            if folder.name == "filled":
                (folder / "x").write_text("x")
            1 / 0  # noqa: B018
    assert sorted(p.name for p in tmp_path.iterdir()) == ["filled", "there"]


def test_a_lock_is_never_taken_on_what_a_link_points_to(tmp_path):
    folder, victim = tmp_path / "run", tmp_path / "victim"
    folder.mkdir()
    victim.write_text("mine")
    (folder / LOCK_FILE).symlink_to(victim)
    with pytest.raises(WrongFile, match=re.escape(str(folder / LOCK_FILE))), alone(folder):
        pytest.fail("held")
    assert victim.read_text() == "mine"
    assert (folder / LOCK_FILE).is_symlink()


@pytest.mark.parametrize("there", ["file", "link to nothing"])
def test_what_is_no_folder_is_told_as_such_and_not_as_held(tmp_path, there):
    folder = tmp_path / "run"
    if there == "file":
        folder.write_text("mine")
    else:
        folder.symlink_to(tmp_path / "nowhere")
    with pytest.raises(NotADirectoryError, match=re.escape(f"{folder}: ")), alone(folder):
        pytest.fail("held")
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_a_killed_process_holds_nothing(tmp_path):
    folder = tmp_path / "run"
    code = (
        "import sys, time, pathlib; from morphofold.io.locks import alone\n"
        f"with alone(pathlib.Path({str(folder)!r})):\n    print('held', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    with pytest.raises(FileExistsError, match=rf"run: .*\b{process.pid}\b"):
        with alone(folder):
            pytest.fail("held twice")
    process.kill()
    process.wait()
    assert (folder / LOCK_FILE).exists()
    with alone(folder):
        pass
    assert list(folder.iterdir()) == []


def test_a_lock_whose_file_was_removed_meanwhile_is_taken_on_the_new_file(tmp_path, monkeypatch):
    folder, lock, removed = tmp_path, locks._try_lock, []

    def after_removal(file):
        lock(file)
        if not removed:
            removed.append(True)
            (folder / LOCK_FILE).unlink()  # as its last holder does, just before

    monkeypatch.setattr(locks, "_try_lock", after_removal)
    with alone(folder), (folder / LOCK_FILE).open("a+") as again:
        with pytest.raises(BlockingIOError):
            fcntl.flock(again, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_a_file_system_without_locks_is_warned_of(tmp_path, monkeypatch):
    def none(file):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(locks, "_try_lock", none)
    with pytest.warns(UserWarning, match=re.escape(f"{tmp_path}: ")), alone(tmp_path):
        pass
