"""A process killed at any step on files, a full disk, two writers at once: all find the old or the new, whole."""

import errno
import os
import re
import shutil
import signal
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from hard_cases.cases import hard_case
from hard_cases.made_files import RADIAL, killed_at, needs_linux, resource
from made_measures import made_measures

from morphofold.io import atomic_folder, folders, locks, write_annotation, write_gifti_map, write_morph, write_surface
from morphofold.results import analyses, read_analysis, write_analysis, write_dataset
from morphofold.shapes import icosphere
from morphofold.sim.run import simulate
from morphofold.surface import Regions, Surface

NO_RESTART = "BrainGrowth, FetalFoldSim: no restart (read)"
NAMES = ("lh.white", "a.gii", "a.ply", "a.vtk", "a.vtp")


@contextmanager
def in_place(path):
    yield Path(path)


@contextmanager
def folder_in_place(path):
    path.mkdir(parents=True)
    yield path


def writers_in_place(patch):
    for module in ("io.files", "io.gifti", "io.trimesh_files", "io.vtk_files", "sim.output.folder"):
        patch.setattr(f"morphofold.{module}.atomic_file", in_place)


@contextmanager
def folder_again(path):
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    yield path


def state(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def writers(folder):
    """What writes a thing by the name of its file or folder, from a size: surfaces, maps, regions, an analysis."""
    surface, values = (lambda r: Surface(*icosphere(2, r))), (lambda r: np.linspace(0, r, 162))
    colours = np.array([[200, 10, 10], [10, 200, 10]], dtype=np.uint8)
    halves = lambda r: Regions(np.arange(162) // r % 2, ("front", "back"), colours)
    found = {name: lambda r, name=name: write_surface(folder / name, surface(r)) for name in NAMES}
    found |= {name: lambda r, name=name: write_morph(folder / name, values(r)) for name in ("lh.k", "lh.k.mgh")}
    found["lh.k.shape.gii"] = lambda r: write_gifti_map(folder / "lh.k.shape.gii", values(r))
    found["lh.a.annot"] = lambda r: write_annotation(folder / "lh.a.annot", halves(r))
    measures = lambda r: [made_measures(name=f"{r}", level=1)]
    found["analysis"] = lambda r: write_analysis(measures(r), folder / "analysis", report=False)
    return found


@hard_case(
    "files",
    "a writer of a surface, map or annotation killed before each step, and within writes",
    peers="nibabel, trimesh, meshio: write in place (read)",
    guard="a file beside, moved when whole",
    without=writers_in_place,
)
def test_killed_file(holds, tmp_path):
    kills = lost = 0
    known = {name: write for name, write in writers(tmp_path).items() if name != "analysis"}
    for name, write in known.items():
        path, whole = tmp_path / name, []
        for size in (2, 1):
            write(size)
            whole.append(path.read_bytes())
        for share in range(5):
            assert killed_at(0, lambda write=write: write(2), size=share * len(whole[0]) // 5)
            lost += path.read_bytes() not in whole
            kills += 1
        k = 1
        while killed_at(k, lambda write=write: write(2)):
            lost += path.read_bytes() not in whole
            kills, k = kills + 1, k + 1
    holds("neither the old file nor the new one found", lost, at_most=0)
    holds("kills", kills, at_least=5 * len(known))
    beside = len(os.listdir(tmp_path)) - len(known)
    holds("left beside, for each kill", beside / kills, at_most=1)


def one_at_a_time(patch):
    """As on systems that can't exchange two names."""
    patch.setattr(folders, "_exchange_names", lambda one, other: False)


@pytest.mark.slow
@hard_case(
    "files",
    "a writer that replaces an analysis killed before each of its steps",
    guard="names exchanged in one step",
    without=one_at_a_time,
    fails=(AssertionError, OSError),
)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows can't exchange two names in one step")
def test_killed_folder(holds, tmp_path):
    out, kills, names = tmp_path / "out", 0, set()
    old, new = (made_measures(name=name, level=1) for name in ("old", "new"))
    write_analysis([old], out, report=False)
    before, k = state(out), 1
    while killed_at(k, lambda: write_analysis([new], out, report=False)):
        (found,) = read_analysis(out)
        names.add(found.cortex.name)
        assert found.cortex.name == "new" or state(out) == before
        kills, k = kills + 1, k + 1
    holds("kills", kills, at_least=50)
    holds.equal("found after them", names, {"old", "new"})
    holds("folders left beside, for each kill", (len(os.listdir(tmp_path)) - 1) / kills, at_most=1)


@hard_case(
    "files",
    "a writer killed before each of its steps where names can't be exchanged",
    fails=AssertionError,
    guard="a look beside",
    without=lambda patch: patch.setattr(analyses, "moved_away", lambda out: ""),
)
def test_killed_between_two_names(holds, tmp_path, monkeypatch):
    """Between its two moves nothing is there: the reader is told where what was there is, whole."""
    one_at_a_time(monkeypatch)
    out, kills, messages, k = tmp_path / "out", 0, [], 1

    def write(words):
        with atomic_folder(out) as folder:
            (folder / "deep").mkdir()
            for name in ("a.txt", "deep/b.txt"):
                (folder / name).write_text(words)

    write("old")
    while killed_at(k, lambda: write("new")):
        place = out
        if not out.exists():
            with pytest.raises(FileNotFoundError) as caught:
                read_analysis(out)
            messages.append(str(caught.value))
            named = re.search(r"(\.out\.\S+\.old)\b", messages[-1])
            assert named, messages[-1]
            place = tmp_path / named[1]
        words = [(place / name).read_text() for name in ("a.txt", "deep/b.txt")]
        assert words in (["old", "old"], ["new", "new"])
        os.replace(place, out)
        kills, k = kills + 1, k + 1
    holds("kills", kills, at_least=5)
    holds("kills between the two moves", len(messages), at_least=1)
    holds.says("the reader is told", re.sub(r"\.out\.\w+", ".out.1a2b3c4d", messages[0]), ".out.1a2b3c4d")


@pytest.mark.slow
@hard_case(
    "files",
    "a writer of a subject of a BIDS dataset killed before each of its steps",
    guard="a folder beside, moved when whole",
    fails=(AssertionError, OSError, ValueError),
    without=lambda patch: patch.setattr("morphofold.results.analyses.atomic_folder", folder_again),
)
def test_killed_dataset(holds, tmp_path):
    out, kills, names, k = tmp_path / "bids", 0, set(), 1
    old, new = (made_measures(name=name, level=1) for name in ("old", "new"))
    place = write_dataset([old], out, "one", report=False)
    there = set(os.listdir(out))
    while killed_at(k, lambda: write_dataset([new], out, "one", report=False)):
        names |= {found.cortex.name for found in read_analysis(place)}
        write_dataset([old], out, "one", report=False)
        kills, k = kills + 1, k + 1
    holds("kills", kills, at_least=50)
    holds.equal("found after them", names, {"old", "new"})
    holds("left beside, for each kill", len(set(os.listdir(out)) - there) / kills, at_most=1)


def failures_of_four(out, count):
    """How many of four processes that write a folder ``count`` times each, at once, do not come to their end."""
    children = []
    for word in "abcd":
        children.append(os.fork())
        if children[-1] == 0:
            code = 1
            try:
                for _ in range(count):
                    with atomic_folder(out) as folder:
                        for i in range(5):
                            (folder / f"{i}.txt").write_text(word)
                code = 0
            finally:
                os._exit(code)
    return sum(os.waitpid(child, 0)[1] != 0 for child in children)


@pytest.mark.slow
@hard_case(
    "files",
    "four processes that write one folder at once, over and over",
    guard="names exchanged in one step",
    without=one_at_a_time,
    fails=AssertionError,
)
def test_four_writers(holds, tmp_path):
    needs_linux()
    out = tmp_path / "out"
    holds("writers that fail", failures_of_four(out, 300), at_most=0)
    words = {(out / f"{i}.txt").read_text() for i in range(5)}
    holds("writers of what is there", len(words), at_most=1, at_least=1)
    holds.equal("left beside", os.listdir(tmp_path), ["out"])


def grow(out):
    return simulate("radial", out, settings=RADIAL, resume=True)


@pytest.mark.slow
@hard_case(
    "files",
    "a run killed before each of its steps, and resumed",
    peers=NO_RESTART,
    guard="a folder beside, moved when whole",
    fails=(AssertionError, ValueError, OSError),
    without=lambda patch: patch.setattr("morphofold.sim.output.folder.atomic_folder", folder_in_place),
)
def test_killed_run(holds, tmp_path):
    whole = {name: raw for name, raw in state(grow(tmp_path / "whole").path).items() if "/" in name}
    k, kills, alike = 1, 0, 0
    while killed_at(k, lambda: grow(tmp_path / "run")):
        after = state(grow(tmp_path / "run").path)
        alike += {name: raw for name, raw in after.items() if "/" in name} == whole
        shutil.rmtree(tmp_path / "run")
        kills, k = kills + 1, k + 1
    holds("kills", kills, at_least=10)
    holds("resumed to the same stages, share", alike / kills, at_least=1)


def unread(patch):
    patch.setattr("morphofold.io.files.read_back", lambda path, temporary: suppress(ValueError))


@contextmanager
def room_for(size):
    """No file may grow beyond a size [bytes], as at a full disk."""
    limit, ignored = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limit[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, ignored)


@hard_case(
    "files",
    "a disk that is full after each fifth of a surface, map, annotation, or a file of an analysis",
    peers="numpy's tofile, and so nibabel and meshio: cut files in silence (measured)",
    guard="a look at what was written",
    without=unread,
    fails=(AssertionError, ValueError),
)
def test_full_disk(holds, tmp_path):
    tried, refusals = 0, []
    known = writers(tmp_path)
    for name, write in known.items():
        path = tmp_path / name
        write(1)
        before = state(tmp_path)
        most = max(p.stat().st_size for p in (path, *path.rglob("*")) if p.is_file())
        for size in range(0, most, most // 5 + 1):
            with room_for(size):
                try:
                    write(2)
                except OSError as error:
                    refusals.append((error.errno, tmp_path / name, Path(error.filename)))
            tried += 1
            assert state(tmp_path) == before, f"{name} is another one, full after {size} bytes"
    holds("writes refused, share", len(refusals) / tried, at_least=1)
    holds("the old one found", tried, at_least=5 * len(known))
    aside = [refusals for code, path, named in refusals if code != errno.EFBIG or not named.is_relative_to(path)]
    holds("refusals that name another cause, or another place than the one to write", len(aside), at_most=0)
    holds.equal("left beside", sorted(p.name for p in tmp_path.iterdir()), sorted(known))


@contextmanager
def full_if_unread(path):
    try:
        yield
    except ValueError as error:
        raise OSError(errno.ENOSPC, "No space left on device", os.fspath(path)) from error


@hard_case(
    "files",
    "a package that writes, at a disk with room, what can't be read back",
    guard="a full disk is told of where a file can't grow",
    without=lambda patch: patch.setattr("morphofold.io.files.read_back", lambda path, temporary: full_if_unread(path)),
    fails=AssertionError,
)
def test_not_a_full_disk(holds, tmp_path, monkeypatch):
    import nibabel.freesurfer

    monkeypatch.setattr(nibabel.freesurfer, "write_geometry", lambda path, *args: Path(path).write_bytes(b"surface"))
    path = tmp_path / "lh.white"
    with pytest.raises(OSError, match=re.escape(f"{path}: ")) as caught:
        write_surface(path, Surface(*icosphere(1)))
    message = str(caught.value).replace(str(path), path.name)
    holds.equal("code of the system's error", caught.value.errno, None)
    holds.says("refusal", message, "lh.white: ")
    holds("lines, and temporary names in them", len(message.splitlines()) + message.count("/."), at_most=1)
    holds.equal("left", os.listdir(tmp_path), [])


@hard_case(
    "files",
    "two runs, and a writer, into one folder at once",
    peers=NO_RESTART,
    guard="a lock",
    without=lambda patch: patch.setattr(locks, "_try_lock", lambda file: None),
)
def test_two_runs(holds, tmp_path):
    with locks.alone(tmp_path / "run"):
        try:
            grow(tmp_path / "run")
            message = ""
        except FileExistsError as error:
            message = str(error).replace(str(tmp_path), "").replace(str(os.getpid()), "4321")
        holds.says("the second run", message, "/run: ", "4321")
        holds.equal("in the folder", os.listdir(tmp_path / "run"), ["lock"])


@hard_case(
    "files",
    "a folder that somebody writes while we do",
    guard="a second look",
    without=lambda patch: patch.setattr(folders, "refuse_foreign", lambda out, found=None: None),
)
def test_foreign_folder(holds, tmp_path):
    out, message = tmp_path / "out", ""
    try:
        with atomic_folder(out) as folder:
            (folder / "a.txt").write_text("ours")
            out.mkdir()
            (out / "thesis.txt").write_text("theirs")
    except FileExistsError as error:
        message = str(error).replace(str(tmp_path), "")
    holds.says("refusal", message, "/out: ", "thesis.txt")
    holds.equal("in the folder", os.listdir(out), ["thesis.txt"])


def comes_within(name, patch, out):
    """Somebody's folder comes to ``out`` right before we move anything there."""
    move = getattr(folders, name)

    def late(*paths):
        patch.setattr(folders, name, move)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        (out / "thesis.txt").write_text("theirs")
        return move(*paths)

    patch.setattr(folders, name, late)


@hard_case(
    "files",
    "a folder that somebody puts in the place of ours after we looked",
    guard="a look at what we got for ours",
    without=lambda patch: patch.setattr(
        folders, "refuse_foreign", lambda out, found=None, look=folders.refuse_foreign: found or look(out)
    ),
)
@pytest.mark.parametrize("exchanges", [True, False])
def test_foreign_folder_at_the_last_moment(holds, tmp_path, monkeypatch, exchanges):
    if not exchanges:
        monkeypatch.setattr(folders, "_exchange_names", lambda one, other: False)
    for begin in ("empty", "ours"):
        out, message = tmp_path / begin, ""
        with atomic_folder(out) as folder:
            (folder / "a.txt").write_text("old")
        if begin == "empty":
            shutil.rmtree(out)
        with monkeypatch.context() as patch:
            comes_within("_replace_folder", patch, out)
            try:
                with atomic_folder(out) as folder:
                    (folder / "a.txt").write_text("ours")
            except FileExistsError as error:
                message = str(error)
        holds.says("refusal", message.replace(str(tmp_path), ""), f"/{begin}: ", "thesis.txt")
        holds.equal("in the folder", os.listdir(out), ["thesis.txt"])
    holds.equal("left beside", sorted(os.listdir(tmp_path)), ["empty", "ours"])


@hard_case(
    "files",
    "two analyses into one new folder at once",
    guard="a folder that came meanwhile is exchanged",
    without=lambda patch: patch.setattr(folders, "_replace_folder", os.replace),
    fails=OSError,
)
def test_two_analyses(holds, tmp_path):
    with atomic_folder(tmp_path / "out") as one:
        (one / "a.txt").write_text("one")
        with atomic_folder(tmp_path / "out") as other:
            (other / "a.txt").write_text("other")
    holds.equal("the last one is there", (tmp_path / "out" / "a.txt").read_text(), "one")
    holds.equal("left beside", os.listdir(tmp_path), ["out"])
