"""Rotations of a sphere, and the vertex below each turned point: the null hypothesis for maps that are smooth."""

import math
from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import dot, position
from morphofold.kernels import kernel, reading

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
        n_cells = int(np.ceil(np.sqrt(CELLS_PER_VERTEX * len(points) / 6)))
        v, u = np.meshgrid(*[np.tan(np.pi / 4 * ((np.arange(n_cells) + 0.5) / n_cells * 2 - 1))] * 2, indexing="ij")
        side_directions = (np.stack([np.full_like(u, sign), u, v], axis=-1) for sign in (1.0, -1.0))
        cell_directions = np.array([np.roll(grid, axis, axis=-1) for axis, grid in product(range(3), side_directions)])
        cell_directions /= np.linalg.norm(cell_directions, axis=-1, keepdims=True)
        #: nearest vertex of each cell, and cells along a side, as kernels take them
        self.arrays = cKDTree(points).query(cell_directions.reshape(-1, 3))[1].astype(np.int64), n_cells

    def __call__(self, points: Array) -> Ints:
        """Vertices (P,) near points (P, 3) of the unit sphere."""
        nearest: Ints = _find(*reading(points, *self.arrays))
        return nearest


@kernel
def _find(points, cell_vertex, n_cells):
    nearest = np.empty(len(points), np.int64)
    for i in range(len(points)):
        nearest[i] = cell_vertex[cell_of(position(points, i), n_cells)]
    return nearest


@kernel
def turned(rotation, point):
    """A point after a rotation (3, 3)."""
    return dot(position(rotation, 0), point), dot(position(rotation, 1), point), dot(position(rotation, 2), point)


@kernel
def cell_of(point, n_cells):
    """Number of the cell of ``NearestTable`` in which a point of the unit sphere lies."""
    x, y, z = point
    axis, main_component, u, v = 0, x, y, z
    if abs(y) > abs(x) and abs(y) >= abs(z):
        axis, main_component, u, v = 1, y, z, x
    elif abs(z) > abs(x):
        axis, main_component, u, v = 2, z, x, y
    i = min(int((math.atan(u / abs(main_component)) * (4 / np.pi) + 1) * (n_cells / 2)), n_cells - 1)
    j = min(int((math.atan(v / abs(main_component)) * (4 / np.pi) + 1) * (n_cells / 2)), n_cells - 1)
    return ((2 * axis + (main_component < 0)) * n_cells + j) * n_cells + i
