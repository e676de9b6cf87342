"""Linear stability of the growing bilayer sphere: the first unstable spherical harmonic, and its critical growth.

The smooth sphere is stable against degree l as long as the impedance Z of impedance.py is positive definite at the free
surface and is nowhere infinite on the path to it (Jacobi's condition). For modes at the interface the jump of Z there
is a better measure. This module finds the growth at which stability ends, for each degree, and the degree for which it
ends first.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from morphofold.arrays import Array
from morphofold.errors import OutOfRange
from morphofold.sim.sphere_theory.impedance import impedances, short_wave_impedances
from morphofold.sim.sphere_theory.smooth_sphere import (
    LAMBDA_R,
    LAMBDA_T,
    RADIUS,
    ConvergenceError,
    SmoothSphere,
    smooth_state,
)

#: lambda_r/lambda_theta at which a smooth neo-Hookean surface can crease (Razavi et al. 2015, Eq. 7)
CREASE = 2.4


class Curve(NamedTuple):
    """Critical growth by degree: degree (K,) int64 ascending; g (K,) float64, NaN where none was found."""

    degree: NDArray[np.int64]
    g: Array


@dataclass(frozen=True)
class Bifurcation:
    """First loss of stability of the smooth sphere. Lengths are in units of the outer reference radius C.

    Attributes
    ----------
    g_crit : float
        Smallest growth at which any mode grows; NaN if none does, and ``reason`` gives the cause.
    mode : float
        Degree l of that mode: a whole number; inf if the shortest waves come first; NaN if none does.
    wavelength, wavelength_deformed : float
        2 pi / sqrt(l (l + 1)) times the outer radius: of the reference sphere, C, and of the grown sphere, c.
    curve : Curve
        Critical growth of the degrees that were computed, from 1 to well beyond the critical degree.
    short_wave : float
        Limit of the curve for l -> inf: waves much shorter than the thickness of the cortex, on its surface (Biot) or
        on the interface, whichever come first. NaN if there is none below g_max.
    g_crease : float
        Growth at which the smooth surface reaches the crease criterion, lambda_r/lambda_theta = 2.4 (Eq. 7); Eqs. (12)
        and (13) if incompressible. NaN if it is not reached up to g_max.
    creasing_amplitude : float
        Amplitude of the critical mode at which its troughs reach the crease criterion, while g is g_crit. It is an
        estimate, with the linear mode at finite amplitude and in rolls; if it exceeds the thickness of the cortex, it
        means only that creases do not come soon. 0 if the smooth surface has reached the criterion already, NaN for a
        mode at the interface.
    reason : str
        Empty, or the cause if there is no g_crit.
    """

    g_crit: float
    mode: float
    wavelength: float
    wavelength_deformed: float
    curve: Curve
    short_wave: float
    g_crease: float
    creasing_amplitude: float
    reason: str = ""

    @property
    def first(self) -> str:
        """The one that needs less growth, "wrinkle" or "crease"; empty if neither comes."""
        if math.isnan(self.g_crit):
            return "" if math.isnan(self.g_crease) else "crease"
        return "crease" if self.g_crease < self.g_crit else "wrinkle"


def bifurcation(
    T_over_C: float,
    mu_ratio: float = 1.0,
    law: str = "isotropic",
    kappa_ratio: float = np.inf,
    *,
    A_over_C: float = 0.5,
    g_max: float = 10.0,
) -> Bifurcation:
    """First bifurcation of the growing bilayer sphere from its smooth state: wrinkling, by linear stability.

    The sphere is treated as a full solid, without approximation by a thin or flat layer.

    Parameters
    ----------
    T_over_C : float
        Thickness of the cortex over the outer radius.
    mu_ratio : float
        Shear modulus of the cortex over that of the core.
    law : {"isotropic", "tangential"}
        Growth of the cortex; the core does not grow.
    kappa_ratio : float
        Bulk over shear modulus, the same in both layers, in :func:`morphofold.sim.materials.elastic.energy`; inf means
        incompressible.
    A_over_C : float
        Radius of the fixed hole over the outer radius; 0.5 in the paper.
    g_max : float
        Growth at which the search ends.

    Returns
    -------
    Bifurcation

    Raises
    ------
    ValueError
        For a parameter out of its range, see
        :class:`~morphofold.sim.sphere_theory.smooth_sphere.SmoothSphere`, or g_max not
        above 1.

    Notes
    -----
    Not in Razavi et al. 2015, who use the crease criterion of Eq. (7). The incremental equations are those of
    small deformations on large ones (Ogden 1984, Non-linear Elastic Deformations, ch. 6), as Ben Amar and Goriely
    (2005, J. Mech. Phys. Solids 53, 2284) used them for growing shells. Limits: Biot's surface instability at
    lambda_r/lambda_theta = 3.383 (l -> inf), and for a stiff thin cortex the wavelength
    2 pi T (mu_ratio/3)^(1/3) at growth 1 + (3/mu_ratio)^(2/3) / 6.
    """
    sphere = SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C)
    growths = _growths_with_smooth_state(sphere, g_max)
    short_wave = _first_root(partial(_short_wave_stiffness, sphere), growths)
    g_crease = _first_root(partial(_distance_to_crease, sphere), growths)
    curve = _search_degrees(partial(_critical_growth, sphere, growths), short_wave, math.ceil(12 / T_over_C))
    g_crit, mode = short_wave, math.inf
    if not (np.isnan(curve.g).all() or short_wave <= np.nanmin(curve.g)):
        at = int(np.nanargmin(curve.g))
        g_crit, mode = float(curve.g[at]), float(curve.degree[at])
    if math.isnan(g_crit):
        nan, end = math.nan, growths[-1]
        reason = f"the smooth sphere is stable up to g = {end:g}"
        reason += "; its state could not be computed beyond that" if end < g_max else ""
        return Bifurcation(nan, nan, nan, nan, curve, short_wave, g_crease, nan, reason)
    wavelength = 2 * math.pi / math.sqrt(mode * (mode + 1))
    c = smooth_state(sphere, g_crit).fields[1, RADIUS, -1]
    amplitude = _creasing_amplitude(sphere, mode, g_crit)
    return Bifurcation(g_crit, mode, wavelength, wavelength * c, curve, short_wave, g_crease, amplitude)


def critical_growth_of_degree(sphere: SmoothSphere, degree: int, g_max: float = 10.0) -> float:
    """Smallest growth at which spherical harmonics of one degree grow; NaN if they do not up to g_max.

    Parameters
    ----------
    sphere : Sphere
    degree : int
        l >= 1.
    g_max : float
        Growth at which the search ends.

    Returns
    -------
    g : float
        NaN also if the smooth state could not be followed up to the bifurcation.

    Raises
    ------
    ValueError
        If degree is below 1, or g_max not above 1.
    """
    if degree < 1:
        raise OutOfRange(f"the degree of the spherical harmonic must be at least 1, got {degree}.")
    return _critical_growth(sphere, _growths_with_smooth_state(sphere, g_max), degree)


def _critical_growth(sphere: SmoothSphere, growths: list[float], degree: int, near: float = math.nan) -> float:
    return _first_root(partial(_lowest_stiffness, sphere, degree), growths, near)


def _growths_with_smooth_state(sphere: SmoothSphere, g_max: float) -> list[float]:
    """Growths at which to search for a root, as far as a smooth state exists; g - 1 rises geometrically."""
    if not (math.isfinite(g_max) and g_max > 1):
        raise OutOfRange(f"g_max is the growth at which the search ends and must be above 1, got {g_max}.")
    growths = [1.0]
    for g in 1 + np.geomspace(1e-6, g_max - 1, 64):
        try:
            smooth_state(sphere, float(g))
        except ConvergenceError:
            break
        growths.append(float(g))
    return growths


def _search_degrees(look: Callable[..., float], limit: float, last: int) -> Curve:
    """Critical growth of degrees from 1, about 25 % apart, and of all degrees next to the lowest.

    The search goes on beyond ``last`` while the curve still falls and does not yet approach its limit as limit + a/l:
    thick soft cortices have their minimum there.
    """
    found: dict[int, float] = {}

    def add(degree: int, near: float) -> float:
        if degree not in found:
            found[degree] = look(degree, near)
        return found[degree]

    near = math.nan
    for degree in np.unique(np.geomspace(1, last, 32).round().astype(int)).tolist():
        near = add(degree, near)
    for _ in range(24):
        (d, g), (e, h) = ((degree, found[degree]) for degree in sorted(found)[-2:])
        if not (h < g and (math.isnan(limit) or e * (h - limit) < 0.97 * d * (g - limit))):
            break
        add(math.ceil(1.25 * e), h)
    while not all(map(math.isnan, found.values())):
        lowest, degrees = min((g, degree) for degree, g in found.items() if not math.isnan(g))[1], sorted(found)
        at = degrees.index(lowest)
        between = {(lowest + degree) // 2 for degree in degrees[max(at - 1, 0) : at + 2]} - found.keys()
        if not between:
            break
        for degree in sorted(between):
            add(degree, found[lowest])
    return Curve(np.array(sorted(found)), np.array([found[degree] for degree in sorted(found)]))


def _distance_to_crease(sphere: SmoothSphere, g: float) -> float:
    """Crease criterion minus lambda_r/lambda_theta of the smooth outer surface."""
    fields = smooth_state(sphere, g).fields
    return CREASE - float(fields[1, LAMBDA_R, -1] / fields[1, LAMBDA_T, -1])


def _first_root(stiffness: Callable[[float], float], growths: list[float], near: float = math.nan) -> float:
    """Smallest growth in the range of an ascending list at which a stiffness falls through zero.

    NaN if it stays positive, or if the smooth state can't be followed that far. If ``near`` is given, a bracket around
    it is widened until it contains the root; otherwise the whole list is searched.
    """
    try:
        for width in (0.02, 0.1, 0.5) if math.isfinite(near) else ():
            low, high = 1 + (near - 1) * (1 - width), min(1 + (near - 1) / (1 - width), growths[-1])
            if stiffness(low) > 0 >= stiffness(high):
                return float(brentq(stiffness, low, high, xtol=1e-13, rtol=1e-13))
        for low, high in pairwise(growths):
            if stiffness(high) <= 0:
                return float(brentq(stiffness, low, high, xtol=1e-13, rtol=1e-13))
    except ConvergenceError:
        pass
    return math.nan


def _lowest_stiffness(sphere: SmoothSphere, degree: int, g: float) -> float:
    """Smallest eigenvalue of Z at the free surface and of its jump at the interface, mapped to (-1, 1) by atan.

    Both are positive as long as the sphere is stable, and vanish at the same growth. The eigenvalue at the place of the
    mode falls gradually, the other one suddenly; so the smaller of the two suits a root finder. -2 if only the poles of
    Z on the path show that the sphere is unstable.
    """
    if g <= 1:
        return 1.0
    surface, interface, poles = impedances(sphere, degree, g)
    lowest = _mapped_lowest_eigenvalue(surface, interface)
    return -2.0 if poles and lowest > 0 else lowest


def _creasing_amplitude(sphere: SmoothSphere, degree: float, g: float) -> float:
    """Amplitude of the critical mode, over C, at which its troughs reach the crease criterion; see ``Bifurcation``.

    In a roll Y -> cos, and at its trough the surface shortens by a (U - n v)/(r U) across and by a/r along.
    """
    lr, lt, r = smooth_state(sphere, g).fields[1, [LAMBDA_R, LAMBDA_T, RADIUS], -1]
    if lr / lt >= CREASE:
        return 0.0
    if math.isinf(degree):
        return math.nan
    stiffness, modes = np.linalg.eigh(impedances(sphere, degree, g)[0])
    if abs(stiffness[0]) > 1e-3 * stiffness[1]:  # a mode at the interface that does not reach the surface
        return math.nan
    across = (1 - math.sqrt(degree * (degree + 1)) * modes[1, 0] / modes[0, 0]) / r
    return float(
        brentq(lambda a: (1 - a * across) ** 2 * (1 - a / r) - lr / lt / CREASE, 0, 1 / max(across, 1 / r), xtol=1e-13)
    )


def _short_wave_stiffness(sphere: SmoothSphere, g: float) -> float:
    """Limit of ``_lowest_stiffness`` for l -> inf."""
    if g <= 1:
        return 1.0
    found = short_wave_impedances(sphere, g)
    return -2.0 if found is None else _mapped_lowest_eigenvalue(*found)


def _mapped_lowest_eigenvalue(surface: Array, interface: Array) -> float:
    """The lower of the smallest eigenvalues, mapped to (-1, 1) by atan."""
    return 2 / math.pi * math.atan(min(np.linalg.eigvalsh(surface)[0], np.linalg.eigvalsh(interface)[0]))
