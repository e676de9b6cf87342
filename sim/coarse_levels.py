"""Less mass for smooth motions: coarse levels of a body, on which forces accelerate it once more.

The mass that keeps a step stable is that of the fastest waves, which are one cell long. Folds are ten cells long and
do not need it. So forces act on coarser levels, too: a = f/m + sum over levels of P C^-1 P^T f. P interpolates from a
level of half, or a quarter, of the resolution, and C is the mass of its nodes. A motion that is smooth on all levels
has the nodal mass over ``lightness``; a wave of one cell has the nodal mass. This is selective mass scaling (Olovsson,
Simonsson and Unosson 2005) in the form of a multilevel preconditioner (Bramble, Pasciak and Xu 1990). It does not
change the states in which all forces vanish.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from scipy import sparse
from skfem import MeshHex

from morphofold.arrays import Array, Bools, Ints
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.mesh.coarsening import depths_kept, halve

#: acceleration of a smooth motion that each level adds, over that by the nodal mass; the finest level first
LEVEL_ACCELERATIONS = (2.0, 3.0)
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
        self._set_up(_interpolations(bilayer, X, thickness) if isinstance(bilayer.mesh, MeshHex) else [], free)

    def _set_up(self, levels: Sequence[_Level], free: Bools) -> None:
        self._ups = [_rows(level.between, level.across) for level in levels]
        self._downs = [_rows(level.between.T, level.across.T) for level in levels]
        self._free = [free[level.nodes] for level in levels]
        self._shares = np.array(LEVEL_ACCELERATIONS[: len(levels)])
        self._inverse, self._values = [np.zeros(len(f)) for f in self._free], [np.zeros(f.shape) for f in self._free]
        last = len(self._free[-1]) if levels else len(free)
        self._ups.append(_rows(sparse.csr_matrix((1, 0)), sparse.csr_matrix((last, 0))))

    @property
    def lightness(self) -> float:
        return 1.0 + float(self._shares.sum())

    def scale(self, factor: float) -> None:
        """Multiply what the levels add by ``factor``."""
        self._shares *= factor

    def remove(self) -> None:
        """Give all motions the nodal mass."""
        n_nodes = (len(self._ups[0][0]) - 1) * (len(self._ups[0][3]) - 1)
        self._set_up([], np.ones((n_nodes, 3), dtype=bool))

    def update(self, mass: Array, crushed: Array, springs: Array) -> None:
        """Compute the masses of the levels from those of the nodes.

        Parameters
        ----------
        mass : (N,) float64
        crushed : (N,) float64
            Stiffness of the elements at each node over that before growth. In creases it is large and changes within a
            coarse cell, which makes the waves of the level faster. So its mass is larger by this factor.
        springs : (S,) float64
            Stiffness over mass that effects such as contact add at the surface nodes.
        """
        elastic, pressed = mass * np.maximum(crushed, 1.0), np.zeros(len(mass))
        pressed[: len(springs)] = mass[: len(springs)] * springs
        sums = np.column_stack([elastic, pressed, pressed])
        for down, share, inverse in zip(self._downs, self._shares, self._inverse, strict=True):
            finer, sums = sums, np.empty((len(inverse), 3))
            _sum(down, finer, np.ones(sums.shape, dtype=bool), sums)
            inverse[:] = share / (sums[:, 0] + share * sums[:, 1])

    def step(self, x: Array, v: Array, forces: Array, mass: Array, free: Bools, keep: float) -> int:
        """One step of unit length: v <- keep v + a on the ``free`` coordinates, x <- x + v; all (N, 3), in place.

        ``forces`` (N, 3) are 0 where a coordinate is held. Returns the number of coordinates that are not finite.
        """
        finer: Array = forces
        coarse: Array = np.zeros((0, 3))
        for down, movable, values in zip(self._downs, self._free, self._values, strict=True):
            _sum(down, finer, movable, values)
            finer = values
        for k in range(len(self._values), 0, -1):
            _accelerate(self._inverse[k - 1], self._values[k - 1], self._free[k - 1], self._ups[k], coarse)
            coarse = self._values[k - 1]
        return _move(x, v, forces, mass, free, keep, self._ups[0], coarse)

    def accelerations(self, forces: Array, mass: Array) -> Array:
        """Accelerations (N, 3) by ``forces`` (N, 3) on nodes of ``mass`` (N,)."""
        v = np.zeros(forces.shape)
        self.step(np.zeros(forces.shape), v, forces, mass, np.ones(forces.shape, dtype=bool), 0.0)
        return v


class _Level(NamedTuple):
    """A level: its nodes among those of the body (n,), and the interpolation from it to the finer one.

    Nodes are numbered level by level, so the interpolation is the Kronecker product of that between levels of nodes
    and that across the surface.
    """

    nodes: Ints
    between: sparse.csr_matrix
    across: sparse.csr_matrix


def _interpolations(bilayer: Bilayer, X: Array, thickness: float) -> list[_Level]:
    """The levels, from fine to coarse; as many as the mesh allows."""
    n, quads = bilayer.n_surface, bilayer.faces
    depth = np.linalg.norm(X.reshape(-1, n, 3) - X[:n], axis=2).mean(axis=1)
    kept = depths_kept(depth, int(np.count_nonzero(bilayer.share > 0)) // n, thickness)
    between = np.stack([np.interp(depth, depth[kept], row) for row in np.eye(len(kept))], axis=1)
    vertices, levels = np.arange(n), []
    for _ in LEVEL_ACCELERATIONS:
        halved = halve(quads, len(vertices)) if len(np.unique(quads)) == len(vertices) else None
        if halved is None:
            break
        vertices, quads = vertices[halved.vertices], halved.quads
        nodes = (kept[:, None] * n + vertices).ravel()
        levels.append(_Level(nodes, sparse.csr_matrix(between), halved.interpolation))
        between = np.eye(len(kept))
    return levels


def _rows(between: sparse.csr_matrix, across: sparse.csr_matrix) -> tuple[Any, ...]:
    """The rows of both factors (starts, columns, values of each), and the number of columns of ``across``."""
    parts = [sparse.csr_matrix(factor) for factor in (between, across)]
    return *(part for m in parts for part in (m.indptr, m.indices, m.data)), across.shape[1]


@njit(inline="always")
def _row_times(k, c, values, product):
    """Row of level k and column c of a product of matrices, as :func:`_rows` gives it, times ``values`` (n, 3)."""
    first, level, weight, start, column, share, columns = product
    s0, s1, s2 = 0.0, 0.0, 0.0
    for p in range(first[k], first[k + 1]):
        w, base = weight[p], level[p] * columns
        for q in range(start[c], start[c + 1]):
            j, a = base + column[q], w * share[q]
            s0 += a * values[j, 0]
            s1 += a * values[j, 1]
            s2 += a * values[j, 2]
    return s0, s1, s2


@njit(parallel=True, cache=True)
def _sum(product, finer, free, out):
    """out = D finer where ``free``, else 0, with D a product of matrices."""
    levels, n = len(product[0]) - 1, len(product[3]) - 1
    for chunk in prange(-(-n // CHUNK)):
        for k in range(levels):
            for c in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
                s = _row_times(k, c, finer, product)
                for r in range(3):
                    out[k * n + c, r] = s[r] if free[k * n + c, r] else 0.0


@njit(parallel=True, cache=True)
def _accelerate(inverse, values, free, product, coarse):
    """values = inverse values + U coarse where ``free``, in place, with U a product of matrices."""
    levels, n = len(product[0]) - 1, len(product[3]) - 1
    for chunk in prange(-(-n // CHUNK)):
        for k in range(levels):
            for c in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
                a, i = _row_times(k, c, coarse, product), k * n + c
                for r in range(3):
                    if free[i, r]:
                        values[i, r] = inverse[i] * values[i, r] + a[r]


@njit(parallel=True, cache=True)
def _move(x, v, forces, mass, free, keep, product, coarse):
    """v = keep v + forces / mass + U coarse where free, x = x + v; returns how many coordinates are not finite."""
    lost, levels, n = 0, len(product[0]) - 1, len(product[3]) - 1
    for chunk in prange(-(-n // CHUNK)):
        for k in range(levels):
            for c in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
                a, i = _row_times(k, c, coarse, product), k * n + c
                per_mass = 1.0 / mass[i]
                for r in range(3):
                    if free[i, r]:
                        v[i, r] = keep * v[i, r] + (per_mass * forces[i, r] + a[r])
                        x[i, r] += v[i, r]
                    lost += not np.isfinite(x[i, r])
    return lost
