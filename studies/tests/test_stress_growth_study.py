"""The theory of first folds on a core that grows by its stress, which the study compares with simulations."""

import numpy as np
import pytest

from morphofold.sim.theory import bifurcation
from morphofold.studies import stress_growth_study
from morphofold.studies.stress_growth_study import AMPLIFIED, HEIGHT, heights, layer, reached, spectra

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


@pytest.mark.parametrize("g", [1.02, 1.2, 1.4])
def test_a_layer_that_is_held_responds_as_an_elastic_body(g):
    """Its stiffness is symmetric, and a long wave lifts it as a whole, without force."""
    force, by_noise, lift, lift_by_noise = layer(g, np.array([0.01, 1.0, 4.0]))
    np.testing.assert_allclose(force[:, 0, 1], force[:, 1, 0], rtol=1e-6)
    np.testing.assert_allclose(lift[0], [0.0, 1.0], atol=0.03)
    assert np.abs(force[0, 1, 1]) < 1e-2 * np.abs(force[1]).max()
    np.testing.assert_allclose(by_noise[0], [-0.01 * (g**4 - g**-2) * g**2, 0.0], rtol=0.03, atol=2e-3)
    assert lift_by_noise[0] == pytest.approx(g**2, rel=0.01)  # noise is stretched along the thickness


@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_an_elastic_core_loses_its_stability_where_the_theory_of_spheres_says(ratio):
    k = 2 * np.pi / np.geomspace(5, 11, 200)
    want = bifurcation(1e-3, ratio, "tangential")

    def least(g):
        return np.linalg.eigvalsh(layer(g, k)[0] + 2 * k[:, None, None] / ratio * np.eye(2))[:, 0]

    assert least(want.g_crit * 0.998).min() > 0 > least(want.g_crit * 1.002).min()
    lowest = 2 * np.pi / k[least(want.g_crit).argmin()]
    assert lowest == pytest.approx(want.wavelength / 1e-3, rel=0.03)


def test_first_folds_of_a_stiff_layer_follow_the_power_laws_of_its_rate():
    found = []
    for rate, last in ((1e4, 0.04), (1e5, 0.016)):
        growth, wavelengths = np.linspace(1 + last / 2000, 1 + last, 2000), np.geomspace(10, 100, 150)
        height = np.abs(heights(4.0, rate, 2 * np.pi / wavelengths, growth))
        at = np.array([reached(growth, one, AMPLIFIED) for one in height.T])
        found.append((np.nanmin(at) - 1, wavelengths[np.nanargmin(at)]))
    growth, wavelength = np.log10(np.divide(*found[::-1]))
    assert growth == pytest.approx(-2 / 5, abs=0.01)
    assert wavelength == pytest.approx(1 / 5, abs=0.01)


def test_half_a_wave_of_bricks_folds_as_theory_says(monkeypatch):
    monkeypatch.setattr(stress_growth_study, "DEPTH", 9.0)
    half, goal = 3.7, AMPLIFIED * HEIGHT
    growth, found = spectra(1.0, 30.0, half, np.array([HEIGHT]), 3, half / 10, goal)
    theory = np.arange(1.001, 1.25, 5e-4)
    exact = reached(theory, np.abs(heights(1.0, 30.0, np.array([np.pi / half]), theory)[:, 0]), AMPLIFIED)
    elastic = reached(theory, np.abs(heights(1.0, 0.0, np.array([np.pi / half]), theory)[:, 0]), AMPLIFIED)
    assert reached(growth, np.abs(found[:, 0]), goal) == pytest.approx(exact, rel=0.015)
    assert np.isnan(elastic)  # an elastic core has no folds so soon
