"""Linear stability of the growing bilayer sphere: the first unstable spherical harmonic, and its critical growth.

The smooth state (smooth_sphere.py) is perturbed by u = U(r) Y_lm e_r + V(r) r grad Y_lm, of any degree l; the order m
does not matter. The second variation of the energy becomes one integral over the radius. Its Euler equations are four
linear equations of first order, for U, V and their momenta. Two solutions are integrated through one layer at a time,
outwards from the fixed hole and inwards from the free surface. The impedance Z of a layer is momenta over
displacements. docs/theory.md has the derivation. Lengths are over the outer reference radius C, moduli over the core's
shear modulus.

The smooth sphere is stable against degree l as long as Z is positive definite at the free surface and is nowhere
infinite on the path to it (Jacobi's condition). For modes at the interface the jump of Z there is a better measure.
This module finds the growth at which stability ends, for each degree, and the degree for which it ends first.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur
from scipy.optimize import brentq

from morphofold.errors import OutOfRange
from morphofold.frozen_arrays import Array, Ints
from morphofold.kernels import kernel, reading
from morphofold.sim.sphere_theory.smooth_sphere import (
    COMPLIANCE,
    LAMBDA_R,
    LAMBDA_T,
    PRESSURE,
    RADIUS,
    RATE,
    ConvergenceError,
    SmoothSphere,
    smooth_state,
)

#: lambda_r/lambda_theta at which a smooth neo-Hookean surface can crease (Razavi et al. 2015, Eq. 7)
CREASE = 2.4
_ROOT_15 = math.sqrt(15)
#: Gauss collocation of three stages (Butcher 1964): order 6, A-stable, and keeps Z symmetric
COLLOCATION_NODES = np.array([0.5 - _ROOT_15 / 10, 0.5, 0.5 + _ROOT_15 / 10])
COLLOCATION_WEIGHTS = np.array([5 / 18, 4 / 9, 5 / 18])
COLLOCATION_MATRIX = np.array(
    [
        [5 / 36, 2 / 9 - _ROOT_15 / 15, 5 / 36 - _ROOT_15 / 30],
        [5 / 36 + _ROOT_15 / 24, 2 / 9, 5 / 36 - _ROOT_15 / 24],
        [5 / 36 + _ROOT_15 / 30, 2 / 9 + _ROOT_15 / 15, 5 / 36],
    ]
)
#: fastest exponent of a mode times the step; the error of the growth is then 1e-9
LARGEST_STEP_EXPONENT = 0.25
#: least number of steps per layer
LEAST_STEPS_PER_LAYER = 16
#: the integration begins where a mode has decayed to exp(-DECAY_EXPONENT) of its value at the interface
DECAY_EXPONENT = 20.0
#: degree at which the short-wave limit is computed: terms in 1/l are below rounding
SHORT_WAVE_DEGREE = 1e12


class Curve(NamedTuple):
    """Critical growth by degree: degree (K,) int64 ascending; g (K,) float64, NaN where none was found."""

    degree: Ints
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


@lru_cache(maxsize=256)  # many questions are about the same sphere
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
    growth_of_degree = partial(critical_growth_of_degree, sphere, g_max=g_max)
    curve = _search_degrees(growth_of_degree, short_wave, math.ceil(12 / T_over_C))
    g_crit, mode = short_wave, math.inf
    if not (np.isnan(curve.g).all() or short_wave <= np.nanmin(curve.g)):
        lowest_index = np.nanargmin(curve.g)
        g_crit, mode = float(curve.g[lowest_index]), float(curve.degree[lowest_index])
    if math.isnan(g_crit):
        nan, last_growth = math.nan, growths[-1]
        reason = f"the smooth sphere is stable up to g = {last_growth:g}"
        reason += "; its state could not be computed beyond that" if last_growth < g_max else ""
        return Bifurcation(nan, nan, nan, nan, curve, short_wave, g_crease, nan, reason)
    wavelength = 2 * math.pi / math.sqrt(mode * (mode + 1))
    grown_radius = smooth_state(sphere, g_crit).fields[1, RADIUS, -1]
    amplitude = _creasing_amplitude(sphere, mode, g_crit)
    return Bifurcation(g_crit, mode, wavelength, wavelength * grown_radius, curve, short_wave, g_crease, amplitude)


def critical_growth_of_degree(
    sphere: SmoothSphere, degree: int, guess_g: float = math.nan, *, g_max: float = 10.0
) -> float:
    """Smallest growth at which spherical harmonics of one degree l >= 1 grow; NaN if there is none up to ``g_max``, or
    if the smooth state could not be followed up to it. The search begins near ``guess_g``, if that is given."""
    return _first_root(partial(_lowest_stiffness, sphere, degree), _growths_with_smooth_state(sphere, g_max), guess_g)


@lru_cache  # a search asks for it at every degree
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


def _search_degrees(growth_of_degree: Callable[..., float], short_wave: float, last_degree: int) -> Curve:
    """Critical growth of degrees from 1, about 25 % apart, and of all degrees next to the lowest.

    The search goes on beyond ``last_degree`` while the curve still falls and does not yet approach its limit as
    limit + a/l: thick soft cortices have their minimum there.
    """
    growth: dict[int, float] = {}

    def add(degree: int, guessed_growth: float) -> float:
        if degree not in growth:
            growth[degree] = growth_of_degree(degree, guessed_growth)
        return growth[degree]

    guessed_growth = math.nan
    for degree in np.unique(np.geomspace(1, last_degree, 32).round().astype(int)).tolist():
        guessed_growth = add(degree, guessed_growth)
    for _ in range(24):
        (l0, g0), (l1, g1) = ((degree, growth[degree]) for degree in sorted(growth)[-2:])
        if not (g1 < g0 and (math.isnan(short_wave) or l1 * (g1 - short_wave) < 0.97 * l0 * (g0 - short_wave))):
            break
        add(math.ceil(1.25 * l1), g1)
    while not all(map(math.isnan, growth.values())):
        lowest, degrees = min((g, degree) for degree, g in growth.items() if not math.isnan(g))[1], sorted(growth)
        rank = degrees.index(lowest)
        new_degrees = {(lowest + degree) // 2 for degree in degrees[max(rank - 1, 0) : rank + 2]} - growth.keys()
        if not new_degrees:
            break
        for degree in sorted(new_degrees):
            add(degree, growth[lowest])
    return Curve(np.array(sorted(growth)), np.array([growth[degree] for degree in sorted(growth)]))


def _distance_to_crease(sphere: SmoothSphere, g: float) -> float:
    """Crease criterion minus lambda_r/lambda_theta of the smooth outer surface."""
    fields = smooth_state(sphere, g).fields
    return CREASE - float(fields[1, LAMBDA_R, -1] / fields[1, LAMBDA_T, -1])


def _first_root(stiffness: Callable[[float], float], growths: list[float], expected_g: float = math.nan) -> float:
    """Smallest growth in the range of an ascending list at which a stiffness falls through zero.

    NaN if it stays positive, or if the smooth state can't be followed that far. If ``expected_g`` is given, a bracket
    around it is widened until it contains the root; otherwise the whole list is searched.
    """
    try:
        for width in (0.02, 0.1, 0.5) if math.isfinite(expected_g) else ():
            low_g, high_g = 1 + (expected_g - 1) * (1 - width), min(1 + (expected_g - 1) / (1 - width), growths[-1])
            if stiffness(low_g) > 0 >= stiffness(high_g):
                return float(brentq(stiffness, low_g, high_g, xtol=1e-13, rtol=1e-13))
        for low_g, high_g in pairwise(growths):
            if stiffness(high_g) <= 0:
                return float(brentq(stiffness, low_g, high_g, xtol=1e-13, rtol=1e-13))
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
    surface, interface, n_poles = impedances(sphere, degree, g)
    lowest_mapped = _mapped_lowest_eigenvalue(surface, interface)
    return -2.0 if n_poles and lowest_mapped > 0 else lowest_mapped


def _creasing_amplitude(sphere: SmoothSphere, degree: float, g: float) -> float:
    """Amplitude of the critical mode, over C, at which its troughs reach the crease criterion; see ``Bifurcation``.

    In a roll Y -> cos, and at its trough the surface shortens by a (U - n v)/(r U) across and by a/r along.
    """
    lambda_r, lambda_t, r = smooth_state(sphere, g).fields[1, [LAMBDA_R, LAMBDA_T, RADIUS], -1]
    if lambda_r / lambda_t >= CREASE:
        return 0.0
    if math.isinf(degree):
        return math.nan
    eigenvalues, modes = np.linalg.eigh(impedances(sphere, degree, g)[0])
    if abs(eigenvalues[0]) > 1e-3 * eigenvalues[1]:  # a mode at the interface that does not reach the surface
        return math.nan
    shortening_across = (1 - math.sqrt(degree * (degree + 1)) * modes[1, 0] / modes[0, 0]) / r
    criterion = lambda a: (1 - a * shortening_across) ** 2 * (1 - a / r) - lambda_r / lambda_t / CREASE
    return float(brentq(criterion, 0, 1 / max(shortening_across, 1 / r), xtol=1e-13))


def _short_wave_stiffness(sphere: SmoothSphere, g: float) -> float:
    """Limit of ``_lowest_stiffness`` for l -> inf."""
    if g <= 1:
        return 1.0
    impedance_pair = short_wave_impedances(sphere, g)
    return -2.0 if impedance_pair is None else _mapped_lowest_eigenvalue(*impedance_pair)


def _mapped_lowest_eigenvalue(surface: Array, interface: Array) -> float:
    """The lower of the smallest eigenvalues, mapped to (-1, 1) by atan."""
    return 2 / math.pi * math.atan(min(np.linalg.eigvalsh(surface)[0], np.linalg.eigvalsh(interface)[0]))


def impedances(sphere: SmoothSphere, degree: float, g: float) -> tuple[Array, Array, int]:
    """Impedance Z of one degree l at growth g: at the free surface, and its jump at the interface.

    Parameters
    ----------
    sphere : Sphere
    degree : float
        l >= 1.
    g : float
        Growth stretch of the cortex, above 1.

    Returns
    -------
    surface, interface : (2, 2) float64
        Symmetric, for (U, sqrt(l (l + 1)) V), over sqrt(l (l + 1)).
    poles : int
        Number of points on the path to either at which Z is infinite.

    Raises
    ------
    ConvergenceError
        If there is no smooth state at g.
    """
    y, fields = smooth_state(sphere, g)
    free_solutions, fixed_solutions = np.eye(4)[:, :2].copy(), np.eye(4)[:, 2:].copy()
    start_y = max(y[0, 0], y[0, -1] - DECAY_EXPONENT / degree)
    core_arguments, cortex_arguments = (reading(float(degree), y[k], fields[k], float(sphere.mu[k])) for k in range(2))
    Z_core, poles_core = _integrate_layer(fixed_solutions, start_y, y[0, -1], *core_arguments)
    Z_surface, poles_out = _integrate_layer(fixed_solutions, y[1, 0], y[1, -1], *cortex_arguments)
    Z_cortex, poles_in = _integrate_layer(free_solutions, y[1, -1], y[1, 0], *cortex_arguments)
    return Z_surface, Z_core - Z_cortex, poles_core + poles_out + poles_in


def short_wave_impedances(sphere: SmoothSphere, g: float) -> tuple[Array, Array] | None:
    """:func:`impedances` for l -> inf: half-space in the state of the outer surface, two joined as at the interface.

    None if a half-space has lost ellipticity.
    """
    fields, (mu_core, mu_cortex) = smooth_state(sphere, g).fields, sphere.mu
    Z_surface = _half_space_impedance(fields[1, :, -1], mu_cortex, "rhp")
    Z_core = _half_space_impedance(fields[0, :, -1], mu_core, "rhp")
    Z_cortex = _half_space_impedance(fields[1, :, 0], mu_cortex, "lhp")
    return None if Z_surface is None or Z_core is None or Z_cortex is None else (Z_surface, Z_core - Z_cortex)


def _half_space_impedance(fields: Array, mu: float, side: str) -> Array | None:
    """Z (2, 2) of a half-space in one state for wave number 1; None if it has lost ellipticity."""
    M, state_fields = np.empty((4, 4)), np.array([*fields[:2], 0.0, mu * fields[COMPLIANCE], 1.0, 1.0])
    _fill_coefficients(M, SHORT_WAVE_DEGREE, 1.0, state_fields)
    M[:2, :2] /= SHORT_WAVE_DEGREE
    M[2:, 2:] /= SHORT_WAVE_DEGREE
    M[2:, :2] /= SHORT_WAVE_DEGREE**2
    _, basis, n_decaying = schur(M, sort=side)
    if n_decaying != 2:
        return None
    Z = mu * basis[2:, :2] @ np.linalg.inv(basis[:2, :2])
    # the work of a uniform pressure is a boundary term: it is left out of M, where it would dominate the rest
    return (Z + Z.T) / 2 - fields[PRESSURE] * np.array([[0.0, 1.0], [1.0, 0.0]])


@kernel
def _fill_coefficients(M, n, mu, fields):
    """Fill M (4, 4) of d(U, v, P, Q)/dy = M (U, v, P, Q) at one point of a smooth state; n = sqrt(l (l + 1)).

    v = n V; P and Q are the momenta of U and v, r^2 times the tractions. E = 1/2 int L ds, s = ln r, with
    S = 2U - n v, D = dU/ds + S and a dot for d/ds::

        L = r [al U.^2 + 2 be U. S + ga S^2 + bulk D^2 + de ((n^2 - 1) v^2 + 2 U^2 - 2 n U v)
               + b_rt v.^2 + b_tr (n U - v)^2 + 2 c v. (n U - v)]

    bulk = J h''(J) is used by its inverse, 0 if incompressible; the moduli are Ogden's for the neo-Hookean energy.
    """
    lr, lt, h1, compliance = fields[LAMBDA_R], fields[LAMBDA_T], fields[PRESSURE], fields[COMPLIANCE]
    r, rate = fields[RADIUS], fields[RATE]
    m = mu * (lr * lt * lt) ** (-5.0 / 3.0)
    rr, tt = m * lr * lr, m * lt * lt
    mean = (rr + 2.0 * tt) / 3.0
    c = mean - h1
    al = 2.0 / 3.0 * (rr + mean) - (rr - mean)
    be = 2.0 / 3.0 * (mean - rr - tt) + h1
    ga = 2.0 / 3.0 * (mean - 2.0 * tt) + h1
    de = tt + c
    k = 1.0 / (1.0 + compliance * al)
    # U. = k (compliance P/r - (1 + compliance be) S);   v. = (Q/r - c (n U - v)) / rr
    uS, uP = -k * (1.0 + compliance * be), k * compliance / r
    vU, vv, vQ = -c * n / rr, c / rr, 1.0 / (rr * r)
    # be U. + bulk D + ga S, the moment of S, in S and P/r
    gS, gP = be * uS + k * (al - be) + ga, be * uP * r + k
    M[0, 0], M[0, 1], M[0, 2], M[0, 3] = 2.0 * uS, -n * uS, uP, 0.0
    M[1, 0], M[1, 1], M[1, 2], M[1, 3] = vU, vv, 0.0, vQ
    M[2, 0] = r * (4.0 * gS + 2.0 * de + tt * n * n + c * n * vU)
    M[2, 1] = r * (-2.0 * n * gS - n * de - n * tt + c * n * vv)
    M[2, 2], M[2, 3] = 2.0 * gP, c * n / rr
    M[3, 0] = r * (-2.0 * n * gS - n * de - n * tt - c * vU)
    M[3, 1] = r * (n * n * gS + (n * n - 1.0) * de + tt - c * vv)
    M[3, 2], M[3, 3] = -n * gP, -c / rr
    M *= rate


@kernel
def _interpolate_fields(x, nodes, table, fields):
    """Fields (6,) at x from a table (6, n) at Chebyshev points, barycentric (Berrut and Trefethen 2004, Eq. 5.4)."""
    last_node = len(nodes) - 1
    weight_sum, node_sign = 0.0, 1.0
    for i in range(len(fields)):  # loops: numba takes seconds to compile operations on whole arrays
        fields[i] = 0.0
    for node in range(last_node + 1):
        distance = x - nodes[node]
        if distance == 0.0:
            for i in range(len(fields)):
                fields[i] = table[i, node]
            return
        weight = node_sign / distance
        if node == 0 or node == last_node:
            weight *= 0.5
        node_sign = -node_sign
        weight_sum += weight
        for i in range(len(fields)):
            fields[i] += weight * table[i, node]
    for i in range(len(fields)):
        fields[i] /= weight_sum


@kernel
def _solve(A, b):
    """Solve A x = b for two columns b (n, 2), in place, by elimination with the largest pivot of each column."""
    n = len(A)
    for k in range(n):
        pivot_row = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot_row, k]):
                pivot_row = i
        for j in range(k, n):
            A[k, j], A[pivot_row, j] = A[pivot_row, j], A[k, j]
        for column in range(2):
            b[k, column], b[pivot_row, column] = b[pivot_row, column], b[k, column]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                for column in range(2):
                    b[i, column] -= factor * b[k, column]
    for k in range(n - 1, -1, -1):
        for column in range(2):
            for j in range(k + 1, n):
                b[k, column] -= A[k, j] * b[j, column]
            b[k, column] /= A[k, k]


@kernel
def _integrate_layer(Y, start, end, degree, nodes, table, mu):
    """Integrate two solutions Y (4, 2) of (U, v, P, Q), in place, from one end of a layer to the other.

    Returns Z (2, 2), their (P, Q) over their (U, v) and over n, and the number of points at which it is infinite.
    """
    n = math.sqrt(degree * (degree + 1.0))
    fields, M = np.empty(6), np.empty((3, 4, 4))
    lhs, rhs = np.empty((12, 12)), np.empty((12, 2))
    largest_rate = max(1.0, table[RATE].max())
    n_steps = max(LEAST_STEPS_PER_LAYER, math.ceil(abs(end - start) * n * largest_rate / LARGEST_STEP_EXPONENT))
    step_length = (end - start) / n_steps
    n_poles, last_determinant = 0, Y[0, 0] * Y[1, 1] - Y[0, 1] * Y[1, 0]
    for step in range(n_steps):
        for i in range(3):
            _interpolate_fields(start + (step + COLLOCATION_NODES[i]) * step_length, nodes, table, fields)
            _fill_coefficients(M[i], n, mu, fields)
        for i in range(3):
            for row in range(4):
                for j in range(3):
                    for column in range(4):
                        lhs[4 * i + row, 4 * j + column] = -step_length * COLLOCATION_MATRIX[i, j] * M[i, row, column]
                lhs[4 * i + row, 4 * i + row] += 1.0
                for solution in range(2):
                    rhs[4 * i + row, solution] = 0.0
                    for column in range(4):
                        rhs[4 * i + row, solution] += M[i, row, column] * Y[column, solution]
        _solve(lhs, rhs)
        # orthonormal columns span the same solutions; without this both would become the faster solution
        squared_norm, inner_product, second_squared_norm = 0.0, 0.0, 0.0
        for row in range(4):
            for solution in range(2):
                for i in range(3):
                    Y[row, solution] += step_length * COLLOCATION_WEIGHTS[i] * rhs[4 * i + row, solution]
            squared_norm += Y[row, 0] * Y[row, 0]
            inner_product += Y[row, 0] * Y[row, 1]
        for row in range(4):
            Y[row, 1] -= inner_product / squared_norm * Y[row, 0]
            Y[row, 0] /= math.sqrt(squared_norm)
            second_squared_norm += Y[row, 1] * Y[row, 1]
        for row in range(4):
            Y[row, 1] /= math.sqrt(second_squared_norm)
        determinant = Y[0, 0] * Y[1, 1] - Y[0, 1] * Y[1, 0]
        n_poles += determinant * last_determinant < 0.0
        last_determinant = determinant
    Z = np.empty((2, 2))
    Z[0, 0] = (Y[2, 0] * Y[1, 1] - Y[2, 1] * Y[1, 0]) / last_determinant / n
    Z[0, 1] = Z[1, 0] = (Y[2, 1] * Y[0, 0] - Y[2, 0] * Y[0, 1]) / last_determinant / n
    Z[1, 1] = (Y[3, 1] * Y[0, 0] - Y[3, 0] * Y[0, 1]) / last_determinant / n
    return Z, n_poles
