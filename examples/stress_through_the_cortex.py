"""Stress through the growing cortex, Fig. 3(b) of the paper.

Before anything folds, the sphere is a problem in one dimension, which the paper's equations solve for an
incompressible body. The thinner the cortex, the more it is compressed.
"""

import matplotlib.pyplot as plt
import numpy as np

from morphofold.sim import theory

figure, ax = plt.subplots(figsize=(6, 4))
for thickness in (1.0, 2.0, 3.0):
    found = theory.stresses(1.5, 50 - thickness, 50)
    depth = (found.r - found.r.min()) / np.ptp(found.r)
    ax.plot(depth, found.sigma_theta, label=f"T = {thickness:g}")
ax.set(xlabel="place in the cortex, from white to pial", ylabel="hoop stress over the core's shear modulus")
ax.legend()
figure.savefig("stress_through_the_cortex.png", dpi=110)

stretch = 1.5 * 50 / (48 * float(theory.deformed_radius(1.5, 50 / 48)))  # of growth over that of the outer surface
measured = float(theory.stresses(1.5, 48, 50).sigma_theta[-1])
known = stretch**-2 - stretch**4  # a free surface, neo-Hookean: squares of the two elastic stretches
print(f"hoop stress at the pial surface: {measured:.3f}; from its stretch alone: {known:.3f}")
