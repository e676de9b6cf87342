import math

import numpy as np
import pytest
import reference

from morphofold.analysis import power_spectrum
from morphofold.analysis.gyrification.power_spectrum import LARGEST_DEGREE
from morphofold.errors import DoesNotApply, NotFinite, OutOfRange, WrongShape
from morphofold.shapes import icosphere
from morphofold.unfolding.harmonics import degrees, harmonics

VERTS, FACES = icosphere(5, radius=50.0)


def harmonic(l, m, verts=VERTS):
    """Real harmonic of degree l and order m >= 0, mean square 1 over the sphere."""
    norm = math.sqrt(4 * math.pi * (1 if m == 0 else 2))
    return reference.harmonic(verts / np.linalg.norm(verts, axis=1)[:, None], l, m).real * norm


@pytest.mark.parametrize(("l", "m"), [(1, 1), (6, 0), (25, 25)])
def test_one_harmonic_has_its_power_in_its_degree_alone(l, m):
    spectrum = power_spectrum(VERTS, FACES, 51 + 3 * harmonic(l, m))
    assert spectrum.power[l] == pytest.approx(9, rel=5e-3)
    assert np.delete(spectrum.power, l).max() < 9e-4
    assert spectrum.rms == pytest.approx(3, rel=3e-3)
    assert spectrum.share == pytest.approx(1, abs=1e-3)
    assert spectrum.degree == pytest.approx(l, abs=0.05)
    assert spectrum.wavelength == pytest.approx(2 * math.pi * 50 / math.sqrt(l * (l + 1)), rel=5e-3)


def test_the_degree_of_two_harmonics_is_weighed_by_their_power_and_the_share_tells_of_one_beyond_the_last():
    both = 2 * harmonic(12, 3) + harmonic(20, 7)
    assert power_spectrum(VERTS, FACES, both).degree == pytest.approx((4 * 12 + 20) / 5, abs=0.02)
    assert power_spectrum(VERTS, FACES, both, 15).share == pytest.approx(4 / 5, abs=0.01)


def test_power_converges_at_second_order():
    spheres = [icosphere(level) for level in (3, 4, 5)]
    errors = [abs(power_spectrum(v, f, harmonic(8, 2, v), 16).power[8] - 1) for v, f in spheres]
    assert np.diff(np.log2(errors)) == pytest.approx([-2, -2], abs=0.2)


def test_turning_the_sphere_does_not_change_the_power(rng):
    height = harmonic(9, 4) + 0.5 * harmonic(14, 0)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    before, after = (power_spectrum(v, FACES, height, 20).power for v in (VERTS, VERTS @ turn.T))
    np.testing.assert_allclose(before, after, atol=1e-6)


@pytest.mark.parametrize("direction", [[0.6, 0.0, 0.8], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
def test_harmonics_of_high_degrees_lose_no_digits(direction):
    """By the addition theorem the squares of degree l sum to (2 l + 1) / 4 pi."""
    squares = harmonics(np.array([direction]), LARGEST_DEGREE)[0] ** 2
    l = np.arange(LARGEST_DEGREE + 1)
    np.testing.assert_allclose(np.bincount(degrees(LARGEST_DEGREE), squares) * 4 * np.pi, 2 * l + 1, rtol=1e-9)


def test_the_largest_degree_has_waves_of_four_edges():
    last = len(power_spectrum(VERTS, FACES, VERTS[:, 2]).power) - 1
    edge = np.linalg.norm(VERTS[FACES[:, 0]] - VERTS[FACES[:, 1]], axis=1).mean()
    assert 2 * math.pi * 50 / last == pytest.approx(4 * edge, rel=0.05)


def test_a_constant_has_no_wavelength():
    spectrum = power_spectrum(VERTS, FACES, np.full(len(VERTS), 2.5))
    assert spectrum.rms == 0
    assert np.isnan([spectrum.degree, spectrum.wavelength, spectrum.share]).all()


@pytest.mark.parametrize(
    ("verts", "faces", "turned"),
    [(VERTS + [60, 0, 0], FACES, r"[1-9]\d*"), (VERTS, FACES[:, ::-1], "20480"), (VERTS, FACES[1:], "0")],
)
def test_what_is_no_sphere_around_the_origin_is_refused(verts, faces, turned):
    with pytest.raises(DoesNotApply, match=rf" {turned} of {len(faces)}\b"):
        power_spectrum(verts, faces, VERTS[:, 0])


def test_values_and_degrees_that_make_no_sense_are_refused():
    for values, error in (np.full(len(VERTS), np.nan), NotFinite), (np.ones(3), WrongShape):
        with pytest.raises(error, match=r"\b10242\b"):
            power_spectrum(VERTS, FACES, values)
    for last in (0, 1001):
        with pytest.raises(OutOfRange, match=rf"\b1 to 1000\b.*\b{last}\b"):
            power_spectrum(VERTS, FACES, VERTS[:, 0], last)
