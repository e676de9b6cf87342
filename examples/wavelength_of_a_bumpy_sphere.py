"""The wavelength of folds, from their spectrum.

Heights of a surface as a sum of spherical harmonics show at which lengths it folds. Here the height is one harmonic,
so its degree is known.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import sph_harm_y

from morphofold.analysis import power_spectrum
from morphofold.shapes import icosphere

degree, order = 18, 7
points, faces = icosphere(5)
polar, azimuth = np.arccos(points[:, 2]), np.arctan2(points[:, 1], points[:, 0])
height = sph_harm_y(degree, order, polar, azimuth).real + 0.02 * np.random.default_rng(0).normal(size=len(points))

spectrum = power_spectrum(points, faces, height, last=40)

figure, ax = plt.subplots(figsize=(6, 4))
ax.semilogy(np.arange(1, 41), spectrum.power[1:])
ax.set(xlabel="degree l of the harmonic", ylabel="power of the height")
figure.savefig("wavelength_of_a_bumpy_sphere.png", dpi=110)

measured, known = int(np.argmax(spectrum.power)), degree
print(f"most power at degree {measured}; the height is a harmonic of degree {known}")
