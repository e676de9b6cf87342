"""Linear stability of the growing sphere: two routes, the full second variation, and the limits that are known."""

import itertools
import math
import re

import numpy as np
import pytest
from scipy.special import sph_harm_y

from morphofold.errors import ImpossibleBody, OutOfRange, UnknownName
from morphofold.sim import theory
from morphofold.sim.materials.elastic import energy
from morphofold.sim.sphere_theory import smooth_sphere, wrinkling
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError, SmoothSphere, smooth_state
from morphofold.studies.accuracy import radial_finite_elements as finite_elements
from morphofold.studies.accuracy import sphere_modes

LAWS, INF = ("isotropic", "tangential"), math.inf


# -- two routes -----------------------------------------------------------------------------------------------------


CASES = [  # T/C, ratio of moduli, degree, kappa_ratio, A/C: the first are the paper's, near their minima
    *[(T, mu, l, kappa, 0.5) for T, mu, l in ((0.02, 1, 37), (0.04, 1, 18), (0.06, 4, 11)) for kappa in (INF, 50.0)],
    *[(0.3, 1, 40, 50.0, 0.5), (0.2, 0.1, 20, INF, 0.5)],
    *[(0.001, 1, 700, INF, 0.5), (0.25, 10, 3, 50.0, 0.5), (0.04, 2, 2, INF, 0.05), (0.04, 2, 6, INF, 0.8)],
]
DEFAULT_CASES = (1, 5, 7, 11)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "case", [case if i in DEFAULT_CASES else pytest.param(case, marks=pytest.mark.slow) for i, case in enumerate(CASES)]
)
def test_marching_and_finite_elements_find_the_same_growth(case, law):
    T_over_C, mu_ratio, degree, kappa_ratio, A_over_C = case
    sphere = SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C)
    marched = wrinkling.critical_growth_of_degree(sphere, degree, g_max=20)
    elements = sphere_modes.critical_growth_of_degree(
        degree, T_over_C, mu_ratio, law, kappa_ratio, A_over_C=A_over_C, g_max=20, step=0.15
    )
    assert marched == pytest.approx(elements, rel=1e-8)  # asked: 1e-6


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("T", "mu_ratio"),
    [
        pytest.param(*at, marks=() if at == (2, 2) else pytest.mark.slow)
        for at in itertools.product((1, 2, 3), (1, 2, 4))
    ],
)
def test_no_degree_is_unstable_below_critical_growth_and_one_is_above(T, mu_ratio, law):
    """By counting negative eigenvalues of the finite-element tangent: nothing hides between the degrees marched.

    And all of these, the paper's cortices, wrinkle before they meet its criterion for creases.
    """
    T_over_C = T / 50
    first = theory.bifurcation(T_over_C, mu_ratio, law)
    assert first.first == "wrinkle"
    assert first.g_crit < float(theory.critical_growth(1 / (1 - T_over_C), law)) - 0.03
    near = (1, *range(int(first.mode) - 1, int(first.mode) + 2), 3 * int(first.mode))
    below, above = 1 + (first.g_crit - 1) * 0.9999, 1 + (first.g_crit - 1) * 1.0001
    assert all(sphere_modes.unstable_modes(below, degree, T_over_C, mu_ratio, law) == 0 for degree in near)
    assert sphere_modes.unstable_modes(above, int(first.mode), T_over_C, mu_ratio, law) == 1


@pytest.mark.slow
def test_toroidal_modes_are_still_stable_when_a_spheroidal_one_is_lost():
    for law, (T_over_C, mu_ratio) in itertools.product(LAWS, [(1 / 50, 1), (3 / 50, 4), (0.3, 1)]):
        first = theory.bifurcation(T_over_C, mu_ratio, law)
        for degree in (1, 2, 5, 20, 80):
            assert sphere_modes.unstable_modes(first.g_crit, degree, T_over_C, mu_ratio, law, toroidal=True) == 0


@pytest.mark.parametrize(("T_over_C", "mu_ratio"), [(3 / 50, 4.0)])
def test_creasing_amplitude_is_that_of_the_finite_element_mode(T_over_C, mu_ratio):
    """Null vector of the finite-element tangent, its roll at that amplitude, and the stretches at the trough."""
    first = theory.bifurcation(T_over_C, mu_ratio)
    degree = int(first.mode)
    body = sphere_modes.SphereModes(SmoothSphere(T_over_C, mu_ratio, A_over_C=0.5), degree, None, 8, first.g_crit)
    x = body.grow((first.g_crit, 1.0))
    values, vectors = np.linalg.eigh(body.second_variation(x, (first.g_crit, 1.0)))
    null = vectors[:, np.argmin(np.abs(values))]
    outer = np.flatnonzero(np.isin(body.free, body.u.get_dofs(lambda R: np.isclose(R[0], 1.0)).flatten()))
    U, V = null[outer][0], null[len(body.free) + outer][0]
    c = float(theory.deformed_radius(first.g_crit, 1 / (1 - T_over_C))) * (1 - T_over_C)
    stretch = c / first.g_crit
    a, N = first.creasing_amplitude, first.mode * (first.mode + 1)
    across = stretch * (1 - a * (U - N * V) / U / c)  # u_theta,theta of u = U Y e_r + V grad Y, Y = -1
    along = stretch * (1 - a / c)
    assert 1 / (across * along) / across == pytest.approx(theory.CREASE, rel=1e-6)
    assert first.first == "wrinkle"


@pytest.mark.parametrize("law", LAWS)
def test_crease_growth_of_a_bifurcation_is_the_papers_if_incompressible(law):
    for T_over_C in (0.02, 0.06):
        first = theory.bifurcation(T_over_C, 2.0, law)
        assert first.g_crease == pytest.approx(float(theory.critical_growth(1 / (1 - T_over_C), law)), rel=1e-11)
    assert math.isnan(theory.bifurcation(0.3, 2.0, "isotropic").g_crease)


def test_crease_growth_of_a_compressible_cortex_is_where_its_surface_has_the_critical_ratio():
    first = theory.bifurcation(0.04, 1.0, kappa_ratio=20.0)
    state = finite_elements.radial_equilibrium(first.g_crease, 0.04, kappa_ratio=20.0, elements=8).at(1.0, "cortex")
    lambda_t = state.r[0] / first.g_crease
    assert state.J[0] / lambda_t**3 == pytest.approx(theory.CREASE, rel=1e-8)


@pytest.mark.parametrize(("T_over_C", "mu_ratio"), [(0.45, 0.02), pytest.param(0.43, 0.5, marks=pytest.mark.slow)])
def test_wrinkles_of_the_interface_leave_the_surface_smooth(T_over_C, mu_ratio):
    """The finite-element mode moves the interface and hardly the surface, so there is no creasing amplitude."""
    first = theory.bifurcation(T_over_C, mu_ratio)
    degree = int(first.mode)
    body = sphere_modes.SphereModes(SmoothSphere(T_over_C, mu_ratio, A_over_C=0.5), degree, None, 8, first.g_crit)
    values, vectors = np.linalg.eigh(body.second_variation(body.grow((first.g_crit, 1.0)), (first.g_crit, 1.0)))
    null = vectors[:, np.argmin(np.abs(values))]

    def moved(R):
        at = np.flatnonzero(np.isin(body.free, body.u.get_dofs(lambda x: np.isclose(x[0], R)).flatten()))
        return abs(null[at][0])

    assert moved(1.0) < 0.01 * moved(1 - T_over_C)
    assert math.isnan(first.creasing_amplitude)
    assert first.first == "wrinkle"


# -- searching the degrees ------------------------------------------------------------------------------------------


def searched(curve, limit, last):
    degrees = []

    def growth_of(degree, near):
        degrees.append(degree)
        return curve(degree)

    return wrinkling._search_degrees(growth_of, limit, last), degrees


def test_a_minimum_beyond_the_first_degrees_is_found():
    """A curve above its limit that still falls dips below it: thick soft cortices."""
    curve, _ = searched(lambda l: 2 - 10 / l + 900 / l**2, 2.0, 60)
    assert curve.degree[np.argmin(curve.g)] == 180
    assert {179, 180, 181} <= set(curve.degree)


def test_a_curve_that_settles_to_its_limit_from_above_is_left_there():
    curve, degrees = searched(lambda l: 1.5 + 3 / l, 1.5, 1000)
    assert max(degrees) < 1300
    assert np.argmin(curve.g) == len(curve.g) - 1


# -- the equations, from the energy ---------------------------------------------------------------------------------


def second_variation_on_the_sphere(A, degree, r, U, V, dU, dV, mu, kappa):
    """d2/de2 of the energy per current volume of A + e L A, integrated over the unit sphere, by central differences.

    L is the gradient of U Y e_r + V r grad Y for the zonal harmonic, in (r, theta, phi) components.
    """
    x, weights = np.polynomial.legendre.leggauss(40)
    angle = np.arccos(x)
    # zonal harmonic and its derivatives by theta
    Y = sph_harm_y(degree, 0, angle, 0).real
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi))
    P = np.polynomial.legendre.Legendre.basis(degree)
    dY = norm * P.deriv(1)(x) * -np.sin(angle)
    ddY = norm * (P.deriv(2)(x) * np.sin(angle) ** 2 - P.deriv(1)(x) * x)
    np.testing.assert_allclose(norm * P(x), Y, rtol=1e-10, atol=1e-12)
    L = np.zeros((len(x), 3, 3))
    L[:, 0, 0] = dU * Y
    L[:, 0, 1] = (U - V) / r * dY
    L[:, 1, 0] = dV * dY
    L[:, 1, 1] = (U * Y + V * ddY) / r
    L[:, 2, 2] = (U * Y + V * dY * x / np.sin(angle)) / r
    e = 1e-3 / np.abs(L).max()
    at = [energy(A + s * e * L @ A, mu, kappa) for s in (-2, -1, 0, 1, 2)]
    second = (-at[0] + 16 * at[1] - 30 * at[2] + 16 * at[3] - at[4]) / (12 * e * e)
    return 2 * math.pi * np.sum(weights * second) / np.linalg.det(A)


@pytest.mark.parametrize(
    ("degree", "lr", "lt", "kappa"), [(1, 1.7, 0.8, 20.0), (2, 0.7, 1.25, 3.0), (7, 1.4, 0.95, 9.0)]
)
def test_the_linear_equations_are_those_of_the_energys_second_variation(degree, lr, lt, kappa, rng):
    """2 L = momenta . velocities + forces . displacements, from the matrix; against finite differences in 3-D."""
    mu, r = 1.3, 0.8
    J = lr * lt * lt
    n = math.sqrt(degree * (degree + 1))
    M = np.empty((4, 4))
    wrinkling._fill_coefficients(M, n, mu, np.array([lr, lt, kappa * (J - 1), 1 / (kappa * J), r, 1.0]))
    for _ in range(5):
        u, velocity = rng.standard_normal(2), rng.standard_normal(2)  # (U, n V) and r d/dr of it
        momenta = np.linalg.solve(M[:2, 2:], velocity - M[:2, :2] @ u)
        forces = M[2:, :2] @ u + M[2:, 2:] @ momenta
        work = (momenta @ velocity + forces @ u) / r  # E = 1/2 int (...) ds = 1/2 int w r^2 dr
        U, V, dU, dV = u[0], u[1] / n, velocity[0] / r, velocity[1] / n / r
        expected = second_variation_on_the_sphere(np.diag([lr, lt, lt]), degree, r, U, V, dU, dV, mu, kappa)
        assert work == pytest.approx(expected * r**2, rel=1e-6)


def test_the_linear_equations_have_hamiltons_form(rng):
    """M = [[a, b], [c, -a^T]] with b, c symmetric: what keeps Z symmetric on the way."""
    M = np.empty((4, 4))
    wrinkling._fill_coefficients(M, 4.2, 1.3, np.array([1.4, 0.9, -0.3, 0.02, 0.8, 1.1]))
    np.testing.assert_allclose(M[:2, :2], -M[2:, 2:].T, rtol=1e-13)
    np.testing.assert_allclose(M[:2, 2:], M[:2, 2:].T, rtol=1e-13)
    np.testing.assert_allclose(M[2:, :2], M[2:, :2].T, rtol=1e-13)


# -- smooth states --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("T_over_C", "g", "kappa_ratio", "g_core"),
    [(0.04, 1.5, 20.0, 1.0), (0.3, 2.0, 5.0, 1.2), (0.001, 1.3, 1e3, 0.95), (0.1, 1.5, INF, 1.2)],
)
def test_smooth_state_is_that_of_finite_elements(law, T_over_C, g, kappa_ratio, g_core):
    sphere = SmoothSphere(T_over_C, 3.0, law, kappa_ratio)
    fields = smooth_state(sphere, g, g_core).fields
    state = finite_elements.radial_equilibrium(g, T_over_C, 3.0, law, kappa_ratio, g_core=g_core)
    for layer, (name, R) in enumerate((("core", sphere.B), ("cortex", 1.0))):
        outer = state.at(R, name)
        lr, lt, h1, _, r, _ = fields[layer, :, -1]
        m = sphere.mu[layer] * (lr * lt * lt) ** (-5 / 3)
        sigma = [m * (v * v - (lr * lr + 2 * lt * lt) / 3) + h1 for v in (lr, lt)]
        expected = [outer.r[0], outer.sigma_r[0], outer.sigma_theta[0]]
        np.testing.assert_allclose([r, *sigma], expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_stress_in_closed_form_is_the_limit_of_finite_elements_at_rate_one_over_kappa(law):
    g, T = 1.6, 0.06
    R = np.linspace(1 - T, 1, 7)
    closed = theory.stresses(g, 1 - T, 1.0, law, mu_cortex=2.0, n=7)
    error = []
    for kappa_ratio in (1e3, 1e4, 1e5):
        s = finite_elements.radial_equilibrium(g, T, 2.0, law, kappa_ratio, elements=8).at(R, "cortex")
        error.append(max(np.abs(s.sigma_r - closed.sigma_r).max(), np.abs(s.sigma_theta - closed.sigma_theta).max()))
        assert np.abs(s.r - closed.r).max() < 2 * g / kappa_ratio
    rate = np.polyfit([3, 4, 5], np.log10(error), 1)[0]
    assert rate == pytest.approx(-1, abs=0.02)
    assert error[-1] < 1e-3
    exact = finite_elements.radial_equilibrium(g, T, 2.0, law, elements=8).at(R, "cortex")
    np.testing.assert_allclose(exact.sigma_r, closed.sigma_r, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(exact.sigma_theta, closed.sigma_theta, rtol=1e-9)


def test_a_growth_without_a_smooth_state_and_one_that_the_points_do_not_resolve_are_refused():
    """A soft core drawn out threefold by a stiff, compressible cortex: finite elements differ by 4e-7 in g there."""
    with pytest.raises(ConvergenceError, match=r"\bg = 9, kappa_ratio = 1, T/C = 0\.02\b"):
        smooth_state(SmoothSphere(0.02, 1.0, "isotropic", 1.0), 9.0)
    with pytest.raises(ConvergenceError, match=r"\bg = 2\.9465, kappa_ratio = 10, T/C = 0\.2\b"):
        smooth_state(SmoothSphere(0.2, 1000.0, "isotropic", 10.0), 2.9465)
    smooth_state(SmoothSphere(0.4, 1000.0, "isotropic", 50.0), 2.93)  # and one that they do, just, is not
    first = theory.bifurcation(0.2, 1e4, "isotropic", 10.0)
    assert math.isnan(first.g_crit)
    assert re.search(r"\bg = [\d.]+;", first.reason)  # and then that it could be followed no further


def test_a_state_far_from_the_incompressible_one_is_reached_by_way_of_stiffer_ones(monkeypatch):
    sphere, g, ways = SmoothSphere(0.16, 38.0, "tangential", 2.3, 0.65), 2.3, []
    newton = smooth_sphere._newton
    monkeypatch.setattr(smooth_sphere, "_newton", lambda *arguments: ways.append(newton(*arguments)) or ways[-1])
    state = smooth_state(sphere, g)
    assert ways[0] is None  # straight from the incompressible state: no
    other = finite_elements.radial_equilibrium(g, 0.16, 38.0, "tangential", 2.3, A_over_C=0.65, elements=16)
    assert state.fields[1, smooth_sphere.RADIUS, -1] == pytest.approx(other.at(1.0, "cortex").r[0], rel=1e-8)


# -- limits that are known ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("T_over_C", [0.02])
def test_the_shortest_waves_go_at_biots_surface_instability(law, T_over_C):
    first = theory.bifurcation(T_over_C, 1.0, law)
    biot = float(theory.critical_growth(1 / (1 - T_over_C), law, ratio=theory.BIOT))
    assert first.short_wave == pytest.approx(biot, rel=1e-10)
    sphere = SmoothSphere(T_over_C, 1.0, law)
    gap = [wrinkling.critical_growth_of_degree(sphere, round(k / T_over_C)) - biot for k in (50, 100, 200)]
    assert np.polyfit(np.log([50, 100, 200]), np.log(np.abs(gap)), 1)[0] == pytest.approx(-1, abs=0.1)
    assert abs(gap[-1]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("T_over_C", "mu_ratio", "law", "kappa_ratio"),
    [(0.3, 0.2, "isotropic", 20.0), (0.3, 3.0, "tangential", 20.0), (0.02, 3.0, "tangential", 5.0)],
)
def test_short_wave_limit_is_that_of_the_curve(T_over_C, mu_ratio, law, kappa_ratio):
    """g(l) = limit + a/l + O(1/l^2), marched at two high degrees; layers of unlike stiffness that can be compressed."""
    sphere = SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio)
    l = round(120 / T_over_C)
    low, high = (wrinkling.critical_growth_of_degree(sphere, degree) for degree in (l, 2 * l))
    short_wave = theory.bifurcation(T_over_C, mu_ratio, law, kappa_ratio).short_wave
    assert short_wave == pytest.approx(2 * high - low, abs=1e-4)


def test_a_thin_soft_cortex_wrinkles_at_the_equibiaxial_stretch_of_biot():
    first = theory.bifurcation(1e-5, 0.1)
    assert first.mode == math.inf
    assert first.wavelength == first.wavelength_deformed == 0
    assert first.creasing_amplitude == 0
    assert 1 / first.g_crit == pytest.approx(0.6661, abs=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_thin_stiff_cortex_wrinkles_as_a_film_on_a_soft_substrate(law):
    """Chen and Hutchinson 2004: 2 pi T (mu_f/3 mu_s)^(1/3) at (3 mu_s/mu_f)^(2/3)/6, in the limit of a stiff film."""
    strain_error, wave_error, stiffness = [], [], (1e2, 1e3, 1e4)
    for mu_ratio in stiffness:
        first = theory.bifurcation(1e-6, mu_ratio, law)
        strain_error.append((first.g_crit - 1) / ((3 / mu_ratio) ** (2 / 3) / 6) - 1)
        wave_error.append(first.wavelength / (2 * math.pi * 1e-6 * (mu_ratio / 3) ** (1 / 3)) - 1)
    assert np.all(np.diff(np.abs(strain_error)) < 0)
    assert abs(strain_error[-1]) < 1e-4
    assert abs(wave_error[-1]) < 2e-3
    # the formula's next term is of the order of the critical strain, mu_ratio^(-2/3)
    assert np.polyfit(np.log(stiffness), np.log(np.abs(wave_error)), 1)[0] == pytest.approx(-2 / 3, abs=0.02)


# -- what a result says ---------------------------------------------------------------------------------------------


def test_critical_mode_is_the_lowest_of_all_degrees():
    first = theory.bifurcation(0.06, 2.0)
    sphere = SmoothSphere(0.06, 2.0)
    every = [wrinkling.critical_growth_of_degree(sphere, degree) for degree in range(1, 41)]
    assert first.mode == 1 + np.nanargmin(every)
    assert first.g_crit == pytest.approx(np.nanmin(every), rel=1e-12)
    both = dict(zip(*first.curve))
    common = [d for d in both if d <= 40]
    np.testing.assert_allclose([both[d] for d in common], [every[d - 1] for d in common], rtol=1e-11)
    assert np.all(np.diff(first.curve.degree) > 0)


def test_a_sphere_that_stays_stable_is_nan_with_the_reason():
    first = theory.bifurcation(0.04, 1.0, g_max=1.2)
    assert math.isnan(first.g_crit)
    assert math.isnan(first.mode)
    assert first.reason.endswith(" g = 1.2")  # all the way
    assert np.isnan(first.curve.g).all()


@pytest.mark.parametrize(
    ("arguments", "kind", "named"),
    [
        ({"T_over_C": 0.6}, ImpossibleBody, r"A/C = 0\.5, T/C = 0\.6\.$"),
        ({"T_over_C": -0.1}, ImpossibleBody, r"A/C = 0\.5, T/C = -0\.1\.$"),
        ({"T_over_C": 0.04, "A_over_C": 0.0}, ImpossibleBody, r"A/C = 0, T/C = 0\.04\.$"),
        ({"T_over_C": 0.04, "mu_ratio": 0.0}, OutOfRange, r"^mu_ratio\b.* 1e-4 .* 1e4\b.* 0\.0\.$"),
        ({"T_over_C": 0.04, "kappa_ratio": 0.1}, OutOfRange, r"^kappa_ratio\b.* 1 .* 1e8\b.* 0\.1\.$"),
        ({"T_over_C": 0.04, "kappa_ratio": 1e13}, OutOfRange, r"^kappa_ratio\b.* 1e8\b.* inf\b.*10000000000000\.0\.$"),
        ({"T_over_C": 1e-9}, ImpossibleBody, r"T/C >= 1e-6\b.* T/C = 1e-09\.$"),
        ({"T_over_C": 0.04, "law": "radial"}, UnknownName, r" 'radial'\.$"),
        ({"T_over_C": 0.04, "g_max": 1.0}, OutOfRange, r"^g_max\b.* 1\.0\.$"),
    ],
)
def test_bifurcation_refuses_what_is_no_sphere(arguments, kind, named):
    with pytest.raises(kind, match=named):
        theory.bifurcation(**arguments)
