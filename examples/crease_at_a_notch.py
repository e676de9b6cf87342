"""A crease grows from a notch.

A homogeneous block that grows between walls can crease once g^3 = 2.4 (Hong, Zhao and Suo 2009), but a smooth surface
stays smooth until Biot's 3.383. A shallow notch is what a crease needs to begin in between.
"""

import matplotlib.pyplot as plt
import numpy as np

import morphofold as mf
from morphofold.sim import theory

history = []


def depth_of_notch(run):
    """Growth, and how far the surface at the notch is below the highest point."""
    z = run.state.x[: run.body.n_surface, 2]
    history.append((run.state.growth, z.max() - z.min()))


settings = ["accuracy.edge=0.5", "output.stages=[]", "growth.final=1.45", "effects.core_growth.final=1.45"]
block = mf.simulate("crease", "crease", settings=settings, after=depth_of_notch)

growth, depth = np.array(history).T
figure, ax = plt.subplots(figsize=(6, 4))
ax.plot(growth, depth, label="depth of the groove")
ax.axvline(theory.CREASE ** (1 / 3), color="C1", label="a crease can form (g³ = 2.4)")
ax.axvline(theory.BIOT ** (1 / 3), color="C3", label="a smooth surface wrinkles (g³ = 3.383)")
ax.set(xlabel="growth g", ylabel="mm")
ax.legend()
figure.savefig("crease_at_a_notch.png", dpi=110)

thickness = block.scene.geometry.cortex_thickness
measured = float(np.interp(thickness / 2, depth, growth))
known = theory.CREASE ** (1 / 3)
print(f"the groove is half a thickness deep at g = {measured:.3f}; a crease can form from {known:.3f}")
