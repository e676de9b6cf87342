"""Growth by a map: one pole grows twice as much as the other.

``effects.growth_map`` takes a value for each vertex of a sphere, here the factor on g - 1: 4/3 at one pole and 2/3 at
the other. A map from data works in the same way: an area ratio, a thickness, the expression of a gene.
"""

import numpy as np

import morphofold as mf
from morphofold.geometry import vertex_areas
from morphofold.io import write_morph, write_surface
from morphofold.shapes import icosphere

points, faces = icosphere(4)
factor = 1 + points[:, 2] / 3
write_surface("sphere.surf.gii", mf.Surface(points, faces))
write_morph("factor.txt", factor)

growth = 1.15
settings = [
    *("geometry.portion=full", "accuracy.edge=4.0", f"growth.final={growth}", "output.stages=[1.001]"),
    "effects={growth_map={file='factor.txt', sphere='sphere.surf.gii', degree=4}}",
]
sphere = mf.simulate("demo", "grown", settings=settings)
before, after = (sphere.cortex(g) for g in sphere.stages)

thickness = [np.linalg.norm(c.pial.verts - c.white.verts, axis=1) for c in (before, after)]
area = [vertex_areas(c.pial.verts, c.faces) for c in (before, after)]
volume_ratio = (thickness[1] * area[1]) / (thickness[0] * area[0])
cortex = mf.Cortex(after.white, after.pial, "lh", "a map of growth")
mf.Measures(cortex, {}, {"grown": volume_ratio}).plot("grown", views=["lateral"]).save("growth_by_a_map.png")

z = before.pial.verts[:, 2] / np.linalg.norm(before.pial.verts, axis=1)
measured = float(volume_ratio[z > 0.9].mean() / volume_ratio[z < -0.9].mean())
top, bottom = (1 + (growth - 1) * factor[cap].mean() for cap in (points[:, 2] > 0.9, points[:, 2] < -0.9))
known = float(top**3 / bottom**3)
print(f"volume of the cortex, one pole over the other: {measured:.3f}; the map asks for {known:.3f}")
