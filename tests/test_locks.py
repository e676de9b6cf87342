import re
import subprocess
import sys

import pytest

from morphofold.io.folders import LOCK_FILE, alone


def test_a_folder_is_held_by_one_and_free_again_afterwards(tmp_path):
    folder = tmp_path / "run"
    with alone(folder):
        with pytest.raises(FileExistsError, match=re.escape(f"{folder}: ")):
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
        "import sys, time, pathlib; from morphofold.io.folders import alone\n"
        f"with alone(pathlib.Path({str(folder)!r})):\n    print('held', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    with pytest.raises(FileExistsError, match=re.escape(f"{folder}: ")):
        with alone(folder):
            pytest.fail("held twice")
    process.kill()
    process.wait()
    assert (folder / LOCK_FILE).exists()
    with alone(folder):
        pass
    assert list(folder.iterdir()) == []
