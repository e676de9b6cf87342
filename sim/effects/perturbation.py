"""A small smooth imperfection of the cortical thickness; without it, folds would follow the symmetries of the mesh."""

import math
from typing import Annotated

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.sim.effects import Effect
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, Length, key

NUMBER_OF_WAVES = 200
#: shortest default wavelength [cortical thicknesses]: meshes don't resolve shorter waves
SHORTEST_WAVELENGTH_OVER_T = 3.0
WAVE_NUMBER_SPREAD = 0.3  # largest relative difference of wave numbers from their mean
DEFAULT_WAVELENGTH_OVER_T = 7.85  # wavelength in space, in cortical thicknesses, if theory gives no first wrinkles
#: wavelength of the first wrinkles over that in space: on a sphere waves look longer by this factor
SURFACE_OVER_SPACE_WAVELENGTH = 1.28


class Options(EffectOptions):
    """Random smooth imperfection of the cortical thickness: rms ``amplitude`` over the thickness, and ``seed``.

    ``wavelength`` [mm]: of its waves in space, by default that of the first wrinkles by theory over 1.28, because waves
    in space look longer by this factor on a sphere (by about 2 on a strip).
    """

    theory = True
    errors_known = True
    at_onset = False
    counted = "once, within rest"

    amplitude: Annotated[float, key("rms of the imperfection over the thickness", gt=0, le=0.3)] = 0.02
    seed: Annotated[int, key("seed of the random pattern", ge=0, lt=2**63)] = 0
    wavelength: Annotated[
        Length | None, key("of its waves in space; by default that of the first wrinkles by theory over 1.28", "mm")
    ] = None


def build(options: Options, scene: Scene) -> "Perturbation":
    thickness = scene.geometry.cortex_thickness
    wavelength = first_wrinkles(scene).wavelength_over_T / SURFACE_OVER_SPACE_WAVELENGTH
    is_resolved = SHORTEST_WAVELENGTH_OVER_T <= wavelength < math.inf
    default_wavelength = (wavelength if is_resolved else DEFAULT_WAVELENGTH_OVER_T) * thickness
    return Perturbation(options.amplitude * thickness, options.wavelength or default_wavelength, options.seed)


class Perturbation(Effect):
    """The thickness of the cortex varies by a random smooth field.

    Parameters
    ----------
    amplitude : float
        Root mean square of the field [mm].
    wavelength : float
        Wavelength in space of the plane waves whose sum is the field [mm]: 200 waves of random direction and phase,
        with wave numbers within 30 % of the mean. On a surface they look longer: 1.2 to 1.3 times on a sphere.
    seed : int
        The field depends only on position and seed, so it is the same on every mesh.
    """

    def __init__(self, amplitude: float, wavelength: float, seed: int):
        rng = np.random.default_rng(seed)
        heading = rng.standard_normal((NUMBER_OF_WAVES, 3))
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        self._amplitude, self.wavelength = amplitude, float(wavelength)
        relative_wave_numbers = 1 + WAVE_NUMBER_SPREAD * rng.uniform(-1, 1, NUMBER_OF_WAVES)
        self._wave = heading * (2 * np.pi / wavelength * relative_wave_numbers)[:, None]
        self._phase = rng.uniform(0, 2 * np.pi, NUMBER_OF_WAVES)

    def field(self, points: Array) -> Array:
        """The field (P,) at points (P, 3) of the pial surface [mm]."""
        return self._amplitude * np.sqrt(2 / NUMBER_OF_WAVES) * np.cos(points @ self._wave.T + self._phase).sum(axis=1)

    def reshape(self, bilayer: Bilayer, X: Array) -> Array:
        """Move the pial surface along the thickness by the field; the white surface stays, linear in between."""
        X, cortex_nodes = X.copy(), np.flatnonzero(bilayer.share > 0)
        for nodes in np.array_split(cortex_nodes, 1 + len(cortex_nodes) // 20_000):  # bounds the memory of the waves
            displacement = bilayer.share[nodes] * self.field(bilayer.foot[nodes])
            X[nodes] += displacement[:, None] * bilayer.radial[nodes]
        return X
