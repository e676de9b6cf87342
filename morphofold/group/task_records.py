"""Common parts of all tasks: folder of results, log, and the record that prevents doing a task twice.

A task's key is the digest of everything that its results depend on: the bytes of its inputs, its parameters, this
version. If there is a record with that key, and every written file still has its digest in the record, nothing needs to
be done. The refusal of an input is a result too. A failure of the machine (memory, a full disk, a worker that died) is
not a result, and the next run tries the task again.
"""

import hashlib
import json
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import morphofold
from morphofold.digests_and_json import Row, changed_since, sha256_of
from morphofold.io.atomic_folders import alone
from morphofold.io.files import write_text
from morphofold.io.json_files import Record, read_json, write_json
from morphofold.number_texts import in_one_line
from morphofold.timing import peak_memory

LONGEST_WAIT_FOR_LOCK = 3600.0  # [s] to wait for another worker on the same task

#: errors that reading and measuring raise for an invalid input
INPUT_ERRORS = (ValueError, TypeError, FileNotFoundError, NotADirectoryError, IsADirectoryError)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task.

    Attributes
    ----------
    name : str
    state : {"done", "reused", "failed"}
        "done" and "reused" have at least one result.
    failures : mapping
        Part of the task (a hemisphere, or "" for all of it) to the reason why it has no result.
    seconds, memory_GiB : float
        Wall time [s], and peak memory of its worker so far [GiB]; 0 if reused.
    redone : bool
        Whether it was done again because its results had been changed.
    """

    name: str
    state: str
    failures: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    memory_GiB: float = 0.0
    redone: bool = False


@dataclass(frozen=True)
class TaskFolder:
    """Where a task writes: ``out`` is the common folder, ``name`` that of the task, ``run`` identifies one run of the
    command."""

    out: str
    name: str
    run: str

    @property
    def log(self) -> Path:
        return Path(self.out) / "logs" / f"{self.name}.log"

    @property
    def record(self) -> Path:
        return Path(self.out) / "records" / f"{self.name}.json"


class TaskLog:
    """Writes lines to the log of a task, with the seconds since it began.

    Each run of the command that writes a line starts a new log; further attempts in the same run append to it. If
    nothing is done, the log stays, so it documents how the existing results were made.
    """

    def __init__(self, folder: TaskFolder):
        self._path, self._head, self._began, self._silent = folder.log, f"run {folder.run}\n", time.perf_counter(), True

    def __call__(self, text: str) -> None:
        if self._silent:
            self._silent = False
            log_text = self._path.read_text("utf-8", errors="replace") if self._path.is_file() else ""
            if not log_text.startswith(self._head):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                write_text(self._path, self._head)
                log_text = ""
            self(f"attempt {log_text.count('  attempt ') + 1}")
        with open(self._path, "a", encoding="utf-8", errors="backslashreplace") as log_file:
            log_file.write(f"{time.perf_counter() - self._began:8.1f} s  {text.rstrip()}\n")


def perform(
    folder: TaskFolder,
    key_of: Callable[[], str],
    find_files: Callable[[], Mapping[str, Path]],
    do_work: Callable[[TaskLog, list[str]], dict[str, str]],
    n_parts: int = 1,
) -> Outcome:
    """Do a task unless it has been done, and write its log and record. Any error makes only this task fail.

    Only one worker at a time does a task, from reading its record until writing it. A worker that the scheduler
    considers lost, or one of an earlier run, may still be working on it; then this one waits.

    Parameters
    ----------
    folder : TaskFolder
    key_of : callable
        Digest of everything that the results depend on.
    find_files : callable
        The existing files of the results, by name.
    do_work : callable
        Writes the results and returns the parts without results, with the reason. Its arguments are the log and the
        names of files that have changed since they were written.
    n_parts : int
        Number of parts; the task has failed if all of them have.
    """
    start, log, changed_files, file_digests = time.perf_counter(), TaskLog(folder), list[str](), dict[str, str]()
    lock = alone(folder.record.parent, f"{folder.name}.lock", LONGEST_WAIT_FOR_LOCK)
    try:
        with warnings.catch_warnings(action="always"), lock:
            warnings.showwarning = lambda message, *more, **others: log(f"warning: {message}")
            try:
                current_key, record = key_of(), read_record(folder.record)
                if record.get("key") == current_key:
                    changed_files = changed_since(record["files"], find_files())
                    if not changed_files:
                        return Outcome(folder.name, "reused" if record["results"] else "failed", record["failures"])
                    log(f"changed since they were written, so done again: {', '.join(changed_files[:5])}")
                folder.record.unlink(missing_ok=True)  # the record no longer describes the files
                failures = do_work(log, changed_files)
                is_done = len(failures) < n_parts
                if is_done:
                    file_digests = {name: sha256_of(path) for name, path in find_files().items()}
            except Exception as error:  # error of this machine, or a defect: no result
                log(traceback.format_exc())
                current_key, is_done, failures = "", False, {"": error_line(error)}
            write_record(folder.record, current_key, failures, results=is_done, files=file_digests)
            seconds, memory, state = time.perf_counter() - start, peak_memory() or 0.0, "done" if is_done else "failed"
            log(f"{state} in {seconds:.1f} s, {memory:.2f} GiB")
            return Outcome(folder.name, state, failures, seconds, memory, bool(changed_files))
    except Exception as error:  # no log or record can be written
        return Outcome(folder.name, "failed", {"": error_line(error)})


def error_line(error: Exception) -> str:
    """An error in one line; an error that is not due to an input has its class name."""
    message = in_one_line(error)
    if isinstance(error, OSError) and error.errno is not None:  # the message of the system
        return f"{error.strerror}." if error.filename is None else f"{error.filename}: {error.strerror}."
    if isinstance(error, (*INPUT_ERRORS, OSError, MemoryError)):
        return message or type(error).__name__
    return f"{type(error).__name__}: {message} (a defect; its log shows where)"


def digest(content: Row) -> str:
    """SHA-256 of the version of morphofold and of plain values."""
    return hashlib.sha256(json.dumps([morphofold.__version__, content], sort_keys=True).encode()).hexdigest()


class _TaskRecord(Record):
    """A task's record."""

    key: str
    failures: dict[str, str]
    results: bool
    files: dict[str, str]


def read_record(path: Path) -> Row:
    """Read a task's record: ``key``, ``failures``, whether it has ``results``, digests of their ``files``; empty if it
    is missing or damaged."""
    try:
        return read_json(path, _TaskRecord, "")
    except (OSError, ValueError):
        return {}


def write_record(
    path: Path, key: str, failures: Mapping[str, str], *, results: bool, files: Mapping[str, str] | None = None
) -> None:
    """Write a task's record; an empty key matches no inputs, so the next run tries the task again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"key": key, "failures": failures, "results": results, "files": files or {}})
