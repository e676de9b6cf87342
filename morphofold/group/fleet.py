"""Jobs on Dask: on workers started for them, or on a running cluster.

A job is a call of one function with plain arguments. If a worker dies, its job starts again on another worker. A job
whose workers died three times is put last and tried once more alone, so that no other job is lost with it.
"""

import logging
import os
import secrets
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from tempfile import TemporaryDirectory
from typing import Any

from morphofold.errors import Mismatch, MissingPart, OptionsClash, OutOfRange, TooLarge
from morphofold.threads import BLAS_VARIABLES
from morphofold.words import in_one_line

GiB = 2**30
MOST_WORKER_DEATHS = 3  # workers that may die during one job before it is put last
SCHEDULER_TIMEOUT_S = 20  # [s] to wait for an answer of a scheduler
JOBS_PER_THREAD = 4  # jobs submitted per thread of a worker; the scheduler has only these
LEAST_JOBS_SUBMITTED = 64  # least number of jobs submitted
LOST_SCHEDULER_REASONS = (
    "scheduler-connection-lost",
    "scheduler-restart",
)  # reasons for which a client treats all jobs as cancelled
JOBS_BETWEEN_WORKER_COUNTS = 32  # jobs after which workers are counted again, because clusters grow


@dataclass(frozen=True)
class Job:
    """A call: ``name`` is unique, ``argument`` is passed to the work."""

    name: str
    argument: Any


@dataclass(frozen=True)
class Lost:
    """The result of a job without outcome: its workers died, or its work raised an unexpected error."""

    reason: str


@dataclass(frozen=True)
class Fleet:
    """Running workers. ``words`` describes their number and the memory of each."""

    client: Any
    words: str
    bound: str  # bound on the memory of one worker, as text
    flying: dict[str, Job] = field(default_factory=dict)  # by key

    def run(self, work: Callable[[Any], Any], jobs: Iterable[Job]) -> Iterator[tuple[Job, Any]]:
        """Call ``work(job.argument)`` for every job; yield each with its result or ``Lost``, in order of completion.

        The scheduler has few jobs at a time, and drops each result once it was yielded, so memory does not grow with
        the number of jobs.

        Raises
        ------
        ConnectionError
            If the scheduler is gone.
        """
        last: list[Job] = []
        for job, outcome, died in self._run(work, jobs, self._window):
            if died:
                last.append(job)
            else:
                yield job, outcome
        for job in last:
            for _, outcome, _ in self._run(work, [job], lambda: 1):
                yield job, outcome

    def _window(self) -> int:
        threads = sum(self.client.nthreads().values())
        return max(LEAST_JOBS_SUBMITTED, JOBS_PER_THREAD * threads)

    def _run(
        self, work: Callable[[Any], Any], jobs: Iterable[Job], window: Callable[[], int]
    ) -> Iterator[tuple[Job, Any, bool]]:
        from distributed import as_completed

        waiting, ended = iter(jobs), as_completed()
        flying: dict[str, Job] = self.flying

        def hand_over(count: int) -> None:
            for job in islice(waiting, count):
                key = f"job-{secrets.token_hex(8)}"  # no name, because others may see keys
                flying[key] = job
                ended.add(self.client.submit(work, job.argument, key=key, pure=False))

        hand_over(window())
        for count, future in enumerate(ended, start=1):
            outcome, died = self._outcome(future)
            job = flying.pop(future.key)
            future.release()
            yield job, outcome, died
            hand_over(1 if count % JOBS_BETWEEN_WORKER_COUNTS else max(1, window() - len(flying)))

    def _outcome(self, future: Any) -> tuple[Any, bool]:
        from distributed import CancelledError, KilledWorker

        try:
            return future.result(), False
        except KilledWorker as error:  # another scheduler may allow another number
            how = f"{error.allowed_failures + 1} workers died while they measured it, one after the other"
            return Lost(f"{how}; each may use {self.bound}. Give workers more memory, and see its log."), True
        except CancelledError as error:  # the client gives the reason
            if self.client.status != "running" or getattr(error, "reason", "") in LOST_SCHEDULER_REASONS:
                raise ConnectionError(
                    "the scheduler is gone. Run it again to continue with what is missing."
                ) from error
            return Lost(f"it was cancelled ({in_one_line(error)}). Run it again."), False
        except (OSError, MemoryError) as error:  # error of its machine, such as a log that can't be written
            return Lost(in_one_line(error) or type(error).__name__), False
        except Exception as error:
            return Lost(f"{type(error).__name__}: {error} (a defect; its log shows where)"), False

    @contextmanager
    def reporting_deaths(self, warn: Callable[[list[str]], None]) -> Iterator[None]:
        """Call ``warn`` with the names of the jobs of a worker that died."""

        def on_event(event: tuple[float, Any]) -> None:
            what = event[1]
            if isinstance(what, dict) and what.get("action") == "remove-worker" and what.get("processing-tasks"):
                known = (self.flying.get(str(key)) for key in what["processing-tasks"])
                warn(sorted(job.name for job in known if job))

        self.client.subscribe_topic("all", on_event)
        try:
            yield
        finally:
            self.client.unsubscribe_topic("all")


@contextmanager
def open_fleet(
    *,
    workers: int | None = None,
    threads: int = 1,
    memory: float | None = None,
    scheduler: str | None = None,
    need: float = 0.0,
) -> Iterator[Fleet]:
    """Workers for the duration of a ``with`` block.

    Parameters
    ----------
    workers : int, optional
        Number of workers started on this machine; None: as many as its cores and memory allow.
    threads : int
        Threads of each worker.
    memory : float, optional
        Bound on the memory of each worker [GiB]; a worker above it is stopped. None: its share of the memory of this
        machine.
    scheduler : str, optional
        Address of a running Dask scheduler, ``"tcp://host:8786"``; its workers are used as they are.
    need : float
        Expected peak memory of a job [GiB]; 0 if not known.

    Yields
    ------
    Fleet

    Raises
    ------
    ValueError
        If a number is invalid, or a job needs more memory than a worker may use.
    ConnectionError
        If there is no answer from ``scheduler``.
    """
    import dask
    from distributed import Client

    _check_arguments(workers, threads, memory, scheduler)
    settings = {
        "distributed.scheduler.allowed-failures": MOST_WORKER_DEATHS - 1,
        "distributed.scheduler.worker-saturation": 1.0,
        **LESS_PROFILING_SETTINGS,
        **NO_DASHBOARD_SETTINGS,
        **{
            f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _worker_environment(threads).items()
        },
    }
    with ExitStack() as stack:
        scratch = TemporaryDirectory(dir=dask.config.get("temporary-directory", None), ignore_cleanup_errors=True)
        settings["temporary-directory"] = stack.enter_context(scratch)  # otherwise Dask leaves a folder in the system's
        stack.enter_context(_restored_environment())
        stack.enter_context(dask.config.set(settings))
        stack.enter_context(_silenced_dask_log())
        if scheduler is not None:
            try:
                client = stack.enter_context(Client(scheduler, timeout=SCHEDULER_TIMEOUT_S))
            except (OSError, TimeoutError) as error:
                raise ConnectionError(
                    f"{scheduler}: no answer from a scheduler. Start one, or leave this option out."
                ) from error
            _refuse_other_versions(client)
            known = client.scheduler_info(n_workers=-1)["workers"].values()
            bounds = {round(worker["memory_limit"] / GiB, 1) for worker in known if worker["memory_limit"]}
            bound = " or ".join(f"{x:g} GiB" for x in sorted(bounds)) or "the memory of its machine"
            words = f"{len(known)} workers at {scheduler}, {bound} each"
        else:
            count, each = _workers_and_memory(workers, threads, memory, need)
            cluster = stack.enter_context(_local_cluster(count, each))
            client = stack.enter_context(Client(cluster))
            bound = f"{each:.1f} GiB"
            words = f"{count} worker{'s' if count > 1 else ''} of {threads} thread{'s' if threads > 1 else ''}, "
            words += f"at most {bound} each"
        yield Fleet(client, words, bound)


#: settings of glibc [bytes]: with Dask's own, every large array is returned to the system at once, and a sixth of a
#: worker's time is lost on getting pages again; these keep a quarter of a GiB at most
ALLOCATOR_VARIABLES = {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}


def _worker_environment(threads: int) -> dict[str, str]:
    """Environment of a worker from its start, because libraries read it only once."""
    return {"NUMBA_NUM_THREADS": str(threads)} | dict.fromkeys(BLAS_VARIABLES, "1") | ALLOCATOR_VARIABLES


#: by default, every Dask process wakes 50 times a second to check for delays, and workers profile themselves 100 times
#: a second; this took a twentieth of two busy cores
LESS_PROFILING_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "2s",
}


#: Dask's pages show names, paths and call stacks to anyone. Schedulers and workers always listen for requests for them,
#: whatever the settings; here they listen on this machine only, and have no pages
NO_DASHBOARD_SETTINGS: dict[str, list[Any]] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
LOOPBACK_ADDRESS = "127.0.0.1:0"


def version_here() -> str:
    """Version of morphofold in the process that calls this."""
    import morphofold

    return morphofold.__version__


def _refuse_other_versions(client: Any) -> None:
    try:
        found = client.run(version_here)
    except ImportError as error:
        raise MissingPart(f"its workers can't import morphofold ({error}). Install it where they run.") from error
    other = {worker: version for worker, version in sorted(found.items()) if version != version_here()}
    for worker, version in other.items():
        raise Mismatch(
            f"the worker {worker} has morphofold {version}, this is {version_here()}. Install the same version."
        )


def _check_arguments(workers: int | None, threads: int, memory: float | None, scheduler: str | None) -> None:
    for name, value in (("workers", workers), ("threads", threads)):
        if value is not None and value < 1:
            raise OutOfRange(f"{name} must be 1 or more, got {value}.")
    if memory is not None and not 0 < memory < float("inf"):
        raise OutOfRange(f"memory must be a positive number of GiB, got {memory:g}.")
    if scheduler is not None and (workers is not None or memory is not None):
        raise OptionsClash("a running scheduler has its own workers. Leave out workers and memory.")


def _workers_and_memory(workers: int | None, threads: int, memory: float | None, need: float) -> tuple[int, float]:
    """Number of workers for this machine, and the memory of each [GiB]."""
    from dask.system import CPU_COUNT
    from distributed.system import MEMORY_LIMIT

    there = 0.9 * MEMORY_LIMIT / GiB  # the rest is for this process and the system
    if workers is None:
        workers = max(1, CPU_COUNT // threads)
        each = memory if memory is not None else need
        if each:
            workers = max(1, min(workers, int(there / each)))
    each = memory if memory is not None else there / workers
    if need > each:
        raise TooLarge(
            f"one job needs about {need:.1f} GiB, but each of {workers} workers may use only {each:.1f} GiB. "
            "Use fewer workers, or give each more memory."
        )
    return workers, each


def _local_cluster(workers: int, memory: float) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        memory_limit=int(memory * GiB),
        scheduler_kwargs={"dashboard": False, "dashboard_address": LOOPBACK_ADDRESS},
        silence_logs=logging.CRITICAL,  # one job per worker: its kernels use the threads
    )


@contextmanager
def _restored_environment() -> Iterator[None]:
    """Remove these variables for the block, so that workers do not inherit them, and restore them afterwards.

    Variables in the environment override Dask's settings for workers, and Dask leaves its own values here.
    """
    names = _worker_environment(1)
    before = {name: os.environ.pop(name) for name in names if name in os.environ}
    try:
        yield
    finally:
        for name in names:
            os.environ.pop(name, None)
        os.environ.update(before)


@contextmanager
def _silenced_dask_log() -> Iterator[None]:
    """Silence Dask's log messages on workers that come and go."""
    log = logging.getLogger("distributed")
    before, log.disabled = log.level, False
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)
