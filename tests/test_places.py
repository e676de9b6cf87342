"""Values carried between meshes of one sphere, and rotations of it."""

import numpy as np
from scipy.spatial import cKDTree

from morphofold.shapes import icosphere
from morphofold.spheres.resampling import places
from morphofold.spheres.spins import NearestTable, rotations


def test_a_value_beside_a_missing_one_is_that_of_the_nearest_vertex(rng):
    points, faces = icosphere(2)
    to = rng.standard_normal((200, 3))
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    carried, values = places(points, faces, to), np.arange(len(points), dtype=float)
    values[7] = np.nan
    near_missing = (carried.corners == 7).any(axis=1)
    assert near_missing.any()
    np.testing.assert_array_equal(carried.values(values)[near_missing], values[carried.nearest[near_missing]])
    assert np.isfinite(carried.values(values)[~near_missing]).all()


def test_the_table_of_nearest_vertices_is_off_by_less_than_a_cell(rng):
    points, _ = icosphere(4)
    to = rng.standard_normal((5000, 3))
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    table = NearestTable(points)
    near = table(to)
    least = cKDTree(points).query(to)[0]
    diagonal = np.sqrt(2) * (np.pi / 2) / table.arrays[1]
    assert (np.linalg.norm(points[near] - to, axis=1) <= least + diagonal).all()
    assert (np.linalg.norm(points[near] - to, axis=1) <= least + 1e-12).mean() > 0.7


def test_rotations_are_uniform_and_the_same_for_a_seed():
    turns = rotations(4000, 3)
    np.testing.assert_allclose(turns @ turns.swapaxes(1, 2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    assert np.abs(turns.mean(axis=0)).max() < 5 / np.sqrt(3 * 4000)  # each entry has variance 1/3
    np.testing.assert_array_equal(turns[:10], rotations(10, 3))
