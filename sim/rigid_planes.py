"""Rigid planes that surface nodes do not cross, without friction: what a symmetry plane and the midline share."""

from typing import Any

import numpy as np
from scipy import sparse

from morphofold.arrays import Array, Bools
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Bilayer, Plane

#: force per mass and depth, per mass and speed: four times those of contact, since a node that presses on its mirror
#: image feels twice the depth from both sides
PENALTY_STIFFNESS, PENALTY_DAMPING = 0.8, 0.4


def medial_plane(bilayer: Bilayer, gap: float) -> Plane:
    """The plane of constant x that is ``gap`` [mm] from the medial side of a hemisphere; x points to the right."""
    x = bilayer.mesh.p[0, : bilayer.n_surface]
    return Plane(0, float(x.max()) + gap, -1) if bilayer.hemi == "lh" else Plane(0, float(x.min()) - gap, 1)


@kernel
def press_plane(x, v, mass, held, axis, at, side, gap, extra):
    """Push surface nodes away from the plane, except those that it holds (``held`` (S,)); returns count and energy."""
    count, energy = 0, 0.0
    for i in range(len(extra)):
        depth = gap - side * (x[i, axis] - at)
        if depth > 0.0 and not held[i]:
            force = mass[i] * (PENALTY_STIFFNESS * depth - PENALTY_DAMPING * side * v[i, axis])
            if force > 0.0:
                extra[i, axis] += side * force
                count += 1
                energy += 0.5 * mass[i] * PENALTY_STIFFNESS * depth * depth
    return count, energy


class RigidPlanes(Effect):
    """Keeps surface nodes on their side of planes. A subclass says which, in ``find_planes``.

    A node is pressed where it is nearer to a plane than :meth:`gap`; nodes that are held are left alone.
    """

    def find_planes(self, body: Body) -> list[tuple[Plane, Bools]]:
        """The planes, and for each which of the surface nodes (S,) it leaves alone."""
        raise NotImplementedError

    def gap(self, body: Body) -> float:
        """Distance from a plane below which nodes are pressed [mm]."""
        return 0.0

    def prepare(self, body: Body) -> None:
        self._planes = self.find_planes(body)
        self._pressed, self._energy = 0, 0.0

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        self._pressed, self._energy = 0, 0.0
        for (axis, at, side), held in self._planes:
            count, energy = press_plane(x, v, body.mass, held, axis, at, side, self.gap(body), extra)
            self._pressed += count
            self._energy += energy

    def springs(self, body: Body, x: Array) -> Array:
        return np.where(self._presses(body, x).any(axis=1), PENALTY_STIFFNESS, 0.0)

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        """Stiffness of the nodes that press: a spring along the axis of their plane."""
        springs, n = np.zeros((len(x), 3)), body.n_surface
        springs[:n] = PENALTY_STIFFNESS * body.mass[:n, None] * self._presses(body, x)
        return sparse.csr_matrix(sparse.diags(springs.ravel()))

    def _presses(self, body: Body, x: Array) -> Bools:
        """Whether a surface node presses on a plane, by axis (S, 3)."""
        n = body.n_surface
        presses = np.zeros((n, 3), dtype=bool)
        for (axis, at, side), held in self._planes:
            presses[:, axis] |= (self.gap(body) > side * (x[:n, axis] - at)) & ~held
        return presses

    def energy(self) -> float:
        return self._energy

    def record(self) -> dict[str, Any]:
        return {"pressed": self._pressed}
