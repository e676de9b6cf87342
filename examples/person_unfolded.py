"""A hemisphere, unfolded.

Heat flow on the sphere of a FreeSurfer subject smooths its white surface until no sulcus is left, vertex by vertex
the same. The smooth surface is where a simulation of this hemisphere begins. Its area is that of its convex hull, to a
percent.
"""

import matplotlib.pyplot as plt

import morphofold as mf
from morphofold.analysis import gyrification_index
from morphofold.unfolding.unfold import unfold

cortex = mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh")
smooth = unfold(cortex.white, cortex.sphere).smooth()

figure, axes = plt.subplots(1, 2, subplot_kw={"projection": "3d"}, figsize=(8, 4))
for ax, surface, title in zip(axes, (cortex.white, smooth), ("white surface", "unfolded")):
    ax.plot_trisurf(*surface.verts.T, triangles=surface.faces, color="0.8", edgecolor="none")
    ax.set(title=title, aspect="equal")
    ax.view_init(elev=0, azim=180)
    ax.set_axis_off()
figure.tight_layout()
figure.savefig("person_unfolded.png", dpi=110)

folded = gyrification_index(cortex.white.verts, cortex.faces)
measured = gyrification_index(smooth.verts, smooth.faces)
known = 1.0  # of a convex surface
print(f"area over that of the convex hull: {folded:.2f} folded, {measured:.3f} unfolded")
