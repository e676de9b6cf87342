"""Depth potential, its scales, and the width of gyri."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from morphofold.analysis.graph.depth_potential import SurfaceOperators, wavelength
from morphofold.errors import OutOfRange
from morphofold.geometry import vertex_areas
from morphofold.shapes import icosphere
from morphofold.shapes.ridges import ridged_net
from morphofold.studies.shapes import bumpy_sphere, regular_net, sphere


def bumpy(amplitude, degree=6, radius=50.0, level=5):
    """A sphere with a zonal wave of one degree, and the wave (N,) [mm]."""
    verts, faces = icosphere(level)
    wave = amplitude * np.polynomial.legendre.legval(verts[:, 2], [0] * degree + [1])
    return verts * (radius + wave)[:, None], faces, wave


def test_altitude_of_a_small_wave_is_what_the_equation_says():
    """To first order H = 1/R + (l - 1)(l + 2) / (2 R^2) h, and the Laplacian is l (l + 1) / R^2."""
    radius, degree, reach = 50.0, 6, 20.0
    verts, faces, wave = bumpy(0.5, degree, radius)
    operators = SurfaceOperators(verts, faces)
    D = operators.depth_potential(reach, 1e-9)  # smoothed over one edge
    share = (degree - 1) * (degree + 2) / (degree * (degree + 1) + (radius / reach) ** 2)
    share *= (1 + degree * (degree + 1) / radius**2 * operators.edge**2 / 6) ** -3
    assert np.corrcoef(D, wave)[0, 1] > 0.999
    assert np.polyfit(wave, D, 1)[0] == pytest.approx(share, rel=0.01)
    assert abs(np.average(D, weights=vertex_areas(verts, faces))) < 1e-4


def test_a_sphere_has_no_altitude_and_noise_comes_in_as_so_many_mm(rng):
    ball = sphere(5, rng=1)
    assert np.abs(SurfaceOperators(ball.verts, ball.faces).depth_potential(15.0, 3.0)).max() < 0.02
    operators = SurfaceOperators(ball.verts, ball.faces)
    noisy = ball.verts + 0.1 * operators.edge * rng.standard_normal(ball.verts.shape)
    D = SurfaceOperators(noisy, ball.faces).depth_potential(15.0, 2 * operators.edge)
    assert D.std() < 0.1 * operators.edge


def test_altitude_turns_with_the_surface_and_scales_with_it():
    verts, faces, _ = bumpy(2.0)
    D = SurfaceOperators(verts, faces).depth_potential(10.0, 3.0)
    turned = verts @ Rotation.random(random_state=1).as_matrix().T + [10.0, -20.0, 30.0]
    np.testing.assert_allclose(SurfaceOperators(turned, faces).depth_potential(10.0, 3.0), D, atol=1e-4)
    np.testing.assert_allclose(SurfaceOperators(1e3 * verts, faces).depth_potential(1e4, 3e3), 1e3 * D, atol=0.1)


def test_smoothing_damps_waves_as_heat_does():
    """By exp(-l (l + 1) s^2 / 2 R^2), in three implicit steps."""
    radius, degree, scale = 50.0, 6, 5.0
    verts, faces = icosphere(5, radius)
    wave = np.polynomial.legendre.legval(verts[:, 2] / radius, [0] * degree + [1])
    rate = degree * (degree + 1) / radius**2
    found = np.polyfit(wave, SurfaceOperators(verts, faces).smooth(wave, scale), 1)[0]
    assert found == pytest.approx((1 + rate * scale**2 / 6) ** -3, rel=0.005)
    assert found == pytest.approx(np.exp(-rate * scale**2 / 2), rel=0.02)


@pytest.mark.parametrize("width", [8.0, *(pytest.param(w, marks=pytest.mark.slow) for w in (6.0, 12.0))])
def test_the_width_is_that_between_inflections(width):
    """Where the mean curvature of a Gaussian ridge on a sphere, smoothed, is 0: along it 1/R, across it 1/R and h''."""
    surface = ridged_net(regular_net("octahedron"), 6, width)
    operators = SurfaceOperators(surface.verts, surface.faces)
    own, smooth = width / (8 * np.log(2)) ** 0.5, 0.007 * operators.area**0.5
    spread = np.hypot(own, smooth)
    top = 4.0 * own / spread
    bend = lambda s: top / spread**2 * (1 - (s / spread) ** 2) * np.exp(-0.5 * (s / spread) ** 2)
    turn = brentq(lambda s: bend(s) + 2 / 52, 0.1, 1.7 * spread)
    assert operators.gyral_width() == pytest.approx(2 * turn * 52 / 50, rel=0.1)


@pytest.mark.slow
def test_the_width_depends_on_the_mesh_by_little_and_on_noise_by_a_quarter():
    net = regular_net("octahedron")
    width = {}
    for level, noise in ((5, 0.0), (6, 0.0), (6, 0.1)):
        surface = ridged_net(net, level, 8.0, noise=noise, rng=3)
        width[level, noise] = SurfaceOperators(surface.verts, surface.faces).gyral_width()
    assert width[5, 0.0] == pytest.approx(width[6, 0.0], rel=0.1)
    assert width[6, 0.1] == pytest.approx(width[6, 0.0], rel=0.25)


@pytest.mark.parametrize("level", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_the_wavelength_of_a_harmonic_is_that_of_its_degree(level):
    """Low waves of degree 6; the error of the mesh is of second order."""
    shape = bumpy_sphere(level, amplitude=0.005, rng=1)
    exact = 2 * np.pi * 50 / 42**0.5
    assert wavelength(shape.verts, shape.faces, width=24.0) == pytest.approx(exact, rel=0.004)


def test_the_wavelength_of_a_surface_without_folds_is_none_and_a_width_is_checked():
    shape = bumpy_sphere(4, amplitude=0.02)
    assert np.isnan(wavelength(shape.verts, shape.faces))
    with pytest.raises(OutOfRange, match=r"\bwidth\b.* -1\.0\b"):
        wavelength(shape.verts, shape.faces, width=-1.0)
