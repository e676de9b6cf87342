"""Smoothing of maps along a surface."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from morphofold.analysis import smooth, smoothing
from morphofold.analysis.smoothing import FWHM_PER_DEVIATION
from morphofold.errors import OutOfRange, WrongShape
from morphofold.geometry import mean_edge_length, vertex_areas
from morphofold.shapes import icosphere, irregular_sphere

RADIUS = 100.0


def point_spread(level, fwhm):
    """Distance from a point (N,) and what smoothing makes of a 1 there, with its share of the area around it."""
    verts, faces = icosphere(level, radius=RADIUS)
    one = np.zeros(len(verts))
    one[0] = 1.0
    away = RADIUS * np.arccos(np.clip(verts @ verts[0] / RADIUS**2, -1, 1))
    return away, smooth(verts, faces, one, fwhm), vertex_areas(verts, faces)


@pytest.mark.parametrize("fwhm", [10.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_kernel_has_its_full_width_at_half_maximum(fwhm):
    away, smoothed, _ = point_spread(6, fwhm)  # edges of 1.9 mm
    order = np.argsort(away)
    half = np.interp(-0.5, -smoothed[order] / smoothed[0], away[order])
    assert 2 * half == pytest.approx(fwhm, rel=0.015)


@pytest.mark.parametrize(("level", "fwhm"), [(5, 20.0), (6, 10.0)])
def test_the_kernel_has_its_variance_and_keeps_the_integral(level, fwhm):
    away, smoothed, areas = point_spread(level, fwhm)
    assert areas @ smoothed == pytest.approx(areas[0], rel=1e-5)
    variance = areas @ (smoothed * away**2) / (areas @ smoothed)  # of both axes together
    assert np.sqrt(variance / 2) * FWHM_PER_DEVIATION == pytest.approx(fwhm, rel=0.03)


@pytest.mark.parametrize("degree", [2, 4])
def test_harmonics_of_a_sphere_fall_as_in_the_heat_equation(degree):
    verts, faces = icosphere(5, radius=RADIUS)
    z = verts[:, 2] / RADIUS
    harmonic = {2: 3 * z**2 - 1, 4: 35 * z**4 - 30 * z**2 + 3}[degree]
    smoothed = smooth(verts, faces, harmonic, 60.0)
    factor = np.exp(-degree * (degree + 1) * (60.0 / FWHM_PER_DEVIATION / RADIUS) ** 2 / 2)
    np.testing.assert_allclose(smoothed, factor * harmonic, atol=0.003 * np.abs(harmonic).max())


def test_it_does_not_depend_on_the_mesh():
    fine, coarse = icosphere(6, radius=RADIUS), irregular_sphere(5, radius=RADIUS, rng=1)
    of = lambda verts: np.sin(verts @ [0.05, 0.02, 0.03])
    maps = [smooth(verts, faces, of(verts), 15.0) for verts, faces in (fine, coarse)]
    distance, nearest = KDTree(fine[0]).query(coarse[0])
    same = distance < 0.3
    assert same.sum() > 50
    np.testing.assert_allclose(maps[0][nearest][same], maps[1][same], atol=0.03)


def test_noise_falls_by_the_number_of_vertices_in_the_kernel(rng):
    verts, faces = icosphere(5, radius=RADIUS)
    edge = mean_edge_length(verts, faces)
    left = smooth(verts, faces, rng.standard_normal(len(verts)), 20.0).std()
    deviation = 20.0 / FWHM_PER_DEVIATION
    expected = np.sqrt(
        np.sqrt(3) / 2 * edge**2 / (4 * np.pi * deviation**2)
    )  # area of a vertex over that of the kernel
    assert left == pytest.approx(expected, rel=0.1)


def test_what_lies_outside_has_no_influence(rng):
    verts, faces = icosphere(5, radius=RADIUS)
    inside = verts[:, 2] > -50
    values = np.where(inside, 3.0, 1e6)
    smoothed = smooth(verts, faces, values, 20.0, inside)
    np.testing.assert_allclose(smoothed[inside], 3.0, rtol=1e-5)
    assert np.isnan(smoothed[~inside]).all()
    gaps = rng.random(len(verts)) < 0.1
    smoothed = smooth(verts, faces, np.where(gaps, np.nan, 3.0), 20.0)
    np.testing.assert_allclose(smoothed[~gaps], 3.0, rtol=1e-5)
    assert np.isnan(smoothed[gaps]).all()


def test_holes_are_filled_where_half_of_the_kernel_is_known():
    verts, faces = icosphere(5, radius=RADIUS)
    z = verts[:, 2]
    inside = z > -60
    hole = (z > 99.7) | (z < 0)
    smoothed = smooth(verts, faces, np.where(hole, np.nan, 2.0), 20.0, inside, fill=0.5)
    np.testing.assert_allclose(smoothed[z > 99.7], 2.0, rtol=1e-4)  # within 8 mm of the pole
    assert np.isnan(smoothed[z < -8]).all()
    assert np.isfinite(smoothed[(z < 99) & (z > 0)]).all()
    assert np.isnan(smooth(verts, faces, np.where(hole, np.nan, 2.0), 20.0, inside)[hole]).all()
    everywhere = smooth(verts, faces, np.where(hole, np.nan, 2.0), 20.0, inside, fill=0.0)
    assert np.isnan(everywhere[~inside]).all()


def test_several_maps_are_smoothed_as_each_alone(rng):
    verts, faces = icosphere(4, radius=RADIUS)
    maps = rng.standard_normal((len(verts), 3))
    maps[::7, 1] = np.nan
    both = smooth(verts, faces, maps, 20.0)
    for k in range(3):
        np.testing.assert_allclose(both[:, k], smooth(verts, faces, maps[:, k], 20.0), atol=1e-5)


def test_steps_on_an_uneven_mesh_agree_with_the_series(rng, monkeypatch):
    verts, faces = icosphere(5, radius=RADIUS)
    maps = rng.standard_normal(len(verts))
    series = smooth(verts, faces, maps, 20.0)
    monkeypatch.setattr(smoothing, "MOST_TERMS", 0)
    steps = smooth(verts, faces, maps, 20.0)
    assert 0 < np.abs(steps - series).max() < 0.005 * np.abs(series).max()


def test_bad_options_are_refused():
    verts, faces = icosphere(2)
    for fwhm in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(OutOfRange):
            smooth(verts, faces, np.zeros(len(verts)), fwhm)
    with pytest.raises(WrongShape):
        smooth(verts, faces, np.zeros(5), 1.0)
