"""What all readers and writers of single files share.

Before reading: the file exists, was fetched, and is not too large; while decoding: any damage becomes one error. A file
is written beside its place and then moved there, so it is complete or not there at all. Folders:
``atomic_folders``.
"""

import difflib
import errno
import os
import re
import secrets
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from morphofold.digests_and_json import clean_name
from morphofold.errors import DISK_FULL_ERRORS, DamagedFile, NotFetched, TooLarge, WrongFile
from morphofold.surface import Faces, Verts

MAX_BYTES = 2 * 2**30  # far above any cortex (a 1 mm hemisphere has 6 MB); small enough for a laptop

#: what git-annex or git-lfs puts in place of a file that is not fetched, and the command that fetches it
_FETCH_COMMANDS = {
    re.compile(rb"[./][^\0\n]*annex/objects/[^\0\n]+\n?$"): "datalad get {}",
    re.compile(rb"version https://git-lfs\.github\.com/spec/"): "git lfs pull",
}
_MOST_POINTER_BYTES = 2**15  # git-annex's bound
#: spellings of a side in a file name: lh.white, hemi-L, hemi-left, _left_, 100307.L.white, sub_Lwhite
_SIDE_PATTERNS = {
    side: re.compile(rf"(?<![A-Za-z0-9])(?:{char}(?:white|pial|hemi)?|(?i:{side}|{word}|hemi-{char}))(?![A-Za-z0-9])")
    for side, char, word in (("lh", "L", "left"), ("rh", "R", "right"))
}
_BIDS_ENTITIES = re.compile(r"(?:^|_)(?:sub|ses|acq|run|rec|space|tpl|atlas|desc|label)-[^_.]*")

StrPath = str | os.PathLike[str]
#: vertices, faces, and FreeSurfer's volume geometry if the file has it
SurfaceContent = tuple[Verts, Faces, Mapping[str, Any] | None]


def side_named(name: str) -> str | None:
    """The hemisphere that the name of a file tells in any usual spelling; None if it tells none, or both.

    These are the words ``lh``, ``left``, ``hemi-L`` and ``hemi-left`` in any case, and ``L`` or ``Lwhite``. Words end
    where letters and digits do, or before a capital. Other BIDS entities (``sub-R``) do not count.
    """
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", _BIDS_ENTITIES.sub("", name))
    sides = [side for side, spelling in _SIDE_PATTERNS.items() if spelling.search(name)]
    return sides[0] if len(sides) == 1 else None


def name_in_file(path: Path) -> str:
    """What regions are called in the name of their file: ``aparc`` in ``lh.aparc.annot``, ``lh.aparc.label.gii``, HCP's
    ``ID.L.aparc.native.label.gii`` and in BIDS ``sub-1_hemi-L_seg-aparc_dseg.label.gii``."""
    name = re.sub(r"\.(annot|label\.gii|dlabel\.nii)$", "", clean_name(path.name))
    entities, mesh = r"((tpl|sub|ses|hemi|space|den)-[^_]+_)+(seg-)?", r"\.(native|\d+k_fs_LR)$"
    return re.sub(rf"^[lr]h\.|^{entities}|_dseg$|^\w+\.([LR]\.)?(?=.*{mesh})|{mesh}", "", name)


def existing_file(path: StrPath, kind: str = "file") -> Path:
    """Path of a readable file of 1 byte to ``MAX_BYTES``; errors name the kind of file that is needed.

    Raises
    ------
    FileNotFoundError
        It does not exist; similar names in the same folder are listed.
    NotFetched
        DataLad, git-annex or git-lfs has left only a pointer to it.
    IsADirectoryError, ValueError
        It is a folder, empty, or too large.
    """
    path = _behind_lost_link(Path(path))
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, but a {kind} is needed. Name the file in it.")
    check_fetched(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such {kind}. {_folder_content_text(path)}")
    n_bytes = path.stat().st_size
    if n_bytes == 0:
        raise DamagedFile(f"{path}: is empty (0 bytes); a {kind} is needed. Copy it again from its source.")
    if n_bytes > MAX_BYTES:
        raise TooLarge(f"{path}: has {n_bytes / 2**30:.1f} GiB; a {kind} may have at most {MAX_BYTES / 2**30:g} GiB.")
    return path


def check_fetched(path: Path) -> None:
    """Raise ``NotFetched`` if DataLad, git-annex or git-lfs has left only a pointer in place of a file."""
    content = _content_if_small(path)
    for pointer_pattern, command in _FETCH_COMMANDS.items():
        if pointer_pattern.match(content):
            raise NotFetched(f"{path}: was not fetched, only a pointer to it is here. Run `{command.format(path)}`.")


def _content_if_small(path: Path) -> bytes:
    """Where a link to nothing leads, or the bytes of a small file; else nothing."""
    if path.is_symlink() and not path.exists():
        return os.fsencode(Path(os.path.realpath(path)).as_posix())
    return path.read_bytes() if path.is_file() and path.stat().st_size <= _MOST_POINTER_BYTES else b""


def _behind_lost_link(path: Path) -> Path:
    """The file of FreeSurfer's link ``?h.pial``, with a warning, if a copy lost the link; any other path as it is.

    FreeSurfer 7 and 8 write ``?h.pial.T1``, or ``.T2`` or ``.FLAIR`` if these refine it, and make the link. A copy may
    have nothing, an empty file, a small file with the name, or a link to nothing.
    """
    if path.name not in ("lh.pial", "rh.pial") or (path.is_file() and path.stat().st_size > _MOST_POINTER_BYTES):
        return path
    link_content = _content_if_small(path).replace(b"\0", b"")  # Cygwin writes the name in UTF-16
    candidates = [path.with_name(f"{path.name}.{ending}") for ending in ("T2", "FLAIR", "T1")]
    candidates.sort(key=lambda file: file.name.encode() not in link_content)
    real_file = next((file for file in candidates if file.is_file()), None)
    if real_file is None or (link_content and candidates[0].name.encode() not in link_content):
        return path
    warnings.warn(f"{path}: FreeSurfer's link is lost here, so {real_file.name} beside it is read.", stacklevel=3)
    return real_file


def _folder_content_text(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        while not folder.parent.is_dir():
            folder = folder.parent
        return f"There is no {folder.name} in {folder.parent.absolute()}."
    entries = sorted(entry.name for entry in folder.iterdir() if entry.name[0] != ".")
    prefix = path.name[:3] if path.name[:3] in ("lh.", "rh.") else ""  # the other hemisphere is not a misspelling
    close_names = difflib.get_close_matches(path.name, [n for n in entries if n.startswith(prefix)], n=4, cutoff=0.7)
    if close_names:
        return f"Similar names in {folder.absolute()}: {', '.join(close_names)}."
    more_text = f" and {len(entries) - 6} more" if len(entries) > 6 else ""
    return f"{folder.absolute()} contains {', '.join(entries[:6]) or 'no files'}{more_text}."


@contextmanager
def decoding(path: Path, kind: str, advice: str = "Copy it again from its source, or make it again.") -> Iterator[None]:
    """Turn any error that a file library raises on a damaged file into one clear ``DamagedFile``; keep ``WrongFile``
    and ``NotFetched``, and ``MemoryError``: the file may be good."""
    try:
        with warnings.catch_warnings(action="ignore"):  # notes on optional parts of the format
            yield
    except NotFetched:  # of a file that this one names
        raise
    except MemoryError as error:
        raise MemoryError(f"{path}: not enough memory to read {kind}. A small file is damaged.") from error
    except (Exception, SystemExit) as error:  # meshio raises SystemExit
        problem = " ".join(str(error).split())[:160]
        if isinstance(error, WrongFile):
            raise WrongFile(f"{path}: {problem}.") from error
        problem = problem or type(error).__name__
        raise DamagedFile(f"{path}: is truncated, damaged, or not {kind} ({problem}). {advice}") from error


def looks_like_text(head: bytes) -> bool:
    """Whether the first bytes of a file are printable text."""
    n_printable = sum(32 <= byte < 127 or byte in b"\t\r\n" for byte in head)
    return bool(head) and b"\0" not in head and n_printable > 0.9 * len(head)


def beginning(raw: bytes) -> str:
    """The first of the bytes of a file in a form that an error can show: escaped, short, one line."""
    head = raw[:1024]
    if looks_like_text(head):
        return f"text, beginning {' '.join(head[:60].decode('ascii', 'replace').split())!r}"
    return f"bytes, beginning {head[:8].hex(' ')}"


def warn_of_no_end(path: Path, raw: bytes) -> None:
    """Warn if a text stops within a line: its last number may be cut, 1 of 162. XML and STL mark their end."""
    if looks_like_text(raw[:1024]) and looks_like_text(raw[-64:]) and not re.search(rb"[\s>]\Z|endsolid", raw[-1024:]):
        warnings.warn(
            f"{path}: its last line has no line break. If the file was cut, its last number is wrong.", stacklevel=4
        )


def check_place(path: Path) -> None:
    """Refuse a name that no file can be written to."""
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder; name a file to write.")
    if not path.parent.is_dir():
        raise FileNotFoundError(
            f"{path.parent}: no such folder, so {path.name} can't be written there. Make the folder first."
        )


def check_above(path: Path) -> None:
    """Refuse a path where nothing can be made: its nearest existing parent is not a folder, or not writable."""
    parent = next(ancestor for ancestor in Path(os.path.abspath(path)).parents if os.path.lexists(ancestor))
    if not parent.is_dir():
        raise NotADirectoryError(f"{parent}: is not a folder, so {path.name} can't be made in it. Name another place.")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))


@contextmanager
def atomic_file(path: StrPath) -> Iterator[Path]:
    """Write a file completely or not at all: yields a temporary name beside ``path``, moved onto it on success.

    The temporary name keeps the ending, because some writers depend on it. A link at ``path`` is replaced, and its
    target stays unchanged: it may be in a store of contents, as git-annex has.
    """
    path = Path(path)
    check_place(path)
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name[-60:]}")  # within 255 bytes
    try:
        with error_names_file(path, temporary):
            yield temporary
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, completely or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, "utf-8", newline="\n")


@contextmanager
def error_names_file(path: Path, temporary: Path) -> Iterator[None]:
    """Make system errors about the temporary path, or about a full disk, name ``path`` or a file in it."""
    try:
        yield
    except OSError as error:
        error_path = str(error.filename or (temporary if error.errno in DISK_FULL_ERRORS else ""))
        if str(temporary) not in error_path:
            raise
        raise OSError(error.errno, error.strerror, error_path.replace(str(temporary), str(path))) from error


def write_and_read(
    path: Path, read: Callable[[bytes, Path], object], write: Callable[..., object], *content: Any, **options: Any
) -> None:
    """Let ``write(name, *content, **options)`` of a library write a file, and read it back; completely or not at all.

    It is read because numpy's ``tofile``, which libraries use, cuts files on a full disk, without an error or a number.

    Raises
    ------
    OSError
        The system's error for ``path``, or that of a full disk if the file can't be read back.
    """
    with atomic_file(path) as temporary:
        try:
            write(os.fspath(temporary), *content, **options)
        except OSError as error:
            if error.errno:  # numpy gives none: then the file is cut, and can't be read
                raise
        try:
            read(temporary.read_bytes(), temporary)
        except Exception as error:
            problem = f"{os.strerror(errno.ENOSPC)}, as what was written can't be read ({error})"
            raise OSError(errno.ENOSPC, problem, os.fspath(path)) from error
