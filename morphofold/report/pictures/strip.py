"""A strip of small pictures of surfaces beside each other, at one scale, for places such as a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from morphofold.errors import OutOfRange
from morphofold.quantities import Quantity
from morphofold.report.pictures.surfaces import Picture, Row, camera, colour_bar, draw, fitted, write

TILE_PX, SEVERAL_TILES_PX = (300, 230), (225, 172)  # width and height of one or two pictures, and of each of more
MARGIN_PX, HEAD_PX, FOOT_PX = 12, 26, 66


class Tile(NamedTuple):
    """One picture: a surface, seen from a side, with words above."""

    row: Row
    view: str
    words: str


def strip(tiles: Sequence[Tile], what: Quantity | None, limits: tuple[float, float] = (0.0, 1.0)) -> Picture:
    """Pictures beside each other; with ``what``, a colour bar below.

    Raises ``OutOfRange`` for a surface without extent.
    """
    width, height = size = TILE_PX if len(tiles) <= 2 else SEVERAL_TILES_PX
    extent = np.array([np.ptp(t.row.surface.verts @ camera(t.view, t.row.hemi).T, axis=0)[:2] for t in tiles]).max(
        axis=0
    )
    if not 0 < extent.max() < np.inf:
        raise OutOfRange(f"the surfaces extend {extent.max():g} mm, so there is nothing to draw.")
    with np.errstate(divide="ignore"):
        per_mm = float(np.min([width - 2 * MARGIN_PX, height - 2 * MARGIN_PX] / extent))
    canvas = np.full((HEAD_PX + height + (FOOT_PX if what else 0), width * len(tiles), 3), 255, dtype=np.uint8)
    shown = what or Quantity("surface", "Surface")
    for k, tile in enumerate(tiles):
        (picture,) = draw(tile.row, [tile.view], shown, limits, size, height / (2 * per_mm))
        canvas[HEAD_PX : HEAD_PX + height, k * width : (k + 1) * width] = picture
        words = fitted(tile.words, 14, width - 2 * MARGIN_PX)
        write(canvas, words, ((k + 0.5) * width, 4), 14, anchor="middle", grey=80)
    if what:
        long = min(260, canvas.shape[1] - 4 * MARGIN_PX)
        colour_bar(canvas, what, limits, ((canvas.shape[1] - long) // 2, HEAD_PX + height), (long, 12))
    return canvas
