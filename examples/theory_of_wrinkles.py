"""When, and how wide, a sphere wrinkles.

Linear stability of the growing sphere gives the growth at which it wrinkles and the length of the waves, for any
stiffness of the cortex. For a stiff cortex the length approaches the formula of films, 2 pi T (mu ratio / 3)^(1/3);
brains are far from that limit.
"""

import matplotlib.pyplot as plt
import numpy as np

from morphofold.sim import theory

T_over_C = 0.002  # a thin cortex on a large body
ratios = np.geomspace(1, 300, 12)
found = [theory.bifurcation(T_over_C, mu_ratio=float(ratio)) for ratio in ratios]
wavelength = np.array([f.wavelength for f in found]) / T_over_C
film = 2 * np.pi * (ratios / 3) ** (1 / 3)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
left.semilogx(ratios, [f.g_crit for f in found], "o-")
left.set(xlabel="shear modulus of the cortex over that of the core", ylabel="growth g of the first wrinkles")
right.loglog(ratios, wavelength, "o-", label="linear stability")
right.loglog(ratios, film, "--", label="formula of films")
right.set(xlabel="shear modulus of the cortex over that of the core", ylabel="wavelength / T")
right.legend()
figure.tight_layout()
figure.savefig("theory_of_wrinkles.png", dpi=110)

measured, known = float(wavelength[-1]), float(film[-1])
print(f"waves of a cortex 300 times as stiff: {measured:.1f} T; formula of films: {known:.1f} T")
