"""The subjects of a cohort: found in a folder, or named by a file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from morphofold.errors import NamedTwice, NothingToDo, NotReadable, WrongFile

PARTS = ("surf", "mri", "scripts", "stats", "label")  # folders of which a FreeSurfer subject has at least one
TEMPLATES = ("fsaverage", "lh.EC_average", "rh.EC_average", "cvs_avg35")  # that FreeSurfer puts beside subjects


def find_subjects(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the subjects in a folder, and of the templates there that were left out, both in order.

    A subject is a folder with one of those that FreeSurfer makes, or with surfaces of its own (``lh.white``,
    ``lh.white.surf.gii``); one whose surfaces are missing is a subject, too, and fails as such.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        If there is no such folder.
    NothingToDo
        If it has no subject.
    """
    if not folder.exists():
        raise FileNotFoundError(f"{folder}: no such folder. Name the folder that holds subjects.")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file. Name the folder that holds subjects.")
    there = sorted(p.name for p in folder.iterdir() if not p.name.startswith(".") and _is_subject(p))
    templates = [name for name in there if name.startswith(TEMPLATES)]
    found = [name for name in there if name not in templates]
    if not found:
        more = f" but the templates {', '.join(templates)}, which --subjects can name" if templates else ""
        raise NothingToDo(f"{folder}: holds no subject{more}. A subject has surf/lh.white and surf/lh.pial.")
    return found, templates


def _is_subject(path: Path) -> bool:
    try:
        if not path.is_dir():
            return False
        return any((path / part).is_dir() for part in PARTS) or any(path.glob("?h.white*"))
    except PermissionError:  # it fails by itself, and stops no other
        return True


def named_subjects(file: Path) -> list[str]:
    """Names from a text file, one in a line; empty lines and what follows ``#`` are left out.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no text, names nobody, somebody twice, or a path.
    """
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file. Name a text file with one subject in a line.")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise WrongFile(f"{file}: is no text in UTF-8. Name a text file with one subject in a line.") from None
    names = [name for line in lines if (name := line.partition("#")[0].strip().rstrip("/"))]
    if not names:
        raise NothingToDo(f"{file}: names no subject. Write one name in a line.")
    refuse_paths(names, str(file))
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise NamedTwice(f"{file}: names {', '.join(twice[:4])}{' ...' * (len(twice) > 4)} twice. Name each once.")
    return names


def refuse_paths(names: Sequence[str], where: str) -> None:
    """Raise ``NotReadable`` if a name is none of a folder."""
    for name in names:
        if name in (".", "..") or Path(name).name != name:
            raise NotReadable(f"{where}: {name!r} is no name of a folder. Name subjects, not paths.")
