"""The radial problem and its stability by finite elements, the readable twin of ``sim/sphere_theory``.

Its numbers are compared with those of the theory in ``test_wrinkling.py``; here are its equations and rates.
"""

from dataclasses import fields

import numpy as np
import pytest
from numpy.polynomial import Legendre, Polynomial

from morphofold.errors import NoSolution
from morphofold.sim.materials.elastic import energy
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError, SmoothSphere
from morphofold.studies.accuracy.radial_finite_elements import SphereMesh, radial_equilibrium
from morphofold.studies.accuracy.radial_modes import SphereModes, critical_growth_of_degree

INF = np.inf


def observed_order(h, error):
    """Slope of log(error) against log(h)."""
    return np.polyfit(np.log(h), np.log(error), 1)[0]


def sphere(law="isotropic", kappa_ratio=INF, l=3, *, g=(1.3, 1.1), mu_ratio=2.0, T=0.2, A=0.4, elements=2, order=3):
    """A coarse body, its radial equilibrium and its growth."""
    body = SphereModes(SmoothSphere(T, mu_ratio, law, kappa_ratio, A), l, elements, order, 1.0)
    return body, body.grow(g), g


# the energy in three dimensions, without any identity of spherical harmonics


def gradients(displacement, X):
    """Grad u (..., 3, 3) of a map of points (..., 3), by complex steps: exact to round-off."""
    step = 1e-30
    return np.stack([displacement(X + 1j * step * e).imag / step for e in np.eye(3)], axis=-1)


def toroidal(l, R0, W, slope):
    """The displacement W(R) N x grad Y for the zonal harmonic of mean square 1 / (4 pi), W linear around R0."""
    dY = Legendre.basis(l).convert(kind=Polynomial).deriv() * np.sqrt((2 * l + 1) / (4 * np.pi))

    def displacement(X):
        R = np.sqrt((X * X).sum(-1, keepdims=True))
        return (W + slope * (R - R0)) * dY(X[..., 2:] / R) * np.cross(X / R, np.eye(3)[2])

    return displacement


def second_difference(body, x, growth, displacement_at, l):
    """Second derivative of the body's energy along a perturbation, by differences, integrated in three dimensions."""
    c, w = np.polynomial.legendre.leggauss(3 * l + 2)
    N = np.stack([np.sqrt(1 - c**2), 0 * c, c], axis=-1)
    at = body.quadrature
    radial, tangential, alpha, beta, p = body.stretches(x, growth, at)
    total = 0.0
    NN = N[:, :, None] * N[:, None, :]
    split = lambda a, b: a * NN + b * (np.eye(3) - NN)
    for e, q in np.ndindex(*at.R.shape):
        A = split(alpha[e, q], beta[e, q])
        h = gradients(displacement_at(e, q), at.R[e, q] * N) @ split(1 / radial[e, 0], 1 / tangential[e, 0])

        def W(s, A=A, h=h, e=e, p=p[e, q]):
            return energy(A + s * h, body.mu[e], 0.0) + p * (np.linalg.det(A + s * h) - 1)

        s = 3e-4
        second = (16 * (W(s) + W(-s)) - W(2 * s) - W(-2 * s) - 30 * W(0.0)) / (12 * s**2)
        volume = body.u.dx[e, q] * at.R[e, q] ** 2 * radial[e, 0] * tangential[e, 0] ** 2
        total += volume * 2 * np.pi * (w @ second)
    return total


@pytest.mark.parametrize(("law", "l"), [("isotropic", 1), ("tangential", 5)])
def test_toroidal_second_variation_is_that_of_the_energy_in_three_dimensions(law, l, rng):
    """That of spheroidal modes, too: its critical growth is that of the theory, whose equations are so tested."""
    body, x, growth = sphere(law, 5.0, l)
    W, z = np.zeros(body.u.N), rng.standard_normal(len(body.free))
    W[body.free] = z
    value, slope, R = np.asarray(body.u.interpolate(W)), body.u.interpolate(W).grad[0], body.quadrature.R
    expected = second_difference(body, x, growth, lambda *at: toroidal(l, R[at], value[at], slope[at]), l)
    assert l * (l + 1) * z @ body.toroidal(x, growth) @ z == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(("law", "kappa_ratio"), [("isotropic", 5.0), ("tangential", INF)])
def test_radial_gradient_and_tangent_are_derivatives_of_the_energy(law, kappa_ratio, rng):
    body, x, growth = sphere(law, kappa_ratio)
    x, z = x + 0.02 * rng.standard_normal(len(x)), rng.standard_normal(len(x))

    def total(x):
        radial, tangential, alpha, beta, p = body.stretches(x, growth, body.quadrature)
        A = np.stack([alpha, beta, beta], axis=-1)[..., None] * np.eye(3)
        J = alpha * beta**2
        W = energy(A, body.mu[:, None], 0.0) + p * (J - 1) - p**2 * body.compliance[:, None] / 2
        return np.sum(body.u.dx * body.quadrature.R**2 * radial * tangential**2 * W)

    gradient, tangent = body.radial(x, growth)
    h = 2.0 ** -np.arange(9, 14)
    rest = [abs(total(x + s * z) - total(x) - s * z @ gradient - s**2 / 2 * z @ tangent @ z) for s in h]
    assert observed_order(h, rest) == pytest.approx(3.0, abs=0.1)


# the radial problem


def test_radius_and_stress_converge_at_the_order_of_the_elements():
    """Maximum norm: order + 1 for the radius, order for the stress. Finite kappa, both layers."""
    order, R, elements = 3, np.linspace(0.8, 1.0, 41), [4, 8, 16]
    fine = radial_equilibrium(1.4, 0.2, 2.0, kappa_ratio=5.0, elements=12, order=9).at(R, "cortex")
    coarse = [radial_equilibrium(1.4, 0.2, 2.0, kappa_ratio=5.0, elements=n, order=order) for n in elements]
    for name, rate in (("r", order + 1), ("sigma_r", order), ("sigma_theta", order)):
        error = [np.abs(getattr(s.at(R, "cortex"), name) - getattr(fine, name)).max() for s in coarse]
        assert observed_order(1 / np.array(elements), error) > rate - 0.25, name
        assert error[-1] < 1e-3


def test_state_at_its_own_quadrature_points_is_the_same():
    """Guards against the values that ElementLinePp keeps from its last points."""
    state = radial_equilibrium(1.5, 0.1, elements=2, order=4)
    again = state.at(state.R[state.cortex], "cortex")
    few = state.at(state.R[state.cortex][::-1], "cortex")
    for f in fields(state)[:6]:
        np.testing.assert_allclose(getattr(again, f.name), getattr(state, f.name)[state.cortex], atol=1e-12)
        np.testing.assert_allclose(getattr(few, f.name)[::-1], getattr(again, f.name), atol=1e-12)


def test_critical_growth_converges_at_twice_the_order_of_the_elements():
    order, elements = 3, np.array([6, 8, 12])
    exact = critical_growth_of_degree(30, 0.04, elements=10, order=9)
    error = [abs(critical_growth_of_degree(30, 0.04, elements=n, order=order) - exact) for n in elements]
    assert observed_order(1 / elements, error) == pytest.approx(2 * order, abs=0.1)
    assert error[-1] < 1e-5


def test_a_degree_that_stays_stable_gives_nan_and_one_that_core_growth_folds_is_refused():
    assert np.isnan(critical_growth_of_degree(30, 0.04, g_max=1.3))
    with pytest.raises(NoSolution, match=r"\bg = 1 .*\b0\.6\b"):
        critical_growth_of_degree(30, 0.04, g_core=0.6)


def test_a_path_without_end_says_how_far_it_was_followed(monkeypatch):
    def newton(self, x, growth):
        if growth[0] > 1.25:
            raise FloatingPointError("no")
        return x

    monkeypatch.setattr(SphereMesh, "newton", newton)
    with pytest.raises(ConvergenceError, match=r"\bg = 1\.24\d*, g_core = 1\b"):
        radial_equilibrium(2.0, 0.04)
