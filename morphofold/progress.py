"""Progress of long work, told to whoever wants to know: the share done, 0 to 1, and what is being done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]


def silent(share: float, text: str = "") -> None:
    """Progress that nobody is told."""


def part_of(progress: Progress, begun: float, part: float, before: str = "") -> Progress:
    """Progress of a part of the whole that begins at a share of it; ``before`` goes before what is being done."""
    return lambda share, text: progress(begun + part * share, f"{before}{text}")
