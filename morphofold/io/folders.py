"""Write folders completely or not at all."""

from __future__ import annotations

import ctypes
import json
import os
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from morphofold.errors import OptionsClash
from morphofold.io.files import StrPath, atomic_file, check_above, naming

MARKER_FILE = ".morphofold"  # in every folder that atomic_folder wrote; lists the files that it wrote and may replace
OLD_MARKER_START = b"morphofold wrote this folder"  # the start of the markers of earlier versions
MOST_MARKER_BYTES = 2**26  # bytes of a marker that are read
# in folders that collect the results of many runs; they are never replaced
COLLECTION_MARKER = ".morphofold-collection"


@contextmanager
def atomic_folder(out: StrPath) -> Iterator[Path]:
    """Write a folder completely or not at all: yields a temporary folder beside ``out``, moved there on success.

    An existing ``out`` is replaced only if it is empty or holds the marker file ``.morphofold`` that this function
    writes. The files that the marker lists are replaced as a whole. All other files belong to the user and stay.
    Markers of earlier versions list no files: then files with the name of a new file are replaced, and others stay.
    If the body fails or is interrupted, ``out`` is unchanged and nothing else is left. A process that is killed
    leaves its temporary folder ``.NAME.*`` beside ``out``.

    Raises
    ------
    FileExistsError
        If ``out`` is a file or a folder that morphofold did not write, or a file of the user in it has the name of
        a file to write.
    """
    out = Path(os.path.realpath(out))  # Path.resolve() raises at a link to itself
    refuse_foreign(out)
    made = [p for p in (out.parent, *out.parent.parents) if not p.exists()]
    out.parent.mkdir(parents=True, exist_ok=True)
    temporary = out.with_name(f".{out.name}.{secrets.token_hex(4)}")
    try:
        with naming(out, temporary):
            temporary.mkdir()
            yield temporary
            mark = {"morphofold": "replaces these files when it writes here again, and keeps all others"}
            text = json.dumps({**mark, "files": sorted(_paths_below(temporary))}, indent=0)
            (temporary / MARKER_FILE).write_text(f"{text}\n", encoding="ascii")
        refuse_foreign(out)
        _replace_folder(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def remove_folder(out: Path) -> None:
    """Remove what ``atomic_folder`` wrote, and the folder if it is then empty; files of the user stay."""
    for name in _files_in_marker(out) or ():
        with suppress(OSError):
            (out / name).unlink()
    for root, _, _ in os.walk(out, topdown=False):
        if os.listdir(root) == [MARKER_FILE] and Path(root) == out:
            (out / MARKER_FILE).unlink()
        with suppress(OSError):  # a file of the user is in it
            os.rmdir(root)


def files_of(out: Path) -> dict[str, Path]:
    """The files that ``atomic_folder`` wrote in a folder, by relative path; none if it left no list."""
    return {name: path for name in sorted(_files_in_marker(out) or ()) if (path := out / name).is_file()}


def _paths_below(folder: Path) -> Iterator[str]:
    """Relative paths of everything in a folder and below: files, links, and empty folders."""
    for root, folders, files in os.walk(folder, onerror=_raise_unless_missing):
        inside = Path(root).relative_to(folder)
        links = [name for name in folders if os.path.islink(os.path.join(root, name))]
        yield from ((inside / name).as_posix() for name in (*files, *links))
        if not (folders or files) and root != os.fspath(folder):
            yield inside.as_posix()


def _raise_unless_missing(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):  # removed by another writer meanwhile
        raise error


def _files_in_marker(folder: Path) -> set[str] | None:
    """What ``atomic_folder`` wrote in a folder: empty if the list is damaged, None if there is no list."""
    marker = folder / MARKER_FILE
    if marker.is_symlink() or not marker.is_file():
        return None
    with marker.open("rb") as file:
        raw = file.read(MOST_MARKER_BYTES + 1)
    if raw.startswith(OLD_MARKER_START):
        return None
    try:
        names = json.loads(raw)["files"] if len(raw) <= MOST_MARKER_BYTES else []
    except (ValueError, KeyError, TypeError, RecursionError):
        names = []
    whole = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return {name for name in names if _is_inside(folder, name)} if whole else set()


def _is_inside(folder: Path, name: str) -> bool:
    """Whether a name is a path inside the folder that follows no link."""
    if "\0" in name or os.path.isabs(name) or ".." in Path(name).parts:
        return False
    inside = Path(name).parent
    return os.path.realpath(folder / inside) == os.path.join(os.path.realpath(folder), *inside.parts)


def _bring_user_files(old: Path, new: Path, out: Path) -> None:
    """Link the user's files in the old folder at ``out`` into the new one, unless that was done before."""
    ours = _files_in_marker(old)
    for name in _paths_below(old):
        source, target = old / name, new / name
        empty = source.is_dir() and not source.is_symlink()  # of the folders, only empty ones are listed
        if name == MARKER_FILE or (ours is not None and name in ours) or (empty and target.is_dir()):
            continue
        if os.path.lexists(target):
            if ours is None or _same_size_and_time(source, target):
                continue
            raise _user_file_in_the_way(out / name)
        try:
            (target if empty else target.parent).mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise _user_file_in_the_way(out / name) from None
        if not empty and os.path.lexists(source):
            _link_or_copy(source, target)


def _user_file_in_the_way(path: Path) -> FileExistsError:
    return FileExistsError(
        f"{path}: morphofold did not write this, and a new result would replace it. Move it away, or name a new folder."
    )


def _same_size_and_time(one: Path, other: Path) -> bool:
    a, b = one.lstat(), other.lstat()
    return (a.st_size, a.st_mtime_ns) == (b.st_size, b.st_mtime_ns)


def _link_or_copy(source: Path, target: Path) -> None:
    """Hard link to a file if the file system allows it, else a copy: simulations are large."""
    try:
        os.link(source, target, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(source, target, follow_symlinks=False)


def _replace_folder(new: Path, out: Path) -> None:
    """Replace a folder by another. At any time, another process sees the old or the new one.

    Some systems can't exchange two names in one step. There, one of two simultaneous writers may fail, and a process
    that is killed here leaves the old folder beside ``out`` (``.NAME.*.old``); ``moved_away`` reports it.
    """
    old = out.with_name(f"{new.name}.old")
    if not out.exists():
        try:
            os.replace(new, out)
            return
        except OSError:
            if out.is_symlink() or not out.is_dir():  # else the folder appeared meanwhile
                raise
    _bring_user_files(out, new, out)
    if _exchange_names(new, out):
        try:
            refuse_foreign(out, found=new)  # a file of the user may have appeared since the last check
            _bring_user_files(new, out, out)
        except BaseException:
            os.replace(new, old)  # the caller does not remove this name
            if _exchange_names(old, out):
                shutil.rmtree(old)
            else:
                os.replace(old, out)
            raise
        shutil.rmtree(new)
        return
    os.replace(out, old)
    try:
        refuse_foreign(out, found=old)
        _bring_user_files(old, new, out)
        os.replace(new, out)
    except BaseException:
        os.replace(old, out)
        raise
    shutil.rmtree(old)


def moved_away(out: StrPath) -> str:
    """Text for an error: where a writer, killed between its two moves, left the old ``out``; else empty."""
    out = Path(os.path.realpath(out))
    with suppress(OSError):
        old = [p.name for p in out.parent.iterdir() if p.name.startswith(f".{out.name}.") and p.suffix == ".old"]
        if old and not out.exists():
            return f" Its content is in {sorted(old)[-1]}, beside it: its writer was killed. Rename that folder back."
    return ""


def _exchange_names(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False if the system or the file system can't."""
    try:
        library, a, b = ctypes.CDLL(None), os.fsencode(one), os.fsencode(other)
        if sys.platform == "darwin":
            return bool(library.renamex_np(a, b, 2) == 0)  # RENAME_SWAP
        here, exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
        return sys.platform.startswith("linux") and bool(library.renameat2(here, a, here, b, exchange) == 0)
    except (AttributeError, OSError, TypeError):  # an old C library, or Windows
        return False


def refuse_overlap(out: Path, inputs: Iterable[StrPath] = ()) -> None:
    """Raise ``OptionsClash`` if ``out`` is or holds an input, or lies in a subject: a folder with surfaces in surf/."""
    target = Path(os.path.realpath(out))  # resolve() raises at a link to itself
    for source in inputs:
        place = Path(os.path.realpath(source))
        if place.exists() and (target == place or target in place.parents):
            raise OptionsClash(
                f"{out}: is, or holds, the input {source}; writing there would replace it. Name another -o."
            )
    for folder in target.parents:
        if any((folder / "surf").glob("[lr]h.*")):
            raise OptionsClash(
                f"{out}: lies in {folder}, a subject with surfaces in surf/, which stays as it is. Name another -o."
            )


def refuse_foreign(out: Path, inputs: Iterable[StrPath] = (), *, found: Path | None = None) -> None:
    """Raise ``FileExistsError`` if ``out`` is a file, or a folder with content that morphofold did not write; and as
    :func:`refuse_overlap`.

    ``found`` is the path that it was moved to; by default it was not moved.
    """
    refuse_overlap(out, inputs)
    found = found or out
    if os.path.islink(os.path.realpath(found)):
        raise FileExistsError(f"{out}: is a link to itself; name a folder to write.")
    check_above(Path(os.path.realpath(out)))
    if not found.exists():
        return
    if not found.is_dir():
        raise FileExistsError(f"{out}: is a file; name a folder to write.")
    if (found / COLLECTION_MARKER).is_file():
        raise FileExistsError(f"{out}: is a cohort or a sweep, which is not replaced. Name a new folder.")
    names = sorted(p.name for p in found.iterdir())
    if names and not _has_marker(found):
        raise FileExistsError(
            f"{out}: morphofold did not write this folder, so it is not replaced. It holds "
            f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}. Name a new folder, or "
            "empty this one."
        )


def refuse_no_collection(out: Path, kind: str) -> None:
    """Raise ``FileExistsError`` if ``out`` exists, is not empty and is not from ``begin_collection``."""
    file = out / COLLECTION_MARKER
    if file.is_file():
        there = file.read_text(encoding="utf-8", errors="replace").partition(":")[0]
        if there != kind:
            raise FileExistsError(f"{out}: is a {there:.20}, not a {kind}. Name a new folder.")
        return
    if out.is_dir() and not any(out.iterdir()):  # it is written into and never moved
        return
    refuse_foreign(out)
    if out.exists():
        raise FileExistsError(
            f"{out}: was written by a command that replaces the folder as a whole. Name a new folder."
        )


def begin_collection(out: Path, kind: str) -> None:
    """Make or reuse a folder that collects the results of many runs and that no command replaces.

    Raises
    ------
    FileExistsError
        If it holds anything else.
    """
    refuse_no_collection(out, kind)
    out.mkdir(parents=True, exist_ok=True)
    with atomic_file(out / COLLECTION_MARKER) as file:
        file.write_text(f"{kind}: morphofold adds results to this folder and replaces none of it.\n", encoding="utf-8")


def _has_marker(out: Path) -> bool:
    return (out / MARKER_FILE).is_file()
