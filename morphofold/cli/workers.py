"""What commands that do many tasks on workers share: the workers, notes while they work, and the answer at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
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
    reused, changed = sum(o.state == "reused" for o in outcomes), sum(o.changed for o in outcomes)
    content = {
        f"{what}s": len(outcomes),
        "with_results": len(outcomes) - len(failed),
        "from_before": reused,
        "changed": changed,
        "failed": len(failed),
        "in_part": len(partly),
        "failures": {outcome.name: dict(outcome.failures) for outcome in failed + partly},
        "page": page,
        **more,
    }
    lines = [
        f"{' '.join(filter(None, (outcome.name, part)))}: {reason}"
        for outcome in (failed + partly)[:5]
        for part, reason in outcome.failures.items()
    ]
    counts = {
        "of them from before": reused,
        "done again, because their files had changed": changed,
        "failed": len(failed),
        "in part": len(partly),
    }
    last = [f"{len(outcomes) - len(failed)} of {len(outcomes)} {what}s have results"]
    last += [f"{count} {text}" for text, count in counts.items() if count]
    return Answer(content, [*lines, f"{', '.join(last)} -> {page}"], 1 if failed or partly else 0)
