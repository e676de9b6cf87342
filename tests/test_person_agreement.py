"""Agreements of folds and their tests by spins: known answers, and the rate of false positives."""

import numpy as np
import pytest
from made_people import random_folds, values
from scipy.stats import spearmanr
from threadpoolctl import threadpool_limits

from morphofold.comparison.person.common_sphere import weighted_median
from morphofold.comparison.person.fold_axes import agreement_of_axes, fold_axes, forwardness, pulled_back, smooth_axes
from morphofold.comparison.person.grown_regions import REGION_MEASURES, region_numbers, spearman
from morphofold.comparison.person.person_agreement import agreement_of_classes, classes, compare_with_null, null_values
from morphofold.geometry import unit, vertex_areas
from morphofold.shapes import icosphere
from morphofold.spheres.spins import NearestTable, rotations
from morphofold.surface import Surface
from morphofold.unfolding.harmonics import SmoothSurface, fit, tangents

TRIALS, SPINS = 300, 99


@pytest.fixture(scope="module")
def ball():
    points, faces = icosphere(3)
    return points, faces, vertex_areas(points, faces)


def unrotated(points):
    """The vertex that each falls on, and its rotation, where nothing is rotated."""
    return np.arange(len(points)), np.eye(3)


def test_the_median_divides_the_weight_in_halves_and_is_no_value():
    assert weighted_median(np.array([3.0, 1.0, 2.0, 4.0]), np.ones(4)) == 2.5
    assert weighted_median(np.array([0.0, 10.0, 20.0]), np.array([1.0, 1.0, 8.0])) == 20.0
    values, weights = np.random.default_rng(1).random((2, 999))
    low = weights[values < weighted_median(values, weights)].sum()
    assert low == pytest.approx(weights.sum() / 2, abs=1.0)


def test_classes_of_a_map_and_of_one_without_spread():
    np.testing.assert_array_equal(classes(np.array([1.0, 2, 3, 4, np.nan]), np.ones(5)), [-1, -1, 1, 1, 0])
    np.testing.assert_array_equal(classes(np.ones(4), np.ones(4)), np.zeros(4))


def test_a_map_agrees_with_itself_not_with_its_opposite_and_by_a_half_with_others(ball, rng):
    points, _, areas = ball
    first, second = (classes(values(random_folds(rng), points), areas) for _ in range(2))
    fraction = agreement_of_classes([first, -first, second], first, areas)(*unrotated(points))
    np.testing.assert_allclose(fraction[:2], [1, 0], atol=1e-12)
    assert 0.3 < fraction[2] < 0.7
    assert agreement_of_classes([first], 0 * first, areas)(*unrotated(points))[0] == 0.5  # nothing is known
    null = null_values([agreement_of_classes([first], second, areas)], points, points, 300, 0)[0][:, 0]
    assert null.mean() == pytest.approx(0.5, abs=4 * null.std() / np.sqrt(300))
    assert 0.005 < null.std() < 0.1


def test_vertices_without_a_class_in_one_body_are_left_out_for_all(ball, rng):
    points, _, areas = ball
    person = classes(values(random_folds(rng), points), areas)
    wall = points[:, 0] > 0.5
    body = np.where(wall, 0, person)
    other = np.where(wall, -person, person)  # wrong only where the first is unknown
    np.testing.assert_allclose(agreement_of_classes([body, other], person, areas)(*unrotated(points)), 1, atol=1e-12)


def p_values(ball, spins, smooth, person, simulated):
    """p of the agreement of simulated with person, and p of what it has above the smooth body."""
    points, _, areas = ball
    of = lambda folds: classes(values(folds, points), areas)
    statistic = agreement_of_classes([of(simulated), of(smooth)], of(person), areas)
    agreement, null = statistic(*unrotated(points)), np.stack([statistic(nearest, None) for nearest in spins])
    tested = compare_with_null(agreement[0], null[:, 0], agreement[1], null[:, 1])
    return tested.p, tested.difference_p


def rates(ball, rng, make):
    points = ball[0]
    table = NearestTable(points)
    spins = [table(points @ rotation) for rotation in rotations(SPINS, 5)]
    with threadpool_limits(1):
        p = np.array([p_values(ball, spins, *make(rng)) for _ in range(TRIALS)])
    return (p <= 0.05).mean(axis=0)


def test_five_of_a_hundred_pairs_of_random_maps_are_significant(ball, rng):
    """And of differences from a third; the standard error is 1.3 %."""
    by_chance = rates(ball, rng, lambda rng: [random_folds(rng, 3) for _ in range(3)])
    assert (np.abs(by_chance - 0.05) < 0.04).all()


def test_growth_that_only_preserves_what_unfolding_left_is_not_significant(ball, rng):
    """Person and simulation have the smooth body in common, and folds of their own: they agree, and it's no result."""

    def make(rng):
        body = random_folds(rng, 1, 4)
        return body, body + random_folds(rng, 5), 3 * body + random_folds(rng, 5)

    agreement, difference = rates(ball, rng, make)
    assert agreement > 0.95
    assert difference <= 0.05


def test_growth_that_finds_the_folds_of_the_person_is_significant(ball, rng):
    def make(rng):
        body, folds = random_folds(rng, 1, 4), random_folds(rng, 5)
        return body, body + 2 * folds, body + 2 * folds + random_folds(rng, 5)

    assert rates(ball, rng, make)[1] > 0.95


def test_a_number_without_control_or_without_value():
    null = np.array([0.1, 0.2, 0.3, np.nan])
    no_control = np.nan, np.full(4, np.nan)
    plain = compare_with_null(0.25, null, *no_control)
    assert (plain.p, plain.control, plain.difference) == (0.5, None, None)  # one of three, and itself
    missing = compare_with_null(float("nan"), null, *no_control)
    assert (missing.p, bool(missing.beats)) == (1, False)
    both = compare_with_null(0.9, np.linspace(0, 0.5, 99), 0.9, np.linspace(0, 0.5, 99))
    assert (both.p, both.difference, both.difference_p, both.beats) == (0.01, 0.0, 1.0, False)


def test_a_rotated_field_of_axes_agrees_with_itself(ball):
    points, _, areas = ball
    (rotation,) = rotations(1, 8)
    fine = icosphere(6)[0]
    nearest, ones = NearestTable(fine)(points @ rotation), np.ones(len(points))
    of = lambda s: (field := np.cross(s, [0.0, 0, 1])) / np.linalg.norm(field, axis=1, keepdims=True).clip(1e-12)
    along = of(points @ rotation) @ rotation.T
    fields = [(along, ones), (np.cross(points, along), ones)]
    cosines = agreement_of_axes(fields, (of(fine), np.ones(len(fine))), areas, points)(nearest, rotation)
    assert (cosines[0] > 0.995, cosines[1] < -0.995) == (True, True)


def test_directions_along_an_ellipsoid_are_pulled_back_to_its_sphere(rng):
    points, faces = icosphere(5)
    axes = np.array([30.0, 60.0, 40.0])
    on_sphere = tangents(points)[:, 0]
    back = pulled_back(on_sphere * axes, points * axes, faces, points)  # the image of a tangent under the linear map
    assert np.abs(np.sum(back * on_sphere, axis=1)).min() > 0.999


def test_fold_axes_run_along_ridges_and_along_the_grooves_between_them():
    """Twelve ridges around the x axis on a sphere: folds are circles of equal x."""
    points, faces = icosphere(5)
    wave = np.cos(12 * np.arcsin(points[:, 0]))
    surface = Surface(40 * (1 + 0.03 * wave)[:, None] * points, faces)
    axes, strength = fold_axes(surface, points, 4.0, np.ones(len(points), dtype=bool))
    across = unit(np.array([1.0, 0, 0]) - points[:, :1] * points)
    for part in (wave > 0.8, wave < -0.8):
        sides = part & (np.abs(points[:, 0]) < 0.9)
        assert np.abs(np.sum(axes * across, axis=1))[sides].max() < 0.15
        assert strength[sides].min() > 0.2


def test_the_smooth_axes_of_a_long_ellipsoid_run_to_the_front():
    points = icosphere(4)[0]
    surface = SmoothSurface(fit(points, points * [30.0, 90.0, 30.0], np.ones(len(points)), 3))
    axes, strength = smooth_axes(surface, points)
    sides = np.abs(points[:, 1]) < 0.5
    assert strength[sides].min() > 0.5
    assert forwardness(axes, strength, surface, points, sides.astype(float)) > 0.99
    assert forwardness(np.cross(points, axes), strength, surface, points, sides.astype(float)) < -0.95


def test_exact_axes_are_those_of_the_mesh():
    points, faces = icosphere(5)
    surface = SmoothSurface(fit(points, points * [30.0, 60.0, 40.0], np.ones(len(points)), 3))
    exact, clear = smooth_axes(surface, points)
    of_mesh, _ = fold_axes(Surface(surface(points), faces), points, 6.0, np.ones(len(points), dtype=bool))
    cosine = np.abs(np.sum(exact * of_mesh, axis=1))[clear > 0.2]
    assert np.percentile(cosine, 2) > 0.99


def test_numbers_of_regions_are_ratios_and_medians():
    labels = np.array([0, 0, 0, 1, 1, -1, 3])
    medians = np.array([5.0, 1, 3, 4, 2, 9, np.nan])
    maps = {REGION_MEASURES[0]: (np.arange(7.0), np.ones(7)), REGION_MEASURES[1]: medians}
    numbers = region_numbers(labels, 4, maps)
    np.testing.assert_allclose(numbers[:2], [[1, 3.5, np.nan, 6], [3, 3, np.nan, np.nan]])
    assert np.isnan(numbers[2]).all()


def test_rank_correlation_is_that_of_scipy_over_regions_that_have_both(rng):
    x, y = rng.integers(0, 8, (2, 30)).astype(float)  # with ties
    assert spearman(x, y) == pytest.approx(spearmanr(x, y).statistic)
    x[3] = y[5] = np.nan
    both = np.isfinite(x + y)
    assert spearman(x, y) == pytest.approx(spearmanr(x[both], y[both]).statistic)
    assert np.isnan(spearman(x[:4], y[:4]))
    assert np.isnan(spearman(np.ones(9), np.arange(9.0)))
