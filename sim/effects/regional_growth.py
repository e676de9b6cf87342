"""A map of growth: parts of the cortex grow more or less than the rest."""

from __future__ import annotations

from morphofold.sim.body import Body
from morphofold.sim.effects import Effect
from morphofold.sim.mesh.bilayer import spot_factors


def build(options, scene) -> RegionalGrowth:
    return RegionalGrowth([(spot.centre, spot.radius, spot.factor) for spot in options.spots])


class RegionalGrowth(Effect):
    """Each element of the cortex takes a share of the growth g - 1 that depends on the pial point it lies under."""

    name = "regional_growth"

    def __init__(self, spots):
        self._spots = spots

    def prepare(self, body: Body) -> None:
        corners = body.bilayer.mesh.t[:, : body.elements.n_cortex]
        body.pattern = spot_factors(body.bilayer.foot[corners].mean(axis=0), self._spots)
