"""What a file format of surfaces is, and the checks that several have in common."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphofold.errors import DamagedFile
from morphofold.io.files import looks_like_text
from morphofold.surface import Faces, Surface, Verts

Read = tuple[Verts, Faces, Mapping[str, Any] | None]

# counts that a header may promise (PLY; VTK; GLB); each counted thing takes at least a byte of the file
_COUNTS = re.compile(
    rb'(?:element[ \t]+\w+|\n[ \t]*(?:points|polygons|cells)|"count"[ \t]*:)[ \t]*(\d+)(?:[ \t]+(\d+))?', re.IGNORECASE
)


@dataclass(frozen=True)
class Format:
    """A file format. A module of ``morphofold.io`` has ``FORMATS``, and stands in the list in ``io/surfaces.py``.

    Attributes
    ----------
    name : str
        As messages call it.
    endings : tuple of str
        Of the names of its files, in lower case. They decide where the first bytes are silent.
    read : callable
        Vertices, faces and the volume geometry of a file, or None; raises ``ValueError`` for one that is damaged.
    write : callable
        Writes a surface to a path, whole or not at all.
    begins : pattern, optional
        What its files begin with, in their first 1024 bytes.
    """

    name: str
    endings: tuple[str, ...]
    read: Callable[[Path], Read]
    write: Callable[[Path, Surface], None]
    begins: re.Pattern[bytes] | None = None

    def starts(self, head: bytes) -> bool:
        return self.begins is not None and self.begins.match(head) is not None

    def named(self, name: str) -> bool:
        return name.lower().endswith(self.endings)


@contextmanager
def silent_log() -> Iterator[None]:
    """Keep packages from logging what is raised anyway, or doesn't matter."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def check_counts(raw: bytes) -> None:
    """Refuse a file that promises more than it can hold."""
    for match in _COUNTS.finditer(raw):
        for count in filter(None, match.groups()):
            if int(count) > len(raw):
                raise DamagedFile(f"its header promises {count.decode()} elements, it has {len(raw)} bytes")


def warn_of_no_end(path: Path, raw: bytes) -> None:
    """Where a text stops within a line, its last number may be a part of one: 1 of 162. XML and STL say their end."""
    says = raw.endswith(b">") or b"endsolid" in raw[-1024:]
    if not (says or raw[-1:].isspace()) and looks_like_text(raw[:1024]) and looks_like_text(raw[-64:]):
        warnings.warn(f"{path}: its last line has no end; was it cut? Then its last number is wrong.", stacklevel=5)
