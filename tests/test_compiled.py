"""Compiled kernels: where their code is kept, when it is used again, and for how many kinds of arguments."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy import sparse

from morphofold import kernel_files, kernels
from morphofold.cli import compiling
from morphofold.kernels import kernel, reading

COUNT = """
import sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    on_start = lambda self, one: compiled.append(one.data["dispatcher"].py_func.__name__)
    on_end = lambda self, one: None
event.register("numba:compile", Listener())
import outer
print(outer.twice_and(3.0), len(compiled))
"""
INNER = """
from morphofold.kernels import kernel
ADDED = 1.0
@kernel
def more(x):
    return x + ADDED
"""
OUTER = """
from inner import more
from morphofold.kernels import kernel
@kernel
def twice_and(x):
    return 2 * more(x)
"""


def result_and_compiled(folder, cache):
    """What the kernel of a folder gives in a new process, and how many functions were compiled for it."""
    keep = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", COUNT], cwd=folder, env=keep, capture_output=True, text=True, check=True
    )
    value, count = done.stdout.split()
    return float(value), int(count)


@pytest.fixture
def folder(tmp_path):
    here = tmp_path / "here"
    here.mkdir()
    (here / "inner.py").write_text(INNER)
    (here / "outer.py").write_text(OUTER)
    return here


def test_code_is_kept_for_other_processes_and_other_installations(folder, tmp_path):
    assert result_and_compiled(folder, tmp_path / "cache") == (8.0, 2)
    assert result_and_compiled(folder, tmp_path / "cache") == (8.0, 0)
    there = tmp_path / "elsewhere"
    folder.rename(there)
    assert result_and_compiled(there, tmp_path / "cache") == (8.0, 0)


@pytest.mark.parametrize("change", ["1.0", "return x +"])
def test_a_kernel_is_compiled_again_when_one_that_it_calls_has_changed(change, folder, tmp_path):
    assert result_and_compiled(folder, tmp_path / "cache")[0] == 8.0
    (folder / "inner.py").write_text(INNER.replace(change, {"1.0": "5.0"}.get(change, "return 5 * x +")))
    assert result_and_compiled(folder, tmp_path / "cache") == ({"1.0": 16.0}.get(change, 32.0), 2)


def test_few_versions_of_a_module_are_kept(folder, tmp_path):
    for added in range(kernels.KEPT_VERSIONS + 3):
        (folder / "inner.py").write_text(INNER.replace("1.0", f"{added}.0"))
        assert result_and_compiled(folder, tmp_path / "cache") == (2.0 * (3 + added), 2)
    (place,) = (tmp_path / "cache").iterdir()
    kept = [one.name.split("-")[0] for one in place.iterdir()]
    assert sorted(set(kept)) == ["inner", "outer"]
    assert kept.count("inner") == kernels.KEPT_VERSIONS


def test_where_nothing_can_be_written_each_process_compiles_for_itself(monkeypatch):
    monkeypatch.setattr(kernel_files, "folder", lambda: None)
    assert kernel(lambda x: x + 1)(2.0) == 3.0
    assert not kernel_files.is_kept("morphofold.geometry")


def test_a_folder_that_can_not_be_listed_holds_nothing(monkeypatch, tmp_path):
    def shut(self, pattern):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(kernel_files, "folder", lambda: tmp_path)
    monkeypatch.setattr(kernel_files.Path, "glob", shut)
    assert not kernel_files.is_kept("morphofold.geometry")


def test_two_processes_that_compile_at_once_do_not_disturb_each_other(folder, tmp_path):
    keep = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    at_once = [
        subprocess.Popen([sys.executable, "-c", COUNT], cwd=folder, env=keep, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    assert {one.communicate()[0].split()[0] for one in at_once} == {"8.0"}
    assert result_and_compiled(folder, tmp_path / "cache") == (8.0, 0)


def test_arrays_are_read_as_one_kind():
    table = np.arange(6.0).reshape(2, 3)
    frozen = table.copy()
    frozen.flags.writeable = False
    for given in (table, frozen, np.asfortranarray(table), np.repeat(table, 2, axis=1)[:, ::2]):
        (read,) = reading(given)
        assert read.flags.c_contiguous
        assert not read.flags.writeable
        np.testing.assert_array_equal(read, table)
    assert table.flags.writeable
    matrix = sparse.csr_array(np.array([[0, 2.0], [3.0, 0]]))
    first, column, value, number = reading(matrix, 7)
    assert (first.tolist(), column.tolist(), value.tolist(), number) == ([0, 1, 2], [1, 0], [2, 3], 7)
    assert first.dtype == column.dtype == np.uint32
    assert len(reading(matrix.astype(bool))) == 2


ONE_KIND = """
import gc
from numba.core.dispatcher import Dispatcher
from morphofold.analysis.measuring import measure
from morphofold.intersections.intersection import self_intersections
from morphofold.shapes.folded_ball import folded_ball
from morphofold.surface import Cortex, Surface
ball = folded_ball(3000)
measure(ball)
loose = Surface(ball.white.verts + 0.0, ball.faces.copy()), Surface(ball.pial.verts * 1.0, ball.faces.copy())
measure(Cortex(*loose), accuracy="fine")
self_intersections(ball.pial)
for one in gc.get_objects():
    if isinstance(one, Dispatcher) and one.py_func.__module__.startswith("morphofold."):
        if len(one.overloads) > 1:
            print(one.py_func.__module__, one.py_func.__name__, len(one.overloads))
"""


def test_no_kernel_of_measuring_is_compiled_twice():
    done = subprocess.run([sys.executable, "-c", ONE_KIND], capture_output=True, text=True, check=True)
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("threads", "cores", "kept", "writable", "children"),
    [
        (None, 2, False, True, 1),
        (1, 2, False, True, 0),
        (None, 1, False, True, 0),
        (2, 8, True, True, 0),
        (2, 8, False, False, 0),
    ],
    ids=["fresh", "one thread", "one core", "kept", "nowhere to keep it"],
)
def test_a_second_process_compiles_only_where_it_helps(monkeypatch, tmp_path, threads, cores, kept, writable, children):
    monkeypatch.setattr(compiling.os, "cpu_count", lambda: cores)
    monkeypatch.setattr(kernel_files, "folder", lambda: tmp_path if writable else None)
    monkeypatch.setattr(kernel_files, "is_kept", lambda module: kept)
    started, popen = [], subprocess.Popen

    def sleeping(command, **options):
        started.append(popen([sys.executable, "-c", "import time; time.sleep(60)"], **options))
        return started[-1]

    monkeypatch.setattr(compiling.subprocess, "Popen", sleeping)
    with pytest.raises(KeyError), compiling.compiling_beside(threads):
        assert [one.poll() for one in started] == [None] * children
        raise KeyError("the command failed")
    assert len(started) == children
    assert all(one.poll() is not None for one in started)


def test_the_second_process_compiles_what_measuring_needs():
    compiling.main()
    assert kernel_files.is_kept("morphofold.analysis.diffusion")
