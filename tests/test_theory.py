"""Radius, stress and crease criterion of the growing sphere against the equations they solve."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from morphofold.errors import ImpossibleBody, OptionsClash, OutOfRange, UnknownName
from morphofold.sim import theory

LAWS = ("isotropic", "tangential")
THICKNESSES = (1.0, 2.0, 3.0)  # with C = 50: the paper's cortices


def det(g, law):
    return g**3 if law == "isotropic" else g**2


def surface_ratio(g, C_bar, law, **core):
    """lambda_r / lambda_theta at the outer surface, from the radius as a function of R alone."""
    h = 1e-5
    inside, outside = (theory.deformed_radius(g, C_bar, law, R_bar=C_bar - d, **core) for d in (2 * h, h))
    c = theory.deformed_radius(g, C_bar, law, **core)
    slope = (3 * c - 4 * outside + inside) / (2 * h)
    radial = g if law == "isotropic" else 1.0
    return (slope / radial) / (c / (g * C_bar))


# -- radius: Eqs. 8 to 11 ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("g_core", [1.0, 0.9, 1.3])
def test_radius_solves_the_incompressibility_equation(law, g_core):
    g, A, B, C = 1.7, 25.0, 47.0, 50.0

    def slope(R, r):
        return (g_core**3 if R < B else det(g, law)) * R**2 / r**2  # Eq. 8

    core = solve_ivp(slope, (A, B), [A], rtol=1e-11, atol=1e-11)
    b = core.y[0, -1]
    c = solve_ivp(slope, (B, C), [b], rtol=1e-11, atol=1e-11).y[0, -1]
    computed = theory.deformed_radius(g, C / B, law, R_bar=[1.0, C / B], g_core=g_core, A_bar=A / B) * B
    np.testing.assert_allclose(computed, [b, c], rtol=1e-9)


def test_radius_is_the_papers_equation_10_over_the_hole():
    A, B, R, C, g_s, g_c = 25.0, 48.0, 49.0, 50.0, 1.5, 1.1
    over_hole = theory.deformed_radius(g_s, C / B, R_bar=R / B, g_core=g_c, A_bar=A / B) * B / A
    assert over_hole**3 == pytest.approx(1 + g_c**3 * ((B / A) ** 3 - 1) + g_s**3 * ((R / A) ** 3 - (B / A) ** 3))


def test_the_hole_is_at_half_the_outer_radius_unless_said():
    half = theory.deformed_radius(1.5, 1.2, g_core=1.2, A_bar=0.6)
    assert theory.deformed_radius(1.5, 1.2, g_core=1.2) == half
    assert theory.critical_growth(1.1, g_core=1.2) == theory.critical_growth(1.1, g_core=1.2, A_bar=0.55)
    with pytest.raises(OptionsClash, match=r"\bC_bar\b.* 1\.25\b.*\bA_bar\b"):
        theory.deformed_radius(1.5, 2.5, g_core=1.2)
    assert theory.deformed_radius(1.5, 2.5) > 2.5  # a core at rest needs none


@pytest.mark.parametrize(
    ("arguments", "kind", "named"),
    [
        ({"g": 0.0, "C_bar": 1.1}, OutOfRange, r"^g .* 0\.0\.$"),
        ({"g": 1.5, "C_bar": 0.9}, OutOfRange, r"^C_bar .* 0\.9\.$"),
        ({"g": 1.5, "C_bar": 1.1, "law": "radial"}, UnknownName, r"\bisotropic, tangential\b.* 'radial'\.$"),
        ({"g": 1.5, "C_bar": 1.1, "g_core": -1.0}, OutOfRange, r"^g_core .* -1\.0\.$"),
        ({"g": 1.5, "C_bar": 1.1, "A_bar": 1.2}, OutOfRange, r"^A_bar .* 1\.2\.$"),
        ({"g": 1.5, "C_bar": 1.1, "R_bar": 1.2}, OutOfRange, r"^R_bar .* C_bar = 1\.1\b.* 1\.2\.$"),
        ({"g": 1.5, "C_bar": 1.1, "R_bar": 0.1}, OutOfRange, r"^R_bar .* A_bar = 0\.55\b.* 0\.1\.$"),
        ({"C_bar": 1.1, "ratio": 1.0}, OutOfRange, r"^ratio .* 1\.$"),
    ],
)
def test_radius_and_critical_growth_refuse_what_is_no_sphere(arguments, kind, named):
    with pytest.raises(kind, match=named):
        (theory.critical_growth if "ratio" in arguments else theory.deformed_radius)(**arguments)


# -- crease criterion: Eqs. 7, 12, 13 ------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("ratio", [theory.CREASE, theory.BIOT])
@pytest.mark.parametrize("core", [{}, {"g_core": 1.2, "A_bar": 0.6}])
def test_at_critical_growth_the_surface_has_the_critical_ratio(law, ratio, core):
    C_bar = np.array([1.001, 50 / 49, 50 / 48, 50 / 47, 1.1])
    g = theory.critical_growth(C_bar, law, ratio=ratio, **core)
    computed = [surface_ratio(a, b, law, **core) for a, b in zip(g, C_bar)]
    np.testing.assert_allclose(computed, ratio, rtol=1e-7)


def test_critical_growth_is_the_papers_equation_12():
    C_bar = np.array([1.01, 1.1, 1.19])
    np.testing.assert_allclose(theory.critical_growth(C_bar), (1 / (1 - 7 / 12 * C_bar**3)) ** (1 / 3), rtol=1e-14)


@pytest.mark.parametrize("C_bar", [1.0001, 1.05, 1.5, 4.0, 100.0])
def test_tangential_critical_growth_is_the_only_root_of_the_papers_equation_13(C_bar):
    roots = np.roots([C_bar**3, -2.4 * (C_bar**3 - 1), 0, -2.4])
    real = roots[np.abs(roots.imag) < 1e-9].real
    positive = real[real > 0]
    assert len(positive) == 1
    assert theory.critical_growth(C_bar, "tangential") == pytest.approx(positive[0], rel=1e-12)


def test_isotropic_creases_end_at_1_20_and_tangential_ones_never():
    limit = theory.thickest_creasing()
    assert limit == pytest.approx((12 / 7) ** (1 / 3))
    assert theory.critical_growth(limit * (1 - 1e-9)) > 500
    assert np.isnan(theory.critical_growth([limit * (1 + 1e-9), 1.3])).all()
    assert np.isfinite(theory.critical_growth([limit, 10.0], "tangential")).all()
    assert theory.thickest_creasing("tangential") == np.inf
    # what is left of the compression when growth has no bound
    assert surface_ratio(1e4, 1.001 * limit, "isotropic") < theory.CREASE


def test_biots_ratio_is_that_of_his_surface_instability():
    x = 1 / theory.BIOT
    assert x**3 + x**2 + 3 * x == pytest.approx(1, abs=1e-14)
    assert x ** (1 / 3) == pytest.approx(0.6661, abs=5e-5)  # equibiaxial stretch


# -- stress: Fig. 3b -----------------------------------------------------------------------------------------------


def by_quadrature(g, A, B, C, law, mu_cortex, mu_core, g_core, R):
    """(sigma_r, sigma_theta) at reference radius R by adaptive quadrature of Eq. 6 inwards from the free surface."""

    def difference(X, layer):
        mu, growth = (mu_cortex, g) if layer == "cortex" else (mu_core, g_core)
        r = B * float(theory.deformed_radius(g, C / B, law, R_bar=X / B, g_core=g_core, A_bar=A / B))
        stretch = r / (growth * X)
        slope = (det(g, law) if layer == "cortex" else g_core**3) * X**2 / r**2
        return mu * (stretch**2 - stretch**-4), 2 * mu * (stretch**2 - stretch**-4) / r * slope

    layer = "cortex" if R >= B else "core"
    sigma_r = -quad(lambda X: difference(X, "cortex")[1], max(R, B), C, epsabs=1e-13, epsrel=1e-13)[0]
    if layer == "core":
        sigma_r -= quad(lambda X: difference(X, "core")[1], R, B, epsabs=1e-13, epsrel=1e-13)[0]
    return sigma_r, sigma_r + difference(R, layer)[0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("g", "T", "g_core"), [(2.0, 2, 1.0), (0.8, 3, 0.9), (3.0, 20, 1.1)])
def test_stress_is_the_integral_of_equilibrium(law, g, T, g_core):
    B, C, A, mu_cortex, mu_core = 50.0 - T, 50.0, 20.0, 3.0, 0.7
    for part, ends in (("cortex", (B, C)), ("core", (A, B))):
        s = theory.stresses(g, B, C, law, mu_cortex=mu_cortex, mu_core=mu_core, part=part, n=4, A=A, g_core=g_core)
        inner = part == "cortex"  # at R = B the quadrature stands on the cortex's side
        for i, R in list(enumerate(np.linspace(*ends, 4)))[: 4 if inner else 3]:
            expected = by_quadrature(g, A, B, C, law, mu_cortex, mu_core, g_core, R)
            np.testing.assert_allclose((s.sigma_r[i], s.sigma_theta[i]), expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("law", LAWS)
def test_the_surface_is_free_and_the_interface_carries_one_traction(law):
    cortex, core = (theory.stresses(1.8, 47, 50, law, part=p, mu_core=0.5, g_core=1.1) for p in ("cortex", "core"))
    assert cortex.sigma_r[-1] == 0
    assert core.sigma_r[-1] == pytest.approx(cortex.sigma_r[0], rel=1e-14)
    assert core.r[-1] == cortex.r[0]
    assert abs(core.sigma_theta[-1] - cortex.sigma_theta[0]) > 1


@pytest.mark.parametrize("law", LAWS)
def test_a_core_that_does_not_grow_carries_one_pressure(law):
    core = theory.stresses(1.8, 47, 50, law, part="core", A=0.0)
    pulled = theory.stresses(1.8, 47, 50, law).sigma_r[0]
    np.testing.assert_allclose([core.sigma_r, core.sigma_theta], pulled, rtol=1e-13)
    assert pulled > 0  # the swelling shell pulls the core outwards


@pytest.mark.parametrize("law", LAWS)
def test_small_growth_gives_the_stress_of_a_thin_clamped_layer(law):
    """A layer that may not spread, grown by e: sigma_theta = -6 mu e."""
    e = 1e-6
    s = theory.stresses(1 + e, 50 - 1e-5, 50, law)
    np.testing.assert_allclose(s.sigma_theta, -6 * e, rtol=1e-4)


def test_the_thinner_the_cortex_the_higher_its_compression():
    """The paper's reading of Fig. 3b, at the outer surface and on average."""
    profiles = [theory.stresses(2.0, 50 - T, 50).sigma_theta for T in THICKNESSES]
    assert all((thin < thick).all() for thin, thick in pairwise(profiles))
    assert max(p.max() for p in profiles) < 0


@pytest.mark.parametrize(
    ("arguments", "kind", "named"),
    [
        ({"B": 50.0, "C": 48.0}, ImpossibleBody, r"\bA = 24, B = 50, C = 48\.$"),
        ({"A": 49.0}, ImpossibleBody, r"\bA = 49, B = 48, C = 50\.$"),
        ({"mu_cortex": 0.0}, OutOfRange, r"^mu_cortex .* 0\.0\.$"),
        ({"mu_core": np.nan}, OutOfRange, r"^mu_core .* nan\.$"),
        ({"n": 1}, OutOfRange, r"^n .* 2\b.* 1\.$"),
        ({"part": "white"}, UnknownName, r"^part .*\bcortex\b.*\bcore\b.* 'white'\.$"),
        ({"part": "core", "A": 0.0, "g_core": 1.1}, OutOfRange, r"\bA = 0\b"),
        ({"law": "radial"}, UnknownName, r" 'radial'\.$"),
    ],
)
def test_stress_refuses_what_is_no_sphere(arguments, kind, named):
    with pytest.raises(kind, match=named):
        theory.stresses(**({"g": 1.5, "B": 48.0, "C": 50.0} | arguments))
