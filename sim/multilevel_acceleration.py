"""Less mass for smooth motions: coarse levels of a body, on which forces accelerate it once more.

The mass that keeps a step stable is that of the fastest waves, which are one cell long. Folds are ten cells long and
do not need it. So forces act on coarser levels, too: a = f/m + sum over levels of P C^-1 P^T f. P interpolates from a
level of half, or a quarter, of the resolution, and C is the mass of its nodes. A motion that is smooth on all levels
has the nodal mass over ``lightness``; a wave of one cell has the nodal mass. This is selective mass scaling (Olovsson,
Simonsson and Unosson 2005) in the form of a multilevel preconditioner (Bramble, Pasciak and Xu 1990). It does not
change the states in which all forces vanish.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import sparse
from skfem import MeshHex

from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.kernels import kernel
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.quad_coarsening import depths_kept, halve

#: acceleration of a smooth motion that each level adds, over that by the nodal mass; the finest level first
LEVEL_ACCELERATIONS = (2.0, 3.0)
_Rows = tuple[NDArray[np.uint32], NDArray[np.uint32], Array, np.uint64]
CHUNK_SIZE = 256  # columns of nodes that a thread takes at once


class CoarseLevels:
    """The coarse levels of a layered body; none if its mesh cannot be coarsened.

    Parameters
    ----------
    bilayer : Bilayer
    X : (N, 3) float64
        Reference positions [mm].
    free : (N, 3) bool
        Where a coordinate may move.
    thickness : float
        Least distance between levels of nodes in the core [mm].

    Attributes
    ----------
    lightness : float
        Nodal mass over the mass with which smooth motions move; 1 without levels.
    """

    def __init__(self, bilayer: Bilayer, X: Array, free: Bools, thickness: float):
        is_brick_mesh = isinstance(bilayer.mesh, MeshHex)
        self._set_up(*(_interpolations(bilayer, X, thickness) if is_brick_mesh else ([], _ONE_LEVEL)), free)

    def _set_up(self, interpolations: "Sequence[_Interpolation]", depth: "_Depth", free: Bools) -> None:
        self._depth, n_columns = depth, len(free) // len(depth.share)
        across_matrices = [across_matrix for _, across_matrix in interpolations]
        empty_matrix = sparse.csr_matrix((across_matrices[-1].shape[1] if across_matrices else n_columns, 0))
        self._across, *coarser_rows = map(_rows, [*across_matrices, empty_matrix])
        self._levels = [
            _Level(free[nodes], _rows(across_matrix.T), rows, np.zeros(len(nodes)), np.zeros((len(nodes), 3)))
            for (nodes, across_matrix), rows in zip(interpolations, coarser_rows, strict=True)
        ]
        self._shares = np.array(LEVEL_ACCELERATIONS[: len(self._levels)])
        self._columns = np.zeros((depth.lower[-1] + 1, 3 * n_columns))

    @property
    def lightness(self) -> float:
        return 1.0 + float(self._shares.sum())

    def scale(self, factor: float) -> None:
        """Multiply what the levels add by ``factor``."""
        self._shares *= factor

    def remove(self) -> None:
        """Give all motions the nodal mass."""
        self._set_up([], _ONE_LEVEL, np.ones((len(self._depth.share) * (len(self._across[0]) - 1), 3), dtype=bool))

    def update(self, mass: Array, stiffening: Array, springs: Array) -> None:
        """Compute the masses of the levels from those of the nodes.

        Parameters
        ----------
        mass : (N,) float64
        stiffening : (N,) float64
            Stiffness of the elements at each node over that before growth. In creases it is large and changes within a
            coarse cell, which makes the waves of the level faster. So its mass is larger by this factor.
        springs : (S,) float64
            Stiffness over mass that effects such as contact add at the surface nodes.
        """
        elastic_mass, contact_mass = mass * np.maximum(stiffening, 1.0), np.zeros(len(mass))
        contact_mass[: len(springs)] = mass[: len(springs)] * springs
        self._restrict(np.column_stack([elastic_mass, contact_mass, contact_mass]), also_held=True)
        for level, level_share in zip(self._levels, self._shares, strict=True):
            level.inverse_mass[:] = level_share / (level.values[:, 0] + level_share * level.values[:, 1])

    def step(self, x: Array, v: Array, forces: Array, mass: Array, free: Bools, kept_share: float) -> int:
        """One step of unit length: v <- kept_share v + a on the ``free`` coordinates, x <- x + v; all (N, 3), in place.

        ``forces`` (N, 3) are 0 where a coordinate is held. Returns 0 if all coordinates are finite.
        """
        self._restrict(forces)
        coarse_values: Array = np.zeros((0, 3))
        for level in reversed(self._levels):
            _accelerate(level.inverse_mass, level.values, level.free, level.coarser_rows, coarse_values)
            coarse_values = level.values
        return _move(x, v, forces, mass, free, kept_share, self._depth, self._across, coarse_values)

    def _restrict(self, finest_values: Array, also_held: bool = False) -> None:
        """Set the values of each level to P^T times those of the finer one where they may move, else 0."""
        if self._levels:
            _sum_along(self._depth, finest_values, self._columns)
        finer: Array = self._columns.reshape(-1, 3)
        for level in self._levels:
            _sum_across(level.across_T, finer, np.ones_like(level.free) if also_held else level.free, level.values)
            finer = level.values

    def accelerations(self, forces: Array, mass: Array) -> Array:
        """Accelerations (N, 3) by ``forces`` (N, 3) on nodes of ``mass`` (N,)."""
        v = np.zeros(forces.shape)
        self.step(np.zeros(forces.shape), v, forces, mass, np.ones(forces.shape, dtype=bool), 0.0)
        return v


class _Depth(NamedTuple):
    """Interpolation along the thickness, for each level of nodes of the body: ``1 - share`` of the kept level ``upper``
    and ``share`` of ``lower``."""

    upper: Ints
    lower: Ints
    share: Array


_ONE_LEVEL = _Depth(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64), np.zeros(1))


class _Level(NamedTuple):
    """A level: where its coordinates may move (n, 3), rows of the interpolations across the surface between the finer
    level and it, transposed, and between it and the coarser one, the inverse masses (n,), and values (n, 3)."""

    free: Bools
    across_T: _Rows
    coarser_rows: _Rows
    inverse_mass: Array
    values: Array


#: the nodes of a level among those of the body (n,), and the interpolation across the surface to the finer one
_Interpolation = tuple[Ints, sparse.csr_matrix]


def _interpolations(bilayer: Bilayer, X: Array, thickness: float) -> tuple[list[_Interpolation], _Depth]:
    """The levels, from fine to coarse, as many as the mesh allows; and the interpolation along the thickness.

    Nodes are numbered level by level, so interpolation is the Kronecker product of those along the thickness and across
    the surface. They are applied one after the other. All coarse levels keep the same levels of nodes.
    """
    n_surface, quads = bilayer.n_surface, bilayer.faces
    layer_depth = np.linalg.norm(X.reshape(-1, n_surface, 3) - X[:n_surface], axis=2).mean(axis=1)
    coarse_layers = depths_kept(layer_depth, int(np.count_nonzero(bilayer.share > 0)) // n_surface, thickness)
    lower_index = np.maximum(np.searchsorted(layer_depth[coarse_layers], layer_depth), 1)
    upper_depth, lower_depth = layer_depth[coarse_layers][lower_index - 1], layer_depth[coarse_layers][lower_index]
    along_depth = _Depth(lower_index - 1, lower_index, (layer_depth - upper_depth) / (lower_depth - upper_depth))
    level_vertices, interpolations = np.arange(n_surface), []
    for _ in LEVEL_ACCELERATIONS:
        coarsened = halve(quads, len(level_vertices)) if len(np.unique(quads)) == len(level_vertices) else None
        if coarsened is None:
            break
        level_vertices, quads = level_vertices[coarsened.vertices], coarsened.quads
        interpolations.append(((coarse_layers[:, None] * n_surface + level_vertices).ravel(), coarsened.interpolation))
    return interpolations, along_depth if interpolations else _ONE_LEVEL


def _rows(matrix: sparse.spmatrix) -> _Rows:
    """Starts, columns and values of the rows of a matrix, and the number of its columns.

    Indices are unsigned: loops are twice as fast with them.
    """
    rows = sparse.csr_matrix(matrix)
    return rows.indptr.astype(np.uint32), rows.indices.astype(np.uint32), rows.data, np.uint64(rows.shape[1])


@kernel(parallel=True)
def _sum_along(depth, finest_values, level_sums):
    """level_sums (levels, 3 n) = sums of ``finest_values`` (N, 3) over levels of nodes."""
    flat_values, n_values = finest_values.reshape(-1), level_sums.shape[1]
    for chunk in prange(-(-n_values // (3 * CHUNK_SIZE))):
        start, end = 3 * CHUNK_SIZE * chunk, min(n_values, 3 * CHUNK_SIZE * (chunk + 1))
        level_sums[:, start:end] = 0.0
        for k in range(len(depth.share)):
            layer_values, lower_weight = flat_values[k * n_values + start : k * n_values + end], depth.share[k]
            upper_sums, lower_sums = level_sums[depth.upper[k], start:end], level_sums[depth.lower[k], start:end]
            for i in range(end - start):
                upper_sums[i] += (1.0 - lower_weight) * layer_values[i]
            if lower_weight > 0:
                for i in range(end - start):
                    lower_sums[i] += lower_weight * layer_values[i]


@njit(inline="always")
def _row_times(rows, row, values, first_row):
    """Row ``row`` of a matrix times the rows of ``values`` (n, 3) from ``first_row`` on."""
    row_starts, columns, weights, _ = rows
    sum0, sum1, sum2 = 0.0, 0.0, 0.0
    for entry in range(row_starts[row], row_starts[row + 1]):
        value_row, weight = first_row + columns[entry], weights[entry]
        sum0 += weight * values[value_row, 0]
        sum1 += weight * values[value_row, 1]
        sum2 += weight * values[value_row, 2]
    return sum0, sum1, sum2


@kernel(parallel=True)
def _sum_across(across_T, finer_values, is_free, level_sums):
    """level_sums = sums of ``finer_values`` across the surface, level by level, where ``is_free``, else 0."""
    n_columns = len(across_T[0]) - 1
    for chunk in prange(-(-n_columns // CHUNK_SIZE)):
        for k in range(len(level_sums) // n_columns):
            for column in range(chunk * CHUNK_SIZE, min(n_columns, (chunk + 1) * CHUNK_SIZE)):
                row_sums = _row_times(across_T, column, finer_values, np.uint64(k) * across_T[3])
                for r in range(3):
                    level_sums[k * n_columns + column, r] = row_sums[r] if is_free[k * n_columns + column, r] else 0.0


@kernel(parallel=True)
def _accelerate(inverse_mass, values, is_free, across, coarse_values):
    """values = inverse_mass values + interpolation of ``coarse_values`` where ``is_free``, in place."""
    n_columns = len(across[0]) - 1
    for chunk in prange(-(-n_columns // CHUNK_SIZE)):
        for k in range(len(values) // n_columns):
            for column in range(chunk * CHUNK_SIZE, min(n_columns, (chunk + 1) * CHUNK_SIZE)):
                added_a, i = _row_times(across, column, coarse_values, np.uint64(k) * across[3]), k * n_columns + column
                for axis in range(3):
                    if is_free[i, axis]:
                        values[i, axis] = inverse_mass[i] * values[i, axis] + added_a[axis]


@kernel(parallel=True)
def _move(x, v, forces, mass, is_free, kept_share, depth, across, coarse_values):
    """v = kept_share v + forces / mass + interpolation of ``coarse_values`` where ``is_free``, x = x + v.

    Returns 0 if all coordinates are finite.
    """
    n_lost, n_columns, n_coarse_layers = 0, len(across[0]) - 1, depth.lower[-1] + 1
    all_x, all_v, all_forces, all_is_free = x.reshape(-1), v.reshape(-1), forces.reshape(-1), is_free.reshape(-1)
    for chunk in prange(-(-n_columns // CHUNK_SIZE)):
        start, end = chunk * CHUNK_SIZE, min(n_columns, (chunk + 1) * CHUNK_SIZE)
        coarse_a, inverse_mass = np.empty((n_coarse_layers, CHUNK_SIZE, 3)), np.empty((CHUNK_SIZE, 3))
        for k in range(n_coarse_layers):
            for column in range(start, end):
                node_a = _row_times(across, column, coarse_values, np.uint64(k) * across[3])
                coarse_a[k, column - start, 0], coarse_a[k, column - start, 1], coarse_a[k, column - start, 2] = node_a
        is_lost = False
        for k in range(len(depth.share)):
            for column in range(end - start):
                inverse_mass[column, :] = 1.0 / mass[k * n_columns + start + column]
            layer_slice, lower_weight = slice(3 * (k * n_columns + start), 3 * (k * n_columns + end)), depth.share[k]
            upper_a, lower_a = coarse_a[depth.upper[k]].reshape(-1), coarse_a[depth.lower[k]].reshape(-1)
            layer_x, layer_v, layer_f = all_x[layer_slice], all_v[layer_slice], all_forces[layer_slice]
            layer_is_free, per_mass = all_is_free[layer_slice], inverse_mass.reshape(-1)
            for i in range(3 * (end - start)):
                node_a = per_mass[i] * layer_f[i] + ((1.0 - lower_weight) * upper_a[i] + lower_weight * lower_a[i])
                layer_v[i] = kept_share * layer_v[i] + node_a if layer_is_free[i] else layer_v[i]
                layer_x[i] += layer_v[i]
                is_lost |= not (layer_x[i] - layer_x[i] == 0.0)  # NaN or infinity; this form is vectorised
        n_lost += is_lost
    return n_lost
