"""The gyral net painted on its surface: crests, and hinges by the number of their arms."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis import Measures, vertex_normals
from morphofold.analysis.net import resampled
from morphofold.io import sample_path
from morphofold.io.files import atomic_file
from morphofold.report import colours
from morphofold.report.colours import rgb_of
from morphofold.report.figures import Picture, Row, figure
from morphofold.report.png import png_bytes
from morphofold.report.quantities import Quantity

CREST = "#333333"
DISC = 0.27             # radius of a hinge, in gyral widths
#: hinges by the number of their arms, five or more being one kind
ARMS = {3: "#d55e00", 4: "#0072b2", 5: "#009e73"}
LEGEND = (("crest", CREST), ("hinge, 3 arms", ARMS[3]), ("4 arms", ARMS[4]), ("5 or more", ARMS[5]))


def net_row(measures: Measures, name: str) -> Row:
    """The white surface of measures with their net, sulci darker; they must have a graph."""
    cortex, graph = measures.cortex, measures.graph
    if graph is None:
        raise ValueError(f"{name}: measures that were read from a folder have no graph. Measure the cortex again.")
    verts, faces = cortex.white.verts, cortex.faces
    depth = measures.maps["sulcal_depth"]
    deep = float(np.nanquantile(depth, 0.95))
    share = np.clip(np.nan_to_num(depth / deep), 0, 1) if deep > 0 else np.zeros(len(verts))
    rgb = np.round(np.array(colours.BARE) * (1 - 0.35 * share)[:, None]).astype(np.uint8)
    normals, width = vertex_normals(verts, faces), graph.graph["scales"].width if graph.graph["scales"] else 0.0
    lines = [crest["polyline"] for _, _, crest in graph.edges(data=True)]
    if lines:
        points = np.concatenate([resampled(line, 0.3 * graph.graph["edge"]) for line in lines])
        rgb[cKDTree(points).query(verts)[0] < 0.55 * graph.graph["edge"]] = rgb_of(CREST)
    tree = cKDTree(verts)
    for _, node in graph.nodes(data=True):
        if node["degree"] > 2:
            near = np.array(tree.query_ball_point(node["position"], DISC * width))
            rgb[near[normals[near] @ node["normal"] > 0]] = rgb_of(ARMS[min(node["degree"], 5)])
    return Row(name, cortex.white, np.full(len(verts), np.nan), cortex.hemi, rgb)


def net_figure(rows: Sequence[Row]) -> Picture:
    """The rows from all sides."""
    return figure(rows, Quantity("net", "Gyral net"), (0.0, 1.0), legend=LEGEND)


def main(words: Sequence[str]) -> int:
    """``python -m morphofold.report.net_picture OUT.png NAME=CORTEX ...``; S1 is the sample."""
    import morphofold as mf

    rows = []
    for word in words[1:]:
        name, _, path = word.rpartition("=")
        cortex = mf.read_cortex(sample_path("S1") if path == "S1" else path, hemi="lh")
        rows.append(net_row(mf.measure(cortex), name))
    with atomic_file(Path(words[0])) as temporary:
        temporary.write_bytes(png_bytes(net_figure(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
