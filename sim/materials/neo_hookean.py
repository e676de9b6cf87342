"""Neo-Hookean: the material of the paper, Eq. (4) of Razavi et al. (2015)."""

from typing import Annotated, Any, Literal, NamedTuple

from morphofold.sim.scene.table_bases import MaterialOptions, key


class Options(MaterialOptions):
    """``mu_ratio``: shear modulus of the cortex over that of the core. ``kappa_ratio``: bulk over shear modulus, in
    both layers."""

    theory = True
    errors_known = True

    model: Annotated[Literal["neo-hookean"], key("which material", exclude=True)] = "neo-hookean"

    def build(self) -> "NeoHookean":
        return NeoHookean()


class NeoHookean(NamedTuple):
    """u = (i1 - 3) / 2."""

    @property
    def uses_i2(self) -> bool:
        return False

    def energy(self, i1: Any, i2: Any) -> Any:
        return 0.5 * (i1 - 3.0)

    def slopes(self, i1: Any, i2: Any) -> tuple[Any, Any]:
        return 0.5, 0.0

    def curvatures(self, i1: Any, i2: Any) -> tuple[Any, Any, Any]:
        return 0.0, 0.0, 0.0


NEO_HOOKEAN = NeoHookean()
