"""The same cortex in nilearn.

``Cortex.to_nilearn`` gives nilearn's own objects, so that its plots, and all that takes a ``SurfaceImage``, go on
from here.
"""

import numpy as np
from nilearn.plotting import plot_surf

import morphofold as mf

cortex = mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh")
measures = mf.measure(cortex, only=["cortical_thickness"])
image = cortex.to_nilearn(measures.maps["cortical_thickness"])

figure = plot_surf(image.mesh, image, hemi="left", view="lateral", cmap="viridis", colorbar=True)
figure.savefig("nilearn_plots.png", dpi=110)

measured = float(np.nanmean(image.data.parts["left"]))
known = float(np.nanmean(measures.maps["cortical_thickness"]))
print(f"mean over the vertices: {measured:.3f} mm in nilearn, {known:.3f} mm here")
