"""Layouts of folders with cortices: which subjects a folder holds, and the files of a hemisphere by what they hold.

Each program that reconstructs cortices names its files in its own way, and has a file here with its ``LAYOUTS``, one
for each mesh or version. ``subjects_in`` and ``subject_at`` try them all; nothing else knows how a folder is laid out.
"""

import glob
import os
import pkgutil
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path

from morphofold.errors import NamedTwice

HEMIS = ("lh", "rh")
MAP_NAMES = ("thickness", "curv", "sulc", "area")
FREESURFER = "FreeSurfer"
#: space of a registered sphere -> what a layout calls it
CONTENT_OF_SPACE = {"fsLR": "registered fsLR", "fsaverage": "registered"}
MOST_NAMES_SHOWN = 8
Files = dict[str, Path]  # by what they hold: a field of a Cortex, or one of its maps


@dataclass(frozen=True)
class Layout:
    """How a program names folders of subjects and the files in them.

    Patterns are paths with fields in braces, each of which is a part of a name. Of the patterns for a file, the first
    that exists counts. ``{side}`` is the hemisphere, ``{kind}`` what the file holds, ``{annotation}`` the parcellation,
    ``{subject}`` a subject whose files lie among those of others, and ``{person}`` the one of a session. Any other
    field is what it is in the name of the white or pial surface: all files of a subject have the same.

    Attributes
    ----------
    program : str
    folders : sequence of patterns
        The folder of a subject, or of a session, in that of all subjects. Its parts are the subject's name.
    surfaces, maps : sequences of patterns
        Files of surfaces and of maps (``MAP_NAMES``) in the subject's folder.
    others : mapping
        Patterns by content: ``regions``, ``cortex`` (a mask), ``registered`` and ``registered fsLR`` (the sphere that
        is registered to fsaverage, to fs_LR), ``stats`` (aseg.stats), ``summary`` (of an analysis).
    sides : mapping
        What the hemispheres are called.
    kinds : mapping
        What contents are called where not as ``{kind}`` here: white, pial, inflated, sphere and the maps.
    annotations : sequence of str
        Parcellations to read if none is named, the first that exists.
    needs : sequence of patterns
        Files without which it is another layout.
    in_template_space : bool
        Whether its surfaces are scaled to a template, and not as large as the person's.
    marks : sequence of str
        Folders by which a folder is that of a subject even if its surfaces are missing.
    """

    program: str
    folders: Sequence[str]
    surfaces: Sequence[str]
    maps: Sequence[str] = ()
    others: Mapping[str, Sequence[str]] = field(default_factory=dict)
    sides: Mapping[str, str] = field(default_factory=lambda: dict(zip(HEMIS, HEMIS)))
    kinds: Mapping[str, str] = field(default_factory=dict)
    annotations: Sequence[str] = ("aparc",)
    needs: Sequence[str] = ()
    in_template_space: bool = False
    marks: Sequence[str] = ()

    def subjects(self, root: Path, subject: str | None = None) -> Iterator["Subject"]:
        """The subjects whose files are in a folder; of files that name a subject, only those of one."""
        field_values: dict[tuple[tuple[str, str], ...], None] = {}
        for kind in ("white", "pial"):
            for side in self.sides.values():
                own = {"side": side, "kind": self.kinds.get(kind, kind)}
                known = own if subject is None else {**own, "subject": subject}
                for pattern in self.surfaces:
                    for _, fields in _matches(root, pattern, known):
                        field_values[tuple((key, value) for key, value in fields.items() if key not in own)] = None
        subjects = (Subject(self, root, dict(values)) for values in field_values)
        return (found for found in subjects if all(found.first_path([pattern]) for pattern in self.needs))

    def roots(self, path: Path) -> Iterator[Path]:
        """The folder of the subject that a path is in, or is: anat/, surf/ or T1w/Native/ stands for its subject."""
        for parts in dict.fromkeys(Path(pattern).parent.parts for pattern in self.surfaces):
            if parts and path.absolute().parts[-len(parts) :] == parts:
                yield path.absolute().parents[len(parts) - 1]
        yield path


@dataclass(frozen=True)
class Subject:
    """A subject, or one session of it, on disk; ``fields`` are those of the patterns of its files."""

    layout: Layout
    folder: Path
    fields: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """``bert``, or ``sub-01_ses-2``."""
        if name := self.fields.get("subject"):
            return name
        parts = Path(os.path.abspath(self.folder)).parts
        for pattern in self.layout.folders:
            n_parts = len(Path(pattern).parts)
            if re.fullmatch(_regex(pattern, {}), "/".join(parts[-n_parts:])):
                return "_".join(parts[-n_parts:])
        return parts[-1]

    @property
    def place(self) -> Path:
        """What ``subject_at`` finds it by: its folder, or its name in a folder of files of several subjects."""
        return self.folder / self.name if "" in self.layout.folders else self.folder

    @property
    def hemis(self) -> tuple[str, ...]:
        """The hemispheres of which it has white or pial."""
        return tuple(hemi for hemi in HEMIS if any(self.surface(hemi, kind) for kind in ("white", "pial")))

    def surface(self, hemi: str, kind: str) -> Path | None:
        """A surface of a hemisphere, if there is one."""
        return self.first_path(self.layout.surfaces, hemi, kind=self.layout.kinds.get(kind, kind))

    def map(self, hemi: str, name: str) -> Path | None:
        """A map of ``MAP_NAMES``, if there is one."""
        return self.first_path(self.layout.maps, hemi, kind=self.layout.kinds.get(name, name))

    def other(self, hemi: str, content: str, **fields: str) -> Path | None:
        """A file of ``Layout.others``, if there is one."""
        return self.first_path(self.layout.others.get(content, ()), hemi, **fields)

    def regions(self, hemi: str, annotation: str | None) -> Path | None:
        """The parcellation ``annotation`` or ``aparc.ANNOTATION``; None: the first of the layout."""
        names = self.layout.annotations
        if annotation is not None:
            names = annotation, f"aparc.{annotation}", re.sub(r"\W|_", "", annotation)  # the last in BIDS
        return next(filter(None, (self.other(hemi, "regions", annotation=name) for name in names)), None)

    def annotations(self, hemi: str) -> list[str]:
        """Names of all parcellation files of a hemisphere."""
        patterns = self.layout.others.get("regions", ())
        known = {**self.fields, "side": self.layout.sides[hemi], "hemi": hemi}
        return sorted({path.name for pattern in patterns for path, _ in _matches(self.folder, pattern, known)})

    def expected(self, hemi: str, kind: str) -> Path:
        """Where a surface that is missing would be."""
        known = {**self.fields, "side": self.layout.sides[hemi], "kind": self.layout.kinds.get(kind, kind)}
        paths = [self.folder / _filled(pattern, known) for pattern in self.layout.surfaces]
        return next((path for path in paths if path.parent.is_dir()), paths[0])

    def first_path(self, patterns: Sequence[str], hemi: str = "lh", **fields: str) -> Path | None:
        """The first path of some patterns that exists; a link to nothing does, for the reader to say so."""
        known = {"side": self.layout.sides[hemi], "hemi": hemi, "person": self.name.split("_ses-")[0], **fields}
        paths = (path for pattern in patterns for path, _ in _matches(self.folder, pattern, {**self.fields, **known}))
        return next(paths, None)


@cache
def programs() -> dict[str, tuple[Layout, ...]]:
    """The layouts of each program, FreeSurfer's first."""
    modules = [module.name for module in pkgutil.iter_modules(__path__)]
    names = sorted(modules, key=lambda name: (name != "freesurfer_folders", name))
    return {name: import_module(f"{__name__}.{name}").LAYOUTS for name in names}


def subjects_in(folder: Path) -> dict[str, Subject]:
    """The subjects and sessions in a folder of subjects, by name; raises ``NamedTwice`` if two programs have one."""
    found: dict[str, Subject] = {}
    marked: list[Subject] = []
    for layouts in programs().values():
        patterns = dict.fromkeys(pattern for layout in layouts for pattern in layout.folders)
        for root in dict.fromkeys(root for pattern in patterns for root, _ in _matches(folder, pattern, {})):
            for subject in _first(layouts, root):
                _check_program([found.get(subject.name, subject), subject], folder)
                found.setdefault(subject.name, subject)
            marked += [Subject(layout, root) for layout in layouts if _is_marked(layout, root)]
    lacking = {subject.name: subject for subject in marked if subject.name not in found}
    return found | {name: subject for name, subject in lacking.items() if not _subjects_of(subject.folder)}


def subject_at(path: Path) -> Subject | None:
    """The subject whose folder a path is, or a folder of its surfaces; or DIR/NAME of a subject that files in DIR name,
    or of a session ``sub-01_ses-2``.

    Raises
    ------
    NamedTwice
        If two programs, several subjects or several sessions have files there, or it is a folder of subjects.
    """
    session_folder = path.parent / path.name.replace("_ses-", "/ses-", 1)
    if path.is_dir() or session_folder.is_dir():
        found = _subjects_of(path if path.is_dir() else session_folder)
    else:
        in_parent = [] if path.exists() else _subjects_of(path.parent, path.name)
        found = [subject for subject in in_parent if subject.name == path.name]
    _check_program(found, path)
    several = found if found or not path.is_dir() else list(subjects_in(path).values())
    if len(several) > 1 or (several and not found):
        names = ", ".join(str(subject.place) for subject in several[:MOST_NAMES_SHOWN])
        raise NamedTwice(
            f"{path}: holds {len(several)} subjects or sessions. Name one of them, as {names}; `morphofold cohort` "
            "measures all subjects of a folder."
        )
    return found[0] if found else None


def _subjects_of(path: Path, subject: str | None = None) -> list[Subject]:
    """The subjects whose folder a path is, or is in, or whose sessions it holds; or only ``subject`` of them."""
    found: list[Subject] = []
    for layouts in programs().values():
        here = (list(layout.subjects(root, subject)) for layout in layouts for root in layout.roots(path))
        sessions = dict.fromkeys(p.split("/", 1)[1] for layout in layouts for p in layout.folders if "/" in p)
        session_roots = (root for pattern in sessions for root, _ in _matches(path, pattern, {}))
        found += next(filter(None, here), []) or [s for root in session_roots for s in _first(layouts, root)]
    return found


def _first(layouts: Sequence[Layout], root: Path) -> list[Subject]:
    """The subjects in a folder by the first layout that has any."""
    return next(filter(None, (list(layout.subjects(root)) for layout in layouts)), [])


def _check_program(subjects: Sequence[Subject], path: Path) -> None:
    named = {subject.layout.program: subject for subject in subjects}
    if len(named) > 1:
        texts = [f"{program} in {subject.folder}" for program, subject in named.items()]
        raise NamedTwice(f"{path}: holds cortices of {' and of '.join(texts)}. Name a folder of one of them.")


def _is_marked(layout: Layout, root: Path) -> bool:
    try:
        return root.is_dir() and any((root / name).is_dir() for name in layout.marks)
    except PermissionError:  # it fails alone and does not stop others
        return True


def _matches(root: Path, pattern: str, known: Mapping[str, str]) -> Iterator[tuple[Path, dict[str, str]]]:
    """The paths below a folder that a pattern fits, with all its fields; a link to nothing is one."""
    filled = _filled(pattern, known)
    if "{" not in filled:
        if os.path.lexists(root / filled):
            yield root / filled, dict(known)
        return
    for path in sorted(root.glob(re.sub(r"\{\w+\}", "*", glob.escape(filled)))):
        match = re.fullmatch(_regex(pattern, known), path.relative_to(root).as_posix())
        if match and path.name[0] != ".":  # as the copies that macOS leaves
            yield path, {**known, **match.groupdict()}


def _filled(pattern: str, known: Mapping[str, str]) -> str:
    return re.sub(r"\{(\w+)\}", lambda match: known.get(match[1], match[0]), pattern)


def _regex(pattern: str, known: Mapping[str, str]) -> str:
    """A regular expression for the paths that a pattern fits: a field that comes again has the same value."""
    texts_and_names, seen, regex = re.split(r"\{(\w+)\}", pattern), set[str](), ""
    for k, part in enumerate(texts_and_names):
        if k % 2 == 0 or part in known:
            regex += re.escape(part if k % 2 == 0 else known[part])
        else:
            regex += f"(?P={part})" if part in seen else f"(?P<{part}>[^/]+)"
            seen.add(part)
    return regex
