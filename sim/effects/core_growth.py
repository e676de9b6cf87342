"""The core grows too, isotropically: g_c of Eq. (9) of Razavi et al. (2015)."""

from __future__ import annotations

from morphofold.sim.body import Body
from morphofold.sim.effects import Effect


def build(options, scene) -> CoreGrowth:
    return CoreGrowth((options.final - 1) / (scene.growth.final - 1))


class CoreGrowth(Effect):
    """The core takes a fixed share of the growth g - 1 of the cortex."""

    name = "core_growth"

    def __init__(self, share: float):
        self._share = share

    def prepare(self, body: Body) -> None:
        body.core_share = self._share
