"""Work on several threads."""

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import numba
import numpy as np
import pytest
from made_simulations import TINY
from threadpoolctl import threadpool_info, threadpool_limits

from morphofold import threads as threads_module
from morphofold.analysis.measuring import measure
from morphofold.analysis.resampled_cortex import Preset, resampled
from morphofold.analysis.steps import Step, run_steps
from morphofold.frozen_arrays import REMEMBERED, memoized
from morphofold.kernels import kernel
from morphofold.report.pages.viewer_data import thin
from morphofold.sim.run import simulate
from morphofold.studies.folded_ball import folded_ball
from morphofold.threads import N_BLOCKS, in_blocks, run_parallel, using_threads
from morphofold.timing import Stages
from morphofold.unfolding.spheres import sphere_of

MOST = numba.get_num_threads()
two_threads = pytest.mark.skipif(MOST < 2, reason="needs two threads")


@kernel
def count(start, stop, add, times):
    for i in range(start, stop):
        times[i] += add


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=two_threads)])
@pytest.mark.parametrize("n", [0, N_BLOCKS - 1, N_BLOCKS + 1])
def test_blocks_cover_every_row_once(threads, n, monkeypatch):
    monkeypatch.setattr(threads_module, "SECONDS_ALONE", 0.0)
    times = np.zeros(n)
    with using_threads(threads):
        in_blocks(count, n, 1.0, times)
    assert (times == 1).all()


@two_threads
@pytest.mark.parametrize("alone", [0.0, 1000.0])
def test_little_work_is_done_in_one_thread(alone, monkeypatch):
    monkeypatch.setattr(threads_module, "SECONDS_ALONE", alone)
    seen = set()
    with using_threads(2):
        in_blocks(lambda start, stop: seen.add(threading.get_ident()), N_BLOCKS)
    assert (seen == {threading.get_ident()}) == (alone > 0)


@pytest.mark.parametrize(("written", "cores"), [("150000 100000", 1), ("max 100000", MOST), (None, MOST)])
def test_by_default_threads_are_as_many_as_the_quota_of_a_container_allows(written, cores, tmp_path, monkeypatch):
    monkeypatch.setattr(threads_module, "CPU_QUOTA", tmp_path / "cpu.max")
    if written:
        (tmp_path / "cpu.max").write_text(written)
    with using_threads(None) as threads:
        assert threads == cores
    with pytest.raises(ValueError, match=r"\bthreads\b.*\b10000\b"), using_threads(10_000):
        pass


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two_blas_threads():
    with threadpool_limits(2, "blas"):
        if blas_threads() != {2}:
            pytest.skip("BLAS has one thread")
        yield


WORK = {
    "measure": lambda progress: measure(folded_ball(1000), progress=progress),
    "unfold": lambda progress: sphere_of(folded_ball(1000).white, progress),
    "grow": lambda progress: simulate("demo", settings=[*TINY, "output.stages=[]"], progress=progress),
}


@pytest.mark.parametrize("name", WORK)
def test_public_functions_compute_with_one_blas_thread_and_restore_what_was(name, two_blas_threads, cwd):
    seen = set()
    WORK[name](lambda fraction, text: seen.update(blas_threads()))
    assert (seen, blas_threads()) == ({1}, {2})


ENVIRONMENT = """
import os
from morphofold.cli import main
main(["theory", "radius"])
from threadpoolctl import threadpool_info
blas = [library for library in threadpool_info() if library["user_api"] == "blas"]
print(os.environ["OMP_WAIT_POLICY"], {library["num_threads"] for library in blas})
"""


def test_commands_compute_with_one_blas_thread_and_waiting_threads_sleep():
    names = (*threads_module.BLAS_VARIABLES, "OMP_WAIT_POLICY")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run(
        [sys.executable, "-c", ENVIRONMENT], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "PASSIVE {1}"


@two_threads
def test_tasks_share_the_threads_and_their_results_come_in_order():
    with using_threads(2):
        assert run_parallel(*[numba.get_num_threads] * 3) == [1, 1, 1]
        assert len(set(run_parallel(*[lambda: time.sleep(0.05) or threading.get_ident()] * 2))) == 2
        assert run_parallel(lambda: time.sleep(0.05) or "slow", lambda: "fast", lambda: "last") == [
            "slow",
            "fast",
            "last",
        ]
        assert numba.get_num_threads() == 2


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=two_threads)])
def test_an_error_of_a_task_comes_out_and_tasks_that_wait_are_not_begun(threads):
    begun = []

    def fail():
        raise ValueError("this one")

    with using_threads(threads), pytest.raises(ValueError, match="this one"):
        run_parallel(fail, lambda: time.sleep(0.1), *[lambda: time.sleep(0.1) or begun.append(1)] * 20)
    assert len(begun) < 3


@two_threads
def test_after_ctrl_c_tasks_in_other_threads_begin_nothing_further(usual_signals):
    steps = []

    def many_steps():
        for _ in range(100):
            run_parallel(lambda: time.sleep(0.02))
            steps.append(1)

    with using_threads(2):
        threading.Timer(0.1, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            run_parallel(many_steps, many_steps)
        assert 0 < len(steps) < 100
        assert run_parallel(lambda: 1, lambda: run_parallel(lambda: 2)) == [1, [2]]


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=two_threads)])
def test_seconds_of_steps_beside_each_other_add_up_to_the_time_that_passed(threads):
    clock, seen, began = Stages(), [], time.perf_counter()
    rows = [("first", (), 0.2, "first"), ("long", ("first",), 0.3, "long"), ("other", ("first",), 0.4, "long")]
    steps = [Step(name, after, (), time.sleep, seconds, stage) for name, after, seconds, stage in rows]
    with using_threads(threads):
        run_steps(steps, 0.02, {}, lambda fraction, name: seen.append((fraction, name)), clock)
    assert sum(clock.seconds.values()) == pytest.approx(time.perf_counter() - began, abs=0.02)
    assert [name for _, name in seen] == ["first", "long", "long"]
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen)


def test_results_of_arrays_that_can_not_change_are_kept_as_long_as_these_live():
    calls = []

    @memoized
    def doubled(array, times=2):
        calls.append(times)
        return array * times, array[:1]

    array = np.arange(3.0)
    assert doubled(array) is not doubled(array)
    array.flags.writeable = False
    first = doubled(array)
    assert doubled(array) is first
    assert doubled(array, times=3) is not first
    assert calls == [2, 2, 2, 3]
    assert not any(part.flags.writeable for part in first)
    view = array[:2]
    assert doubled(view) is not doubled(view)
    assert len(REMEMBERED[-1]) == 2
    del array, view, first
    assert len(REMEMBERED[-1]) == 0


@two_threads
@pytest.mark.parametrize(
    "work", [partial(thin, max_vertices=2000), lambda cortex: resampled(cortex, Preset(2000, 0, 6.0)).cortex]
)
def test_surfaces_that_are_simplified_beside_each_other_are_those_of_one_at_a_time(work):
    """The library that does it has global state."""
    balls = [folded_ball(n) for n in (10_000, 12_000)]
    alone = [work(ball).faces for ball in balls]
    with using_threads(2):
        for faces, result in zip(alone, run_parallel(*(partial(work, ball) for ball in balls)), strict=True):
            np.testing.assert_array_equal(result.faces, faces)
