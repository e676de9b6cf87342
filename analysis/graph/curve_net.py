"""A net of curves on a surface: borders between basins, merging of close junctions, removal of short spurs."""

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np
from scipy import sparse

from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import arc_length, edges_of_faces, norms, symmetric
from morphofold.surface import Faces, PerVertex, Verts

MIDPOINT_SHIFT = 1e-3  # of an edge: how far from its midpoint a border between basins crosses it


class Node:
    """A point of the net: position ``at`` (3,) [mm]; ``merged``, the number of nodes that it was merged from; the
    finest ``basins`` that meet there; ``cut``, True where the net was cut at a border or a mask."""

    def __init__(self, at: Array, basins: frozenset[int] = frozenset(), cut: bool = False):
        self.at, self.basins, self.cut, self.merged = at, basins, cut, 1


class Arc:
    """A curve ``points`` (P, 3) [mm] from node ``a`` to ``b``; ``blind``: it leads to the tip of a dead-end gyrus."""

    def __init__(self, a: int, b: int, points: Array, blind: bool = False):
        self.a, self.b, self.blind = a, b, blind
        self.points = points

    @property
    def points(self) -> Array:
        return self._points

    @points.setter
    def points(self, points: Array) -> None:
        self._points = points
        self.length = float(norms(points[1:] - points[:-1]).sum())

    def reversed(self) -> "Arc":
        return Arc(self.b, self.a, self.points[::-1], self.blind)


class Net:
    """Nodes and arcs by number. An arc may be a loop, and two nodes may be joined by several arcs."""

    def __init__(self) -> None:
        self.nodes: dict[int, Node] = {}
        self.arcs: dict[int, Arc] = {}
        self._numbers = count()

    def add_node(self, node: Node) -> int:
        self.nodes[number := next(self._numbers)] = node
        return number

    def add_arc(self, arc: Arc) -> int:
        self.arcs[number := next(self._numbers)] = arc
        return number

    def ends(self) -> dict[int, list[int]]:
        """Arcs of each node; a loop occurs twice."""
        arcs_of_node: dict[int, list[int]] = {node: [] for node in self.nodes}
        for arc_id, arc in self.arcs.items():
            arcs_of_node[arc.a].append(arc_id)
            arcs_of_node[arc.b].append(arc_id)
        return arcs_of_node

    def degrees(self) -> dict[int, int]:
        return {node: len(arc_ids) for node, arc_ids in self.ends().items()}

    def drop(self, *arc_ids: int) -> None:
        """Remove arcs, and the end nodes that are then not needed."""
        removed_arcs = [self.arcs.pop(arc_id) for arc_id in arc_ids]
        for node in sorted({end for arc in removed_arcs for end in (arc.a, arc.b)}):
            self._tidy(node)

    def _tidy(self, node: int) -> None:
        """Remove a node without arcs; join the two arcs of a node that has only two."""
        arc_ids = [arc_id for arc_id, arc in self.arcs.items() for end in (arc.a, arc.b) if end == node]
        if not arc_ids:
            del self.nodes[node]
        elif len(arc_ids) == 2 and arc_ids[0] != arc_ids[1]:
            into, out = self.arcs.pop(arc_ids[0]), self.arcs.pop(arc_ids[1])
            into, out = into if into.b == node else into.reversed(), out if out.a == node else out.reversed()
            del self.nodes[node]
            self.add_arc(Arc(into.a, out.b, np.concatenate([into.points, out.points[1:]]), into.blind and out.blind))

    def split(self, arc_id: int, point_index: int) -> int:
        """Insert a node at point k of an arc; returns the number of the node."""
        old_arc = self.arcs.pop(arc_id)
        node = self.add_node(Node(old_arc.points[point_index]))
        self.add_arc(Arc(old_arc.a, node, old_arc.points[: point_index + 1], old_arc.blind))
        self.add_arc(Arc(node, old_arc.b, old_arc.points[point_index:], old_arc.blind))
        return node

    def merge(self, merge_length: float, loop_mm: float) -> None:
        """Contract arcs shorter than ``merge_length`` between two junctions, the shortest first; drop loops shorter
        than ``loop_mm``. A merged junction lies at the mean of all junctions that it was merged from."""
        while True:
            degree = self.degrees()
            loops = [n for n, arc in self.arcs.items() if arc.a == arc.b and arc.length < loop_mm and degree[arc.a] > 2]
            if loops:
                self.drop(min(loops, key=lambda arc_id: self.arcs[arc_id].length))
                continue
            short_arcs = [
                (arc.length, arc_id)
                for arc_id, arc in self.arcs.items()
                if arc.a != arc.b and arc.length < merge_length and degree[arc.a] > 2 and degree[arc.b] > 2
            ]
            if not short_arcs:
                return
            self._contract(min(short_arcs)[1])

    def _contract(self, arc_id: int) -> None:
        arc = self.arcs.pop(arc_id)
        kept_node, removed_node = self.nodes[arc.a], self.nodes.pop(arc.b)
        n_merged = kept_node.merged + removed_node.merged
        kept_node.at = (kept_node.merged * kept_node.at + removed_node.merged * removed_node.at) / n_merged
        kept_node.merged, kept_node.basins = n_merged, kept_node.basins | removed_node.basins
        for other_arc in self.arcs.values():
            other_arc.a, other_arc.b = (arc.a if end == arc.b else end for end in (other_arc.a, other_arc.b))
            if arc.a in (other_arc.a, other_arc.b):
                other_arc.points = moved(other_arc.points, self.nodes[other_arc.a].at, self.nodes[other_arc.b].at)

    def prune(self, length: float) -> None:
        """Drop arcs shorter than ``length`` [mm] with a free end, the shortest first; arcs that end at a cut stay."""
        while True:
            degrees = self.degrees()
            free_arcs = [
                (arc.length, arc_id)
                for arc_id, arc in self.arcs.items()
                if arc.length < length and any(degrees[end] == 1 and not self.nodes[end].cut for end in (arc.a, arc.b))
            ]
            if not free_arcs:
                return
            self.drop(min(free_arcs)[1])

    def tidy_up(self, merge_length: float, prune_length: float, loop_length: float) -> None:
        """Merge and prune in turn until nothing changes."""
        n_arcs_before = -1
        while len(self.arcs) != n_arcs_before:
            n_arcs_before = len(self.arcs)
            self.merge(merge_length, loop_length)
            self.prune(prune_length)

    def keep(self, accept: Callable[[Array], Bools]) -> None:
        """Remove the parts of arcs where ``accept`` of the points (P, 3) is False; the new ends are marked as cut."""
        for arc_id in list(self.arcs):
            arc = self.arcs[arc_id]
            is_accepted = accept(arc.points)
            if is_accepted.all():
                continue
            del self.arcs[arc_id]
            for start, stop in _stretches_of_true(is_accepted):
                if stop - start < 2:
                    continue
                a = arc.a if start == 0 else self.add_node(Node(arc.points[start], cut=True))
                b = arc.b if stop == len(is_accepted) else self.add_node(Node(arc.points[stop - 1], cut=True))
                self.add_arc(Arc(a, b, arc.points[start:stop], arc.blind))
        for node in list(self.nodes):
            if node in self.nodes:
                self._tidy(node)


def _stretches_of_true(flags: Bools) -> Iterator[tuple[int, int]]:
    """Start and stop of each stretch of True."""
    changes = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return zip(changes[0::2].tolist(), changes[1::2].tolist(), strict=True)


def moved(points: Array, new_start: Array, new_end: Array) -> Array:
    """A curve with its ends moved; the points between move by a share that is linear along the curve."""
    arc_lengths = arc_length(points)
    fraction = (arc_lengths / arc_lengths[-1] if arc_lengths[-1] > 0 else np.linspace(0, 1, len(arc_lengths)))[:, None]
    return points + (1 - fraction) * (new_start - points[0]) + fraction * (new_end - points[-1])


def resampled(points: Array, step: float) -> Array:
    """A curve with points at equal distances of at most ``step`` [mm]; its ends stay."""
    length = arc_length(points)[-1]
    return at_arc_lengths(points, np.linspace(0, length, max(int(np.ceil(length / step)), 2) + 1))


def at_arc_lengths(points: Array, new_lengths: Array) -> Array:
    """The points (Q, 3) of a curve at the arc lengths ``new_lengths`` (Q,) [mm]."""
    arc_lengths = arc_length(points)
    return np.stack([np.interp(new_lengths, arc_lengths, points[:, k]) for k in range(3)], axis=1)


def smoothed(points: Array, deviation: float) -> Array:
    """A curve resampled and smoothed along itself by a Gaussian [mm]; the ends stay."""
    points = resampled(points, 0.5 * deviation)
    n_reach = min(6, len(points) - 1)  # three deviations of two steps each
    points_before, points_after = 2 * points[0] - points[n_reach:0:-1], 2 * points[-1] - points[-2 : -n_reach - 2 : -1]
    mean_step = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    weights = np.exp(-0.5 * (np.arange(-n_reach, n_reach + 1) * mean_step / deviation) ** 2)
    padded = np.concatenate([points_before, points, points_after])
    return np.stack([np.convolve(padded[:, k], weights / weights.sum(), "valid") for k in range(3)], axis=1)


def borders(verts: Verts, faces: Faces, edges: Ints, basin: Ints, finest: Ints, height: PerVertex) -> Net:
    """The net of the borders between basins. It is connected by construction; junctions are where three basins meet.

    Parameters
    ----------
    verts, faces, edges : (N, 3), (M, 3), (E, 2)
        Surface and its edges in ascending order.
    basin, finest : (N,) int64
        Basin of each vertex, and its finest basin, which junctions record.
    height : (N,) float64
        What the basins are of. It decides where points would be equal up to rounding.

    Returns
    -------
    Net
        A curve runs through the midpoints of edges whose ends are in different basins, a thousandth of the edge nearer
        to the higher end, so that one vertex is the nearest. A junction lies in a triangle with three basins. A border
        without a junction is a loop from its highest point. Curves end at the border of the surface.
    """
    end_basins = basin[edges]
    crossed = np.flatnonzero(end_basins[:, 0] != end_basins[:, 1])
    crossing_of = np.full(len(edges), -1)
    crossing_of[crossed] = np.arange(len(crossed))
    sides = crossing_of[edges_of_faces(faces)]  # (M, 3)
    n_crossings = (sides >= 0).sum(axis=1)
    two, three = np.flatnonzero(n_crossings == 2), np.flatnonzero(n_crossings == 3)
    junctions = len(crossed) + np.arange(len(three))
    edge_ends = edges[crossed]
    fraction = 0.5 + MIDPOINT_SHIFT * np.sign(height[edge_ends[:, 1]] - height[edge_ends[:, 0]])
    midpoints = verts[edge_ends[:, 0]] + fraction[:, None] * (verts[edge_ends[:, 1]] - verts[edge_ends[:, 0]])
    points = np.concatenate([midpoints, verts[faces[three]].mean(axis=1)])
    point_pairs = np.concatenate(
        [sides[two][sides[two] >= 0].reshape(-1, 2), np.column_stack([np.repeat(junctions, 3), sides[three].ravel()])]
    )
    graph = symmetric(len(points), point_pairs, np.ones(len(point_pairs), dtype=np.int8))
    net, node_of_point = Net(), {}
    for path in paths(graph, junctions, np.argsort(-height[edge_ends].sum(axis=1), kind="stable")):
        for point in (path[0], path[-1]):
            if point not in node_of_point:
                is_junction = point >= len(crossed)
                basins = frozenset(finest[faces[three[point - len(crossed)]]].tolist()) if is_junction else frozenset()
                is_at_border = not is_junction and graph.indptr[point + 1] - graph.indptr[point] == 1
                node_of_point[point] = net.add_node(Node(points[point], basins, cut=is_at_border))
        net.add_arc(Arc(node_of_point[path[0]], node_of_point[path[-1]], points[path]))
    return net


def paths(graph: sparse.csr_array, junctions: Ints, ring_starts: Ints) -> Iterator[list[int]]:
    """Chains between junctions or borders of the surface, and rings, each once; a ring begins at the first of its
    points in the given order.

    A point with more than two neighbours, on an edge with more than two triangles, is also a junction.
    """
    row_starts, neighbours = graph.indptr.tolist(), graph.indices.tolist()
    junctions = np.union1d(junctions, np.flatnonzero(np.diff(graph.indptr) > 2))
    end_points, seen_points = set(junctions.tolist()), set()
    free_ends = np.flatnonzero(np.diff(graph.indptr) == 1).tolist()
    end_points.update(free_ends)

    def walk(start: int, second: int) -> list[int]:
        path = [start, second]
        while path[-1] not in end_points and path[-1] != start:
            point = path[-1]
            path.append(next(k for k in neighbours[row_starts[point] : row_starts[point + 1]] if k != path[-2]))
        return path

    for start in [*junctions.tolist(), *free_ends]:
        for k in neighbours[row_starts[start] : row_starts[start + 1]]:
            if k in seen_points or (k in end_points and k < start):
                continue
            path = walk(start, k)
            seen_points.update(path[1:-1])
            yield path
    for start in ring_starts.tolist():
        if start not in end_points and start not in seen_points and row_starts[start] < row_starts[start + 1]:
            path = walk(start, neighbours[row_starts[start]])
            seen_points.update(path)
            yield path
