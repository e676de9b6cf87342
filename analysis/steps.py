"""Steps of a measurement that run beside each other: shown as they begin, and timed."""

from collections.abc import Callable, Sequence
from functools import partial
from threading import Lock
from typing import Any

from morphofold.progress import Progress
from morphofold.threads import run_parallel
from morphofold.timing import Stages, working_seconds

#: what it does, its share of all work, and a function that does it
Step = tuple[str, float, Callable[[], Any]]


class Steps:
    """Runs steps of some work; calls ``progress`` as each begins, with the share of the work that is done.

    ``whole`` is the sum of the shares of all steps. The seconds of ``clock`` add up to the time that passed: what steps
    took beside each other is divided among them.
    """

    def __init__(self, progress: Progress, clock: Stages | None, whole: float = 1.0):
        self._progress, self._clock, self._whole = progress, clock, whole
        self._lock, self._done = Lock(), 0.0

    def run(self, *chains: Sequence[Step]) -> None:
        """Run chains of steps beside each other: the steps of a chain after each other, all to their end."""
        if not chains:
            return
        began, spent = working_seconds(), dict.fromkeys((name for chain in chains for name, *_ in chain), 0.0)
        run_parallel(*(partial(self._follow, chain, spent) for chain in chains))
        if self._clock is not None:
            self._clock.divide(working_seconds() - began, spent)

    def _follow(self, chain: Sequence[Step], spent: dict[str, float]) -> None:
        for name, share, step in chain:
            with self._lock:
                self._progress(min(self._done / self._whole, 1.0), name)
            began = working_seconds()
            step()
            with self._lock:
                spent[name] += max(working_seconds() - began, 0.0)
                self._done += share
