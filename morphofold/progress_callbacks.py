"""Progress of long work: functions called with the share done, 0 to 1, and what is being done."""

import logging
from collections.abc import Callable, Sequence
from functools import partial

Progress = Callable[[float, str], None]


LOGGER = logging.getLogger("morphofold")


def logged(fraction: float, text: str = "") -> None:
    """Progress as debug messages of the logger ``morphofold``, which are not shown by default."""
    LOGGER.debug("%3.0f %% %s", 100 * fraction, text)


def part_of(progress: Progress, start_share: float, share: float, prefix: str = "") -> Progress:
    """Progress of a part of the work: from ``start_share`` on, of length ``share``; ``prefix`` precedes the text."""
    return lambda fraction, text: progress(start_share + share * fraction, f"{prefix}{text}")


def parts_of(progress: Progress, texts: Sequence[str]) -> list[Progress]:
    """Progress of parts of equal length, which may run beside each other; ``texts`` precede theirs."""
    fractions = [0.0] * len(texts)

    def part(part_index: int, fraction: float, text: str) -> None:
        fractions[part_index] = fraction
        progress(sum(fractions) / len(fractions), f"{texts[part_index]}{text}")

    return [partial(part, part_index) for part_index in range(len(texts))]
