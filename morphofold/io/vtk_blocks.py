"""What the XML of a VTK file promises, seen before VTK believes it, which ends the process where memory is short."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator

import numpy as np

MAX_UNPACKED = 2**29    # bytes of all arrays together
MAX_COUNT = 2**24       # points and cells: VTK takes about 30 bytes for each
_COUNTS = re.compile(rb"""\sNumberOf(?!Components)\w+\s*=\s*["']\s*([^"']*)["']""")
_WIDTHS = re.compile(rb"""\sNumberOfComponents\s*=\s*["']\s*([^"']*)["']""")
_INLINE = re.compile(rb"""<DataArray\s[^>]*format\s*=\s*["']binary["'][^>]*>\s*""", re.IGNORECASE)
_OFFSETS = re.compile(rb"""<DataArray\s[^>]*offset\s*=\s*["'](\d+)["']""", re.IGNORECASE)
_APPENDED = re.compile(rb"""<AppendedData\s[^>]*encoding\s*=\s*["'](\w+)["'][^>]*>\s*_""", re.IGNORECASE)


def check_blocks(raw: bytes) -> None:
    """Raise ``ValueError`` unless counts, and the sizes to which arrays are said to unpack, are within bounds.

    Uncompressed, each counted thing takes at least a byte; zlib packs a thousand into one.
    """
    packed = b"compressor" in raw[:1024]
    counts = [int(match[1]) for match in _COUNTS.finditer(raw)]
    widths = [int(match[1]) for match in _WIDTHS.finditer(raw)]
    most = min(MAX_COUNT, (1032 if packed else 1) * len(raw))
    if min(counts, default=0) < 0 or sum(counts) > most:
        raise ValueError(f"its header promises {sum(counts)} points and cells, it has {len(raw)} bytes")
    if widths and not 1 <= min(widths) <= max(widths) <= 9:
        raise ValueError(f"an array has {max(widths)} components; there are 1 to 9")
    size = sum(_sizes(raw, packed))
    if size > MAX_UNPACKED:
        raise ValueError(f"its arrays unpack to {size} bytes, at most {MAX_UNPACKED}")


def _sizes(raw: bytes, packed: bool) -> Iterator[int]:
    """Bytes of each binary array as its beginning says: its length, or the number of blocks and their size."""
    start = raw[:1024]
    order, width = ">" if b"BigEndian" in start else "<", 8 if b"UInt64" in start else 4
    letters = {(4, False): 8, (8, False): 12, (4, True): 16, (8, True): 24}[width, packed]     # of base64, to be whole

    def size(head: bytes) -> int:
        numbers = np.frombuffer(head, f"{order}u{width}", count=2 if packed else 1).tolist()
        return int(np.prod(numbers, dtype=object))

    def in_text(at: int) -> int:
        return size(base64.b64decode(raw[at : at + letters]))

    for match in _INLINE.finditer(raw):
        yield in_text(match.end())
    appended = _APPENDED.search(raw)
    if appended is None:
        return
    for match in _OFFSETS.finditer(raw, 0, appended.start()):
        at = appended.end() + int(match[1])
        yield size(raw[at : at + 16]) if appended[1].lower() == b"raw" else in_text(at)
