"""Progress of long work: a bar with the time left on a terminal, a line per tenth elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(label: str, quiet: bool = False) -> Iterator[Callable[[float, str], None]]:
    """Yield ``tell(share, text)`` with share from 0 to 1. Everything goes to standard error."""
    if quiet:
        yield lambda share, text="": None
    elif sys.stderr.isatty():
        with _bar(label) as tell:
            yield tell
    else:
        yield _lines(label)


@contextmanager
def _bar(label: str) -> Iterator[Callable[[float, str], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(), TextColumn("[dim]{task.fields[text]}"),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=4, transient=True) as bars:
        task = bars.add_task(label, total=1.0, text="")
        yield lambda share, text="": bars.update(task, completed=share, text=text)


def _lines(label: str) -> Callable[[float, str], None]:
    started, told = time.monotonic(), [0]

    def tell(share: float, text: str = "") -> None:
        tenth = int(10 * share)
        if tenth > told[0]:
            told[0] = tenth
            print(f"{label}: {share:4.0%} after {time.monotonic() - started:.0f} s  {text}", file=sys.stderr, flush=True)

    return tell
