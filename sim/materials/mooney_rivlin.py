"""Mooney-Rivlin (Mooney 1940, Rivlin 1948): part of the stiffness resists changes of area, not of length."""

from typing import Annotated, Any, Literal, NamedTuple

from morphofold.sim.scene.table_bases import MaterialOptions, key


class Options(MaterialOptions):
    """As neo-Hookean, but with C1 (i1 - 3) + C2 (i2 - 3), mu = 2 (C1 + C2), ``second_share`` = C2 / (C1 + C2)."""

    model: Annotated[Literal["mooney-rivlin"], key("which material")]
    second_share: Annotated[
        float, key("share of the shear modulus that belongs to the second invariant", ge=0, le=1)
    ] = 0.25

    def build(self) -> "MooneyRivlin":
        return MooneyRivlin(self.second_share)


class MooneyRivlin(NamedTuple):
    """u = (1 - s) (i1 - 3) / 2 + s (i2 - 3) / 2, with s the share of the second invariant."""

    share: float

    @property
    def uses_i2(self) -> bool:
        return True

    def energy(self, i1: Any, i2: Any) -> Any:
        return 0.5 * (1.0 - self.share) * (i1 - 3.0) + 0.5 * self.share * (i2 - 3.0)

    def slopes(self, i1: Any, i2: Any) -> tuple[Any, Any]:
        return 0.5 * (1.0 - self.share), 0.5 * self.share

    def curvatures(self, i1: Any, i2: Any) -> tuple[Any, Any, Any]:
        return 0.0, 0.0, 0.0
