"""The wavelength of least energy of a strip."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from morphofold.studies import spacing
from morphofold.threads import using_threads

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(spacing, "LAYERS", 4)
    monkeypatch.setattr(spacing, "DEPTH", 6.0)
    with using_threads(1):
        yield


def flat_energy(g, ratio):
    """Energy for each area of a flat layer under tangential growth, and its thickness.

    It is held at its sides, so one stretch l is free, along its thickness: A = diag(1/g, 1/g, l).
    """

    def energy(l):  # of the grown volume g^2
        J = l / g**2
        return g**2 * ratio * (0.5 * (J ** (-2 / 3) * (2 / g**2 + l**2) - 3) + 25.0 * (J - 1) ** 2)

    found = minimize_scalar(energy, bounds=(1.0, 5.0), method="bounded", options={"xatol": 1e-10})
    return found.fun, found.x


def test_before_folds_the_energy_is_that_of_a_flat_layer(coarse, monkeypatch):
    monkeypatch.setattr(spacing, "GROWTHS", (1.1,))
    monkeypatch.setattr(spacing, "COSINE", 0.0)
    state = spacing.grow("tangential", 2.0, 3.0)[1.1]
    energy, thickness = flat_energy(1.1, 2.0)
    assert state.energy == pytest.approx(energy, rel=1e-3)
    assert state.height == pytest.approx(0.0, abs=1e-6)
    assert state.crown == pytest.approx(thickness, rel=1e-4)
    assert state.fundus == pytest.approx(thickness, rel=1e-4)


def test_a_fold_has_less_energy_than_the_flat_strip_and_a_thicker_crown(coarse, monkeypatch):
    monkeypatch.setattr(spacing, "GROWTHS", (1.5,))
    state = spacing.grow("tangential", 2.0, 3.0)[1.5]
    assert state.height > 2
    assert state.energy < 0.9 * flat_energy(1.5, 2.0)[0]
    assert state.crown > 1.1 * state.fundus
    assert state.wall >= state.crown


def test_a_half_wave_that_splits_has_no_further_states(coarse, monkeypatch):
    """Under tangential growth at ratio 1 one of 4.5 T splits after g = 1.4, and one of 2.5 T does not."""
    monkeypatch.setattr(spacing, "GROWTHS", (1.4, 1.6))
    assert list(spacing.grow("tangential", 1.0, 4.5)) == [1.4]
    assert list(spacing.grow("tangential", 1.0, 2.5)) == [1.4, 1.6]


def test_the_best_wave_is_the_bottom_of_the_parabola():
    energies = 3 + (spacing.HALF_WAVES - 4.2) ** 2
    k, half = spacing.best_wave(energies)
    assert spacing.HALF_WAVES[k] == 4.0
    assert half == pytest.approx(4.2)


def test_a_best_wave_at_an_end_is_not_known():
    assert np.isnan(spacing.best_wave(spacing.HALF_WAVES)[1])
    energies = np.where(spacing.HALF_WAVES == 3.5, np.nan, (spacing.HALF_WAVES - 4.2) ** 2)
    assert np.isnan(spacing.best_wave(energies)[1])
