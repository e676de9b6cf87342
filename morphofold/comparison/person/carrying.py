"""Values and labels carried from the vertices of one surface to those of another on the same sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.arrays import Array, Ints
from morphofold.geometry import incident_faces
from morphofold.surface import Faces

NEAREST_VERTICES = 4  # around a point, whose triangles are searched
OUTSIDE = -1e-9  # least share of a corner with which a point is still in a triangle
POINTS_AT_ONCE = 4096  # bounds the memory

Any_ = TypeVar("Any_", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Carrier:
    """Places of P target points on a source of N vertices.

    Attributes
    ----------
    nearest : (P,) int64
        Nearest vertex of the source.
    corners : (P, 3) int64
        Corners of the triangle of the source that holds the point; three times the nearest vertex if none does.
    shares : (P, 3) float64
        Barycentric coordinates in that triangle; they sum to 1.
    """

    nearest: Ints
    corners: Ints
    shares: Array

    def labels(self, values: NDArray[Any_]) -> NDArray[Any_]:
        """Labels, or any values (N, ...), of the nearest vertex: (P, ...)."""
        return values[self.nearest]

    def values(self, values: Array) -> Array:
        """Values (N,) by linear interpolation in the triangle (P,); those of the nearest vertex beside a NaN."""
        corner = np.asarray(values, dtype=np.float64)[self.corners]
        known = np.isfinite(corner).all(axis=1)
        found = np.asarray(values, dtype=np.float64)[self.nearest]
        found[known] = np.sum(corner[known] * self.shares[known], axis=1)
        return found


def carrier(points: Array, faces: Faces, to: Array) -> Carrier:
    """Find the places of target points on a sphere with vertices.

    Parameters
    ----------
    points : (N, 3) float64
        Vertices of the source on the unit sphere.
    faces : (M, 3) int64
        Its triangles; a few may be inside out, as on FreeSurfer's spheres.
    to : (P, 3) float64
        Target points on the unit sphere.

    Notes
    -----
    The ray from the centre through a point q meets the triangle with corners a, b, c where ``[a b c] w = q`` has no
    negative w; w over its sum are the barycentric coordinates. A point that is a vertex of the source gets exactly the
    value there.
    """
    _, near = cKDTree(points).query(to, k=NEAREST_VERTICES)
    ring = incident_faces(len(points), faces)
    most = int(np.diff(ring.indptr).max())
    around = np.full((len(points), most), -1, dtype=np.int64)
    column = np.arange(len(ring.indices)) - np.repeat(ring.indptr[:-1], np.diff(ring.indptr))
    around[np.repeat(np.arange(len(points)), np.diff(ring.indptr)), column] = ring.indices
    corners, shares = np.repeat(near[:, :1], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(to), 1))
    for start in range(0, len(to), POINTS_AT_ONCE):
        part = slice(start, start + POINTS_AT_ONCE)
        _place(points, faces, around[near[part]].reshape(-1, NEAREST_VERTICES * most), to[part], part, corners, shares)
    return Carrier(near[:, 0].astype(np.int64), corners.astype(np.int64), shares)


def _place(points: Array, faces: Faces, candidates: Ints, to: Array, part: slice, corners: Any, shares: Any) -> None:
    """Fill ``corners`` and ``shares`` of points that lie in one of their candidate triangles (P, C), -1 for none."""
    a, b, c = np.moveaxis(points[faces[candidates]], 2, 0)
    q = np.broadcast_to(to[:, None], a.shape)
    w = np.stack([np.einsum("pci,pci->pc", q, np.cross(*side)) for side in ((b, c), (c, a), (a, b))], axis=2)
    total = w.sum(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        w = w / total[:, :, None]
    ahead = np.einsum("pci,pci->pc", a + b + c, q) > 0  # not on the other side of the sphere
    least = np.where((candidates >= 0) & ahead & np.isfinite(w).all(axis=2), w.min(axis=2), -np.inf)
    best = least.argmax(axis=1)
    row = np.arange(len(to))
    inside = least[row, best] >= OUTSIDE
    where = np.arange(part.start, part.start + len(to))[inside]
    corners[where] = faces[candidates[row, best]][inside]
    found = np.clip(w[row, best][inside], 0.0, 1.0)
    shares[where] = found / found.sum(axis=1, keepdims=True)
