"""The clock that stands still while numba compiles, and what is said meanwhile."""

import subprocess
import sys
import time

import pytest
from numba import TypingError, njit

from morphofold import progress_callbacks
from morphofold.cli.terminal_output import COMPILING_TEXT, progress
from morphofold.timing import Stages, reporting_compilation, working_seconds


def new_kernel():
    """A function that has to be compiled, one that it calls too."""

    @njit
    def inner(x):
        return x * x + 1.0

    @njit
    def outer(x):
        return inner(x) - inner(0.5 * x)

    return outer


def test_the_clock_stands_still_while_numba_compiles_and_goes_on_after():
    kernel, times = new_kernel(), []
    wall, work = time.perf_counter(), working_seconds()
    with reporting_compilation(lambda: times.append(working_seconds())):
        kernel(3.0)
        kernel(3)
        kernel(4.0)
    wall, work = time.perf_counter() - wall, working_seconds() - work
    assert len(times) == 4  # for floats and for integers, the inner ones after them
    assert -0.05 < times[2] - times[0] < work + 0.05  # another process may have the core between two events
    assert work < 0.5 * wall  # calling three times takes microseconds, compiling far more
    with pytest.raises(TypingError):
        njit(lambda x: x + "text")(1.0)
    before = working_seconds()
    time.sleep(0.02)
    assert working_seconds() - before >= 0.02


def test_stages_last_until_the_next_begins_and_what_comes_again_is_added(monkeypatch):
    now = iter([0.0, 1.0, 1.0, 3.0, 3.0, 7.0, 20.0, 28.0])
    monkeypatch.setattr("morphofold.timing.working_seconds", lambda: next(now))
    clock = Stages()
    clock.begin("reading")  # 0 to 1
    clock.begin("areas")  # 1 to 3
    clock.begin("curvature")  # 3 to 7
    clock.end()
    clock.end()
    clock.begin("reading")  # 20 to 28; what lies between is nobody's
    clock.end()
    assert clock.seconds == {"reading": 9.0, "areas": 2.0, "curvature": 4.0}


def test_compiling_is_said_once_and_not_when_quiet(capsys):
    for quiet in (True, False):
        with progress("scene", quiet) as show:
            new_kernel()(3.0)
            new_kernel()(3.0)
            show(0.5, "half way")
        assert capsys.readouterr().err.count(COMPILING_TEXT) == (not quiet)
    new_kernel()(3.0)  # nobody is told any more
    assert not capsys.readouterr().err


def test_peak_memory_rises_by_what_is_held_stays_when_it_is_let_go_and_is_not_the_parents():
    child = (
        "import numpy as np; from morphofold.timing import peak_memory as peak\n"
        "a = peak(); held = np.ones(2**25); b = peak(); del held; print(a, b, peak())"
    )
    parent = f"import subprocess as s, sys; held = b'1' * 2**30; s.run([sys.executable, '-c', {child!r}], check=True)"
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, check=True)
    before, during, after = map(float, done.stdout.split())
    assert during - before == pytest.approx(0.25, abs=0.02)
    assert during - 0.005 < after < before + 0.27  # the kernel counts in batches
    assert after < 0.9  # GiB; the parent holds 1


def test_progress_that_nobody_asked_for_goes_to_a_logger(caplog):
    with caplog.at_level("DEBUG", logger="morphofold"):
        progress_callbacks.part_of(progress_callbacks.logged, 0.5, 0.5, "sphere: ")(0.5, "round")
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [("DEBUG", " 75 % sphere: round")]
