"""Theory of the growing bilayer sphere, without a simulation: radius, stress, critical growth.

Reference radii: a fixed hole A, the core/cortex interface B, the outer surface C; r is the deformed radius of R.
Both layers are incompressible and neo-Hookean, F = A.G (Razavi et al. 2015, Eqs. 1-5); the cortex grows by g, the
core by g_core. Radii with a bar are over B, as in Eqs. (11) to (13). :func:`bifurcation` finds where a fold begins
without a crease; the paper does not have it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from morphofold.errors import ImpossibleBody, OptionsClash, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.growth_laws import check_law, volume
from morphofold.sim.sphere_theory.smooth_sphere import stress_primitive
from morphofold.sim.sphere_theory.wrinkling import CREASE, Bifurcation, bifurcation
from morphofold.validators import one_of, positive

__all__ = [
    "BIOT",
    "CREASE",
    "Bifurcation",
    "Stresses",
    "bifurcation",
    "critical_growth",
    "deformed_radius",
    "stresses",
    "thickest_creasing",
]

#: lambda_r/lambda_theta at which a surface wrinkles: 1/x, x^3 + x^2 + 3x = 1 (Biot 1963); equibiaxial stretch 0.6661
BIOT = 3.382975767906237


class Stresses(NamedTuple):
    """Cauchy stresses along a radius: deformed radius r, sigma_r and sigma_theta = sigma_phi, each (n,)."""

    r: Array
    sigma_r: Array
    sigma_theta: Array


def deformed_radius(
    g: ArrayLike,
    C_bar: ArrayLike,
    law: str = "isotropic",
    *,
    R_bar: ArrayLike | None = None,
    g_core: ArrayLike = 1.0,
    A_bar: ArrayLike | None = None,
) -> Array:
    """Deformed radius over B of the grown bilayer sphere; by default of its outer surface.

    Parameters
    ----------
    g : (...) float
        Growth stretch of the cortex, g_s in the paper; a ratio of lengths, 1 means no growth.
    C_bar : (...) float
        Outer radius C/B > 1.
    law : {"isotropic", "tangential"}
        Growth of the cortex: the same in all directions, or none along the radius.
    R_bar : (...) float, optional
        Reference radius R/B, from A_bar to C_bar; C_bar if None.
    g_core : (...) float
        Growth stretch of the core, isotropic under both laws; g_c of Eq. (9).
    A_bar : (...) float, optional
        Radius A/B of the fixed hole; half of C_bar if None, as in the paper. It matters only if the core grows.

    Returns
    -------
    r_bar : (...) float64
        r/B. With g_core = 1 it is r/B of Eq. (11); times B/A it is Eq. (10).

    Raises
    ------
    ValueError
        For growth that is not positive, radii out of order, or another law.

    Notes
    -----
    For incompressible growth r^2 dr = det(G) R^2 dR (Eq. 8). Integrated outwards from the fixed hole, through the core
    and then the cortex (Eqs. 9 and 10)::

        r^3 = A^3 + g_core^3 (R^3 - A^3)            in the core; b^3 its value at B
        r^3 = b^3 + det(G) (R^3 - B^3)              in the cortex; det(G) = g^3, or g^2 if tangential

    The paper gives the isotropic case. Its text estimates g by "g_s^3 = V/V_0, the volume ratio of the deformed
    system": that holds for the volume of the cortex alone, because the volume of the core does not change.
    """
    growth, outer, core_growth = _above(0, g, "g"), _above(1, C_bar, "C_bar = C/B"), _above(0, g_core, "g_core")
    hole = _checked_hole_radius(A_bar, outer, core_growth)
    R = outer if R_bar is None else np.asarray(R_bar, dtype=np.float64)
    if not np.all((R >= hole) & (R <= outer)):
        raise OutOfRange(f"R_bar = R/B must lie from A_bar = {hole.min():g} to C_bar = {outer.max():g}, got {R}.")
    core_r_cubed = hole**3 + core_growth**3 * (np.minimum(R, 1) ** 3 - hole**3)
    return np.cbrt(core_r_cubed + volume(growth, law) * (np.maximum(R, 1) ** 3 - 1))


def stresses(
    g: float,
    B: float,
    C: float,
    law: str = "isotropic",
    *,
    mu_cortex: float = 1.0,
    n: int = 101,
    part: str = "cortex",
    mu_core: float = 1.0,
    A: float | None = None,
    g_core: float = 1.0,
) -> Stresses:
    """Stresses along the radius of the grown cortex, or of the core, in closed form (Fig. 3b).

    Parameters
    ----------
    g : float
        Growth stretch of the cortex.
    B, C : float
        Reference radii of the interface and of the outer surface, in any one unit of length.
    law : {"isotropic", "tangential"}
    mu_cortex, mu_core : float
        Shear moduli; stresses are in their unit.
    n : int
        Number of points, equally spaced in the reference radius from B to C (cortex) or from A to B (core).
    part : {"cortex", "core"}
        Layer. sigma_r is continuous at the interface, sigma_theta jumps there.
    A : float, optional
        Radius of the fixed hole; C/2 if None.
    g_core : float
        Isotropic growth stretch of the core.

    Returns
    -------
    Stresses
        r (n,) in the unit of B and C, sigma_r and sigma_theta (n,) in the unit of the moduli; tension positive.

    Raises
    ------
    ValueError
        For growth or moduli that are not positive, radii out of order, n < 2, another law or part.

    Notes
    -----
    With lambda = r/(R g) and lambda_r = 1/lambda^2 (incompressible), Eqs. (4) to (6) are::

        d sigma_r / dr = 2 (sigma_theta - sigma_r) / r,   sigma_theta - sigma_r = mu (lambda^2 - lambda^-4)

    with sigma_r = 0 at C and continuous at B. For isotropic growth dr/r = d lambda / (lambda (1 - lambda^3)), and
    the integral is ``sigma_r = f(lambda) - f(lambda at C)``, ``f = mu (lambda^-4/2 + 2/lambda)``. For tangential
    growth, with q = r/R, it has the same form with ::

        f = 2 mu [(1 - g^2) Q + g^4/(4 q^4) + g^2/q],     dQ = q dq / (g^2 - q^3)

    In Q, the logarithm of |g^2 - q^3| can be written with that of R, since R^3 (g^2 - q^3) is constant: it stays exact
    where q^3 is close to g^2. A core that does not grow does not deform: its stress is the uniform pressure of the
    cortex. The stress in the cortex does not depend on the core's modulus.
    """
    hole_radius = C / 2 if A is None else A
    if not (np.isfinite([B, C, hole_radius]).all() and 0 <= hole_radius < B < C):
        raise ImpossibleBody(f"radii must be ordered 0 <= A < B < C, got A = {hole_radius:g}, B = {B:g}, C = {C:g}.")
    positive(mu_cortex, "mu_cortex", "shear modulus")
    positive(mu_core, "mu_core", "shear modulus")
    if n < 2:
        raise OutOfRange(f"n must be at least 2 points, got {n}.")
    one_of(part, ("cortex", "core"), "part")
    if part == "core" and hole_radius == 0 and g_core != 1:
        raise OutOfRange("the stress of a growing core without a hole (A = 0) is infinite at its centre: give A > 0.")

    def layer_stress(R: Array, growth: float, layer_law: str, mu: float) -> tuple[Array, Array, Array]:
        r = B * deformed_radius(g, C / B, law, R_bar=R / B, g_core=g_core, A_bar=hole_radius / B)
        q = np.divide(r, R, out=np.full(len(R), g_core), where=R > 0)
        stretch = q / growth
        return r, mu * stress_primitive(q, R, growth, layer_law), mu * (stretch**2 - stretch**-4)

    r, primitive, stress_difference = layer_stress(np.linspace(B, C, n), g, law, mu_cortex)
    sigma_r = primitive - primitive[-1]
    if part == "core":
        interface_stress = sigma_r[0]
        r, primitive, stress_difference = layer_stress(np.linspace(hole_radius, B, n), g_core, "isotropic", mu_core)
        sigma_r = interface_stress + primitive - primitive[-1]
    return Stresses(r, sigma_r, sigma_r + stress_difference)


def critical_growth(
    C_bar: ArrayLike,
    law: str = "isotropic",
    *,
    ratio: float = CREASE,
    g_core: ArrayLike = 1.0,
    A_bar: ArrayLike | None = None,
) -> Array:
    """Growth at which lambda_r/lambda_theta of the outer surface reaches ``ratio``: the crease criterion, Eq. (7).

    Parameters
    ----------
    C_bar : (...) float
        Outer radius C/B > 1.
    law : {"isotropic", "tangential"}
    ratio : float
        2.4 for creases (Hong, Zhao and Suo 2009, as in Eq. 7); :data:`BIOT` for wrinkles of vanishing length.
    g_core, A_bar
        As for :func:`deformed_radius`.

    Returns
    -------
    g_crit : (...) float64
        NaN where the surface never reaches the ratio: for isotropic growth, where C_bar is not below
        :func:`thickest_creasing`. For tangential growth it always exists.

    Raises
    ------
    ValueError
        As for :func:`deformed_radius`, and for a ratio that is not above 1 and finite.

    Notes
    -----
    At R = C, incompressible: lambda_r/lambda_theta = lambda_theta^-3 with lambda_theta = c/(g C). Isotropic, with c
    from Eq. (10) and b the deformed radius of the interface (b = B if the core doesn't grow)::

        g^3 = b_bar^3 / (1 - C_bar^3 (1 - 1/ratio))                                      Eq. (12) at 2.4: 7/12
        g^3 C_bar^3 - ratio g^2 (C_bar^3 - 1) - ratio b_bar^3 = 0                        Eq. (13), tangential

    The cubic has one positive root (one change of sign). Both tend to 2.4^(1/3) = 1.339 for a thin cortex, the
    paper's 1.34; Eq. (12) ends at C_bar = (12/7)^(1/3) = 1.197, the paper's "about 1.2". The caption of Fig. 4 swaps
    inner and outer: C is the outer radius. The stiffness of the cortex does not enter. But it determines whether
    the criterion is met before the surface wrinkles, see :func:`bifurcation`.
    """
    outer_radius, core_growth = _above(1, C_bar, "C_bar = C/B"), _above(0, g_core, "g_core")
    if not 1 < ratio < np.inf:
        raise OutOfRange(f"ratio of radial to tangential stretch must be above 1 and finite, got {ratio:g}.")
    b_cubed = 1 + (core_growth**3 - 1) * (1 - _checked_hole_radius(A_bar, outer_radius, core_growth) ** 3)
    check_law(law)
    if law == "isotropic":
        left = 1 - outer_radius**3 * (1 - 1 / ratio)
        return np.cbrt(np.divide(b_cubed, left, out=np.full(np.broadcast(b_cubed, left).shape, np.nan), where=left > 0))
    # Newton from above: to the right of its only positive root the cubic is positive, rising and convex
    g = np.maximum(ratio, np.sqrt(b_cubed)) * np.ones(np.broadcast(b_cubed, outer_radius).shape)
    for _ in range(60):
        cubic_value = g**3 * outer_radius**3 - ratio * g**2 * (outer_radius**3 - 1) - ratio * b_cubed
        step = cubic_value / (3 * g**2 * outer_radius**3 - 2 * ratio * g * (outer_radius**3 - 1))
        g = g - step
        if np.all(np.abs(step) <= 1e-15 * g):
            break
    return g


def thickest_creasing(law: str = "isotropic", ratio: float = CREASE) -> float:
    """Smallest C_bar at which the outer surface never reaches the ratio: (12/7)^(1/3) for creases; inf if tangential.

    For g to infinity, isotropic growth takes lambda_theta^3 at C to 1 - 1/C_bar^3, not to 0: the swollen outer cortex
    rests on swollen inner cortex. If this limit is above 1/ratio, no crease forms.
    """
    check_law(law)
    return float(np.cbrt(ratio / (ratio - 1))) if law == "isotropic" else float("inf")


def _above(lower_bound: float, values: ArrayLike, quantity_name: str) -> Array:
    """Values as an array, which must be above the least and finite."""
    values = np.asarray(values, dtype=np.float64)
    if not np.all((values > lower_bound) & np.isfinite(values)):
        raise OutOfRange(f"{quantity_name} must be above {lower_bound:g} and finite, got {values}.")
    return values


def _checked_hole_radius(A_bar: ArrayLike | None, outer: Array, core_growth: Array) -> Array:
    if A_bar is None and np.any((outer >= 2) & (core_growth != 1)):
        raise OptionsClash(
            f"A_bar is C_bar / 2 = {outer.max() / 2:g} by default, but must lie inside the core: give A_bar, below 1."
        )
    hole = np.asarray(np.minimum(outer / 2, 1.0) if A_bar is None else A_bar, dtype=np.float64)
    if not np.all((hole >= 0) & (hole <= 1)):
        raise OutOfRange(f"A_bar is the hole radius over the interface radius and must be from 0 to 1, got {hole}.")
    return hole
