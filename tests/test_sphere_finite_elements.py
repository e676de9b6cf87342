"""The radial problem and its stability by finite elements: rates, laws, limits and refusals.

What the closed forms and the shooting method of ``theory`` give for the same numbers is compared elsewhere.
"""

from dataclasses import fields

import numpy as np
import pytest
from numpy.polynomial import Legendre, Polynomial

from morphofold.errors import ImpossibleBody, NoSolution, OutOfRange, UnknownName
from morphofold.sim.growth import LAWS
from morphofold.sim.materials.elastic import energy
from morphofold.sim.sphere_theory.finite_elements import SphereMesh, radial_equilibrium
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError, SmoothSphere
from morphofold.studies.accuracy.sphere_modes import SphereModes, critical_growth_of_degree, unstable_modes

INF = np.inf


def observed_order(h, error):
    """Slope of log(error) against log(h)."""
    return np.polyfit(np.log(h), np.log(error), 1)[0]


def sphere(law="isotropic", kappa_ratio=INF, l=3, *, g=(1.3, 1.1), mu_ratio=2.0, T=0.2, A=0.4, elements=2, order=3):
    """A coarse body, its radial equilibrium and its growth."""
    body = SphereModes(SmoothSphere(T, mu_ratio, law, kappa_ratio, A), l, elements, order, 1.0)
    return body, body.grow(g), g


# the energy in three dimensions, without any identity of spherical harmonics


def harmonic(l):
    """Zonal harmonic of mean square 1 / (4 pi), as a polynomial in cos(theta), and its derivative."""
    Y = Legendre.basis(l).convert(kind=Polynomial) * np.sqrt((2 * l + 1) / (4 * np.pi))
    return Y, Y.deriv()


def gradients(displacement, X):
    """Grad u (..., 3, 3) of a map of points (..., 3), by complex steps: exact to round-off."""
    step = 1e-30
    return np.stack([displacement(X + 1j * step * e).imag / step for e in np.eye(3)], axis=-1)


def at_radius(R, value, slope):
    """A function of radius with this value and slope at R."""
    return lambda radius: value + slope * (radius - R)


def spheroidal(l, U, V):
    Y, dY = harmonic(l)

    def displacement(X):
        R = np.sqrt((X * X).sum(-1, keepdims=True))
        N, c = X / R, X[..., 2:] / R
        return U(R) * Y(c) * N + V(R) * dY(c) * (np.eye(3)[2] - c * N)

    return displacement


def toroidal(l, W):
    _, dY = harmonic(l)

    def displacement(X):
        R = np.sqrt((X * X).sum(-1, keepdims=True))
        return W(R) * dY(X[..., 2:] / R) * np.cross(X / R, np.eye(3)[2])

    return displacement


def second_difference(body, x, growth, displacement_at, pressure_at, l):
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
        dp = pressure_at(e, q) * harmonic(l)[0](c)

        def W(s, A=A, h=h, e=e, p=p[e, q], dp=dp):
            J, pressure = np.linalg.det(A + s * h), p + s * dp
            return energy(A + s * h, body.mu[e], 0.0) + pressure * (J - 1) - pressure**2 * body.compliance[e] / 2

        s = 3e-4
        second = (16 * (W(s) + W(-s)) - W(2 * s) - W(-2 * s) - 30 * W(0.0)) / (12 * s**2)
        volume = body.u.dx[e, q] * at.R[e, q] ** 2 * radial[e, 0] * tangential[e, 0] ** 2
        total += volume * 2 * np.pi * (w @ second)
    return total


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kappa_ratio", [5.0, INF])
@pytest.mark.parametrize("l", [1, 2, 5])
def test_second_variation_is_that_of_the_energy_in_three_dimensions(law, kappa_ratio, l, rng):
    body, x, growth = sphere(law, kappa_ratio, l)
    z = rng.standard_normal(2 * len(body.free) + body.q.N)
    U, V = np.zeros(body.u.N), np.zeros(body.u.N)
    U[body.free], V[body.free], q = np.split(z, [len(body.free), 2 * len(body.free)])
    value, slope = (lambda f: np.asarray(body.u.interpolate(f))), (lambda f: body.u.interpolate(f).grad[0])
    radius = body.quadrature.R

    def displacement(e, k):
        return spheroidal(l, *(at_radius(radius[e, k], value(f)[e, k], slope(f)[e, k]) for f in (U, V)))

    pressure = np.asarray(body.q.interpolate(q))
    want = second_difference(body, x, growth, displacement, lambda e, k: pressure[e, k], l)
    assert z @ body.second_variation(x, growth) @ z == pytest.approx(want, rel=1e-7)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("l", [1, 2, 5])
def test_toroidal_second_variation_is_that_of_the_energy_in_three_dimensions(law, l, rng):
    body, x, growth = sphere(law, 5.0, l)
    W, z = np.zeros(body.u.N), rng.standard_normal(len(body.free))
    W[body.free] = z
    value, slope = np.asarray(body.u.interpolate(W)), body.u.interpolate(W).grad[0]
    radius = body.quadrature.R

    def displacement(e, k):
        return toroidal(l, at_radius(radius[e, k], value[e, k], slope[e, k]))

    want = second_difference(body, x, growth, displacement, lambda e, k: 0.0, l)
    assert l * (l + 1) * z @ body.toroidal(x, growth) @ z == pytest.approx(want, rel=1e-7)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kappa_ratio", [5.0, INF])
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


@pytest.mark.parametrize("order", [2, 3, 4])
def test_radius_and_stress_converge_at_the_order_of_the_elements(order):
    """Maximum norm: order + 1 for the radius, order for the stress. Finite kappa, both layers."""
    R, elements = np.linspace(0.8, 1.0, 41), [4, 8, 16]
    fine = radial_equilibrium(1.4, 0.2, 2.0, kappa_ratio=5.0, elements=12, order=9).at(R, "cortex")
    coarse = [radial_equilibrium(1.4, 0.2, 2.0, kappa_ratio=5.0, elements=n, order=order) for n in elements]
    for name, rate in (("r", order + 1), ("sigma_r", order), ("sigma_theta", order)):
        error = [np.abs(getattr(s.at(R, "cortex"), name) - getattr(fine, name)).max() for s in coarse]
        assert observed_order(1 / np.array(elements), error) > rate - 0.25, name
        assert error[-1] < 1e-3


@pytest.mark.parametrize("law", LAWS)
def test_grown_volume_is_filled_when_incompressible(law):
    """r^3 - A^3 is the integral of 3 R^2 det G, in both layers."""
    g, g_core, A, B = 1.7, 1.2, 0.5, 0.9
    det = g**3 if law == "isotropic" else g**2
    state = radial_equilibrium(g, 1 - B, 3.0, law, g_core=g_core, elements=6)
    R = np.linspace(A, B, 7)
    r3 = state.at(R, "core").r ** 3
    np.testing.assert_allclose(r3, A**3 + g_core**3 * (R**3 - A**3), rtol=1e-9)
    R = np.linspace(B, 1.0, 7)
    np.testing.assert_allclose(state.at(R, "cortex").r ** 3, r3[-1] + det * (R**3 - B**3), rtol=1e-9)
    np.testing.assert_allclose(state.J, 1.0, rtol=1e-6)


def test_incompressible_limit_is_reached_at_the_rate_of_the_compliance():
    kappa, limit = np.array([1e2, 1e3, 1e4]), radial_equilibrium(1.5, 0.1, 2.0)
    for name in ("r", "sigma_theta", "p"):
        error = [
            np.abs(getattr(radial_equilibrium(1.5, 0.1, 2.0, kappa_ratio=k), name) - getattr(limit, name)).max()
            for k in kappa
        ]
        assert observed_order(1 / kappa, error) == pytest.approx(1.0, abs=0.05), name


@pytest.mark.parametrize(("law", "T_over_C", "kappa_ratio"), [("isotropic", 0.04, INF), ("tangential", 1e-3, 50.0)])
def test_stress_is_in_equilibrium_and_the_traction_continuous(law, T_over_C, kappa_ratio):
    """d(sigma_r)/dr = 2 (sigma_theta - sigma_r)/r; no traction at the surface, none lost at the interface."""
    state = radial_equilibrium(1.5, T_over_C, 4.0, law, kappa_ratio)
    B, size = 1 - T_over_C, np.abs(state.sigma_theta).max()
    core, cortex = state.at(B, "core"), state.at([B, 1.0], "cortex")
    assert cortex.sigma_r[1] == pytest.approx(0.0, abs=1e-6 * size)
    assert core.sigma_r[0] == pytest.approx(cortex.sigma_r[0], abs=1e-6 * size)
    assert core.sigma_theta[0] > 0 > cortex.sigma_theta[0]
    middle, h = B + T_over_C / 2, 1e-3 * T_over_C
    low, mid, high = (state.at(middle + s, "cortex") for s in (-h, 0, h))
    slope = (high.sigma_r - low.sigma_r) / (high.r - low.r)
    np.testing.assert_allclose(slope, 2 * (mid.sigma_theta - mid.sigma_r) / mid.r, rtol=1e-4)


def test_pressure_is_the_bulk_modulus_times_the_volume_change():
    state = radial_equilibrium(1.4, 0.1, 3.0, kappa_ratio=4.0)
    kappa = 4.0 * np.where(state.cortex, 3.0, 1.0)
    np.testing.assert_allclose(state.p, kappa * (state.J - 1), atol=1e-7)
    np.testing.assert_allclose(state.p, (state.sigma_r + 2 * state.sigma_theta) / 3, atol=1e-12)


@pytest.mark.parametrize("kappa_ratio", [2.0, INF])
def test_a_sphere_that_has_not_grown_is_free_of_stress(kappa_ratio):
    state = radial_equilibrium(1.0, 0.04, 5.0, kappa_ratio=kappa_ratio)
    for stress in (state.sigma_r, state.sigma_theta, state.p):
        np.testing.assert_allclose(stress, 0.0, atol=1e-12)
    np.testing.assert_array_equal(state.r, state.R)


def test_state_at_its_own_quadrature_points_is_the_same():
    """Guards against the values that ElementLinePp keeps from its last points."""
    state = radial_equilibrium(1.5, 0.1, elements=2, order=4)
    again = state.at(state.R[state.cortex], "cortex")
    few = state.at(state.R[state.cortex][::-1], "cortex")
    for f in fields(state)[:6]:
        np.testing.assert_allclose(getattr(again, f.name), getattr(state, f.name)[state.cortex], atol=1e-12)
        np.testing.assert_allclose(getattr(few, f.name)[::-1], getattr(again, f.name), atol=1e-12)


# stability


@pytest.mark.parametrize("order", [2, 3, 4])
def test_critical_growth_converges_at_twice_the_order_of_the_elements(order):
    elements = np.array([6, 8, 12])
    exact = critical_growth_of_degree(30, 0.04, elements=10, order=9)
    error = [abs(critical_growth_of_degree(30, 0.04, elements=n, order=order) - exact) for n in elements]
    assert observed_order(1 / elements, error) == pytest.approx(2 * order, abs=0.1)
    assert error[-1] < 1e-5


@pytest.mark.parametrize("l", [5, 60, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", LAWS)
def test_critical_growth_does_not_depend_on_the_mesh(l, law):
    got = critical_growth_of_degree(l, 0.04, 2.0, law)
    assert got == pytest.approx(critical_growth_of_degree(l, 0.04, 2.0, law, order=10), rel=1e-9)


def test_number_of_unstable_modes_changes_at_the_critical_growth():
    g = critical_growth_of_degree(20, 0.06, 2.0, kappa_ratio=20.0)
    assert unstable_modes(g * (1 - 1e-9), 20, 0.06, 2.0, kappa_ratio=20.0) == 0
    assert unstable_modes(g * (1 + 1e-9), 20, 0.06, 2.0, kappa_ratio=20.0) == 1


def test_critical_growth_tends_to_the_incompressible_one():
    kappa, limit = np.array([1e2, 1e3, 1e4]), critical_growth_of_degree(20, 0.04, 2.0)
    error = [abs(critical_growth_of_degree(20, 0.04, 2.0, kappa_ratio=k) - limit) for k in kappa]
    assert observed_order(1 / kappa, error) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("law", [pytest.param(LAWS[0], marks=pytest.mark.slow), *LAWS[1:]])
def test_surface_loses_stability_at_the_stretch_of_biot(law):
    """A half-space of equal stretch b in its plane folds at b = 0.6661, where b^-3 is the root 3.3830 of
    x^3 - 3 x^2 - x - 1 = 0 (Biot 1963); here many waves fit in the cortex and the sphere is flat to them: the
    ratio of stretches at the surface exceeds the root by a multiple of 1/l."""
    biot = np.real(np.roots([1, -3, -1, -1])[0])
    excess = []
    for l, T_over_C in ((2000, 0.01), (4000, 0.005)):
        g = critical_growth_of_degree(l, T_over_C, law=law, step=0.2)
        excess.append((g / radial_equilibrium(g, T_over_C, law=law).at(1.0, "cortex").r[0]) ** 3 - biot)
    assert 0 < excess[1] < 2.5e-3
    assert excess[0] == pytest.approx(2 * excess[1], rel=0.03)
    assert 2 * excess[1] - excess[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kappa_ratio", [5.0, INF])
def test_toroidal_modes_stay_stable_until_the_spheroidal_ones_are_lost(law, kappa_ratio):
    g = min(critical_growth_of_degree(l, 0.04, law=law, kappa_ratio=kappa_ratio) for l in (10, 20, 30, 40))
    degrees = (1, 2, 5, 20, 100)
    assert [unstable_modes(g, l, 0.04, law=law, kappa_ratio=kappa_ratio, toroidal=True) for l in degrees] == [0] * 5


def test_growth_of_core_and_cortex_alike_by_a_common_factor_changes_only_the_hole():
    """With the hole far away, g and g_core in the same ratio give the same instability: growth has no scale."""
    alone = critical_growth_of_degree(30, 0.02, A_over_C=0.05)
    both = critical_growth_of_degree(30, 0.02, A_over_C=0.05, g_core=1.3, step=0.2) / 1.3
    assert both == pytest.approx(alone, rel=1e-3)


def test_a_degree_that_stays_stable_gives_nan():
    assert np.isnan(critical_growth_of_degree(1, 0.04, g_max=2.0))
    assert np.isnan(critical_growth_of_degree(30, 0.04, g_max=1.3))


# refusals


@pytest.mark.parametrize(
    ("change", "kind", "named"),
    [
        ({"T_over_C": 0.5}, ImpossibleBody, r"A/C = 0\.5, T/C = 0\.5\.$"),
        ({"A_over_C": 0.0}, ImpossibleBody, r"A/C = 0, T/C = 0\.04\.$"),
        ({"mu_ratio": INF}, OutOfRange, r"^mu_ratio\b.* 1e-4 .* 1e4\b.* inf\.$"),
        ({"kappa_ratio": 0.0}, OutOfRange, r"^kappa_ratio\b.* 1 .* 1e8\b.* 0\.0\.$"),
        ({"law": "radial"}, UnknownName, r"\bisotropic, tangential\b.* 'radial'\.$"),
    ],
)
def test_values_out_of_range_are_refused(change, kind, named):
    with pytest.raises(kind, match=named):
        unstable_modes(**{"g": 1.2, "l": 5, "T_over_C": 0.04, **change})


def test_a_search_without_room_is_refused():
    with pytest.raises(OutOfRange, match=r"\bg_max = 1\.0\b"):
        critical_growth_of_degree(5, 0.04, g_max=1.0)


def test_a_sphere_folded_by_core_growth_alone_is_refused():
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
