"""One law across scales.

Make the cortex coarser, cube by cube, and measure what is left of its folds. Total area, exposed area and thickness
then follow the folding law of mammals (Mota and Herculano-Houzel 2015; Wang and others 2024): total over exposed area
to the power 5/4 falls with the thickness to the power 1/2. A body without folds hardly changes.
"""

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf
from morphofold.analysis import across_scales, law_across_scales

person = mf.read_cortex(mf.sample_path("S1"), hemi="lh")
rows = across_scales(person)
law = law_across_scales(rows)

cubes = [row.terms for row in rows if row.scale > 0]  # without the cortex as it is
thickness = np.array([terms.thickness for terms in cubes])
folding = np.array([terms.total / terms.exposed**1.25 for terms in cubes])

figure, ax = plt.subplots(figsize=(6, 4.5))
ax.loglog(thickness, folding, "o", label="S1, left hemisphere, made of cubes")
ax.loglog(thickness, folding[0] * (thickness / thickness[0]) ** -0.5, label="power -1/2")
ax.set(xlabel="thickness [mm]", ylabel="total area / exposed area$^{5/4}$ [mm$^{-1/2}$]")
ax.legend()
figure.savefig("folding_across_scales.png", dpi=110)

measured, known = law.exponent, -0.5
print(f"exponent of one person's cortex across scales: {measured:.2f}; of the law: {known}")
