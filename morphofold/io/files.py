"""What every reader and writer asks of a file: that it is there, bounded, whole, and replaced in one step."""

from __future__ import annotations

import ctypes
import difflib
import errno
import json
import math
import os
import platform
import re
import secrets
import shutil
import sys
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from xml.etree.ElementTree import ParseError
from xml.parsers.expat import ExpatError, errors

MAX_BYTES = 2 * 2**30   # far above any cortex (a 1 mm hemisphere has 6 MB); below what hurts a laptop
MOST_PACKED = 2000      # bytes of arrays from one of a file, twice of what zlib can do
MARKER = ".morphofold"  # in every folder that atomic_folder made, and that it may therefore replace

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)    # of a write; Python doesn't say to which file
_EXPAT_WANTS_MEMORY = errors.codes[errors.XML_ERROR_NO_MEMORY]
_ROOM = 2**20           # bytes by which a file can't grow where it was cut for want of room

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
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such {what}. {_what_is_there(path)}")
    if not path.is_file():
        raise ValueError(f"{path}: is not a regular file, looked for a {what}.")
    size = path.stat().st_size
    if size == 0:
        raise ValueError(f"{path}: is empty (0 bytes), looked for a {what}. Copy it again from its source.")
    if size > MAX_BYTES:
        raise ValueError(
            f"{path}: has {size / 2**30:.1f} GiB; a {what} may have {MAX_BYTES / 2**30:g} GiB at most."
        )
    return path


def _what_is_there(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        while not folder.parent.is_dir():
            folder = folder.parent
        return f"There is no {folder.name} in {folder.parent.absolute()}."
    names = sorted(p.name for p in folder.iterdir())
    side = path.name[:3] if path.name[:3] in ("lh.", "rh.") else ""         # the other hemisphere is no misspelling
    close = difflib.get_close_matches(path.name, [n for n in names if n.startswith(side)], n=4, cutoff=0.7)
    if close:
        return f"Close to it in that folder: {', '.join(close)}."
    if names:
        return f"That folder holds {', '.join(names[:6])}{' ...' if len(names) > 6 else ''}."
    return "That folder is empty."


@contextmanager
def decoding(path: Path, what: str, advice: str = "Make it anew from its source.") -> Iterator[None]:
    """Turn whatever a file library raises on a damaged file into one clear ``ValueError``.

    Where memory did not suffice for what the file may hold, it may be whole: that is a ``MemoryError``, with its place.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # remarks on optional parts of the format
            yield
    except (Exception, SystemExit) as error:  # meshio leaves through SystemExit
        wanted = _array_wanted(error)
        if wanted and wanted > MOST_PACKED * path.stat().st_size:      # no file of this size unpacks to that
            error = ValueError(f"it promises an array of {wanted / 2**30:.3g} GiB")
        elif _wants_memory(error):
            raise MemoryError(
                f"{path}: memory did not suffice to read {what}. Close other programs, or take a computer with more."
            ) from error
        told = "" if isinstance(error, SystemExit) else " ".join(str(error).split())[:160]
        reason = told or type(error).__name__.replace("SystemExit", "its reader gave up")
        raise ValueError(f"{path}: is truncated, damaged, or not {what} ({reason}). {advice}") from error


def _array_wanted(error: BaseException) -> float:
    """Bytes of the array for which numpy found no memory; 0 for any other error."""
    shape, dtype = getattr(error, "shape", None), getattr(error, "dtype", None)
    if not isinstance(error, MemoryError) or shape is None or dtype is None:
        return 0.0
    return float(math.prod(shape)) * float(dtype.itemsize)


def _wants_memory(error: BaseException | None) -> bool:
    """Whether an error, or one that it came of, is a lack of memory; expat tells of it by a code of its own."""
    while error is not None:
        expat = isinstance(error, (ExpatError, ParseError)) and error.code == _EXPAT_WANTS_MEMORY
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
    if path.exists() and not path.is_file():                            # which a move would put a file in place of
        raise ValueError(f"{path}: is a device or a pipe; name a file to write.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder to write {path.name} into. Make it first.")


@contextmanager
def atomic_file(path: StrPath) -> Iterator[Path]:
    """Write a file whole or not at all: yields a temporary name beside ``path``, moved onto it on success.

    The temporary name keeps the ending, so that writers which go by it still do.
    """
    path = Path(path)
    check_place(path)
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        with _naming(path, temporary):
            yield temporary
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path, temporary: Path) -> Iterator[None]:
    """Make the system's errors name ``path``, or a file in it, where they name what is temporary, or a full disk."""
    try:
        yield
    except OSError as error:
        named = os.fspath(error.filename) if isinstance(error.filename, (str, os.PathLike)) else ""
        inside = os.path.relpath(named, temporary) if named else "."
        if error.errno is None or inside.startswith("..") or not (named or error.errno in _FULL):
            raise
        raise OSError(error.errno, error.strerror, os.path.normpath(path / inside)) from error


@contextmanager
def read_back(path: StrPath, temporary: Path) -> Iterator[None]:
    """Around what a library writes and a look at it: numpy's ``tofile`` cuts files, or tells no cause, at a full disk.

    Raises
    ------
    OSError
        The system's own, of ``path``, if the file can't grow; else one that says what the library did.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        with _naming(Path(path), temporary), temporary.open("ab") as file:
            file.write(bytes(_ROOM))
            file.flush()
            os.fsync(file.fileno())
        told = " ".join(str(error).replace(os.fspath(temporary), os.fspath(path)).split())
        what = "what was written can't be read, though there is room"
        raise OSError(f"{path}: {what} ({told}). Write it again, or in another format.") from error


@contextmanager
def atomic_folder(out: StrPath) -> Iterator[Path]:
    """Write a folder whole or not at all: yields a temporary folder beside ``out``, moved there on success.

    An existing ``out`` is replaced, as a whole, only if it is empty or morphofold wrote it: it holds the
    marker file ``.morphofold`` that this function leaves, or a ``summary.json`` that names morphofold.
    If the body fails or is interrupted, ``out`` is as it was and nothing else is left.

    Raises
    ------
    FileExistsError
        If ``out`` is a file or a folder that morphofold did not write.
    """
    out = Path(os.path.abspath(out))
    if out.is_symlink():
        out = Path(os.path.realpath(out))                               # resolve() raises at a link to itself
    put_back(out)
    refuse_foreign(out)
    made = [p for p in (out.parent, *out.parent.parents) if not p.exists()]
    out.parent.mkdir(parents=True, exist_ok=True)
    _sweep(out)
    temporary = lock = None
    try:
        temporary, lock = _begun(out)
        with _naming(out, temporary):
            yield temporary
        refuse_foreign(out)
        _move_onto(temporary, out)
    except BaseException:
        if temporary is not None and (temporary / MARKER).is_file():    # else what came back by an exchange
            _remove(temporary)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise
    finally:
        if lock is not None:
            os.close(lock)


def put_back(out: StrPath) -> None:
    """Where a writer was killed between moving the old folder away and the new one here, move the old one back.

    That happens only where the system can't exchange two names; a writer that lives moves it away once more.
    """
    out = Path(os.path.realpath(out))
    old = [path for path in _beside(out) if path.suffix == ".old" and _ours(path)] if not out.exists() else []
    with suppress(OSError):
        for path in sorted(old, key=lambda path: path.stat().st_ctime_ns)[-1:]:
            os.replace(path, out)


def _beside(out: Path, host: str = "[0-9a-f]{4}") -> list[Path]:
    """Temporary folders of writers of ``out``, and old ones that they moved away."""
    name = re.compile(re.escape(f".{out.name}.") + host + r"[0-9a-f]{4}(\.old)?")
    with suppress(OSError):
        return [path for path in out.parent.iterdir() if name.fullmatch(path.name) and path.is_dir()]
    return []


def _host() -> str:
    """Four digits of this computer: locks may not be seen by others that write into the same folder."""
    return f"{zlib.crc32(platform.node().encode()) & 0xFFFF:04x}"


def _begun(out: Path) -> tuple[Path, int | None]:
    """A temporary folder beside ``out`` that holds the marker alone, and its lock."""
    for left in reversed(range(9)):
        temporary = out.with_name(f".{out.name}.{_host()}{secrets.token_hex(2)}")
        lock = None
        try:
            temporary.mkdir()
            lock = _locked(temporary)
            with _naming(out, temporary):
                (temporary / MARKER).write_text(
                    "morphofold wrote this folder and replaces it as a whole when told to write here again.\n"
                    "Delete this file to keep the folder.\n", encoding="utf-8",
                )  # fmt: skip
            return temporary, lock
        except BaseException as error:
            if lock is not None:
                os.close(lock)
            if not isinstance(error, (FileExistsError, FileNotFoundError)) or not left:     # else the name was taken
                with suppress(OSError):
                    (temporary / MARKER).unlink(missing_ok=True)
                    temporary.rmdir()
                raise
    raise AssertionError("unreachable")


if sys.platform == "win32":

    def _locked(folder: Path) -> int | None:
        """No lock: there a folder can't be opened."""
        return None

else:
    import fcntl

    def _locked(folder: Path) -> int | None:
        """A lock on a folder that ends with the process; None where another holds it or there are no locks."""
        try:
            lock = os.open(folder, os.O_RDONLY)
        except OSError:
            return None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            return None
        return lock


def _sweep(out: Path) -> None:
    """Remove what killed writers of ``out`` on this computer left beside it: theirs is what nobody has locked.

    Without locks (Windows, some file systems) and for writers on other computers it stays.
    """
    for path in sorted(_beside(out, _host())):                          # NAME before NAME.old
        with suppress(OSError):
            if path.suffix == ".old":
                if path.with_suffix("").exists() or not out.exists() or not _ours(path):
                    continue                                            # its writer may live, or it is the only one
                path = path.rename(path.with_suffix(""))                # no longer to be put back
            lock = _locked(path)
            if lock is None:
                continue
            try:
                if (path / MARKER).is_file() or not os.listdir(path) or _ours(path):
                    _remove(path)
            finally:
                os.close(lock)


def _remove(folder: Path) -> None:
    """Remove a folder of ours, its marker last: if killed on the way it is known as ours."""
    with suppress(OSError):
        names = os.listdir(folder)
        if names:
            (folder / MARKER).touch()
        for path in (folder / name for name in names if name != MARKER):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        if names:
            (folder / MARKER).unlink()
        folder.rmdir()


def _move_onto(new: Path, out: Path) -> None:
    """Put a folder in the place of another, of which another process sees the old or the new one at any time.

    Where the system can't exchange two names at once, a process killed here leaves the old beside (``.NAME.*.old``),
    which the next writer or reader of ``out`` puts back.
    """
    if not out.exists():
        try:
            os.replace(new, out)
            return
        except OSError:
            if out.is_symlink() or not out.is_dir():                    # else it came into being meanwhile
                raise
    if _exchange(new, out):
        try:
            refuse_foreign(out, found=new)                              # somebody's may have come after the last look
        except BaseException:
            _exchange(new, out)
            raise
        _remove(new)
        return
    old = out.with_name(f"{new.name}.old")
    os.replace(out, old)
    try:
        refuse_foreign(out, found=old)
        os.replace(new, out)
    except BaseException as error:
        if isinstance(error, OSError) and not old.exists():             # somebody else has put it back
            _move_onto(new, out)
            return
        os.replace(old, out)
        raise
    os.replace(old, new)                                                # no longer to be put back
    _remove(new)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system can't."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        rename = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError):                                   # an old C library
        return False
    here, exchange = -100, 2                                            # AT_FDCWD, RENAME_EXCHANGE
    done: int = rename(here, os.fsencode(one), here, os.fsencode(other), exchange)
    return done == 0


def refuse_foreign(out: Path, *, found: Path | None = None) -> None:
    """Raise ``FileExistsError`` if ``out`` is a file, or a folder with content that morphofold did not write.

    ``found`` is where it was moved to, by default nowhere.
    """
    found = found or out
    if os.path.islink(os.path.realpath(found)):
        raise FileExistsError(f"{out}: is a link to itself; name a folder to write.")
    if not found.exists():
        return
    if not found.is_dir():
        raise FileExistsError(f"{out}: is a file; name a folder to write.")
    names = sorted(p.name for p in found.iterdir())
    if names and not _ours(found):
        raise FileExistsError(
            f"{out}: morphofold did not write this folder, so it is not replaced. It holds "
            f"{', '.join(names[:4])}{' ...' if len(names) > 4 else ''}. Name a new folder, or empty this one."
        )


def _ours(out: Path) -> bool:
    if (out / MARKER).is_file():
        return True
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(summary, dict) and "morphofold" in summary
