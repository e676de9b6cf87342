"""The gyral net painted on its surface: crests, and hinges by number of arms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.analysis import Measures, vertex_normals
from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.graph.net import resampled
from morphofold.errors import MissingPart
from morphofold.quantities import Quantity
from morphofold.report import colours
from morphofold.report.colours import rgb_of
from morphofold.report.pictures.sheet import Picture
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.surface import Verts

CREST_COLOUR = "#333333"
HINGE_RADIUS_IN_WIDTHS = 0.27  # radius of a hinge, in crown widths
#: colours of hinges by number of arms; five or more have one colour
COLOUR_BY_ARMS = {3: "#d55e00", 4: "#0072b2", 5: "#009e73"}
DOUBTFUL_COLOUR = "#8c8c8c"  # hinges that are not counted, with any number of arms
NET_LEGEND = (
    ("crest", CREST_COLOUR),
    ("hinge, 3 arms", COLOUR_BY_ARMS[3]),
    ("4 arms", COLOUR_BY_ARMS[4]),
    ("5 or more", COLOUR_BY_ARMS[5]),
    ("doubtful", DOUBTFUL_COLOUR),
)


def net_row(measures: Measures, name: str) -> Row:
    """The white surface of measures with their net, sulci darker; needs a graph.

    Raises ``MissingPart`` without one.
    """
    cortex, graph = measures.cortex, measures.graph
    if graph is None:
        raise MissingPart(f"{name}: has no gyral graph, because the analysis is older. Measure the cortex again.")
    verts = cortex.white.verts
    rgb = shaded(measures)
    normals, width = vertex_normals(verts, cortex.faces), graph.graph["scales"].width if graph.graph["scales"] else 0.0
    paint_lines(
        rgb, verts, [crest["polyline"] for _, _, crest in graph.edges(data=True)], graph.graph["edge"], CREST_COLOUR
    )
    tree, radius = (
        cKDTree(verts),
        max(HINGE_RADIUS_IN_WIDTHS * width, graph.graph["edge"]),
    )  # a dot has at least one vertex
    for _, node in graph.nodes(data=True):
        if node["degree"] > 2:
            near = np.array(tree.query_ball_point(node["position"], radius), dtype=np.int64)
            colour = COLOUR_BY_ARMS[min(node["degree"], 5)] if counts(node) else DOUBTFUL_COLOUR
            rgb[near[normals[near] @ node["normal"] > 0]] = rgb_of(colour)
    return Row(name, cortex.white, hemi=cortex.hemi, rgb=rgb)


def shaded(measures: Measures) -> colours.RGB:
    """Colours (N, 3) of the bare surface, darker with sulcal depth where that was measured."""
    depth = measures.maps.get("sulcal_depth", np.zeros(measures.cortex.n_vertices))
    deep = float(np.nanquantile(depth, 0.95))
    share = np.clip(np.nan_to_num(depth / deep), 0, 1) if deep > 0 else np.zeros(len(depth))
    return np.round(np.array(colours.BARE_SURFACE_COLOUR) * (1 - 0.35 * share)[:, None]).astype(np.uint8)


def paint_lines(rgb: colours.RGB, verts: Verts, lines: Sequence[NDArray[np.float64]], edge: float, colour: str) -> None:
    """Colour the vertices within about half an ``edge`` [mm] of lines (P, 3)."""
    if lines:
        points, reach = np.concatenate([resampled(line, 0.3 * edge) for line in lines]), 0.55 * edge
        rgb[cKDTree(points).query(verts, distance_upper_bound=reach)[0] < reach] = rgb_of(colour)


def net_figure(rows: Sequence[Row]) -> Picture:
    """Picture of rows of nets, in all views."""
    return figure(rows, Quantity("net", "Gyral net"), None, legend=NET_LEGEND)
