"""How many steps a run takes: those of its ramp and of its relaxation are known, those in which it waits are not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


@dataclass(frozen=True)
class Steps:
    """Steps of a run.

    Attributes
    ----------
    ramp, relaxing : int
        While the cortex grows as fast as its pace lets it, and at the final growth afterwards.
    waiting : float
        More of them, in which growth waits for balance while folds form; between ``fewest`` and ``most`` were seen.
    awake : float
        Mean over all steps of how far contact has woken, as a share of a step: what it then adds to one.
    """

    ramp: int
    relaxing: int
    waiting: float
    fewest: float
    most: float
    awake: float

    @property
    def expected(self) -> int:
        """All of them."""
        return round(self.ramp + self.relaxing + self.waiting)

    @property
    def growing(self) -> float:
        """Steps in which the cortex grows."""
        return self.ramp + self.waiting


def steps_of(scene: Scene, per_unit: float, crossing: float, costs: Mapping[str, Any]) -> Steps:
    """Steps that a scene takes. Of its effects, a ramp and true inertia change the pace, and contact while it presses.

    Parameters
    ----------
    scene : Scene
    per_unit : float
        Steps for growth to rise by 1 at full pace.
    crossing : float
        Steps in which a wave crosses the cortex: one tick of the clock that sets the pace.
    costs : mapping
        The table's ``costs``: how long runs waited, and what contact took.
    """
    from morphofold.sim.dynamics import REFRESH, SLOWEST, soft_start
    from morphofold.sim.effects import ramp as ramps
    from morphofold.sim.run import RELAXATION
    from morphofold.sim.wrinkles import slow_growth

    waiting, contact = costs["waiting"], costs["contact"]
    touching = contact["per_growth"] if "contact" in scene.effects.named else 0.0
    folding = lambda g: max(0.0, g - contact["from"]) * touching
    shape = None if scene.effects.ramp is None else ramps.build(scene.effects.ramp, scene)
    waits, slow = scene.effects.inertia is None, slow_growth(scene)
    ramp, awake, growth = 0, 0.0, 1.0
    for stage in scene.stages:
        while growth < stage:                                           # as Dynamics.grow_to does
            pace = max(SLOWEST, soft_start(growth)) if waits else 1.0
            if slow is not None and slow.start <= growth <= slow.end:
                pace = min(pace, slow.pace)
            pace *= shape.pace(growth) if shape else 1.0
            increment = REFRESH * pace / per_unit
            growth = stage if stage - growth <= 1.5 * increment else growth + increment
            ramp += REFRESH
            awake += REFRESH * folding(growth)
    relaxing = -(-int(RELAXATION * per_unit * (scene.growth.final - 1)) // REFRESH) * REFRESH
    awake += relaxing * folding(scene.growth.final)
    if waits:
        folded = (scene.growth.final - waiting["from"]) / (waiting["to"] - waiting["from"])
        ticks = waiting["ticks"] * scene.material.mu_ratio ** waiting["stiffness_power"] * scene.growth.rate
        more = min(max(folded, 0.0), 1.0) * ticks * crossing
    else:                                                               # real masses: the step shrinks as bricks do
        more = (ramp + relaxing) * costs["inertia"]["per_growth"] * (scene.growth.final - 1)
    fewest, most = (more * waiting[key] for key in ("fewest", "most"))
    return Steps(ramp, relaxing, more, fewest, most, awake / (ramp + relaxing) if ramp else 0.0)
