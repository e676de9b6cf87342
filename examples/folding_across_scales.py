"""One law across scales.

Make the cortex coarser, cube by cube, and measure what is left of its folds. Total area, exposed area and thickness
then follow a power law, with the exponent 1.25 for people as for mammals (Mota and Herculano-Houzel 2015; Wang and
others 2024).
"""

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf
from morphofold.analysis import across_scales, law_across_scales

person = mf.read_cortex(mf.sample_path("S1"), hemi="lh")
rows = across_scales(person)
law = law_across_scales(rows)

figure, ax = plt.subplots(figsize=(6, 4.5))
exposed = np.array([row.terms.exposed for row in rows])
folded = np.array([row.terms.total * row.terms.thickness**0.5 for row in rows])
ax.loglog(exposed, folded, "o")
ax.set(xlabel="exposed area [mm²]", ylabel="total area x thickness$^{1/2}$ [mm$^{5/2}$]", title="S1, left hemisphere")
figure.savefig("folding_across_scales.png", dpi=110)

measured, known = law.exponent, 1.25
print(f"exponent of one person's cortex across scales: {measured:.3f}; of mammals: {known}")
