"""Which nodes the blocks of elements read, and the sum of their forces at the nodes.

A block or column reads the positions of its own nodes once. It sums the forces of its elements per node before it
writes them: one row per block and node. Each node then sums its few rows in a fixed order, so the result is bitwise the
same for any number of threads. Neighbouring elements should have close numbers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.sim.elements.lanes import LANES, gather


class Summary(NamedTuple):
    """Numbers of all elements at a measurement: stored energy, smallest and largest J, mean v/V, and how many have a J
    that is not positive."""

    energy: float
    min_J: float
    max_J: float
    min_volume_ratio: float
    mean_volume_ratio: float
    inverted: int


def summary_of(energy: Array, J_min: Array, J_max: Array, volume_ratio: Array, counted: Bools | bool = True) -> Summary:
    """Summary of values of the same shape; where not ``counted``, energy is 0 and the others are repeated."""
    extremes = float(J_min.min()), float(J_max.max()), float(volume_ratio.min())
    n_inverted = int(np.count_nonzero((J_min <= 0) & counted)) if extremes[0] <= 0 else 0
    return Summary(float(energy.sum()), *extremes, float(volume_ratio.mean(where=counted)), n_inverted)


class Rows:
    """Elements in lanes, and the rows into which a kernel writes what they add to their nodes.

    Parameters
    ----------
    lane_element : (count, LANES) int
        Element in each lane of each block; lanes left over repeat an element.
    nodes : (R,) int
        Node of each row.
    n_nodes : int

    Attributes
    ----------
    count : int
        Number of blocks.
    filler : (count, LANES) bool
        Lanes that repeat an element.
    first, rows : (N + 1,), (R,) uint32
        Node n owns the rows ``rows[first[n]:first[n + 1]]``.
    force : (R, 3) float64
        Forces of the rows, filled by a kernel.
    """

    def __init__(self, lane_element: Ints, nodes: NDArray[np.integer], n_nodes: int):
        self.element, self.count = lane_element, len(lane_element)
        self.nodes: NDArray[np.uint32] = nodes.astype(np.uint32)
        self._place = np.unique(lane_element.ravel(), return_index=True)[1]  # first lane of each element
        self.filler: Bools = np.ones(lane_element.shape, dtype=bool)
        self.filler.ravel()[self._place] = False
        self.rows = np.argsort(self.nodes, kind="stable").astype(np.uint32)
        self.first = np.concatenate([[0], np.cumsum(np.bincount(self.nodes, minlength=n_nodes))]).astype(np.uint32)
        self.force = np.zeros((len(self.nodes), 3))

    def moduli(self, mu: Array, kappa: Array, third_value: Array) -> Array:
        """Three numbers of each element (E,) as (block, 3 LANES); the moduli of lanes left over are 0."""
        moduli = np.column_stack([mu, kappa, third_value])[self.element]
        moduli[self.filler, :2] = 0.0
        return lanes_of(moduli)

    def from_lanes(self, values: NDArray) -> NDArray:
        """Values (block, rows * LANES) as (E, rows), a row's values side by side in memory."""
        block, lane = np.divmod(self._place, LANES)
        first_entry = block * values.shape[1] + lane
        return np.stack([values.ravel().take(first_entry + row) for row in range(0, values.shape[1], LANES)]).T

    def nodal_forces(self) -> Array:
        """Nodal sums (N, 3) of ``force``."""
        return self.nodal_sums(self.force)

    def nodal_sums(self, row_values: Array) -> Array:
        """Nodal sums (N, ...) of the values (R, ...) of the rows."""
        sums = np.empty((len(self.first) - 1, *row_values.shape[1:]))
        gather(row_values.reshape(len(row_values), -1), self.first, self.rows, sums.reshape(len(sums), -1))
        return sums


class Blocks(Rows):
    """Consecutive elements in blocks.

    Parameters
    ----------
    corners : (E, K) int
        Node numbers of each element.
    n_nodes : int

    Attributes
    ----------
    nodes, start : (R,) uint32, (count + 1,) int
        Block b owns rows ``start[b]:start[b + 1]``; row s belongs to node ``nodes[s]``.
    local : (count, K * LANES) uint16
        Row of each corner within its block.
    """

    def __init__(self, corners: Ints, n_nodes: int):
        lane_element = _consecutive(len(corners))
        nodes, self.start, self.local = distinct_nodes(lanes_of(corners[lane_element]))
        super().__init__(lane_element, nodes, n_nodes)


class Columns(Rows):
    """Bricks in columns under a surface of quads: a group of ``LANES`` quads and the bricks below them, layer by layer.

    The bricks of a column share faces, so a kernel that steps down a group reads each level of nodes once, and adds up
    what both neighbours do to a shared face before it writes that.

    Parameters
    ----------
    corners : (E, 8) int
        Nodes of each brick, corner 2 q + k: q is the corner of its quad, k is 1 on the upper face. The upper face of a
        brick has the same corners, in the same order, as the lower face of the brick above it. All columns have equally
        many bricks.
    n_nodes : int

    Attributes
    ----------
    layers : int
        Block ``layers * g + k`` holds the bricks of layer k in group g.
    nodes, start : (R,) uint32, (groups + 1,) int
        Group g owns rows ``start[g]:start[g + 1]``, level by level with equally many rows; row s belongs to node
        ``nodes[s]``.
    local : (groups, 4 * LANES) uint16
        Row, within its level, of each corner of each quad.
    """

    def __init__(self, corners: Ints, n_nodes: int):
        layer_bricks = _bricks_by_layer(corners, n_nodes)
        self.layers = len(layer_bricks)
        lane_quads = _consecutive(layer_bricks.shape[1])
        surface, level_starts, self.local = distinct_nodes(lanes_of(corners[layer_bricks[0], 1::2][lane_quads]))
        level_sizes = np.repeat(np.diff(level_starts), np.diff(level_starts))
        top_rows = np.arange(len(surface)) + self.layers * np.repeat(level_starts[:-1], np.diff(level_starts))
        nodes, below_of = np.empty((self.layers + 1) * len(surface), dtype=np.int64), np.empty(n_nodes, dtype=np.int64)
        level_nodes = nodes[top_rows] = surface
        for level, bricks in enumerate(layer_bricks, 1):
            below_of[corners[bricks, 1::2]] = corners[bricks, ::2]
            level_nodes = nodes[top_rows + level * level_sizes] = below_of[level_nodes]
        self.start = level_starts * (self.layers + 1)
        super().__init__(layer_bricks.T[lane_quads].swapaxes(1, 2).reshape(-1, LANES), nodes, n_nodes)


def _bricks_by_layer(corners: Ints, n_nodes: int) -> Ints:
    """The bricks (layers, columns) below each other, from the surface down; columns in the order of their bricks."""
    nodes = corners.astype(np.int64)  # scikit-fem numbers nodes in 32 bits: their products would overflow
    top_keys, low_keys = (nodes[:, k] * n_nodes + nodes[:, 6 + k] for k in (1, 0))  # a face by two opposite corners
    brick_order = np.argsort(top_keys)
    layers = [np.flatnonzero(~np.isin(top_keys, low_keys))]
    while len(layers) * len(layers[0]) < len(corners):
        layers.append(brick_order[np.searchsorted(top_keys[brick_order], low_keys[layers[-1]])])
    return np.stack(layers)


def lanes_of(values: NDArray) -> NDArray:
    """Values (block, LANES, ...) as (block, rows * LANES), lane fastest."""
    n_blocks = len(values)
    return np.ascontiguousarray(values.reshape(n_blocks, LANES, -1).swapaxes(1, 2).reshape(n_blocks, -1))


def _consecutive(n_elements: int) -> Ints:
    """The numbers below ``n_elements`` as (blocks, LANES); the last is repeated."""
    return np.minimum(np.arange(-(-n_elements // LANES) * LANES), n_elements - 1).reshape(-1, LANES)


def distinct_nodes(nodes: NDArray) -> tuple[NDArray, Ints, NDArray[np.uint16]]:
    """The distinct nodes in each row of ``nodes`` (count, M), one row after the other (R,); where those of each row
    start (count + 1,); and the number of each entry among them (count, M)."""
    node_order = np.argsort(nodes, axis=1, kind="stable")
    sorted_nodes = np.take_along_axis(nodes, node_order, axis=1)
    is_new_node = np.ones(sorted_nodes.shape, dtype=bool)
    is_new_node[:, 1:] = sorted_nodes[:, 1:] != sorted_nodes[:, :-1]
    local_number = np.empty(nodes.shape, dtype=np.uint16)
    np.put_along_axis(local_number, node_order, (np.cumsum(is_new_node, axis=1) - 1).astype(np.uint16), axis=1)
    return sorted_nodes[is_new_node], np.concatenate([[0], np.cumsum(is_new_node.sum(axis=1))]), local_number
