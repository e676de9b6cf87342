"""Hinges of two groups: copies, samples of one law, and shifted ones."""

import numpy as np
import pytest
from test_hinge_shapes import made, mirrored, turned

from morphofold.analysis.graph.hinge_shapes import HingeShapes
from morphofold.comparison.hinges import compare_hinges, examples, median_difference


def shapes(features, *, first=0, width=8.0, per_area=0.1):
    count = len(features)
    kinds = np.array(["Y", "T", "V"])[np.arange(count) % 3]
    return HingeShapes(first + np.arange(count), features, kinds, width, per_area)


def test_every_two_groups_are_compared_in_their_order_and_empty_ones_left_out(rng):
    known = {name: shapes(made(6, rng)) for name in ("a", "b", "c")} | {"few": shapes(made(1, rng))}
    groups = {"model": ["a", "b"], "one": ["few"], "MRI": ["c", "not measured"]}
    (found,) = compare_hinges(known, groups)
    assert (found.one, found.other) == ("model", "MRI")
    assert (found.shape.n, found.shape.m) == (12, 6)
    assert found.surfaces == (2, 1)  # of unequal groups the page says so
    assert [c.source for c in found.controls] == ["model", "MRI itself", "random net"]
    assert [c.n for c in found.controls][:2] == [12, 6]
    assert len(compare_hinges(known, {name: [name] for name in "abc"})) == 3


def test_a_mirrored_copy_is_matched_hinge_by_hinge_at_no_distance(rng):
    own = made(20, rng)
    order = rng.permutation(20)
    copy = mirrored(turned(own, 1))[order]
    (found,) = compare_hinges({"m": shapes(own), "s": shapes(copy, first=100)}, {"model": ["m"], "MRI": ["s"]})
    assert found.shape.p == 1.0
    assert found.shape.statistic == pytest.approx(0, abs=1e-12)
    assert {match.hinge: match.other - 100 for match in found.matches} == {int(order[k]): k for k in range(20)}
    assert max(match.distance for match in found.matches) < 1e-12
    assert all(match.pose >= 3 for match in found.matches)
    assert [row.ks for row in found.numbers] == [0] * 5
    assert found.controls[0].median == pytest.approx(0, abs=1e-12)
    assert found.controls[1].p < 0.01  # others of the same brain are farther


def test_one_law_is_not_told_apart_and_chance_is():
    rng = np.random.default_rng(11)
    groups = {"model": ["m"], "MRI": ["s"]}
    (same,) = compare_hinges({"m": shapes(made(80, rng)), "s": shapes(made(80, rng))}, groups)
    assert same.shape.p > 0.05
    assert same.controls[1].p > 0.05
    assert same.controls[2].p == 0.001
    assert same.controls[2].median > 1.3 * same.controls[0].median
    other = made(80, rng)
    other[:, :, 1] += 0.4
    (shifted,) = compare_hinges({"m": shapes(other), "s": shapes(made(80, rng))}, groups)
    assert shifted.shape.p == 0.001
    length = {row.number: row for row in shifted.numbers}["length / width"]
    assert length.median / length.other_median == pytest.approx(np.exp(0.4), rel=0.1)
    assert length.p < 1e-6


def test_examples_are_the_best_of_each_kind_and_no_hinge_twice(rng):
    own = made(9, rng)
    (found,) = compare_hinges({"m": shapes(own), "s": shapes(made(30, rng))}, {"model": ["m"], "MRI": ["s"]})
    three = examples(found.matches, 3)
    assert {match.kind for match in three} == {"Y", "T", "V"}
    for kind in "YTV":
        best = next(match for match in found.matches if match.kind == kind)
        chosen = next(match for match in three if match.kind == kind)
        assert chosen == best or best.other in {match.other for match in three}
    assert len({match.other for match in three}) == 3
    assert len(examples(found.matches[:2])) <= 2
    assert len(examples(found.matches)) == len({match.other for match in examples(found.matches)}) == 6


def test_medians_differ_as_often_as_chance_has_it():
    ps = [median_difference(*np.random.default_rng(k).standard_normal((2, 20)), permutations=99) for k in range(100)]
    assert 0.4 < np.mean(ps) < 0.6
    assert median_difference(np.arange(20.0), 100 + np.arange(20.0)) == 0.001
    assert median_difference(np.ones(5), np.ones(9)) == 1.0
