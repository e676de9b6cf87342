"""A material of your own.

Tissue stiffens as it is stretched. Demiray's exponential law is a class with an energy and its derivatives; the
solver's stresses follow. A file ``sim/materials/demiray.py`` makes it a material for scenes.
"""

from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from morphofold.sim.materials.elastic import stress


class Demiray(NamedTuple):
    """u = (exp(a (i1 - 3)) - 1) / 2a (Demiray 1972, J. Biomech. 5, 309)."""

    a: float
    uses_i2 = False

    def energy(self, i1, i2):
        return (np.exp(self.a * (i1 - 3.0)) - 1.0) / (2.0 * self.a)

    def slopes(self, i1, i2):
        return 0.5 * np.exp(self.a * (i1 - 3.0)), 0.0

    def curvatures(self, i1, i2):
        return 0.5 * self.a * np.exp(self.a * (i1 - 3.0)), 0.0, 0.0


def pulling_force(material, stretch):
    """Of an incompressible bar, per area before, over the shear modulus."""
    P = stress(np.diag([stretch, stretch**-0.5, stretch**-0.5]), 1.0, 0.0, material)
    return P[0, 0] - P[1, 1] * stretch**-1.5


stretches, a = np.linspace(0.7, 1.6, 50), 2.0
figure, ax = plt.subplots(figsize=(6, 4))
ax.plot(stretches, [pulling_force(Demiray(a), l) for l in stretches], label="Demiray, a = 2")
ax.plot(stretches, stretches - stretches**-2, label="neo-Hookean")
ax.set(xlabel="stretch", ylabel="force per area / μ")
ax.legend()
figure.savefig("material_of_your_own.png", dpi=110)

measured, known = pulling_force(Demiray(a), 1.4), (1.4 - 1.4**-2) * np.exp(a * (1.4**2 + 2 / 1.4 - 3))
print(f"force at a stretch of 1.4: {measured:.4f}; exactly {known:.4f}")
