"""Progress of long work: functions called with the share done, 0 to 1, and what is being done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]


def silent(share: float, text: str = "") -> None:
    """Progress that is not shown."""


def part_of(progress: Progress, begun: float, part: float, before: str = "") -> Progress:
    """Progress of a part of the work: from share ``begun`` on, of length ``part``; ``before`` precedes the text."""
    return lambda share, text: progress(begun + part * share, f"{before}{text}")
