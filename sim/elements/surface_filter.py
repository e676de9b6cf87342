"""A weak stiffness of the pial surface against zigzags of the size of one cell; its energy is 0 for any affine map.

Under extreme compression elements form saw-teeth; this stops them. For a smooth surface its energy is of order h^4.
"""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray
from scipy import sparse

from morphofold.frozen_arrays import Array
from morphofold.kernels import kernel
from morphofold.sim.mesh.brick_mesh import Bilayer

FLAT_STENCIL_RATIO = 1e-7  # singular value, over the largest, below which a stencil is flat in that direction
SAME_POINT_DISTANCE_IN_CELLS = 1e-4  # distance below which two points of a stencil are the same [cell sizes]


class SurfaceFilter:
    """Energy ``strength H/2 sum_i w_i |(M u)_i|^2`` of the displacements u = x - X of the pial surface.

    L u is the mean of a node's neighbours minus the node. A row of M is a row of L L minus its projection onto the
    affine functions of position on its stencil. So M x = 0 for every affine map x of X, and the energy of M u = M x
    does not change under rigid motion. Beyond a symmetry plane the mirror images of the nodes are used; w is halved on
    the plane. H is the size of a cell before growth times the mean stretch of growth. It does not depend on x, so
    forces are the energy's derivative.

    Parameters
    ----------
    bilayer : Bilayer
    X : (N, 3) float64
        Reference positions [mm].
    strength : float
        [Pa]
    cell : float
        Size of a cell of the reference surface [mm].
    """

    def __init__(self, bilayer: Bilayer, X: Array, strength: float, cell: float):
        n = bilayer.n_surface
        stencils = _remove_affine_part(_squared_operator(_umbrella_laplacian(bilayer)), X, cell)
        n_planes = sum((bilayer.mesh.p[axis, :n] == position for axis, position, _ in bilayer.planes), np.zeros(n))
        plane_weights = sparse.diags(0.5**n_planes)

        def stiffness(values: Array) -> sparse.csr_matrix:
            M = sparse.csr_matrix((values, (stencils.row, stencils.node)), shape=(n, n))
            return sparse.csr_matrix(M.T @ plane_weights @ M)

        even_part = stiffness(stencils.value)
        self._B = [even_part] * 3
        for axis in {plane.axis for plane in bilayer.planes}:  # this component changes sign in the mirror
            self._B[axis] = stiffness(stencils.value * stencils.sign[:, axis])
        self._row_sum = np.max([np.asarray(abs(matrix).sum(axis=1)).ravel() for matrix in self._B], axis=0)
        odd_parts = [sparse.coo_matrix(matrix - even_part) for matrix in self._B]
        entries = [np.concatenate([getattr(part, field) for part in odd_parts]) for field in ("row", "col", "data")]
        self._even = even_part.indptr.astype(np.uint32), even_part.indices.astype(np.uint32), even_part.data
        self._odd = np.repeat(np.arange(3), [part.nnz for part in odd_parts]), *entries
        self._X, self._u = X[:n].copy(), np.zeros((n, 3))
        self.cell, self._strength = cell, strength
        self.grow(1.0)

    def grow(self, stretch: float) -> None:
        """Set the size of a cell for a mean ``stretch`` of growth."""
        self._scale = self._strength * self.cell * stretch

    @property
    def stiffness(self) -> Array:
        """Row sums of the filter's stiffness matrix (S,), an upper bound of its eigenvalues."""
        return self._scale * self._row_sum

    def forces(self, x: Array, out: Array | None = None) -> Array:
        """Forces (S, 3) on the surface nodes at positions ``x`` (N, 3), written into ``out`` if that is given."""
        out = np.empty_like(self._X) if out is None else out
        _filter_forces(*self._even, *self._odd, x, self._X, self._scale, self._u, out)
        return out

    def energy(self, x: Array) -> float:
        """Energy of the filter at positions ``x``: as it is quadratic, half of minus force times displacement."""
        return -0.5 * float(np.sum(self.forces(x) * self._u))

    def matrix(self, axis: int) -> sparse.csr_matrix:
        """Stiffness (S, S) of one component at the present growth."""
        return self._scale * self._B[axis]


class _Stencils(NamedTuple):
    """Rows of an operator on the surface, including mirror images of nodes beyond symmetry planes.

    Entry e of row ``row`` is ``value`` times the function at ``sign * position of node + offset``; entries of a row are
    contiguous. ``row``, ``node`` (E,) int, ``sign``, ``offset`` (E, 3), ``value`` (E,) float64.
    """

    row: NDArray[np.int64]
    node: NDArray[np.int64]
    sign: Array
    offset: Array
    value: Array

    def taken(self, entries: NDArray[np.generic]) -> "_Stencils":
        return _Stencils(*(array[entries] for array in self))


def _umbrella_laplacian(bilayer: Bilayer) -> _Stencils:
    """The mean of a node's neighbours minus the node."""
    faces, n_surface = bilayer.faces, bilayer.n_surface
    edge_ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    node, neighbour = np.unique(np.concatenate([edge_ends, edge_ends[:, ::-1]]), axis=0).T
    stencils = _Stencils(node, neighbour, np.ones((len(node), 3)), np.zeros((len(node), 3)), np.ones(len(node)))
    for axis, position, _ in bilayer.planes:
        on_plane = bilayer.mesh.p[axis, :n_surface] == position
        mirror_images = stencils.taken(on_plane[stencils.row] & ~on_plane[stencils.node])
        mirror_images.sign[:, axis] *= -1
        mirror_images.offset[:, axis] = 2 * position - mirror_images.offset[:, axis]
        stencils = _Stencils(*(np.concatenate(arrays) for arrays in zip(stencils, mirror_images)))
    weights = 1 / np.bincount(stencils.row, minlength=n_surface)[stencils.row]
    nodes = np.arange(n_surface)
    diagonal = _Stencils(nodes, nodes, np.ones((n_surface, 3)), np.zeros((n_surface, 3)), -np.ones(n_surface))
    laplacian = _Stencils(*(np.concatenate(arrays) for arrays in zip(stencils._replace(value=weights), diagonal)))
    return laplacian.taken(np.argsort(laplacian.row, kind="stable"))


def _squared_operator(operator: _Stencils) -> _Stencils:
    """The operator applied twice: each entry is replaced by all entries of its node's row."""
    row_sizes = np.bincount(operator.row)
    row_starts = np.cumsum(row_sizes) - row_sizes
    n_next = row_sizes[operator.node]
    entry = np.repeat(np.arange(len(operator.row)), n_next)
    successor = np.arange(len(entry)) - np.repeat(np.cumsum(n_next) - n_next, n_next) + row_starts[operator.node[entry]]
    inner, outer = operator.taken(entry), operator.taken(successor)
    offset = inner.sign * outer.offset + inner.offset
    return _Stencils(inner.row, outer.node, inner.sign * outer.sign, offset, inner.value * outer.value)


def _remove_affine_part(stencils: _Stencils, positions: Array, cell: float) -> _Stencils:
    """Each row minus its projection onto 1 and the three coordinates of its points; equal points are merged first."""
    points = stencils.sign * positions[stencils.node] + stencils.offset
    rounded_points = np.rint(points / (SAME_POINT_DISTANCE_IN_CELLS * cell)).astype(np.int64)
    entry_order = np.lexsort((*rounded_points.T, stencils.node, stencils.row))
    point_keys = np.column_stack([stencils.row, stencils.node, rounded_points])[entry_order]
    is_new = np.concatenate([[True], np.any(point_keys[1:] != point_keys[:-1], axis=1)])
    new_entry = np.flatnonzero(is_new)
    entry_values = np.add.reduceat(stencils.value[entry_order], new_entry)
    merged, points = stencils.taken(entry_order[new_entry])._replace(value=entry_values), points[entry_order[new_entry]]

    row_sizes = np.bincount(merged.row)
    row_starts = np.cumsum(row_sizes) - row_sizes
    for size in np.unique(row_sizes):
        rows = np.flatnonzero(row_sizes == size)
        entry = row_starts[rows, None] + np.arange(size)
        basis = np.concatenate([np.ones((len(rows), size, 1)), (points[entry] - positions[rows, None]) / cell], axis=2)
        U, singular_values, _ = np.linalg.svd(basis, full_matrices=False)
        U *= (singular_values > FLAT_STENCIL_RATIO * singular_values[:, :1])[:, None, :]
        row_values = entry_values[entry][..., None]
        for _ in range(2):  # the second time removes round-off
            row_values = row_values - U @ (U.swapaxes(1, 2) @ row_values)
        entry_values[entry] = row_values[..., 0]
    return merged._replace(value=entry_values)


@kernel(parallel=True)
def _filter_forces(row_start, column, value, odd_axis, odd_row, odd_column, difference, x, X, scale, u, out):
    """Compute out = -scale (B + D) u for the surface nodes; u = x - X (n, 3) is written, too.

    B is a CSR matrix (row_start, column, value), with unsigned indices, which are twice as fast as signed ones; D adds
    ``difference`` to single entries (odd_row, odd_column) of one component, ``odd_axis``.
    """
    for node in prange(len(out)):
        for axis in range(3):
            u[node, axis] = x[node, axis] - X[node, axis]
    for node in prange(len(out)):
        sum0, sum1, sum2 = 0.0, 0.0, 0.0
        for k in range(row_start[node], row_start[node + 1]):
            neighbour, entry = column[k], value[k]
            sum0 += entry * u[neighbour, 0]
            sum1 += entry * u[neighbour, 1]
            sum2 += entry * u[neighbour, 2]
        out[node, 0], out[node, 1], out[node, 2] = -scale * sum0, -scale * sum1, -scale * sum2
    for k in range(len(odd_axis)):
        out[odd_row[k], odd_axis[k]] -= scale * difference[k] * u[odd_column[k], odd_axis[k]]
