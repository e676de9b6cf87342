"""What the XML of a VTK file promises, seen before VTK believes it, which ends the process where memory is short."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

MAX_UNPACKED = 2**29    # bytes of all arrays together
MAX_COUNT = 2**24       # points and cells: VTK takes about 30 bytes for each
_ROWS = {"Points": "Points", "PointData": "Points"}     # the count that an array has a row for; else of its own name
_LINE = 1000            # letters of white space, at most, before an array


@dataclass
class _Tag:
    """A beginning of an element: its name, that of the element around it, its attributes, where its text begins."""

    name: str
    around: str
    said: Mapping[str, str]
    text: int | None = None


def check_blocks(raw: bytes) -> None:
    """Raise ``ValueError`` unless counts, and the sizes to which arrays are said to unpack, are within bounds.

    Unpacked, each number takes at least a byte; zlib packs a thousand into one.
    """
    tags, end = _tags(raw)
    file = next((tag.said for tag in tags if tag.name == "VTKFile"), {})
    packed = "compressor" in file
    room = (1032 if packed else 1) * len(raw)
    counts = [int(n) for tag in tags for key, n in tag.said.items() if _is_count(key)]
    if min(counts, default=0) < 0 or sum(counts) > min(MAX_COUNT, room):
        raise ValueError(f"its header promises {sum(counts)} points and cells, it has {len(raw)} bytes")
    numbers = sum(_numbers(tags))
    if numbers > min(MAX_UNPACKED, room):
        raise ValueError(f"its header promises {numbers} numbers, it has {len(raw)} bytes")
    size = sum(_sizes(raw, tags, end, packed, file))
    most = MAX_UNPACKED if packed else min(MAX_UNPACKED, len(raw))
    if size > most:
        raise ValueError(f"its arrays unpack to {size} bytes, at most {most}")


def _is_count(key: str) -> bool:
    return key.startswith("NumberOf") and key != "NumberOfComponents"


class _Appended(Exception):
    """Behind this tag is no XML."""


def _tags(raw: bytes) -> tuple[list[_Tag], int]:
    """The elements before appended data, and where the tag of these begins (else the end of the file)."""
    tags: list[_Tag] = []
    around: list[str] = []
    parser = expat.ParserCreate()

    def start(name: str, said: dict[str, str]) -> None:
        tags.append(_Tag(name, around[-1] if around else "", said))
        around.append(name)
        if name == "AppendedData":
            raise _Appended(parser.CurrentByteIndex)

    def text(letters: str) -> None:
        if tags[-1].text is None:
            tags[-1].text = parser.CurrentByteIndex

    parser.StartElementHandler, parser.CharacterDataHandler = start, text
    parser.EndElementHandler = lambda name: around.pop()
    try:
        parser.Parse(raw, True)
    except _Appended as at:
        return tags, int(at.args[0])
    return tags, len(raw)


def _numbers(tags: list[_Tag]) -> Iterator[int]:
    """How many numbers each array has at least, as components and counts say."""
    counts: dict[str, int] = {}
    for tag in tags:
        if tag.name == "Piece":
            counts = {key.removeprefix("NumberOf"): int(n) for key, n in tag.said.items() if _is_count(key)}
            counts["CellData"] = sum(n for key, n in counts.items() if key != "Points")
        elif tag.name == "DataArray":
            width = int(tag.said.get("NumberOfComponents", 1))
            if width < 0:
                raise ValueError(f"an array has {width} components")
            rows = tag.said.get("NumberOfTuples", counts.get(_ROWS.get(tag.around, tag.around), 0))
            yield width * max(int(rows), 1)


def _sizes(raw: bytes, tags: list[_Tag], end: int, packed: bool, file: Mapping[str, str]) -> Iterator[int]:
    """Bytes of each binary array as its beginning says: its length, or the number of blocks and their sizes."""
    order = ">" if file.get("byte_order") == "BigEndian" else "<"
    width = 8 if file.get("header_type") == "UInt64" else 4

    def words(at: int, count: int, is_raw: bool) -> list[int]:
        """The first numbers of an array's beginning, which is packed into text by itself."""
        size = count * width
        letters = 4 * -(-size // 3)
        text = b"" if is_raw else b"".join(raw[at : at + _LINE + letters].split())[:letters]
        head = raw[at : at + size] if is_raw else base64.b64decode(text)
        return np.frombuffer(head, f"{order}u{width}", count=count).tolist()

    def size(at: int, is_raw: bool = False) -> int:
        if not packed:
            return words(at, 1, is_raw)[0]
        blocks, each, last = words(at, 3, is_raw)
        if blocks > len(raw) or sum(words(at, 3 + blocks, is_raw)[3:]) > len(raw):
            raise ValueError(f"the {blocks} blocks of an array are larger than the file, which has {len(raw)} bytes")
        return max(blocks * each, last)

    first = raw.find(b"_", raw.find(b">", end)) + 1
    for tag in tags:
        form = tag.said.get("format", "").lower()
        if tag.name == "DataArray" and form == "binary":
            yield size(len(raw) if tag.text is None else tag.text)
        elif tag.name == "DataArray" and form == "appended":
            yield size(first + int(tag.said.get("offset", 0)), tags[-1].said.get("encoding") == "raw")
