"""Static pictures: one row per surface, one column per view, one measure, one set of limits, one scale.

``raster`` draws the surfaces, with the same bytes on every machine and no graphics library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import UnknownName
from morphofold.geometry import vertex_normals
from morphofold.quantities import Quantity
from morphofold.report import colours
from morphofold.report.pictures import raster
from morphofold.report.pictures.png import lettering
from morphofold.report.plots.line_plots import ticks
from morphofold.surface import Surface
from morphofold.threads import beside

Picture = NDArray[np.uint8]  # (height, width, 3)

VIEWS = ("lateral", "medial", "top", "bottom")
MOST_PX_PER_MM, LARGEST_VIEW_PX = 6.0, 400


def camera(view: str, hemi: str) -> NDArray[np.float64]:
    """The screen's right, up and towards-the-viewer axes, as rows of a (3, 3) rotation.

    Coordinates are right, anterior, superior (RAS): a left hemisphere is seen laterally from -x, a right one
    from +x; seen from the top or the bottom, anterior is up.
    """
    side = 1.0 if (hemi == "rh") == (view == "lateral") else -1.0
    axes = {
        "lateral": [[0, side, 0], [0, 0, 1], [side, 0, 0]],
        "medial": [[0, side, 0], [0, 0, 1], [side, 0, 0]],
        "top": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "bottom": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        "front": [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
    }
    if view not in axes:
        raise UnknownName(f"view must be one of {', '.join(axes)}; got {view!r}.")
    return np.array(axes[view], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Row:
    """One surface of a figure: its name, its shape, and a value (N,) or a colour (N, 3) per vertex."""

    name: str
    surface: Surface
    values: NDArray[np.float64]
    hemi: str = "lh"
    rgb: NDArray[np.uint8] | None = None


VisibleFaces = dict[tuple[Any, ...], Any]  # (surface, view) -> visible faces


def draw(
    row: Row,
    views: Sequence[str],
    what: Quantity,
    limits: tuple[float, float],
    size: tuple[int, int],
    half_height: float,
    looks: VisibleFaces | None = None,
) -> list[Picture]:
    """One surface from each of ``views``, as pictures (height, width, 3); ``half_height`` of a picture in mm.

    ``looks`` keeps the visible faces of a surface; the next picture of the same surface then only needs colouring.
    """
    looks = {} if looks is None else looks
    verts, faces = row.surface.verts, row.surface.faces
    points = verts - (verts.min(axis=0) + verts.max(axis=0)) / 2
    rgb = colours.apply(row.values, limits, what.signed) if row.rgb is None else row.rgb
    mine = (row.surface,)  # the key also keeps the surface alive
    if mine not in looks:
        looks[mine] = vertex_normals(points, faces)
    normals = looks[mine]
    cameras = [camera(view, row.hemi) for view in views]

    def picture(turned: NDArray[np.float64]) -> Picture:
        place = (row.surface, turned.tobytes(), size, half_height)
        if place not in looks:
            looks[place] = raster.look(points @ turned.T, faces, size, half_height)
        seen: raster.Seen = looks[place]
        return seen.coloured(normals @ turned.T, rgb)

    return beside(*(partial(picture, camera) for camera in cameras))


def figure(
    rows: Sequence[Row],
    what: Quantity,
    limits: tuple[float, float],
    views: Sequence[str] = VIEWS,
    width: int = 1520,
    legend: Sequence[tuple[str, str]] = (),
    looks: VisibleFaces | None = None,
) -> Picture:
    """Rows of surfaces from ``views``, all at one scale, with view names, ruler, and colour bar or ``legend``.

    ``legend`` has words and their colour ("#d55e00"). ``looks`` is as for :func:`draw`.
    """
    extent = np.array([[np.ptp(r.surface.verts @ camera(v, r.hemi).T, axis=0)[:2] for v in views] for r in rows])
    gap, edge, head, foot, label = 24, 20, 72, 112, 30
    most = max(MOST_PX_PER_MM, LARGEST_VIEW_PX / extent.max())  # small bodies are enlarged
    per_mm = min((width - 2 * edge - gap * len(views)) / extent[:, :, 0].max(axis=0).sum(), most)
    columns = np.ceil(per_mm * extent[:, :, 0].max(axis=0)).astype(int) + gap
    lines = np.ceil(per_mm * extent[:, :, 1].max(axis=1)).astype(int) + gap
    canvas = np.full((head + int(lines.sum()) + len(rows) * label + foot, width, 3), 255, dtype=np.uint8)
    write(canvas, what.title, (edge, 10), 20, bold=True)
    lefts, top = edge + np.cumsum(columns) - columns, head
    for left, column, view in zip(lefts, columns, views):
        write(canvas, view, (left + column / 2, 42), 15, anchor="middle", grey=110)
    for row, line in zip(rows, lines):
        write(canvas, row.name, (edge, top), 17)
        top += label
        wide = int(columns.max())
        pictures = draw(row, views, what, limits, (wide, int(line)), line / (2 * per_mm), looks)
        for left, column, picture in zip(lefts, columns, pictures):
            cut = (wide - column) // 2
            canvas[top : top + line, left : left + column] = picture[:, cut : cut + column]
        top += line
    ruler(canvas, per_mm, (edge, top + 34))
    if legend:
        for k, (words, colour) in enumerate(legend):
            x = edge + 220 + 230 * k
            canvas[top + 26 : top + 42, x : x + 16] = colours.rgb_of(colour)
            write(canvas, words, (x + 24, top + 21), 15, grey=60)
        return canvas
    colour_bar(canvas, what, limits, (width // 2 - 180, top + 22), (360, 16))
    if any(np.isnan(row.values).any() for row in rows):
        x = width // 2 + 240
        canvas[top + 22 : top + 38, x : x + 26] = colours.NOT_MEASURED_COLOUR
        write(canvas, "not measured", (x + 34, top + 19), 14, grey=80)
    return canvas


def ruler(canvas: Picture, px_per_mm: float, at: tuple[int, int]) -> None:
    """Draw a scale bar of a round length, with its top left at ``at``."""
    mm = max((m for m in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if m * px_per_mm <= 160), default=0.1)
    end = at[0] + round(mm * px_per_mm)
    canvas[at[1] : at[1] + 3, at[0] : end] = 60
    write(canvas, f"{mm} mm", ((at[0] + end) / 2, at[1] + 6), 14, anchor="middle", grey=60)


def colour_bar(
    canvas: Picture, what: Quantity, limits: tuple[float, float], at: tuple[int, int], size: tuple[int, int]
) -> None:
    """Draw the colours between the limits, (width, height) pixels from the top left ``at``, numbers and unit below."""
    x, y = at
    ramp = colours.apply(np.linspace(*limits, size[0]), limits, what.signed)
    canvas[y : y + size[1], x : x + size[0]] = ramp
    clear = 0.12 * (limits[1] - limits[0])  # distance from the numbers at both ends
    inner = [t for t in ticks(*limits, about=4) if limits[0] + clear < t < limits[1] - clear]
    for mark in (limits[0], *inner, limits[1]):
        column = x + round((mark - limits[0]) / (limits[1] - limits[0]) * (size[0] - 1))
        canvas[y + size[1] : y + size[1] + 5, column] = 60
        write(canvas, f"{mark:.3g}", (column, y + size[1] + 6), 14, anchor="middle", grey=60)
    write(canvas, what.title, (x + size[0] / 2, y + size[1] + 28), 14, anchor="middle", grey=60)


_PLAIN_CHARACTERS = str.maketrans({"₁": "1", "₂": "2", "\u202f": " ", "−": "-"})  # plain characters for these glyphs


def write(
    canvas: Picture,
    text: str,
    at: tuple[float, float],
    size: int,
    bold: bool = False,
    anchor: str = "start",
    grey: int = 20,
) -> None:
    """Write a line of text on a picture, with its top left (or top middle) at ``at``; cut off at the border."""
    ink = lettering(text.translate(_PLAIN_CHARACTERS), size, bold)
    x = round(at[0] - (ink.shape[1] / 2 if anchor == "middle" else 0))
    y = round(at[1] + 1.4 * size) - ink.shape[0]  # so that the bottoms of all texts are at the same height
    left, top = max(-x, 0), max(-y, 0)
    under = canvas[y + top : y + ink.shape[0], x + left : x + ink.shape[1]]
    ink = ink[top : top + under.shape[0], left : left + under.shape[1], None]
    under[:] = np.round(under * (1 - ink) + grey * ink).astype(np.uint8)


def fitted(text: str, size: int, width: int, bold: bool = False) -> str:
    """A line of text of at most ``width`` pixels; if longer, its beginning and end with "…" between them."""
    words, kept = text, len(text)
    while kept > 2 and lettering(words.translate(_PLAIN_CHARACTERS), size, bold).shape[1] > width:
        kept -= 1
        words = text[: kept - kept // 2] + "…" + text[len(text) - kept // 2 :]
    return words


def safe_name(key: str) -> str:
    """A map's name, which may come from a file, as a file name of letters, digits, ``-`` and ``_``."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in key) or "map"
