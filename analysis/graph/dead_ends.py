"""Dead-end gyri: ridges that end inside one basin, so no border of basins runs along them."""

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from morphofold.analysis.geodesics import cheapest_path, shorten
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.graph.net import Arc, Net, Node, resampled
from morphofold.arrays import Array, Bools
from morphofold.geometry import arc_length
from morphofold.surface import PerVertex

LOWEST_CROWN_QUANTILE = 0.1  # quantile of the depth potential along the net, below which there is no crown
# cost of a path exp(-4 c) + 0.03 per mm, c the distance to the flank in half widths
COST_DECAY, LEAST_COST_PER_MM = 4.0, 0.03
MOST_HALF_WIDTHS_FROM_FLANK = 1.3  # half widths from the flank, beyond which the cost stays the same
END_TRIM_IN_WIDTHS = 0.5  # widths between the end of a crest and the flank of its gyrus


def add_dead_ends(
    net: Net, operators: SurfaceOperators, graph: sparse.csr_array, D: PerVertex, crown: Bools, width: float, tip: float
) -> None:
    """Add crests to the tips of crowns that reach farther than ``tip`` [mm] from the net, the farthest first.

    ``crown`` (N,): candidate vertices. They count as crown if their depth potential D (N,) is also above the lowest
    tenth of the net. The path back to the net follows the middle of the crown (Sato and others 2000, the skeletons
    called TEASAR).
    """
    if not net.arcs:
        return
    tree = cKDTree(operators.verts)
    along = np.concatenate([resampled(arc.points, operators.edge) for arc in net.arcs.values()])
    on_net = np.zeros(len(D), dtype=bool)
    on_net[tree.query(along)[1]] = True
    crown = crown & (D > np.quantile(D[on_net], LOWEST_CROWN_QUANTILE))
    flank = np.where(crown, np.inf, 0.0)
    border = np.unique(operators.pairs[crown[operators.pairs[:, 0]] != crown[operators.pairs[:, 1]]])
    shorten(graph, flank, border[crown[border]], crown)
    cost = LEAST_COST_PER_MM + np.exp(-COST_DECAY * np.minimum(flank / (0.5 * width), MOST_HALF_WIDTHS_FROM_FLANK))
    way = np.full(len(D), np.inf)
    shorten(graph, way, np.flatnonzero(on_net & crown), crown)
    while True:
        reached = np.where(np.isfinite(way), way, 0.0)
        far = int(reached.argmax())
        if reached[far] <= tip:
            return
        path = cheapest_path(graph, cost, far, on_net, crown)
        shorten(graph, way, path, crown)
        line = _curve_without_start(operators.verts[path], END_TRIM_IN_WIDTHS * width)
        on_net[path] = True
        if line is not None:
            end = net.add_node(Node(line[0]))
            root = _node_at_point(net, line[-1])
            net.add_arc(Arc(end, root, np.concatenate([line, net.nodes[root].at[None]]), blind=True))


def _curve_without_start(line: Array, length: float) -> Array | None:
    """A curve without its first ``length`` [mm]; None if nothing is left."""
    kept = line[arc_length(line) >= length]
    return kept if len(kept) > 1 else None


def _node_at_point(net: Net, at: Array) -> int:
    """The node of the net at a point, or a new node on the nearest curve."""
    nearest = min(((float(np.linalg.norm(arc.points - at, axis=1).min()), name) for name, arc in net.arcs.items()))[1]
    arc = net.arcs[nearest]
    k = int(np.linalg.norm(arc.points - at, axis=1).argmin())
    if k == 0 or k == len(arc.points) - 1:
        return arc.a if k == 0 else arc.b
    return net.split(nearest, k)
