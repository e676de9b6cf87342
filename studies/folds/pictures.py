"""Pictures of simulated folds side by side: the same camera, scale and colour limits, and a caption under each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morphofold.quantities import Quantity, round_out
from morphofold.report.pictures.surfaces import Picture, Row, camera, colour_bar, draw, ruler, write
from morphofold.sim.run import Simulation
from morphofold.surface import Surface

DISPLACEMENT = Quantity("displacement", "Displacement |u|", "mm")
VIEW = "top"  # along the axis of a half sphere: shows all that was simulated, and no mirrored part
WIDEST = 420  # pixels from one column to the next


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture: its caption, the surface [mm], and a value (N,) per vertex."""

    words: str
    surface: Surface
    values: NDArray[np.float64]


def displaced(simulation: Simulation, g: float, words: str = "") -> Panel:
    """The pial surface at growth g, coloured by the distance of each point from its position at g = 1 [mm]."""
    now, before = simulation.cortex(g).pial, simulation.cortex(1.0).pial
    return Panel(words or f"g = {g:.2f}", now, np.linalg.norm(now.verts - before.verts, axis=1))


def row_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    """0, and the next round number above the 99.5th percentile of the values of every panel."""
    return 0.0, round_out(max(float(np.percentile(panel.values, 99.5)) for panel in panels))


def picture(
    panels: Sequence[Sequence[Panel]],
    what: Quantity,
    limits: Sequence[tuple[float, float]],
    columns: Sequence[str] = (),
) -> Picture:
    """Rows of panels seen from above at one scale, a colour bar under each row and a scale bar under the last.

    Parameters
    ----------
    panels : rows of Panel
        All rows have the same number of panels.
    what : Quantity
    limits : sequence of (low, high)
        Colour limits, the same for all panels of a row.
    columns : sequence of str
        Titles of the columns.

    Returns
    -------
    (height, width, 3) uint8
    """
    extents = [[np.ptp(p.surface.verts @ camera(VIEW, "lh").T, axis=0)[:2] for p in row] for row in panels]
    gap, edge, words, bar = 20, 20, 34, 84
    per_mm = (WIDEST - gap) / np.max(extents)
    lines = [int(np.ceil(per_mm * np.max(row, axis=0)[1])) + gap for row in extents]
    top = 40 if columns else edge
    size = (top + sum(lines) + len(lines) * (words + bar), 2 * edge + WIDEST * len(panels[0]))
    canvas = np.full((*size, 3), 255, dtype=np.uint8)
    for k, title in enumerate(columns):
        write(canvas, title, (edge + (k + 0.5) * WIDEST, 8), 17, bold=True, anchor="middle")
    for row, line, colours in zip(panels, lines, limits):
        for k, panel in enumerate(row):
            left, seen = edge + k * WIDEST, Row(panel.words, panel.surface, panel.values)
            (image,) = draw(seen, [VIEW], what, colours, (WIDEST, line), line / (2 * per_mm))
            canvas[top : top + line, left : left + WIDEST] = image
            write(canvas, panel.words, (left + WIDEST / 2, top + line), 17, anchor="middle")
        top += line + words
        colour_bar(canvas, what, colours, (size[1] // 2 - 150, top + 10), (300, 14))
        top += bar
    ruler(canvas, per_mm, (edge, top - bar + 20))
    return canvas
