"""Workers that do many tasks beside each other, by Dask: started on this machine, or those of a running cluster.

If a worker dies, what it was doing starts again on another worker, until it has cost three of them.
"""

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any, Protocol
from unittest.mock import patch

from morphofold import __version__
from morphofold.errors import Mismatch, TooLarge
from morphofold.group.tasks import Outcome, TaskFolder, error_line, write_record
from morphofold.progress import Progress, silent
from morphofold.provenance import Row
from morphofold.threads import BLAS_VARIABLES

GiB = 2**30
MOST_WORKER_DEATHS = 3  # workers that may die during one task
SCHEDULER_TIMEOUT_S = 20  # [s] to wait for an answer of a scheduler
TASKS_PER_MESSAGE = 500  # to the scheduler
SETTINGS: Row = {
    "distributed.scheduler.allowed-failures": MOST_WORKER_DEATHS - 1,
    "distributed.scheduler.worker-saturation": 1.0,  # no task waits on a worker, or would count as lost with it
    # by default, every process wakes 50 times a second to check for delays, and workers profile themselves 100 times a
    # second; this took a twentieth of two busy cores
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "2s",
    # pages would show names, paths and call stacks to anyone
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
#: settings of glibc [bytes]: with Dask's own, every large array is returned to the system at once, and a sixth of a
#: worker's time is lost on getting pages again; these keep a quarter of a GiB at most
ALLOCATOR_VARIABLES = {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}


class Task(Protocol):
    """What every task has."""

    @property
    def place(self) -> TaskFolder: ...


@dataclass(frozen=True)
class Lost:
    """The result of a task without outcome: its workers died, or it raised an unexpected error."""

    reason: str


@dataclass(frozen=True)
class Workers:
    """Running workers of a Dask ``client``; ``label`` describes their number and the memory of each."""

    client: Any
    label: str

    def run(
        self, work: Callable[[Any], Any], tasks: Sequence[Any], died: Callable[[list[Any]], None] = lambda tasks: None
    ) -> Iterator[tuple[Any, Any]]:
        """Call ``work`` for every task; yield each with its result or ``Lost``, in order of completion.

        ``died`` is called with the tasks of a worker that died.

        Raises
        ------
        ConnectionError
            If the scheduler is gone.
        """
        from distributed import CancelledError, KilledWorker, as_completed

        futures = self.client.map(work, tasks, pure=False, batch_size=TASKS_PER_MESSAGE)
        task_of = {future.key: task for future, task in zip(futures, tasks)}

        def on_event(event: tuple[float, Any]) -> None:
            keys = event[1].get("processing-tasks", ()) if event[1].get("action") == "remove-worker" else ()
            if interrupted := [task_of[key] for key in keys if key in task_of]:
                died(interrupted)

        self.client.subscribe_topic("all", on_event)
        try:
            for future in as_completed(futures):
                try:
                    outcome = future.result()
                except KilledWorker as error:  # another scheduler may allow another number
                    count = error.allowed_failures + 1
                    outcome = Lost(f"{count} workers died during it. Give workers more memory, and see its log.")
                except CancelledError as error:
                    raise ConnectionError(
                        "the scheduler is gone. Run it again to continue with what is missing."
                    ) from error
                except Exception as error:
                    outcome = Lost(error_line(error))
                yield task_of[future.key], outcome
        finally:
            self.client.unsubscribe_topic("all")


def run_tasks(
    workers: Workers,
    work: Callable[[Any], Outcome],
    tasks: Sequence[Task],
    progress: Progress = silent,
    notice: Callable[[str], None] = lambda text: None,
) -> list[Outcome]:
    """Do every task; return the outcomes in the order of ``tasks``.

    ``progress`` gets the share done and the last name; ``notice`` gets a message when workers die. A task that is lost
    with its workers is recorded as failed, if possible, and the next run tries it again.
    """
    outcomes: dict[str, Outcome] = {}
    n_failed = 0

    def died(interrupted: list[Task]) -> None:
        names = ", ".join(sorted(task.place.name for task in interrupted))
        notice(f"a worker died; started again on another worker: {names}")

    for task, outcome in workers.run(work, tasks, died):
        place = task.place
        if isinstance(outcome, Lost):
            with suppress(OSError, ValueError):  # a name that cannot be a file name
                write_record(place.record, "", {"": outcome.reason}, results=False)
            outcome = Outcome(place.name, "failed", {"": outcome.reason})
        outcomes[place.name] = outcome
        n_failed += outcome.state == "failed"
        failed = f", {n_failed} failed" if n_failed else ""
        progress(len(outcomes) / len(tasks), f"{len(outcomes)} of {len(tasks)}{failed}, {place.name}")
    return [outcomes[task.place.name] for task in tasks]


def open_workers(
    workers: int | None = None,
    threads: int = 1,
    memory: float | None = None,
    scheduler: str | None = None,
    need: float = 0.0,
) -> AbstractContextManager[Workers]:
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
        Expected peak memory of a task [GiB]; 0 if not known.

    Raises
    ------
    ValueError
        If a task needs more memory than a worker may use, or the workers of the scheduler have another version.
    ConnectionError
        If there is no answer from ``scheduler``.
    """
    if scheduler is not None:
        return _workers_of_cluster(scheduler)
    return _own_workers(*_workers_and_memory(workers, threads, memory, need), threads)


@contextmanager
def _workers_of_cluster(address: str) -> Iterator[Workers]:
    from distributed import Client

    try:
        client = Client(address, timeout=SCHEDULER_TIMEOUT_S)
    except OSError as error:
        raise ConnectionError(f"{address}: no answer from a scheduler. Start one, or leave this option out.") from error
    with client:
        versions = client.get_versions(packages=["morphofold"])["workers"]  # type: ignore[index]
        for worker, info in sorted(versions.items()):
            if (version := info["packages"]["morphofold"]) != __version__:
                raise Mismatch(
                    f"the worker {worker} has morphofold {version}, this is {__version__}. Install the same version."
                )
        limits = [info["memory_limit"] for info in client.scheduler_info(n_workers=-1)["workers"].values()]
        bounds = sorted({round(limit / GiB, 1) for limit in limits if limit})
        bound = " or ".join(f"{x:g} GiB" for x in bounds) or "the memory of its machine"
        yield Workers(client, f"{len(limits)} workers at {address}, {bound} each")


@contextmanager
def _own_workers(count: int, memory: float, threads: int) -> Iterator[Workers]:
    """Workers on this machine, each with ``memory`` [GiB] and one task at a time, whose kernels use the threads."""
    import dask
    from distributed import Client, LocalCluster

    # workers inherit these from their start, because libraries read them only once; Dask leaves its own behind
    variables = {"NUMBA_NUM_THREADS": str(threads)} | dict.fromkeys(BLAS_VARIABLES, "1") | ALLOCATOR_VARIABLES
    with (
        TemporaryDirectory(ignore_cleanup_errors=True) as scratch,  # otherwise Dask leaves a folder in the system's
        patch.dict(os.environ, variables),
        dask.config.set({**SETTINGS, "temporary-directory": scratch}),
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            memory_limit=int(memory * GiB),
            # it listens whatever the settings: on this machine only
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        plural = [f"{n} {word}{'s' if n > 1 else ''}" for n, word in ((count, "worker"), (threads, "thread"))]
        yield Workers(client, f"{' of '.join(plural)}, at most {memory:.1f} GiB each")


def _workers_and_memory(workers: int | None, threads: int, memory: float | None, need: float) -> tuple[int, float]:
    """Number of workers for this machine, and the memory of each [GiB]."""
    from dask.system import CPU_COUNT
    from distributed.system import MEMORY_LIMIT

    available = 0.9 * MEMORY_LIMIT / GiB  # the rest is for this process and the system
    if workers is None:
        workers = max(1, CPU_COUNT // threads)
        if size := memory or need:
            workers = max(1, min(workers, int(available / size)))
    each = available / workers if memory is None else memory
    if need > each:
        raise TooLarge(
            f"one job needs about {need:.1f} GiB, but each of {workers} workers may use only {each:.1f} GiB. "
            "Use fewer workers, or give each more memory."
        )
    return workers, each
