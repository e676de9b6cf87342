"""One writer to a folder: a lock that the system lets go of when its process ends, however it ends."""

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

LOCK = "lock"  # there while a run writes, and after one was killed; then nobody holds it
_BUSY = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)


@contextmanager
def alone(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Hold ``folder``, made if need be, so that no other run writes there; a folder made and left empty goes again.

    With a ``name`` of its own a lock is of that part of the folder alone.

    On a file system without locks a warning says so, and nothing is held.

    Raises
    ------
    FileExistsError
        If another run holds it, in this process or in another.
    NotADirectoryError
        If ``folder`` is a file, or a link to nothing.
    WrongFile
        If a link or a device lies in the place of the lock.
    """
    if os.path.lexists(folder) and not folder.is_dir():  # mkdir's own error reads as a held lock's
        raise NotADirectoryError(f"{folder}: is no folder, so nothing can be written there. Move it away.")
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        file = _hold(folder, name)
        try:
            yield
        finally:
            _let_go(folder / name, file)
    except BaseException:
        for path in made:
            with suppress(OSError):  # not empty: what was written stays
                path.rmdir()
        raise


def _hold(folder: Path, name: str) -> IO[str]:
    """The open lock file of a folder, locked, with this process's number in it."""
    path = folder / name
    while True:
        file = open_own(path, "a+", encoding="ascii", errors="replace")
        try:
            _lock(file, folder if name == LOCK else path)
            if not _is_at(file, path):  # whoever held it has just removed it
                file.close()
                continue
            file.truncate(0)
            file.write(f"{os.getpid()}\n")
            file.flush()
        except BaseException:
            file.close()
            raise
        return file


def _lock(file: IO[str], place: Path) -> None:
    try:
        _try_lock(file)
    except OSError as error:
        if error.errno in _BUSY:
            raise FileExistsError(
                f"{place}: another run is writing here{_number(file)}. Wait for its end, or choose another folder."
            ) from None
        if error.errno not in _NO_LOCKS:
            raise
        warnings.warn(f"{place}: its file system has no locks; let no other run write here.", stacklevel=4)


if sys.platform == "win32":
    import msvcrt

    def _try_lock(file: IO[str]) -> None:
        file.seek(2**30)  # beyond the number, which others may read
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

    def _let_go(path: Path, file: IO[str]) -> None:
        file.close()
        with suppress(OSError):  # another run may have opened it already
            path.unlink()

else:
    import fcntl

    def _try_lock(file: IO[str]) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _let_go(path: Path, file: IO[str]) -> None:
        path.unlink(missing_ok=True)  # while it is held: nobody else's
        file.close()


def _number(file: IO[str]) -> str:
    """The process that wrote its number into a lock file, in brackets; nothing before it has."""
    file.seek(0)
    number = file.read(20).strip()
    return f" (process {number})" if number.isdigit() else ""


def _is_at(file: IO[str], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.lstat())
    except FileNotFoundError:
        return False
