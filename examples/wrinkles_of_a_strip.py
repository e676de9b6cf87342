"""A strip wrinkles when theory says so.

A stiff layer that grows on a soft core stays flat until it loses its stability. Linear stability of a sphere whose
cortex is very thin beside its radius gives that growth; the finite elements of a strip lose their stability at nearly
the same one.
"""

import matplotlib.pyplot as plt

import morphofold as mf
from morphofold.sim import theory
from morphofold.sim.equilibrium.statics import bifurcation_of_scene
from morphofold.sim.scene.scene_files import load_scene

settings = ["geometry.length=40", "accuracy.edge=1.0", "growth.final=1.5", "output.stages=[1.2, 1.3, 1.4]"]
strip = mf.simulate("strip", "strip", settings=settings)

figure, axes = plt.subplots(len(strip.stages), sharex=True, sharey=True, figsize=(6, 7))
for ax, g in zip(axes, strip.stages):
    cortex = strip.cortex(g)
    for surface, colour in (("pial", "C3"), ("white", "C0")):
        points = cortex.surface(surface).verts
        side = points[points[:, 1] < 1e-6]  # one side of the strip, which is one brick deep
        ax.plot(*side[side[:, 0].argsort()][:, [0, 2]].T, colour)
    ax.set(title=f"g = {g:g}", aspect="equal", ylabel="mm")
figure.tight_layout()
figure.savefig("wrinkles_of_a_strip.png", dpi=110)

measured = bifurcation_of_scene(load_scene("strip", settings)).g_crit
known = theory.bifurcation(0.01, mu_ratio=2.0, kappa_ratio=50.0).g_crit
print(f"the mesh of the strip loses its stability at g = {measured:.3f}; theory: {known:.3f}")
