"""Jobs on Dask: on workers started for them, on a cluster that is there, or on SLURM's.

A job is a call of one function with plain arguments. What a worker that dies had in hand begins anew on another; a job
whose workers died three times is put last and tried once more by itself, so that it takes no others with it.
"""

from __future__ import annotations

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
from morphofold.words import in_one_line

GiB = 2**30
DEATHS = 3  # of workers under one job, after which it is put last
ANSWER = 20  # [s] that a scheduler has to answer
AHEAD = 4  # jobs handed over per thread of a worker; the scheduler holds these alone
AT_LEAST = 64  # of them
GONE = ("scheduler-connection-lost", "scheduler-restart")  # reasons for which a client takes all to be cancelled
LOOK_AGAIN = 32  # jobs after which workers are counted again: clusters grow


@dataclass(frozen=True)
class Job:
    """A call: ``name`` tells it from all others, ``argument`` is handed to the work."""

    name: str
    argument: Any


@dataclass(frozen=True)
class Lost:
    """What became of a job that has no outcome: its workers died, or its work raised what it should not."""

    reason: str


@dataclass(frozen=True)
class Fleet:
    """Workers that are there. ``words`` say how many, with how much memory each."""

    client: Any
    words: str
    bound: str  # of the memory of one worker, in words
    flying: dict[str, Job] = field(default_factory=dict)  # by their keys

    def run(self, work: Callable[[Any], Any], jobs: Iterable[Job]) -> Iterator[tuple[Job, Any]]:
        """Call ``work(job.argument)`` for every job; yield each with what it returned, or ``Lost``, as they end.

        Few jobs at a time are with the scheduler, and none of their results once it was yielded, so that memory does
        not grow with their number.

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
        return max(AT_LEAST, AHEAD * threads)

    def _run(
        self, work: Callable[[Any], Any], jobs: Iterable[Job], window: Callable[[], int]
    ) -> Iterator[tuple[Job, Any, bool]]:
        from distributed import as_completed

        waiting, ended = iter(jobs), as_completed()
        flying: dict[str, Job] = self.flying

        def hand_over(count: int) -> None:
            for job in islice(waiting, count):
                key = f"job-{secrets.token_hex(8)}"  # no name: others may see keys
                flying[key] = job
                ended.add(self.client.submit(work, job.argument, key=key, pure=False))

        hand_over(window())
        for count, future in enumerate(ended, start=1):
            outcome, died = self._outcome(future)
            job = flying.pop(future.key)
            future.release()
            yield job, outcome, died
            hand_over(1 if count % LOOK_AGAIN else max(1, window() - len(flying)))

    def _outcome(self, future: Any) -> tuple[Any, bool]:
        from distributed import CancelledError, KilledWorker

        try:
            return future.result(), False
        except KilledWorker as error:  # a scheduler of others has its own number
            how = f"{error.allowed_failures + 1} workers died while they measured it, one after the other"
            return Lost(f"{how}; each may take {self.bound}. Give workers more memory, and see its log."), True
        except CancelledError as error:  # its client tells who did
            if self.client.status != "running" or getattr(error, "reason", "") in GONE:
                raise ConnectionError("the scheduler is gone. Run it again to go on with what is missing.") from error
            return Lost(f"it was cancelled ({in_one_line(error)}). Run it again."), False
        except (OSError, MemoryError) as error:  # of its machine: a log that can't be written
            return Lost(in_one_line(error) or type(error).__name__), False
        except Exception as error:
            return Lost(f"{type(error).__name__}: {error} (a defect; its log shows where)"), False

    @contextmanager
    def telling_of_deaths(self, warn: Callable[[list[str]], None]) -> Iterator[None]:
        """Call ``tell`` with the names of the jobs that a worker had in hand when it died."""

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
    slurm: int | None = None,
    need: float = 0.0,
) -> Iterator[Fleet]:
    """Workers for the time of a ``with``.

    Parameters
    ----------
    workers : int, optional
        Started on this machine; None: as many as its cores and its memory allow.
    threads : int
        Of each worker.
    memory : float, optional
        Bound on the memory of each worker [GiB]; a worker that passes it is stopped. None: its share of what this
        machine has.
    scheduler : str, optional
        Address of a Dask scheduler that runs already, ``"tcp://host:8786"``; its workers are what they are.
    slurm : int, optional
        SLURM jobs to ask for, as the user's ``jobqueue.yaml`` describes them.
    need : float
        What a job is expected to take at most [GiB]; 0 where that is not known.

    Yields
    ------
    Fleet

    Raises
    ------
    ImportError
        If SLURM is asked for and dask-jobqueue is not installed.
    ValueError
        If a number is none, or a job needs more memory than a worker may take.
    ConnectionError
        If nothing answers at ``scheduler``.
    """
    import dask
    from distributed import Client

    _check(workers, threads, memory, scheduler, slurm)
    settings = {
        "distributed.scheduler.allowed-failures": DEATHS - 1,
        "distributed.scheduler.worker-saturation": 1.0,
        **LESS_WATCHING,
        **NO_PAGES,
        **{f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _environment(threads).items()},
    }
    with ExitStack() as stack:
        scratch = TemporaryDirectory(dir=dask.config.get("temporary-directory", None), ignore_cleanup_errors=True)
        settings["temporary-directory"] = stack.enter_context(scratch)  # or Dask leaves a folder in that of the system
        stack.enter_context(_environment_kept())
        stack.enter_context(dask.config.set(settings))
        stack.enter_context(_quietly())
        if scheduler is not None:
            try:
                client = stack.enter_context(Client(scheduler, timeout=ANSWER))
            except (OSError, TimeoutError) as error:
                raise ConnectionError(f"{scheduler}: no scheduler answers. Start one, or leave it out.") from error
            _refuse_other_versions(client)
            known = client.scheduler_info(n_workers=-1)["workers"].values()
            bounds = {round(worker["memory_limit"] / GiB, 1) for worker in known if worker["memory_limit"]}
            bound = " or ".join(f"{x:g} GiB" for x in sorted(bounds)) or "what its machine has"
            words = f"{len(known)} workers at {scheduler}, {bound} each"
        elif slurm is not None:
            cluster = stack.enter_context(_slurm_cluster(threads, memory))
            cluster.scale(jobs=slurm)
            client = stack.enter_context(Client(cluster))
            bound = "what its SLURM job asks for" if memory is None else f"{memory:g} GiB"
            words = f"{slurm} SLURM jobs asked for, {bound} each"
        else:
            count, each = _shares(workers, threads, memory, need)
            cluster = stack.enter_context(_local_cluster(count, each))
            client = stack.enter_context(Client(cluster))
            bound = f"{each:.1f} GiB"
            words = f"{count} worker{'s' if count > 1 else ''} of {threads} thread{'s' if threads > 1 else ''}, "
            words += f"at most {bound} each"
        yield Fleet(client, words, bound)


THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: of glibc [bytes]: Dask's own gives every large array back to the system at once, and a sixth of a worker's time goes
#: into pages that it gets again; these keep a quarter of a GiB at most
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}


def _environment(threads: int) -> dict[str, str]:
    """Of a worker, from its first moment: libraries look once."""
    return {name: str(threads) for name in THREADS} | ALLOCATOR


#: every process of Dask wakes 50 times a second to see whether it is late, and workers note what they are doing 100
#: times: of two busy cores that took a twentieth
LESS_WATCHING = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "2s",
}


#: Dask's pages show names, paths and call stacks to whoever asks. Schedulers and workers listen for them whatever they
#: are told: here on this machine alone, and they know none
NO_PAGES: dict[str, list[Any]] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
UNSEEN = "127.0.0.1:0"


def version_here() -> str:
    """morphofold's version, of the process that is asked."""
    import morphofold

    return morphofold.__version__


def _refuse_other_versions(client: Any) -> None:
    try:
        found = client.run(version_here)
    except ImportError as error:
        raise MissingPart(f"its workers can't import morphofold ({error}). Install it where they run.") from error
    other = {worker: version for worker, version in sorted(found.items()) if version != version_here()}
    for worker, version in other.items():
        raise Mismatch(f"the worker {worker} has morphofold {version}, this is {version_here()}. Install one.")


def _check(workers: int | None, threads: int, memory: float | None, scheduler: str | None, slurm: int | None) -> None:
    for name, value in (("workers", workers), ("threads", threads), ("slurm", slurm)):
        if value is not None and value < 1:
            raise OutOfRange(f"{name} must be 1 or more, got {value}.")
    if memory is not None and not 0 < memory < float("inf"):
        raise OutOfRange(f"memory must be a positive number of GiB, got {memory:g}.")
    if scheduler is not None and (slurm is not None or workers is not None or memory is not None):
        raise OptionsClash("a scheduler that runs already has its own workers. Leave out workers, memory and slurm.")
    if slurm is not None and workers is not None:
        raise OptionsClash("workers are of this machine, slurm is a number of SLURM jobs. Name one of them.")


def _shares(workers: int | None, threads: int, memory: float | None, need: float) -> tuple[int, float]:
    """How many workers this machine takes, and the memory of each [GiB]."""
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
            f"one of these takes about {need:.1f} GiB, and each of {workers} workers may take {each:.1f} GiB. "
            "Ask for fewer workers, or more memory for each."
        )
    return workers, each


def _local_cluster(workers: int, memory: float) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        memory_limit=int(memory * GiB),
        scheduler_kwargs={"dashboard": False, "dashboard_address": UNSEEN},
        silence_logs=logging.CRITICAL,  # one job each: its kernels have the threads
    )


def _slurm_cluster(threads: int, memory: float | None) -> Any:
    try:
        from dask_jobqueue import SLURMCluster
    except ImportError:
        raise ImportError("workers on SLURM need the package dask-jobqueue: pip install dask-jobqueue.") from None
    import dask

    options = dask.config.get("jobqueue.slurm.scheduler-options", None) or {}
    given: dict[str, Any] = {} if memory is None else {"memory": f"{memory:g}GiB"}
    prologue = [f"export {name}={value}" for name, value in _environment(threads).items()]
    try:
        return SLURMCluster(
            cores=threads,
            processes=1,
            job_script_prologue=prologue,
            worker_extra_args=["--nthreads", "1", "--no-dashboard", "--dashboard-address", UNSEEN],
            scheduler_options={**options, "dashboard": False, "dashboard_address": UNSEEN},
            **given,
        )
    except ValueError as error:
        raise OptionsClash(f"jobqueue.yaml: {error} Pass --memory, or say it there.") from error


@contextmanager
def _environment_kept() -> Iterator[None]:
    """With what this process was told afterwards as before, and none of it for workers to inherit: what is in the
    environment overrules what Dask is told, and Dask leaves here what it told workers."""
    names = (*THREADS, *ALLOCATOR)
    before = {name: os.environ.pop(name) for name in names if name in os.environ}
    try:
        yield
    finally:
        for name in names:
            os.environ.pop(name, None)
        os.environ.update(before)


@contextmanager
def _quietly() -> Iterator[None]:
    """Without what Dask logs of workers that come and go."""
    log = logging.getLogger("distributed")
    before, log.disabled = log.level, False
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)
