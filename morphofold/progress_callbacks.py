"""Progress of long work: functions called with the share done, 0 to 1, and what is being done."""

from collections.abc import Callable, Sequence
from functools import partial

Progress = Callable[[float, str], None]


def silent(fraction: float, text: str = "") -> None:
    """Progress that is not shown."""


def part_of(progress: Progress, begun: float, part: float, before: str = "") -> Progress:
    """Progress of a part of the work: from share ``begun`` on, of length ``part``; ``before`` precedes the text."""
    return lambda fraction, text: progress(begun + part * fraction, f"{before}{text}")


def parts_of(progress: Progress, texts: Sequence[str]) -> list[Progress]:
    """Progress of parts of equal length, which may run beside each other; ``texts`` precede theirs."""
    fractions = [0.0] * len(texts)

    def part(k: int, fraction: float, text: str) -> None:
        fractions[k] = fraction
        progress(sum(fractions) / len(fractions), f"{texts[k]}{text}")

    return [partial(part, k) for k in range(len(texts))]
