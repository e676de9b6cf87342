"""Smoothing, height and windows behind gyral thickness."""

from importlib.resources import files

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import spsolve

from morphofold import geometry
from morphofold.analysis.relief import (
    COTANGENT_BOUNDS,
    EDGE_PATH_DETOUR,
    WINDOW_TOLERANCE,
    implicit_smoothing,
    relief,
    windowed_range,
)
from morphofold.geometry import edge_graph, mean_edge_length
from morphofold.io import read_cortex
from morphofold.shapes import icosphere, irregular_sphere


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


def test_smoothing_does_not_know_where_the_surface_lies():
    verts, faces = icosphere(3, radius=50.0)
    far = np.array([1e4, 0, 0])
    np.testing.assert_allclose(
        implicit_smoothing(verts + far, faces, 10.0) - far, implicit_smoothing(verts, faces, 10.0), atol=1e-6
    )


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


def test_windows_on_fine_meshes_hold_their_radius_to_their_tolerance(rng):
    verts, faces = irregular_sphere(5, radius=50.0, rng=rng)
    values = np.sin(verts @ [0.2, 0.1, 0.15]) + verts @ [0.002, 0.004, 0.006]  # many maxima, near the edges of windows
    radius = 1.01 * mean_edge_length(verts, faces) / WINDOW_TOLERANCE / EDGE_PATH_DETOUR
    low, high = (found[::20] for found in windowed_range(verts, faces, values, radius))
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
