"""The midline: a rigid plane beside a hemisphere, where the other hemisphere and the falx are."""

from typing import Annotated

import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.rigid_shells import PlaneShell
from morphofold.sim.rigid_walls import RigidWalls, medial_plane
from morphofold.sim.scene.table_bases import LONGEST_LENGTH_MM, EffectOptions, key


class Options(EffectOptions):
    """A rigid plane on the medial side of a hemisphere, ``gap`` [mm] from the body's first surface."""

    shapes = ("cortex",)
    at_onset = False

    gap: Annotated[
        float, key("between the medial side of the body at first and the plane", "mm", ge=0, le=LONGEST_LENGTH_MM)
    ] = 0.5


class Midline(RigidWalls):
    """A plane of constant x that surface nodes do not cross, without friction; nodes that are held are left alone.

    x points to the right, as in FreeSurfer: the medial side of a left hemisphere is where x is largest, that of a right
    one where x is smallest.

    Parameters
    ----------
    gap : float
        Between the first surface and the plane [mm].
    """

    def __init__(self, gap: float):
        self._gap = gap

    def prepare(self, body: Body) -> None:
        is_held = np.isin(np.arange(body.n_surface), body.bilayer.held)
        self.shells = [PlaneShell(medial_plane(body.bilayer, self._gap), is_held)]
