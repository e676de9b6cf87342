"""The class of a surface file format, and checks that several formats share."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from morphofold.errors import DamagedFile
from morphofold.io.files import looks_like_text
from morphofold.surface import Faces, Surface, Verts

SurfaceContent = tuple[Verts, Faces, Mapping[str, Any] | None]

# counts in a header (PLY; VTK; GLB); each counted element takes at least one byte of the file
_HEADER_COUNTS = re.compile(
    rb'(?:element[ \t]+\w+|\n[ \t]*(?:points|polygons|cells)|"count"[ \t]*:)[ \t]*(\d+)(?:[ \t]+(\d+))?', re.IGNORECASE
)


@dataclass(frozen=True)
class Format:
    """A file format. Its module in ``morphofold.io`` has ``FORMATS`` and is in the list in ``io/surfaces.py``.

    Attributes
    ----------
    name : str
        Its name in messages.
    endings : tuple of str
        Endings of its file names, in lower case. They decide if the first bytes do not identify a format.
    read : callable
        Reads vertices, faces and the volume geometry, or None for the latter; raises ``ValueError`` for a damaged file.
    write : callable, optional
        Writes a surface to a path, completely or not at all.
    begins : pattern, optional
        Matches the start of its files, within their first 1024 bytes.
    """

    name: str
    endings: tuple[str, ...]
    read: Callable[[Path], SurfaceContent]
    write: Callable[[Path, Surface], None] | None = None
    begins: re.Pattern[bytes] | None = None

    def starts(self, head: bytes) -> bool:
        return self.begins is not None and self.begins.match(head) is not None

    def named(self, name: str) -> bool:
        return name.lower().endswith(self.endings)


def from_words(words: Sequence[bytes | str], kind: DTypeLike) -> NDArray[Any]:
    """Numbers in text; an array of strings would take the memory of the longest for each."""
    return np.fromiter(map(float if np.dtype(kind).kind == "f" else int, words), dtype=kind, count=len(words))


@contextmanager
def silent_log() -> Iterator[None]:
    """Keep packages from logging messages that are raised anyway or are not important."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def check_counts(raw: bytes) -> None:
    """Refuse a file whose header declares more elements than it can hold."""
    for match in _HEADER_COUNTS.finditer(raw):
        for count in filter(None, match.groups()):
            if int(count) > len(raw):
                raise DamagedFile(f"its header declares {count.decode()} elements, but it has {len(raw)} bytes")


def warn_of_no_end(path: Path, raw: bytes) -> None:
    """Warn if a text stops within a line: its last number may be cut, 1 of 162. XML and STL mark their end."""
    says = raw.endswith(b">") or b"endsolid" in raw[-1024:]
    if not (says or raw[-1:].isspace()) and looks_like_text(raw[:1024]) and looks_like_text(raw[-64:]):
        warnings.warn(
            f"{path}: its last line has no line break. If the file was cut, its last number is wrong.", stacklevel=5
        )
