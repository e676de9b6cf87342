"""What ``cohort``, ``bids`` and ``sweep`` share: their workers, notes on the way, and outcomes of tasks as an answer.

In go the options and tasks, out come outcomes, and from these what is printed.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import islice
from pathlib import Path
from typing import Any

from morphofold.cli.command_options import Answer, OnWorkers
from morphofold.cli.terminal_output import print_line, progress
from morphofold.group import workers as running
from morphofold.group.task_records import Outcome

Failures = Mapping[str, Mapping[str, str]]  # by task and part, a reason


def open_workers(args: OnWorkers, memory_needed: float = 0.0) -> AbstractContextManager[running.Workers]:
    """The workers that the options name, each of which needs the memory ``memory_needed`` [GiB], if it is known."""
    return running.open_workers(args.workers, args.threads, args.memory, args.scheduler, memory_needed)


def run_with_progress(
    workers: running.Workers, label: str, work: Callable[[Any], Outcome], tasks: Sequence[running.Task], args: OnWorkers
) -> list[Outcome]:
    with progress(label, args.quiet) as on_progress:
        return running.run_tasks(workers, work, tasks, on_progress)


def print_note(text: str, args: OnWorkers) -> None:
    """Print a line on standard error, unless the command is quiet."""
    if not args.quiet:
        print_line(text, file=sys.stderr)


def answer_of(outcomes: Sequence[Outcome], kind: str, page: Path, first_lines: Sequence[str], **more: Any) -> Answer:
    """Lines ``first_lines``, the first failures, how many have results; as JSON all failures and ``more``. Code 1 if
    any failed, or has no maps on a template."""
    incomplete = sorted((outcome for outcome in outcomes if outcome.failures), key=lambda each: each.state != "failed")
    failures = {outcome.name: outcome.failures for outcome in incomplete}
    n_failed = sum(outcome.state == "failed" for outcome in incomplete)
    n_with_results = len(outcomes) - n_failed
    counts = {
        "from_before": sum(outcome.state == "reused" for outcome in outcomes),
        "changed": sum(outcome.redone for outcome in outcomes),
        "failed": n_failed,
        "in_part": len(incomplete) - n_failed,
    }
    content = {f"{kind}s": len(outcomes), "with_results": n_with_results, **counts, "failures": failures, "page": page}
    state_texts = "of them from before", "done again, because their files had changed", "failed", "in part"
    count_texts = [f"{count} {text}" for count, text in zip(counts.values(), state_texts) if count]
    last_line = ", ".join([f"{n_with_results} of {len(outcomes)} {kind}s have results", *count_texts])
    lines = [*first_lines, *failure_lines(dict(islice(failures.items(), 5))), f"{last_line} -> {page}"]
    return Answer(content | more, lines, int(any([failures, *more.get("mapped", {}).values()])))


def failure_lines(failures: Failures, text: str = "") -> list[str]:
    """The failed parts of tasks, and why, with ``text`` between them."""
    return [
        f"{name} {part}".rstrip() + f"{text}: {reason}"
        for name, reasons in failures.items()
        for part, reason in reasons.items()
    ]
