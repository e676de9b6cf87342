"""Rigid walls that surface nodes do not cross, without friction: what skull, midline and symmetry planes share."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy import sparse

from morphofold.frozen_arrays import Array
from morphofold.geometry import dot
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import Bilayer, Plane
from morphofold.sim.rigid_shells import Shell


def medial_plane(bilayer: Bilayer, gap: float) -> Plane:
    """The plane of constant x that is ``gap`` [mm] from the medial side of a hemisphere; x points to the right."""
    x = bilayer.mesh.p[0, : bilayer.n_surface]
    return Plane(0, float(x.max()) + gap, -1) if bilayer.hemi == "lh" else Plane(0, float(x.min()) - gap, 1)


@kernel
def press_walls(v, mass, depth, normal, stiffness, damping, forces):
    """Push the surface nodes that are outside, by ``depth`` (S,), back along ``normal`` (S, 3); returns how many, and
    their energy."""
    n_pressed, energy = 0, 0.0
    for i in range(len(forces)):
        if depth[i] <= 0.0:
            continue
        force = mass[i] * (stiffness * depth[i] + damping * dot(v[i], normal[i]))
        if force > 0.0:
            for axis in range(3):
                forces[i, axis] -= force * normal[i, axis]
            n_pressed += 1
            energy += 0.5 * mass[i] * stiffness * depth[i] * depth[i]
    return n_pressed, energy


class RigidWalls(Effect):
    """Surface nodes stay inside of ``shells``, at their :meth:`gap`.

    ``penalty``: force per mass and depth, and per mass and speed. That of planes is four times that of contact: a node
    that presses on its mirror image feels twice the depth from both sides.
    """

    penalty = 0.8, 0.4
    shells: Sequence[Shell]
    _pressed, _energy = 0, 0.0

    def gap(self, body: Body) -> float:
        """Distance of the walls from the shells, outwards [mm]."""
        return 0.0

    def depths(self, body: Body, x: Array, n_nodes: int) -> Iterator[tuple[Array, Array]]:
        """For each wall depth (n,) of the first n nodes outside, and its normals (n, 3) there."""
        for shell in self.shells:
            depth, normal = np.zeros(n_nodes), np.zeros((n_nodes, 3))
            shell.measure(x, self.gap(body), depth, normal)
            yield depth, normal

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        self._pressed, self._energy = 0, 0.0
        for depth, normal in self.depths(body, x, len(extra)):
            n_pressed, energy = press_walls(v, body.mass, depth, normal, *self.penalty, extra)
            self._pressed += n_pressed
            self._energy += energy

    def springs(self, body: Body, x: Array) -> Array:
        is_outside = np.zeros(body.n_surface, dtype=bool)
        for depth, _ in self.depths(body, x, body.n_surface):
            is_outside |= depth > 0
        return np.where(is_outside, self.penalty[0], 0.0)

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        """Of the nodes outside: a spring along each one's normal of the wall."""
        n, node_blocks = body.n_surface, np.zeros((body.n_surface, 3, 3))
        for depth, normal in self.depths(body, x, n):
            spring_stiffness = self.penalty[0] * body.mass[:n] * (depth > 0)
            node_blocks += spring_stiffness[:, None, None] * normal[:, :, None] * normal[:, None, :]
        row_starts = np.minimum(np.arange(len(x) + 1), n)
        return sparse.csr_matrix(sparse.bsr_matrix((node_blocks, np.arange(n), row_starts), shape=(x.size, x.size)))

    def energy(self) -> float:
        return self._energy

    def record(self) -> dict[str, Any]:
        return {"pressed": self._pressed}
