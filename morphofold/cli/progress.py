"""Progress of long work: a bar with the time left on a terminal, a line per tenth elsewhere.

numba compiles a kernel when it is called for the first time on a machine. This is shown, and is not counted in the time
left.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from morphofold.cli.streams import one_line
from morphofold.progress import silent

COMPILING_TEXT = "compiling, once on this machine"


class ProgressCallback(Protocol):
    """Called with the share done, 0 to 1, and a short text."""

    def __call__(self, share: float, text: str = "") -> None: ...


@contextmanager
def progress(label: str, quiet: bool = False) -> Iterator[ProgressCallback]:
    """Yield ``show(share, text)`` with share from 0 to 1. Everything goes to standard error, names in it escaped."""
    if quiet:
        yield silent
    else:
        with _progress_bar(one_line(label)) if sys.stderr.isatty() else _progress_lines(one_line(label)) as show:
            yield lambda share, text="": show(share, one_line(text))


def time_left(seconds: float, share: float) -> str:
    """The time left in words, after ``seconds`` for this share of the work; empty at shares of 0 and 1."""
    if not 0 < share < 1:
        return ""
    left = seconds * (1 - share) / share
    if left < 90:
        return f"{left:.0f} s left"
    hours, minutes = divmod(round(left / 60), 60)
    return f"{60 * hours + minutes} min left" if left < 5400 else f"{hours} h {minutes} min left"


@contextmanager
def _progress_bar(label: str) -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from morphofold.timing import reporting_compilation, working_seconds

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[text]}", style="dim", markup=False),  # names may contain brackets
    )
    started = working_seconds()
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=4, transient=True) as bars:
        task = bars.add_task(label, total=1.0, text="", left="")

        def show(share: float, text: str = "") -> None:
            bars.update(task, completed=share, text=text, left=time_left(working_seconds() - started, share))

        with reporting_compilation(lambda: bars.update(task, text=COMPILING_TEXT)):
            yield show


@contextmanager
def _progress_lines(label: str) -> Iterator[ProgressCallback]:
    from morphofold.timing import reporting_compilation, working_seconds

    started, shown, compiling = working_seconds(), [0], [False]

    def show(share: float, text: str = "") -> None:
        tenth = int(10 * share)
        if tenth > shown[0]:
            shown[0] = tenth
            seconds = working_seconds() - started
            left = ", ".join(filter(None, (f"{share:4.0%} after {seconds:.0f} s", time_left(seconds, share))))
            print(f"{label}: {left}  {text}", file=sys.stderr, flush=True)

    def report_compilation() -> None:
        if not compiling[0]:
            compiling[0] = True
            print(f"{label}: {COMPILING_TEXT}", file=sys.stderr, flush=True)

    with reporting_compilation(report_compilation):
        yield show
