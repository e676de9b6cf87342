"""Progress of long work: a bar with the time left on a terminal, a line per tenth elsewhere.

numba compiles a kernel when it is called for the first time on a machine. This is shown, and is not counted in the time
left.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from morphofold.cli.printing import one_line
from morphofold.progress import Progress, silent

COMPILING_TEXT = "compiling, once on this machine"


@contextmanager
def progress(label: str, quiet: bool = False) -> Iterator[Progress]:
    """Yield ``show(share, text)`` with share from 0 to 1. Everything goes to standard error, names in it escaped."""
    if quiet:
        yield silent
        return
    from morphofold.timing import reporting_compilation, working_seconds

    started = working_seconds()
    with _progress_bar(one_line(label)) if sys.stderr.isatty() else _progress_lines(one_line(label)) as update:

        def show(share: float, text: str) -> None:
            update(share, one_line(text), working_seconds() - started)

        with reporting_compilation(lambda: update(None, COMPILING_TEXT, 0.0)):
            yield show


#: called with the share done, or None while numba compiles, a text, and the seconds of work so far
Update = Callable[[float | None, str, float], None]


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
def _progress_bar(label: str) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[text]}", style="dim", markup=False),  # names may contain brackets
    )
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=4, transient=True) as bars:
        task = bars.add_task(label, total=1.0, text="", left="")

        def update(share: float | None, text: str, seconds: float) -> None:
            if share is None:
                bars.update(task, text=text)
            else:
                bars.update(task, completed=share, text=text, left=time_left(seconds, share))

        yield update


@contextmanager
def _progress_lines(label: str) -> Iterator[Update]:
    printed: set[int | None] = {0}

    def update(share: float | None, text: str, seconds: float) -> None:
        tenth = None if share is None else int(10 * share)
        if tenth in printed:
            return
        printed.add(tenth)
        if share is not None:
            left = ", ".join(filter(None, (f"{share:4.0%} after {seconds:.0f} s", time_left(seconds, share))))
            text = f"{left}  {text}"
        print(f"{label}: {text}", file=sys.stderr, flush=True)

    yield update
