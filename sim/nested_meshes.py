"""A run on two nested meshes: folds choose their pattern on the fine one, and grow on the coarse one.

Which folds form is mostly decided between the first wrinkles and soon after walls first touch: then a coarse mesh leads
to other folds than a fine one (docs/solver.md has how often it still does). So the body grows on the fine mesh in this
window, and before and after it on the coarse one. At a stage the state is carried to the fine mesh and held there,
which brings back what the coarse mesh flattens; growth goes on from the coarse state. The coarse mesh is never held to
rest for long: there it would leave the path of the fine one.

A state is carried by its displacement in the reference body, along the lines of both meshes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from morphofold.frozen_arrays import Array
from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics, State, UnstableError
from morphofold.sim.effects import Effect, build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.mesh.brick_mesh import Bilayer

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

#: the window of the fine mesh, in growth strain: from this share of that of the first wrinkles by theory, to this
#: multiple of that at which walls first touch
WINDOW_START, WINDOW_END = 0.93, 2.0
COARSE_TICKS, FINE_TICKS = 4.0, 8.0  # for which a stage is held on the coarse mesh, then on the fine one


def carried(source: Bilayer, target: Bilayer, nodal_values: Array) -> Array:
    """Values (N, K) of the nodes of one mesh at those of another mesh of the same body, (M, K).

    Cubic splines along the lines of the surface, linear between layers of nodes. Nothing is smoothed: on its own mesh a
    field stays the same, and one that varies slowly is carried with an error of fourth order.
    """
    layers = nodal_values.reshape(-1, source.n_surface, nodal_values.shape[1])
    on_layers = np.empty((len(layers), target.n_surface, nodal_values.shape[1]))
    for nodes, target_nodes in zip(source.grids, target.grids):
        along, across = (_spline(n, n_target) for n, n_target in zip(nodes.shape, target_nodes.shape))
        on_layers[:, target_nodes] = np.einsum("iu,jv,luvc->lijc", along, across, layers[:, nodes], optimize=True)
    depths, target_depths = _relative_depths(source), _relative_depths(target)
    between_layers = np.array([np.interp(target_depths, depths, unit_row) for unit_row in np.eye(len(depths))])
    return np.einsum("lk,lsc->ksc", between_layers, on_layers).reshape(-1, nodal_values.shape[1])


def _spline(n: int, n_target: int) -> Array:
    """Matrix (n_target, n) of cubic interpolation between even points of an interval."""
    points = np.linspace(0, 1, n)
    return np.asarray(make_interp_spline(points, np.eye(n), k=min(3, n - 1))(np.linspace(0, 1, n_target)))


def _relative_depths(bilayer: Bilayer) -> Array:
    """Depth of each layer of nodes (L,): 0 on the pial surface, 1 on white, 2 on the lowest; mean over the surface."""
    layers = bilayer.mesh.p.T.reshape(-1, bilayer.n_surface, 3)
    depth = np.linalg.norm(layers - layers[0], axis=2).mean(axis=1)
    white = depth[np.flatnonzero(bilayer.share.reshape(len(depth), -1).max(axis=1) > 0)[-1] + 1]
    return np.where(depth <= white, depth / white, 1 + (depth - white) / (depth[-1] - white))


def carry(source: Body, state: State, target: Dynamics) -> None:
    """Let a run go on from the ``state`` of another mesh of its body; pairs of contact and the distance from rest are
    found anew. Pressures of a split bulk modulus are carried, too: those of the carried positions would be far off,
    because a coarse mesh cannot keep the volume of each brick where folds are sharp."""
    body = target.body
    source.grow(state.growth)
    source.elements.measure(state.x)
    ratios = carried(source.bilayer, body.bilayer, _at_nodes(source.bilayer, source.elements.state()["volume_ratio"]))
    x = body.X + carried(source.bilayer, body.bilayer, state.x - source.X)
    v = carried(source.bilayer, body.bilayer, state.v) * (source.crossing / body.crossing)
    for plane in body.bilayer.planes:
        is_on_plane = body.on_plane[:, plane.axis]
        x[is_on_plane, plane.axis] = plane.at
    x[body.bilayer.held] = body.X[body.bilayer.held]
    v[~body.free] = 0.0
    target.enter(x, v, state, ratios[body.bilayer.mesh.t].mean(axis=0)[:, 0])


def _at_nodes(bilayer: Bilayer, element_values: Array) -> Array:
    """Mean at each node of the values (E,) of its bricks, (N, 1)."""
    node, shape = bilayer.mesh.t.ravel(), bilayer.mesh.t.shape
    sums = np.bincount(node, np.broadcast_to(element_values, shape).ravel())
    return (sums / np.bincount(node))[:, None]


class NestedDynamics:
    """Grows a scene on two meshes; it is used as a :class:`Dynamics` is.

    Attributes
    ----------
    coarse, fine : Dynamics
    run : Dynamics
        The one that is under way.
    contact : float
        Growth at which walls first touched; inf before that.
    at_stage : bool
        Whether ``run`` holds a stage on the fine mesh, while the coarse one waits in its state before that.
    """

    def __init__(self, scene: Scene, effects: Sequence[Effect]):
        coarse_effects = build_effects(scene.coarse)
        self.coarse = Dynamics.of(scene.coarse, build_body(scene.coarse, coarse_effects), coarse_effects)
        self.fine = Dynamics.of(scene, build_body(scene, effects), effects)
        self.run, self.contact, self.at_stage = self.coarse, math.inf, False
        self._start = 1 + WINDOW_START * float(np.nan_to_num(first_wrinkles(scene).growth - 1))

    @property
    def state(self) -> State:
        return self.run.state

    @property
    def seconds(self) -> Counter[str]:
        """Seconds of both by phase."""
        return Counter(self.coarse.seconds) + Counter(self.fine.seconds)

    def grow_to(self, g: float, after: Callable[[State], None]) -> None:
        """As :meth:`Dynamics.grow_to`, on the mesh for the growth."""
        if self.at_stage and self.state.growth < g:
            self.run, self.at_stage = self.coarse, False
            self.coarse.count_from(self.fine.state)
        while self.state.growth < g:
            end = 1 + WINDOW_END * (self.contact - 1)
            self._use(self.fine if self._start <= self.state.growth < end else self.coarse)
            targets = [limit for limit in (g, self._start, end) if limit > self.state.growth]
            self.run.grow_to(min(targets), after, self._has_met)

    def _has_met(self) -> bool:
        """Whether walls touch for the first time, in the window."""
        contact = self.state.record["effects"].get("contact", {"pairs": 0})
        is_first = self.run is self.fine and self.contact == math.inf and contact["pairs"] > 0
        if is_first:
            self.contact = self.state.growth
        return is_first

    def _use(self, run: Dynamics) -> None:
        if run is not self.run:
            try:
                carry(self.run.body, self.run.state, run)
            except UnstableError as error:
                raise UnstableError(f"{error} It came from another mesh (finest has one).", self.run.save()) from error
            self.run = run

    def settle(self, after: Callable[[State], None], count_modes: Callable[[], int | None]) -> bool:
        """Hold a stage: on the coarse mesh, if it is under way, and on the fine one."""
        if self.run is self.coarse:
            self.coarse.hold(COARSE_TICKS, after)
            self._use(self.fine)
            self.at_stage = True
        return self.fine.hold(self.fine.patience_factor * FINE_TICKS, after)

    def save(self) -> dict[str, NDArray[Any]]:
        """As :meth:`Dynamics.save`."""
        arrays = {"on_fine": np.array(self.run is self.fine), "contact": np.array(self.contact)}
        arrays |= {"at_stage": np.array(self.at_stage), "growth": np.array(self.state.growth)}
        for name, run in (("coarse", self.coarse), ("fine", self.fine)):
            arrays |= {f"{name}.{key}": array for key, array in run.save().items()}
        return arrays

    def load(self, arrays: dict[str, NDArray[Any]]) -> None:
        """As :meth:`Dynamics.load`."""
        for name, run in (("coarse", self.coarse), ("fine", self.fine)):
            run.load({k.removeprefix(f"{name}."): array for k, array in arrays.items() if k.startswith(f"{name}.")})
        self.run = self.fine if arrays["on_fine"] else self.coarse
        self.contact, self.at_stage = arrays["contact"].item(), bool(arrays["at_stage"])
