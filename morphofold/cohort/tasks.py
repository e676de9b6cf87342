"""What is the same of every task of many: its folder of results, its log, and the record by which it is not done twice.

A task's key is the digest of all that its results follow from: the bytes of its inputs, its parameters, this version. A
record of that key means that nothing needs to be done, as long as every file that was written has the digest that the
record has of it. What an input was refused for is a result like any other; what a machine is to blame for (memory, a
full disk, a worker that died) is none, and is tried again by the next run.
"""

from __future__ import annotations

import hashlib
import json
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphofold.io import atomic_file
from morphofold.io.files import open_own
from morphofold.io.json_files import Record, read_json
from morphofold.io.locks import alone
from morphofold.provenance import changed_since, sha256_of, strict_json
from morphofold.timing import peak_memory
from morphofold.words import in_one_line

LONGEST_WAIT = 3600.0  # [s] for another worker that is at the same task
PAUSE = 2.0  # [s] between two looks

#: what reading and measuring raise of an input that is not as it should be
REFUSALS = (ValueError, TypeError, FileNotFoundError, NotADirectoryError, IsADirectoryError)


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes
    ----------
    name : str
    state : {"done", "reused", "failed"}
        "done" and "reused" with at least one result.
    failures : mapping
        Part of the task (a hemisphere, or "" for all of it) to why it has no result.
    seconds, memory_GiB : float
        Wall time [s], and the most memory that its worker has held so far [GiB]; 0 if reused.
    attempt : int
        1, or more where workers died before.
    changed : bool
        Whether it was done anew since its results had been changed.
    """

    name: str
    state: str
    failures: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    memory_GiB: float = 0.0
    attempt: int = 1
    changed: bool = False


@dataclass(frozen=True)
class TaskFolder:
    """Where a task of many writes: ``out`` is the folder of all, ``name`` the task's, ``run`` tells one run of the
    command from another."""

    out: str
    name: str
    run: str

    @property
    def log(self) -> Path:
        return Path(self.out) / "logs" / f"{self.name}.log"

    @property
    def record(self) -> Path:
        return Path(self.out) / "records" / f"{self.name}.json"


class Say:
    """Writes lines into the log of a task, with the seconds since it began.

    The log is begun anew by each run of the command that has something to say, and gone on with by each attempt of one
    run; where nothing is done it stays, so that it tells how the results that are there came to be.
    """

    def __init__(self, place: TaskFolder):
        self._path, self._head, self._began = place.log, f"run {place.run}\n", time.perf_counter()
        text = place.log.read_text(encoding="utf-8", errors="replace") if place.log.is_file() else ""
        self._new_run, self._silent = not text.startswith(self._head), True
        self.attempt = 1 if self._new_run else text.count("  attempt ") + 1

    def __call__(self, text: str) -> None:
        self.begin()
        with open_own(self._path, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{time.perf_counter() - self._began:8.1f} s  {text.rstrip()}\n")

    def begin(self) -> None:
        """Say which attempt this is, unless that was said."""
        if not self._silent:
            return
        self._silent = False
        if self._new_run:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(self._path) as file:
                file.write_text(self._head, encoding="utf-8")
        self(f"attempt {self.attempt}")


def perform(
    place: TaskFolder,
    key: Callable[[], str],
    files: Callable[[], Mapping[str, Path]],
    work: Callable[[Say, list[str]], dict[str, str]],
    parts: int = 1,
) -> Outcome:
    """Do a task unless it has been done, and keep its log and record. Whatever is raised, the task alone has failed.

    One worker at a time is at a task, from the look at its record until that is written: a worker that the scheduler
    gave up for lost, or one of an earlier run, may be at it still, and is waited for.

    Parameters
    ----------
    place : TaskFolder
    key : callable
        Digest of what the results follow from.
    files : callable
        The files of the results that are there, by names.
    work : callable
        Writes the results and returns the parts that have none, with the reason; is given ``say`` for its log, and the
        names of those files that have changed since they were written.
    parts : int
        Of which all must have failed for the task to be.
    """
    try:
        return _perform(place, key, files, work, parts)
    except Exception as error:  # no log or record can be written there
        return Outcome(place.name, "failed", {"": _told(error)})


def _perform(
    place: TaskFolder,
    key: Callable[[], str],
    files: Callable[[], Mapping[str, Path]],
    work: Callable[[Say, list[str]], dict[str, str]],
    parts: int,
) -> Outcome:
    began = time.perf_counter()
    with _logged(place) as log, ExitStack() as held:
        changed: list[str] = []
        written: dict[str, str] = {}
        try:
            _hold_when_free(place, log, held)
            now = key()
            known = read_record(place.record)
            if known.get("key") == now:
                changed = changed_since(known["files"], files())
                if not changed:
                    return Outcome(place.name, "reused" if known["results"] else "failed", known["failures"])
            log.begin()
            if changed:
                names = f"{', '.join(changed[:4])}{' ...' * (len(changed) > 4)}"
                log(f"changed since they were written, so done anew: {names}")
            place.record.unlink(missing_ok=True)  # what is there is no longer what it spoke of
            failures = work(log, changed)
            results = len(failures) < parts
            if results:
                written = {name: sha256_of(path) for name, path in files().items()}
        except Exception as error:  # of this machine, or a defect: no result
            log(traceback.format_exc())
            now, results, failures = "", False, {"": _told(error)}
        write_record(place.record, now, failures, results=results, files=written)
        seconds, memory, state = time.perf_counter() - began, peak_memory() or 0.0, "done" if results else "failed"
        log(f"{state} in {seconds:.1f} s, {memory:.2f} GiB")
        return Outcome(place.name, state, failures, seconds, memory, log.attempt, bool(changed))


def _hold_when_free(place: TaskFolder, say: Say, held: ExitStack) -> None:
    """Hold a task, once no other worker is at it.

    Raises
    ------
    FileExistsError
        If another is at it for longer than LONGEST_WAIT.
    """
    until, warned = time.monotonic() + LONGEST_WAIT, False
    while True:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # no locks there: who began the run was told
                held.enter_context(alone(place.record.parent, f"{place.name}.lock"))
            return
        except FileExistsError as error:
            if time.monotonic() > until:
                raise
            if not warned:
                say(f"waiting: {error}")
            warned = True
            time.sleep(PAUSE)


def _told(error: Exception) -> str:
    """An error in one line; one that is not an input's is named by its kind."""
    words = in_one_line(error)
    if isinstance(error, OSError) and error.errno is not None:  # the system's own words, not ours
        return f"{error.strerror}." if error.filename is None else f"{error.filename}: {error.strerror}."
    if isinstance(error, (*REFUSALS, OSError, MemoryError)):
        return words or type(error).__name__
    return f"{type(error).__name__}: {words} (a defect; its log shows where)"


@contextmanager
def _logged(place: TaskFolder) -> Iterator[Say]:
    """The log of a task, with what is warned of in it."""
    say = Say(place)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *more, **others: say(f"warning: {message}")
        yield say


def digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of this version and of plain values."""
    import morphofold

    text = json.dumps([morphofold.__version__, dict(content)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class _Known(Record):
    """A task's record."""

    key: str
    failures: dict[str, str]
    results: bool
    files: dict[str, str]


def read_record(path: Path) -> dict[str, Any]:
    """A task's record: ``key``, ``failures``, whether it has ``results``, digests of their ``files``; empty if there is
    none to be relied on."""
    try:
        found = read_json(path, _Known, "")
    except (OSError, ValueError):
        return {}
    complete = (
        found["files"] if found["results"] else found["failures"]
    )  # results are files, and a failure has a reason
    return found if complete else {}


def write_record(
    path: Path, key: str, failures: Mapping[str, str], *, results: bool, files: Mapping[str, str] | None = None
) -> None:
    """Write a task's record; one with an empty key is that of no inputs, so that the next run tries again."""
    content = {"key": key, "failures": failures, "results": results, "files": files or {}}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        file.write_text(strict_json(content), encoding="utf-8")
