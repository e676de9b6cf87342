"""An effect of your own: weight.

An effect is a class with the hooks that it needs. This one pulls every node of the surface down by a constant force;
a block that stands on its base, held at its sides, then sinks by pressure times height over its modulus.
"""

import matplotlib.pyplot as plt
import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import bilayer_patch


class DeadLoad(Effect):
    """A pressure on the flat top that does not turn with it, in units of the core's shear modulus."""

    name = "dead_load"

    def __init__(self, pressure):
        self.pressure = pressure

    def prepare(self, body):
        x, y = body.X[: body.n_surface, :2].T
        inside = lambda c: np.where((c == c.min()) | (c == c.max()), 0.5, 1.0)  # a border node has half of a cell
        self.share = inside(x) * inside(y)
        self.share *= np.ptp(x) * np.ptp(y) / self.share.sum()  # [mm2]

    def add_forces(self, body, x, v, extra):
        extra[: body.n_surface, 2] -= self.pressure * self.share


depth, kappa, loads, sunk = 12.0, 50.0, (0.1, 0.2, 0.4, 0.8), []
for load in loads:
    block = bilayer_patch((4.0, 4.0), depth, 3.0, 1.0)  # 4 x 4 x 12 mm, 3 mm of it cortex, edges of 1 mm
    body = Body(block, mu_cortex=1.0, mu_core=1.0, kappa_ratio=kappa, law="isotropic")
    run = Dynamics(body, [DeadLoad(load)], steps_per_unit=1500)
    run.relax(7200)
    sunk.append(float((body.X - run.state.x)[: body.n_surface, 2].mean()))

figure, ax = plt.subplots(figsize=(6, 4))
ax.plot(loads, sunk, "o", label="simulated")
ax.plot(loads, np.array(loads) * depth / (kappa + 4 / 3), label="pressure x height / (κ + 4μ/3)")
ax.set(xlabel="pressure / μ", ylabel="sunk by [mm]")
ax.legend()
figure.savefig("effect_of_your_own.png", dpi=110)

measured, known = sunk[0], loads[0] * depth / (kappa + 4 / 3)
print(f"sunk by {measured:.5f} mm; linear elasticity: {known:.5f} mm")
