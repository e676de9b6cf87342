import math

import numpy as np
import pytest
import reference

from morphofold import analysis
from morphofold.analysis.gyrification import power_spectrum
from morphofold.errors import DoesNotApply, NotFinite, OutOfRange, WrongShape
from morphofold.shapes import icosphere


@pytest.fixture(scope="module")
def sphere():
    return icosphere(5, radius=50.0)


def harmonic(verts, l, m):
    """Real harmonic of degree l and order m >= 0, mean square 1 over the sphere."""
    return reference.harmonic(verts / np.linalg.norm(verts, axis=1)[:, None], l, m).real * math.sqrt(
        4 * math.pi * (1 if m == 0 else 2)
    )


@pytest.mark.parametrize(("l", "m"), [(1, 1), (6, 0), (17, 5), (25, 25)])
def test_one_harmonic_has_its_power_in_its_degree_alone(sphere, l, m):
    verts, faces = sphere
    found = analysis.power_spectrum(verts, faces, 51 + 3 * harmonic(verts, l, m))
    assert found.power[l] == pytest.approx(9, rel=5e-3)
    assert np.delete(found.power, l).max() < 9e-4
    assert found.rms == pytest.approx(3, rel=3e-3)
    assert found.share == pytest.approx(1, abs=1e-3)
    assert found.degree == pytest.approx(l, abs=0.05)
    assert found.wavelength == pytest.approx(2 * math.pi * 50 / math.sqrt(l * (l + 1)), rel=5e-3)


def test_the_degree_of_two_harmonics_is_weighed_by_their_power(sphere):
    verts, faces = sphere
    both = 2 * harmonic(verts, 12, 3) + harmonic(verts, 20, 7)
    assert analysis.power_spectrum(verts, faces, both).degree == pytest.approx((4 * 12 + 20) / 5, abs=0.02)


def test_power_converges_at_second_order():
    errors = []
    for level in (3, 4, 5):
        verts, faces = icosphere(level)
        errors.append(abs(analysis.power_spectrum(verts, faces, harmonic(verts, 8, 2), 16).power[8] - 1))
    assert np.diff(np.log2(errors)) == pytest.approx([-2, -2], abs=0.2)


def test_turning_the_sphere_does_not_change_the_power(sphere, rng):
    verts, faces = sphere
    height = harmonic(verts, 9, 4) + 0.5 * harmonic(verts, 14, 0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    one, other = (analysis.power_spectrum(v, faces, height, 20).power for v in (verts, verts @ turn.T))
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_the_kernel_projects_on_harmonics(rng):
    verts, _ = icosphere(2)
    f = rng.standard_normal(len(verts))
    wanted = [
        sum((1 if m == 0 else 2) * abs(f @ np.conj(reference.harmonic(verts, l, m))) ** 2 for m in range(l + 1))
        for l in range(41)
    ]
    np.testing.assert_allclose(power_spectrum._power_by_degree(verts, f, 40), wanted, rtol=1e-9)


def test_high_degrees_lose_no_digits():
    """One vertex near the equator, weight 1: by the addition theorem sum_m |Y_lm|^2 = (2 l + 1) / 4 pi."""
    for direction in ([[0.6, 0.0, 0.8]], [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]):
        power = power_spectrum._power_by_degree(np.array(direction), np.ones(1), power_spectrum.LARGEST_DEGREE)
        np.testing.assert_allclose(power * 4 * np.pi, 2 * np.arange(power_spectrum.LARGEST_DEGREE + 1) + 1, rtol=1e-9)


def test_the_largest_degree_has_waves_of_four_edges(sphere):
    verts, faces = sphere
    last = len(analysis.power_spectrum(verts, faces, verts[:, 2]).power) - 1
    edge = np.linalg.norm(verts[faces[:, 0]] - verts[faces[:, 1]], axis=1).mean()
    assert 2 * math.pi * 50 / last == pytest.approx(4 * edge, rel=0.05)


def test_the_share_tells_of_waves_beyond_the_last_degree(sphere):
    verts, faces = sphere
    height = harmonic(verts, 10, 2) + harmonic(verts, 30, 11)
    assert analysis.power_spectrum(verts, faces, height, 20).share == pytest.approx(0.5, abs=0.01)


def test_a_constant_has_no_wavelength(sphere):
    verts, faces = sphere
    found = analysis.power_spectrum(verts, faces, np.full(len(verts), 2.5))
    assert found.rms == 0
    assert math.isnan(found.degree)
    assert math.isnan(found.wavelength)
    assert math.isnan(found.share)


def test_what_is_no_sphere_around_the_origin_is_refused(sphere):
    verts, faces = sphere
    for wrong, whole, turned in (
        (verts + [60, 0, 0], faces, r"[1-9]\d*"),
        (verts, faces[:, ::-1], "20480"),
        (verts, faces[1:], "0"),
    ):
        with pytest.raises(DoesNotApply, match=rf" {turned} of {len(whole)}\b"):
            analysis.power_spectrum(wrong, whole, verts[:, 0])


def test_values_and_degrees_that_make_no_sense_are_refused(sphere):
    verts, faces = sphere
    with pytest.raises(NotFinite, match=r"\b10242\b.*\(10242,\)"):
        analysis.power_spectrum(verts, faces, np.where(np.arange(len(verts)) == 7, np.nan, 1.0))
    with pytest.raises(WrongShape, match=r"\b10242\b.*\(3,\)"):
        analysis.power_spectrum(verts, faces, np.ones(3))
    for last in (0, 1001):
        with pytest.raises(OutOfRange, match=rf"\b1 to 1000\b.*\b{last}\b"):
            analysis.power_spectrum(verts, faces, verts[:, 0], last)
