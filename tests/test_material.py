import numpy as np
import pytest

from morphofold.sim.material import brick_energy, brick_stress, cofactor, energy, stress

MU, KAPPA = 1.7, 40.0


def near_identity(rng, *shape):
    return np.eye(3) + 0.2 * rng.standard_normal((*shape, 3, 3))


def taylor_order(W, slope, h):
    """Order at which the energy leaves its tangent."""
    rest = [np.abs(W(s) - W(0.0) - s * slope).max() for s in h]
    return np.polyfit(np.log(h), np.log(rest), 1)[0]


def test_stress_is_the_derivative_of_the_energy(rng):
    A, dA = near_identity(rng, 5), rng.standard_normal((5, 3, 3))
    slope = np.sum(stress(A, MU, KAPPA) * dA, axis=(1, 2))
    order = taylor_order(lambda s: energy(A + s * dA, MU, KAPPA), slope, 2.0 ** -np.arange(6, 13))
    assert order == pytest.approx(2.0, abs=0.05)


def test_brick_stress_is_the_derivative_of_the_brick_energy(rng):
    A, dA, w = near_identity(rng, 4, 8), rng.standard_normal((4, 8, 3, 3)), rng.uniform(0.5, 1.0, (4, 8))
    mu, kappa = np.full(4, MU), np.full(4, KAPPA)
    slope = np.einsum("eq,eqij,eqij->e", w, brick_stress(A, w, mu, kappa), dA)
    order = taylor_order(lambda s: brick_energy(A + s * dA, w, mu, kappa), slope, 2.0 ** -np.arange(7, 13))
    assert order == pytest.approx(2.0, abs=0.05)


def test_energy_does_not_see_rotations(rng):
    A = near_identity(rng, 5)
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R *= np.sign(np.linalg.det(R))
    np.testing.assert_allclose(energy(R @ A, MU, KAPPA), energy(A, MU, KAPPA), rtol=1e-12)
    np.testing.assert_allclose(stress(R @ A, MU, KAPPA), R @ stress(A, MU, KAPPA), rtol=1e-10, atol=1e-10)


def test_volume_preserving_stretch_has_the_energy_of_equation_4():
    stretch = np.array([1.3, 0.9, 1 / (1.3 * 0.9)])
    assert energy(np.diag(stretch), MU, KAPPA) == pytest.approx(MU / 2 * (np.sum(stretch**2) - 3), rel=1e-12)


def test_small_strain_moduli_are_mu_and_kappa():
    e = 1e-5
    shear = np.eye(3); shear[0, 1] = e
    assert stress(shear, MU, KAPPA)[0, 1] == pytest.approx(MU * e, rel=1e-4)
    assert stress(np.eye(3) * (1 + e), MU, KAPPA)[0, 0] == pytest.approx(3 * KAPPA * e, rel=1e-3)


def test_a_crushed_element_still_gives_finite_forces():
    A = np.diag([1.0, 1.0, 0.0])
    assert np.isfinite(energy(A, MU, KAPPA))
    assert np.isfinite(stress(A, MU, KAPPA)).all()
    assert stress(A, MU, KAPPA)[2, 2] < 0                              # it pushes back open


def test_cofactor_is_det_times_inverse_transpose(rng):
    A = near_identity(rng, 6)
    want = np.linalg.det(A)[:, None, None] * np.linalg.inv(A).swapaxes(1, 2)
    np.testing.assert_allclose(cofactor(A), want, atol=1e-12)
