"""Spheres whose triangles are irregular."""

import numpy as np
from scipy.spatial import ConvexHull

from morphofold.geometry import face_vectors
from morphofold.shapes import icosphere
from morphofold.surface import Faces, Verts


def irregular_sphere(
    level: int, radius: float = 1.0, *, jitter: float = 0.45, rng: np.random.Generator | int = 0
) -> tuple[Verts, Faces]:
    """Sphere as :func:`icosphere`, with vertices moved at random along the sphere and triangulated again.

    Each vertex moves by up to ``jitter`` mean edges along each of three axes before it returns to the sphere. The
    faces are the Delaunay triangulation on the sphere (the convex hull), in random order of corners. At 0.45 the
    smallest angle is about one degree. ``rng`` is a generator or a seed.
    """
    rng = np.random.default_rng(rng)
    verts, _ = icosphere(level)
    edge_length = (16 * np.pi / 3**0.5 / (2 * len(verts) - 4)) ** 0.5  # of equilateral triangles of that area
    verts = verts + rng.uniform(-jitter * edge_length, jitter * edge_length, verts.shape)
    verts /= np.linalg.norm(verts, axis=1, keepdims=True)
    return verts * radius, spherical_delaunay(verts)


def spherical_delaunay(verts: Verts) -> Faces:
    """Delaunay triangulation (M, 3) of unit directions (N, 3) around the sphere, counter-clockwise from outside."""
    faces = ConvexHull(verts).simplices.astype(np.int64)
    is_inward = np.sum(face_vectors(verts, faces) * verts[faces[:, 0]], axis=1) < 0
    faces[is_inward] = faces[is_inward][:, ::-1]
    return faces
