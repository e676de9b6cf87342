"""Three-hinge patterns in pairs: patches of white surface about two hinges, crests in red, each in its own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from morphofold.analysis import Measures
from morphofold.analysis._mesh import mean_edge_length
from morphofold.analysis.hinge_table import hinge_at
from morphofold.analysis.smooth import DETOUR, edge_graph
from morphofold.comparison.hinges import Match
from morphofold.report.figures import Picture, Row, draw, write
from morphofold.report.net_picture import paint_lines, shaded
from morphofold.report.quantities import Quantity
from morphofold.surface import Surface

OWN, OTHERS = "#c8102e", "#e8a5a0"      # crests of the hinge, and the others
REACH = 2.2                             # radius of a patch along the surface, in gyral widths
TILT = 25.0                             # degrees by which a patch is tipped back, so that its height is seen
PANEL, WORDS = 330, 30  # pixels
NOTHING = Quantity("patch", "Patch")


def hinge_patch(measures: Measures, number: int, pose: int = 0) -> Row:
    """White surface within 2.2 gyral widths along it of a hinge, in gyral widths; its own crests red, others pale.

    Parameters
    ----------
    measures : Measures
        With a gyral graph.
    number : int
        Of the hinge, in the table of hinges and in the graph.
    pose : int
        Which arm points right, and whether the patch is mirrored (3 and more), as in
        :func:`morphofold.analysis.patterns.shape_distance`.

    Returns
    -------
    Row
        The hinge is the origin, its normal z before the patch is tipped back.

    Raises
    ------
    ValueError
        If there is no graph, or no such hinge in it.
    """
    graph = measures.graph
    if graph is None or number not in graph or graph.degree(number) < 3:
        raise ValueError(f"{measures.cortex.name}: has no gyral graph with a hinge {number}. Measure the cortex again.")
    hinge = hinge_at(graph, number)
    width = graph.graph["scales"].width
    normal = np.asarray(graph.nodes[number]["normal"])
    right = np.array(hinge.arms[pose % 3].direction)
    frame = np.stack([right, np.cross(normal, right), normal]) / width
    if pose >= 3:
        frame[1] *= -1
    white = measures.cortex.white
    edges = edge_graph(white.verts, white.faces)
    near = np.isfinite(dijkstra(edges, indices=hinge.vertex, limit=DETOUR * REACH * width))
    faces = white.faces[near[white.faces].all(axis=1)]
    kept = np.unique(faces)
    faces = np.searchsorted(kept, faces)
    rgb, verts = shaded(measures.maps["sulcal_depth"])[kept], white.verts[kept]
    thick = max(1.6 * mean_edge_length(white.verts, white.faces), 0.14 * width)
    own = [crest["polyline"] for *_, crest in graph.edges(number, data=True)]
    others = [crest["polyline"] for *_, crest in graph.edges(data=True)]
    for lines, colour in ((others, OTHERS), (own, OWN)):
        paint_lines(rgb, verts, lines, thick, colour)
    faces = faces[:, ::-1] if pose >= 3 else faces
    bounds = REACH * np.array([[-1.0, -1, -1], [1, 1, 1]])              # of no face: they put the hinge into the middle
    verts = np.concatenate([(verts - hinge.position) @ (_tipped() @ frame).T, bounds])
    return Row("", Surface(verts, faces), np.full(len(verts), np.nan), "lh", np.concatenate([rgb, rgb[:2]]))


def _tipped() -> NDArray[np.float64]:
    c, s = np.cos(np.radians(TILT)), np.sin(np.radians(TILT))
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def hinge_pairs(
    matches: Sequence[Match], measures: Mapping[str, Measures], rows: tuple[str, str], backend: str | None = None
) -> Picture:
    """Pairs of hinges in columns, the first group above the second, which lies as it resembles the first most.

    Parameters
    ----------
    matches : sequence of Match
    measures : mapping of the surfaces that they name
    rows : two str
        What stands before the rows.
    backend : {"pyvista", "raster"}, optional
        As for :func:`morphofold.report.figures.draw`.
    """
    left, top = 120, 16
    canvas = np.full((top + 2 * (PANEL + WORDS) + 12, left + PANEL * len(matches), 3), 255, dtype=np.uint8)
    for k, match in enumerate(matches):
        for line, (name, number, pose) in enumerate(
            [(match.surface, match.hinge, 0), (match.other_surface, match.other, match.pose)]
        ):
            patch = hinge_patch(measures[name], number, pose)
            (image,) = draw(patch, ["top"], NOTHING, (0, 1), (PANEL, PANEL), REACH, backend)
            y, x = top + line * (PANEL + WORDS), left + k * PANEL
            canvas[y : y + PANEL, x : x + PANEL] = image
            words = f"{name}, hinge {number}" + (", mirrored" if pose >= 3 else "")
            write(canvas, words, (x + PANEL / 2, y + PANEL), 14, anchor="middle", grey=60)
    for line, words in enumerate(rows):
        write(canvas, words, (10, top + line * (PANEL + WORDS) + PANEL / 2 - 20), 17, bold=True)
    return canvas
