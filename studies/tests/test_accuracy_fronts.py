"""Fronts, power laws and what half an error costs, on points made up so that the answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from morphofold.errors import DamagedFile, OutOfRange
from morphofold.studies.accuracy.fronts import better_than, grouped, halving, law
from morphofold.studies.accuracy.points import FIELDS, Point, timed


def point(seconds, error, **others):
    made = Point("solver", "a body", "radius", error, "theory", "mesh", "h", 1.0, 100, seconds, seconds, seconds)
    return replace(made, **others)


def test_what_nothing_beats_is_the_front():
    cheap, middle, dear = point(1, 0.3), point(2, 0.2), point(4, 0.1)
    slow, wrong = point(3, 0.2), point(2, 0.25)
    found = better_than([cheap, slow, middle, wrong, dear])
    assert found == [None, middle, None, middle, None]


def test_the_most_accurate_of_those_that_are_better_is_named():
    best, good, bad = point(1, 0.1), point(1, 0.2), point(2, 0.3)
    assert better_than([good, bad, best])[1] == best


def test_what_is_a_little_faster_or_truer_dominates_nothing():
    one = point(1, 0.1)
    assert better_than([one, point(0.8, 0.1), point(0.9, 0.097)])[0] is None
    assert better_than([one, point(0.7, 0.1)])[0] is not None
    assert better_than([one, point(0.9, 0.09)])[0] is not None


def test_what_takes_half_the_time_for_a_hair_less_accuracy_dominates():
    dear = point(2, 0.1)
    assert better_than([dear, point(1, 0.101)])[0] is not None
    assert better_than([dear, point(1, 0.11)])[0] is None


def test_equal_points_are_both_on_the_front():
    assert better_than([point(1, 0.1), point(1, 0.1)]) == [None, None]


def test_what_has_another_known_answer_is_another_group():
    points = [point(1, 0.1), point(1, 0.2, against="finest mesh"), point(1, 0.3, subject="another")]
    assert [len(group) for group in grouped(points).values()] == [1, 1, 1]


@pytest.mark.parametrize("power", [-3.0, 0.5, 2.0])
def test_a_power_law_is_found_again_exactly(power):
    x = np.array([0.2, 0.5, 1.0, 3.0])
    found = law(x, 7.0 * x**power)
    assert found.power == pytest.approx(power, abs=1e-6)
    assert found.coefficient == pytest.approx(7.0, rel=1e-6)
    assert found.uncertainty < 1e-5
    assert found.at(2.0) == pytest.approx(7.0 * 2.0**power)


def test_the_interval_of_the_power_holds_the_true_one_in_95_of_100_cases(rng):
    x = np.geomspace(0.3, 1.2, 6)
    inside = 0
    for _ in range(400):
        found = law(x, 2.0 * x**1.7 * np.exp(0.2 * rng.standard_normal(6)))
        inside += abs(found.power - 1.7) < found.uncertainty
    assert 0.91 < inside / 400 < 0.985


@pytest.mark.parametrize(
    ("x", "y"), [([1, 2], [1, 2]), ([1, 1, 1], [1, 2, 3]), ([1, 2, 3], [1, 0, 2]), ([1, 2, 3], [1, np.nan, 2])]
)
def test_no_law_is_drawn_through_too_little(x, y):
    with pytest.raises(OutOfRange) as refused:
        law(x, y)
    assert f"x = {[*map(float, x)]}, y = {[*map(float, y)]}" in str(refused.value)


def test_half_the_error_of_a_second_order_method_in_three_dimensions_and_time_takes_four_times_as_long():
    x = np.array([0.25, 0.5, 1.0])
    found = halving(law(x, 10 * x**-4.0), law(x, 0.1 * x**2.0))
    assert found.factor == pytest.approx(4.0, rel=1e-6)
    assert found.low == pytest.approx(4.0, rel=1e-3)
    assert found.high == pytest.approx(4.0, rel=1e-3)


def test_the_interval_of_a_factor_widens_with_the_scatter(rng):
    x = np.geomspace(0.3, 1.2, 7)
    time = law(x, 10 * x**-3.0 * np.exp(0.05 * rng.standard_normal(7)))
    some, more = (law(x, 0.1 * x**2.0 * np.exp(s * rng.standard_normal(7))) for s in (0.05, 0.3))
    a, b = halving(time, some), halving(time, more)
    assert a.low < a.factor < a.high
    assert b.high / b.low > a.high / a.low


def test_a_price_beyond_all_bounds_is_a_number_still():
    x = np.array([0.3, 0.6, 1.2])
    error = law(x, x)
    hardly = replace(error, uncertainty=0.9999 * error.power)
    found = halving(law(x, x**-3.0), hardly)
    assert found.factor == pytest.approx(8.0)
    assert 1e100 < found.high < np.inf


def test_an_error_that_does_not_fall_has_no_price(rng):
    x = np.geomspace(0.3, 1.2, 5)
    noise = law(x, 0.1 * np.exp(0.5 * rng.standard_normal(5)))
    assert halving(law(x, x**-3.0), noise) is None


def test_a_point_survives_being_written_as_a_row():
    one = point(1.5, 0.25, preset="draft")
    assert tuple(one.as_row()) == FIELDS
    assert Point.from_row(one.as_row()) == one
    with pytest.raises(DamagedFile, match=r"\bsubject\b"):
        Point.from_row({"half": "solver"})


def test_quick_work_is_done_once_to_warm_up_and_timed_five_times():
    calls = []
    result, times = timed(lambda: calls.append(sum(range(20_000))) or len(calls))
    assert (result, times.repeats) == (6, 5)
    assert times.fastest <= times.seconds <= times.slowest
