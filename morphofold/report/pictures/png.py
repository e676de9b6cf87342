"""PNG files, and text for pictures, with Pillow."""

from __future__ import annotations

import io
import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from morphofold.arrays import Array
from morphofold.errors import WrongShape

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

#: of 1 to 9: half the time of the default 6, and as many bytes to 4 %
COMPRESSION = 4


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """A (height, width, 3) uint8 picture as the bytes of a PNG file."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise WrongShape(f"a picture must be (height, width, 3) uint8, got {image.shape} {image.dtype}.")
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=COMPRESSION)
    return file.getvalue()


def halved(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture at half width and height: each pixel is the mean of four, in steps of four.

    It has a fifth of the bytes, without a visible loss at this size.
    """
    height, width = image.shape[0] // 2, image.shape[1] // 2
    even = image[: 2 * height, : 2 * width].astype(np.uint16)
    total = even[::2, ::2] + even[::2, 1::2] + even[1::2, ::2] + even[1::2, 1::2]
    return np.minimum(np.round(total / 16) * 4, 255).astype(np.uint8)


def in_steps_of_four(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture in steps of four, which the eye can't see: two thirds of the bytes."""
    return np.minimum((image.astype(np.uint16) + 2) // 4 * 4, 255).astype(np.uint8)


def read_png(path: Path) -> NDArray[np.uint8]:
    """The picture (height, width, 3) of a PNG file."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def lettering(text: str, size: int, bold: bool = False) -> Array:
    """Ink on each pixel, (height, width) in 0..1, for a line of text in DejaVu Sans; missing characters are boxes.

    All texts of one size have the same height, with the baseline on the same row.
    """
    plain = "".join(c if c.isprintable() else " " for c in text) or " "
    font = _font(size, bold)
    picture = Image.new("L", (math.ceil(font.getlength(plain)) + 1, sum(font.getmetrics())))
    ImageDraw.Draw(picture).text((0, 0), plain, fill=255, font=font)
    return np.asarray(picture) / 255.0


@cache
def _font(size: int, bold: bool) -> FreeTypeFont:
    import matplotlib

    name = f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans{'-Bold' if bold else ''}.ttf"
    return ImageFont.truetype(name, 0.9 * size, layout_engine=ImageFont.Layout.BASIC)
