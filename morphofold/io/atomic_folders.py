"""Folders of results: written completely or not at all, by one run at a time, and never over files of others.

Commands call ``refuse_foreign`` before their work, and write in ``atomic_folder``; a cohort or a sweep, which collects
the results of many runs, begins with ``begin_collection`` and holds the lock of ``alone``.
"""

import json
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from morphofold.errors import OptionsClash
from morphofold.io.files import StrPath, check_above, error_names_file, write_text

MARKER_FILE = ".morphofold"  # in every folder that atomic_folder wrote; lists the files that it wrote and may replace
# in folders that collect the results of many runs; they are never replaced
COLLECTION_MARKER = ".morphofold-collection"
LOCK_FILE = "lock"  # exists while a run writes, and after a run was killed; then nobody holds it


@contextmanager
def atomic_folder(out: StrPath) -> Iterator[Path]:
    """Write a folder completely or not at all: yields a temporary folder beside ``out``, moved there on success.

    An existing ``out`` is replaced only if it is empty or holds the marker file ``.morphofold`` that this function
    writes. The files that the marker lists are replaced as a whole. All other files belong to the user and stay.
    If the body fails or is interrupted, ``out`` is unchanged and nothing else is left. A process that is killed
    leaves its temporary folder ``.NAME.*`` beside ``out``; if that is between the two moves at the end, the old folder
    is there, too, as ``.NAME.*.old``.

    Raises
    ------
    FileExistsError
        If ``out`` is a file or a folder that morphofold did not write, or a file of the user in it has the name of
        a file to write.
    """
    out = Path(os.path.realpath(out))
    refuse_foreign(out)
    temporary = out.with_name(f".{out.name}.{secrets.token_hex(4)}")
    with _made_folder(out.parent):
        try:
            with error_names_file(out, temporary):
                temporary.mkdir()
                yield temporary
                marker = {
                    "morphofold": "replaces these files when it writes here again, and keeps all others",
                    "files": sorted(_files_below(temporary)),
                }
                (temporary / MARKER_FILE).write_text(f"{json.dumps(marker, indent=0)}\n", "ascii")
            _replace_folder(temporary, out)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def mark_as_ours(out: Path) -> None:
    """Mark an empty or new folder as ours, so that parts can be written into it before the whole."""
    if not out.is_dir() or not any(out.iterdir()):
        with atomic_folder(out):
            pass


@contextmanager
def alone(folder: Path, lock_name: str = LOCK_FILE, wait_seconds: float = 0.0) -> Iterator[None]:
    """Lock ``folder`` so that no other run writes there. It is made if needed, and removed again if it stays empty.

    The system releases the lock when the process ends, in any way. A lock with its own ``lock_name`` locks only that
    part of the folder. If another run holds it, this one waits for so many seconds.

    Raises
    ------
    FileExistsError
        If another run holds the lock, in this process or in another.
    NotADirectoryError
        If ``folder`` is a file, or a link whose target does not exist.
    """
    from filelock import FileLock, Timeout

    if os.path.lexists(folder) and not folder.is_dir():  # mkdir's error would mean that another run writes here
        raise NotADirectoryError(f"{folder}: is not a folder, so nothing can be written there. Move it away.")
    with _made_folder(folder):
        try:
            with FileLock(folder / lock_name, timeout=wait_seconds):
                try:
                    yield
                finally:
                    with suppress(OSError):  # Windows removes no open file
                        (folder / lock_name).unlink()
        except Timeout:
            locked_path = folder if lock_name == LOCK_FILE else folder / lock_name
            raise FileExistsError(
                f"{locked_path}: another run is writing here. Wait until it ends, or choose another folder."
            ) from None


@contextmanager
def _made_folder(folder: Path) -> Iterator[None]:
    """Make a folder; after an error, remove what was made, if it is empty."""
    new_folders = [ancestor for ancestor in (folder, *folder.parents) if not ancestor.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for path in new_folders:
            with suppress(OSError):  # written files stay
                path.rmdir()
        raise


def remove_folder(out: Path) -> None:
    """Remove what ``atomic_folder`` wrote, and the folder if it is then empty; files of the user stay."""
    for path in files_of(out).values():
        with suppress(OSError):
            path.unlink()
    for root, _, _ in os.walk(out, topdown=False):
        if os.listdir(root) == [MARKER_FILE] and Path(root) == out:
            (out / MARKER_FILE).unlink()
        with suppress(OSError):  # a file of the user is in it
            os.rmdir(root)


def files_of(out: Path) -> dict[str, Path]:
    """The files that ``atomic_folder`` wrote in a folder, by relative path; none if it left no list."""
    try:
        files = {name: out / name for name in json.loads((out / MARKER_FILE).read_bytes())["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    names_inside = [name for name, path in files.items() if out in path.parents and ".." not in path.parts]
    return {name: files[name] for name in names_inside if files[name].is_file()}


def _files_below(folder: Path) -> list[str]:
    """Relative paths of the files and links in a folder and below."""
    paths = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())  # it follows no links
    return [path.relative_to(folder).as_posix() for path in paths]


def _replace_folder(new_folder: Path, out: Path) -> None:
    """Move a new folder to ``out``, and the user's files from the old one into it."""
    user_files = sorted({*_files_below(out)} - {MARKER_FILE, *files_of(out)})
    for name in user_files:
        if os.path.lexists(new_folder / name) or any((new_folder / folder).is_file() for folder in Path(name).parents):
            raise FileExistsError(
                f"{out / name}: morphofold did not write this, and a new result would replace it. Move it away, or "
                "name a new folder."
            )
    old_folder = new_folder.with_name(f"{new_folder.name}.old")
    if out.exists():
        os.replace(out, old_folder)
    try:
        os.replace(new_folder, out)
    except BaseException:
        if old_folder.exists():
            os.replace(old_folder, out)
        raise
    for name in user_files:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(old_folder / name, out / name)
    shutil.rmtree(old_folder, ignore_errors=True)


def refuse_overlap(out: Path, inputs: Iterable[StrPath] = ()) -> None:
    """Raise ``OptionsClash`` if ``out`` is or holds an input, or lies in a subject: a folder with surfaces in surf/."""
    out_path = Path(os.path.realpath(out))  # resolve() raises at a link to itself
    for input_path in inputs:
        real_input = Path(os.path.realpath(input_path))
        if real_input.exists() and (out_path == real_input or out_path in real_input.parents):
            raise OptionsClash(
                f"{out}: is, or holds, the input {input_path}; writing there would replace it. Name another -o."
            )
    for folder in out_path.parents:
        if any((folder / "surf").glob("[lr]h.*")):
            raise OptionsClash(
                f"{out}: lies in {folder}, a subject with surfaces in surf/, which stays as it is. Name another -o."
            )


def refuse_foreign(out: Path, inputs: Iterable[StrPath] = ()) -> None:
    """Raise ``FileExistsError`` if ``out`` is a file, or a folder with content that morphofold did not write; and as
    :func:`refuse_overlap`."""
    refuse_overlap(out, inputs)
    check_above(Path(os.path.realpath(out)))
    if not out.exists():
        return
    if not out.is_dir():
        raise FileExistsError(f"{out}: is a file; name a folder to write.")
    if (out / COLLECTION_MARKER).is_file():
        raise FileExistsError(f"{out}: is a cohort, a sweep or an inference, which is not replaced. Name a new folder.")
    names = sorted(path.name for path in out.iterdir())
    if names and not (out / MARKER_FILE).is_file():
        raise FileExistsError(
            f"{out}: morphofold did not write this folder, so it is not replaced. It holds "
            f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}. Name a new folder, or "
            "empty this one."
        )


def refuse_no_collection(out: Path, kind: str) -> None:
    """Raise ``FileExistsError`` if ``out`` exists, is not empty and is not from ``begin_collection``."""
    marker_file = out / COLLECTION_MARKER
    if marker_file.is_file():
        other_kind = marker_file.read_text("utf-8", errors="replace").partition(":")[0]
        if other_kind != kind:
            raise FileExistsError(f"{out}: is a {other_kind:.20}, not a {kind}. Name a new folder.")
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
    write_text(out / COLLECTION_MARKER, f"{kind}: morphofold adds results to this folder and replaces none of it.\n")
