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
from morphofold.sim.mesh.quad_halving import depths_kept, halve

#: acceleration of a smooth motion that each level adds, over that by the nodal mass; the finest level first
LEVEL_ACCELERATIONS = (2.0, 3.0)
_Rows = tuple[NDArray[np.uint32], NDArray[np.uint32], Array, np.uint64]
CHUNK = 256  # columns of nodes that a thread takes at once


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
        self._depth, n = depth, len(free) // len(depth.share)
        across_matrices = [across_matrix for _, across_matrix in interpolations]
        empty_matrix = sparse.csr_matrix((across_matrices[-1].shape[1] if across_matrices else n, 0))
        self._across, *coarser_rows = map(_rows, [*across_matrices, empty_matrix])
        self._levels = [
            _Level(free[nodes], _rows(across_matrix.T), rows, np.zeros(len(nodes)), np.zeros((len(nodes), 3)))
            for (nodes, across_matrix), rows in zip(interpolations, coarser_rows, strict=True)
        ]
        self._shares = np.array(LEVEL_ACCELERATIONS[: len(self._levels)])
        self._columns = np.zeros((depth.lower[-1] + 1, 3 * n))

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
        self._restrict(np.column_stack([elastic_mass, contact_mass, contact_mass]), everywhere=True)
        for level, level_share in zip(self._levels, self._shares, strict=True):
            level.inverse[:] = level_share / (level.values[:, 0] + level_share * level.values[:, 1])

    def step(self, x: Array, v: Array, forces: Array, mass: Array, free: Bools, keep: float) -> int:
        """One step of unit length: v <- keep v + a on the ``free`` coordinates, x <- x + v; all (N, 3), in place.

        ``forces`` (N, 3) are 0 where a coordinate is held. Returns 0 if all coordinates are finite.
        """
        self._restrict(forces)
        coarse_values: Array = np.zeros((0, 3))
        for level in reversed(self._levels):
            _accelerate(level.inverse, level.values, level.free, level.coarser, coarse_values)
            coarse_values = level.values
        return _move(x, v, forces, mass, free, keep, self._depth, self._across, coarse_values)

    def _restrict(self, finest_values: Array, everywhere: bool = False) -> None:
        """Set the values of each level to P^T times those of the finer one where they may move, else 0."""
        if self._levels:
            _sum_along(self._depth, finest_values, self._columns)
        finer: Array = self._columns.reshape(-1, 3)
        for level in self._levels:
            _sum_across(level.across_T, finer, np.ones_like(level.free) if everywhere else level.free, level.values)
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
    coarser: _Rows
    inverse: Array
    values: Array


#: the nodes of a level among those of the body (n,), and the interpolation across the surface to the finer one
_Interpolation = tuple[Ints, sparse.csr_matrix]


def _interpolations(bilayer: Bilayer, X: Array, thickness: float) -> tuple[list[_Interpolation], _Depth]:
    """The levels, from fine to coarse, as many as the mesh allows; and the interpolation along the thickness.

    Nodes are numbered level by level, so interpolation is the Kronecker product of those along the thickness and across
    the surface. They are applied one after the other. All coarse levels keep the same levels of nodes.
    """
    n, quads = bilayer.n_surface, bilayer.faces
    depth = np.linalg.norm(X.reshape(-1, n, 3) - X[:n], axis=2).mean(axis=1)
    coarse_layers = depths_kept(depth, int(np.count_nonzero(bilayer.share > 0)) // n, thickness)
    lower = np.maximum(np.searchsorted(depth[coarse_layers], depth), 1)
    start, end = depth[coarse_layers][lower - 1], depth[coarse_layers][lower]
    along = _Depth(lower - 1, lower, (depth - start) / (end - start))
    level_vertices, interpolations = np.arange(n), []
    for _ in LEVEL_ACCELERATIONS:
        coarsened = halve(quads, len(level_vertices)) if len(np.unique(quads)) == len(level_vertices) else None
        if coarsened is None:
            break
        level_vertices, quads = level_vertices[coarsened.vertices], coarsened.quads
        interpolations.append(((coarse_layers[:, None] * n + level_vertices).ravel(), coarsened.interpolation))
    return interpolations, along if interpolations else _ONE_LEVEL


def _rows(matrix: sparse.spmatrix) -> _Rows:
    """Starts, columns and values of the rows of a matrix, and the number of its columns.

    Indices are unsigned: loops are twice as fast with them.
    """
    rows = sparse.csr_matrix(matrix)
    return rows.indptr.astype(np.uint32), rows.indices.astype(np.uint32), rows.data, np.uint64(rows.shape[1])


@kernel(parallel=True)
def _sum_along(depth, finest_values, level_sums):
    """level_sums (levels, 3 n) = sums of ``finest_values`` (N, 3) over levels of nodes."""
    flat_values, n = finest_values.reshape(-1), level_sums.shape[1]
    for chunk in prange(-(-n // (3 * CHUNK))):
        start, end = 3 * CHUNK * chunk, min(n, 3 * CHUNK * (chunk + 1))
        level_sums[:, start:end] = 0.0
        for k in range(len(depth.share)):
            layer_values, weight = flat_values[k * n + start : k * n + end], depth.share[k]
            upper, lower = level_sums[depth.upper[k], start:end], level_sums[depth.lower[k], start:end]
            for i in range(end - start):
                upper[i] += (1.0 - weight) * layer_values[i]
            if weight > 0:
                for i in range(end - start):
                    lower[i] += weight * layer_values[i]


@njit(inline="always")
def _row_times(rows, c, values, first_row):
    """Row c of a matrix times the rows of ``values`` (n, 3) from ``first_row`` on."""
    row_starts, columns, weights, _ = rows
    s0, s1, s2 = 0.0, 0.0, 0.0
    for q in range(row_starts[c], row_starts[c + 1]):
        j, w = first_row + columns[q], weights[q]
        s0 += w * values[j, 0]
        s1 += w * values[j, 1]
        s2 += w * values[j, 2]
    return s0, s1, s2


@kernel(parallel=True)
def _sum_across(across_T, finer_values, is_free, level_sums):
    """level_sums = sums of ``finer_values`` across the surface, level by level, where ``is_free``, else 0."""
    n = len(across_T[0]) - 1
    for chunk in prange(-(-n // CHUNK)):
        for k in range(len(level_sums) // n):
            for c in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
                row_sums = _row_times(across_T, c, finer_values, np.uint64(k) * across_T[3])
                for r in range(3):
                    level_sums[k * n + c, r] = row_sums[r] if is_free[k * n + c, r] else 0.0


@kernel(parallel=True)
def _accelerate(inverse, values, is_free, across, coarse_values):
    """values = inverse values + interpolation of ``coarse_values`` where ``is_free``, in place."""
    n = len(across[0]) - 1
    for chunk in prange(-(-n // CHUNK)):
        for k in range(len(values) // n):
            for c in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
                a, i = _row_times(across, c, coarse_values, np.uint64(k) * across[3]), k * n + c
                for r in range(3):
                    if is_free[i, r]:
                        values[i, r] = inverse[i] * values[i, r] + a[r]


@kernel(parallel=True)
def _move(x, v, forces, mass, is_free, keep, depth, across, coarse_values):
    """v = keep v + forces / mass + interpolation of ``coarse_values`` where ``is_free``, x = x + v.

    Returns 0 if all coordinates are finite.
    """
    n_lost, n, n_kept = 0, len(across[0]) - 1, depth.lower[-1] + 1
    all_x, all_v, all_forces, all_is_free = x.reshape(-1), v.reshape(-1), forces.reshape(-1), is_free.reshape(-1)
    for chunk in prange(-(-n // CHUNK)):
        start, end = chunk * CHUNK, min(n, (chunk + 1) * CHUNK)
        coarse_a, inverse_mass = np.empty((n_kept, CHUNK, 3)), np.empty((CHUNK, 3))
        for k in range(n_kept):
            for c in range(start, end):
                a = _row_times(across, c, coarse_values, np.uint64(k) * across[3])
                coarse_a[k, c - start, 0], coarse_a[k, c - start, 1], coarse_a[k, c - start, 2] = a
        lost = False
        for k in range(len(depth.share)):
            for c in range(end - start):
                inverse_mass[c, :] = 1.0 / mass[k * n + start + c]
            layer_slice, weight = slice(3 * (k * n + start), 3 * (k * n + end)), depth.share[k]
            upper, lower = coarse_a[depth.upper[k]].reshape(-1), coarse_a[depth.lower[k]].reshape(-1)
            X, V, F = all_x[layer_slice], all_v[layer_slice], all_forces[layer_slice]
            may_move, per_mass = all_is_free[layer_slice], inverse_mass.reshape(-1)
            for i in range(3 * (end - start)):
                a = per_mass[i] * F[i] + ((1.0 - weight) * upper[i] + weight * lower[i])
                V[i] = keep * V[i] + a if may_move[i] else V[i]
                X[i] += V[i]
                lost |= not (X[i] - X[i] == 0.0)  # NaN and infinity: so written, the loop becomes vector instructions
        n_lost += lost
    return n_lost
