"""The midline: a rigid plane beside a hemisphere, where the other hemisphere and the falx are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from morphofold.arrays import Bools
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Plane
from morphofold.sim.rigid_planes import RigidPlanes, medial_plane
from morphofold.sim.scene.keys import LONGEST_LENGTH_MM, EffectOptions, key

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


class Options(EffectOptions):
    """A rigid plane on the medial side of a hemisphere, ``gap`` [mm] from the body's first surface."""

    shapes = ("cortex",)
    at_onset = False

    gap: Annotated[
        float, key("between the medial side of the body at first and the plane", "mm", ge=0, le=LONGEST_LENGTH_MM)
    ] = 0.5


def build(options: Options, scene: Scene) -> Effect:
    return Midline(options.gap)


class Midline(RigidPlanes):
    """A plane of constant x that surface nodes do not cross, without friction; nodes that are held are left alone.

    x points to the right, as in FreeSurfer: the medial side of a left hemisphere is where x is largest, that of a right
    one where x is smallest.

    Parameters
    ----------
    gap : float
        Between the first surface and the plane [mm].
    """

    name = "midline"

    def __init__(self, gap: float):
        self._gap = gap

    def find_planes(self, body: Body) -> list[tuple[Plane, Bools]]:
        held = np.zeros(len(body.X), dtype=bool)
        held[body.bilayer.held] = True
        return [(medial_plane(body.bilayer, self._gap), held[: body.n_surface])]
