"""Compiled kernels: when their cached code is used again, and for how many kinds of arguments."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy import sparse

from morphofold.kernels import reading

COUNT = """
import os
from numba.core import event
compiled = []
class Listener(event.Listener):
    on_start = lambda self, event: compiled.append(event.data["dispatcher"].py_func.__name__)
    on_end = lambda self, event: None
event.register("numba:compile", Listener())
import outer
print(outer.result(3.0, outer.Law(2.0)), len(compiled))
"""
SOURCES = {
    "deep": """
from numba import njit
@njit
def most(x):
    return x + 1
""",
    "inner": """
import deep
from morphofold.kernels import kernel
ADDED = 1.0
@kernel
def more(x):
    return deep.most(x) - 1 + ADDED
""",
    "constants": """
SHIFT = 0.0
""",
    "law": """
from typing import NamedTuple
class Law(NamedTuple):
    factor: float
    def energy(self, x, y):
        return self.factor * x + y
""",
    "outer": """
from constants import SHIFT
from inner import more
from law import Law
from morphofold.kernels import kernel
from morphofold.sim.materials import energy_of
@kernel
def result(x, material):
    return energy_of(material, more(x), SHIFT)
""",
}


def result_and_compiled(folder):
    """What the kernel of a folder gives in a new process, and whether functions were compiled for it."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", COUNT]
    out = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout
    return float(out.split()[0]), int(out.split()[1]) > 0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    for name, source in SOURCES.items():
        (tmp_path / f"{name}.py").write_text(source)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "before", "after", "value"),
    [
        pytest.param("inner", "ADDED = 1.0", "ADDED = 5.0", 16.0, marks=pytest.mark.slow),
        pytest.param("inner", "- 1 + ADDED", "+ ADDED", 10.0, marks=pytest.mark.slow),
        pytest.param("deep", "x + 1", "x + 3", 12.0, marks=pytest.mark.slow),
        pytest.param("constants", "0.0", "0.5", 8.5, marks=pytest.mark.slow),
        pytest.param("law", "self.factor * x", "3 * x", 12.0, marks=pytest.mark.slow),
    ],
)
def test_a_kernel_is_compiled_again_when_what_it_takes_from_elsewhere_has_changed(folder, file, before, after, value):
    assert [result_and_compiled(folder) for _ in range(2)] == [(8.0, True), (8.0, False)]
    (folder / f"{file}.py").write_text(SOURCES[file].replace(before, after))
    assert [result_and_compiled(folder) for _ in range(2)] == [(value, True), (value, False)]


@pytest.mark.slow
@pytest.mark.parametrize("damaged", [lambda content: content[: len(content) // 2], bytes.swapcase])
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_damaged_file_is_replaced(folder, kind, damaged):
    assert result_and_compiled(folder) == (8.0, True)
    for file in folder.glob(f"__pycache__/*.{kind}"):
        file.write_bytes(damaged(file.read_bytes()))
    assert [result_and_compiled(folder) for _ in range(2)] == [(8.0, True), (8.0, False)]


def test_arrays_are_read_as_one_kind():
    table = np.arange(6.0).reshape(2, 3)
    for array in (table, np.asfortranarray(table), np.repeat(table, 2, axis=1)[:, ::2]):
        (read,) = reading(array)
        assert (read.flags.c_contiguous, read.flags.writeable, array.flags.writeable) == (True, False, True)
        np.testing.assert_array_equal(read, table)
    matrix = sparse.csr_array(np.array([[0, 2.0], [3.0, 0]]))
    first, column, value, number = reading(matrix, 7)
    assert (first.tolist(), column.tolist(), value.tolist(), number) == ([0, 1, 2], [1, 0], [2, 3], 7)
    assert first.dtype == column.dtype == np.uint32
    assert len(reading(matrix.astype(bool))) == 2


ONE_KIND = """
import gc
from numba import types
from numba.core.dispatcher import Dispatcher
from morphofold.analysis.measuring import measure
from morphofold.intersections.intersection import self_intersections
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Cortex, Surface
ball = folded_ball(3000)
measure(ball)
loose = Surface(ball.white.verts + 0.0, ball.faces.copy()), Surface(ball.pial.verts * 1.0, ball.faces.copy())
measure(Cortex(*loose), accuracy="fine")
self_intersections(ball.pial)
for kernel in gc.get_objects():
    if isinstance(kernel, Dispatcher) and kernel.py_func.__module__.startswith("morphofold."):
        kinds = {tuple(map(types.unliteral, signature)) for signature in kernel.overloads}
        if len(kinds) > 1:
            print(kernel.py_func.__module__, kernel.py_func.__name__, kinds)
"""


@pytest.mark.slow
def test_no_kernel_of_measuring_is_compiled_twice():
    done = subprocess.run([sys.executable, "-c", ONE_KIND], capture_output=True, text=True, check=True)
    assert done.stdout == ""
