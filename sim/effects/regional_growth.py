"""A map of growth: parts of the cortex grow more or less than the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.brick_mesh import spot_factors
from morphofold.sim.scene.tables import EffectOptions, Spot, key

if TYPE_CHECKING:
    from morphofold.sim.scene import Scene


class Options(EffectOptions):
    """Regions where the cortex takes ``factor`` times the growth g - 1."""

    counted = "within grow"
    example = "{spots = [{centre = [0, 0, 50], radius = 20, factor = 0.5}]}"

    spots: Annotated[
        tuple[Spot, ...],
        key("regions where the cortex takes `factor` times the growth g - 1", strict=False, min_length=1),
    ]

    def first_wrinkles(self, growth: float, scene: Scene) -> float:
        """Where the cortex grows most."""
        return 1 + (growth - 1) / max(1.0, *(spot.factor for spot in self.spots))


def build(options: Options, scene: Scene) -> RegionalGrowth:
    return RegionalGrowth([(spot.centre, spot.radius, spot.factor) for spot in options.spots])


class RegionalGrowth(Effect):
    """Each element of the cortex takes a share of the growth g - 1 that depends on the pial point it lies under."""

    name = "regional_growth"

    def __init__(self, spots):
        self._spots = spots

    def prepare(self, body: Body) -> None:
        corners = body.bilayer.mesh.t[:, : body.elements.n_cortex]
        body.pattern = spot_factors(body.bilayer.foot[corners].mean(axis=0), self._spots)
