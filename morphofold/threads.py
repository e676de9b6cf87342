"""How many threads numba and BLAS use, and how work is divided among them."""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from threading import Event, Lock, current_thread, main_thread
from typing import Any

from threadpoolctl import ThreadpoolController

from morphofold.errors import OutOfRange

# Threads of numba that wait for others sleep. By default they spin, and on a machine with other work, where the others
# wait for a core, a step of a strip took 27 times as long. Read when numba starts its threads.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

#: environment variables that libraries of BLAS read when they are loaded
BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "OMP_NUM_THREADS")
#: blocks into which kernels divide their work, each with its own scratch; independent of the number of threads
N_BLOCKS = 64
SECONDS_ALONE = 0.005  # of work in one thread, before others are started: that takes a tenth of it
CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # of a container or a batch job: microseconds, in a period of microseconds
#: fast_simplification has global state: only one surface is simplified at a time
SIMPLIFY_LOCK = Lock()
_interrupted = Event()  # by Ctrl-C: tasks in other threads begin nothing further


def set_threads(threads: int | None) -> None:
    """Let numba kernels use ``threads`` threads; None: all cores that this process may use.

    Results are bitwise the same for any number.

    Raises
    ------
    OutOfRange
        If the number is not between 1 and the cores of this machine.
    """
    import numba

    max_threads: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # of the affinity of the process
    if threads is None:
        threads = max_threads
        with suppress(OSError, ValueError):  # no such quota, or "max"
            quota, period = map(int, CPU_QUOTA.read_text(encoding="ascii").split())
            threads = max(1, min(max_threads, quota // period))
    if not 1 <= threads <= max_threads:
        is_from_env = "NUMBA_NUM_THREADS" in os.environ
        limit_reason = "by the environment variable NUMBA_NUM_THREADS" if is_from_env else "on this machine"
        raise OutOfRange(f"threads must be 1 to {max_threads} {limit_reason}, got {threads}.")
    numba.set_num_threads(threads)


@contextmanager
def using_threads(threads: int | None) -> Iterator[int]:
    """As :func:`set_threads`, but restores the number afterwards; yields the number of threads."""
    import numba

    previous_threads = numba.get_num_threads()
    set_threads(threads)
    try:
        yield numba.get_num_threads()
    finally:
        numba.set_num_threads(previous_threads)


def in_blocks(kernel: Callable[..., Any], n_rows: int, *arguments: Any) -> None:
    """Call ``kernel(start, stop, *arguments)`` for blocks of 0 to ``n_rows``, on all threads if they take long.

    The kernel writes to rows ``start`` to ``stop`` of some of its arguments, and only to these, so the result is the
    same for any number of threads. It must release Python's lock, as :func:`morphofold.kernels.kernel` lets it.
    """
    import numba

    block_bounds = [block * n_rows // N_BLOCKS for block in range(N_BLOCKS + 1)]
    blocks = [partial(kernel, start, stop, *arguments) for start, stop in pairwise(block_bounds) if stop > start]
    start_time, threads = time.perf_counter(), numba.get_num_threads()
    while blocks and (threads == 1 or time.perf_counter() - start_time < SECONDS_ALONE):
        blocks.pop(0)()  # the first compiles
    run_parallel(*blocks)


def run_parallel(*tasks: Callable[[], Any]) -> list[Any]:
    """The results of functions without arguments that run beside each other, each with its share of the threads.

    The first error of a task is raised; after it, or Ctrl-C, no further task begins. In other threads than the main one
    ``CancelledError`` is raised after Ctrl-C.
    """
    import numba

    if current_thread() is main_thread():
        _interrupted.clear()
    elif _interrupted.is_set():
        raise CancelledError
    threads = numba.get_num_threads()
    if threads == 1 or not tasks:
        return [task() for task in tasks]
    per_task = max(1, threads // len(tasks))
    with ThreadPoolExecutor(min(threads, len(tasks)), initializer=numba.set_num_threads, initargs=(per_task,)) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            return [future.result() for future in futures]
        except BaseException as error:
            if not isinstance(error, Exception):
                _interrupted.set()
            pool.shutdown(wait=False, cancel_futures=True)  # those that run are waited for
            raise


def enough_threads(n_tasks: int, threads: int | None = None) -> bool:
    """Whether so many large tasks, as the hemispheres of a brain, run beside each other: if each has two threads."""
    import numba

    return 1 < n_tasks <= (threads or numba.get_num_threads()) // 2


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  (its BLAS is another one than NumPy's)

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context, and decorator of functions, in which NumPy and SciPy compute products of matrices in one thread.

    Sums of several differ in last bits, and for vectors and matrices as ours several take longer: threads of BLAS spin
    while they wait. The number that the process used before is restored.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield
