"""Rotations of a sphere, and the vertex below each turned point: the null hypothesis for maps that are smooth."""

import math

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morphofold.arrays import Array, Ints
from morphofold.kernels import kernel

CELLS_PER_VERTEX = 8
ROUND_OFF = 1e-12


def rotations(count: int, seed: int = 0) -> Array:
    """Rotations (count, 3, 3), uniformly distributed: unit quaternions of normal deviates."""
    return Rotation.from_quat(np.random.default_rng(seed).standard_normal((count, 4))).as_matrix()


def p_value(value: float, null: Array) -> float:
    """(1 + values (T,) under rotations at least as large) / (1 + T); 1 for a number that is NaN."""
    return float((1 + np.count_nonzero(null >= value - ROUND_OFF)) / (1 + len(null))) if np.isfinite(value) else 1.0


class NearestTable:
    """The vertex near a point of the unit sphere, from a table: for many rotations, faster than a search.

    The sphere is divided into cells, ``CELLS_PER_VERTEX`` for each vertex, by squares on the sides of a cube. A point
    gets the vertex nearest to the middle of its cell, so it is off by less than the diagonal of a cell.

    Parameters
    ----------
    points : (N, 3) float64
        Vertices on the unit sphere.
    """

    def __init__(self, points: Array):
        self.n = int(np.ceil(np.sqrt(CELLS_PER_VERTEX * len(points) / 6)))
        at = np.tan(np.pi / 4 * ((np.arange(self.n) + 0.5) / self.n * 2 - 1))
        v, u = np.meshgrid(at, at, indexing="ij")
        middles = np.empty((6, self.n, self.n, 3))
        for side in range(6):
            axis, sign = side // 2, 1.0 - 2 * (side % 2)
            middles[side, ..., axis] = sign
            middles[side, ..., (axis + 1) % 3], middles[side, ..., (axis + 2) % 3] = u, v
        middles /= np.linalg.norm(middles, axis=-1, keepdims=True)
        self.vertex = cKDTree(points).query(middles.reshape(-1, 3))[1].astype(np.int64)

    def __call__(self, points: Array) -> Ints:
        """Vertices (P,) near points (P, 3) of the unit sphere."""
        row, axis = np.arange(len(points)), np.abs(points).argmax(axis=1)
        most = points[row, axis]
        u, v = (points[row, (axis + k) % 3] / np.abs(most) for k in (1, 2))
        i, j = (
            np.minimum(((np.arctan(x) * (4 / np.pi) + 1) * (self.n / 2)).astype(np.int64), self.n - 1) for x in (u, v)
        )
        return self.vertex[((2 * axis + (most < 0)) * self.n + j) * self.n + i]


@kernel
def cell_of(p0, p1, p2, n):
    """Number of the cell of ``NearestTable`` in which a point of the unit sphere lies."""
    a0, a1, a2 = abs(p0), abs(p1), abs(p2)
    if a0 >= a1 and a0 >= a2:
        axis, most, u, v = 0, p0, p1, p2
    elif a1 >= a2:
        axis, most, u, v = 1, p1, p2, p0
    else:
        axis, most, u, v = 2, p2, p0, p1
    i = min(int((math.atan(u / abs(most)) * (4 / np.pi) + 1) * (n / 2)), n - 1)
    j = min(int((math.atan(v / abs(most)) * (4 / np.pi) + 1) * (n / 2)), n - 1)
    return ((2 * axis + (1 if most < 0 else 0)) * n + j) * n + i
