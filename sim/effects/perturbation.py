"""A small smooth imperfection: without one, folds would follow the symmetries of the mesh."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np

from morphofold.arrays import Array
from morphofold.sim.effects import Effect
from morphofold.sim.equilibrium.wrinkles import first_wrinkles
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene.tables import EffectOptions, Length, key

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

WAVES = 200
LEAST = 3.0  # shortest waves by default [cortical thicknesses]: meshes don't resolve shorter ones
SPREAD = 0.3  # wave numbers lie within this share of the mean one
WAVELENGTH = 7.85  # in space, in cortical thicknesses, where theory knows no first wrinkles,
CUT = 1.28  # and the share of that of the first wrinkles: a sphere cuts waves in space so much longer


class Options(EffectOptions):
    """Random smooth imperfection of the cortical thickness: rms amplitude over the thickness, and its seed.

    ``wavelength`` [mm]: of its waves in space, by default theory's first wrinkles over 1.28: a sphere cuts waves in
    space so much longer (a strip twice, or so).
    """

    theory = True
    errors_known = True
    at_onset = False
    counted = "once, within rest"

    amplitude: Annotated[float, key("rms of the imperfection over the thickness", gt=0, le=0.3)] = 0.02
    seed: Annotated[int, key("another seed, another pattern", ge=0, lt=2**63)] = 0
    wavelength: Annotated[
        Length | None, key("of its waves in space; by default theory's first wrinkles over 1.28", "mm")
    ] = None


def build(options: Options, scene: Scene) -> Perturbation:
    thickness = scene.geometry.cortex_thickness
    wavelength = first_wrinkles(scene).wavelength_over_T / CUT
    known = LEAST <= wavelength < math.inf
    default = (wavelength if known else WAVELENGTH) * thickness
    return Perturbation(options.amplitude * thickness, options.wavelength or default, options.seed)


class Perturbation(Effect):
    """The thickness of the cortex varies by a random smooth field.

    Parameters
    ----------
    amplitude : float
        Root mean square of the field [mm].
    wavelength : float
        Of the plane waves in space, 200 of random direction and phase, that the field is the sum of [mm]; their wave
        numbers lie within 30 %. A surface cuts waves that don't run along it longer: 1.2 to 1.3 times on a sphere.
    seed : int
        The field is a function of position and seed alone, so meshes of any size carry the same one.
    """

    name = "perturbation"

    def __init__(self, amplitude: float, wavelength: float, seed: int):
        rng = np.random.default_rng(seed)
        axis = rng.standard_normal((WAVES, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        self._amplitude, self.wavelength = amplitude, float(wavelength)
        self._wave = axis * (2 * np.pi / wavelength * (1 + SPREAD * rng.uniform(-1, 1, WAVES)))[:, None]
        self._phase = rng.uniform(0, 2 * np.pi, WAVES)

    def field(self, at: Array) -> Array:
        """The field (P,) at points (P, 3) of the pial surface [mm]."""
        return self._amplitude * np.sqrt(2 / WAVES) * np.cos(at @ self._wave.T + self._phase).sum(axis=1)

    def reshape(self, bilayer: Bilayer, X: Array) -> Array:
        """The pial surface moves along the thickness by the field, the white surface not at all, linear in between."""
        X, inside = X.copy(), np.flatnonzero(bilayer.share > 0)
        for nodes in np.array_split(inside, 1 + len(inside) // 20_000):  # bounds the memory of the waves
            step = bilayer.share[nodes] * self.field(bilayer.foot[nodes])
            X[nodes] += step[:, None] * bilayer.radial[nodes]
        return X
