"""What a command prints: its answer as lines or JSON, and the progress of long work; one line each."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from morphofold.cli.command_options import Answer
from morphofold.progress_callbacks import Progress, logged


def print_answer(answer: Answer, *, as_json: bool) -> None:
    """Print the answer of a command: a file, or content as strict JSON, without NaN; or its lines."""
    if not as_json:
        for line in answer.lines:
            print_line(line)
    elif isinstance(answer.json, Path):
        print(answer.json.read_text(encoding="utf-8"), end="")
    elif answer.json is not None:
        from morphofold.digests_and_json import strict_json

        print(strict_json(answer.json), end="")


def print_line(text: str, file: TextIO | None = None) -> None:
    """Print text in one line; see :func:`one_line`."""
    print(one_line(text), file=file, flush=True)


def one_line(text: str) -> str:
    """Text in one line: characters that end a line or control a terminal are escaped as in Python."""
    from morphofold.digests_and_json import clean_name  # which imports NumPy

    return clean_name(text)


def aligned(columns: Sequence[Sequence[str]], alignments: str) -> list[str]:
    """Lines of a table from the cells of its columns, headings first; ``alignments`` has ``<`` or ``>`` for each."""
    row_format = "  ".join(f"{{:{alignment}{max(map(len, cells))}}}" for cells, alignment in zip(columns, alignments))
    return [row_format.format(*row).rstrip() for row in zip(*columns)]


COMPILING_TEXT = "compiling, once on this machine"


@contextmanager
def progress(label: str, quiet: bool = False) -> Iterator[Progress]:
    """Yield ``show(share, text)`` with share from 0 to 1. Everything goes to standard error, names in it escaped."""
    if quiet:
        yield logged
        return
    from morphofold.timing import reporting_compilation, working_seconds

    start_time = working_seconds()
    progress_display = _progress_bar if sys.stderr.isatty() else _progress_lines
    with progress_display(one_line(label)) as update:

        def show(fraction: float, text: str) -> None:
            update(fraction, one_line(text), working_seconds() - start_time)

        with reporting_compilation(lambda: update(None, COMPILING_TEXT, 0.0)):
            yield show


#: called with the share done, or None while numba compiles, a text, and the seconds of work so far
Update = Callable[[float | None, str, float], None]


def time_left(seconds: float, fraction: float) -> str:
    """The time left in words, after ``seconds`` for this share of the work; empty at shares of 0 and 1."""
    if not 0 < fraction < 1:
        return ""
    seconds_left = seconds * (1 - fraction) / fraction
    if seconds_left < 90:
        return f"{seconds_left:.0f} s left"
    minutes = round(seconds_left / 60)
    return f"{minutes} min left" if seconds_left < 5400 else f"{minutes // 60} h {minutes % 60} min left"


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
        bar_task = bars.add_task(label, total=1.0, text="", left="")

        def update(fraction: float | None, text: str, seconds: float) -> None:
            if fraction is None:
                bars.update(bar_task, text=text)
            else:
                bars.update(bar_task, completed=fraction, text=text, left=time_left(seconds, fraction))

        yield update


@contextmanager
def _progress_lines(label: str) -> Iterator[Update]:
    printed_tenths: set[int | None] = {0}

    def update(fraction: float | None, text: str, seconds: float) -> None:
        tenth = None if fraction is None else int(10 * fraction)
        if tenth in printed_tenths:
            return
        printed_tenths.add(tenth)
        if fraction is not None:
            status = ", ".join(filter(None, (f"{fraction:4.0%} after {seconds:.0f} s", time_left(seconds, fraction))))
            text = f"{status}  {text}"
        print(f"{label}: {text}", file=sys.stderr, flush=True)

    yield update
