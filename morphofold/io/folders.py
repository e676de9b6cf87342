"""Folders that are written whole or not at all, and what killed writers of them leave."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import re
import secrets
import shutil
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from morphofold.io.files import StrPath, naming

MARKER = ".morphofold"  # in every folder that atomic_folder made, and that it may therefore replace


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
        with naming(out, temporary):
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
            with naming(out, temporary):
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
