"""Runs many tasks on a fleet and collects their outcomes."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

from morphofold.group.fleet import Fleet, Job, Lost
from morphofold.group.tasks import Outcome, TaskFolder, write_record
from morphofold.progress import Progress, silent


class Task(Protocol):
    """What every task has."""

    @property
    def place(self) -> TaskFolder: ...


def failed(place: TaskFolder, reason: str) -> Outcome:
    """The outcome of a task that returned none; also writes its record, if possible."""
    with suppress(OSError, ValueError):  # a name that cannot be a file name
        write_record(place.record, "", {"": reason}, results=False)
    return Outcome(place.name, "failed", {"": reason})


def run_tasks(
    fleet: Fleet,
    work: Callable[[Any], Outcome],
    tasks: Sequence[Task],
    progress: Progress = silent,
    notice: Callable[[str], None] = lambda text: None,
) -> list[Outcome]:
    """Do every task on the workers of a fleet; return the outcomes in the order of ``tasks``.

    ``progress`` gets the share done and the last name; ``notice`` gets a message when workers die. A task that is lost
    with its workers is recorded as failed, if possible, and the next run tries it again.
    """
    jobs = [Job(task.place.name, task) for task in tasks]
    found: dict[str, Outcome] = {}
    bad = 0

    def died(names: list[str]) -> None:
        who = ", ".join(names[:3]) + " ..." * (len(names) > 3)
        notice(f"a worker died; {who} start{'s' if len(names) == 1 else ''} again on another worker")

    with fleet.reporting_deaths(died):
        for job, outcome in fleet.run(work, jobs):
            if isinstance(outcome, Lost):
                outcome = failed(job.argument.place, outcome.reason)
            found[job.name] = outcome
            bad += outcome.state == "failed"
            words = f"{len(found)} of {len(jobs)}{f', {bad} failed' if bad else ''}, {job.name}"
            progress(len(found) / len(jobs), words)
    return [found[job.name] for job in jobs]
