"""Curvature of a torus, for which it is known.

Curvature is fitted to the surface within a given radius in mm, so that it does not change when the mesh is refined.
Convex is positive: the outside of a torus has mean curvature (1/r + 1/(R + r)) / 2.
"""

import numpy as np

import morphofold as mf
from morphofold.analysis import curvature

R, r, n_around, n_across = 30.0, 10.0, 240, 80
u, v = np.meshgrid(np.arange(n_around), np.arange(n_across), indexing="ij")
a, b = 2 * np.pi * u.ravel() / n_around, 2 * np.pi * v.ravel() / n_across
points = np.column_stack([(R + r * np.cos(b)) * np.cos(a), (R + r * np.cos(b)) * np.sin(a), r * np.sin(b)])
number = lambda i, j: ((i % n_around) * n_across + j % n_across).ravel()
corners = [number(u, v), number(u + 1, v), number(u + 1, v + 1), number(u, v + 1)]
faces = np.concatenate([np.column_stack([corners[k] for k in triangle]) for triangle in ((0, 1, 2), (0, 2, 3))])

H = curvature(points, faces, scale=2.0).H
torus = mf.Cortex.of_surface(mf.Surface(points, faces), "lh", name="torus")
mf.Measures(torus, {}, {"H": H}).plot("H", views=["top", "front"]).save("curvature_of_a_torus.png")

measured = float(H[b == 0].mean())
known = (1 / r + 1 / (R + r)) / 2
print(f"mean curvature at the outside: {measured:.5f} 1/mm; exactly {known:.5f}")
