"""Impedance Z of the layers of the smooth sphere for a spherical harmonic: momenta over displacements.

The smooth state (smooth_sphere.py) is perturbed by u = U(r) Y_lm e_r + V(r) r grad Y_lm, of any degree l; the order m
does not matter. The second variation of the energy becomes one integral over the radius. Its Euler equations are four
linear equations of first order, for U, V and their momenta. Two solutions are integrated through one layer at a time,
outwards from the fixed hole and inwards from the free surface. docs/theory.md has the derivation. Lengths are over the
outer reference radius C, moduli over the core's shear modulus.
"""

import math

import numpy as np
from scipy.linalg import schur

from morphofold.arrays import Array
from morphofold.kernels import kernel, reading
from morphofold.sim.sphere_theory.smooth_sphere import (
    COMPLIANCE,
    LAMBDA_R,
    LAMBDA_T,
    PRESSURE,
    RADIUS,
    RATE,
    SmoothSphere,
    smooth_state,
)

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
    free, fixed = np.eye(4)[:, :2].copy(), np.eye(4)[:, 2:].copy()
    start = max(y[0, 0], y[0, -1] - DECAY_EXPONENT / degree)
    core, cortex = (reading(float(degree), y[k], fields[k], float(sphere.mu[k])) for k in range(2))
    below, poles_core = _integrate_layer(fixed, start, y[0, -1], *core)
    surface, poles_out = _integrate_layer(fixed, y[1, 0], y[1, -1], *cortex)
    above, poles_in = _integrate_layer(free, y[1, -1], y[1, 0], *cortex)
    return surface, below - above, poles_core + poles_out + poles_in


def short_wave_impedances(sphere: SmoothSphere, g: float) -> tuple[Array, Array] | None:
    """:func:`impedances` for l -> inf: half-space in the state of the outer surface, two joined as at the interface.

    None if a half-space has lost ellipticity.
    """
    fields = smooth_state(sphere, g).fields
    surface = _half_space_impedance(fields[1, :, -1], sphere.mu[1], "rhp")
    below, above = (
        _half_space_impedance(fields[0, :, -1], sphere.mu[0], "rhp"),
        _half_space_impedance(fields[1, :, 0], sphere.mu[1], "lhp"),
    )
    return None if surface is None or below is None or above is None else (surface, below - above)


def _half_space_impedance(fields: Array, mu: float, side: str) -> Array | None:
    """Z (2, 2) of a half-space in one state for wave number 1; None if it has lost ellipticity."""
    M = np.empty((4, 4))
    _fill_coefficients(
        M,
        SHORT_WAVE_DEGREE,
        1.0,
        np.array([fields[LAMBDA_R], fields[LAMBDA_T], 0.0, mu * fields[COMPLIANCE], 1.0, 1.0]),
    )
    M[:2, :2] /= SHORT_WAVE_DEGREE
    M[2:, 2:] /= SHORT_WAVE_DEGREE
    M[2:, :2] /= SHORT_WAVE_DEGREE**2
    _, basis, dying = schur(M, sort=side)
    if dying != 2:
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
    for i in range(4):
        for j in range(4):
            M[i, j] *= rate


@kernel
def _interpolate_fields(x, nodes, table, fields):
    """Fields (6,) at x from a table (6, n) at Chebyshev points, barycentric (Berrut and Trefethen 2004, Eq. 5.4)."""
    last = len(nodes) - 1
    total, sign = 0.0, 1.0
    for i in range(len(fields)):
        fields[i] = 0.0
    for k in range(last + 1):
        distance = x - nodes[k]
        if distance == 0.0:
            for i in range(len(fields)):
                fields[i] = table[i, k]
            return
        weight = sign / distance
        if k == 0 or k == last:
            weight *= 0.5
        sign = -sign
        total += weight
        for i in range(len(fields)):
            fields[i] += weight * table[i, k]
    for i in range(len(fields)):
        fields[i] /= total


@kernel
def _solve(A, b):
    """Solve A x = b for two columns b (n, 2), in place, by elimination with the largest pivot of each column."""
    n = len(A)
    for k in range(n):
        top = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[top, k]):
                top = i
        if top != k:
            for j in range(k, n):
                A[k, j], A[top, j] = A[top, j], A[k, j]
            for c in range(2):
                b[k, c], b[top, c] = b[top, c], b[k, c]
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            if share != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= share * A[k, j]
                for c in range(2):
                    b[i, c] -= share * b[k, c]
    for k in range(n - 1, -1, -1):
        for c in range(2):
            for j in range(k + 1, n):
                b[k, c] -= A[k, j] * b[j, c]
            b[k, c] /= A[k, k]


@kernel
def _integrate_layer(Y, start, end, degree, nodes, table, mu):
    """Integrate two solutions Y (4, 2) of (U, v, P, Q), in place, from one end of a layer to the other.

    Returns Z (2, 2), their (P, Q) over their (U, v) and over n, and the number of points at which it is infinite.
    """
    n = math.sqrt(degree * (degree + 1.0))
    fields, M = np.empty(6), np.empty((3, 4, 4))
    lhs, rhs = np.empty((12, 12)), np.empty((12, 2))
    rate = 1.0
    for k in range(len(nodes)):
        rate = max(rate, table[RATE, k])
    steps = max(LEAST_STEPS_PER_LAYER, math.ceil(abs(end - start) * n * rate / LARGEST_STEP_EXPONENT))
    h = (end - start) / steps
    poles, before = 0, Y[0, 0] * Y[1, 1] - Y[0, 1] * Y[1, 0]
    for step in range(steps):
        for i in range(3):
            _interpolate_fields(start + (step + COLLOCATION_NODES[i]) * h, nodes, table, fields)
            _fill_coefficients(M[i], n, mu, fields)
        for i in range(3):
            for p in range(4):
                for j in range(3):
                    for q in range(4):
                        lhs[4 * i + p, 4 * j + q] = -h * COLLOCATION_MATRIX[i, j] * M[i, p, q]
                lhs[4 * i + p, 4 * i + p] += 1.0
                for c in range(2):
                    rhs[4 * i + p, c] = 0.0
                    for q in range(4):
                        rhs[4 * i + p, c] += M[i, p, q] * Y[q, c]
        _solve(lhs, rhs)
        # orthonormal columns span the same solutions; without this both would become the faster solution
        one, both, two = 0.0, 0.0, 0.0
        for p in range(4):
            for c in range(2):
                for i in range(3):
                    Y[p, c] += h * COLLOCATION_WEIGHTS[i] * rhs[4 * i + p, c]
            one += Y[p, 0] * Y[p, 0]
            both += Y[p, 0] * Y[p, 1]
        for p in range(4):
            Y[p, 1] -= both / one * Y[p, 0]
            Y[p, 0] /= math.sqrt(one)
            two += Y[p, 1] * Y[p, 1]
        for p in range(4):
            Y[p, 1] /= math.sqrt(two)
        now = Y[0, 0] * Y[1, 1] - Y[0, 1] * Y[1, 0]
        if now * before < 0.0:
            poles += 1
        before = now
    Z = np.empty((2, 2))
    Z[0, 0] = (Y[2, 0] * Y[1, 1] - Y[2, 1] * Y[1, 0]) / before / n
    Z[0, 1] = Z[1, 0] = (Y[2, 1] * Y[0, 0] - Y[2, 0] * Y[0, 1]) / before / n
    Z[1, 1] = (Y[3, 1] * Y[0, 0] - Y[3, 0] * Y[0, 1]) / before / n
    return Z, poles
