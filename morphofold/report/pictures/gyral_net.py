"""Pictures of the gyral net: ``Measures`` with a graph go in, painted surfaces and their pictures come out.

They are the net on its white surface, and pairs of matched hinges side by side: patches of pial surface around each,
crests in red, in the hinge's own frame. The pages of analyses and comparisons show them.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morphofold import geometry
from morphofold.analysis import Measures, vertex_normals
from morphofold.analysis.graph.curve_net import resampled
from morphofold.analysis.graph.hinges import counts, hinge_at
from morphofold.comparison.hinge_comparison import Match, examples
from morphofold.errors import MissingPart
from morphofold.frozen_arrays import Array
from morphofold.quantities import Quantity
from morphofold.report.colours import BARE_SURFACE_COLOUR, RGB, in_bytes, rgb_of
from morphofold.report.pictures.pixel_canvas import GREY, Picture, new_sheet
from morphofold.report.pictures.raster import visible
from morphofold.report.pictures.surfaces import Row, draw, figure
from morphofold.surface import Surface, Verts

PatchPair = tuple[Row, Row]  # patches of two hinges that match

CREST_COLOUR = "#333333"
HINGE_RADIUS_IN_WIDTHS = 0.27  # radius of a hinge, in crown widths
#: colours of hinges by number of arms; five or more have one colour
COLOUR_BY_ARMS = {3: "#d55e00", 4: "#0072b2", 5: "#009e73"}
DOUBTFUL_COLOUR = "#8c8c8c"  # hinges that are not counted, with any number of arms
NET_LEGEND = tuple(
    zip(
        ("crest", "hinge, 3 arms", "4 arms", "5 or more", "doubtful"),
        (CREST_COLOUR, *COLOUR_BY_ARMS.values(), DOUBTFUL_COLOUR),
    )
)
OWN_CREST_COLOUR, OTHER_CREST_COLOUR = "#c8102e", "#e8a5a0"  # crests of the hinge, and the others
PATCH_RADIUS_IN_WIDTHS = 2.0  # radius of a patch, in crown widths
CREST_WIDTH = 0.16  # width of a drawn crest, in crown widths
EDGE_HALVINGS = 2  # number of times edges are halved, for smooth lines
TILT_DEG = 25.0  # [degrees] tilt of a patch, so that its height is visible
TILT_MATRIX = Rotation.from_euler("x", -TILT_DEG, degrees=True).as_matrix()
PANEL_PX, CAPTION_PX = 330, 30  # pixels
PX_PER_WIDTH = PANEL_PX / (2 * PATCH_RADIUS_IN_WIDTHS)
LEAST_VISIBLE_SHARE = 0.7  # least visible share of a hinge's crests in an example


def net_row(measures: Measures, name: str) -> Row:
    """The white surface of measures with their net, sulci darker; needs a graph.

    Raises ``MissingPart`` without one.
    """
    cortex, graph = measures.cortex, measures.graph
    if graph is None:
        raise MissingPart(f"{name}: has no gyral graph, because the analysis is older. Measure the cortex again.")
    verts, edge_mm, scales = cortex.white.verts, graph.graph["edge"], graph.graph["scales"]
    rgb, normals, vertex_tree = shaded(measures), vertex_normals(verts, cortex.faces), cKDTree(verts)
    paint_lines(rgb, verts, [line for *_, line in graph.edges(data="polyline")], edge_mm, CREST_COLOUR)
    dot_radius = max(HINGE_RADIUS_IN_WIDTHS * (scales.width if scales else 0.0), edge_mm)  # so a dot has a vertex
    for _, hinge in graph.nodes(data=True):
        if hinge["degree"] > 2:
            near_vertices = np.array(vertex_tree.query_ball_point(hinge["position"], dot_radius), dtype=np.int64)
            colour = COLOUR_BY_ARMS[min(hinge["degree"], 5)] if counts(hinge) else DOUBTFUL_COLOUR
            rgb[near_vertices[normals[near_vertices] @ hinge["normal"] > 0]] = rgb_of(colour)
    return Row(name, cortex.white, hemi=cortex.hemi, rgb=rgb)


def shaded(measures: Measures) -> RGB:
    """Colours (N, 3) of the bare surface, darker with sulcal depth where that was measured."""
    depth = measures.maps.get("sulcal_depth", np.zeros(measures.cortex.n_vertices))
    depth_scale = max(np.nanquantile(depth, 0.95), 1e-9)  # more than 0 without any sulcus
    depth_fraction = np.clip(np.nan_to_num(depth / depth_scale), 0, 1)
    return in_bytes(np.array(BARE_SURFACE_COLOUR) * (1 - 0.35 * depth_fraction)[:, None])


def paint_lines(rgb: RGB, verts: Verts, lines: Sequence[Array], edge_length: float, colour: str) -> None:
    """Colour the vertices within about half an ``edge_length`` [mm] of lines (P, 3)."""
    if lines:
        points, reach_mm = np.concatenate([resampled(line, 0.3 * edge_length) for line in lines]), 0.55 * edge_length
        rgb[cKDTree(points).query(verts, distance_upper_bound=reach_mm)[0] < reach_mm] = rgb_of(colour)


def net_figure(rows: Sequence[Row]) -> Picture:
    """Picture of rows of nets, in all views."""
    return figure(rows, Quantity("net", "Gyral net"), legend=NET_LEGEND)


def hinge_patch(measures: Measures, hinge_number: int, pose: int = 0) -> Row:
    """The connected pial surface within two crown widths of a hinge, in crown widths.

    The hinge's own crests are red, others pale. Crests run on the white surface; they are drawn at the same vertices of
    the pial surface.

    Parameters
    ----------
    measures : Measures
        With a gyral graph.
    hinge_number : int
        Number of the hinge, in the table of hinges and in the graph.
    pose : int
        Which arm points right, and whether the patch is mirrored (3 and more), as in
        :func:`morphofold.analysis.graph.hinge_statistics.shape_distance`.

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
    if graph is None or hinge_number not in graph or graph.degree(hinge_number) < 3:
        raise MissingPart(
            f"{measures.cortex.name}: has no gyral graph with a hinge {hinge_number}. Measure the cortex again."
        )
    hinge, crown_width = hinge_at(graph, hinge_number), graph.graph["scales"].width
    normal, right_direction = graph.nodes[hinge_number]["normal"], hinge.arms[pose % 3].direction
    mirror = -1 if pose >= 3 else 1
    frame = np.stack([right_direction, mirror * np.cross(normal, right_direction), normal]) / crown_width
    pial = measures.cortex.pial
    verts = (pial.verts - pial.verts[hinge.vertex]) @ (TILT_MATRIX @ frame).T
    is_near = geometry.norms(verts) < PATCH_RADIUS_IN_WIDTHS
    faces = pial.faces[is_near[pial.faces].all(axis=1)]
    piece_of = geometry.components(len(verts), faces)[1]
    patch_index, patch_verts, faces = geometry.in_use(verts, faces[piece_of[faces[:, 0]] == piece_of[hinge.vertex]])
    white, edge_mm = measures.cortex.white.verts, graph.graph["edge"]
    white_tree, shades = cKDTree(white[patch_index]), shaded(measures)[patch_index]
    fine_values = np.column_stack([patch_verts, shades])
    for _ in range(EDGE_HALVINGS):
        fine_values, faces = geometry.split(fine_values, faces)
    fine_xyz, rgb = fine_values[:, :3].copy(), in_bytes(fine_values[:, 3:])
    for node, colour in ((None, OTHER_CREST_COLOUR), (hinge_number, OWN_CREST_COLOUR)):  # of None, all crests
        lines = [line for *_, line in graph.edges(node, data="polyline")]
        lines_on_patch = [part for line in lines for part in _line_on_patch(line, white_tree, patch_verts, edge_mm)]
        paint_lines(rgb, fine_xyz, lines_on_patch, CREST_WIDTH, colour)
    corners = PATCH_RADIUS_IN_WIDTHS * np.array([[-1.0, -1, -1], [1, 1, 1]])  # they centre the picture on the hinge
    return Row("", Surface(np.concatenate([fine_xyz, corners]), faces[:, ::mirror]), rgb=np.concatenate([rgb, rgb[:2]]))


def _line_on_patch(line: Array, white_tree: cKDTree, patch_verts: Array, edge_mm: float) -> Iterator[Array]:
    """The parts of a line (P, 3) within ``edge_mm`` of the white vertices of a patch, moved to ``patch_verts``.

    A line from vertex to vertex zigzags, so each part is smoothed; its ends stay.
    """
    distances, nearest_vertex = white_tree.query(line, distance_upper_bound=edge_mm)
    inside_points = np.flatnonzero(np.isfinite(distances))
    for point_run in np.split(inside_points, np.flatnonzero(np.diff(inside_points) > 1) + 1):
        if len(point_run) > 1:
            smoothed_part = patch_verts[nearest_vertex[point_run]]
            for _ in range(4):
                smoothed_part[1:-1] = (smoothed_part[:-2] + 2 * smoothed_part[1:-1] + smoothed_part[2:]) / 4
            yield smoothed_part


def pair_of(match: Match, measures: Mapping[str, Measures]) -> PatchPair:
    """The patches of a match; the second is in the pose most similar to the first."""
    first_patch = hinge_patch(measures[match.surface], match.hinge)
    return first_patch, hinge_patch(measures[match.other_surface], match.other, match.pose)


def clear_examples(matches: Sequence[Match], measures: Mapping[str, Measures]) -> dict[Match, PatchPair]:
    """The best matches with crests visible in a picture, on surfaces with a graph, with their patches."""
    pairs: dict[Match, PatchPair] = {}

    def is_clear(match: Match) -> bool:
        if None in (measures[match.surface].graph, measures[match.other_surface].graph):
            return False
        pairs[match] = pair_of(match, measures)
        return all(in_sight(patch) > LEAST_VISIBLE_SHARE for patch in pairs[match])

    return {match: pairs[match] for match in examples(matches, accept=is_clear)}


def in_sight(patch: Row) -> float:
    """Visible share of a hinge's own crests in the picture of its patch."""
    faces = patch.surface.faces
    visible_face = visible(patch.surface.verts, faces, (PANEL_PX, PANEL_PX), PX_PER_WIDTH, oversample=1)[0]
    assert patch.rgb is not None
    crest_vertices = np.flatnonzero((patch.rgb == rgb_of(OWN_CREST_COLOUR)).all(axis=1))
    return float(np.isin(crest_vertices, faces[visible_face[visible_face >= 0]]).mean()) if crest_vertices.size else 0.0


def hinge_pairs(pairs: Mapping[Match, PatchPair], group_names: tuple[str, str]) -> Picture:
    """Pairs of hinges in columns, the first group above the second; ``group_names`` are those of both."""
    left, top, row_height = 3 * CAPTION_PX // 2, 16, PANEL_PX + CAPTION_PX
    panel_size, group_style = (PANEL_PX, PANEL_PX), {"rotation": 90, "weight": "bold"}
    with new_sheet(left + PANEL_PX * len(pairs), top + 2 * row_height + 12) as sheet:
        for row_index, group_name in enumerate(group_names):
            y = top + row_index * row_height
            sheet.text(CAPTION_PX, y + PANEL_PX / 2, group_name, 20, PANEL_PX, ha="center", va="center", **group_style)
            for k, (match, patch_pair) in enumerate(pairs.items()):
                x = left + k * PANEL_PX
                sheet.picture(draw(patch_pair[row_index], "top", panel_size, PX_PER_WIDTH), x, y)
                surface_name, number = ((match.surface, match.hinge), (match.other_surface, match.other))[row_index]
                label = surface_name.removeprefix(group_name).strip()  # its group is said at the row
                caption = f"{label}, " * bool(label) + f"{number}" + ", mirrored" * (row_index * match.pose >= 3)
                sheet.text(x + PANEL_PX / 2, y + PANEL_PX + 22, caption, 18, PANEL_PX - 20, ha="center", color=GREY)
        return sheet.pixels()
