"""True inertia: the mass is that of the material and time is real, instead of a relaxation to equilibrium."""

from typing import Annotated, Any

import numpy as np

from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.scene.table_bases import EffectOptions, key


class Options(EffectOptions):
    """True inertia. ``duration``: time in which growth rises by 1. ``damping``: decay rate of velocities, per unit of
    time. The unit is the time of a shear wave across 1 mm of core at density 1. Growth still slows down for collapsing
    elements."""

    theory = True
    real_time = True
    at_onset = False

    density: Annotated[float, key("density of the body; the unit of time is for density 1", ge=1e-4, le=1e4)] = 1.0
    duration: Annotated[
        float, key("time for growth to rise by 1; unit: time of a shear wave across 1 mm of core", ge=1, le=1e6)
    ] = 500.0
    damping: Annotated[float, key("rate at which velocities decay, per unit of time", ge=0, le=10)] = 0.05


class Inertia(Effect):
    """Real mass and time: a step of the solver, one unit long, is the longest time step that is stable.

    Parameters
    ----------
    density : float
        Density of the reference body, in units in which lengths are mm and the core's shear modulus is 1.
    duration : float
        Time in which growth rises by 1, in mm sqrt(density / mu of the core): a shear wave takes 1 per mm in the core.
    damping : float
        Rate at which velocities decay, per unit of time.
    """

    saved = ("_dt", "_time", "_step")

    def __init__(self, density: float, duration: float, damping: float):
        self._density, self._duration, self._damping = density, duration * np.sqrt(density), damping / np.sqrt(density)
        self._dt, self._time, self._step = 0.0, 0.0, 0

    def prepare(self, body: Body) -> None:
        self._mass = self._density * body.nodal_volumes()
        body.levels.remove()

    def refresh(self, run) -> None:
        dt = float(np.sqrt(np.min(self._mass / run.body.mass)))  # body.mass: the smallest for a step of one
        if self._dt:
            run.state.v *= dt / self._dt  # velocities are per step
            self._time += (run.state.step - self._step) * self._dt
        self._dt, self._step = dt, run.state.step
        run.body.mass[:] = self._mass / dt**2
        run.rate, run.waits_for_balance = dt / self._duration, False
        run.damping = -np.expm1(-self._damping * dt)

    def record(self) -> dict[str, Any]:
        return {"time": self._time, "time_step": self._dt}
