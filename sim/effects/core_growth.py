"""The core grows too, isotropically: g_c of Eq. (9) of Razavi et al. (2015)."""

import math
from typing import Annotated

from morphofold.sim.effects import Effect, need_growth
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, key


class Options(EffectOptions):
    """Isotropic growth of the core, up to ``final`` when the cortex reaches its final growth (g_c of Eq. 9)."""

    shapes = (*EffectOptions.shapes, "radial")
    counted = "within grow"

    final: Annotated[float, key("growth stretch of the core at the final growth of the cortex", gt=0.5, le=4)] = 1.2

    def check(self, scene: Scene) -> None:
        need_growth(scene, "effects.core_growth")

    def share(self, scene: Scene) -> float:
        """Growth g - 1 of the core over that of the cortex."""
        return (self.final - 1) / (scene.growth.final - 1)

    def first_wrinkles(self, growth: float, scene: Scene) -> float:
        """Growth of the cortex at which its growth over that of the core reaches ``growth``, that of the theory."""
        core_share = self.share(scene)
        return growth * (1 - core_share) / (1 - growth * core_share) if growth * core_share < 1 else math.nan


def build(options: Options, scene: Scene) -> Effect:
    return CoreGrowth(options.share(scene))


class CoreGrowth(Effect):
    """The growth g - 1 of the core is a fixed ``share`` of that of the cortex."""

    def __init__(self, share: float):
        self.share = share

    def prepare(self, body) -> None:  # which may have one dimension
        body.core_share = self.share
