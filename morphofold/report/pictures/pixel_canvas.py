"""Pictures as arrays of pixels: drawn surfaces, letters, rulers and colour bars go onto a white ``Sheet``, its pixels
come out; functions make PNG files of them, whole or small for a page.
"""

import base64
import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from morphofold.quantities import Quantity
from morphofold.report.colours import RGB, Limits
from morphofold.report.plots.figure_style import NO_FORMULAS, colour_bar, plot_style, round_step, ticks

Picture = RGB  # (height, width, 3)

DPI = 64  # a power of two: sizes in inches are whole pixels without round-off
PT_PER_PX = 72 / DPI  # [points] of a pixel, for sizes of letters
GREY = "0.24"
SHEET_STYLE = {
    **NO_FORMULAS,
    "figure.dpi": DPI,
    **dict.fromkeys(("xtick.labelsize", "axes.labelsize"), 13 * PT_PER_PX),  # of the colour bar
    **dict.fromkeys(("xtick.color", "axes.labelcolor"), GREY),
}
#: of 1 to 9: half the time of the default 6, and as many bytes to 4 %
PNG_COMPRESSION = 4


@dataclass(frozen=True)
class Sheet:
    """A white picture in the making; positions are pixels from the top left."""

    figure: Figure
    width: int
    height: int

    def picture(self, image: Picture, x: int, y: int) -> None:
        self.figure.figimage(image, x, self.height - y - len(image))

    def box(self, x: float, y: float, width: float, height: float, colour: Any) -> None:
        # without a transform, it is in pixels
        self.figure.add_artist(Rectangle((x, self.height - y - height), width, height, fc=colour, lw=0, transform=None))

    def text(self, x: float, y: float, text: str, font_size: float, max_px: float = math.inf, **style: Any) -> None:
        """Write a line with its baseline at y; "…" stands for the middle of one that is longer than ``max_px``."""
        line = " ".join(text.split())
        artist = self.figure.text(x / self.width, 1 - y / self.height, line, fontsize=font_size * PT_PER_PX, **style)
        n_letters = len(line)
        while n_letters > 2 and max(artist.get_window_extent().size) > max_px:
            n_letters -= 1
            artist.set_text(line[: n_letters - n_letters // 2] + "…" + line[len(line) - n_letters // 2 :])

    def key(self, x: float, y: float, text: str, colour: Any) -> None:
        """Write what a colour means, beside a square of it."""
        self.box(x, y, 16, 16, colour)
        self.text(x + 24, y + 14, text, 13.5, color=GREY)

    def ruler(self, px_per_mm: float, x: int, y: int) -> None:
        """Draw a scale bar of a round length of at most 160 pixels."""
        ruler_mm = round_step(160 / px_per_mm)
        ruler_px = round(ruler_mm * px_per_mm)
        self.box(x, y, ruler_px, 3, (60 / 255,) * 3)
        self.text(x + ruler_px / 2, y + 20, f"{ruler_mm:g} mm", 13, ha="center", color=GREY)

    def colour_bar(self, measure: Quantity, limits: Limits, x: float, y: float, width: float, height: float) -> None:
        """Draw the colours between the limits, numbers and unit below."""
        sheet_w, sheet_h, (low, high) = self.width, self.height, limits
        ax = self.figure.add_axes((x / sheet_w, 1 - (y + height) / sheet_h, width / sheet_w, height / sheet_h))
        colorbar = colour_bar(self.figure, measure.title, limits, measure.signed, cax=ax, orientation="horizontal")
        gap = 0.12 * (high - low)  # distance from the numbers at both ends
        tick_values = (low, *(tick for tick in ticks(low, high, n_ticks=4) if low + gap < tick < high - gap), high)
        colorbar.set_ticks(tick_values, labels=[f"{tick_value:.3g}" for tick_value in tick_values])

    def pixels(self) -> Picture:
        """The finished picture."""
        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        return np.array(canvas.buffer_rgba())[:, :, :3]


@contextmanager
def new_sheet(width: int, height: int) -> Iterator[Sheet]:
    """A sheet of so many pixels; finish it inside."""
    with plot_style(SHEET_STYLE):
        yield Sheet(Figure(figsize=(width / DPI, height / DPI)), width, height)


def png_bytes(image: Picture) -> bytes:
    """A (height, width, 3) uint8 picture as the bytes of a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG", compress_level=PNG_COMPRESSION)
    return buffer.getvalue()


def halved(image: Picture) -> Picture:
    """A picture at half width and height, in steps of four: a fifth of the bytes."""
    height, width = (2 * (side_px // 2) for side_px in image.shape[:2])
    return in_steps_of_four(np.asarray(Image.fromarray(image[:height, :width]).reduce(2)))


def in_steps_of_four(image: Picture) -> Picture:
    """A picture in steps of four, which the eye can't see: two thirds of the bytes."""
    return np.minimum((image.astype(np.uint16) + 2) // 4 * 4, 255).astype(np.uint8)


def in_page(png: bytes) -> str:
    """A picture file as base64, for the source of an image in HTML."""
    return base64.b64encode(png).decode()


def read_png(path: Path) -> Picture:
    """The picture (height, width, 3) of a PNG file."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def safe_name(key: str) -> str:
    """A map's name, which may come from a file, as a file name of letters, digits, ``-`` and ``_``."""
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in key) or "map"
