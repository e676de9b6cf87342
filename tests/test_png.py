"""PNG files and lettering."""

import struct
import zlib

import numpy as np
import pytest

from morphofold.report.pictures.png import lettering, png_bytes


def decode_png(data):
    """A reader of the PNG subset we write, from the specification: 8-bit RGB, filters 0 and 2."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, body = 8, b""
    while at < len(data):
        n, kind = struct.unpack(">I4s", data[at : at + 8])
        content = data[at + 8 : at + 8 + n]
        assert struct.unpack(">I", data[at + 8 + n : at + 12 + n])[0] == zlib.crc32(kind + content)
        if kind == b"IHDR":
            width, height = struct.unpack(">II", content[:8])
        body += content if kind == b"IDAT" else b""
        at += 12 + n
    rows = np.frombuffer(zlib.decompress(body), np.uint8).reshape(height, 1 + 3 * width)
    image = rows[:, 1:].copy()
    for y in range(1, height):
        if rows[y, 0] == 2:
            image[y] += image[y - 1]
    return image.reshape(height, width, 3)


def test_a_png_holds_the_picture_exactly(rng):
    picture = rng.integers(0, 256, (7, 11, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decode_png(png_bytes(picture)), picture)
    with pytest.raises(ValueError, match="float64"):
        png_bytes(np.zeros((2, 2, 3)))


def test_lettering_shares_a_baseline_and_reads_no_tex():
    low, tall = lettering("axe", 20), lettering("AXE", 20)
    foot = lambda ink: ink.shape[0] - np.flatnonzero(ink.any(axis=1))[-1]
    assert abs(foot(low) - foot(tall)) <= 1
    assert lettering("$x$", 20).shape[1] > lettering("x", 20).shape[1] + 8


def test_no_character_of_a_name_vanishes():
    """VTK's font lacks all of these, and DejaVu the last two, for which a box stands."""
    for text in ("Ж", "α", "₁", "脑", "日本"):
        assert lettering(text, 20).sum() > 10 * len(text)
    assert lettering("日本", 20).shape[1] > 1.8 * lettering("日", 20).shape[1] > 10
    assert lettering("S1 脑", 20).shape[1] > lettering("S1 ", 20).shape[1] + 10
    for bold in (False, True):
        latin, mixed = lettering("EgÅ", 20, bold), lettering("EgÅ脑", 20, bold)
        assert latin.shape[0] == mixed.shape[0]
        feet = [np.flatnonzero(ink[:, :14].any(axis=1))[-1] for ink in (latin, mixed)]
        assert abs(feet[0] - feet[1]) <= 1                              # the baseline, under the E
