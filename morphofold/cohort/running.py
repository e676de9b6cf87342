"""Many tasks on a fleet, and what became of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

from morphofold.cohort.fleet import Fleet, Job, Lost
from morphofold.cohort.tasks import Outcome, TaskFolder, write_record
from morphofold.progress import Progress, silent


class Task(Protocol):
    """What a task of many has."""

    @property
    def place(self) -> TaskFolder: ...


def failed(place: TaskFolder, reason: str) -> Outcome:
    """What became of a task that has no outcome of its own, and its record, where one can be written."""
    with suppress(OSError, ValueError):  # a name that no file can have
        write_record(place.record, "", {"": reason}, results=False)
    return Outcome(place.name, "failed", {"": reason})


def run_tasks(
    fleet: Fleet,
    work: Callable[[Any], Outcome],
    tasks: Sequence[Task],
    progress: Progress = silent,
    notice: Callable[[str], None] = lambda text: None,
) -> list[Outcome]:
    """Do every task on the workers of a fleet; what became of each, in the order of ``tasks``.

    ``progress`` is told the share done and the last name, ``notice`` of workers that died. A task that is lost with its
    workers has a record that says so, where one can be written, and is tried again by the next run.
    """
    jobs = [Job(task.place.name, task) for task in tasks]
    found: dict[str, Outcome] = {}
    bad = 0

    def died(names: list[str]) -> None:
        who = ", ".join(names[:3]) + " ..." * (len(names) > 3)
        notice(f"a worker died; {who} begin{'s' if len(names) == 1 else ''} anew on another")

    with fleet.telling_of_deaths(died):
        for job, outcome in fleet.run(work, jobs):
            if isinstance(outcome, Lost):
                outcome = failed(job.argument.place, outcome.reason)
            found[job.name] = outcome
            bad += outcome.state == "failed"
            words = f"{len(found)} of {len(jobs)}{f', {bad} failed' if bad else ''}, {job.name}"
            progress(len(found) / len(jobs), words)
    return [found[job.name] for job in jobs]
