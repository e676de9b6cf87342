"""Readable twins of the measuring room's kernels: the same mathematics in plain NumPy, one vertex at a time."""

from math import factorial

import numpy as np
from scipy.special import lpmv


def vertex_areas(verts, faces):
    """One third of every incident triangle, by Heron's formula."""
    area = np.zeros(len(verts))
    for face in faces:
        a, b, c = (np.linalg.norm(verts[face[k]] - verts[face[k - 1]]) for k in range(3))
        s = (a + b + c) / 2
        for vertex in face:
            area[vertex] += np.sqrt(s * (s - a) * (s - b) * (s - c)) / 3
    return area


def face_vectors(verts, faces):
    """Half the cross product of two sides of each triangle."""
    a, b, c = (verts[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def distance_to_planes(verts, planes):
    """Least distance of each vertex to the planes (P, 4), all of them tried; n . x + d is below 0 inside."""
    return np.maximum((-verts @ planes[:, :3].T - planes[:, 3]).min(axis=1), 0)


def principal_curvatures(verts, normals, neighbours, i, scale, facing=0.2):
    """k1, k2 and the direction of k1 at vertex i, as ``morphofold.analysis.curvature`` defines them.

    ``neighbours`` is a list of lists. The neighbourhood does not grow, the fit is always cubic.
    """
    near, new = {i}, [i]
    while new:
        new = [
            w
            for v in new
            for w in neighbours[v]
            if w not in near and np.linalg.norm(verts[w] - verts[i]) < scale and normals[w] @ normals[i] > facing
        ]
        near.update(new)
    near = sorted(near)

    n = normals[i]
    t1 = np.cross(n, np.eye(3)[np.argmin(abs(n))])
    t1 /= np.linalg.norm(t1)
    t2 = np.cross(n, t1)
    away = verts[near] - verts[i]
    distance = np.linalg.norm(away, axis=1)
    powers = [(p, q) for p in range(4) for q in range(4 - p)]
    k1 = k2 = 1.0  # a first fit as on a sphere, a second in its principal frame
    for _ in range(2):
        flat, height = away @ np.stack([t1, t2], axis=1), away @ n
        g = flat * [k1, k2]  # gradient of the surface, up to its sign and length
        g *= np.sign(np.sum(g * flat, axis=1))[:, None]
        length = np.linalg.norm(g, axis=1)[:, None]
        g = np.divide(g, length, out=np.zeros_like(g), where=length > 0)
        gx = np.sum(g * flat, axis=1)
        u, v = (flat + g * (np.sqrt(gx**2 + height**2) - gx)[:, None]).T

        weight = np.sqrt(np.maximum(normals[near] @ n, 0) * (1 - distance**2 / scale**2))
        columns = np.stack([u**p * v**q for p, q in powers], axis=1)
        fit = np.linalg.lstsq(weight[:, None] * columns, weight * height, rcond=None)[0]
        a = dict(zip(powers, fit, strict=True))

        du, dv = t1 + a[1, 0] * n, t2 + a[0, 1] * n
        outward = np.cross(du, dv) / np.linalg.norm(np.cross(du, dv))
        first = np.array([[du @ du, du @ dv], [du @ dv, dv @ dv]])
        second = -np.array([[2 * a[2, 0], a[1, 1]], [a[1, 1], 2 * a[0, 2]]]) * (n @ outward)
        value, vector = np.linalg.eig(np.linalg.solve(first, second))
        high, low = np.argsort(value)[::-1]
        k1, k2, n = value[high], value[low], outward
        t1 = vector[0, high] * du + vector[1, high] * dv
        t1 /= np.linalg.norm(t1)
        t2 = np.cross(n, t1)
    return k1, k2, t1


def harmonic(directions, l, m):
    """Complex spherical harmonic of degree l and order m >= 0 at unit directions (N, 3); int |Y|^2 = 1."""
    size = np.sqrt((2 * l + 1) / (4 * np.pi) * factorial(l - m) / factorial(l + m))
    return size * lpmv(m, l, directions[:, 2]) * np.exp(1j * m * np.arctan2(directions[:, 1], directions[:, 0]))
