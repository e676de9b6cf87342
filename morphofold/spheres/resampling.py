"""Resampling of maps from one surface to another, registered by their spheres (FreeSurfer's ?h.sphere.reg)."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from morphofold.errors import WrongShape
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import corners, cross, dot, incident_faces, position
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces, Surface
from morphofold.threads import in_blocks
from morphofold.unfolding.unfold import points_on_sphere

LEAST_GATHERED = 4  # source vertices around a target vertex, from which on their mean is taken
LEAST_KNOWN_SHARE = 0.5  # of the weights of a target vertex, below which it has no value
NEAREST_VERTICES = 4  # around a point, whose triangles are searched
LEAST_SHARE = -1e-9  # least share of a corner with which a point is still in a triangle

Value = TypeVar("Value", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Places:
    """Places of P points on a sphere of N vertices.

    Attributes
    ----------
    nearest : (P,) int64
        Nearest vertex of the sphere.
    corners : (P, 3) int64
        Corners of the triangle that holds the point; three times the nearest vertex if none does.
    shares : (P, 3) float64
        Barycentric coordinates in that triangle; they sum to 1.
    """

    nearest: Ints
    corners: Ints
    shares: Array

    def __repr__(self) -> str:
        return f"Places({len(self.nearest):,} points)"

    def of_nearest(self, values: NDArray[Value]) -> NDArray[Value]:
        """Labels, or any values (N, ...), of the nearest vertex: (P, ...)."""
        return values[self.nearest]

    def values(self, values: Array) -> Array:
        """Values (N,) by linear interpolation in the triangle (P,); those of the nearest vertex beside a NaN."""
        corner_values = np.asarray(values, dtype=np.float64)[self.corners]
        is_finite = np.isfinite(corner_values).all(axis=1)
        interpolated = np.asarray(values, dtype=np.float64)[self.nearest]
        interpolated[is_finite] = np.sum(corner_values[is_finite] * self.shares[is_finite], axis=1)
        return interpolated


class Resampling:
    """Brings maps from the N vertices of a source to the P vertices of a target.

    Parameters
    ----------
    source, target : Surface
        Spheres about the origin, of any radius, on which the two surfaces are registered: ``?h.sphere.reg`` of a
        subject; that, or ``?h.sphere``, of a template. For the way back exchange them.

    Raises
    ------
    ValueError
        If one of the two is not a sphere: a border, vertices at different distances from the origin, or triangles that
        cover it more than once.

    Notes
    -----
    Where the target is finer, values are interpolated linearly in the triangles of the source. Where it is coarser,
    that would use few of the source's vertices, so values are averaged: each source vertex is shared among the corners
    of the target's triangle that holds it, in proportion to its barycentric coordinates. The second is the transpose of
    interpolation from target to source, so it keeps sums. Workbench's ADAP_BARY_AREA chooses between the two in a
    similar way. Means are of second order in the edge of an even target, such as FreeSurfer's templates, and of first
    order where its triangles are uneven.
    """

    def __init__(self, source: Surface, target: Surface):
        self._source, self._target = source, target
        self._from, self._to = (points_on_sphere(sphere, sphere) for sphere in (source, target))

    def __repr__(self) -> str:
        return f"Resampling({len(self._source.verts):,} to {len(self._target.verts):,} vertices)"

    @cached_property
    def places(self) -> Places:
        """Places of the target's vertices in the source's triangles."""
        return places(self._from, self._source.faces, self._to)

    @cached_property
    def shares(self) -> sparse.csr_array:
        """Shares (P, N) of each source vertex that fall to the target's vertices; columns sum to 1."""
        back = places(self._to, self._target.faces, self._from)
        return _matrix(back.corners, np.arange(len(self._from))[:, None], back.shares, (len(self._to), len(self._from)))

    def values(self, values: Array) -> Array:
        """Values (N,) at the target's vertices (P,), by linear interpolation; beside a NaN those of the nearest vertex.

        Exact where a target's vertex is one of the source's, and of second order in the edge elsewhere.
        """
        return self.places.values(self._checked(values))

    def means(self, values: Array, areas: Array) -> Array:
        """Means (P,) of values (N,) over the area around each target's vertex; ``areas`` (N,) of the source's [mm^2].

        Where the target is as fine as the source or finer, this is ``values``. NaN where less than half of the weight
        is of values that are known.
        """
        values, weights = self._checked(values), self._weights(areas)
        is_finite = np.isfinite(values)
        total_weights, finite_weights = weights.sum(axis=1), weights @ is_finite.astype(np.float64)
        weighted_sums = weights @ np.where(is_finite, values, 0.0)
        has_enough = (finite_weights >= LEAST_KNOWN_SHARE * total_weights) & (finite_weights > 0)
        return np.divide(weighted_sums, finite_weights, out=np.full(len(weighted_sums), np.nan), where=has_enough)

    def sums(self, amounts: Array) -> Array:
        """Amounts (P,) such as areas or counts: the source's (N,) are divided among the target's vertices.

        Their sum stays the same to round-off. NaN counts as nothing.
        """
        amounts = self._checked(amounts)
        target_sums: Array = self.shares @ np.where(np.isfinite(amounts), amounts, 0.0)
        return target_sums

    def labels(self, labels: Ints, areas: Array) -> Ints:
        """The label (P,) with the largest area around each target's vertex, of labels (N,); the least of equal ones."""
        labels, weights = self._checked(labels), self._weights(areas)
        label_values, label_number = np.unique(labels, return_inverse=True)
        label_matrix = sparse.csr_array((np.ones(len(label_number)), label_number, np.arange(len(label_number) + 1)))
        largest_labels: Ints = label_values[(weights @ label_matrix).toarray().argmax(axis=1)]
        return largest_labels

    def _weights(self, areas: Array) -> sparse.csr_array:
        """Weights (P, N) of means: shares times areas, or those of interpolation where few source vertices are near."""
        area_weights = self.shares @ sparse.diags_array(self._checked(areas))
        has_few = np.diff(self.shares.indptr) < LEAST_GATHERED
        rows = np.flatnonzero(has_few)[:, None]
        interpolation = _matrix(rows, self.places.corners[has_few], self.places.shares[has_few], area_weights.shape)
        return (sparse.diags_array((~has_few).astype(np.float64)) @ area_weights + interpolation).tocsr()

    def _checked(self, values: NDArray[Value]) -> NDArray[Value]:
        if np.shape(values) != (len(self._from),):
            raise WrongShape(f"the map has shape {np.shape(values)}, the source sphere has {len(self._from)} vertices.")
        return np.asarray(values)


def _matrix(rows: Ints, columns: Ints, values: Array, shape: tuple[int, int]) -> sparse.csr_array:
    """Entries (P, 3) that are not 0, those at the same place added."""
    is_nonzero = values > 0
    positions = [np.broadcast_to(entry_index, values.shape)[is_nonzero] for entry_index in (rows, columns)]
    return sparse.coo_array((values[is_nonzero], positions), shape=shape).tocsr()


def places(points: Array, faces: Faces, targets: Array) -> Places:
    """Find the places of points on a sphere.

    Parameters
    ----------
    points : (N, 3) float64
        Vertices on the unit sphere.
    faces : (M, 3) int64
        Its triangles; a few may be inside out, as on FreeSurfer's spheres.
    targets : (P, 3) float64
        Points on the unit sphere.

    Notes
    -----
    The ray from the centre through a point q meets the triangle with corners a, b, c where ``[a b c] w = q`` has no
    negative w; w over its sum are the barycentric coordinates. A point that is a vertex of the sphere gets exactly the
    value there.
    """
    _, near = cKDTree(points).query(targets, k=NEAREST_VERTICES)
    near = near.astype(np.int64)
    corners, shares = np.repeat(near[:, :1], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(targets), 1))
    vertex_faces = incident_faces(len(points), faces)
    in_blocks(_find_triangles, len(targets), *reading(points, faces, vertex_faces, near, targets), corners, shares)
    return Places(near[:, 0].copy(), corners, shares)


@kernel
def _find_triangles(start, stop, points, faces, indptr, indices, near_vertices, targets, corner_vertices, shares):
    """Write the corners and shares (P, 3) of the triangle around ``near_vertices`` (P, K) that holds each point."""
    for i in range(start, stop):
        q, best_share = position(targets, i), -np.inf
        for k in range(near_vertices.shape[1]):
            for e in range(indptr[near_vertices[i, k]], indptr[near_vertices[i, k] + 1]):
                a, b, c = corners(points, faces, indices[e])
                u, v, w = dot(q, cross(b, c)), dot(q, cross(c, a)), dot(q, cross(a, b))
                volume_sum = u + v + w
                if volume_sum == 0.0 or dot(a, q) + dot(b, q) + dot(c, q) <= 0.0:  # on the other side of the sphere
                    continue
                u, v, w = u / volume_sum, v / volume_sum, w / volume_sum
                least_share = min(u, v, w)
                if least_share > best_share:
                    best_share = least_share
                    if least_share >= LEAST_SHARE:
                        u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
                        volume_sum = u + v + w
                        shares[i, 0], shares[i, 1], shares[i, 2] = u / volume_sum, v / volume_sum, w / volume_sum
                        for corner in range(3):
                            corner_vertices[i, corner] = faces[indices[e], corner]
