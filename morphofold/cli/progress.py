"""Progress of long work: a bar with the time left on a terminal, a line per tenth elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Tell(Protocol):
    """Called with the share done, 0 to 1, and a few words."""

    def __call__(self, share: float, text: str = "") -> None: ...


@contextmanager
def progress(label: str, quiet: bool = False) -> Iterator[Tell]:
    """Yield ``tell(share, text)`` with share from 0 to 1. Everything goes to standard error."""
    if quiet:

        def silent(share: float, text: str = "") -> None:
            pass

        yield silent
    elif sys.stderr.isatty():
        with _bar(label) as tell:
            yield tell
    else:
        yield _lines(label)


@contextmanager
def _bar(label: str) -> Iterator[Tell]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(), TextColumn("[dim]{task.fields[text]}"),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=4, transient=True) as bars:
        task = bars.add_task(label, total=1.0, text="")

        def tell(share: float, text: str = "") -> None:
            bars.update(task, completed=share, text=text)

        yield tell


def _lines(label: str) -> Tell:
    started, told = time.monotonic(), [0]

    def tell(share: float, text: str = "") -> None:
        tenth = int(10 * share)
        if tenth > told[0]:
            told[0] = tenth
            seconds = time.monotonic() - started
            left = f", {seconds * (1 - share) / share:.0f} s left" if 0 < share < 1 else ""
            print(f"{label}: {share:4.0%} after {seconds:.0f} s{left}  {text}", file=sys.stderr, flush=True)

    return tell
