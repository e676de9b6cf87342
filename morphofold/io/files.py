"""What every reader and writer asks of a file: that it is there, bounded, whole, and replaced in one step."""

from __future__ import annotations

import difflib
import errno
import math
import os
import secrets
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from xml.etree.ElementTree import ParseError
from xml.parsers.expat import ExpatError, errors

from morphofold.errors import DamagedFile, TooLarge, WrongFile

MAX_BYTES = 2 * 2**30  # far above any cortex (a 1 mm hemisphere has 6 MB); below what hurts a laptop
MOST_PACKED = 2000  # bytes of arrays from one of a file, twice of what zlib can do

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of writes alone; Python doesn't say to which file
_EXPAT_WANTS_MEMORY = errors.codes[errors.XML_ERROR_NO_MEMORY]
_ROOM = 2**20  # bytes by which a file can't grow where it was cut for want of room

StrPath = str | os.PathLike[str]


def existing_file(path: StrPath, what: str = "file") -> Path:
    """Path of a readable regular file of 1 byte to ``MAX_BYTES``; the error says what was looked for.

    Raises
    ------
    FileNotFoundError
        Nothing is there; names close to it in the same folder are listed.
    IsADirectoryError, ValueError
        It is a folder, a device, empty, or too large.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, looked for a {what}. Name the file in it.")
    if path.is_symlink() and not path.exists():
        raise FileNotFoundError(f"{path}: is a link to what is not there, looked for a {what}. Fetch it, or remove it.")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such {what}. {_what_is_there(path)}")
    if not path.is_file():
        raise WrongFile(f"{path}: is not a regular file, looked for a {what}.")
    size = path.stat().st_size
    if size == 0:
        raise DamagedFile(f"{path}: is empty (0 bytes), looked for a {what}. Copy it again from its source.")
    if size > MAX_BYTES:
        raise TooLarge(f"{path}: has {size / 2**30:.1f} GiB; a {what} may have {MAX_BYTES / 2**30:g} GiB at most.")
    return path


def _what_is_there(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        while not folder.parent.is_dir():
            folder = folder.parent
        return f"There is no {folder.name} in {folder.parent.absolute()}."
    names = sorted(p.name for p in folder.iterdir())
    side = path.name[:3] if path.name[:3] in ("lh.", "rh.") else ""  # the other hemisphere is no misspelling
    close = difflib.get_close_matches(path.name, [n for n in names if n.startswith(side)], n=4, cutoff=0.7)
    if close:
        return f"Close to it in that folder: {', '.join(close)}."
    if names:
        return f"That folder holds {', '.join(names[:6])}{f' and {len(names) - 6} more' if len(names) > 6 else ''}."
    return "That folder is empty."


@contextmanager
def decoding(path: Path, what: str, advice: str = "Make it anew from its source.") -> Iterator[None]:
    """Turn whatever a file library raises on a damaged file into one clear ``DamagedFile``; a ``WrongFile`` stays one.

    Where memory did not suffice for what the file may hold, it may be whole: that is a ``MemoryError``, with its place.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # remarks on optional parts of the format
            yield
    except (Exception, SystemExit) as error:  # meshio leaves through SystemExit
        wanted = _array_wanted(error)
        if wanted and wanted > MOST_PACKED * path.stat().st_size:  # no file of this size unpacks to that
            error = ValueError(f"it promises an array of {wanted / 2**30:.3g} GiB")
        elif _wants_memory(error):
            raise MemoryError(
                f"{path}: memory did not suffice to read {what}. Close other programs, or take a computer with more."
            ) from error
        problem = "" if isinstance(error, SystemExit) else " ".join(str(error).split())[:160]
        reason = problem or type(error).__name__.replace("SystemExit", "its reader gave up")
        kind = WrongFile if isinstance(error, WrongFile) else DamagedFile
        raise kind(f"{path}: is truncated, damaged, or not {what} ({reason}). {advice}") from error


def _array_wanted(error: BaseException) -> float:
    """Bytes of the array for which numpy found no memory; 0 for any other error."""
    shape, dtype = getattr(error, "shape", None), getattr(error, "dtype", None)
    if not isinstance(error, MemoryError) or shape is None or dtype is None:
        return 0.0
    return float(math.prod(shape)) * float(dtype.itemsize)


def _wants_memory(error: BaseException | None) -> bool:
    """Whether an error, or one that it came of, is a lack of memory; expat tells of it by a code of its own."""
    while error is not None:
        expat = isinstance(error, (ExpatError, ParseError)) and getattr(error, "code", 0) == _EXPAT_WANTS_MEMORY
        if expat or isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        error = error.__cause__ or error.__context__
    return False


def looks_like_text(head: bytes) -> bool:
    """Whether the first bytes of a file are printable text."""
    printable = sum(32 <= b < 127 or b in b"\t\r\n" for b in head)
    return bool(head) and b"\0" not in head and printable > 0.9 * len(head)


def beginning(head: bytes) -> str:
    """The first bytes of a file as an error may show them: escaped, short, one line."""
    if looks_like_text(head):
        return f"text, beginning {' '.join(head[:60].decode('ascii', 'replace').split())!r}"
    return f"bytes, beginning {head[:8].hex(' ')}"


def check_place(path: Path) -> None:
    """Refuse a name that no file can be written to."""
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder; name a file to write.")
    if path.exists() and not path.is_file():  # which a move would put a file in place of
        raise WrongFile(f"{path}: is a device or a pipe; name a file to write.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder to write {path.name} into. Make it first.")


def check_above(path: Path) -> None:
    """Refuse a place that nothing can be made at: what is there of the folders above is no folder, or not writable."""
    above = next(p for p in Path(os.path.abspath(path)).parents if os.path.lexists(p))
    if not above.is_dir():
        raise NotADirectoryError(f"{above}: is no folder, so {path.name} can't be made in it. Name another place.")
    if not os.access(above, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))


@contextmanager
def atomic_file(path: StrPath) -> Iterator[Path]:
    """Write a file whole or not at all: yields a temporary name beside ``path``, moved onto it on success.

    The temporary name keeps the ending, so that writers which go by it still do. A link at ``path`` is replaced, and
    what it points to stays as it is: it may be of a store of contents, as git-annex keeps.
    """
    path = Path(path)
    check_place(path)
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name[-60:]}")  # within 255 bytes
    try:
        with naming(path, temporary):
            yield temporary
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def open_own(path: StrPath, mode: str, **options: Any) -> IO[Any]:
    """``open`` for a file that is written in place, under a name that others can foresee: a lock, a log.

    ``mode`` is one that adds: others empty a file before it can be looked at.

    Raises
    ------
    WrongFile
        If a link, a second name of a file, a pipe or a device is there: writing would change what is not ours.
    """

    def opener(name: str, flags: int) -> int:
        # where the system can't refuse links, the look before is all there is; a pipe without a reader never waits
        number = os.open(name, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)
        there = os.fstat(number)
        if stat.S_ISREG(there.st_mode) and there.st_nlink <= 1:
            return number
        os.close(number)
        raise WrongFile(refusal)

    refusal = f"{path}: is a link, a second name of a file, a pipe or a device, so nothing is written to it. Remove it."
    if os.path.islink(path):
        raise WrongFile(refusal)
    try:
        return open(path, mode, opener=opener, **options)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EMLINK, errno.ENXIO):  # a link since then; a pipe without a reader
            raise WrongFile(refusal) from error
        raise


@contextmanager
def naming(path: Path, temporary: Path) -> Iterator[None]:
    """Make the system's errors name ``path``, or a file in it, where they name what is temporary, or a full disk."""
    try:
        yield
    except OSError as error:
        by_name = isinstance(error.filename, (str, bytes, os.PathLike))
        if error.errno is None or not (by_name or error.errno in _FULL):
            raise
        ours = Path(os.path.abspath(temporary))
        named = Path(os.path.abspath(os.fsdecode(error.filename))) if by_name else ours
        if not named.is_relative_to(ours):  # as where it is on another drive
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path / named.relative_to(ours))) from error


def write_and_look(path: StrPath, write: Callable[[str], object], read: Callable[[Path], object]) -> None:
    """Have a library write a file to the name it is given, and look whether the file can be read, whole or not at all.

    Raises
    ------
    OSError, ValueError
        As ``write_by_library`` and ``read_back`` say.
    """
    with atomic_file(path) as temporary:
        with write_by_library(path, temporary):
            write(os.fspath(temporary))
        with read_back(path, temporary):
            read(temporary)


@contextmanager
def write_by_library(path: StrPath, temporary: Path) -> Iterator[None]:
    """Around what a library writes: numpy's ``tofile`` tells no cause at a full disk.

    Raises
    ------
    OSError
        The system's own, of ``path``, if the file can't grow; else one that says what the library did.
    WrongFile
        The library's own, with the place: what was to be written is not as it should be.
    """
    try:
        yield
    except ValueError as error:
        raise WrongFile(f"{path}: can't be written ({_told(error, path, temporary)}). Take another format.") from error
    except OSError as error:
        if error.errno is not None:
            raise
        _grow(Path(path), temporary)
        problem = _told(error, path, temporary)
        raise OSError(f"{path}: can't be written, though there is room ({problem}). Write it again.") from error


@contextmanager
def read_back(path: StrPath, temporary: Path) -> Iterator[None]:
    """Around a look at what a library wrote: numpy's ``tofile`` cuts files at a full disk.

    Raises
    ------
    OSError
        The system's own, of ``path``, if the file can't grow; else one that says what was seen.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        _grow(Path(path), temporary)
        what = f"what was written can't be read, though there is room ({_told(error, path, temporary)})"
        raise OSError(f"{path}: {what}. Write it again, or in another format.") from error


def _grow(path: Path, temporary: Path) -> None:
    """Raise the system's error if the file can't grow."""
    with naming(path, temporary), temporary.open("ab") as file:
        file.write(bytes(_ROOM))
        file.flush()
        os.fsync(file.fileno())


def _told(error: Exception, path: StrPath, temporary: Path) -> str:
    return " ".join(str(error).replace(os.fspath(temporary), os.fspath(path)).split())
