"""Regional growth: parts of the cortex grow more or less than the rest."""

from typing import Annotated

from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import spot_factors
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, Spot, key


class Options(EffectOptions):
    """Regions where the growth g - 1 of the cortex is multiplied by ``factor``."""

    counted = "within grow"
    example = "{spots = [{centre = [0, 0, 50], radius = 20, factor = 0.5}]}"

    spots: Annotated[
        tuple[Spot, ...], key("regions where the growth g - 1 is multiplied by `factor`", strict=False, min_length=1)
    ]

    def first_wrinkles(self, growth: float, scene: Scene) -> float:
        """Growth g at which the region that grows most reaches ``growth``."""
        return 1 + (growth - 1) / max(1.0, *(spot.factor for spot in self.spots))


def build(options: Options, scene: Scene) -> Effect:
    return RegionalGrowth([(spot.centre, spot.radius, spot.factor) for spot in options.spots])


class RegionalGrowth(Effect):
    """Multiplies the growth g - 1 of each element of the cortex by a factor that depends on the pial point above it."""

    def __init__(self, spots):
        self._spots = spots

    def prepare(self, body: Body) -> None:
        corner_nodes = body.bilayer.mesh.t[:, : body.elements.n_cortex]
        body.pattern = body.pattern * spot_factors(body.bilayer.foot[corner_nodes].mean(axis=0), self._spots)
