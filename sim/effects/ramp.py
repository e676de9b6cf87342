"""Shapes of the growth ramp: how fast g rises from 1 to its final value."""

import math
from typing import Annotated, Literal

from morphofold.sim.effects import Effect, need_growth
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, key

SLOWING_FINAL_RATE = 0.1  # final rate of the slowing ramp, over its first rate, about

#: rate over that of the linear ramp at a share s of the growth; the mean of 1/rate is 1, so the total time is the same
RATE_BY_SHAPE = {
    "exponential": lambda s, final: (1 + s * (final - 1)) * math.log(final) / (final - 1),
    "smooth": lambda s, final: math.pi * max(math.sqrt(max(s * (1 - s), 0.0)), 0.05),
    "slowing": lambda s, final: math.log((1 + SLOWING_FINAL_RATE) / SLOWING_FINAL_RATE) * (1 + SLOWING_FINAL_RATE - s),
}


class Options(EffectOptions):
    """Shape of the growth ramp; without it growth rises linearly. The number of steps stays about the same."""

    theory = True
    at_onset = False
    counted = "sets the pace, takes no time"
    example = '{shape = "smooth"}'

    shape: Annotated[Literal["exponential", "smooth", "slowing"], key("how growth rises; linear without this table")]

    def check(self, scene: Scene) -> None:
        need_growth(scene, "effects.ramp")


def build(options: Options, scene: Scene) -> Effect:
    return Ramp(options.shape, scene.growth.final)


class Ramp(Effect):
    """Sets the rate of growth as a function of growth."""

    def __init__(self, shape: str, final: float):
        self._rate, self._final = RATE_BY_SHAPE[shape], final

    def pace(self, g: float) -> float:
        return self._rate((g - 1) / (self._final - 1), self._final)
