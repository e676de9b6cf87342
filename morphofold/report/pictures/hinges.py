"""Pairs of three-hinge patterns: patches of pial surface around two hinges, crests in red, each in its own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis import Measures
from morphofold.analysis.graph.hinges import hinge_at
from morphofold.comparison.hinges import Match, examples
from morphofold.errors import MissingPart
from morphofold.quantities import Quantity
from morphofold.report.colours import rgb_of
from morphofold.report.pictures.net import paint_lines, shaded
from morphofold.report.pictures.raster import look
from morphofold.report.pictures.sheet import GREY, Picture, new_sheet
from morphofold.report.pictures.surfaces import Row, draw
from morphofold.surface import Faces, Surface

OWN_CREST_COLOUR, OTHER_CREST_COLOUR = "#c8102e", "#e8a5a0"  # crests of the hinge, and the others
PATCH_RADIUS_IN_WIDTHS = 2.0  # radius of a patch, in crown widths
CREST_WIDTH = 0.16  # width of a drawn crest, in crown widths
EDGE_HALVINGS = 2  # number of times edges are halved, for smooth lines
TILT_DEG = 25.0  # [degrees] tilt of a patch, so that its height is visible
PANEL_PX, CAPTION_PX = 330, 30  # pixels
PX_PER_WIDTH = PANEL_PX / (2 * PATCH_RADIUS_IN_WIDTHS)
LEAST_VISIBLE_SHARE = 0.7  # least visible share of a hinge's crests in an example
PATCH_QUANTITY = Quantity("patch", "Patch")


def hinge_patch(measures: Measures, number: int, pose: int = 0) -> Row:
    """The connected pial surface within two crown widths of a hinge, in crown widths.

    The hinge's own crests are red, others pale. Crests run on the white surface; they are drawn at the same vertices of
    the pial surface.

    Parameters
    ----------
    measures : Measures
        With a gyral graph.
    number : int
        Number of the hinge, in the table of hinges and in the graph.
    pose : int
        Which arm points right, and whether the patch is mirrored (3 and more), as in
        :func:`morphofold.analysis.graph.hinge_shapes.shape_distance`.

    Returns
    -------
    Row
        The hinge is the origin, and its normal is z before the tilt.

    Raises
    ------
    MissingPart
        If there is no graph, or no such hinge in it.
    """
    graph = measures.graph
    if graph is None or number not in graph or graph.degree(number) < 3:
        raise MissingPart(
            f"{measures.cortex.name}: has no gyral graph with a hinge {number}. Measure the cortex again."
        )
    from trimesh.remesh import subdivide

    hinge, width = hinge_at(graph, number), graph.graph["scales"].width
    normal = np.asarray(graph.nodes[number]["normal"])
    right = np.array(hinge.arms[pose % 3].direction)
    frame = np.stack([right, np.cross(normal, right), normal]) / width
    if pose >= 3:
        frame[1] *= -1
    pial = measures.cortex.pial
    verts = (pial.verts - pial.verts[hinge.vertex]) @ (_tilt_matrix() @ frame).T
    near = geometry.norms(verts) < PATCH_RADIUS_IN_WIDTHS
    first, second, third = pial.faces.T
    kept, faces = _connected_piece(pial.faces[near[first] & near[second] & near[third]], hinge.vertex)
    white, edge = measures.cortex.white.verts, graph.graph["edge"]
    tree, reach = cKDTree(white[kept]), edge + geometry.norms(white[kept] - white[hinge.vertex]).max()

    def carried(at: int | None) -> list[NDArray[np.float64]]:
        lines = [crest["polyline"] for *_, crest in graph.edges(at, data=True)]
        near = _lines_near(lines, white[hinge.vertex], reach)
        return [part for line in near for part in _line_on_patch(line, tree, verts[kept], edge)]

    grey = shaded(measures)[kept].astype(np.float64)
    fine, look = verts[kept], {"grey": grey}
    for _ in range(EDGE_HALVINGS):
        fine, faces, look = subdivide(fine, faces, vertex_attributes=look)
    rgb = np.round(look["grey"]).astype(np.uint8)
    paint_lines(rgb, fine, carried(None), CREST_WIDTH, OTHER_CREST_COLOUR)
    paint_lines(rgb, fine, carried(number), CREST_WIDTH, OWN_CREST_COLOUR)
    faces = faces[:, ::-1] if pose >= 3 else faces
    bounds = PATCH_RADIUS_IN_WIDTHS * np.array(
        [[-1.0, -1, -1], [1, 1, 1]]
    )  # without faces: they centre the picture on the hinge
    fine, rgb = np.concatenate([fine, bounds]), np.concatenate([rgb, rgb[:2]])
    return Row("", Surface(fine, faces), rgb=rgb)


def _connected_piece(faces: Faces, vertex: int) -> tuple[NDArray[np.int64], Faces]:
    """The vertices that faces (M, 3) connect to ``vertex``, and the faces between them."""
    piece = geometry.components(int(faces.max()) + 1, faces)[1]
    kept, ends = np.unique(faces[piece[faces[:, 0]] == piece[vertex]], return_inverse=True)
    return kept, ends.reshape(-1, 3)


def _lines_near(lines: list[NDArray[np.float64]], at: NDArray[np.float64], reach: float) -> list[NDArray[np.float64]]:
    """The lines (P, 3) with a point within ``reach`` [mm] of a point (3,)."""
    near = geometry.norms(np.concatenate(lines) - at) <= reach
    first = np.cumsum([0, *map(len, lines)])[:-1]
    return [line for line, some in zip(lines, np.logical_or.reduceat(near, first)) if some]


def _line_on_patch(
    line: NDArray[np.float64], white: cKDTree, verts: NDArray[np.float64], edge: float
) -> list[NDArray[np.float64]]:
    """The parts of a line (P, 3) within an edge [mm] of ``white`` vertices of a patch, moved to the same ``verts``.

    A line from vertex to vertex zigzags, so each part is smoothed; its ends stay.
    """
    far, nearest = white.query(line, distance_upper_bound=edge)
    inside = np.flatnonzero(np.isfinite(far))
    parts = []
    for run in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
        part = verts[nearest[run]]
        for _ in range(4 if len(part) > 2 else 0):
            part = np.concatenate([part[:1], (part[:-2] + 2 * part[1:-1] + part[2:]) / 4, part[-1:]])
        parts += [part] if len(part) > 1 else []
    return parts


def _tilt_matrix() -> NDArray[np.float64]:
    c, s = np.cos(np.radians(TILT_DEG)), np.sin(np.radians(TILT_DEG))
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def pair_of(match: Match, measures: Mapping[str, Measures]) -> tuple[Row, Row]:
    """The patches of a match; the second is in the pose most similar to the first."""
    one = hinge_patch(measures[match.surface], match.hinge)
    return one, hinge_patch(measures[match.other_surface], match.other, match.pose)


def clear_examples(matches: Sequence[Match], measures: Mapping[str, Measures]) -> dict[Match, tuple[Row, Row]]:
    """The best matches with crests visible in a picture, on surfaces with a graph, with their patches."""
    pairs: dict[Match, tuple[Row, Row]] = {}

    def clear(match: Match) -> bool:
        if measures[match.surface].graph is None or measures[match.other_surface].graph is None:
            return False
        pairs[match] = pair_of(match, measures)
        return all(in_sight(patch) > LEAST_VISIBLE_SHARE for patch in pairs[match])

    return {match: pairs[match] for match in examples(matches, accept=clear)}


def in_sight(patch: Row) -> float:
    """Visible share of a hinge's own crests in the picture of its patch."""
    faces = patch.surface.faces
    seen = look(patch.surface.verts, faces, (PANEL_PX, PANEL_PX), PATCH_RADIUS_IN_WIDTHS, oversample=1).face
    shown = np.zeros(len(patch.surface.verts), dtype=bool)
    shown[faces[np.unique(seen[seen >= 0])]] = True
    assert patch.rgb is not None
    own = (patch.rgb == rgb_of(OWN_CREST_COLOUR)).all(axis=1)
    return float(shown[own].mean()) if own.any() else 0.0


def hinge_pairs(pairs: Mapping[Match, tuple[Row, Row]], rows: tuple[str, str]) -> Picture:
    """Pairs of hinges in columns, the first group above the second; ``rows`` are the names of both groups."""
    drawn = [
        [draw(p, "top", PATCH_QUANTITY, (0, 1), (PANEL_PX, PANEL_PX), PX_PER_WIDTH) for p in patches]
        for patches in pairs.values()
    ]
    left, top, step = 3 * CAPTION_PX // 2, 16, PANEL_PX + CAPTION_PX
    with new_sheet(left + PANEL_PX * len(pairs), top + 2 * step + 12) as sheet:
        for k, (match, pictures) in enumerate(zip(pairs, drawn)):
            ends = ((match.surface, match.hinge, 0), (match.other_surface, match.other, match.pose))
            for line, (picture, (surface, number, pose)) in enumerate(zip(pictures, ends)):
                x, y = left + k * PANEL_PX, top + line * step
                sheet.picture(picture, x, y)
                name = surface.removeprefix(rows[line]).strip()  # its group is said at the row
                text = f"{name}, " * bool(name) + f"{number}" + ", mirrored" * (pose >= 3)
                sheet.text(x + PANEL_PX / 2, y + PANEL_PX + 22, text, 18, PANEL_PX - 20, ha="center", color=GREY)
        for line, name in enumerate(rows):
            middle = top + line * step + PANEL_PX / 2
            sheet.text(CAPTION_PX, middle, name, 20, PANEL_PX, ha="center", va="center", rotation=90, weight="bold")
        return sheet.pixels()
