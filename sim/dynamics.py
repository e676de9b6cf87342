"""Explicit damped dynamics with fictitious mass: the body follows its growth through buckling into folds.

The step is one unit of time. Each node gets the smallest mass that keeps this step stable for the present stiffness of
its elements. The mass is updated every ``STEPS_PER_MEASUREMENT`` steps, so compressed elements can't make the step
unstable. The mass is fictitious. The result is a path of near-equilibria, which comes to rest at the stages of a scene;
:mod:`morphofold.sim.equilibrium.rest_distance` measures the distance from rest.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numpy.typing import NDArray

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.body import MOST_SPLIT_GROWTH, Body
from morphofold.sim.effects import Effect, overriding
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.lanes import sum_forces
from morphofold.sim.equilibrium.rest_distance import SOFT_MODE_W2, Balance, softest
from morphofold.sim.equilibrium.wrinkle_onset import Slow, slow_growth
from morphofold.threads import using_threads
from morphofold.timing import working_seconds

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene

NODES_PER_THREAD = 5000  # for fewer nodes a thread costs more than it saves: a step has some ten parallel loops
STEPS_PER_MEASUREMENT = 12  # steps between measurements of mass and energies
STEPS_PER_INCREMENT = 2  # steps between increments of growth: no wave is so fast, so none is in resonance with them
#: velocities fall by exp(-0.15) while a wave crosses the cortex (Body.crossing), at a stage by exp(-0.1): critical
#: damping of the softest folds, with stiffness over mass of 0.0025 per tick^2
DAMPING_PER_CROSSING, REST_DAMPING_PER_CROSSING = 0.15, 0.1
KINETIC_LIMIT = 1e-3  # kinetic over strain energy above which growth slows down
COLLAPSE_RATIO_OF_J = 0.9  # growth also slows if the smallest J falls by this factor between measurements, or below 0
SLOWEST_PACE = 0.05  # smallest pace of growth when it slows down
#: below this growth strain the kinetic energy is compared with the strain energy expected there
EARLY_GROWTH_STRAIN = 0.2
SOFT_START_GROWTH = 0.02  # growth over which the pace rises to its full value, so that the body doesn't ring
FIRST_PACE = 0.1  # pace at the start
REST_DISTANCE_OVER_T = 0.05  # distance from rest that counts as rest, over the thickness of the cortex
#: growth goes on after so long within REST_DISTANCE_OVER_T, or after so long in total [ticks]
REST_TICKS, PATIENCE_TICKS = 2.0, 36.0
SLENDER_PATIENCE_TICKS = 60.0  # PATIENCE_TICKS of a slender body, whose bow has further to go
#: after little growth, patience is PATIENCE_PER_GROWTH_TICK times the ticks of growth, at least LEAST_PATIENCE_TICKS
LEAST_PATIENCE_TICKS, PATIENCE_PER_GROWTH_TICK = 10.0, 4 / 3
#: beyond this distance the body may be on the way to other folds: patience is MOST_PATIENCE_FACTOR times longer
AWAY_DISTANCE_OVER_T = 0.25
MOST_PATIENCE_FACTOR = 8.0  # largest factor on PATIENCE_TICKS where the motion is softer than that of folds
RINGING_W2 = 1.0  # stiffness over mass above which a motion rings and does not fold [1/tick^2]
RING_DOWN_TICKS = 8.0  # time for which ringing is damped more [ticks]; later vibrations come from contact
MOST_DAMPING = 0.5  # largest share of the velocity that a step removes then
#: share by which pressures follow in a step (:func:`follow_share`): over the bound of stability, and at most
FOLLOW_OVER_BOUND, MOST_FOLLOW = 0.5, 0.1
#: scalars of a state, beside its arrays
STATE_SCALARS = ("step", "growth", "relaxed", "rested", "earliest_rest", "lowest_J", "before_J", "dissipated")
#: a state that comes from another mesh is damped more at first, for so long [ticks], by such a share of the velocity in
#: a step: what it cannot resolve moves within a cell, fast; with MOST_DAMPING bricks burst that are crushed nearly flat
ENTRY_TICKS, ENTRY_DAMPING = 3.0, 0.1


class UnstableError(RuntimeError):
    """The run left its bounds; ``sound`` holds the last state within them, as returned by ``Dynamics.save``."""

    def __init__(self, message: str, sound_state: dict[str, NDArray]):
        super().__init__(message)
        self.sound = sound_state


@dataclass
class State:
    """State of a run: positions x (N, 3) [mm], velocities v (N, 3) [mm/step] and growth stretch; the number of steps in
    total, at this growth, at the end of the last rest, and at this growth before an unstable state can be at rest
    again; the smallest J of any element so far, and at the measurement before the last; and the energy dissipated so
    far."""

    x: Array
    v: Array
    step: int = 0
    growth: float = 1.0
    relaxed: int = 0
    rested: int = 0
    earliest_rest: int = 0
    lowest_J: float = 1.0
    before_J: float = 1.0
    dissipated: float = 0.0
    record: dict[str, Any] = field(default_factory=dict)


def restlessness(growth: float, kinetic_over_strain: float) -> float:
    """Kinetic over strain energy; below ``EARLY_GROWTH_STRAIN``, over the strain energy expected at that strain.

    A smooth body swells at nearly constant speed, while its strain energy rises from zero with the square of the growth
    strain.
    """
    return kinetic_over_strain * min(1.0, abs(growth - 1) / EARLY_GROWTH_STRAIN) ** 2


def soft_start(growth: float) -> float:
    """Pace of growth near its start, as a share of the full pace."""
    return min(1.0, FIRST_PACE + abs(growth - 1) / SOFT_START_GROWTH)


def limited_pace(pace: float, growth: float, slow: Slow | None) -> float:
    """A pace within its limits: at least ``SLOWEST_PACE``, but no more than that of slow growth."""
    pace = max(SLOWEST_PACE, pace)
    return min(pace, slow.pace) if slow is not None and slow.start <= growth <= slow.end else pace


def follow_share(damping: float) -> float:
    """Share theta by which the pressures of a split bulk modulus follow in a step.

    They lag, which feeds a motion with energy: one of stiffness over mass w^2, of which the share a belongs to the
    modulus that acts at once, is stable by Routh and Hurwitz if, with s = MODULUS_RATIO - 1,
    theta a s w^2 < damping (w^2 + theta damping + theta^2). So theta s <= damping is enough for any motion with a <= 1.
    In folds under pressure a is larger, because stress lowers w^2: such motions are fed slowly. So a stage that is held
    for longer than ``PATIENCE_TICKS`` is held with the whole modulus (docs/solver.md).
    """
    return min(MOST_FOLLOW, FOLLOW_OVER_BOUND * damping / (Bricks.MODULUS_RATIO - 1))


def next_growth(growth: float, target: float, increment: float) -> float:
    """Growth after an increment towards a target: the target itself, if no more than one and a half are left."""
    remaining = target - growth
    return target if abs(remaining) <= 1.5 * increment else growth + math.copysign(increment, remaining)


def patience(growth_ticks: float | None = None) -> float:
    """Ticks at a stage after which growth goes on, at rest or not, if no motion is softer than that of folds.

    ``growth_ticks``: ticks of growth since the body last rested; None if it has not rested yet.
    """
    ticks = PATIENCE_TICKS if growth_ticks is None else PATIENCE_PER_GROWTH_TICK * growth_ticks
    return min(PATIENCE_TICKS, max(LEAST_PATIENCE_TICKS, ticks))


class Dynamics:
    """Grow a body step by step.

    Parameters
    ----------
    body : Body
    effects : sequence of Effect
        Optional effects; hooks that an effect does not override cost nothing.
    steps_per_unit : float
        Steps in which growth rises by 1; with fewer steps the run is faster but lags further behind equilibrium.
    damping : float, optional
        Share of the velocity lost per step; computed from DAMPING_PER_CROSSING by default.
    slow : Slow, optional
        Growth at which the pace is limited (:func:`morphofold.sim.equilibrium.wrinkle_onset.slow_growth`).
    start : State, optional
        State to begin at; at rest and ungrown by default.
    """

    def __init__(
        self,
        body: Body,
        effects: Sequence[Effect] = (),
        *,
        steps_per_unit: float,
        damping: float | None = None,
        slow: Slow | None = None,
        start: State | None = None,
    ):
        self.body, self.effects = body, tuple(effects)
        self.rate, self.slow = 1.0 / steps_per_unit, slow
        self.damping = DAMPING_PER_CROSSING / body.crossing if damping is None else damping
        self.waits_for_balance = True  # False if an effect makes time real
        self.patience_factor = 1.0  # on the time for which a stage is held
        self.state = State(body.X.copy(), np.zeros_like(body.X))
        self._rest_distance = REST_DISTANCE_OVER_T * body.thickness
        self.balance = Balance(body.crossing, body.X, self._rest_distance, softest(body))
        self.seconds: dict[str, float] = defaultdict(float)
        hooks = ("add_element_forces", "add_forces", "after_step", "pace", "refresh", "springs")
        self._effects_with = {hook: overriding(self.effects, hook) for hook in hooks}
        self._extra, self._forces = np.zeros((body.n_surface, 3)), np.zeros(body.X.shape)
        self._sound_state: dict[str, NDArray] = {}
        for effect in self.effects:
            effect.prepare(body)
        if start is not None:
            self.state = start
            body.grow(start.growth)
            body.elements.compute_forces(start.x, 1.0)
        self._measure()
        self._first_parts = {k: v for k, v in self.save(with_balance=False).items() if k not in ("x", "v")}

    def __repr__(self) -> str:
        effects = ", ".join(effect.name for effect in self.effects) or "no effects"
        return f"Dynamics({self.body!r}, {effects}, at growth {self.state.growth:.4g})"

    @property
    def threads(self) -> int:
        """Number of threads of a step: those of numba, or fewer for a small body."""
        return min(numba.get_num_threads(), 1 + len(self.body.X) // NODES_PER_THREAD)

    @classmethod
    def of(cls, scene: Scene, body: Body, effects: Sequence[Effect] = (), start: State | None = None) -> Dynamics:
        """The dynamics of a scene's body at the growth rate of the scene."""
        steps_per_unit = scene.steps_per_unit(body.crossing)
        run = cls(body, effects, steps_per_unit=steps_per_unit, slow=slow_growth(scene), start=start)
        run.patience_factor = scene.output.patience
        return run

    def grow_to(
        self, g: float, after: Callable[[State], None] = lambda state: None, until: Callable[[], bool] = lambda: False
    ) -> None:
        """Raise or lower the growth stretch to ``g``, or ``until`` that is true; ``after`` is called every
        ``STEPS_PER_MEASUREMENT`` steps.

        Raises
        ------
        OutOfRange
            If g is not a positive number.
        UnstableError
            If a position is no longer finite, the volume of an element is not positive, or J at a point of an element
            exceeds ``LARGEST_J``.
        """
        if not 0 < g < math.inf:
            raise OutOfRange(f"the growth stretch must be a positive number, got {g:g}.")
        if self.state.growth == g:
            return
        self.state.relaxed = self.state.earliest_rest = 0
        while self.state.growth != g and not until():
            self._split_bulk(True)
            increment = self.rate * STEPS_PER_MEASUREMENT * self._pace()
            new_growth = next_growth(self.state.growth, g, increment)
            self._run(STEPS_PER_MEASUREMENT, new_growth)
            if new_growth == g:
                self.balance.forget()  # the motion so far was that of growth
            after(self.state)

    def relax(
        self, steps: int, after: Callable[[State], None] = lambda state: None, damping: float | None = None
    ) -> None:
        """Take steps at the present growth until ``steps`` are done, rounded up to ``STEPS_PER_MEASUREMENT``; with
        another ``damping`` if that is given."""
        full_damping, self.damping = self.damping, self.damping if damping is None else damping
        while self.state.relaxed < steps:
            self._hold(after)
        self.damping = full_damping

    def hold(self, ticks: float, after: Callable[[State], None] = lambda state: None) -> bool:
        """Hold the growth for so long [ticks], less damped than during growth; returns whether the body seems at
        rest."""
        tick = self.body.crossing
        self.relax(round(ticks * tick), after, min(self.damping, REST_DAMPING_PER_CROSSING / tick))
        self.state.rested = self.state.step
        return self._record_rest(self.balance.calm >= REST_TICKS * tick)

    def _record_rest(self, seems_at_rest: bool, displacement: float = 0.0) -> bool:
        """Record whether the body is at rest, how far from it [mm], and whether it leaves a saddle.

        It leaves one if it seemed to rest and moved on, by the ``displacement`` [mm], or if its distance rises.
        """
        balance, at_rest = self.balance, seems_at_rest and displacement < self._rest_distance
        distance = balance.distance if at_rest else max(balance.left, displacement)
        is_leaving = not at_rest and bool(seems_at_rest or balance.distance > balance.mean)
        distance_over_T = distance / self.body.thickness
        self.state.record |= {"at_rest": at_rest, "leaving_saddle": is_leaving, "distance_over_T": distance_over_T}
        return at_rest

    def settle(
        self, after: Callable[[State], None] = lambda state: None, count_modes: Callable[[], int | None] = lambda: None
    ) -> bool:
        """Hold the growth until the body is at rest: within ``REST_DISTANCE_OVER_T`` for ``REST_TICKS``.

        Damping is less than during growth: critical for the softest folds, as in dynamic relaxation (Underwood 1983). A
        motion slower than theirs is damped critically, too; at first so is one that rings, because growth has stopped
        suddenly. If the body does not come to rest, growth goes on after its :func:`patience`, longer by the factor by
        which the motion is softer than that of folds, ``MOST_PATIENCE_FACTOR`` at most. Beyond
        ``AWAY_DISTANCE_OVER_T`` the time is ``PATIENCE_TICKS`` times ``MOST_PATIENCE_FACTOR``. After little growth the
        patience is short, since the body lags little; but not for a slender body, which bends slowly. Near a saddle a
        body is slow, too: if ``count_modes`` (which may count unstable modes) is not 0, growth does not go on for
        another ``PATIENCE_TICKS``, up to ``MOST_PATIENCE_FACTOR`` times as long. Nothing is done if time is real.

        A body that seems to rest may leave a saddle. So, unless its first wrinkles are still to come, it is held for as
        long as its :func:`patience` once more; it is at rest if it has moved by less than ``REST_DISTANCE_OVER_T``. The
        ``distance_over_T`` of the record is otherwise no less than that move; if the body does not seem to rest, it is
        ``balance.left``.

        Returns
        -------
        bool
            Whether the body is at rest; ``at_rest`` in the record, which also has ``leaving_saddle``.
        """
        tick, T, full_damping = self.body.crossing, self.body.thickness, self.damping
        balance, state, rest_damping = self.balance, self.state, min(full_damping, REST_DAMPING_PER_CROSSING / tick)
        growth_ticks, displacement = (state.step - state.relaxed - state.rested) / tick, 0.0
        most_ticks, is_smooth, seems_at_rest = PATIENCE_TICKS * MOST_PATIENCE_FACTOR, self._is_smooth, False
        while self.waits_for_balance:
            max_wait = SLENDER_PATIENCE_TICKS if balance.slender else patience(growth_ticks if state.rested else None)
            max_wait *= self.patience_factor * min(SOFT_MODE_W2 / balance.soft, MOST_PATIENCE_FACTOR)
            max_wait = max(max_wait, 2 * RING_DOWN_TICKS if is_smooth else 0.0)
            if balance.distance >= AWAY_DISTANCE_OVER_T * T:
                max_wait = max(max_wait, most_ticks)
            seems_at_rest = balance.calm >= REST_TICKS * tick and state.relaxed >= state.earliest_rest
            if seems_at_rest or state.relaxed >= state.earliest_rest + max_wait * tick:
                if state.relaxed < most_ticks * tick and count_modes():
                    state.earliest_rest = state.relaxed + round(PATIENCE_TICKS * tick)
                else:
                    first_x, more_steps = state.x.copy(), round(patience(growth_ticks) * tick)
                    if seems_at_rest and not is_smooth:  # no run can be resumed within
                        self.relax(state.relaxed + more_steps, damping=rest_damping)
                    displacement = float(np.mean(np.sum((state.x - first_x) ** 2, axis=1)) ** 0.5)
                    if displacement < self._rest_distance or state.relaxed >= max_wait * tick:
                        break
            is_ringing = state.relaxed < RING_DOWN_TICKS * tick and (is_smooth or balance.w2 > RINGING_W2 / tick**2)
            self.damping = rest_damping
            if is_ringing and not is_smooth:  # so much damping stops folds, too: they need some time to move again
                balance.calm = -round(tick / REST_DAMPING_PER_CROSSING)
            if is_ringing or 0 < balance.w2 < (0.5 * self.damping) ** 2:
                ringing_w2 = RINGING_W2 / tick**2 if is_ringing else 0.0
                self.damping = min(2 * math.sqrt(max(balance.w2, ringing_w2)), MOST_DAMPING)
            self._hold(after)
            self.damping = full_damping
        state.rested = state.step
        return self.waits_for_balance and self._record_rest(seems_at_rest, displacement)

    @property
    def _is_smooth(self) -> bool:
        """Whether the first wrinkles of theory are still to come."""
        return bool(self.slow and self.state.growth < self.slow.start)

    def energy_slope(self) -> float:
        """Work of the next increment of growth, at fixed positions and pressures, over the increment."""
        g, increment = self.state.growth, self.rate * STEPS_PER_INCREMENT * self._pace()
        energies = [self.body.acting_energy(self.state.x, growth) for growth in (g + increment, g)]
        return (energies[0] - energies[1]) / increment

    def _split_bulk(self, split: bool) -> None:
        if self.body.split_bulk(split and self.state.growth <= MOST_SPLIT_GROWTH):
            self.balance.forget()  # the mass is another
            self._measure()

    def _hold(self, after: Callable[[State], None]) -> None:
        self._split_bulk(self.state.relaxed < PATIENCE_TICKS * self.body.crossing)
        self._run(STEPS_PER_MEASUREMENT)
        self.state.relaxed += STEPS_PER_MEASUREMENT
        after(self.state)

    def save(self, with_balance: bool = True) -> dict[str, NDArray]:
        """The run as arrays, sufficient to resume with bitwise the same result; otherwise only to inspect."""
        state = self.state
        arrays = {"x": state.x.copy(), "v": state.v.copy()}
        arrays |= {key: np.array(getattr(state, key)) for key in STATE_SCALARS}
        for name, part in self._parts():
            if with_balance or part is not self.balance:
                arrays |= {f"{name}.{key}": value for key, value in part.save().items()}
        return arrays

    def enter(self, x: Array, v: Array, state: State, volume_ratios: Array) -> None:
        """Go on from positions and velocities (N, 3), and v/V of the elements (E,), of another run in this ``state``,
        which has another mesh."""
        scalars = {key: np.array(getattr(state, key)) for key in STATE_SCALARS}
        scalars["relaxed"] = scalars["earliest_rest"] = np.array(0)
        self.load(self.save() | self._first_parts | {"x": x, "v": v} | scalars)
        self.body.set_pressures(volume_ratios)
        self.relax(round(ENTRY_TICKS * self.body.crossing), damping=ENTRY_DAMPING)
        self.state.lowest_J, self.state.relaxed = state.lowest_J, 0
        self.balance.forget()

    def count_from(self, other: State) -> None:
        """Count steps, and the smallest J, from those of another run, which held this state on another mesh."""
        self.state.rested += other.step - self.state.step
        self.state.step, self.state.lowest_J = other.step, min(self.state.lowest_J, other.lowest_J)
        self.balance.forget()

    def _parts(self) -> list[tuple[str, Any]]:
        """Parts with a state of their own, by name."""
        return [("balance", self.balance), ("body", self.body), *((effect.name, effect) for effect in self.effects)]

    def load(self, arrays: dict[str, NDArray]) -> None:
        """Restore a run that ``save`` wrote."""
        self.state = State(arrays["x"].copy(), arrays["v"].copy(), **{key: arrays[key].item() for key in STATE_SCALARS})
        self.body.grow(self.state.growth)
        for name, part in self._parts():
            part.load({k.removeprefix(f"{name}."): array for k, array in arrays.items() if k.startswith(f"{name}.")})
        self._measure()

    def _pace(self) -> float:
        """Share of the full growth rate: less while the run is far from equilibrium, or if an effect requires it."""
        record, growth, growth_pace = self.state.record, self.state.growth, 1.0
        if self.waits_for_balance:
            growth_pace = soft_start(growth)
            growth_pace /= max(1.0, restlessness(growth, record["kinetic_over_strain"]) / KINETIC_LIMIT)
        if record["min_J"] < COLLAPSE_RATIO_OF_J * self.state.before_J:
            growth_pace = min(growth_pace, 0.5)
        if record["inverted"]:
            growth_pace = SLOWEST_PACE
        growth_pace = limited_pace(growth_pace, growth, self.slow)
        for effect in self._effects_with["pace"]:
            growth_pace *= effect.pace(growth)
        return growth_pace

    def _run(self, steps: int, new_growth: float | None = None) -> None:
        """Take steps, towards another growth if one is given, and measure."""
        with using_threads(self.threads):
            self._take(steps, new_growth)
            self._measure(steps)

    def _take(self, steps: int, target: float | None) -> None:
        body, state, start_growth, add_time = self.body, self.state, self.state.growth, _phase_timer(self.seconds)
        blocks = body.elements.blocks
        for k in range(steps):
            if target is not None and k % STEPS_PER_INCREMENT == 0:
                done_share = min(k + STEPS_PER_INCREMENT, steps) / steps
                state.growth = target if done_share == 1 else start_growth + done_share * (target - start_growth)
                body.grow(state.growth)
                add_time("grow")
            body.elements.compute_forces(state.x, follow_share(self.damping))
            add_time("elements")
            self._call("add_element_forces", add_time, body, state.x, state.v)
            body.filter.forces(state.x, self._extra)
            add_time("filter")
            self._call("add_forces", add_time, body, state.x, state.v, self._extra)
            previous_v = state.v.copy() if k == steps - 1 else state.v
            sum_forces(blocks.force, blocks.first, blocks.rows, body.rest, self._extra, body.free, self._forces)
            n_lost = body.levels.step(state.x, state.v, self._forces, body.mass, body.free, 1.0 - self.damping)
            add_time("advance")
            if n_lost:
                raise self._lost(state.step + k + 1)
            self._call("after_step", add_time, state.x, state.v)
        state.step += steps
        acceleration = state.v - (1.0 - self.damping) * previous_v  # of the last step; its positions are x - v
        self.balance.update(state.step, state.x - state.v, acceleration, body.mass, self.damping)
        add_time("balance")

    def _call(self, hook: str, add_time: Callable[[str], None], *hook_arguments: Any) -> None:
        """Call a hook of the effects that have it."""
        for effect in self._effects_with[hook]:
            getattr(effect, hook)(*hook_arguments)
            add_time(effect.name)

    def _lost(self, step: int) -> UnstableError:
        """The error at a step after which positions are NaN or infinite; it names the node where that began.

        It is the node at the centre of those whose forces, or else positions, are not finite.
        """
        is_lost = np.any(~np.isfinite(self._forces), axis=1)
        if not is_lost.any():
            is_lost = np.any(~np.isfinite(self.state.x), axis=1)
        corners, n = self.body.bilayer.mesh.t, len(self.state.x)
        lost_around = np.bincount(corners[:, is_lost[corners].all(axis=0)].ravel(), minlength=n)
        culprit = f"node {np.argmax(lost_around + is_lost)}"
        return self._unstable(f"{np.count_nonzero(is_lost)} of {n} nodes are not finite", step, culprit)

    def _burst(self) -> UnstableError:
        """The error of elements without volume, or with a J beyond ``LARGEST_J``; it names the first."""
        elements = self.body.elements
        by_element = elements.state()
        volume_ratio, max_J = by_element["volume_ratio"], by_element["J_max"]
        broken = np.flatnonzero(~((volume_ratio > 0) & (max_J <= elements.LARGEST_J)))
        culprit = f"element {broken[0]} with v/V = {volume_ratio[broken[0]]:.2f} and J up to {max_J[broken[0]]:.2f}"
        problem = f"{broken.size} of {elements.n} elements have no volume left or burst"
        return self._unstable(problem, self.state.step, culprit)

    def _unstable(self, problem: str, step: int, culprit: str) -> UnstableError:
        return UnstableError(
            f"{problem} at g = {self.state.growth:.3f}, step {step}; the first is {culprit}. Slow the growth down "
            "(growth.rate) or refine the mesh.",
            self._sound_state,
        )

    def _measure(self, steps: int = 0) -> None:
        """Measure mass, energies and volume ratios of the state, ``steps`` after the last measurement."""
        body, state, add_time = self.body, self.state, _phase_timer(self.seconds)
        if not np.isfinite(state.x).all():
            raise self._lost(state.step)
        body.update_state(state.x)
        measured = body.elements.summary()
        if not (measured.min_volume_ratio > 0 and measured.max_J <= body.elements.LARGEST_J):
            raise self._burst()
        strain_energy = measured.energy + body.filter.energy(state.x)
        state.before_J = state.record.get("min_J", state.before_J)
        state.lowest_J = min(state.lowest_J, measured.min_J)
        add_time("measure")
        self._call("refresh", add_time, self)
        body.update_levels(sum(effect.springs(body, state.x) for effect in self._effects_with["springs"]))
        kinetic_energy = body.kinetic_energy(state.v)
        state.dissipated += 2 * self.damping * kinetic_energy * steps
        state.record = {
            "step": state.step,
            "growth": state.growth,
            "strain_energy": strain_energy,
            "kinetic_energy": kinetic_energy,
            "kinetic_over_strain": kinetic_energy / strain_energy if strain_energy > 0 else 0.0,
            "dissipated_energy": state.dissipated,
            "distance_over_T": self.balance.distance / body.thickness if self.waits_for_balance else None,
            "at_rest": None,
            "leaving_saddle": None,
            "min_J": measured.min_J,
            "max_J": measured.max_J,
            "inverted": measured.inverted,
            "mean_volume_ratio": measured.mean_volume_ratio,
            "effects": {effect.name: {"energy": effect.energy(), **effect.record()} for effect in self.effects},
        }
        self._sound_state = self.save(with_balance=False)
        add_time("measure")


def _phase_timer(seconds_by_phase: dict[str, float]) -> Callable[[str], None]:
    """A function that adds the time since its last call to a phase of ``seconds_by_phase``."""
    last_time = working_seconds()

    def add_time(phase: str) -> None:
        nonlocal last_time
        time_now = working_seconds()
        seconds_by_phase[phase] += time_now - last_time
        last_time = time_now

    return add_time
