"""Workers that do many tasks beside each other, by Dask: started on this machine, or those of a running cluster.

If a worker dies, what it was doing starts again on another worker, until it has cost three of them.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from morphofold.digests_and_json import Row
from morphofold.errors import TooLarge
from morphofold.group.task_records import Outcome, TaskFolder, error_line, write_record
from morphofold.progress_callbacks import Progress, logged
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
    # the environment of workers from their start, unless it is set already: one thread for BLAS, and of glibc [bytes]
    # others than Dask's own, with which every large array is returned to the system at once, and a sixth of a worker's
    # time is lost on getting pages again; these keep a quarter of a GiB at most
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(BLAS_VARIABLES, "1")
    | {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)},
}


class Task(Protocol):
    """What every task has."""

    @property
    def task_folder(self) -> TaskFolder: ...


@dataclass(frozen=True)
class Lost:
    """The result of a task without outcome: its workers died, or it raised an unexpected error."""

    reason: str


@dataclass(frozen=True)
class Workers:
    """Running workers of a Dask ``client``; ``label`` describes their number and the memory of each."""

    client: Any
    label: str

    def run(self, do_task: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Call ``do_task`` for every task; yield each with its result or ``Lost``, in order of completion.

        Raises
        ------
        ConnectionError
            If the scheduler is gone.
        """
        from distributed import CancelledError, KilledWorker, as_completed

        futures = self.client.map(do_task, tasks, pure=False, batch_size=TASKS_PER_MESSAGE)
        task_by_future = dict(zip(futures, tasks))
        for future in as_completed(futures):
            try:
                outcome = future.result()
            except KilledWorker as error:  # another scheduler may allow another number
                outcome = Lost(
                    f"{error.allowed_failures + 1} workers died during it. Give workers more memory, and see its log."
                )
            except CancelledError as error:
                raise ConnectionError(
                    "the scheduler is gone. Run it again to continue with what is missing."
                ) from error
            except Exception as error:
                outcome = Lost(error_line(error))
            yield task_by_future[future], outcome


def run_tasks(
    workers: Workers, do_task: Callable[[Any], Outcome], tasks: Sequence[Task], progress: Progress = logged
) -> list[Outcome]:
    """Do every task; return the outcomes in the order of ``tasks``.

    ``progress`` gets the share done and the last name. A task that is lost with its workers is recorded as failed, if
    possible, and the next run tries it again.
    """
    outcomes: dict[str, Outcome] = {}
    for task, outcome in workers.run(do_task, tasks):
        task_folder = task.task_folder
        if isinstance(outcome, Lost):
            with suppress(OSError, ValueError):  # a name that cannot be a file name
                write_record(task_folder.record, "", {"": outcome.reason}, results=False)
            outcome = Outcome(task_folder.name, "failed", {"": outcome.reason})
        outcomes[task_folder.name] = outcome
        n_failed = sum(other.state == "failed" for other in outcomes.values())
        failed_text = f", {n_failed} failed" if n_failed else ""
        progress(len(outcomes) / len(tasks), f"{len(outcomes)} of {len(tasks)}{failed_text}, {task_folder.name}")
    return [outcomes[task.task_folder.name] for task in tasks]


@contextmanager
def open_workers(
    workers: int | None = None,
    threads: int = 1,
    memory: float | None = None,
    scheduler: str | None = None,
    need: float = 0.0,
) -> Iterator[Workers]:
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
        If a task needs more memory than a worker may use.
    ConnectionError
        If there is no answer from ``scheduler``.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S)
        except OSError as error:
            raise ConnectionError(
                f"{scheduler}: no answer from a scheduler. Start one, or leave this option out."
            ) from error
        with client:
            yield Workers(client, f"{len(client.ncores())} workers at {scheduler}")
        return
    n_workers, memory = _workers_and_memory(workers, threads, memory, need)
    with (
        TemporaryDirectory(ignore_cleanup_errors=True) as scratch,  # otherwise Dask leaves a folder in the system's
        dask.config.set({**SETTINGS, "temporary-directory": scratch}),
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,  # one task at a time, whose kernels use the threads
            processes=True,
            memory_limit=int(memory * GiB),
            env={"NUMBA_NUM_THREADS": str(threads)},
            # it listens whatever the settings: on this machine only
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        count_texts = [f"{n} {word}{'s' if n > 1 else ''}" for n, word in ((n_workers, "worker"), (threads, "thread"))]
        yield Workers(client, f"{' of '.join(count_texts)}, at most {memory:.1f} GiB each")


def _workers_and_memory(n_workers: int | None, threads: int, memory: float | None, need: float) -> tuple[int, float]:
    """Number of workers for this machine, and the memory of each [GiB]."""
    from dask.system import CPU_COUNT
    from distributed.system import MEMORY_LIMIT

    available_GiB = 0.9 * MEMORY_LIMIT / GiB  # the rest is for this process and the system
    if n_workers is None:
        n_workers = max(1, CPU_COUNT // threads)
        if memory_per_worker := memory or need:
            n_workers = max(1, min(n_workers, int(available_GiB / memory_per_worker)))
    memory_of_each = available_GiB / n_workers if memory is None else memory
    if need > memory_of_each:
        raise TooLarge(
            f"one job needs about {need:.1f} GiB, but each of {n_workers} workers may use only {memory_of_each:.1f} "
            "GiB. Use fewer workers, or give each more memory."
        )
    return n_workers, memory_of_each
