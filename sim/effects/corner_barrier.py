"""Corners of the pial bricks resist collapse: for sulci so sharp that they crease within one brick.

The elements measure J at their Gauss points, inside. In a crease the opposite sides of a single quad of the pial
surface can pass each other while J is positive at all Gauss points, and contact does not see them: they are neighbours.
So each corner of a pial brick has a J of its own, that of the three edges that meet in it, over its grown volume, and

    W = sum_c  STRENGTH / 2 mu w_c (LEAST_J - J_c)^2   where J_c < LEAST_J,

with w_c an eighth of that volume. The volume of the bricks that it acts on goes to zero as the mesh is refined.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import prange
from scipy import sparse

from morphofold.errors import DoesNotApply, ImpossibleBody
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import cross, dot, less, position
from morphofold.kernels import kernel
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, Running, joined_springs
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.lanes import LANES
from morphofold.sim.scene.table_bases import EffectOptions

LEAST_J = 0.2  # the barrier acts below it
STRENGTH = 80.0  # stiffness against J over mu: a crease of one modulus presses with about 8 mu


@kernel(parallel=True)
def corner_volumes(x, nodes, signs, volumes):
    """Volume (groups, 4, LANES) that the three edges of each corner span; ``nodes`` (groups, 4, LANES, 4)."""
    for group in prange(len(nodes)):
        for corner in range(4):
            for lane in range(LANES):
                node, node_i, node_j, node_below = nodes[group, corner, lane]
                corner_x = position(x, node)
                normal = cross(less(position(x, node_i), corner_x), less(position(x, node_j), corner_x))
                volumes[group, corner, lane] = signs[corner] * dot(normal, less(corner_x, position(x, node_below)))


class Options(EffectOptions):
    """Corners of the pial bricks resist collapse, where a sulcus creases within one brick; no options."""

    shapes = ("sphere", "ellipsoid", "patch", "strip", "cortex")
    theory = True
    at_onset = False


class _Pressed(NamedTuple):
    """The corners that the barrier acts on: rows of forces and nodes (K, 4); edges (K, 3, 3) [mm], and which nodes they
    join (K, 3, 4); the gradient of J by the nodes (K, 4, 3) [1/mm]; the modulus against J (K,), of mu times mm^3;
    LEAST_J - J (K,); grown volume (K,) [mm^3]."""

    rows: Ints
    nodes: Ints
    edges: Array
    joins: Array
    gradient: Array
    modulus: Array
    lack: Array
    volume: Array


class CornerBarrier(Effect):
    """The barrier; see the module for its energy. It is our own.

    Raises
    ------
    DoesNotApply, ImpossibleBody
        By ``prepare``, if the body has tetrahedra, or corners that are inside out before growth.
    """

    def prepare(self, body: Body) -> None:
        if not isinstance(body.elements, Bricks):
            raise DoesNotApply("effects.corner_barrier needs bricks, but this body has tetrahedra; leave it out.")
        blocks = body.elements.blocks
        rows = (blocks.start[:-1, None] + blocks.local).reshape(-1, 4, LANES)
        level_width = np.diff(blocks.start)[:, None, None] // (blocks.layers + 1)
        corner = np.arange(4)
        #: rows of forces and nodes (groups, 4, LANES, 4) of each corner: its own, along both sides of the quad, below
        self._rows: Ints = np.stack([rows, rows[:, corner ^ 2], rows[:, corner ^ 1], rows + level_width], axis=-1)
        self._nodes: Ints = blocks.nodes[self._rows].astype(np.int64)
        self._joins = np.zeros((4, 3, 4))  # edges of a corner from its nodes: along i, along j, towards the surface
        self._joins[:, 0, 1], self._joins[:, 1, 2], self._joins[:, 2, 0] = 1 - (corner & 2), 1 - 2 * (corner & 1), 1.0
        self._joins[:, :2, 0], self._joins[:, 2, 3] = -self._joins[:, [0, 1], [1, 2]], -1.0
        self._brick, is_filler = blocks.element[:: blocks.layers], blocks.filler[:: blocks.layers]
        self._mu = np.where(is_filler, 0.0, body.mu[self._brick])
        self._is_real = np.broadcast_to(~is_filler[:, None], rows.shape)
        self._first_volume = self._volumes(body.X)
        inverted = self._nodes[self._is_real & (self._first_volume <= 0)]
        if len(inverted):
            raise ImpossibleBody(
                f"effects.corner_barrier: {len(inverted)} corners of pial bricks are inside out before growth, the "
                f"first at node {inverted[0, 0]}. Use a finer mesh (accuracy.level), or leave the effect out."
            )
        self._energy = 0.0
        self._measure(body, body.X)

    def refresh(self, run: Running) -> None:
        self._measure(run.body, run.state.x)

    def _measure(self, body: Body, x: Array) -> None:
        """Compute the grown volume (groups, 4, LANES) of the corners, and their J (C,) at ``x``."""
        growth_ratio = body.grown_volumes() / body.elements.volume[: body.elements.n_cortex]
        self._volume = self._first_volume * growth_ratio[self._brick][:, None]
        self._J = (self._volumes(x) / self._volume)[self._is_real]

    def _volumes(self, x: Array) -> Array:
        volumes = np.empty(self._nodes.shape[:3])
        corner_volumes(x, self._nodes, self._joins[:, 0, 1] * self._joins[:, 1, 2], volumes)
        return volumes

    def add_element_forces(self, body: Body, x: Array, v: Array) -> None:
        pressed = self._pressed(x)
        self._energy = 0.0
        if not len(pressed.nodes):
            return
        push_by_J = pressed.modulus * pressed.lack
        self._energy = 0.5 * float(np.sum(push_by_J * pressed.lack))
        np.add.at(body.elements.blocks.force, pressed.rows, push_by_J[:, None, None] * pressed.gradient)

    def _pressed(self, x: Array) -> _Pressed:
        lack = LEAST_J - self._volumes(x) / self._volume
        pressed_lanes = np.nonzero((lack > 0) & self._is_real) if lack.max() > 0 else (np.empty(0, dtype=np.int64),) * 3
        nodes, joins, volume = self._nodes[pressed_lanes], self._joins[pressed_lanes[1]], self._volume[pressed_lanes]
        edges, modulus = joins @ x[nodes], STRENGTH / 8 * self._mu[pressed_lanes[0], pressed_lanes[2]] * volume
        cofactors = np.cross(edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
        gradient = joins.swapaxes(1, 2) @ cofactors / volume[:, None, None]
        return _Pressed(self._rows[pressed_lanes], nodes, edges, joins, gradient, modulus, lack[pressed_lanes], volume)

    def stiffness(self, body: Body, x: Array) -> sparse.csr_matrix:
        active = self._pressed(x)
        node_gradients = active.gradient.reshape(-1, 12)
        spring_stiffness = active.modulus[:, None, None] * node_gradients[:, :, None] * node_gradients[:, None, :]
        hessian = np.zeros((len(active.nodes), 3, 3, 3, 3))  # of the determinant, by edge, coordinate, edge, coordinate
        for edge, next_edge, third_edge in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            cross_matrix = np.cross(np.eye(3), active.edges[:, third_edge, None, :])  # its rows are e_s x third
            hessian[:, edge, :, next_edge, :] = cross_matrix.swapaxes(1, 2)
            hessian[:, next_edge, :, edge, :] = cross_matrix
        node_hessian = np.einsum("kea,kerfs,kfb->karbs", active.joins, hessian, active.joins).reshape(-1, 12, 12)
        spring_stiffness -= (active.modulus * active.lack / active.volume)[:, None, None] * node_hessian
        return joined_springs(active.nodes, spring_stiffness, x)

    def springs(self, body: Body, x: Array) -> Array:
        pressed, springs = self._pressed(x), np.zeros(len(x))
        norms = np.linalg.norm(pressed.gradient, axis=2)
        np.add.at(springs, pressed.nodes, pressed.modulus[:, None] * norms * norms.sum(axis=1, keepdims=True))
        return (springs / body.mass)[: body.n_surface]

    def energy(self) -> float:
        return self._energy

    def record(self) -> dict[str, Any]:
        return {"corners": int(np.count_nonzero(self._J < LEAST_J)), "lowest_J": float(self._J.min())}
