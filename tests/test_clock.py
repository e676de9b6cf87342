"""The clock that stands still while numba compiles, and what is said meanwhile."""

import sys
import time

import pytest
from numba import njit

from morphofold.cli.progress import COMPILING, progress
from morphofold.clock import telling_of_compiling, working_seconds


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
    kernel, told = new_kernel(), []
    wall, work = time.perf_counter(), working_seconds()
    with telling_of_compiling(lambda: told.append(working_seconds())):
        kernel(3.0)
        kernel(3)
        kernel(4.0)
    wall, work = time.perf_counter() - wall, working_seconds() - work
    assert len(told) == 2                               # for floats and for integers, the inner ones within them
    assert told[0] <= told[1] <= told[0] + work
    assert work < 0.5 * wall                            # calling three times takes microseconds, compiling far more
    before = working_seconds()
    time.sleep(0.02)
    assert working_seconds() - before >= 0.02


def test_a_kernel_that_can_not_be_compiled_does_not_stop_the_clock():
    @njit
    def broken(x):
        return x + "text"

    with pytest.raises(Exception, match="No implementation of function"):
        broken(1.0)
    before = working_seconds()
    time.sleep(0.02)
    assert working_seconds() - before >= 0.02


@pytest.mark.parametrize("terminal", [False, True])
def test_compiling_is_said_once_and_not_when_quiet(terminal, capsys, monkeypatch):
    monkeypatch.setattr(type(sys.stderr), "isatty", lambda self: terminal, raising=False)
    for quiet in (True, False):
        with progress("scene", quiet) as tell:
            new_kernel()(3.0)
            new_kernel()(3.0)
            tell(0.5, "half way")
        said = capsys.readouterr().err
        if not terminal:
            assert said.count(COMPILING) == (not quiet)
        elif quiet:
            assert not said
    new_kernel()(3.0)                                   # nobody is told any more
    assert not capsys.readouterr().err
