"""Octants of hollow balls of tetrahedra, and their mirror images, for tests of bodies from files."""

import meshio
import numpy as np

from morphofold.sim.mesh.from_file import bilayer_from_file
from morphofold.sim.scene import MeshFile

R, HOLE, T = 50.0, 25.0, 6.0


def tets_between(levels, faces):
    """Points and conforming tetrahedra of layers of prisms between surfaces (L, S, 3) with the same faces."""
    a, b, c = np.sort(faces, axis=1).T  # each prism is cut by the order of its columns
    S, tets = len(levels[0]), []
    for k in range(len(levels) - 1):
        o, u = k * S, (k + 1) * S
        tets += [
            np.stack(t, axis=1)
            for t in ((o + a, o + b, o + c, u + c), (o + a, o + b, u + b, u + c), (o + a, u + a, u + b, u + c))
        ]
    return np.concatenate(levels), np.concatenate(tets)


def octant(n=6):
    """An octant of a hollow ball, x, y, z >= 0: points, and tetrahedra in seven layers, three of them the cortex."""
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    number = {at: k for k, at in enumerate(zip(i.tolist(), j.tolist()))}
    faces = [[number[a, b], number[a + 1, b], number[a, b + 1]] for a, b in number if a + b < n]
    faces += [[number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]] for a, b in number if a + b < n - 1]
    verts = np.column_stack([i, j, n - i - j]) / n
    verts = verts / np.linalg.norm(verts, axis=1, keepdims=True)
    radii = [R - T * s for s in (0, 1 / 3, 2 / 3, 1)] + [R - T - (R - T - HOLE) * s for s in (0.2, 0.45, 0.7, 1.0)]
    return tets_between([r * verts for r in radii], np.array(faces))


def mirrored(points, tets, axes=(0, 1, 2)):
    """The body with its mirror images at coordinate 0 of some axes; points on a plane are shared."""
    for axis in axes:
        off = np.flatnonzero(points[:, axis] != 0)
        image = np.arange(len(points))
        image[off] = len(points) + np.arange(len(off))
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        points, tets = np.concatenate([points, points[off] * sign]), np.concatenate([tets, image[tets]])
    return points, tets


def boundary(tets):
    """Faces (F, 3) that one tetrahedron has."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    return unique[count == 1]


def written(path, points, tets, point_data=None, cell_data=None, triangles=None, labels=None):
    """Write a body; ``cell_data`` are of the tetrahedra, ``labels`` (cell data ``facet``) of the ``triangles``."""
    cells, data = [("tetra", tets)], {name: [values] for name, values in (cell_data or {}).items()}
    if triangles is not None:
        cells.append(("triangle", triangles))
        data = {name: [*values, np.zeros(len(triangles), dtype=np.int64)] for name, values in data.items()}
        data["facet"] = [np.zeros(len(tets), dtype=np.int64), labels]
    meshio.Mesh(points, cells, point_data=point_data or {}, cell_data=data).write(path)
    return path


def geometry(path, **options):
    return MeshFile(shape="mesh", file=str(path), **{"cortex_thickness": T, **options})


def bilayer(path, **options):
    return bilayer_from_file(geometry(path, **options))
