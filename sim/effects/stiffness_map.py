"""Stiffness by a map: the cortex is stiffer or softer from place to place, as a file says."""

from pathlib import Path

import numpy as np

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.effects import Effect
from morphofold.sim.hemisphere.subject_maps import MapAtNodes
from morphofold.sim.mesh.brick_mesh import Bilayer
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, SphereMap

LEAST_FACTOR, LARGEST_FACTOR = 0.1, 10.0


class Options(SphereMap, EffectOptions):
    """A map of factors on the moduli of the cortex, 0.1 to 10; on a sphere, 0 and less are no values."""

    shapes = ("sphere", "ellipsoid", "cortex", "mesh")
    counted = "once, when the body is built"
    example = '{file = "fsaverage5/surf/lh.thickness", sphere = "fsaverage5/surf/lh.sphere"}'

    def files(self, scene: Scene) -> dict[str, Path]:
        return MapAtNodes(self, scene.geometry, "stiffness_map").files


def build(options: Options, scene: Scene) -> Effect:
    return StiffnessMap(MapAtNodes(options, scene.geometry, "stiffness_map", positive=True), options.file)


class StiffnessMap(Effect):
    """Multiplies the moduli of each element of the cortex by a factor from a map."""

    def __init__(self, node_map: MapAtNodes, name: str):
        self._map, self._name = node_map, name

    def moduli(self, bilayer: Bilayer) -> Array:
        mesh, node_factors = bilayer.mesh, self._map.at(bilayer)
        factors, cortex_elements = np.ones(mesh.nelements), mesh.subdomains["cortex"]
        factors[cortex_elements] = node_factors[mesh.t[:, cortex_elements]].mean(axis=0)
        if not (factors.min() >= LEAST_FACTOR and factors.max() <= LARGEST_FACTOR):
            raise OutOfRange(
                f"{self._name}: makes the cortex {np.nanmin(factors):.3g} to {np.nanmax(factors):.3g} times as stiff; "
                f"factors must be {LEAST_FACTOR:g} to {LARGEST_FACTOR:g}."
            )
        return factors
