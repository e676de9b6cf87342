"""What commands that do many tasks on workers share: the workers, notes while they work, and the answer at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from morphofold.cli.options import Answer, ManyTasks
from morphofold.cli.printing import print_line
from morphofold.cli.progress import progress
from morphofold.cohort.fleet import Fleet, open_fleet
from morphofold.cohort.running import Task, run_tasks
from morphofold.cohort.tasks import Outcome


def open_workers(args: ManyTasks, need: float) -> AbstractContextManager[Fleet]:
    """The workers that the options name, each of which needs the memory ``need`` [GiB]."""
    return open_fleet(
        workers=args.workers, threads=args.threads, memory=args.memory, scheduler=args.scheduler, need=need
    )


def run_with_progress(
    fleet: Fleet, label: str, work: Callable[[Any], Outcome], tasks: Sequence[Task], args: ManyTasks
) -> list[Outcome]:
    with progress(label, args.quiet) as show:
        return run_tasks(fleet, work, tasks, show, lambda text: print_note(text, args))


def print_note(text: str, args: ManyTasks) -> None:
    """Print a line on standard error, unless the command is quiet."""
    if not args.quiet:
        print_line(text, file=sys.stderr)


def answer_of(outcomes: Sequence[Outcome], what: str, page: Path, **more: Any) -> Answer:
    """How many have results, and the first failures; as JSON all of them and ``more``. The code is 1 if any failed."""
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    partly = [outcome for outcome in outcomes if outcome.state != "failed" and outcome.failures]
    failures = {outcome.name: dict(outcome.failures) for outcome in failed + partly}
    with_results = len(outcomes) - len(failed)
    counts = {
        "from_before": sum(outcome.state == "reused" for outcome in outcomes),
        "changed": sum(outcome.changed for outcome in outcomes),
        "failed": len(failed),
        "in_part": len(partly),
    }
    content = {f"{what}s": len(outcomes), "with_results": with_results, **counts, "failures": failures, "page": page}
    texts = "of them from before", "done again, because their files had changed", "failed", "in part"
    numbers = [f"{count} {text}" for count, text in zip(counts.values(), texts) if count]
    last = ", ".join([f"{with_results} of {len(outcomes)} {what}s have results", *numbers])
    lines = [line for name in list(failures)[:5] for line in failure_lines(name, failures[name])]
    return Answer({**content, **more}, [*lines, f"{last} -> {page}"], 1 if failures else 0)


def failure_lines(name: str, failures: Mapping[str, str], text: str = "") -> list[str]:
    """The failed parts of a task, and why, with ``text`` between them."""
    return [f"{name} {part}".rstrip() + f"{text}: {reason}" for part, reason in failures.items()]
