"""The subjects of a cohort: found in a folder, or listed in a file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from morphofold.errors import NamedTwice, NothingToDo, NotReadable, WrongFile

SUBJECT_FOLDERS = ("surf", "mri", "scripts", "stats", "label")  # folders; a FreeSurfer subject has at least one
TEMPLATE_SUBJECTS = (
    "fsaverage",
    "lh.EC_average",
    "rh.EC_average",
    "cvs_avg35",
)  # folders that FreeSurfer puts beside subjects


def find_subjects(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the subjects in a folder, and names of the templates that were left out, both sorted.

    A subject is a folder with one of the folders that FreeSurfer makes, or with surfaces of its own (``lh.white``,
    ``lh.white.surf.gii``). A folder without surfaces is a subject too, and fails later.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        If there is no such folder.
    NothingToDo
        If it has no subject.
    """
    if not folder.exists():
        raise FileNotFoundError(f"{folder}: no such folder. Give the folder that contains the subjects.")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file. Give the folder that contains the subjects.")
    there = sorted(p.name for p in folder.iterdir() if not p.name.startswith(".") and _is_subject(p))
    templates = [name for name in there if name.startswith(TEMPLATE_SUBJECTS)]
    found = [name for name in there if name not in templates]
    if not found:
        more = f" except the templates {', '.join(templates)}, which --subjects can list" if templates else ""
        raise NothingToDo(f"{folder}: contains no subject{more}. A subject has surf/lh.white and surf/lh.pial.")
    return found, templates


def _is_subject(path: Path) -> bool:
    try:
        if not path.is_dir():
            return False
        return any((path / part).is_dir() for part in SUBJECT_FOLDERS) or any(path.glob("?h.white*"))
    except PermissionError:  # it fails alone and does not stop others
        return True


def named_subjects(file: Path) -> list[str]:
    """Names from a text file, one per line; empty lines and text after ``#`` are ignored.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not UTF-8 text, has no name, a name twice, or a path.
    """
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file. Give a text file with one subject per line.")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise WrongFile(f"{file}: is not UTF-8 text. Give a text file with one subject per line.") from None
    names = [name for line in lines if (name := line.partition("#")[0].strip().rstrip("/"))]
    if not names:
        raise NothingToDo(f"{file}: lists no subject. Write one name per line.")
    refuse_paths(names, str(file))
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise NamedTwice(f"{file}: lists {', '.join(twice[:4])}{' ...' * (len(twice) > 4)} twice. List each name once.")
    return names


def refuse_paths(names: Sequence[str], where: str) -> None:
    """Raise ``NotReadable`` if a name is not a folder name."""
    for name in names:
        if name in (".", "..") or Path(name).name != name:
            raise NotReadable(f"{where}: {name!r} is not a folder name. Give names of subjects, not paths.")
