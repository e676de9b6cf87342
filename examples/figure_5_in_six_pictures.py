"""Figure 5 of the paper in six pictures.

One eighth of the sphere of Fig. 5 (T = 2, C = 50, a cortex twice as stiff as the core) grows on a coarse mesh, and is
mirrored to the whole. Until it wrinkles, its radius is that of the paper's Eq. (11).
"""

import numpy as np
from PIL import Image

import morphofold as mf
from morphofold.analysis import curvature
from morphofold.quantities import quantity
from morphofold.report.pictures.surfaces import Row, figure
from morphofold.sim import theory

settings = ["geometry.portion=octant", "accuracy.level=draft"]
sphere = mf.simulate("fig5", "fig5", settings=settings)

rows = []
for g in sphere.stages:
    pial = sphere.cortex(g).pial
    rows.append(Row(f"g = {g:g}", pial, curvature(pial.verts, pial.faces).H))
Image.fromarray(figure(rows, quantity("H"), (-0.3, 0.3), ["lateral"], transposed=True)).save(
    "figure_5_in_six_pictures.png"
)

measured = float(np.linalg.norm(sphere.cortex(sphere.stages[0]).pial.verts, axis=1).mean())
known = 48 * float(theory.deformed_radius(sphere.stages[0], 50 / 48))
print(f"radius at g = {sphere.stages[0]:g}: {measured:.2f} mm; Eq. (11): {known:.2f} mm")
