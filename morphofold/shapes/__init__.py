"""Triangle meshes of regular spheres, and evenly spread directions."""

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.geometry import split
from morphofold.surface import Faces, Verts


def icosphere(level: int, radius: float = 1.0) -> tuple[Verts, Faces]:
    """Sphere from an icosahedron; its triangles are split in four ``level`` times.

    Returns
    -------
    verts : (10 * 4**level + 2, 3) float64
    faces : (20 * 4**level, 3) int64
    """
    phi = (1 + 5**0.5) / 2
    verts = np.array([[-1, phi, 0], [1, phi, 0], [-1, -phi, 0], [1, -phi, 0], [0, -1, phi], [0, 1, phi],
                      [0, -1, -phi], [0, 1, -phi], [phi, 0, -1], [phi, 0, 1], [-phi, 0, -1], [-phi, 0, 1]])  # fmt: skip
    verts /= np.linalg.norm(verts[0])
    faces = np.array([[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
                      [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
                      [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]])  # fmt: skip
    for _ in range(level):
        n_old = len(verts)
        verts, faces = split(verts, faces)
        verts[n_old:] /= np.linalg.norm(verts[n_old:], axis=1, keepdims=True)
    return verts * radius, faces.astype(np.int64)


def even_directions(n: int) -> Array:
    """Unit directions (n, 3), evenly spread over the whole sphere (Fibonacci lattice).

    No two of them are mirror images across a coordinate plane: on a sphere mirrored from an octant they are n different
    places of the octant.
    """
    index = np.arange(n) + 0.5
    z, angle = 1 - 2 * index / n, np.pi * (1 + 5**0.5) * index
    rho = np.sqrt(1 - z * z)
    return np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
