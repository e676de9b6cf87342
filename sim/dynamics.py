"""Explicit damped dynamics with a measured step: the body follows its growth through buckling into folds.

The step is one unit of time. What is measured is the mass: each node gets the least mass that keeps that step
stable for the present stiffness of its elements, renewed every ``REFRESH`` steps, so that squeezed elements can
never outrun the step. Mass is fictitious; the result is a path of near-equilibria, and the ratio of kinetic
to strain energy says how near.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from morphofold.sim import kernels
from morphofold.sim.body import Body

Array = NDArray[np.float64]

REFRESH = 10            # steps between measurements of mass, energies and growth increments
DAMPING = 0.02          # share of the velocity lost per step
KINETIC_LIMIT = 5e-3    # kinetic over strain energy above which growth slows down
SLOWEST = 0.2           # least pace of growth while it does
EARLY = 1.2             # below this growth there is too little strain energy to judge the kinetic one by
LARGEST_J = 30.0        # beyond it the kernels' cube root no longer holds, and no sound body gets there


class Effect(Protocol):
    """What an optional effect may do in a step. One file each under ``sim/effects``."""

    name: str

    def refresh(self, body: Body, x: Array, v: Array) -> None:
        """Called every ``REFRESH`` steps, after the mass was measured."""

    def add_forces(self, body: Body, x: Array, v: Array, extra: Array) -> None:
        """Add forces on the surface nodes to ``extra`` (S, 3), every step."""

    def energy(self) -> float:
        """Energy stored in the effect at the last step."""

    def record(self) -> dict[str, Any]:
        """Numbers for the log."""

    def save(self) -> dict[str, NDArray]:
        """Arrays for a checkpoint; ``load`` takes them back."""

    def load(self, arrays: dict[str, NDArray]) -> None: ...


class UnstableError(RuntimeError):
    """The run left its bounds; ``sound`` holds what ``Dynamics.save`` gave at the last state within them."""

    def __init__(self, message: str, sound: dict[str, NDArray]):
        super().__init__(message)
        self.sound = sound


@dataclass
class State:
    """Where a run stands: positions x (N, 3) [mm], velocities v (N, 3) [mm/step], growth stretch, the steps done in
    all and in relaxation, and the smallest J that any element had so far."""

    x: Array
    v: Array
    step: int = 0
    growth: float = 1.0
    relaxed: int = 0
    lowest_J: float = 1.0
    record: dict[str, Any] = field(default_factory=dict)


class Dynamics:
    """Grow a body step by step.

    Parameters
    ----------
    body : Body
    effects : sequence of Effect
        Surface effects; an empty one costs nothing.
    steps_per_unit : float
        Steps for growth to rise by 1; fewer is faster and lags further behind equilibrium.
    damping : float
        Share of the velocity lost per step.
    """

    def __init__(self, body: Body, effects: Sequence[Effect] = (), *, steps_per_unit: float, damping: float = DAMPING):
        self.body, self.effects = body, tuple(effects)
        self.rate, self.damping = 1.0 / steps_per_unit, damping
        self.state = State(body.X.copy(), np.zeros_like(body.X))
        self.seconds: dict[str, float] = defaultdict(float)
        self._extra = np.zeros((body.n_surface, 3))
        self._flat_force = body.force.reshape(-1)
        self._sound: dict[str, NDArray] = {}
        self._measure()

    def grow_to(self, g: float, after: Callable[[State], None] = lambda state: None) -> None:
        """Raise the growth stretch to ``g``; ``after`` is called every ``REFRESH`` steps.

        Raises
        ------
        UnstableError
            If a position stops being finite or elements turn inside out.
        """
        while self.state.growth < g:
            increment = self.rate * REFRESH * self._pace()
            left = g - self.state.growth
            self.state.growth = g if left <= 1.5 * increment else self.state.growth + increment
            self.body.grow(self.state.growth)
            self._run(REFRESH)
            after(self.state)

    def relax(self, steps: int, after: Callable[[State], None] = lambda state: None) -> None:
        """Take steps at the present growth until there were ``steps`` of them, rounded up to ``REFRESH``."""
        while self.state.relaxed < steps:
            self._run(REFRESH)
            self.state.relaxed += REFRESH
            after(self.state)

    def save(self) -> dict[str, NDArray]:
        """The run as arrays, enough to go on bitwise the same."""
        state = self.state
        arrays = {"x": state.x.copy(), "v": state.v.copy()}
        arrays |= {key: np.array(getattr(state, key)) for key in ("step", "growth", "relaxed", "lowest_J")}
        for effect in self.effects:
            arrays |= {f"{effect.name}.{key}": value for key, value in effect.save().items()}
        return arrays

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Take up a run that ``save`` wrote."""
        step, growth, relaxed = int(arrays["step"]), float(arrays["growth"]), int(arrays["relaxed"])
        lowest_J = float(arrays["lowest_J"])
        self.state = State(arrays["x"].copy(), arrays["v"].copy(), step, growth, relaxed, lowest_J)
        self.body.grow(self.state.growth)
        for effect in self.effects:
            prefix = f"{effect.name}."
            effect.load({k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)})
        self._measure()

    def _pace(self) -> float:
        """Share of the full growth rate: less while the kinetic energy is above its limit."""
        ratio = self.state.record["kinetic_over_strain"]
        if self.state.growth < EARLY or ratio <= KINETIC_LIMIT:
            return 1.0
        return max(SLOWEST, KINETIC_LIMIT / ratio)

    def _run(self, steps: int) -> None:
        body, state, seconds = self.body, self.state, self.seconds
        for _ in range(steps):
            t0 = time.perf_counter()
            body.element_forces(state.x)
            t1 = time.perf_counter()
            self._extra[:] = body.filter.forces(state.x)
            t2 = time.perf_counter()
            seconds["elements"] += t1 - t0
            seconds["filter"] += t2 - t1
            for effect in self.effects:
                effect.add_forces(body, state.x, state.v, self._extra)
                t3 = time.perf_counter()
                seconds[effect.name] += t3 - t2
                t2 = t3
            kernels.advance(
                state.x, state.v, self._flat_force, body.first, body.slots, body.rest, self._extra, body.mass,
                body.free, 1.0 - self.damping,
            )  # fmt: skip
            seconds["advance"] += time.perf_counter() - t2
        state.step += steps
        self._measure()

    def _measure(self) -> None:
        body, state = self.body, self.state
        t0 = time.perf_counter()
        if not np.isfinite(state.x).all():
            lost = np.flatnonzero(~np.isfinite(state.x).all(axis=1))
            raise UnstableError(
                f"{len(lost)} of {len(state.x)} nodes are not finite at g = {state.growth:.3f}, step {state.step}; "
                f"the first is node {lost[0]}. Slow the growth down (growth.rate) or refine the mesh.", self._sound
            )  # fmt: skip
        body.update_state(state.x)
        element = body.element_state()
        kinetic = 0.5 * float(np.sum(body.mass[:, None] * state.v**2))
        strain = float(element["energy"].sum()) + body.filter.energy(state.x)
        broken = np.flatnonzero((element["volume_ratio"] <= 0) | (element["J_max"] > LARGEST_J))
        if broken.size:
            raise UnstableError(
                f"{broken.size} of {body.n_elements} elements have no volume left or burst at g = {state.growth:.3f}, "
                f"step {state.step}; the first is element {broken[0]} with v/V = "
                f"{element['volume_ratio'][broken[0]]:.2f}. Slow the growth down (growth.rate) or refine the mesh.",
                self._sound,
            )
        state.lowest_J = min(state.lowest_J, float(element["J_min"].min()))
        self.seconds["measure"] += time.perf_counter() - t0
        effects: dict[str, Any] = {}
        for effect in self.effects:
            t0 = time.perf_counter()
            effect.refresh(body, state.x, state.v)
            effects[effect.name] = {"energy": effect.energy(), **effect.record()}
            self.seconds[effect.name] += time.perf_counter() - t0
        state.record = {
            "step": state.step,
            "growth": state.growth,
            "strain_energy": strain,
            "kinetic_energy": kinetic,
            "kinetic_over_strain": kinetic / strain if strain > 0 else 0.0,
            "min_J": float(element["J_min"].min()),
            "max_J": float(element["J_max"].max()),
            "mean_volume_ratio": float(np.mean(element["volume_ratio"])),
            "effects": effects,
        }
        self._sound = self.save()
