"""A small smooth imperfection: without one, folds would follow the symmetries of the mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphofold.sim.mesh import Bilayer

WAVES = 200
SPREAD = 0.3            # wave numbers lie within this share of the degree


def perturbed_nodes(bilayer: Bilayer, *, amplitude: float, degree: float, seed: int) -> NDArray[np.float64]:
    """Reference positions with a cortex whose thickness varies by a random smooth field.

    Parameters
    ----------
    amplitude : float
        Root mean square of the field, as a share of the cortical thickness.
    degree : float
        Waves per turn around the sphere; plane waves of random direction and phase have
        ``|k| radius = degree (1 +- 0.3)``.
    seed : int
        The field is a function of position and seed alone, so meshes of any size carry the same one.

    Returns
    -------
    X : (N, 3) float64
        The pial surface moves radially by the field, the white surface not at all, linear in between [mm].
    """
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal((WAVES, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    wave = axis * (degree * (1 + SPREAD * rng.uniform(-1, 1, WAVES)))[:, None]
    phase = rng.uniform(0, 2 * np.pi, WAVES)
    X = np.array(bilayer.mesh.p.T)
    outer, inner = bilayer.radii[0], bilayer.radii[bilayer.cortex_layers]
    direction = X[bilayer.layer(0)] / outer
    field = np.sqrt(2 / WAVES) * np.cos(direction @ wave.T + phase).sum(axis=1)
    for level in range(bilayer.cortex_layers):
        share = (bilayer.radii[level] - inner) / (outer - inner)
        X[bilayer.layer(level)] += (amplitude * (outer - inner) * share * field)[:, None] * direction
    return X
