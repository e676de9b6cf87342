"""Shapes of the growth ramp: how fast g rises on its way from 1 to its final value."""

from __future__ import annotations

import math

from morphofold.sim.effects import Effect

LAST = 0.1              # the slowing ramp ends at about this share of its first rate

#: rate over that of the linear ramp at a share s of the way, each of mean slowness 1: the time of the ramp stays
RATES = {
    "exponential": lambda s, final: (1 + s * (final - 1)) * math.log(final) / (final - 1),
    "smooth": lambda s, final: math.pi * max(math.sqrt(max(s * (1 - s), 0.0)), 0.05),
    "slowing": lambda s, final: math.log((1 + LAST) / LAST) * (1 + LAST - s),
}


def build(options, scene) -> Ramp:
    return Ramp(options.shape, scene.growth.final)


class Ramp(Effect):
    """The rate of growth as a function of growth."""

    name = "ramp"

    def __init__(self, shape: str, final: float):
        self._rate, self._final = RATES[shape], final

    def pace(self, g: float) -> float:
        return self._rate((g - 1) / (self._final - 1), self._final)
