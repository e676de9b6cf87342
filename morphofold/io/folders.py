"""Folders that are written whole or not at all."""

from __future__ import annotations

import ctypes
import json
import os
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from morphofold.io.files import StrPath, atomic_file, naming

MARKER = ".morphofold"  # in every folder that atomic_folder made, and that it may therefore replace
COLLECTION = ".morphofold-collection"   # in folders that results of many are added to, which nothing replaces


@contextmanager
def atomic_folder(out: StrPath) -> Iterator[Path]:
    """Write a folder whole or not at all: yields a temporary folder beside ``out``, moved there on success.

    An existing ``out`` is replaced, as a whole, only if it is empty or morphofold wrote it: it holds the
    marker file ``.morphofold`` that this function leaves, or a ``summary.json`` that names morphofold.
    If the body fails or is interrupted, ``out`` is as it was and nothing else is left. A process that is killed
    leaves its temporary folder beside, ``.NAME.*``.

    Raises
    ------
    FileExistsError
        If ``out`` is a file or a folder that morphofold did not write.
    """
    out = Path(os.path.realpath(out))                                   # Path.resolve() raises at a link to itself
    refuse_foreign(out)
    made = [p for p in (out.parent, *out.parent.parents) if not p.exists()]
    out.parent.mkdir(parents=True, exist_ok=True)
    temporary = out.with_name(f".{out.name}.{secrets.token_hex(4)}")
    try:
        with naming(out, temporary):
            temporary.mkdir()
            yield temporary
            (temporary / MARKER).write_text(
                "morphofold wrote this folder and replaces it as a whole when told to write here again.\n"
                "Give it another name to keep it.\n", encoding="utf-8",
            )  # fmt: skip
        refuse_foreign(out)
        _move_onto(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def _move_onto(new: Path, out: Path) -> None:
    """Put a folder in the place of another, of which another process sees the old or the new one at any time.

    Where the system can't exchange two names at once, of two writers at once one may fail, and a process killed here
    leaves the old beside (``.NAME.*.old``), of which ``moved_away`` tells.
    """
    old = out.with_name(f"{new.name}.old")
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
            os.replace(new, old)                                        # a name that our caller does not remove
            if _exchange(old, out):
                shutil.rmtree(old)
            else:
                os.replace(old, out)
            raise
        shutil.rmtree(new)
        return
    os.replace(out, old)
    try:
        refuse_foreign(out, found=old)
        os.replace(new, out)
    except BaseException:
        os.replace(old, out)
        raise
    shutil.rmtree(old)


def moved_away(out: StrPath) -> str:
    """Where a writer killed between its two moves left what was at ``out``, in words for an error; else nothing."""
    out = Path(os.path.realpath(out))
    with suppress(OSError):
        old = [p.name for p in out.parent.iterdir() if p.name.startswith(f".{out.name}.") and p.suffix == ".old"]
        if old and not out.exists():
            return f" What was there is in {sorted(old)[-1]}, beside it: its writer was killed. Rename it back."
    return ""


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system can't."""
    try:
        library, a, b = ctypes.CDLL(None), os.fsencode(one), os.fsencode(other)
        if sys.platform == "darwin":
            return bool(library.renamex_np(a, b, 2) == 0)               # RENAME_SWAP
        here, exchange = -100, 2                                        # AT_FDCWD, RENAME_EXCHANGE
        return sys.platform.startswith("linux") and bool(library.renameat2(here, a, here, b, exchange) == 0)
    except (AttributeError, OSError, TypeError):                        # an old C library, or Windows
        return False


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
    if (found / COLLECTION).is_file():
        raise FileExistsError(f"{out}: is a cohort or a sweep, which is not replaced. Name a new folder.")
    names = sorted(p.name for p in found.iterdir())
    if names and not _ours(found):
        raise FileExistsError(
            f"{out}: morphofold did not write this folder, so it is not replaced. It holds "
            f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}. Name a new folder, or "
            "empty this one."
        )


def refuse_no_collection(out: Path, kind: str) -> None:
    """Raise ``FileExistsError`` if ``out`` is there, and neither empty nor a folder that ``begin_collection`` began."""
    file = out / COLLECTION
    if file.is_file():
        there = file.read_text(encoding="utf-8", errors="replace").partition(":")[0]
        if there != kind:
            raise FileExistsError(f"{out}: is a {there:.20}, not a {kind}. Name a new folder.")
        return
    refuse_foreign(out)
    if out.exists() and any(out.iterdir()):
        raise FileExistsError(f"{out}: is of a command that replaces it as a whole. Name a new folder.")


def begin_collection(out: Path, kind: str) -> None:
    """Make or take a folder that results of many are added to, run after run, and that no command replaces.

    Raises
    ------
    FileExistsError
        If it holds anything else.
    """
    refuse_no_collection(out, kind)
    out.mkdir(parents=True, exist_ok=True)
    with atomic_file(out / COLLECTION) as file:
        file.write_text(f"{kind}: morphofold adds results to this folder and replaces none of it.\n", encoding="utf-8")


def _ours(out: Path) -> bool:
    if (out / MARKER).is_file():
        return True
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(summary, dict) and "morphofold" in summary
