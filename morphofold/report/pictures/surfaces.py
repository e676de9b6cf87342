"""Static pictures of surfaces: a ``Row`` per surface goes in, the pixels of a figure come out, a column per view, with
one measure, one set of limits and one scale.

``raster`` draws the surfaces, with the same bytes on every machine and no graphics library.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product

import numpy as np

from morphofold.errors import OutOfRange, UnknownName
from morphofold.frozen_arrays import Array, Ints, memoized
from morphofold.geometry import vertex_normals
from morphofold.quantities import Quantity, common_limits
from morphofold.report import colours
from morphofold.report.colours import Limits
from morphofold.report.pictures import raster
from morphofold.report.pictures.pixel_canvas import Picture, new_sheet
from morphofold.surface import Faces, Surface
from morphofold.threads import run_parallel

VIEWS = ("lateral", "medial", "top", "bottom")
#: where the screen's right, up and towards-the-viewer axes point, for a right hemisphere: right, left, anterior,
#: posterior, superior or inferior
CAMERAS = {"lateral": "ASR", "medial": "PSL", "top": "RAS", "bottom": "LAI", "front": "LSA"}
DIRECTIONS = dict(zip("RASLPI", [*np.eye(3), *-np.eye(3)]))
OTHER_SIDE = {"lateral": "medial", "medial": "lateral"}
MOST_PX_PER_MM, LARGEST_VIEW_PX = 6.0, 400
GAP_PX, EDGE_PX, HEAD_PX, FOOT_PX, NAME_PX = 24, 20, 72, 112, 30  # [pixels] of a figure

NO_VALUES = np.empty(0)


@dataclass(frozen=True, eq=False)
class Row:
    """One surface of a figure: its name, its shape, and a value (N,) or a colour (N, 3) per vertex; bare without."""

    name: str
    surface: Surface
    values: Array = field(default_factory=lambda: NO_VALUES)
    hemi: str = "lh"
    rgb: colours.RGB | None = None

    def colours(self, limits: Limits, signed: bool) -> colours.RGB:
        if self.rgb is not None:
            return self.rgb
        if self.values.size:
            return colours.apply(self.values, limits, signed)
        return np.full((len(self.surface.verts), 3), colours.BARE_SURFACE_COLOUR, dtype=np.uint8)


def camera(view: str, hemi: str) -> Array:
    """The screen's right, up and towards-the-viewer axes, as rows of a (3, 3) rotation.

    Coordinates are right, anterior, superior (RAS): a left hemisphere is seen laterally from -x, a right one
    from +x; seen from the top or the bottom, anterior is up.
    """
    if view not in CAMERAS:
        raise UnknownName(f"view must be one of {', '.join(CAMERAS)}; got {view!r}.")
    return np.array([DIRECTIONS[axis] for axis in CAMERAS[view if hemi == "rh" else OTHER_SIDE.get(view, view)]])


def extent(surface: Surface, view: str, hemi: str = "lh") -> Array:
    """Width and height (2,) of a surface in a view [mm]."""
    return np.abs(camera(view, hemi)[:2]) @ np.ptp(surface.verts, axis=0)  # its axes are those of the coordinates


@memoized
def visible_faces(
    verts: Array, faces: Faces, view: str, hemi: str, size: tuple[int, int], px_per_mm: float
) -> raster.Seen:
    """The visible faces of a surface in a view; the next picture of the same surface then only needs colouring."""
    centred_verts = verts - (verts.min(axis=0) + verts.max(axis=0)) / 2
    return raster.visible(centred_verts @ camera(view, hemi).T, faces, size, px_per_mm)


def draw(
    row: Row, view: str, size: tuple[int, int], px_per_mm: float, limits: Limits = (0.0, 1.0), signed: bool = False
) -> Picture:
    """One surface from a side, in the middle of a picture (height, width, 3) of ``size`` (width, height)."""
    verts, faces = row.surface.verts, row.surface.faces
    visible_pixels = visible_faces(verts, faces, view, row.hemi, size, px_per_mm)
    normals = vertex_normals(verts, faces) @ camera(view, row.hemi).T
    return raster.coloured(visible_pixels, faces, normals, row.colours(limits, signed))


def figure(
    rows: Sequence[Row],
    measure: Quantity,
    limits: Limits | None = None,
    views: Sequence[str] = VIEWS,
    width: int = 1520,
    legend: Sequence[tuple[str, str]] = (),
    *,
    transposed: bool = False,
) -> Picture:
    """Rows of surfaces from ``views``, all at one scale, with view names and ruler.

    Below is a colour bar between the ``limits`` (None: limits that suit all values), or if there are no values the
    ``legend``: words and their colour ("#d55e00").
    ``transposed`` has the surfaces in columns. Raises ``OutOfRange`` for surfaces without extent.
    """
    row_names = [row.name for row in rows]
    cells, headings = [[(row, view) for view in views] for row in rows], list(views)
    if transposed:
        cells, headings, row_names = [list(column) for column in zip(*cells)], row_names, headings
    if known_values := [row.values for row in rows if row.values.size]:
        limits = limits or common_limits(measure, known_values)
    extents = np.array([[extent(row.surface, view, row.hemi) for row, view in cell_row] for cell_row in cells])
    per_mm, column_widths, heights = _scale_and_sizes(extents, width)
    widest, ends = max(column_widths), limits or (0.0, 1.0)
    (*tops, bottom), lefts = np.cumsum([HEAD_PX, *(heights + NAME_PX)]), np.cumsum([EDGE_PX, *column_widths])
    images = run_parallel(
        *(partial(draw, *c, (widest, h), per_mm, ends, measure.signed) for line, h in zip(cells, heights) for c in line)
    )
    with new_sheet(width, bottom + FOOT_PX) as sheet:
        sheet.text(EDGE_PX, 36, measure.title, 18, weight="bold")
        for left, column_width, heading in zip(lefts, column_widths, headings):
            sheet.text(left + column_width / 2, 62, heading, 13.5, column_width, ha="center", color="0.43")
        for top, name in zip(tops, row_names):
            sheet.text(EDGE_PX, top + 22, name, 15.5, max_px=width - 2 * EDGE_PX)
        for (top, (left, column_width)), picture in zip(product(tops, zip(lefts, column_widths)), images):
            cropped_px = (widest - column_width) // 2
            sheet.picture(picture[:, cropped_px : cropped_px + column_width], left, top + NAME_PX)
        sheet.ruler(per_mm, EDGE_PX, bottom + 34)
        if limits is not None:
            sheet.colour_bar(measure, limits, width // 2 - 180, bottom + 22, 360, 16)
            if any(np.isnan(values).any() for values in known_values):
                sheet.key(width // 2 + 240, bottom + 22, "not measured", np.divide(colours.NOT_MEASURED_COLOUR, 255))
        for k, legend_entry in enumerate(legend):
            sheet.key(EDGE_PX + 220 + 230 * k, bottom + 26, *legend_entry)
        return sheet.pixels()


def _scale_and_sizes(extents: Array, width: int) -> tuple[float, Ints, Ints]:
    """Pixels per mm, and the width of each column and height of each line, in which all surfaces fit; from their
    width and height [mm] (lines, columns, 2)."""
    if not 0 < extents.max() < np.inf:
        raise OutOfRange(f"the surfaces extend {extents.max():g} mm, so there is nothing to draw.")
    widths_mm, heights_mm = extents[:, :, 0].max(axis=0), extents[:, :, 1].max(axis=1)
    px_per_mm = max(MOST_PX_PER_MM, LARGEST_VIEW_PX / extents.max())  # small bodies are enlarged
    if widths_mm.any():
        px_per_mm = min(px_per_mm, (width - 2 * EDGE_PX - GAP_PX * len(widths_mm)) / widths_mm.sum())
    widths_px, heights_px = (np.ceil(px_per_mm * sizes).astype(np.int64) + GAP_PX for sizes in (widths_mm, heights_mm))
    return px_per_mm, widths_px, heights_px
