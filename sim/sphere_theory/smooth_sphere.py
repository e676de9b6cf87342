"""The smooth state of the growing bilayer sphere before it folds: stretches and pressure along the radius.

Lengths are in units of the outer reference radius C, moduli in units of the core's shear modulus. The incompressible
state has a closed form (Razavi et al. 2015, Eqs. 8 to 11, and the integral of Eq. 6). The nearly incompressible state
is computed by Chebyshev collocation, with the energy of :func:`morphofold.sim.materials.elastic.energy`.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import dct

from morphofold.errors import ImpossibleBody, OutOfRange
from morphofold.frozen_arrays import Array
from morphofold.sim.growth_laws import check_law, volume

#: Chebyshev points per layer
CHEBYSHEV_POINTS = 24
#: a stretch is resolved if its last Chebyshev coefficients, over the largest, are below this; 1e-16 in ordinary cases
UNRESOLVED_TAIL = 1e-6
#: fields of a state, in this order
LAMBDA_R, LAMBDA_T, PRESSURE, COMPLIANCE, RADIUS, RATE = range(6)


class State(NamedTuple):
    """A smooth state at the Chebyshev points of core and cortex, from the hole outwards.

    Attributes
    ----------
    y : (2, CHEBYSHEV_POINTS) float64
        Coordinate: logarithm of the deformed radius that the point would have if it were incompressible. All fields
        are smooth in it for any growth; as functions of R they change fast near the interface.
    fields : (2, 6, CHEBYSHEV_POINTS) float64
        Elastic stretches lambda_r and lambda_theta; the derivative h'(J) of the volumetric energy (the part of the
        mean stress that does not come from shear); the volumetric compliance 1/(J h''(J)), 0 if incompressible; the
        deformed radius r; and d ln r / dy.
    """

    y: Array
    fields: Array


class ConvergenceError(ArithmeticError):
    """No smooth state of the sphere was found at this growth."""


@dataclass(frozen=True)
class SmoothSphere:
    """Parameters of a smooth state except growth, checked on construction.

    Attributes
    ----------
    T_over_C : float
        Thickness of the cortex over the outer radius, at least 1e-6.
    mu_ratio : float
        Shear modulus of the cortex over that of the core, 1e-4 to 1e4.
    law : {"isotropic", "tangential"}
        Growth of the cortex.
    kappa_ratio : float
        Bulk over shear modulus, the same in both layers, 1 to 1e8; inf means incompressible.
    A_over_C : float
        Radius of the fixed hole over the outer radius, at least 0.001.

    Raises
    ------
    ValueError
        If a value is out of its range, or the cortex reaches down to the hole.
    """

    T_over_C: float
    mu_ratio: float = 1.0
    law: str = "isotropic"
    kappa_ratio: float = np.inf
    A_over_C: float = 0.5

    def __post_init__(self) -> None:
        check_law(self.law)
        if not 1e-4 <= self.mu_ratio <= 1e4:  # beyond, rounding errors of the stiff layer hide the soft layer
            raise OutOfRange(
                f"mu_ratio, shear modulus of cortex over core, must lie between 1e-4 and 1e4, got {self.mu_ratio}."
            )
        if not (1 <= self.kappa_ratio <= 1e8 or self.kappa_ratio == np.inf):  # beyond, rounding spoils kappa (J - 1)
            raise OutOfRange(
                f"kappa_ratio, bulk over shear modulus, must lie between 1 and 1e8, or be inf for incompressible, "
                f"got {self.kappa_ratio}."
            )
        if not (self.A_over_C >= 1e-3 and self.T_over_C >= 1e-6 and self.A_over_C + self.T_over_C < 1):
            raise ImpossibleBody(
                f"hole and cortex must leave a core between them: need A/C >= 0.001, T/C >= 1e-6 and A/C + T/C < 1, "
                f"got A/C = {self.A_over_C:g}, T/C = {self.T_over_C:g}."
            )

    @property
    def B(self) -> float:
        """Reference radius of the interface over C."""
        return 1 - self.T_over_C

    @property
    def mu(self) -> Array:
        """Shear moduli of core and cortex, in units of that of the core."""
        return np.array([1.0, self.mu_ratio])

    def growth(self, g: float, g_core: float = 1.0) -> tuple[Array, Array]:
        """Radial and tangential growth stretch of (core, cortex) as (2, 1) columns."""
        return np.array([[g_core], [g if self.law == "isotropic" else 1.0]]), np.array([[g_core], [g]])


@lru_cache(maxsize=256)  # a search uses the same growths for every degree
def smooth_state(sphere: SmoothSphere, g: float, g_core: float = 1.0, n_points: int = CHEBYSHEV_POINTS) -> State:
    """Smooth state at growth g of the cortex.

    Parameters
    ----------
    sphere : Sphere
    g : float
        Growth stretch of the cortex.
    g_core : float
        Growth stretch of the core, isotropic.
    n_points : int
        Chebyshev points per layer; with more than by default the search for the state is longer, too.

    Returns
    -------
    State
        Read-only: calls with the same arguments share it.

    Raises
    ------
    ConvergenceError
        If no nearly incompressible state was found, or the points do not resolve it.
    """
    b = sphere.B * np.cbrt(1 + (g_core**3 - 1) * (1 - (sphere.A_over_C / sphere.B) ** 3))  # Eqs. (9) and (10)
    c = np.cbrt(b**3 + volume(g, sphere.law) * (1 - sphere.B**3))
    layer_ends = np.log([[sphere.A_over_C, b], [b, c]])
    unit_nodes = (1 - np.cos(np.pi * np.arange(n_points) / (n_points - 1))) / 2
    y = layer_ends[:, :1] + (layer_ends[:, 1:] - layer_ends[:, :1]) * unit_nodes
    y[:, -1] = layer_ends[:, 1]
    radial_growth, tangential_growth = sphere.growth(g, g_core)
    r = np.exp(y)
    R = np.cbrt(sphere.B**3 + (r**3 - b**3) / (radial_growth * tangential_growth**2))
    lambda_t = r / (R * tangential_growth)
    if np.isfinite(sphere.kappa_ratio):
        fields = _compressible_fields(sphere, (radial_growth, tangential_growth), y, R, r)
    else:
        lambda_r = lambda_t**-2
        f = sphere.mu_ratio * stress_primitive(r[1] / R[1], R[1], g, sphere.law)
        core_f = stress_primitive(lambda_t[0] * g_core, R[0], g_core, "isotropic") if g_core != 1 else np.zeros(len(f))
        sigma_r = np.stack([f[0] - f[-1] + core_f - core_f[-1], f - f[-1]])
        deviator = sphere.mu[:, None] * (lambda_r**2 - lambda_t**2) * 2 / 3
        fields = np.stack([lambda_r, lambda_t, sigma_r - deviator, np.zeros_like(r), r, np.ones_like(r)], axis=1)
    y.flags.writeable = fields.flags.writeable = False  # all callers share the state
    return State(y, fields)


def stress_primitive(q: Array, R: Array, g: float, law: str) -> Array:
    """f in sigma_r = mu (f(r) - f(c)) for an incompressible layer that is free at c; see :func:`theory.stresses`.

    ``q`` = r/R and ``R`` are (...) arrays along the layer, g is its growth stretch.
    """
    if law == "isotropic":
        stretch = q / g
        return stretch**-4 / 2 + 2 / stretch
    a = np.cbrt(g * g)
    s = q / a
    Q = (np.log(R) + 0.5 * np.log(1 + s + s * s) - np.arctan((2 * s + 1) / np.sqrt(3)) / np.sqrt(3)) / a
    return 2 * ((1 - g * g) * Q + g**4 / (4 * q**4) + g * g / q)


def _compressible_fields(sphere: SmoothSphere, growth: tuple[Array, Array], y: Array, R: Array, r: Array) -> Array:
    """Fields that solve Div P = 0 at points y with reference radius R; r is their incompressible radius.

    With q = r/R, w = dr/dR and x = ln R this is dq/dx = w - q and dP_r/dx = 2 (P_theta - P_r), P the first
    Piola-Kirchhoff stress per reference area. The hole is fixed (q = 1), the outer surface free (P_r = 0), q and
    P_r are continuous at the interface.
    """
    (radial_growth, tangential_growth), q, mu = growth, r / R, sphere.mu[:, None]
    w = radial_growth * tangential_growth**2 / q**2
    dy_dx = w / q
    D = dy_dx[:, :, None] * np.stack([_differentiation_matrix(layer_y) for layer_y in y])
    direct_factors, stepwise_factors = np.ones(1), 3.0 ** np.arange(6, -1, -1)  # from the incompressible state
    attempts = [(direct_factors, 15), (stepwise_factors, 15)] + [(direct_factors, 80)] * (y.shape[1] > CHEBYSHEV_POINTS)
    for kappa_factors, n_iterations in attempts:
        solution: tuple[Array, Array] | None = (q, w)
        for kappa_factor in kappa_factors:
            if solution is not None:
                kappa_ratio = kappa_factor * sphere.kappa_ratio
                solution = _newton(D, *solution, radial_growth, tangential_growth, mu, kappa_ratio, n_iterations)
        if solution is not None:
            q, w = solution
            a, b = w / radial_growth, q / tangential_growth
            J = a * b * b
            kappa = sphere.kappa_ratio * mu
            if max(_chebyshev_tail(np.log(a)), _chebyshev_tail(np.log(b))) < UNRESOLVED_TAIL:
                return np.stack([a, b, kappa * (J - 1), 1 / (kappa * J), q * R, w / q / dy_dx], axis=1)
            break
    raise ConvergenceError(
        f"no smooth state found at g = {tangential_growth[1, 0]:g}, kappa_ratio = {sphere.kappa_ratio:g}, "
        f"T/C = {sphere.T_over_C:g}: use less growth or a larger kappa_ratio."
    )


def _newton(
    D: Array, q: Array, w: Array, g_r: Array, g_theta: Array, mu: Array, kappa_ratio: float, n_iterations: int
) -> tuple[Array, Array] | None:
    """Solution q, w (2, n) by Newton's method from the given one, or None; D (2, n, n) is d/dx, growth and moduli are
    (2, 1)."""
    n, det_G = q.shape[1], g_r * g_theta**2
    kappa = kappa_ratio * mu
    # of equations that they replace
    boundary_rows = hole_row, joint_row, stress_row, free_row = [0, 2 * n, 2 * n - 1, 4 * n - 1]
    for _ in range(n_iterations):
        a, b = w / g_r, q / g_theta
        J = a * b * b
        m, I1 = mu * J ** (-2 / 3), a * a + 2 * b * b
        bulk_stress = kappa * J * (J - 1)
        tau_r, tau_t = m * (a * a - I1 / 3) + bulk_stress, m * (b * b - I1 / 3) + bulk_stress  # J sigma
        P, P_t = det_G * tau_r / w, det_G * tau_t / q
        common_slope = 2 / 9 * m * I1 + bulk_stress + kappa * J * J
        P_w = det_G * (common_slope + 2 / 3 * m * a * a - tau_r) / w**2
        P_q = det_G * 2 * (common_slope - 2 / 3 * m * (a * a + b * b)) / (w * q)  # twice P_t's in w
        P_tq = det_G * (2 * common_slope - 2 / 3 * m * b * b - tau_t) / q**2
        lhs, rhs = np.zeros((4 * n, 4 * n)), np.empty((2, 2, n))
        for layer in range(2):
            q_rows, w_rows = slice(2 * layer * n, 2 * layer * n + n), slice(2 * layer * n + n, 2 * layer * n + 2 * n)
            rhs[layer, 0] = D[layer] @ q[layer] + q[layer] - w[layer]
            rhs[layer, 1] = D[layer] @ P[layer] + 2 * (P[layer] - P_t[layer])
            lhs[q_rows, q_rows], lhs[q_rows, w_rows] = D[layer] + np.eye(n), -np.eye(n)
            lhs[w_rows, q_rows] = D[layer] * P_q[layer] + 2 * np.diag(P_q[layer] - P_tq[layer])
            lhs[w_rows, w_rows] = D[layer] * P_w[layer] + 2 * np.diag(P_w[layer] - P_q[layer] / 2)
        lhs[boundary_rows] = 0
        lhs[hole_row, 0] = 1
        lhs[joint_row, [n - 1, 2 * n]] = -1, 1
        lhs[stress_row, [n - 1, 2 * n - 1, 2 * n, 3 * n]] = P_q[0, -1], P_w[0, -1], -P_q[1, 0], -P_w[1, 0]
        lhs[free_row, [3 * n - 1, 4 * n - 1]] = P_q[1, -1], P_w[1, -1]
        rhs.flat[boundary_rows] = q[0, 0] - 1, q[1, 0] - q[0, -1], P[0, -1] - P[1, 0], P[1, -1]
        try:
            step_q, step_w = np.linalg.solve(lhs, rhs.ravel()).reshape(2, 2, n).swapaxes(0, 1)
        except np.linalg.LinAlgError:
            return None
        step_share = min(1.0, 0.5 / max((step_q / q).max(), (step_w / w).max(), 0.5))  # a stretch falls by half at most
        q, w = q - step_share * step_q, w - step_share * step_w
        if max(np.abs(step_q).max(), np.abs(step_w).max()) < 1e-9:
            return q, w
    return None


def _chebyshev_tail(field_rows: Array) -> float:
    """Larger of the last two Chebyshev coefficients of rows of values, over the largest of all or 1."""
    coefficients = np.abs(dct(field_rows, type=1, axis=-1))
    return float(coefficients[:, -2:].max() / max(coefficients.max(), 2.0 * field_rows.shape[-1]))


def _differentiation_matrix(x: Array) -> Array:
    """Differentiation matrix on Chebyshev points (Trefethen 2000, Spectral Methods in MATLAB, ch. 6)."""
    end_weights = np.ones(len(x))
    end_weights[[0, -1]] = 2
    end_weights[1::2] *= -1
    differences = x[:, None] - x + np.eye(len(x))
    D = np.outer(end_weights, 1 / end_weights) / differences
    return D - np.diag(D.sum(axis=1))
