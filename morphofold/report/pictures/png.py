"""PNG files without an imaging library, and lettering for them without a display."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """A (height, width, 3) uint8 picture as the bytes of a PNG file."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(f"a picture must be (height, width, 3) uint8, got {image.shape} {image.dtype}.")
    height, width, _ = image.shape
    rows = np.full((height, 1 + 3 * width), 2, dtype=np.uint8)  # filter type 2: "up"
    flat = image.reshape(height, 3 * width)
    rows[0, 1:] = flat[0]
    rows[1:, 1:] = flat[1:] - flat[:-1]  # uint8 wraps, as PNG wants

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def halved(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture half as wide and high, each pixel the mean of four, in steps of four: a fifth of the bytes, no loss to
    be seen at this size."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    total = image[: 2 * height, : 2 * width].astype(np.uint16).reshape(height, 2, width, 2, 3).sum(axis=(1, 3))
    return np.minimum(np.round(total / 16) * 4, 255).astype(np.uint8)


def read_png(path: Path) -> NDArray[np.uint8]:
    """The picture (height, width, 3) of a PNG file."""
    from matplotlib.image import imread

    return np.round(255 * imread(path)[:, :, :3]).astype(np.uint8)


def lettering(text: str, size: int, bold: bool = False) -> NDArray[np.float64]:
    """How much ink lies on each pixel, (height, width) in 0..1, of a line of text; VTK's font, no display.

    The picture is as high for every text of one size, with the baseline on the same row. A text of which VTK's font,
    little more than Latin-1, lacks a character is set in matplotlib's DejaVu; a box stands for what that lacks, too.
    """
    plain = "".join(c if c.isprintable() else " " for c in text) or " "
    if not all(_in_vtk(c) for c in set(plain)):
        return _dejavu(plain, size, bold)
    ink = _vtk(plain, size, bold)
    inked = np.flatnonzero(ink.any(axis=0))
    return ink[:, : inked[-1] + 2] if inked.size else ink[:, :1]


def _vtk(text: str, size: int, bold: bool) -> NDArray[np.float64]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkRenderingCore import vtkTextProperty, vtkTextRenderer
    from vtkmodules.vtkRenderingFreeType import vtkFreeTypeTools  # noqa: F401  (registers the renderer)

    style = vtkTextProperty()
    style.SetFontFamilyToArial()
    style.SetFontSize(size)
    style.SetBold(bold)
    style.SetColor(0, 0, 0)
    picture, used = vtkImageData(), [0, 0]
    # FreeType, said outright: otherwise a "$" in a subject's name is read as TeX.
    if not vtkTextRenderer.GetInstance().RenderString(style, text, picture, used, 72, vtkTextRenderer.FreeType):
        return np.zeros((2 * size, 1))
    columns, lines, _ = picture.GetDimensions()
    return vtk_to_numpy(picture.GetPointData().GetScalars()).reshape(lines, columns, 4)[::-1, :, 3] / 255.0


@cache
def _in_vtk(character: str) -> bool:
    """Whether VTK's font has a character; it leaves out silently what it lacks."""
    return character.isspace() or bool(_vtk(character, 20, False).any())


def _dejavu(text: str, size: int, bold: bool) -> NDArray[np.float64]:
    import matplotlib
    from matplotlib.ft2font import FT2Font

    font = FT2Font(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans{'-Bold' if bold else ''}.ttf")
    font.set_size(0.9 * size, 72)                                       # its letters are larger than Arial's
    font.set_text("".join(c if font.get_char_index(ord(c)) else "\u25a1" for c in text))
    font.draw_glyphs_to_bitmap(antialiased=True)
    ink = np.asarray(font.get_image()) / 255.0
    plain = _vtk("E", size, bold)
    baseline = np.flatnonzero(plain.any(axis=1))[-1] + 1                # rows above it
    ascent = ink.shape[0] - round(font.get_descent() / 64)
    ink = np.pad(ink, ((max(baseline - ascent, 0), len(plain)), (0, 1)))[max(ascent - baseline, 0) :]
    return ink[: len(plain)]
