"""Courses of growth in time: how fast g rises from 1 to its final value."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from morphofold.errors import OutOfRange
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
    """Course of growth in time; without it growth rises linearly. The number of steps stays about the same.

    Each of the ``points`` of a ``table`` is a time and the growth stretch then, from 1 to ``growth.final``; growth is
    linear between them. Only ratios of times matter: the whole takes as long as a linear ramp.
    """

    theory = True
    at_onset = False
    counted = "sets the pace, takes no time"
    example = '{shape = "smooth"}'

    shape: Annotated[
        Literal["exponential", "smooth", "slowing", "table"], key("how growth rises; linear without this table")
    ]
    points: Annotated[
        tuple[Annotated[tuple[float, float], Field(strict=False)], ...],
        key("times and growth stretches of a table, such as [[0, 1], [3, 1.2], [4, 2]]", strict=False),
    ] = ()

    def check(self, scene: Scene) -> None:
        need_growth(scene, "effects.ramp")
        if (self.shape == "table") != bool(self.points):
            raise OutOfRange('effects.ramp: shape "table" needs points, and other shapes have none')
        final, growths = scene.growth.final, [g for _, g in self.points]
        rises = len(growths) > 1 and bool((np.diff(self.points, axis=0) > 0).all())
        if self.points and not (rises and (growths[0], growths[-1]) == (1, final)):
            raise OutOfRange(
                f"effects.ramp.points: times and growth must rise, growth from 1 to growth.final = {final:g}"
            )


def build(options: Options, scene: Scene) -> Effect:
    return Ramp(options.shape, scene.growth.final, options.points)


class Ramp(Effect):
    """Sets the rate of growth as a function of growth; shape and ``points`` as in :class:`Options`."""

    def __init__(self, shape: str, final: float, points: Sequence[tuple[float, float]] = ()):
        self._final = final
        if shape == "table":
            times, growths = np.transpose(points)
            rates = np.diff(growths) / np.diff(times) * np.ptp(times) / (final - 1)
            self._rate = lambda s, _: float(rates[np.searchsorted(growths[1:-1], 1 + s * (final - 1), side="right")])
        else:
            self._rate = RATE_BY_SHAPE[shape]

    def pace(self, g: float) -> float:
        return self._rate((g - 1) / (self._final - 1), self._final)
