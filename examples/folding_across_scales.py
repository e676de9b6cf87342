"""One law across scales.

Make the cortex coarser, cube by cube, and measure what is left of its folds. Total area, exposed area and thickness
then follow a power law, with the slope 1.25 for people as for mammals (Mota and Herculano-Houzel 2015; Wang and
others 2024).
"""

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf
from morphofold.analysis import across_scales, law_across_scales

person = mf.read_cortex(mf.sample_path("S1"), hemi="lh")
rows = across_scales(person)
law = law_across_scales(rows)

cubes = [row for row in rows if row.scale > 0]  # without the cortex as it is
scale = np.array([row.scale for row in cubes])
exposed = np.array([row.terms.exposed for row in cubes]) / scale**2
folded = np.array([row.terms.total * row.terms.thickness**0.5 for row in cubes]) / scale**2.5

figure, ax = plt.subplots(figsize=(6, 4.5))
ax.loglog(exposed, folded, "o")
ax.set(
    xlabel="exposed area / scale²", ylabel="total area x thickness$^{1/2}$ / scale$^{5/2}$", title="S1, left hemisphere"
)
figure.savefig("folding_across_scales.png", dpi=110)

measured, known = law.slope, 1.25
print(
    f"slope of one person's cortex across scales: {measured:.3f}; of mammals: {known}; a shell without folds has 1.17"
)
