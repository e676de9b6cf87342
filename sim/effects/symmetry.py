"""Contact of the pial surface with its mirror image: nodes stay half a gap away from a symmetry plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from scipy import sparse

from morphofold.arrays import Array, Bools
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, contact

#: a node and its image press, at twice the depth
PENALTY_STIFFNESS, PENALTY_DAMPING = 4 * contact.PENALTY_STIFFNESS, 4 * contact.PENALTY_DAMPING


@njit(cache=True)
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


def build(options, scene) -> Symmetry:
    return Symmetry()


class Symmetry(Effect):
    """Keeps nodes from crossing the symmetry planes; ``Body`` holds the nodes that lie on them."""

    name = "symmetry"

    def prepare(self, body: Body) -> None:
        n = body.n_surface
        held = [np.ascontiguousarray(body.bilayer.mesh.p[axis, :n] == at) for axis, at, _ in body.bilayer.planes]
        self._planes = list(zip(body.bilayer.planes, held))
        self._pressed, self._energy = 0, 0.0

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        self._pressed, self._energy = 0, 0.0
        for (axis, at, side), held in self._planes:
            count, energy = press_plane(x, v, body.mass, held, axis, at, side, self._gap(body), extra)
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
            presses[:, axis] |= (self._gap(body) > side * (x[:n, axis] - at)) & ~held
        return presses

    def _gap(self, body: Body) -> float:
        return 0.5 * contact.GAP_IN_CELLS * body.cell

    def energy(self) -> float:
        return self._energy

    def record(self) -> dict[str, Any]:
        return {"pressed": self._pressed}
