"""Points of triangles, and places along a Morton curve."""

import numpy as np
import pytest
import trimesh

from morphofold.geometry import closest_in_triangle, distance_from_triangle, morton_codes, nearest_weights


def test_weights_name_the_nearest_point_of_the_triangle(rng):
    grid = np.array([(i, j, 40 - i - j) for i in range(41) for j in range(41 - i)]) / 40
    for _ in range(50):
        a, b, c = rng.standard_normal((3, 3))
        p = 2 * rng.standard_normal(3)
        w = np.array(nearest_weights(p, a, b, c))
        assert w.min() >= 0
        assert w.sum() == pytest.approx(1)
        best = np.linalg.norm(grid @ [a, b, c] - p, axis=1).min()
        assert np.linalg.norm(w @ [a, b, c] - p) <= best + 1e-12


def test_the_nearest_point_of_a_triangle_is_that_of_trimesh(rng):
    triangles = rng.normal(size=(500, 3, 3))
    triangles[:20, 2] = triangles[:20, 1]  # an edge
    triangles[20:40, 2] = triangles[20:40, :2].mean(axis=1)  # a sliver
    points = 2 * rng.normal(size=(500, 3))
    expected = np.linalg.norm(trimesh.triangles.closest_point(triangles, points) - points, axis=1)
    along = np.linspace(0, 1, 2001)[:, None]
    for k, (corner, p) in enumerate(zip(triangles, points)):
        s, t = closest_in_triangle(p, *corner)
        distance = np.linalg.norm((1 - s - t) * corner[0] + s * corner[1] + t * corner[2] - p)
        if k < 20:  # not a question for trimesh
            expected[k] = np.linalg.norm(corner[0] + along * (corner[1] - corner[0]) - p, axis=1).min()
        assert distance_from_triangle(p, *corner) == pytest.approx(distance, abs=1e-9)
        assert distance == pytest.approx(expected[k], abs=1e-3 if k < 20 else 1e-6)


def test_a_morton_curve_goes_through_the_eight_parts_of_each_cube_in_turn():
    corner = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    code = morton_codes((corner + 0.5) / 4, bits=2)
    assert sorted(code.tolist()) == list(range(64))
    for part in range(8):
        inside = corner[np.isin(code, np.arange(8 * part, 8 * part + 8))]
        assert np.ptp(inside, axis=0).tolist() == [1, 1, 1]
    assert morton_codes(np.array([[0.0, 0, 0], [1.0, 1, 1]])).tolist() == [0, 2**60 - 1]
