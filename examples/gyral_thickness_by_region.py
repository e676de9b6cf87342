"""Gyral thickness by region, beside cortical thickness.

The width of a gyrus from wall to wall, both cortices and the white matter between them, is another measure than the
thickness of the cortex. Regions come from the subject's own annotation.
"""

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf

cortex = mf.read_cortex(mf.sample_path("fsaverage5"), hemi="lh")
measures = mf.measure(cortex)
regions = [row for row in measures.regions if row["gyral_thickness_mm"] is not None]
cortical, gyral, file = (
    np.array([row[column] for row in regions])
    for column in ("cortical_thickness_mm", "gyral_thickness_mm", "thickness_file_mm")
)

figure, ax = plt.subplots(figsize=(6, 4.5))
ax.plot(cortical, gyral, "o")
for row in regions[::8]:
    ax.annotate(f" {row['region']}", (row["cortical_thickness_mm"], row["gyral_thickness_mm"]), fontsize=7)
ax.set(xlabel="cortical thickness [mm]", ylabel="gyral thickness [mm]", title="regions of an average brain")
figure.savefig("gyral_thickness_by_region.png", dpi=110)

measured, known = float(cortical.mean()), float(file.mean())
print(f"mean cortical thickness of regions: {measured:.2f} mm; FreeSurfer's file: {known:.2f} mm")
