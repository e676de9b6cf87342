"""Places of points in the triangles of a sphere, and values there by linear interpolation."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Ints
from morphofold.geometry import corners, cross, dot, incident_faces, position
from morphofold.kernels import kernel, reading
from morphofold.surface import Faces
from morphofold.threads import in_blocks

NEAREST_VERTICES = 4  # around a point, whose triangles are searched
OUTSIDE = -1e-9  # least share of a corner with which a point is still in a triangle

T = TypeVar("T", bound=np.generic)


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

    def of_nearest(self, values: NDArray[T]) -> NDArray[T]:
        """Labels, or any values (N, ...), of the nearest vertex: (P, ...)."""
        return values[self.nearest]

    def values(self, values: Array) -> Array:
        """Values (N,) by linear interpolation in the triangle (P,); those of the nearest vertex beside a NaN."""
        corner = np.asarray(values, dtype=np.float64)[self.corners]
        known = np.isfinite(corner).all(axis=1)
        found = np.asarray(values, dtype=np.float64)[self.nearest]
        found[known] = np.sum(corner[known] * self.shares[known], axis=1)
        return found


def places(points: Array, faces: Faces, to: Array) -> Places:
    """Find the places of points on a sphere.

    Parameters
    ----------
    points : (N, 3) float64
        Vertices on the unit sphere.
    faces : (M, 3) int64
        Its triangles; a few may be inside out, as on FreeSurfer's spheres.
    to : (P, 3) float64
        Points on the unit sphere.

    Notes
    -----
    The ray from the centre through a point q meets the triangle with corners a, b, c where ``[a b c] w = q`` has no
    negative w; w over its sum are the barycentric coordinates. A point that is a vertex of the sphere gets exactly the
    value there.
    """
    _, near = cKDTree(points).query(to, k=NEAREST_VERTICES)
    near = near.astype(np.int64)
    inside, shares = np.repeat(near[:, :1], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(to), 1))
    ring = incident_faces(len(points), faces)
    in_blocks(_find_triangles, len(to), *reading(points, faces, ring, near, to), inside, shares)
    return Places(near[:, 0].copy(), inside, shares)


@kernel
def _find_triangles(start, stop, points, faces, indptr, indices, near, to, inside, shares):
    """Write the corners and shares (P, 3) of the triangle around the ``near`` (P, K) vertices that holds each point."""
    for i in range(start, stop):
        q, best = position(to, i), -np.inf
        for k in range(near.shape[1]):
            for e in range(indptr[near[i, k]], indptr[near[i, k] + 1]):
                a, b, c = corners(points, faces, indices[e])
                u, v, w = dot(q, cross(b, c)), dot(q, cross(c, a)), dot(q, cross(a, b))
                total = u + v + w
                if total == 0.0 or dot(a, q) + dot(b, q) + dot(c, q) <= 0.0:  # on the other side of the sphere
                    continue
                u, v, w = u / total, v / total, w / total
                least = min(u, v, w)
                if least > best:
                    best = least
                    if least >= OUTSIDE:
                        u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
                        total = u + v + w
                        shares[i, 0], shares[i, 1], shares[i, 2] = u / total, v / total, w / total
                        for r in range(3):
                            inside[i, r] = faces[indices[e], r]
