"""Corners of the pial bricks resist collapse: for sulci so sharp that they crease within one brick.

The elements measure J at their Gauss points, inside. In a crease the opposite sides of a single quad of the pial
surface can pass each other while J is positive at all Gauss points, and contact does not see them: they are neighbours.
So each corner of a pial brick has a J of its own, that of the three edges that meet in it, over its grown volume, and

    W = sum_c  STRENGTH / 2 mu w_c (LEAST_J - J_c)^2   where J_c < LEAST_J,

with w_c an eighth of that volume. The volume of the bricks that it acts on goes to zero as the mesh is refined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit, prange
from scipy import sparse

from morphofold.arrays import Array, Ints
from morphofold.errors import DoesNotApply, ImpossibleBody
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, Running
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.scene.tables import EffectOptions

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

LEAST_J = 0.2  # the barrier acts below it
STRENGTH = 80.0  # stiffness against J over mu: a crease of one modulus presses with about 8 mu


@njit(parallel=True, cache=True)
def add_corner_forces(x, nodes, start, local, layers, volume, mu, force, energy):
    """Add the forces of the barrier to the rows (R, 3) of the two upper levels of nodes; energy (groups,).

    ``volume`` (groups, 4, LANES) is that of the grown corners, ``mu`` (groups, LANES); 0: a lane left over. The rest is
    of ``blocks.Columns``.
    """
    for g in prange(len(local)):
        top = start[g]
        below = top + (start[g + 1] - top) // (layers + 1)
        energy[g] = 0.0
        for l in range(LANES):
            if mu[g, l] == 0.0:
                continue
            for q in range(4):
                own = local[g, q * LANES + l]
                one, other = local[g, (q ^ 2) * LANES + l], local[g, (q ^ 1) * LANES + l]
                a, b = 1.0 - (q & 2), 1.0 - 2 * (q & 1)  # the sense in which its edges run
                n, i, j, k = nodes[top + own], nodes[top + one], nodes[top + other], nodes[below + own]
                u0, u1, u2 = a * (x[i, 0] - x[n, 0]), a * (x[i, 1] - x[n, 1]), a * (x[i, 2] - x[n, 2])
                v0, v1, v2 = b * (x[j, 0] - x[n, 0]), b * (x[j, 1] - x[n, 1]), b * (x[j, 2] - x[n, 2])
                w0, w1, w2 = x[n, 0] - x[k, 0], x[n, 1] - x[k, 1], x[n, 2] - x[k, 2]
                c0, c1, c2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
                lack = LEAST_J - (c0 * w0 + c1 * w1 + c2 * w2) / volume[g, q, l]
                if lack <= 0.0:
                    continue
                p = STRENGTH * mu[g, l] * lack / 8.0
                energy[g] += 0.5 * p * lack * volume[g, q, l]
                a, b = a * p, b * p
                a0, a1, a2 = a * (v1 * w2 - v2 * w1), a * (v2 * w0 - v0 * w2), a * (v0 * w1 - v1 * w0)
                b0, b1, b2 = b * (w1 * u2 - w2 * u1), b * (w2 * u0 - w0 * u2), b * (w0 * u1 - w1 * u0)
                c0, c1, c2 = p * c0, p * c1, p * c2
                for s, f0, f1, f2 in (
                    (top + one, a0, a1, a2),
                    (top + other, b0, b1, b2),
                    (below + own, -c0, -c1, -c2),
                    (top + own, c0 - a0 - b0, c1 - a1 - b1, c2 - a2 - b2),
                ):
                    force[s, 0] += f0
                    force[s, 1] += f1
                    force[s, 2] += f2


@njit(parallel=True, cache=True)
def corner_volumes(x, nodes, sense, out):
    """Volume (groups, 4, LANES) that the three edges of each corner span; ``nodes`` (groups, 4, LANES, 4)."""
    for g in prange(len(nodes)):
        for q in range(4):
            for l in range(LANES):
                n, i, j, k = nodes[g, q, l]
                out[g, q, l] = sense[q] * (
                    ((x[i, 1] - x[n, 1]) * (x[j, 2] - x[n, 2]) - (x[i, 2] - x[n, 2]) * (x[j, 1] - x[n, 1]))
                    * (x[n, 0] - x[k, 0])
                    + ((x[i, 2] - x[n, 2]) * (x[j, 0] - x[n, 0]) - (x[i, 0] - x[n, 0]) * (x[j, 2] - x[n, 2]))
                    * (x[n, 1] - x[k, 1])
                    + ((x[i, 0] - x[n, 0]) * (x[j, 1] - x[n, 1]) - (x[i, 1] - x[n, 1]) * (x[j, 0] - x[n, 0]))
                    * (x[n, 2] - x[k, 2])
                )


class Options(EffectOptions):
    """Corners of the pial bricks resist collapse, where a sulcus creases within one brick; no options."""

    shapes = ("sphere", "ellipsoid", "patch", "strip", "cortex")
    theory = True
    at_onset = False


def build(options: Options, scene: Scene) -> CornerBarrier:
    return CornerBarrier()


class _Pressed(NamedTuple):
    """The corners that the barrier acts on: nodes (K, 4); edges (K, 3, 3), and which nodes they join (K, 3, 4); the
    gradient of J by the nodes (K, 4, 3); the modulus against J [N mm] and LEAST_J - J (K,), and grown volume (K,)."""

    nodes: Ints
    edges: Array
    joins: Array
    gradient: Array
    modulus: Array
    lack: Array
    volume: Array


class CornerBarrier(Effect):
    """The barrier; see the module for its energy."""

    name = "corner_barrier"

    def prepare(self, body: Body) -> None:
        if not isinstance(body.elements, Bricks):
            raise DoesNotApply("effects.corner_barrier needs bricks, but this body has tetrahedra; leave it out.")
        b = body.elements.blocks
        row = (b.start[:-1, None] + b.local).reshape(-1, 4, LANES)
        level = np.diff(b.start)[:, None, None] // (b.layers + 1)
        own, below, q = b.nodes[row], b.nodes[row + level], np.arange(4)
        #: nodes (groups, 4, LANES, 4) of each corner: itself, along either side of the quad, below
        self._nodes: Ints = np.stack([own, own[:, q ^ 2], own[:, q ^ 1], below], axis=-1).astype(np.int64)
        self._joins = np.zeros((4, 3, 4))  # edges of a corner from its nodes: along i, along j, towards the surface
        self._joins[:, 0, 1], self._joins[:, 1, 2], self._joins[:, 2, 0] = 1 - (q & 2), 1 - 2 * (q & 1), 1.0
        self._joins[:, :2, 0], self._joins[:, 2, 3] = -self._joins[:, [0, 1], [1, 2]], -1.0
        self._brick, filler = b.element[:: b.layers], b.filler[:: b.layers]
        self._mu = np.where(filler, 0.0, body.mu[self._brick])
        self._real = np.broadcast_to(~filler[:, None], own.shape)
        self._first = self._volumes(body.X)
        inside_out = self._nodes[self._real & (self._first <= 0)]
        if len(inside_out):
            raise ImpossibleBody(
                f"effects.corner_barrier: {len(inside_out)} corners of pial bricks are inside out before growth, the "
                f"first at node {inside_out[0, 0]}. Use a finer mesh (accuracy.level), or leave the effect out."
            )
        self._energy = np.zeros(len(b.local))
        self._measure(body, body.X)

    def refresh(self, run: Running) -> None:
        self._measure(run.body, run.state.x)

    def _measure(self, body: Body, x: Array) -> None:
        """Compute the grown volume (groups, 4, LANES) of the corners, and their J (C,) at ``x``."""
        ratio = body.grown_volumes() / body.elements.volume[: body.elements.n_cortex]
        self._volume = self._first * ratio[self._brick][:, None]
        self._J = (self._volumes(x) / self._volume)[self._real]

    def _volumes(self, x: Array) -> Array:
        volumes = np.empty(self._nodes.shape[:3])
        corner_volumes(x, self._nodes, self._joins[:, 0, 1] * self._joins[:, 1, 2], volumes)
        return volumes

    def add_element_forces(self, body: Body, x: Array, v: Array) -> None:
        assert isinstance(body.elements, Bricks)
        b = body.elements.blocks
        add_corner_forces(x, b.nodes, b.start, b.local, b.layers, self._volume, self._mu, b.force, self._energy)

    def _pressed(self, x: Array) -> _Pressed:
        lack = LEAST_J - self._volumes(x) / self._volume
        at = np.nonzero(self._real & (lack > 0))
        nodes, joins, volume = self._nodes[at], self._joins[at[1]], self._volume[at]
        edges, modulus = joins @ x[nodes], STRENGTH / 8 * self._mu[at[0], at[2]] * volume
        cofactors = np.cross(edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
        gradient = joins.swapaxes(1, 2) @ cofactors / volume[:, None, None]
        return _Pressed(nodes, edges, joins, gradient, modulus, lack[at], volume)

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        p = self._pressed(x)
        slopes = p.gradient.reshape(-1, 12)
        entries = p.modulus[:, None, None] * slopes[:, :, None] * slopes[:, None, :]
        curvature = np.zeros((len(p.nodes), 3, 3, 3, 3))  # of the determinant, by edge, coordinate, edge, coordinate
        for edge, other, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            turn = np.cross(np.eye(3), p.edges[:, third, None, :])  # its rows are e_s x third
            curvature[:, edge, :, other, :] = turn.swapaxes(1, 2)
            curvature[:, other, :, edge, :] = turn
        by_node = np.einsum("kea,kerfs,kfb->karbs", p.joins, curvature, p.joins).reshape(-1, 12, 12)
        entries -= (p.modulus * p.lack / p.volume)[:, None, None] * by_node
        at = (3 * p.nodes[:, :, None] + np.arange(3)).reshape(-1, 12)
        places = np.repeat(at, 12, axis=1).ravel(), np.tile(at, (1, 12)).ravel()
        return sparse.csr_matrix((entries.ravel(), places), shape=(x.size, x.size))

    def springs(self, body: Body, x: Array) -> Array:
        p, springs = self._pressed(x), np.zeros(len(x))
        length = np.linalg.norm(p.gradient, axis=2)
        np.add.at(springs, p.nodes, p.modulus[:, None] * length * length.sum(axis=1, keepdims=True))
        return (springs / body.mass)[: body.n_surface]

    def energy(self) -> float:
        return float(self._energy.sum())

    def record(self) -> dict[str, Any]:
        return {"corners": int(np.count_nonzero(self._J < LEAST_J)), "lowest_J": float(self._J.min())}
