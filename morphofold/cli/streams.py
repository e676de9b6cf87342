"""Standard streams of a command: closed ones lead nowhere, broken ones do not stop the work, lines stay lines."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar
from unicodedata import category

Result = TypeVar("Found")

#: errors of a pipe without a reader, a stream that was closed or can't be written, a terminal that has gone
_NO_READER_ERRORS = (errno.EPIPE, errno.EBADF, errno.EIO)
#: categories of characters that end a line, steer a terminal, or can't be printed
_UNPRINTABLE_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")
LONGEST_WORD, LONGEST_LINE = 300, 4000  # characters that are printed of text from a user or a file


def print_json(content: Any) -> None:
    """Print strict JSON, without NaN."""
    from morphofold.provenance import strict_json

    print(strict_json(content), end="")


def print_file(path: Path) -> None:
    """Print a file of results, for --json."""
    print(path.read_text(encoding="utf-8"), end="")


def one_line(text: str) -> str:
    """Text in one line: characters that end a line or control a terminal are escaped as in Python, and the middle of
    long words and lines is left out. File names may contain anything, and have any length."""
    line = "".join(
        c.encode("unicode_escape").decode("ascii") if category(c) in _UNPRINTABLE_CATEGORIES else c for c in text
    )
    line = re.sub(rf"\S{{{LONGEST_WORD + 1},}}", lambda word: _shortened_in_middle(word[0], LONGEST_WORD), line)
    return _shortened_in_middle(line, LONGEST_LINE)


def _shortened_in_middle(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-(most // 2 - 3) :]}"


@contextmanager
def standard_streams() -> Iterator[None]:
    """While a command runs, open closed streams to nowhere, so that no file of ours takes their numbers; if nobody
    reads a stream any more, the rest of its output is dropped, and the work goes on."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = open(os.devnull, mode, encoding="utf-8")  # the lowest free number: that of this stream
            os.set_inheritable(nowhere.fileno(), True)  # for the workers, too
            setattr(sys, name, nowhere)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for a name that is not text, or an old terminal
    kept = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _BrokenPipeTolerantStream(sys.stdout), _BrokenPipeTolerantStream(sys.stderr)  # type: ignore[assignment]
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # a full disk was reported before, or it is too late
                stream.flush()
        sys.stdout, sys.stderr = kept


class _BrokenPipeTolerantStream:
    """A stream that can be written even if nobody reads it."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return self._go_on(lambda: self._stream.write(text), len(text))

    def flush(self) -> None:
        self._go_on(self._stream.flush, None)

    def _go_on(self, act: Callable[[], Result], otherwise: Result) -> Result:
        try:
            return act()
        except OSError as error:
            if error.errno not in _NO_READER_ERRORS:
                raise
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())  # also for its buffer, and for our workers
            os.close(nowhere)
            return otherwise
