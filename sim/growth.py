"""Growth tensors as in the equations; the kernels include them in the point data (brick_kernels.grow)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import UnknownName

LAWS = ("isotropic", "tangential")


def check_law(law: str) -> None:
    """Raise ``UnknownName`` if ``law`` is not a growth law."""
    if law not in LAWS:
        raise UnknownName(f"growth law must be one of {', '.join(LAWS)}, got {law!r}.")


def volume(g: Any, law: str) -> Any:
    """det G for growth g, a float or an array: g^3 if isotropic, g^2 if tangential; ``UnknownName`` for another law."""
    check_law(law)
    return g**3 if law == "isotropic" else g**2


def growth_tensor(g: NDArray[np.float64] | float, radial: NDArray[np.float64], law: str) -> NDArray[np.float64]:
    """Growth tensor G in F = A G (Razavi et al. 2015, Eq. 1).

    Parameters
    ----------
    g : float or (...) float64
        Growth stretch, a ratio of lengths; 1 means no growth.
    radial : (..., 3) float64
        Unit reference direction N; tangential growth adds nothing along it.
    law : {"isotropic", "tangential"}
        ``g I`` (paper, before Eq. 2), or ``g (I - N N) + N N`` (before Eq. 3).

    Returns
    -------
    G : (..., 3, 3) float64

    Raises
    ------
    UnknownName
        For another law.
    """
    check_law(law)
    g = np.asarray(g, dtype=np.float64)[..., None, None]
    if law == "isotropic":
        return g * np.broadcast_to(np.eye(3), radial.shape + (3,))
    NN = radial[..., :, None] * radial[..., None, :]
    return g * (np.eye(3) - NN) + NN
