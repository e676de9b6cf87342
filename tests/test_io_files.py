"""Files and folders are written whole or not at all, by one process; our own JSON is as its schema or refused."""

import json
import os
import re
import subprocess
import sys

import pytest
from made_measures import made_measures

from morphofold.errors import DamagedFile, Refusal, TooLarge
from morphofold.io import atomic_file, atomic_folder, read_cortex, remove_folder, write_surface
from morphofold.io.atomic_folders import LOCK_FILE, alone
from morphofold.io.files import decoding
from morphofold.io.json_files import Amount, Record, read_json
from morphofold.results import write_analysis


def interrupt_while_writing(path):
    path.write_text("half")
    raise KeyboardInterrupt


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, rough):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_file(tmp_path / "a.txt") as temporary:
        interrupt_while_writing(temporary)
    with pytest.raises(FileNotFoundError, match=r"no: .*\blh\.white\b"):
        write_surface(tmp_path / "no" / "lh.white", rough)
    assert os.listdir(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


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
    out.mkdir(parents=True)  # an empty folder is replaced, too
    write_folder(out, "first")
    write_folder(out, "second")
    for folder in (out, tmp_path / "new" / "deep"):
        with pytest.raises(KeyboardInterrupt), atomic_folder(folder) as temporary:
            interrupt_while_writing(temporary / "a.txt")
    assert sorted(os.listdir(out)) == [".morphofold", "a.txt"]
    assert (out / "a.txt").read_text() == "second"
    assert os.listdir(tmp_path / "deep") == ["out"]
    assert os.listdir(tmp_path) == ["deep"]


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
    (out / "user" / "deep").mkdir(parents=True)
    for name in ("NOTES.txt", "maps/lh.user", "user/deep/b.txt"):
        (out / name).write_text("of the user")
    (out / "elsewhere").symlink_to(tmp_path)
    (out / "nowhere").symlink_to("not-there")
    with atomic_folder(out) as folder:
        (folder / "maps").mkdir()
        for name in ("a.txt", "new.txt", "maps/lh.H"):
            (folder / name).write_text("second")
    contents = tree(out)
    del contents[".morphofold"]
    assert contents == {
        **dict.fromkeys(("a.txt", "new.txt", "maps/lh.H"), "second"),
        **dict.fromkeys(("NOTES.txt", "maps/lh.user", "user/deep/b.txt"), "of the user"),
        **dict.fromkeys(("maps", "user", "user/deep", "elsewhere", "nowhere"), False),
    }
    assert os.readlink(out / "elsewhere") == os.fspath(tmp_path)
    assert os.listdir(tmp_path) == ["out"]
    remove_folder(out)
    assert set(contents) - set(tree(out)) == {"a.txt", "new.txt", "maps/lh.H"}
    write_folder(out)  # it is ours still
    assert (out / "NOTES.txt").read_text() == "of the user"


@pytest.mark.parametrize(("theirs", "ours"), [("b", "b"), ("b/user.txt", "b"), ("b", "b/ours.txt")])
def test_what_we_did_not_write_is_not_written_over(tmp_path, theirs, ours):
    out = tmp_path / "out"
    write_folder(out, "first")
    (out / theirs).parent.mkdir(exist_ok=True)
    (out / theirs).write_text("of the user")
    before = tree(out)
    with pytest.raises(FileExistsError, match=re.escape(f"{out / theirs}: ")), atomic_folder(out) as folder:
        (folder / ours).parent.mkdir(exist_ok=True)
        (folder / ours).write_text("ours")
    assert tree(out) == before
    assert os.listdir(tmp_path) == ["out"]


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


def refuse_lock(folder, error=FileExistsError):
    with pytest.raises(error, match=re.escape(f"{folder}: ")), alone(folder):
        pytest.fail("locked twice")


def test_a_folder_is_locked_by_one_and_free_again_afterwards(tmp_path):
    folder = tmp_path / "run"
    with alone(folder):
        refuse_lock(folder)
        assert (folder / LOCK_FILE).exists()  # the refused one took nothing away
        with alone(tmp_path / "another"):
            pass
    assert not (folder / LOCK_FILE).exists()
    with alone(folder):
        pass


def test_a_folder_that_was_made_and_left_empty_goes_again_and_one_that_was_there_or_is_filled_stays(tmp_path):
    (tmp_path / "old").mkdir()
    for folder in (tmp_path / "old", tmp_path / "a" / "b", tmp_path / "filled"):
        with pytest.raises(ZeroDivisionError), alone(folder):
            if folder.name == "filled":
                (folder / "x").write_text("x")
            1 / 0  # noqa: B018
    assert sorted(p.name for p in tmp_path.iterdir()) == ["filled", "old"]


def test_a_lock_in_what_is_no_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("of the user")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link"):
        refuse_lock(tmp_path / name, NotADirectoryError)
    assert sorted(os.listdir(tmp_path)) == ["file", "link"]


def test_a_killed_process_locks_nothing(tmp_path):
    folder = tmp_path / "run"
    code = (
        "import sys, time, pathlib; from morphofold.io.atomic_folders import alone\n"
        f"with alone(pathlib.Path({str(folder)!r})):\n    print('locked', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "locked\n"
    refuse_lock(folder)
    process.kill()
    process.wait()
    assert (folder / LOCK_FILE).exists()
    with alone(folder):
        pass
    assert list(folder.iterdir()) == []


# --- our own JSON files, with every value changed in turn

HEALTH = {"growth": 1.8, "min_J": 0.5, "crossings": 0, "deepest_crossing": 0.0, "mean_radius_mm": 60.0}
WRONG = ["x", 5, None, [], {}, float("nan"), -1, 1e308, True, 1e-300]
HEALTH = {"growth": 1.8, "min_J": 0.5, "crossings": 0, "deepest_crossing": 0.0, "mean_radius_mm": 60.0}
STAGE = {
    **{"name": "ball", "g": 1.8, "law": "isotropic", "mu_ratio": 2.0, "shape": "sphere", "portion": 0.125},
    **{"reference_thickness": 3.0, "reference_radius": 50.0, "units": "mm", "warnings": ["it wobbles"]},
    "health": HEALTH,
}


KEYS = [*((key,) for key in STAGE), *(("health", key) for key in HEALTH), ("warnings", 0)]


def with_value(content, path, value):
    content = json.loads(json.dumps(content))
    part = content if len(path) == 1 else content[path[0]]
    part[path[-1]] = value
    return json.dumps(content)


def refusal(read, path):
    """The refusal, which names a file or one in its folder; "" if it is read."""
    try:
        read()
    except (Refusal, OSError) as error:
        line = str(error)
        assert str(path) in line, line
        assert len(line) < 600
        assert "\n" not in line
        return line
    return ""


def test_a_stage_record_is_refused_or_read_whatever_it_holds(tmp_path):
    folder = write_analysis([made_measures(level=1)], tmp_path / "g1.80", report=False)
    (folder / "summary.json").unlink()
    path = folder / "stage.json"
    texts = {("name",), ("law",), ("shape",), ("units",), ("warnings", 0)}
    for key in KEYS:
        for value in WRONG:
            path.write_text(with_value(STAGE, key, value))
            if not refusal(lambda: read_cortex(folder), path):
                assert not isinstance(value, bool), key
                assert key in texts or not isinstance(value, str), key
                assert value != 1e308, key
    path.write_text(json.dumps({**STAGE, "own": {"a": [1, "x", None]}}))
    assert read_cortex(folder).info["own"] == {"a": [1, "x", None]}  # of a later version, or somebody's own
    assert read_cortex(folder).portion == 0.125


class Sample(Record):
    size: Amount
    name: str = ""


@pytest.mark.parametrize(
    "raw",
    [b"", b"{", b"[]", b"\xff", b'{"name": "x"}', b'{"size": 1} {}']
    + [b'{"size": %s}' % value for value in (b"NaN", b"1e999", b"true", b'"1"', b"-1e-9")],
)
def test_what_is_not_as_its_schema_is_refused_with_file_and_cure(raw, tmp_path):
    path = tmp_path / "sample.json"
    path.write_bytes(raw)
    line = refusal(lambda: read_json(path, Sample, "Make it anew."), path)
    assert line.endswith("Make it anew.")


def test_a_missing_file_and_one_beyond_its_bound_are_refused(tmp_path):
    path = tmp_path / "sample.json"
    with pytest.raises(FileNotFoundError):
        read_json(path, Sample, "")
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(TooLarge, match=r"sample\.json: .*\b1,099,511,627,776\b"):
        read_json(path, Sample, "")
