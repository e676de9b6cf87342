"""Growth by a map: the cortex grows more or less from place to place, as a file says."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from morphofold.errors import OptionsClash, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.shapes import even_directions
from morphofold.sim.body import Body
from morphofold.sim.effects import Effect, need_growth
from morphofold.sim.hemisphere.subject_maps import MapAtNodes
from morphofold.sim.scene import Scene
from morphofold.sim.scene.table_bases import EffectOptions, SphereMap, key

LARGEST_FACTOR = 8.0
SPHERE_POINTS = 2000  # on the sphere at which a map is looked at


class Options(SphereMap, EffectOptions):
    """A map of the growth. ``values = "factor"``: of the factor on the growth g - 1.

    ``values = "area ratio"``: of the area of the cortex at the final growth, over its area before, up to a factor; the
    mean over the body is that of uniform growth. With ``file = "area_ratio"`` it is the subject's own: the area of the
    folded surface over that of the unfolded one. Point data of a mesh are ratios as they are, whatever their mean. A
    place that has less area than before does not grow.

    ``curve``: points (g, weight); between them the weight is linear. 0 is uniform growth, 1 is that of the map, which
    is the default at any g.
    """

    shapes = ("sphere", "ellipsoid", "cortex", "mesh")
    counted = "within grow"
    example = (
        '{file = "fsaverage5/surf/lh.area", sphere = "fsaverage5/surf/lh.sphere", values = "area ratio", '
        "curve = [[1, 0], [2, 0.2]]}"
    )

    values: Annotated[
        Literal["factor", "area ratio"],
        key("what the map gives: the factor on the growth g - 1, or the final area over the first, up to a factor"),
    ] = "factor"
    curve: Annotated[
        tuple[Annotated[tuple[float, Annotated[float, Field(ge=0, le=1)]], Field(strict=False)], ...],
        key("points (g, weight of the map): 0 is uniform growth, 1, the default, that of the map", strict=False),
    ] = ()
    held_from: Annotated[
        float | None,
        key("growth g from which differences of lengths stay: the weight falls as 1 / (g - 1); excludes `curve`", gt=1),
    ] = None

    def check(self, scene: Scene) -> None:
        growths = [g for g, _ in self.curve]
        if sorted(set(growths)) != growths:
            raise OutOfRange("effects.growth_map.curve: growths must rise from point to point")
        if self.curve and self.held_from:
            raise OptionsClash("effects.growth_map: curve and held_from both set the weight. Leave one out.")
        if self.values == "area ratio":
            need_growth(scene, "effects.growth_map.values")

    def files(self, scene: Scene) -> dict[str, Path]:
        return MapAtNodes(self, scene.geometry, "growth_map").files

    def first_wrinkles(self, growth: float, scene: Scene) -> float:
        """Growth g at which the place that grows most reaches ``growth``."""
        growth_map = MapAtNodes(self, scene.geometry, "growth_map")
        if growth_map.on_sphere is None:
            return growth
        factor = GrowthMap(growth_map, self, scene).factors(growth_map.on_sphere(even_directions(SPHERE_POINTS)))
        most = max(1.0, float(factor.max()))
        if self.held_from is not None:  # the length of that place rises as g once the map is held
            sooner = 1 + (growth - 1) / most
            return sooner if sooner <= self.held_from else growth - (self.held_from - 1) * (most - 1)
        return 1 + (growth - 1) / max(1.0, 1 + self.weight(growth) * (most - 1))

    def weight(self, g: float) -> float:
        """Weight of the map at growth g."""
        if self.held_from is not None and g > self.held_from:
            return (self.held_from - 1) / (g - 1)
        if not self.curve:
            return 1.0
        return float(np.interp(g, [curve_g for curve_g, _ in self.curve], [weight for _, weight in self.curve]))


def build(options: Options, scene: Scene) -> Effect:
    return GrowthMap(MapAtNodes(options, scene.geometry, "growth_map"), options, scene)


class GrowthMap(Effect):
    """Multiplies the growth g - 1 of each element of the cortex by a factor from a map, whose weight may change."""

    def __init__(self, node_map: MapAtNodes, options: Options, scene: Scene):
        self._map, self._options = node_map, options
        self._final = scene.growth.final if options.values == "area ratio" else None

    def factors(self, values: Array) -> Array:
        """Factors on the growth from values of the map, which are ratios of areas or factors themselves."""
        if self._final is not None:
            stretch = self._final * np.sqrt(np.maximum(values, 0) / self._map.mean)
            values = np.maximum((stretch - 1) / (self._final - 1), 0.0)
        if not (np.isfinite(values).all() and values.min() >= 0 and values.max() <= LARGEST_FACTOR):
            raise OutOfRange(
                f"{self._options.file}: makes factors of {np.nanmin(values):.3g} to {np.nanmax(values):.3g} on the "
                f"growth; they must be 0 to {LARGEST_FACTOR:g}."
            )
        return values

    def prepare(self, body: Body) -> None:
        corners = body.bilayer.mesh.t[:, : body.elements.n_cortex]
        factor = self.factors(self._map.at(body.bilayer))[corners].mean(axis=0)
        if self._options.curve or self._options.held_from:
            body.changing.append(lambda g: 1 + self._options.weight(g) * (factor - 1))
        else:
            body.pattern = body.pattern * factor
