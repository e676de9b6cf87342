"""Local gyrification index, without MATLAB.

Pial area within 25 mm of each vertex over the area there of an outer surface that spans the sulci. On a sphere it is
1 everywhere. The command line gives the same map: ``morphofold analyze SUBJECT -o OUT`` writes
``OUT/maps/lh.local_gyrification_index``.
"""

import morphofold as mf
from morphofold.analysis import local_gyrification_index
from morphofold.shapes import icosphere

cortex = mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh")
index = local_gyrification_index(cortex.pial.verts, cortex.faces)
mf.Measures(cortex, {}, {"local_gyrification_index": index}).plot("local_gyrification_index").save(
    "local_gyrification.png"
)
print(f"an average brain: {index.min():.2f} to {index.max():.2f}")

measured = float(local_gyrification_index(*icosphere(5, 50.0)).mean())
known = 1.0
print(f"a sphere: {measured:.4f}")
