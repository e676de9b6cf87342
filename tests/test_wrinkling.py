"""Linear stability of the growing sphere: two routes, the full second variation, and the limits that are known."""

import math
import re

import numpy as np
import pytest

from morphofold.errors import ImpossibleBody, OutOfRange, UnknownName
from morphofold.sim import theory
from morphofold.sim.materials.elastic import energy
from morphofold.sim.sphere_theory import smooth_sphere, wrinkling
from morphofold.sim.sphere_theory.smooth_sphere import ConvergenceError, SmoothSphere, smooth_state
from morphofold.studies.accuracy import radial_finite_elements as finite_elements, radial_modes

LAWS, INF = ("isotropic", "tangential"), math.inf


# -- two routes -----------------------------------------------------------------------------------------------------


slow = lambda *case: pytest.param(*case, marks=pytest.mark.slow)
CASES = [  # the first are the paper's, near their minima
    *[slow(T, mu, l, INF, 0.5) for T, mu, l in ((0.02, 1, 37), (0.04, 1, 18), (0.06, 4, 11))],
    *[slow(0.04, 1, 18, 50.0, 0.5), slow(0.3, 1, 40, 50.0, 0.5), slow(0.001, 1, 700, INF, 0.5)],
    *[slow(0.25, 10, 3, 50.0, 0.5), slow(0.04, 2, 2, INF, 0.05)],
    *[(0.02, 1, 37, 50.0, 0.5), (0.06, 4, 11, 50.0, 0.5), (0.2, 0.1, 20, INF, 0.5), (0.04, 2, 6, INF, 0.8)],
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("T_over_C", "mu_ratio", "degree", "kappa_ratio", "A_over_C"), CASES)
def test_marching_and_finite_elements_find_the_same_growth(T_over_C, mu_ratio, degree, kappa_ratio, A_over_C, law):
    sphere = SmoothSphere(T_over_C, mu_ratio, law, kappa_ratio, A_over_C)
    marched = wrinkling.critical_growth_of_degree(sphere, degree, g_max=20)
    elements = radial_modes.critical_growth_of_degree(
        degree, T_over_C, mu_ratio, law, kappa_ratio, A_over_C=A_over_C, g_max=20, step=0.15
    )
    assert marched == pytest.approx(elements, rel=1e-8)  # asked: 1e-6


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("T", "mu_ratio"), [(2, 2), *(slow(T, mu) for T in (1, 2, 3) for mu in (1, 4))])
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
    assert all(radial_modes.unstable_modes(below, degree, T_over_C, mu_ratio, law) == 0 for degree in near)
    assert radial_modes.unstable_modes(above, int(first.mode), T_over_C, mu_ratio, law) == 1


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("T_over_C", "mu_ratio"), [(1 / 50, 1), (3 / 50, 4), (0.3, 1)])
def test_toroidal_modes_are_still_stable_when_a_spheroidal_one_is_lost(T_over_C, mu_ratio, law):
    g = theory.bifurcation(T_over_C, mu_ratio, law).g_crit
    unstable = lambda degree: radial_modes.unstable_modes(g, degree, T_over_C, mu_ratio, law, toroidal=True)
    assert [unstable(degree) for degree in (1, 2, 5, 20, 80)] == [0] * 5


def null_mode(first, T_over_C, mu_ratio):
    """U and V of the finite-element mode at critical growth, at the nodes of a radius: a function of the radius."""
    body = radial_modes.SphereModes(SmoothSphere(T_over_C, mu_ratio), int(first.mode), None, 8, first.g_crit)
    growth = first.g_crit, 1.0
    values, vectors = np.linalg.eigh(body.second_variation(body.grow(growth), growth))
    null = vectors[:, np.argmin(np.abs(values))]

    def at(R):
        node = np.flatnonzero(np.isin(body.free, body.u.get_dofs(lambda x: np.isclose(x[0], R)).flatten()))[0]
        return null[node], null[len(body.free) + node]

    return at


def test_creasing_amplitude_is_that_of_the_finite_element_mode():
    """Null vector of the finite-element tangent, its roll at that amplitude, and the stretches at the trough."""
    T_over_C, mu_ratio = 3 / 50, 4.0
    first = theory.bifurcation(T_over_C, mu_ratio)
    U, V = null_mode(first, T_over_C, mu_ratio)(1.0)
    c = float(theory.deformed_radius(first.g_crit, 1 / (1 - T_over_C))) * (1 - T_over_C)
    stretch = c / first.g_crit
    a, N = first.creasing_amplitude, first.mode * (first.mode + 1)
    across = stretch * (1 - a * (U - N * V) / U / c)  # u_theta,theta of u = U Y e_r + V grad Y, Y = -1
    along = stretch * (1 - a / c)
    assert 1 / (across * along) / across == pytest.approx(theory.CREASE, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_crease_growth_of_a_bifurcation_is_the_papers_if_incompressible(law):
    for T_over_C in (0.02, 0.06):
        first = theory.bifurcation(T_over_C, 2.0, law)
        assert first.g_crease == pytest.approx(float(theory.critical_growth(1 / (1 - T_over_C), law)), rel=1e-11)
    assert math.isnan(theory.bifurcation(0.3, 2.0, "isotropic").g_crease)


def test_crease_growth_of_a_compressible_cortex_is_where_its_surface_has_the_critical_ratio():
    first = theory.bifurcation(0.04, 1.0, kappa_ratio=20.0)
    state = finite_elements.radial_equilibrium(first.g_crease, 0.04, kappa_ratio=20.0, elements=8).at(1.0, "cortex")
    assert state.J[0] / (state.r[0] / first.g_crease) ** 3 == pytest.approx(theory.CREASE, rel=1e-8)


@pytest.mark.parametrize(("T_over_C", "mu_ratio"), [(0.45, 0.02), slow(0.43, 0.5)])
def test_wrinkles_of_the_interface_leave_the_surface_smooth(T_over_C, mu_ratio):
    """The finite-element mode moves the interface and hardly the surface, so there is no creasing amplitude."""
    first = theory.bifurcation(T_over_C, mu_ratio)
    mode = null_mode(first, T_over_C, mu_ratio)
    assert abs(mode(1.0)[0]) < 0.01 * abs(mode(1 - T_over_C)[0])
    assert math.isnan(first.creasing_amplitude)
    assert first.first == "wrinkle"


# -- searching the degrees ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("curve", "limit", "last", "lowest"),
    [
        (lambda l: 2 - 10 / l + 900 / l**2, 2.0, 60, 180),  # dips below its limit: thick soft cortices
        (lambda l: 1.5 + 3 / l, 1.5, 1000, pytest.approx(1150, abs=150)),  # settles to it, and is left to itself
    ],
)
def test_degrees_are_searched_as_far_as_their_curve_falls(curve, limit, last, lowest):
    result = wrinkling._search_degrees(lambda degree, near: curve(degree), limit, last)
    assert result.degree[np.argmin(result.g)] == lowest


# -- the equations, from the energy ---------------------------------------------------------------------------------


def second_variation_on_the_sphere(A, degree, r, U, V, dU, dV, mu, kappa):
    """d2/de2 of the energy per current volume of A + e L A, integrated over the unit sphere, by central differences.

    L is the gradient of U Y e_r + V r grad Y for the zonal harmonic, in (r, theta, phi) components.
    """
    x, weights = np.polynomial.legendre.leggauss(40)
    angle = np.arccos(x)
    # zonal harmonic and its derivatives by theta
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi))
    P = np.polynomial.legendre.Legendre.basis(degree)
    Y, dY = norm * P(x), norm * P.deriv(1)(x) * -np.sin(angle)
    ddY = norm * (P.deriv(2)(x) * np.sin(angle) ** 2 - P.deriv(1)(x) * x)
    L = np.zeros((len(x), 3, 3))
    L[:, 0, 0] = dU * Y
    L[:, 0, 1] = (U - V) / r * dY
    L[:, 1, 0] = dV * dY
    L[:, 1, 1] = (U * Y + V * ddY) / r
    L[:, 2, 2] = (U * Y + V * dY * x / np.sin(angle)) / r
    e = 1e-3 / np.abs(L).max()
    w = [energy(A + s * e * L @ A, mu, kappa) for s in (-2, -1, 0, 1, 2)]
    second = (-w[0] + 16 * w[1] - 30 * w[2] + 16 * w[3] - w[4]) / (12 * e * e)
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
    for kappa_ratio in (1e3, 1e5):
        s = finite_elements.radial_equilibrium(g, T, 2.0, law, kappa_ratio, elements=8).at(R, "cortex")
        error.append(max(np.abs(s.sigma_r - closed.sigma_r).max(), np.abs(s.sigma_theta - closed.sigma_theta).max()))
        assert np.abs(s.r - closed.r).max() < 2 * g / kappa_ratio
    assert error[1] < 1e-3
    assert np.log(error[1] / error[0]) / np.log(100) == pytest.approx(-1, abs=0.02)
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
    sphere, g, states = SmoothSphere(0.16, 38.0, "tangential", 2.3, 0.65), 2.3, []
    newton = smooth_sphere._newton
    monkeypatch.setattr(smooth_sphere, "_newton", lambda *arguments: states.append(newton(*arguments)) or states[-1])
    state = smooth_state(sphere, g)
    assert states[0] is None  # straight from the incompressible state: no
    other = finite_elements.radial_equilibrium(g, 0.16, 38.0, "tangential", 2.3, A_over_C=0.65, elements=16)
    assert state.fields[1, smooth_sphere.RADIUS, -1] == pytest.approx(other.at(1.0, "cortex").r[0], rel=1e-8)


# -- limits that are known ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
def test_the_shortest_waves_go_at_biots_surface_instability(law):
    T_over_C = 0.02
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
    lengths = first.wavelength, first.wavelength_deformed, first.creasing_amplitude
    assert (first.mode, *lengths) == (INF, 0, 0, 0)
    assert 1 / first.g_crit == pytest.approx(0.6661, abs=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_thin_stiff_cortex_wrinkles_as_a_film_on_a_soft_substrate(law):
    """Chen and Hutchinson 2004: 2 pi T (mu_f/3 mu_s)^(1/3) at (3 mu_s/mu_f)^(2/3)/6, in the limit of a stiff film."""
    stiffness = np.array([1e2, 1e3, 1e4])
    films = [theory.bifurcation(1e-6, mu_ratio, law) for mu_ratio in stiffness]
    strain = np.array([film.g_crit - 1 for film in films]) / ((3 / stiffness) ** (2 / 3) / 6) - 1
    wave = np.array([film.wavelength for film in films]) / (2 * math.pi * 1e-6 * (stiffness / 3) ** (1 / 3)) - 1
    assert np.all(np.diff(np.abs(strain)) < 0)
    assert (abs(strain[-1]) < 1e-4, abs(wave[-1]) < 2e-3) == (True, True)
    # the formula's next term is of the order of the critical strain, mu_ratio^(-2/3)
    assert np.polyfit(np.log(stiffness), np.log(np.abs(wave)), 1)[0] == pytest.approx(-2 / 3, abs=0.02)


# -- what a result says ---------------------------------------------------------------------------------------------


def test_critical_mode_is_the_lowest_of_all_degrees():
    first = theory.bifurcation(0.06, 2.0)
    sphere = SmoothSphere(0.06, 2.0)
    every = [wrinkling.critical_growth_of_degree(sphere, degree) for degree in range(1, 41)]
    assert (first.mode, first.g_crit) == (1 + np.nanargmin(every), pytest.approx(np.nanmin(every), rel=1e-12))
    degree, g = (values[first.curve.degree <= 40] for values in first.curve)
    np.testing.assert_allclose(g, np.array(every)[degree - 1], rtol=1e-11)
    assert np.all(np.diff(first.curve.degree) > 0)


def test_a_sphere_that_stays_stable_is_nan_with_the_reason():
    first = theory.bifurcation(0.04, 1.0, g_max=1.2)
    assert np.isnan([first.g_crit, first.mode, *first.curve.g]).all()
    assert first.reason.endswith(" g = 1.2")  # all the way


@pytest.mark.parametrize(
    ("arguments", "kind", "named"),
    [
        ({"T_over_C": 0.6}, ImpossibleBody, r"A/C = 0\.5, T/C = 0\.6\.$"),
        ({"T_over_C": 1e-9}, ImpossibleBody, r"T/C >= 1e-6\b.* T/C = 1e-09\.$"),
        ({"T_over_C": 0.04, "mu_ratio": 0.0}, OutOfRange, r"^mu_ratio\b.* 1e-4 .* 1e4\b.* 0\.0\.$"),
        ({"T_over_C": 0.04, "kappa_ratio": 1e13}, OutOfRange, r"^kappa_ratio\b.* 1e8\b.* inf\b.*10000000000000\.0\.$"),
        ({"T_over_C": 0.04, "law": "radial"}, UnknownName, r" 'radial'\.$"),
    ],
)
def test_bifurcation_refuses_what_is_no_sphere(arguments, kind, named):
    with pytest.raises(kind, match=named):
        theory.bifurcation(**arguments)
