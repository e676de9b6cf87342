"""The exact signs against rational arithmetic."""

from itertools import permutations

import numpy as np
import pytest
from reference_signs import displaced, rational_sign

from morphofold.intersections.signs import plane_sign, side


def nearly_flat(rng, weight):
    """Points on a plane up to rounding: the fourth combines the other three, or is one of its neighbours."""
    a, b, c = rng.standard_normal((3, 3)) * 10.0 ** rng.integers(-3, 3)
    s, t = rng.uniform(-2, 2, 2)
    d = weight * a + s * (b - a) + t * (c - a)
    return a, b, c, d + rng.integers(-2, 3, 3) * np.spacing(d)


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_the_sign_of_points_on_a_plane_up_to_rounding_is_that_of_rational_arithmetic(rng, weight):
    wrong = 0
    for _ in range(1000):
        a, b, c, d = nearly_flat(rng, weight)
        exact = rational_sign(a, b, c, d, int(weight))
        assert plane_sign(a, b, c, d, weight) == exact
        wrong += np.sign(np.dot(d - weight * a, np.cross(b - a, c - a))) != exact
    assert wrong > 50  # plain floating point would not do


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_a_true_zero_is_told_as_zero(rng, weight):
    for _ in range(100):
        a, b, c = rng.integers(-50, 50, (3, 3)).astype(float)
        s, t = rng.integers(-3, 4, 2)
        assert plane_sign(a, b, c, weight * a + s * (b - a) + t * (c - a), weight) == 0


def test_coordinates_of_very_different_size_keep_their_sign(rng):
    for _ in range(300):
        points = rng.standard_normal((4, 3)) * 10.0 ** rng.integers(-60, 20, (4, 3))
        assert plane_sign(*points, 1.0) == rational_sign(*points)


def test_ties_are_decided_as_if_each_vertex_were_displaced_by_less_than_the_one_before(rng):
    ties = 0
    for _ in range(300):
        verts = rng.integers(0, 3, (4, 3)).astype(float)  # mostly flat, often on a line or in one place
        i, j, k, p = rng.permutation(4)
        moved = displaced(verts)
        assert side(verts, i, j, k, p) == rational_sign(moved[i], moved[j], moved[k], moved[p])
        ties += plane_sign(verts[i], verts[j], verts[k], verts[p], 1.0) == 0
    assert ties > 50


def test_the_sign_turns_with_every_exchange_of_two_vertices():
    verts = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 5, 0]])
    for order in permutations(range(4)):
        parity = round(np.linalg.det(np.eye(4)[list(order)]))
        assert side(verts, *order) == parity * side(verts, 0, 1, 2, 3) != 0


def test_only_four_vertices_on_one_line_have_no_side():
    verts = np.outer([0.0, 1, 2, 5], [1, 2, -1])
    assert side(verts, 0, 1, 2, 3) == 0
