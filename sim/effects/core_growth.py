"""The core grows too, isotropically: g_c of Eq. (9) of Razavi et al. (2015)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from morphofold.sim.effects import Effect

if TYPE_CHECKING:                                       # a body of one dimension calls for this effect too
    from morphofold.sim.body import Body


def build(options, scene) -> CoreGrowth:
    return CoreGrowth((options.final - 1) / (scene.growth.final - 1))


class CoreGrowth(Effect):
    """The core takes a fixed ``share`` of the growth g - 1 of the cortex."""

    name = "core_growth"

    def __init__(self, share: float):
        self.share = share

    def prepare(self, body: Body) -> None:
        body.core_share = self.share
