"""Check the sizes that the XML of a VTK file declares before VTK reads it: VTK ends the process if memory is short."""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.parsers import expat

import numpy as np

from morphofold.errors import DamagedFile

MOST_UNPACKED_BYTES = 2**29  # bytes of all arrays together; each number may take 8
MOST_POINTS_AND_CELLS = 2**24  # points and cells: VTK takes about 30 bytes for each
# element -> the count of its rows; else the count of its own name
_COUNT_OF_ROWS = {"Points": "Points", "PointData": "Points"}
_MOST_WHITE_SPACE = 1000  # at most so many characters of white space before an array


@dataclass
class _Tag:
    """The start of an element: its name, the element around it, its attributes, where it and its text begin."""

    name: str
    around: str
    attributes: Mapping[str, str]
    at: int
    text: int | None = None


def check_blocks(raw: bytes) -> None:
    """Raise ``ValueError`` unless the counts, and the declared unpacked sizes of arrays, are within bounds.

    Each unpacked number takes at least one byte; zlib packs about a thousand bytes into one.
    """
    tags = _parsed_tags(raw)
    file = next((tag.attributes for tag in tags if tag.name == "VTKFile"), {})
    packed = "compressor" in file
    room = (1032 if packed else 1) * len(raw)
    counts = [int(n) for tag in tags for key, n in tag.attributes.items() if _is_count_attribute(key)]
    if min(counts, default=0) < 0 or sum(counts) > min(MOST_POINTS_AND_CELLS, room):
        raise DamagedFile(f"its header declares {sum(counts)} points and cells, but the file has {len(raw)} bytes")
    numbers = sum(_values_per_array(tags))
    if numbers > min(MOST_UNPACKED_BYTES // 8, room):
        raise DamagedFile(f"its header declares {numbers} numbers, but the file has {len(raw)} bytes")
    size = sum(_unpacked_sizes(raw, tags, packed, file))
    most = MOST_UNPACKED_BYTES if packed else min(MOST_UNPACKED_BYTES, len(raw))
    if size > most:
        raise DamagedFile(f"its arrays unpack to {size} bytes; at most {most} are allowed")


def _is_count_attribute(key: str) -> bool:
    return key.startswith("NumberOf") and key != "NumberOfComponents"


class _AppendedDataReached(Exception):
    """No XML follows this tag."""


def _parsed_tags(raw: bytes) -> list[_Tag]:
    """The elements up to the appended data; its element, if any, is the last."""
    tags: list[_Tag] = []
    around: list[str] = []
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        tags.append(_Tag(name, around[-1] if around else "", attributes, parser.CurrentByteIndex))
        around.append(name)
        if name == "AppendedData":
            raise _AppendedDataReached

    def text(letters: str) -> None:
        if tags[-1].text is None:
            tags[-1].text = parser.CurrentByteIndex

    parser.StartElementHandler, parser.CharacterDataHandler = start, text
    parser.EndElementHandler = lambda name: around.pop()
    with contextlib.suppress(_AppendedDataReached):
        parser.Parse(raw, True)
    return tags


def _values_per_array(tags: list[_Tag]) -> Iterator[int]:
    """Least number of values of each array, from its components and counts."""
    counts: dict[str, int] = {}
    for tag in tags:
        if tag.name == "Piece":
            counts = {
                key.removeprefix("NumberOf"): int(n) for key, n in tag.attributes.items() if _is_count_attribute(key)
            }
            counts["CellData"] = sum(n for key, n in counts.items() if key != "Points")
        elif tag.around and "type" in tag.attributes:  # with any name: VTK checks only the type
            width = int(tag.attributes.get("NumberOfComponents", 1))
            if width < 0:
                raise DamagedFile(f"an array has a negative number of components, {width}")
            rows = counts.get(_COUNT_OF_ROWS.get(tag.around, tag.around), 0)
            yield width * max(int(tag.attributes.get("NumberOfTuples", 0)), rows, 1)


def _unpacked_sizes(raw: bytes, tags: list[_Tag], packed: bool, file: Mapping[str, str]) -> Iterator[int]:
    """Bytes of each binary array as its first numbers declare: its length, or the number of blocks and their sizes."""
    order = ">" if file.get("byte_order") == "BigEndian" else "<"
    width = 8 if file.get("header_type") == "UInt64" else 4

    def words(at: int, count: int, is_raw: bool) -> list[int]:
        """The first numbers of an array; they are encoded as text separately."""
        size = count * width
        letters = 4 * -(-size // 3)
        text = b"" if is_raw else b"".join(raw[at : at + _MOST_WHITE_SPACE + letters].split())[:letters]
        head = raw[at : at + size] if is_raw else base64.b64decode(text, validate=True)
        return np.frombuffer(head, f"{order}u{width}", count=count).tolist()

    def size(at: int, is_raw: bool = False) -> int:
        if not packed:
            return words(at, 1, is_raw)[0]
        blocks, each, last = words(at, 3, is_raw)
        if blocks > len(raw) or sum(words(at, 3 + blocks, is_raw)[3:]) > len(raw):
            raise DamagedFile(f"the {blocks} blocks of an array are larger than the file, which has {len(raw)} bytes")
        return max(blocks * each, last)

    for tag in tags:  # VTK uses the offset, meshio the format
        if "offset" in tag.attributes:
            yield size(
                _start_of_appended_array(raw, tags[-1], tag.attributes["offset"]),
                tags[-1].attributes.get("encoding") == "raw",
            )
        if tag.attributes.get("format", "").lower() == "binary":
            yield size(_start_of_inline_array(raw, tag))


def _start_of_appended_array(raw: bytes, data: _Tag, offset: str) -> int:
    """Where an array begins in the appended data, whose tag is the last one."""
    if data.name != "AppendedData":
        raise DamagedFile("an array has an offset, but the file has no appended data")
    if not (offset.isascii() and offset.isdigit()):
        raise DamagedFile(f"an array has the offset {offset[:20]!r}, which is not a whole number")
    end = _end_of_tag(raw, data)
    text = raw[end : end + _MOST_WHITE_SPACE].lstrip()
    if not text.startswith(b"_"):
        raise DamagedFile("its appended data do not begin with _")
    return end + raw[end : end + _MOST_WHITE_SPACE].index(b"_") + 1 + int(offset)


def _start_of_inline_array(raw: bytes, tag: _Tag) -> int:
    """Where the text of an array begins: for XML at the end of the tag, for VTK after the first bracket."""
    end = _end_of_tag(raw, tag)
    if tag.text != end:
        raise DamagedFile("an array has no numbers directly after its tag")
    return end


def _end_of_tag(raw: bytes, tag: _Tag) -> int:
    """Where a tag before data ends; for some readers, a bracket in an attribute would end it too early."""
    for key, value in tag.attributes.items():
        if ">" in value:
            raise DamagedFile(f"its {tag.name} element has the character > in the attribute {key}")
    return raw.index(b">", tag.at) + 1
