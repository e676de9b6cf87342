"""Heights of folds in bands of harmonic degrees, and the valleys between folds: known answers on the sphere."""

import numpy as np
import pytest
from made_people import LEVEL, made_person, random_folds
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

from morphofold.comparison.person import fold_heights as module
from morphofold.comparison.person.common_sphere import bodies_of
from morphofold.comparison.person.fold_heights import (
    VALLEY_POINTS,
    agreement_of_lines,
    band,
    fold_heights,
    valley_directions,
    weighted_correlations,
)
from morphofold.shapes import even_directions
from morphofold.unfolding.harmonics import Expansion, degrees


def zonal(degree):
    """The harmonic of this degree about the z axis."""
    l = degrees(degree)
    return Expansion(np.where(np.arange(len(l)) == degree**2 + degree, 1.0, 0.0)[:, None])


def test_heights_are_taken_apart_by_degree_and_a_mean_is_none():
    """The penalty takes 3 % of degree 16."""
    points = even_directions(4000)
    low, high = random_folds(np.random.default_rng(0), 1, 6), random_folds(np.random.default_rng(1), 7, 16)
    low_values, high_values = (Expansion(folds[:, None])(points)[:, 0] for folds in (low, high))
    fitted = band(fold_heights(points, 3 + 5 * low_values + high_values, np.ones(len(points))))(points)[:, 0]
    assert np.corrcoef(fitted, high_values)[0, 1] > 0.999
    assert fitted @ high_values / (high_values @ high_values) == pytest.approx(0.98, abs=0.01)


def test_more_vertices_than_are_fitted_give_the_same_heights(monkeypatch):
    points = even_directions(12_000)
    values = Expansion(random_folds(np.random.default_rng(2))[:, None])(points)[:, 0]
    whole = fold_heights(points, values, np.ones(len(points)))(points)
    monkeypatch.setattr(module, "MOST_FITTED_VERTICES", 4000)
    assert fold_heights(points, values, np.ones(len(points)))(points) == pytest.approx(whole, abs=0.03)


@pytest.mark.parametrize("degree", [8, 13])
def test_valleys_of_a_zonal_height_are_circles_where_it_is_least(degree):
    z = np.linspace(-1, 1, 20_001)
    value = eval_legendre(degree, z)
    least = z[1:-1][(value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])]
    valleys = valley_directions(zonal(degree))
    nearest = least[np.abs(valleys[:, 2, None] - least).argmin(axis=1)]
    spacing = np.sqrt(4 * np.pi / VALLEY_POINTS)
    off = np.abs(np.arccos(valleys[:, 2]) - np.arccos(nearest))
    assert off.max() < 0.6 * spacing
    length = 2 * np.pi * np.sqrt(1 - least**2).sum()
    assert len(valleys) * spacing == pytest.approx(length, rel=0.03)  # points in proportion to length


def test_correlations_are_those_of_the_area_and_none_without_spread():
    rng = np.random.default_rng(3)
    x, y, copies = rng.standard_normal((2, 50)), rng.standard_normal(50), rng.integers(0, 4, 50)
    repeated = [np.corrcoef(np.repeat(row, copies), np.repeat(y, copies))[0, 1] for row in x]
    assert weighted_correlations(x, y, copies.astype(float)) == pytest.approx(repeated)
    assert weighted_correlations(np.ones((1, 50)), y, np.ones(50)) == 0
    assert weighted_correlations(x, y, np.zeros(50)).tolist() == [0, 0]


def test_a_line_is_near_itself_far_from_nowhere_and_turns_with_the_sphere():
    person = made_person(random_folds(np.random.default_rng(4)))
    bodies = bodies_of(person, person, LEVEL)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    around_x = np.column_stack([np.zeros(400), np.cos(angle), np.sin(angle)])  # in no part of the medial wall
    around_y = around_x[:, [1, 0, 2]]
    statistic = agreement_of_lines(bodies, [around_x, around_y, np.empty((0, 3))], around_x)
    own, crossing, none = statistic(bodies.to_grown.nearest, np.eye(3))
    assert own == 1
    assert 0 < crossing < 0.2  # at the two poles that both go through
    assert np.isnan(none)
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert statistic(bodies.to_grown.nearest, quarter)[1] == 1
