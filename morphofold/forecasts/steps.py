"""Number of steps of a run: those of the ramp are known, those of resting and waiting for balance are estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


@dataclass(frozen=True)
class Steps:
    """Steps of a run.

    Attributes
    ----------
    ramp : int
        Steps while the cortex grows as fast as its pace allows.
    resting, waiting : float
        Further steps: growth stops at a stage until the body is at rest, and waits for balance while folds form.
    fewest, most : float
        Fewest and most steps of both together that runs took.
    awake : float
        Time that active contact adds to a step, as a share of the step, mean over all steps.
    """

    ramp: int
    resting: float
    waiting: float
    fewest: float
    most: float
    awake: float

    @property
    def expected(self) -> int:
        """All steps."""
        return round(self.ramp + self.resting + self.waiting)

    @property
    def growing(self) -> float:
        """Steps in which the cortex grows."""
        return self.ramp + self.waiting


def steps_of(scene: Scene, per_unit: float, crossing: float, costs: Mapping[str, Any]) -> Steps:
    """Steps that a scene takes. Of its effects, a ramp and inertia change the pace, and contact adds time to steps.

    Parameters
    ----------
    scene : Scene
    per_unit : float
        Steps for growth to rise by 1 at full pace.
    crossing : float
        Steps in which a wave crosses the cortex: one tick of the clock that sets the pace.
    costs : mapping
        The table's ``costs``: how long runs rested and waited, and the time of contact.
    """
    from morphofold.sim.dynamics import SLOWEST_PACE, STEPS_PER_MEASUREMENT, patience, soft_start
    from morphofold.sim.effects import ramp as ramps
    from morphofold.sim.equilibrium.wrinkles import first_wrinkles, slow_growth

    waiting, resting, contact = costs["waiting"], costs["resting"], costs["contact"]
    touching = contact["per_growth"] if "contact" in scene.effects else 0.0
    folding = lambda g: max(0.0, g - contact["from"]) * touching
    shape = None if "ramp" not in scene.effects else ramps.build(scene.effects["ramp"], scene)
    waits, slow = not scene.real_time, slow_growth(scene)
    ramp, awake, growth, ramps_to = 0, 0.0, 1.0, [0]
    for stage in scene.stages:
        while growth < stage:  # as in Dynamics.grow_to
            pace = max(SLOWEST_PACE, soft_start(growth)) if waits else 1.0
            if slow is not None and slow.start <= growth <= slow.end:
                pace = min(pace, slow.pace)
            pace *= shape.pace(growth) if shape else 1.0
            increment = STEPS_PER_MEASUREMENT * pace / per_unit
            growth = stage if stage - growth <= 1.5 * increment else growth + increment
            ramp += STEPS_PER_MEASUREMENT
            awake += STEPS_PER_MEASUREMENT * folding(growth)
        ramps_to.append(ramp)
    if not waits:  # real masses: the step shrinks as bricks do
        more = ramp * costs["inertia"]["per_growth"] * (scene.growth.final - 1)
        fewest, most = (more * waiting[key] for key in ("fewest", "most"))
        return Steps(ramp, 0, more, fewest, most, awake / ramp if ramp else 0.0)
    wrinkled = first_wrinkles(scene).growth
    grown = [(b - a) / crossing for a, b in pairwise(ramps_to)]  # ticks up to each stage
    longest = [patience(), *map(patience, grown[1:])]
    rests = [
        crossing * (min(max(most, resting["brief"]), resting["folded"]) if not stage <= wrinkled else resting["smooth"])
        for most, stage in zip(longest, scene.stages)
    ]
    awake += sum(rest * folding(stage) for rest, stage in zip(rests, scene.stages))
    folded = (scene.growth.final - waiting["from"]) / (waiting["to"] - waiting["from"])
    ticks = waiting["ticks"] * scene.material.mu_ratio ** waiting["stiffness_power"] * scene.growth.rate
    more = min(max(folded, 0.0), 1.0) * ticks * crossing
    fewest, most = (more * waiting[key] + sum(rests) * resting[key] for key in ("fewest", "most"))
    return Steps(ramp, sum(rests), more, fewest, most, awake / (ramp + sum(rests)) if ramp else 0.0)
