"""Plane strain in a strip one brick deep: both sides move together, so that round-off can't grow across it."""

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect


class PlaneStrain(Effect):
    """Each node of the far side (y > 0) follows the opposite node of the near side."""

    def prepare(self, body: Body) -> None:
        positions = body.bilayer.mesh.p
        node_order = np.lexsort((positions[1], positions[2], positions[0]))
        self._near, self._far = node_order[0::2], node_order[1::2]

    def after_step(self, x: Array, v: Array) -> None:
        for axis in (0, 2):
            x[self._far, axis] = x[self._near, axis]
            v[self._far, axis] = v[self._near, axis]
