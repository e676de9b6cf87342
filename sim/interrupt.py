"""Delay Ctrl-C until a run is in a state from which it can be resumed."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

HANG_UP = getattr(signal, "SIGHUP", None)  # Windows has none


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Hold back SIGINT, SIGTERM and SIGHUP; yields a function that returns whether one came. A second acts at once.

    Signals that are ignored (SIGHUP under nohup) stay ignored. A second SIGHUP does not count: a terminal and its shell
    both send one when they close. Only the main thread can hold signals; in other threads nothing is held and the
    function returns False.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    came: list[int] = []

    def hold(number: int, frame: object) -> None:
        if came and number != HANG_UP:
            raise KeyboardInterrupt
        came.append(number)

    held = [n for n in (signal.SIGINT, signal.SIGTERM, HANG_UP) if n and signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, hold) for number in held}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
    if came:  # too late to stop the work, but it stops what comes after
        raise KeyboardInterrupt
