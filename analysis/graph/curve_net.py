"""A net of curves on a surface: borders between basins, merging of close junctions, removal of short spurs."""

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np
from scipy import sparse

from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.geometry import arc_length, edges_of_faces, norms, symmetric
from morphofold.surface import Faces, PerVertex, Verts

OFF_MIDPOINT = 1e-3  # of an edge: how far from its midpoint a border between basins crosses it


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
        ends: dict[int, list[int]] = {node: [] for node in self.nodes}
        for name, arc in self.arcs.items():
            ends[arc.a].append(name)
            ends[arc.b].append(name)
        return ends

    def degrees(self) -> dict[int, int]:
        return {node: len(arcs) for node, arcs in self.ends().items()}

    def drop(self, *names: int) -> None:
        """Remove arcs, and the end nodes that are then not needed."""
        removed_arcs = [self.arcs.pop(name) for name in names]
        for node in sorted({end for arc in removed_arcs for end in (arc.a, arc.b)}):
            self._tidy(node)

    def _tidy(self, node: int) -> None:
        """Remove a node without arcs; join the two arcs of a node that has only two."""
        arcs = [name for name, arc in self.arcs.items() for end in (arc.a, arc.b) if end == node]
        if not arcs:
            del self.nodes[node]
        elif len(arcs) == 2 and arcs[0] != arcs[1]:
            into, out = self.arcs.pop(arcs[0]), self.arcs.pop(arcs[1])
            into, out = into if into.b == node else into.reversed(), out if out.a == node else out.reversed()
            del self.nodes[node]
            self.add_arc(Arc(into.a, out.b, np.concatenate([into.points, out.points[1:]]), into.blind and out.blind))

    def split(self, arc: int, k: int) -> int:
        """Insert a node at point k of an arc; returns the number of the node."""
        old_arc = self.arcs.pop(arc)
        node = self.add_node(Node(old_arc.points[k]))
        self.add_arc(Arc(old_arc.a, node, old_arc.points[: k + 1], old_arc.blind))
        self.add_arc(Arc(node, old_arc.b, old_arc.points[k:], old_arc.blind))
        return node

    def merge(self, distance: float, loop: float) -> None:
        """Contract arcs shorter than ``distance`` between two junctions, the shortest first; drop loops shorter than
        ``loop`` [mm]. A merged junction lies at the mean of all junctions that it was merged from."""
        while True:
            degree = self.degrees()
            loops = [n for n, arc in self.arcs.items() if arc.a == arc.b and arc.length < loop and degree[arc.a] > 2]
            if loops:
                self.drop(min(loops, key=lambda name: self.arcs[name].length))
                continue
            short_arcs = [
                (arc.length, name)
                for name, arc in self.arcs.items()
                if arc.a != arc.b and arc.length < distance and degree[arc.a] > 2 and degree[arc.b] > 2
            ]
            if not short_arcs:
                return
            self._contract(min(short_arcs)[1])

    def _contract(self, name: int) -> None:
        arc = self.arcs.pop(name)
        node, removed = self.nodes[arc.a], self.nodes.pop(arc.b)
        n_merged = node.merged + removed.merged
        node.at = (node.merged * node.at + removed.merged * removed.at) / n_merged
        node.merged, node.basins = n_merged, node.basins | removed.basins
        for other in self.arcs.values():
            other.a, other.b = (arc.a if end == arc.b else end for end in (other.a, other.b))
            if arc.a in (other.a, other.b):
                other.points = moved(other.points, self.nodes[other.a].at, self.nodes[other.b].at)

    def prune(self, length: float) -> None:
        """Drop arcs shorter than ``length`` [mm] with a free end, the shortest first; arcs that end at a cut stay."""
        while True:
            degrees = self.degrees()
            free_arcs = [
                (arc.length, name)
                for name, arc in self.arcs.items()
                if arc.length < length and any(degrees[end] == 1 and not self.nodes[end].cut for end in (arc.a, arc.b))
            ]
            if not free_arcs:
                return
            self.drop(min(free_arcs)[1])

    def tidy_up(self, merge: float, prune: float, loop: float) -> None:
        """Merge and prune in turn until nothing changes."""
        n_arcs_before = -1
        while len(self.arcs) != n_arcs_before:
            n_arcs_before = len(self.arcs)
            self.merge(merge, loop)
            self.prune(prune)

    def keep(self, good: Callable[[Array], Bools]) -> None:
        """Remove the parts of arcs where ``good`` of the points (P, 3) is False; the new ends are marked as cut."""
        for name in list(self.arcs):
            arc = self.arcs[name]
            is_good = good(arc.points)
            if is_good.all():
                continue
            del self.arcs[name]
            for start, stop in _stretches_of_true(is_good):
                if stop - start < 2:
                    continue
                a = arc.a if start == 0 else self.add_node(Node(arc.points[start], cut=True))
                b = arc.b if stop == len(is_good) else self.add_node(Node(arc.points[stop - 1], cut=True))
                self.add_arc(Arc(a, b, arc.points[start:stop], arc.blind))
        for node in list(self.nodes):
            if node in self.nodes:
                self._tidy(node)


def _stretches_of_true(flags: Bools) -> Iterator[tuple[int, int]]:
    """Start and stop of each stretch of True."""
    changes = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return zip(changes[0::2].tolist(), changes[1::2].tolist(), strict=True)


def moved(points: Array, start: Array, stop: Array) -> Array:
    """A curve with its ends moved; the points between move by a share that is linear along the curve."""
    lengths = arc_length(points)
    fraction = (lengths / lengths[-1] if lengths[-1] > 0 else np.linspace(0, 1, len(lengths)))[:, None]
    return points + (1 - fraction) * (start - points[0]) + fraction * (stop - points[-1])


def resampled(points: Array, step: float) -> Array:
    """A curve with points at equal distances of at most ``step`` [mm]; its ends stay."""
    length = arc_length(points)[-1]
    return at_arc_lengths(points, np.linspace(0, length, max(int(np.ceil(length / step)), 2) + 1))


def at_arc_lengths(points: Array, places: Array) -> Array:
    """The points (Q, 3) of a curve at the arc lengths ``places`` (Q,) [mm]."""
    lengths = arc_length(points)
    return np.stack([np.interp(places, lengths, points[:, k]) for k in range(3)], axis=1)


def smoothed(points: Array, deviation: float) -> Array:
    """A curve resampled and smoothed along itself by a Gaussian [mm]; the ends stay."""
    points = resampled(points, 0.5 * deviation)
    n_reach = min(6, len(points) - 1)  # three deviations of two steps each
    points_before, points_after = 2 * points[0] - points[n_reach:0:-1], 2 * points[-1] - points[-2 : -n_reach - 2 : -1]
    step = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    weights = np.exp(-0.5 * (np.arange(-n_reach, n_reach + 1) * step / deviation) ** 2)
    padded = np.concatenate([points_before, points, points_after])
    return np.stack([np.convolve(padded[:, k], weights / weights.sum(), "valid") for k in range(3)], axis=1)


def borders(verts: Verts, faces: Faces, pairs: Ints, basin: Ints, finest: Ints, height: PerVertex) -> Net:
    """The net of the borders between basins. It is connected by construction; junctions are where three basins meet.

    Parameters
    ----------
    verts, faces, pairs : (N, 3), (M, 3), (E, 2)
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
    end_basins = basin[pairs]
    crossed = np.flatnonzero(end_basins[:, 0] != end_basins[:, 1])
    crossing_of = np.full(len(pairs), -1)
    crossing_of[crossed] = np.arange(len(crossed))
    side = crossing_of[edges_of_faces(faces)]  # (M, 3)
    n_crossings = (side >= 0).sum(axis=1)
    two, three = np.flatnonzero(n_crossings == 2), np.flatnonzero(n_crossings == 3)
    junction = len(crossed) + np.arange(len(three))
    edge_ends = pairs[crossed]
    fraction = 0.5 + OFF_MIDPOINT * np.sign(height[edge_ends[:, 1]] - height[edge_ends[:, 0]])
    midpoints = verts[edge_ends[:, 0]] + fraction[:, None] * (verts[edge_ends[:, 1]] - verts[edge_ends[:, 0]])
    points = np.concatenate([midpoints, verts[faces[three]].mean(axis=1)])
    links = np.concatenate(
        [side[two][side[two] >= 0].reshape(-1, 2), np.column_stack([np.repeat(junction, 3), side[three].ravel()])]
    )
    graph = symmetric(len(points), links, np.ones(len(links), dtype=np.int8))
    net, node_of = Net(), {}
    for path in paths(graph, junction, np.argsort(-height[edge_ends].sum(axis=1), kind="stable")):
        for end in (path[0], path[-1]):
            if end not in node_of:
                inside = end >= len(crossed)
                three_basins = frozenset(finest[faces[three[end - len(crossed)]]].tolist()) if inside else frozenset()
                at_border = not inside and graph.indptr[end + 1] - graph.indptr[end] == 1
                node_of[end] = net.add_node(Node(points[end], three_basins, cut=at_border))
        net.add_arc(Arc(node_of[path[0]], node_of[path[-1]], points[path]))
    return net


def paths(graph: sparse.csr_array, junction: Ints, first_of_rings: Ints) -> Iterator[list[int]]:
    """Chains between junctions or borders of the surface, and rings, each once; a ring begins at the first of its
    points in the given order.

    A point with more than two neighbours, on an edge with more than two triangles, is also a junction.
    """
    row_starts, neighbours = graph.indptr.tolist(), graph.indices.tolist()
    junction = np.union1d(junction, np.flatnonzero(np.diff(graph.indptr) > 2))
    end_points, seen_points = set(junction.tolist()), set()
    free_ends = np.flatnonzero(np.diff(graph.indptr) == 1).tolist()
    end_points.update(free_ends)

    def walk(start: int, following: int) -> list[int]:
        path = [start, following]
        while path[-1] not in end_points and path[-1] != start:
            point = path[-1]
            path.append(next(k for k in neighbours[row_starts[point] : row_starts[point + 1]] if k != path[-2]))
        return path

    for start in [*junction.tolist(), *free_ends]:
        for k in neighbours[row_starts[start] : row_starts[start + 1]]:
            if k in seen_points or (k in end_points and k < start):
                continue
            path = walk(start, k)
            seen_points.update(path[1:-1])
            yield path
    for start in first_of_rings.tolist():
        if start not in end_points and start not in seen_points and row_starts[start] < row_starts[start + 1]:
            path = walk(start, neighbours[row_starts[start]])
            seen_points.update(path)
            yield path
