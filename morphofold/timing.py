"""Cost of work: a clock that stops while numba compiles (once on a machine for each kernel that is called), and the
memory that is held."""

import re
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from threading import Lock
from typing import Any

from numba.core import event

COMPILING_EVENT = "numba:compile"
_compiling = event.TimingListener()  # kernels that are compiled for another kernel are counted within it
event.register(COMPILING_EVENT, _compiling)


def working_seconds() -> float:
    """Seconds since some moment [s], without the time in which numba compiled."""
    return time.perf_counter() - (_compiling.duration if _compiling.done else 0.0)


class _Reporter(event.Listener):  # type: ignore[misc]
    def __init__(self, on_compile: Callable[[], None]):
        self.report = on_compile

    def on_start(self, _: Any) -> None:
        self.report()

    def on_end(self, _: Any) -> None:
        pass


def reporting_compilation(on_compile: Callable[[], None]) -> AbstractContextManager[Any]:
    """Context in which ``on_compile`` is called whenever numba begins to compile; kernels from its cache are not
    compiled, and one that another kernel calls is reported after that."""
    context: AbstractContextManager[Any] = event.install_listener(COMPILING_EVENT, _Reporter(on_compile))
    return context


class Stages:
    """Seconds of each stage by name [s], without compiling. A stage lasts until the next begins."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._name, self._since, self._lock = "", 0.0, Lock()

    def begin(self, name: str) -> None:
        """Begin stage ``name``, and end the one before; a repeated stage adds to its time."""
        self.end()
        self._name, self._since = name, working_seconds()

    def end(self) -> None:
        """End the current stage; no other begins."""
        if self._name:
            self.add(self._name, working_seconds() - self._since)
        self._name = ""

    def add(self, name: str, seconds: float) -> None:
        """Add to the time of a stage that was timed elsewhere."""
        with self._lock:
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def divide(self, seconds: float, stage_seconds: Mapping[str, float]) -> None:
        """Divide ``seconds`` [s] among stages that ran beside each other, in proportion to what each spent."""
        total_seconds = sum(stage_seconds.values())
        for name, seconds_spent in stage_seconds.items():
            self.add(name, seconds * seconds_spent / total_seconds if total_seconds > 0 else 0.0)


def peak_memory() -> float | None:
    """Most memory that this process has held at once since it began [GiB]; None if the system does not report it.

    Work of this process before a run counts; processes that started it do not. On Linux the ``ru_maxrss`` of
    ``getrusage`` begins with the memory of the parent, so the kernel's own high-water mark is read there.
    """
    status = Path("/proc/self/status")
    if status.exists() and (peak_match := re.search(r"^VmHWM:\s*(\d+)", status.read_text(), re.MULTILINE)):
        return round(int(peak_match[1]) / 2**20, 3)  # KiB
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak_rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak_rss / (2**30 if sys.platform == "darwin" else 2**20), 3)  # bytes on macOS, else KiB
