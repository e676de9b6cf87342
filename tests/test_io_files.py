"""Files and folders are written whole or not at all."""

import errno
import os
import shutil
from xml.parsers.expat import ExpatError

import pytest

import morphofold.io.folders as folders
from morphofold.io import atomic_file, atomic_folder, sample_path, write_surface
from morphofold.io.files import decoding
from morphofold.shapes import icosphere
from morphofold.surface import Surface


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
    with pytest.raises(FileNotFoundError, match=r"no such folder to write lh.white into"):
        write_surface(tmp_path / "no" / "lh.white", rough)


def expat_error(code):
    error = ExpatError("out of memory: line 1, column 0")
    error.code = code
    return error


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.ENOMEM, "Cannot allocate memory"), expat_error(1)])
def test_a_lack_of_memory_is_no_damage(tmp_path, error):
    def reads_within():
        try:
            raise error
        except Exception as cause:
            raise RuntimeError("a package's own words") from cause

    with pytest.raises(MemoryError, match=r"a.gii: memory did not suffice to read GIFTI. Close other programs"):
        with decoding(tmp_path / "a.gii", "GIFTI"):
            reads_within()
    with pytest.raises(ValueError, match="damaged"), decoding(tmp_path / "a.gii", "GIFTI"):
        raise expat_error(3)


def write_folder(out, content="new"):
    with atomic_folder(out) as folder:
        (folder / "a.txt").write_text(content)
        assert not (out / "a.txt").is_file() or (out / "a.txt").read_text() != content


def test_a_folder_appears_whole_and_is_replaced_whole(tmp_path):
    out = tmp_path / "deep" / "out"
    write_folder(out, "first")
    (out / "stale.txt").touch()
    write_folder(out, "second")
    assert sorted(os.listdir(out)) == [".morphofold", "a.txt"]
    assert (out / "a.txt").read_text() == "second"
    assert os.listdir(tmp_path / "deep") == ["out"]


def test_a_failed_folder_leaves_the_old_one_and_nothing_else(tmp_path):
    write_folder(tmp_path / "out", "first")
    for out in (tmp_path / "out", tmp_path / "new" / "deep"):
        with pytest.raises(KeyboardInterrupt), atomic_folder(out) as folder:
            interrupt_while_writing(folder / "a.txt")
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out" / "a.txt").read_text() == "first"


def test_an_empty_folder_and_one_with_our_summary_are_replaced(tmp_path):
    (tmp_path / "empty").mkdir()
    write_folder(tmp_path / "empty")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "summary.json").write_text('{"morphofold": "0.1.0"}')
    write_folder(tmp_path / "old")
    assert not (tmp_path / "old" / "summary.json").exists()


@pytest.mark.parametrize("content", ["{}", "[]", "not json"])
def test_a_folder_of_somebody_else_is_never_replaced(tmp_path, content):
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(FileExistsError, match=r"morphofold did not write this folder.*summary.json"):
        write_folder(tmp_path)
    assert (tmp_path / "summary.json").read_text() == content
    with pytest.raises(FileExistsError, match="is a file; name a folder"):
        write_folder(tmp_path / "summary.json")


def test_a_folder_that_somebody_fills_meanwhile_is_not_replaced(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(FileExistsError, match="did not write"), atomic_folder(out):
        shutil.copytree(sample_path("S1"), out)
    assert os.listdir(tmp_path) == ["out"]
    assert sorted(os.listdir(out)) == sorted(os.listdir(sample_path("S1")))


def test_a_move_that_fails_puts_the_old_folder_back(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_folder(out, "first")
    replace = os.replace

    def fail_once(source, target):
        if os.fspath(target) == os.fspath(out) and not os.fspath(source).endswith(".old"):
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr(folders, "_exchange", lambda one, other: False)        # as on a system that cannot
    monkeypatch.setattr(folders.os, "replace", fail_once)
    with pytest.raises(OSError, match="disk full"):
        write_folder(out, "second")
    assert os.listdir(tmp_path) == ["out"]
    assert (out / "a.txt").read_text() == "first"


def test_a_writers_own_error_is_no_fault_of_the_disk(tmp_path):
    path = tmp_path / "lh.white"
    wrong = Surface(*icosphere(1), geometry={"unknown": 1})
    with pytest.raises(ValueError, match=r"lh\.white: can't be written \(.*unknown") as caught:
        write_surface(path, wrong)
    assert "room" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_errors_of_inputs_and_of_other_drives_keep_their_names(tmp_path, monkeypatch):
    """An input on a broken disk tells no name; os.path.relpath knows no way from one drive of Windows to another."""
    def no_way(*paths):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(os.path, "relpath", no_way)
    for error in (OSError(errno.EIO, "Input/output error"), OSError(errno.ENOENT, "none", "/elsewhere/lh.white")):
        with pytest.raises(OSError) as caught, atomic_file(tmp_path / "out.txt"):
            raise error
        assert caught.value is error
    with pytest.raises(OSError) as caught, atomic_file(tmp_path / "out.txt") as temporary:
        raise OSError(errno.EACCES, "Permission denied", os.fspath(temporary))
    assert caught.value.filename == os.fspath(tmp_path / "out.txt")


def test_a_link_is_replaced_and_not_what_it_points_to(tmp_path):
    (tmp_path / "store").write_text("theirs")
    link = tmp_path / "out.txt"
    link.symlink_to("store")
    with atomic_file(link) as temporary:
        temporary.write_text("ours")
    assert ((tmp_path / "store").read_text(), link.read_text(), link.is_symlink()) == ("theirs", "ours", False)


@pytest.mark.skipif(os.name == "nt", reason="Windows bounds whole paths, too")
def test_a_name_of_255_bytes_is_written(tmp_path):
    path = tmp_path / ("é" * 125 + ".txt")[-252:]
    with atomic_file(path) as temporary:
        temporary.write_text("ours")
    assert (path.read_text(), len(os.fsencode(path.name))) == ("ours", 254)
