"""Spherical harmonics: values, derivatives and fits, against SciPy and closed forms."""

import numpy as np
import pytest
from scipy.special import sph_harm_y
from threadpoolctl import threadpool_limits

from morphofold.errors import WrongShape
from morphofold.unfolding.harmonics import Expansion, degrees, fit, harmonics


@pytest.fixture
def points(rng):
    s = np.vstack([rng.standard_normal((300, 3)), np.eye(3), -np.eye(3)])  # poles and axes, too
    return s / np.linalg.norm(s, axis=1, keepdims=True)


def test_harmonics_are_those_of_scipy(points):
    theta, phi = np.arccos(points[:, 2]), np.arctan2(points[:, 1], points[:, 0])
    ours = harmonics(points, 9)
    for l in range(10):
        for m in range(l + 1):
            theirs = (-1) ** m * sph_harm_y(l, m, theta, phi) * (1 if m == 0 else np.sqrt(2))
            np.testing.assert_allclose(ours[:, l * l + l + m], theirs.real, atol=1e-13)
            if m:
                np.testing.assert_allclose(ours[:, l * l + l - m], theirs.imag, atol=1e-13)


def test_the_gradient_of_a_solid_harmonic_polynomial_is_exact(points):
    """x y z is solid of degree 3, x^2 - y^2 of degree 2, z of degree 1."""
    x, y, z = points.T
    function = fit(points, np.column_stack([x * y * z + x**2 - y**2, z]), np.ones(len(points)), 4)
    gradient = function.gradient()(points).reshape(-1, 2, 3)
    first = np.column_stack([y * z + 2 * x, x * z - 2 * y, x * y])
    np.testing.assert_allclose(gradient[:, 0], first, atol=1e-12)
    np.testing.assert_allclose(gradient[:, 1], np.broadcast_to([0, 0, 1], first.shape), atol=1e-12)
    assert not Expansion(np.ones((1, 2))).gradient()(points).any()  # of a constant


def test_a_fit_returns_the_expansion_that_it_was_given(points, rng):
    known = Expansion(rng.standard_normal((49, 3)))
    fitted = fit(points, known(points), rng.uniform(0.5, 2, len(points)), 6)
    np.testing.assert_allclose(fitted.coefficients, known.coefficients, atol=1e-10)


def test_heat_flow_lets_each_degree_decay_at_its_own_rate(rng):
    known = Expansion(rng.standard_normal((36, 1)))
    ratio = known.smoothed(0.03).coefficients / known.coefficients
    l = degrees(5)
    np.testing.assert_allclose(ratio[:, 0], np.exp(-0.03 * l * (l + 1)), rtol=1e-13)


def test_too_few_points_are_refused(points):
    with pytest.raises(WrongShape):
        fit(points[:20], points[:20], np.ones(20), 6)


def test_fits_and_values_have_the_same_bits_for_any_number_of_threads(rng):
    s = rng.standard_normal((20_000, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    results = []
    for threads in (1, 2):
        with threadpool_limits(threads, "blas"):
            shape = fit(s, s**2, np.ones(len(s)), 20)
            results.append((shape.coefficients, shape(s)))
    for one, other in zip(*results):
        np.testing.assert_array_equal(one, other)
