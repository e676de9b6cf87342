"""Files and folders are written whole or not at all."""

import os
import re
import subprocess
import sys

import pytest

from morphofold.errors import DamagedFile
from morphofold.io import atomic_file, atomic_folder, remove_folder, write_surface
from morphofold.io.files import decoding
from morphofold.io.folders import LOCK_FILE, alone


def interrupt_while_writing(path):
    path.write_text("half")
    raise KeyboardInterrupt


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "a.txt") as temporary:
        interrupt_while_writing(temporary)
    assert os.listdir(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_writing_into_a_folder_that_is_not_there_is_refused(tmp_path, rough):
    with pytest.raises(FileNotFoundError, match=r"no: .*\blh\.white\b"):
        write_surface(tmp_path / "no" / "lh.white", rough)


def test_a_lack_of_memory_is_no_damage(tmp_path):
    with pytest.raises(MemoryError, match=r"a\.gii: .*\bGIFTI\b"), decoding(tmp_path / "a.gii", "GIFTI"):
        raise MemoryError
    with pytest.raises(DamagedFile, match=r"a\.gii: .*\bGIFTI\b"), decoding(tmp_path / "a.gii", "GIFTI"):
        raise RuntimeError


def write_folder(out, content="new"):
    with atomic_folder(out) as folder:
        (folder / "a.txt").write_text(content)
        assert not (out / "a.txt").is_file() or (out / "a.txt").read_text() != content


def test_a_folder_appears_whole_and_is_replaced_whole(tmp_path):
    out = tmp_path / "deep" / "out"
    write_folder(out, "first")
    write_folder(out, "second")
    assert sorted(os.listdir(out)) == [".morphofold", "a.txt"]
    assert (out / "a.txt").read_text() == "second"
    assert os.listdir(tmp_path / "deep") == ["out"]


def tree(folder):
    return {p.relative_to(folder).as_posix(): p.is_file() and p.read_text() for p in folder.rglob("*")}


def test_what_we_did_not_write_stays(tmp_path):
    """Our old file goes, a changed one of ours is replaced; all else stays, be it in a folder or a link."""
    out = tmp_path / "out"
    with atomic_folder(out) as folder:
        (folder / "maps").mkdir()
        for name in ("a.txt", "old.txt", "maps/lh.H", "maps/lh.K"):
            (folder / name).write_text("first")
    (out / "a.txt").write_text("changed by its user")
    (out / "NOTES.txt").write_text("mine")
    (out / "maps" / "lh.mine").write_text("mine")
    (out / "mine" / "deep").mkdir(parents=True)
    (out / "mine" / "deep" / "b.txt").write_text("mine")
    (out / "elsewhere").symlink_to(tmp_path)
    (out / "nowhere").symlink_to("not-there")
    with atomic_folder(out) as folder:
        (folder / "maps").mkdir()
        for name in ("a.txt", "new.txt", "maps/lh.H"):
            (folder / name).write_text("second")
    found = tree(out)
    del found[".morphofold"]
    assert found == {
        "a.txt": "second",
        "new.txt": "second",
        "maps": False,
        "maps/lh.H": "second",
        "maps/lh.mine": "mine",
        "NOTES.txt": "mine",
        "mine": False,
        "mine/deep": False,
        "mine/deep/b.txt": "mine",
        "elsewhere": False,
        "nowhere": False,
    }
    assert os.readlink(out / "elsewhere") == os.fspath(tmp_path)
    assert os.listdir(tmp_path) == ["out"]
    remove_folder(out)
    assert set(found) - set(tree(out)) == {"a.txt", "new.txt", "maps/lh.H"}
    write_folder(out)  # it is ours still
    assert (out / "NOTES.txt").read_text() == "mine"


@pytest.mark.parametrize(("theirs", "ours"), [("b", "b"), ("b/mine.txt", "b"), ("b", "b/ours.txt")])
def test_what_we_did_not_write_is_not_written_over(tmp_path, theirs, ours):
    out = tmp_path / "out"
    write_folder(out, "first")
    (out / theirs).parent.mkdir(exist_ok=True)
    (out / theirs).write_text("mine")
    before = tree(out)
    refused = pytest.raises(FileExistsError, match=re.escape(f"{out / theirs}: "))
    with refused, atomic_folder(out) as folder:
        (folder / ours).parent.mkdir(exist_ok=True)
        (folder / ours).write_text("ours")
    assert tree(out) == before
    assert os.listdir(tmp_path) == ["out"]


def test_a_failed_folder_leaves_the_old_one_and_nothing_else(tmp_path):
    write_folder(tmp_path / "out", "first")
    for out in (tmp_path / "out", tmp_path / "new" / "deep"):
        with pytest.raises(KeyboardInterrupt), atomic_folder(out) as folder:
            interrupt_while_writing(folder / "a.txt")
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out" / "a.txt").read_text() == "first"


def test_an_empty_folder_is_replaced(tmp_path):
    (tmp_path / "empty").mkdir()
    write_folder(tmp_path / "empty")
    assert (tmp_path / "empty" / "a.txt").is_file()


@pytest.mark.parametrize("content", ["not json", '{"morphofold": "0.1.0"}'])
def test_a_folder_of_somebody_else_is_never_replaced(tmp_path, content):
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(FileExistsError, match=rf"{re.escape(str(tmp_path))}: .*\bsummary\.json\b"):
        write_folder(tmp_path)
    assert (tmp_path / "summary.json").read_text() == content
    with pytest.raises(FileExistsError, match=r"summary\.json: "):
        write_folder(tmp_path / "summary.json")


def test_a_link_is_replaced_and_not_what_it_points_to(tmp_path):
    (tmp_path / "store").write_text("theirs")
    link = tmp_path / "out.txt"
    link.symlink_to("store")
    with atomic_file(link) as temporary:
        temporary.write_text("ours")
    assert ((tmp_path / "store").read_text(), link.read_text(), link.is_symlink()) == ("theirs", "ours", False)


# --- locks


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
def test_a_lock_in_what_is_no_folder_is_refused(tmp_path, there):
    folder = tmp_path / "run"
    if there == "file":
        folder.write_text("mine")
    else:
        folder.symlink_to(tmp_path / "nowhere")
    with pytest.raises(NotADirectoryError, match=re.escape(f"{folder}")), alone(folder):
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
