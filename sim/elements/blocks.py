"""Elements in blocks of ``LANES`` lanes, and the sum of their forces at the nodes.

A block reads the positions of its own nodes once. It sums the forces of its elements per node before it writes them:
one row per block and node. Each node then sums its few rows in a fixed order, so the result is bitwise the same for any
number of threads. Neighbouring elements should have close numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphofold.arrays import Array, Ints
from morphofold.sim.elements.brick_kernels import LANES, gather, gather_scalar


def to_lanes(values: NDArray, n_blocks: int) -> NDArray:
    """Reorder (E, rows) per element to (block, rows * LANES), lane fastest; the last lanes repeat the last element."""
    padded = np.concatenate([values, np.repeat(values[-1:], n_blocks * LANES - len(values), axis=0)])
    return np.ascontiguousarray(padded.reshape(n_blocks, LANES, -1).transpose(0, 2, 1).reshape(n_blocks, -1))


def from_lanes(values: NDArray, n_elements: int) -> NDArray:
    """Reorder (block, rows * LANES) back to (E, rows)."""
    n_blocks = len(values)
    return values.reshape(n_blocks, -1, LANES).transpose(0, 2, 1).reshape(n_blocks * LANES, -1)[:n_elements]


class Blocks:
    """Nodes that each block reads, and rows that it writes.

    Parameters
    ----------
    corners : (E, K) int
        Node numbers of each element.
    n_nodes : int

    Attributes
    ----------
    count : int
        Number of blocks; the last block repeats its last element.
    nodes, start : (R,) uint32, (count + 1,) int
        Block b owns rows ``start[b]:start[b + 1]``; row s belongs to node ``nodes[s]``.
    local : (count, K * LANES) uint16
        Row of each corner within its block.
    first, rows : (N + 1,) int, (R,) uint32
        Node n owns the rows ``rows[first[n]:first[n + 1]]``.
    force : (R, 3) float64
        Forces of the rows, filled by a kernel.
    """

    def __init__(self, corners: Ints, n_nodes: int):
        self.count = -(-len(corners) // LANES)
        lanes = to_lanes(corners.astype(np.int32), self.count)
        order = np.argsort(lanes, axis=1, kind="stable")
        ranked = np.take_along_axis(lanes, order, axis=1)
        new = np.ones(ranked.shape, dtype=bool)
        new[:, 1:] = ranked[:, 1:] != ranked[:, :-1]
        self.local = np.empty(lanes.shape, dtype=np.uint16)
        np.put_along_axis(self.local, order, (np.cumsum(new, axis=1) - 1).astype(np.uint16), axis=1)
        self.nodes: NDArray[np.uint32] = ranked[new].astype(np.uint32)
        self.start = np.concatenate([[0], np.cumsum(new.sum(axis=1))])
        self.rows = np.argsort(self.nodes, kind="stable").astype(np.uint32)
        self.first = np.concatenate([[0], np.cumsum(np.bincount(self.nodes, minlength=n_nodes))])
        self.force = np.zeros((len(self.nodes), 3))

    def nodal_forces(self) -> Array:
        """Nodal sums (N, 3) of ``force``."""
        out = np.empty((len(self.first) - 1, 3))
        gather(self.force, self.first, self.rows, out)
        return out

    def nodal_sums(self, values: Array) -> Array:
        """Nodal sums (N,) of one value per row (R,)."""
        out = np.empty(len(self.first) - 1)
        gather_scalar(values, self.first, self.rows, out)
        return out
