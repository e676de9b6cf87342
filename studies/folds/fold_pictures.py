"""Pictures of simulated folds side by side: the same camera, scale and colour limits, and a caption under each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphofold.quantities import Quantity, round_out
from morphofold.report.pictures.pixel_canvas import Picture, new_sheet
from morphofold.report.pictures.surfaces import Row, draw, extent
from morphofold.sim.run import Simulation
from morphofold.surface import Surface

DISPLACEMENT = Quantity("displacement", "Displacement |u|", "mm")
VIEW = "top"  # along the axis of a half sphere: shows all that was simulated, and no mirrored part
PITCH = 420  # pixels from one column to the next


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture: its caption, the surface [mm], and a value (N,) per vertex."""

    caption: str
    surface: Surface
    values: NDArray[np.float64]


def displaced(simulation: Simulation, g: float, caption: str = "") -> Panel:
    """The pial surface at growth g, coloured by the distance of each point from its position at g = 1 [mm]."""
    surface, reference = simulation.cortex(g).pial, simulation.cortex(1.0).pial
    return Panel(caption or f"g = {g:.2f}", surface, np.linalg.norm(surface.verts - reference.verts, axis=1))


def row_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    """0, and the next round number above the 99.5th percentile of the values of every panel."""
    return 0.0, round_out(max(float(np.percentile(panel.values, 99.5)) for panel in panels))


def picture(
    panels: Sequence[Sequence[Panel]],
    measure: Quantity,
    limits: Sequence[tuple[float, float]],
    columns: Sequence[str] = (),
) -> Picture:
    """Rows of panels seen from above at one scale, a colour bar under each row and a scale bar under the last.

    Parameters
    ----------
    panels : rows of Panel
        All rows have the same number of panels.
    measure : Quantity
    limits : sequence of (low, high)
        Colour limits, the same for all panels of a row.
    columns : sequence of str
        Titles of the columns.

    Returns
    -------
    (height, width, 3) uint8
    """
    extents = [[extent(panel.surface, VIEW) for panel in row] for row in panels]
    gap, margin, text_height, bar_height = 20, 20, 34, 84
    px_per_mm = (PITCH - gap) / np.max(extents)
    row_heights = [int(np.ceil(px_per_mm * np.max(row, axis=0)[1])) + gap for row in extents]
    y_top, width = 40 if columns else margin, 2 * margin + PITCH * len(panels[0])
    image_rows = [
        [draw(Row("", panel.surface, panel.values), VIEW, (PITCH, row_height), px_per_mm, bar_limits) for panel in row]
        for row, row_height, bar_limits in zip(panels, row_heights, limits)
    ]
    with new_sheet(width, y_top + sum(row_heights) + len(row_heights) * (text_height + bar_height)) as sheet:
        for column, title in enumerate(columns):
            sheet.text(margin + (column + 0.5) * PITCH, 30, title, 15.5, weight="bold", ha="center")
        for row, images, row_height, bar_limits in zip(panels, image_rows, row_heights, limits):
            for column, (panel, image) in enumerate(zip(row, images)):
                sheet.picture(image, margin + column * PITCH, y_top)
                sheet.text(margin + (column + 0.5) * PITCH, y_top + row_height + 22, panel.caption, 15.5, ha="center")
            y_top += row_height + text_height
            sheet.colour_bar(measure, bar_limits, width // 2 - 150, y_top + 10, 300, 14)
            y_top += bar_height
        sheet.ruler(px_per_mm, margin, y_top - bar_height + 20)
        return sheet.pixels()
