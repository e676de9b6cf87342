"""Laws of growth of the cortex, and how much its volume grows; the kernels have the tensors in the point data
(brick_kernels.grow)."""

from typing import Any

from morphofold.validators import one_of

LAWS = ("isotropic", "tangential")


def check_law(law: str) -> None:
    """Raise ``UnknownName`` if ``law`` is not a growth law."""
    one_of(law, LAWS, "growth law")


def volume(g: Any, law: str) -> Any:
    """det G for growth g, a float or an array: g^3 if isotropic, g^2 if tangential; ``UnknownName`` for another law."""
    check_law(law)
    return g**3 if law == "isotropic" else g**2
