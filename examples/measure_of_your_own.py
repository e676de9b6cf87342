"""A measure of your own: the surface ratio.

How much more surface than a flat one lies within a ball around each vertex (Toro and others 2008). On a sphere the
ratio is 1, whatever the sphere's radius: a cap has the area of the disc.
"""

import numpy as np
from scipy.spatial import cKDTree

import morphofold as mf
from morphofold.analysis import vertex_areas
from morphofold.shapes import icosphere


def surface_ratio(verts, faces, radius=20.0):
    """Area within a ball around each vertex over that of a disc, (N,)."""
    area = vertex_areas(verts, faces)
    near = cKDTree(verts).query_ball_point(verts, radius)
    return np.array([area[within].sum() for within in near]) / (np.pi * radius**2)


cortex = mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh")
ratio = surface_ratio(cortex.pial.verts, cortex.faces)
mf.Measures(cortex, {}, {"surface_ratio": ratio}).plot("surface_ratio").save("measure_of_your_own.png")

measured, known = float(surface_ratio(*icosphere(5, 50.0)).mean()), 1.0
print(f"a sphere {measured:.3f}; an average brain {ratio.mean():.2f}")
