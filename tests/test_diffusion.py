"""Implicit diffusion on a surface, and what stands on it: smoothing, relief, depth potential and the width of gyri."""

from importlib.resources import files

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse import csgraph
from scipy.sparse.linalg import spsolve
from scipy.spatial import KDTree

from morphofold import geometry
from morphofold.analysis import smooth, smoothing
from morphofold.analysis.diffusion import Diffusion
from morphofold.analysis.graph.depth_potential import SurfaceOperators, wavelength
from morphofold.analysis.relief import (
    COTANGENT_BOUNDS,
    EDGE_PATH_DETOUR,
    WINDOW_TOLERANCE,
    implicit_smoothing,
    relief,
    windowed_range,
)
from morphofold.analysis.smoothing import FWHM_PER_DEVIATION
from morphofold.errors import OutOfRange, WrongShape
from morphofold.geometry import cotangent_laplacian, edge_graph, mean_edge_length, vertex_areas
from morphofold.io import read_cortex
from morphofold.shapes import icosphere
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.studies.known_shapes import bumpy_sphere, regular_net, sphere
from morphofold.studies.ridged_nets import ridged_net

CLIP = (-5.0, 20.0)


def on(verts, faces):
    return Diffusion(vertex_areas(verts, faces), cotangent_laplacian(verts, faces, clip=CLIP))


@pytest.fixture
def solver():
    return on(*irregular_sphere(4, rng=2))


@pytest.mark.parametrize("time", [0.0, 0.03, 1e3])
@pytest.mark.parametrize("columns", [1, 3])
def test_the_solution_is_that_of_a_direct_solver(solver, time, columns, rng):
    n = len(solver.mass)
    right, start = (rng.standard_normal((n, columns)).squeeze() for _ in range(2))
    right *= solver.mass if columns == 1 else solver.mass[:, None]
    start_before = start.copy()
    matrix = (time * solver.stiffness + sparse.diags_array(solver.mass)).tocsc()
    solution = solver.solve(time, right, start, 1e-13)
    np.testing.assert_allclose(solution, spsolve(matrix, right), atol=1e-9 * np.abs(solution).max())
    np.testing.assert_array_equal(start, start_before)
    rough = solver.solve(time, right, start, 1e-2)
    off = np.linalg.norm(matrix @ rough - right, axis=0) / np.linalg.norm(right, axis=0)
    assert (off <= 1e-2).all()


def test_a_harmonic_of_a_sphere_falls_by_its_eigenvalue():
    verts, faces = icosphere(6, radius=3.0)
    solver, wave = on(verts, faces), verts[:, 0] * verts[:, 1]  # degree 2: L = 6 / r^2
    solution = solver.solve(2.0, solver.mass * wave, wave, 1e-12)
    np.testing.assert_allclose(solution, wave / (1 + 2.0 * 6 / 9), atol=5e-3 * np.abs(wave).max())


@pytest.mark.slow
def test_the_number_of_iterations_hardly_grows_with_the_mesh(monkeypatch):
    counts = []
    for level in (4, 5, 6):  # 2,562 to 40,962 vertices; the time is 9 to 150 squared edges
        verts, faces = irregular_sphere(level, radius=50.0, rng=2)
        solver, most = on(verts, faces), 1
        while True:
            monkeypatch.setattr("morphofold.analysis.diffusion.MOST_ITERATIONS", most)
            try:
                solver.solve(225.0, solver.mass * verts[:, 0], 0 * verts[:, 0], 1e-6)
                break
            except RuntimeError:
                most += 1
        counts.append(most)
    assert max(counts) <= 20  # without multigrid it doubles with each level
    assert counts[2] <= counts[1] + 3


def test_a_vertex_without_triangles_keeps_its_start_and_pieces_do_not_mix(rng):
    verts, faces = icosphere(2)
    n = len(verts)
    both = np.concatenate([verts, [[9.0, 9.0, 9.0]], verts + 5.0])
    solver = on(both, np.concatenate([faces, faces + n + 1]))
    start = rng.standard_normal(2 * n + 1)
    solution = solver.solve(10.0, solver.mass * np.r_[np.ones(n), 7.0, np.full(n, 2.0)], start, 1e-12)
    np.testing.assert_allclose(solution, np.r_[np.ones(n), start[n], np.full(n, 2.0)], atol=1e-9)


def test_what_does_not_converge_is_refused(solver):
    right = np.full(len(solver.mass), np.nan)
    with pytest.raises(RuntimeError, match=r"\b300\b.*\b2562\b"):
        solver.solve(1.0, right, np.zeros(len(right)), 1e-6)


RADIUS = 100.0


def point_spread(level, fwhm):
    """Distance from a point (N,) and what smoothing makes of a 1 there, with its share of the area around it."""
    verts, faces = icosphere(level, radius=RADIUS)
    pulse = np.zeros(len(verts))
    pulse[0] = 1.0
    away = RADIUS * np.arccos(np.clip(verts @ verts[0] / RADIUS**2, -1, 1))
    return away, smooth(verts, faces, pulse, fwhm), vertex_areas(verts, faces)


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


def test_a_smoothed_sphere_shrinks_by_the_factor_of_the_heat_equation():
    verts, faces = icosphere(4, radius=50.0)
    smooth = implicit_smoothing(verts, faces, 10.0, rounds=2, rtol=1e-10)
    factor = 1 / (1 + 2 * (10 / 50) ** 2)  # the coordinates are harmonics of degree 1, eigenvalue 2 / r^2
    np.testing.assert_allclose(smooth, factor**2 * verts, atol=5e-3 * 50)


def test_smoothing_solves_its_equation_on_an_irregular_noisy_mesh(rng):
    verts, faces = irregular_sphere(3, radius=50.0, rng=rng)
    verts = verts + rng.normal(0, 0.5, verts.shape)
    mass = sparse.diags_array(geometry.vertex_areas(verts, faces))
    matrix = (mass + 7.0**2 * geometry.cotangent_laplacian(verts, faces, clip=COTANGENT_BOUNDS)).tocsc()
    expected = spsolve(matrix, mass @ verts)
    np.testing.assert_allclose(implicit_smoothing(verts, faces, 7.0, rounds=1, rtol=1e-11), expected, atol=1e-6)
    loose = implicit_smoothing(verts, faces, 7.0, rounds=1)
    assert 1e-9 < np.abs(loose - expected).max() < 0.05  # the default tolerance, on a displacement of millimetres


def ranges_within(verts, faces, values, radius, step=1):
    """Of every ``step``-th vertex."""
    distance = csgraph.dijkstra(edge_graph(verts, faces), indices=np.arange(0, len(verts), step))
    near = distance <= radius * EDGE_PATH_DETOUR
    return np.where(near, values, np.inf).min(axis=1), np.where(near, values, -np.inf).max(axis=1)


def test_windows_hold_the_least_and_the_largest_within_their_distance(rng):
    verts, faces = irregular_sphere(3, radius=50.0, rng=rng)
    values = rng.normal(size=len(verts))
    values[:40] = values[40]  # ties
    low, high = windowed_range(verts, faces, values, 13.0)
    least, most = ranges_within(verts, faces, values, 13.0)
    np.testing.assert_array_equal(high, most)
    np.testing.assert_array_equal(low, least)


@pytest.mark.slow
def test_windows_on_fine_meshes_hold_their_radius_to_their_tolerance(rng):
    verts, faces = irregular_sphere(5, radius=50.0, rng=rng)
    values = np.sin(verts @ [0.2, 0.1, 0.15]) + verts @ [0.002, 0.004, 0.006]  # many maxima, near the edges of windows
    radius = 1.01 * mean_edge_length(verts, faces) / WINDOW_TOLERANCE / EDGE_PATH_DETOUR
    low, high = (values_of_window[::20] for values_of_window in windowed_range(verts, faces, values, radius))
    least, most = ranges_within(verts, faces, values, (1 + 0.5 * WINDOW_TOLERANCE) * radius * (1 + 1e-12), step=20)
    assert np.all((high <= most) & (low >= least))
    assert np.any((high < most) | (low > least))  # else later sources went on where they were hardly nearer
    least, most = ranges_within(verts, faces, values, (1 - WINDOW_TOLERANCE) * radius, step=20)
    assert np.mean((high >= most) & (low <= least)) > 0.98


def test_edge_paths_are_longer_than_the_straight_way_by_the_factor_that_windows_use():
    verts, faces = icosphere(5)
    path = csgraph.dijkstra(edge_graph(verts, faces), indices=[100, 2000, 7000])
    straight = np.arccos(np.clip(verts[[100, 2000, 7000]] @ verts.T, -1, 1))
    near = (straight > 0.2) & (straight < 0.5)
    assert (path[near] / straight[near]).mean() == pytest.approx(EDGE_PATH_DETOUR, abs=0.02)


def test_height_follows_freesurfers_sulc():
    cortex = read_cortex(files("morphofold.data_samples") / "fsaverage5", hemi="lh")
    height = relief(cortex.pial.verts, cortex.faces, 10.0).height
    assert np.corrcoef(height, cortex.maps["sulc"])[0, 1] < -0.97


def test_a_scale_that_is_no_length_is_refused():
    with pytest.raises(ValueError, match=r"^scale .* 0\.0\.$"):
        implicit_smoothing(*icosphere(1), 0.0)


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
    D = operators.depth_potential(reach, 1e-9)
    gain = (degree - 1) * (degree + 2) / (degree * (degree + 1) + (radius / reach) ** 2)
    assert np.corrcoef(D, wave)[0, 1] > 0.999
    assert np.polyfit(wave, D, 1)[0] == pytest.approx(gain, rel=0.01)
    assert abs(np.average(D, weights=vertex_areas(verts, faces))) < 1e-4


def test_a_sphere_has_no_altitude_and_noise_comes_in_as_so_many_mm(rng):
    ball = sphere(5, rng=1)
    assert np.abs(SurfaceOperators(ball.verts, ball.faces).depth_potential(15.0, 3.0)).max() < 0.02
    operators = SurfaceOperators(ball.verts, ball.faces)
    noisy = ball.verts + 0.1 * operators.mean_edge * rng.standard_normal(ball.verts.shape)
    D = SurfaceOperators(noisy, ball.faces).depth_potential(15.0, 2 * operators.mean_edge)
    assert D.std() < 0.1 * operators.mean_edge


def test_smoothing_damps_waves_as_heat_does():
    """By exp(-l (l + 1) s^2 / 2 R^2), in three implicit steps."""
    radius, degree, scale = 50.0, 6, 5.0
    verts, faces = icosphere(5, radius)
    wave = np.polynomial.legendre.legval(verts[:, 2] / radius, [0] * degree + [1])
    rate = degree * (degree + 1) / radius**2
    factor = np.polyfit(wave, SurfaceOperators(verts, faces).smooth(wave, scale), 1)[0]
    assert factor == pytest.approx((1 + rate * scale**2 / 6) ** -3, rel=0.005)
    assert factor == pytest.approx(np.exp(-rate * scale**2 / 2), rel=0.02)


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
