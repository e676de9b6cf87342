"""Ctrl-C that waits for a moment at which a run can be taken up again."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupted:
    """Called, it says whether a signal came."""

    def __init__(self) -> None:
        self.came, self.forgotten = False, False

    def __call__(self) -> bool:
        return self.came

    def forget(self) -> None:
        """The work is whole: a signal that came too late to stop it, or comes before the end, is none."""
        self.forgotten = True


@contextmanager
def deferred_interrupt() -> Iterator[Interrupted]:
    """Hold back SIGINT and SIGTERM; yields a function that says whether one came. A second one acts at once.

    Only the main thread can hold signals; elsewhere nothing is held and the function says no.
    """
    interrupted = Interrupted()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return

    def hold(number: int, frame: object) -> None:
        if interrupted.came:
            raise KeyboardInterrupt
        interrupted.came = True

    before = {number: signal.signal(number, hold) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupted
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
    if interrupted.came and not interrupted.forgotten:      # too late to stop the work, in time for what comes after
        raise KeyboardInterrupt
