"""Values to colours, for pictures and diagrams: one sequential and one diverging table, safe for colour-blind readers
and for print.

The tables are computed in OKLab (Ottosson 2020), where equal steps look equal. The sequential table rises in
lightness from deep blue to pale yellow. The diverging table falls from a light middle to blue and to orange, with
the same lightness on both sides.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import ImageColor

RGB = NDArray[np.uint8]
Limits = tuple[float, float]  # of values

NOT_MEASURED_COLOUR = (196, 196, 192)  # vertices without a value
BARE_SURFACE_COLOUR = (214, 207, 198)  # the surface without an overlay
#: cube roots of the responses of the cones, from OKLab, and linear sRGB from the responses
CONES_OF_OKLAB = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
SRGB_OF_CONES = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def rgb_of(colour: str) -> RGB:
    """Bytes (3,) of a colour as "#rrggbb"."""
    return np.array(ImageColor.getrgb(colour), dtype=np.uint8)


def in_bytes(values: np.ndarray) -> RGB:
    """Colours from 0 to 255, rounded."""
    return np.round(values).astype(np.uint8)


def _colour_table(lightness: np.ndarray, chroma: np.ndarray, hue_deg: np.ndarray) -> RGB:
    """Bytes (256, 3); chroma is lowered, in steps of 2 %, where the screen cannot show the colour."""
    hue = np.deg2rad(hue_deg)
    for _ in range(200):
        oklab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
        linear_rgb = (oklab @ CONES_OF_OKLAB.T) ** 3 @ SRGB_OF_CONES.T
        rgb = np.where(linear_rgb <= 0.0031308, 12.92 * linear_rgb, 1.055 * np.abs(linear_rgb) ** (1 / 2.4) - 0.055)
        out_of_gamut = ((rgb < -1e-4) | (rgb > 1 + 1e-4)).any(axis=1)
        chroma = np.where(out_of_gamut, 0.98 * chroma, chroma)
    return in_bytes(np.clip(255 * rgb, 0, 255))


@cache
def sequential() -> RGB:
    """(256, 3) uint8, dark blue to pale yellow; for magnitudes."""
    position = np.linspace(0, 1, 256)
    return _colour_table(0.30 + 0.63 * position, 0.125 + 0.03 * np.sin(np.pi * position), 285 - 180 * position)


@cache
def diverging() -> RGB:
    """(256, 3) uint8, blue (negative) through near-white to orange-red (positive); for signed quantities."""
    position = np.linspace(-1, 1, 256)
    distance = np.abs(position)
    return _colour_table(0.96 - 0.50 * distance**1.1, 0.19 * distance**0.8, np.where(position < 0, 255.0, 42.0))


def table(signed: bool) -> RGB:
    """The colours of signed quantities or of magnitudes."""
    return diverging() if signed else sequential()


def apply(values: np.ndarray, limits: Limits, signed: bool) -> RGB:
    """Colour of each value, (..., 3) uint8: end colours beyond the limits, ``NOT_MEASURED_COLOUR`` for NaN."""
    low, high = limits
    fraction = np.clip((np.asarray(values, dtype=np.float64) - low) / (high - low), 0, 1)
    colour_index = np.nan_to_num(np.round(255 * fraction), nan=256).astype(np.int64)
    return np.vstack([table(signed), NOT_MEASURED_COLOUR]).astype(np.uint8)[colour_index]


def ink(rgb: np.ndarray) -> str:
    """White or black, whichever has more contrast to a colour (3,) in bytes, by WCAG's relative luminance."""
    rgb_fraction = np.divide(rgb, 255)
    linear_rgb = np.where(rgb_fraction <= 0.04045, rgb_fraction / 12.92, ((rgb_fraction + 0.055) / 1.055) ** 2.4)
    luminance = linear_rgb @ [0.2126, 0.7152, 0.0722]
    return "white" if 1.05 * 0.05 > (luminance + 0.05) ** 2 else "black"
