"""One writer per folder: a lock that the system releases when its process ends, in any way."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from morphofold.io.files import open_own

LOCK_FILE = "lock"  # exists while a run writes, and after a run was killed; then nobody holds it
_LOCK_HELD_ERRORS = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_NO_LOCKS_ERRORS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)


@contextmanager
def alone(folder: Path, name: str = LOCK_FILE) -> Iterator[None]:
    """Lock ``folder`` so that no other run writes there. It is made if needed, and removed again if it stays empty.

    A lock with its own ``name`` locks only that part of the folder.

    On a file system without locks, a warning is given and nothing is locked.

    Raises
    ------
    FileExistsError
        If another run holds the lock, in this process or in another.
    NotADirectoryError
        If ``folder`` is a file, or a link whose target does not exist.
    WrongFile
        If the lock file is a link or a device.
    """
    if os.path.lexists(folder) and not folder.is_dir():  # mkdir's error looks like that of a held lock
        raise NotADirectoryError(f"{folder}: is not a folder, so nothing can be written there. Move it away.")
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        file = _open_locked_file(folder, name)
        try:
            yield
        finally:
            _release_lock(folder / name, file)
    except BaseException:
        for path in made:
            with suppress(OSError):  # not empty: written files stay
                path.rmdir()
        raise


def _open_locked_file(folder: Path, name: str) -> IO[str]:
    """The open, locked lock file of a folder, with the number of this process in it."""
    path = folder / name
    while True:
        file = open_own(path, "a+", encoding="ascii", errors="replace")
        try:
            _lock_or_refuse(file, folder if name == LOCK_FILE else path)
            if not _is_file_at(file, path):  # the run that held it has just removed it
                file.close()
                continue
            file.truncate(0)
            file.write(f"{os.getpid()}\n")
            file.flush()
        except BaseException:
            file.close()
            raise
        return file


def _lock_or_refuse(file: IO[str], place: Path) -> None:
    try:
        _try_lock(file)
    except OSError as error:
        if error.errno in _LOCK_HELD_ERRORS:
            raise FileExistsError(
                f"{place}: another run is writing here{_process_number_text(file)}. Wait until it ends, or choose "
                "another folder."
            ) from None
        if error.errno not in _NO_LOCKS_ERRORS:
            raise
        warnings.warn(f"{place}: its file system has no locks. Make sure that no other run writes here.", stacklevel=4)


if sys.platform == "win32":
    import msvcrt

    def _try_lock(file: IO[str]) -> None:
        file.seek(2**30)  # after the number, which others may read
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

    def _release_lock(path: Path, file: IO[str]) -> None:
        file.close()
        with suppress(OSError):  # another run may have opened it already
            path.unlink()

else:
    import fcntl

    def _try_lock(file: IO[str]) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _release_lock(path: Path, file: IO[str]) -> None:
        path.unlink(missing_ok=True)  # while it is held: it is no other run's
        file.close()


def _process_number_text(file: IO[str]) -> str:
    """The process number in a lock file, in brackets; empty if none is written yet."""
    file.seek(0)
    number = file.read(20).strip()
    return f" (process {number})" if number.isdigit() else ""


def _is_file_at(file: IO[str], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.lstat())
    except FileNotFoundError:
        return False
