"""Hinges of two groups: copies, samples of one law, and shifted ones."""

import numpy as np
import pytest
from test_hinge_statistics import made, mirrored, turned

from morphofold.analysis.graph.hinge_statistics import PLANAR_NET_FEATURES, HingeShapes, shape_distance
from morphofold.comparison import hinge_comparison
from morphofold.comparison.hinge_comparison import RANDOM_NET_NAME, compare_hinges, examples, net_at_chance


def shapes(features, *, first=0, width=8.0, per_area=0.1):
    count = len(features)
    kinds = np.array(["Y", "T", "V"])[np.arange(count) % 3]
    return HingeShapes(first + np.arange(count), features, kinds, width, per_area)


def test_every_two_groups_are_compared_in_their_order_and_empty_ones_left_out(rng):
    surfaces = {name: shapes(made(6, rng)) for name in ("a", "b", "c")} | {"few": shapes(made(1, rng))}
    groups = {"model": ["a", "b"], "one": ["few"], "MRI": ["c", "not measured"]}
    (result,) = compare_hinges(surfaces, groups)
    assert (result.one, result.other) == ("model", "MRI")
    assert (result.shape.n, result.shape.m) == (12, 6)
    assert result.surfaces == (2, 1)  # of unequal groups the page says so
    assert [c.source for c in result.controls] == ["model", "MRI itself", RANDOM_NET_NAME]
    assert [c.n for c in result.controls] == [3] * 3  # the same number of all, half of the smaller group
    assert len(compare_hinges(surfaces, {name: [name] for name in "abc"})) == 3


def test_a_mirrored_copy_is_matched_hinge_by_hinge_at_no_distance(rng):
    own = made(20, rng)
    order = rng.permutation(20)
    copy = mirrored(turned(own, 1))[order]
    (result,) = compare_hinges({"m": shapes(own), "s": shapes(copy, first=100)}, {"model": ["m"], "MRI": ["s"]})
    assert result.shape.p == 1.0
    assert result.shape.statistic == pytest.approx(0, abs=1e-12)
    assert {match.hinge: match.other - 100 for match in result.matches} == {int(order[k]): k for k in range(20)}
    assert max(match.distance for match in result.matches) < 1e-12
    assert all(match.pose >= 3 for match in result.matches)
    assert [row.ks for row in result.numbers] == [0] * 5
    copy, others, _ = result.controls
    assert copy.to_other < 0.7 * others.to_other  # half of the copies are drawn


def test_samples_of_one_law_do_not_differ_and_chance_does():
    rng = np.random.default_rng(11)
    groups = {"model": ["m"], "MRI": ["s"]}
    (same,) = compare_hinges({"m": shapes(made(80, rng)), "s": shapes(made(80, rng))}, groups)
    assert same.shape.p > 0.05
    own, itself, chance = same.controls
    assert own.to_other == pytest.approx(itself.to_other, rel=0.1)
    assert own.from_other == pytest.approx(itself.from_other, rel=0.1)
    assert chance.to_other > 1.3 * own.to_other
    assert same.closer
    assert (same.p, same.units) == (0.001, "hinges")
    other = made(80, rng)
    other[:, :, 1] += 0.4
    (shifted,) = compare_hinges({"m": shapes(other), "s": shapes(made(80, rng))}, groups)
    assert shifted.shape.p == 0.001
    length = {row.number: row for row in shifted.numbers}["length / width"]
    assert length.median / length.other_median == pytest.approx(np.exp(0.4), rel=0.1)


def test_examples_are_the_best_of_each_kind_and_no_hinge_twice(rng):
    own = made(9, rng)
    (result,) = compare_hinges({"m": shapes(own), "s": shapes(made(30, rng))}, {"model": ["m"], "MRI": ["s"]})
    three = examples(result.matches, 3)
    assert {match.kind for match in three} == {"Y", "T", "V"}
    for kind in "YTV":
        best = next(match for match in result.matches if match.kind == kind)
        chosen = next(match for match in three if match.kind == kind)
        assert chosen == best or best.other in {match.other for match in three}
    assert len({match.other for match in three}) == 3
    assert len(examples(result.matches)) == len({match.other for match in examples(result.matches)}) == 6


def test_one_common_shape_is_no_closer_than_chance(rng):
    """One hinge of the random net, again and again, is near to many hinges, but few are near to it."""
    law = shapes(made(80, rng))
    net = np.nan_to_num(net_at_chance([law]))
    (whole,) = compare_hinges({"m": shapes(net[:200]), "s": law}, {"net": ["m"], "MRI": ["s"]})
    assert not whole.closer
    assert whole.p > 0.05
    nearest = min(range(len(net)), key=lambda k: _distance_to(net[k : k + 1], law))
    common = np.repeat(net[nearest : nearest + 1], 80, axis=0)
    (result,) = compare_hinges({"m": shapes(common), "s": law}, {"one": ["m"], "MRI": ["s"]})
    first, _, chance = result.controls
    assert first.to_other < chance.to_other
    assert first.from_other > chance.from_other
    assert not result.closer


def _distance_to(hinge, law):
    return float(shape_distance(hinge, law.features, of=PLANAR_NET_FEATURES)[0].min())


def test_of_six_surfaces_each_is_one_unit(rng):
    """All six say the same: of 64 divisions by signs two are as extreme, whatever the number of hinges."""
    people = {f"p{k}": shapes(made(40, rng)) for k in range(6)}
    (result,) = compare_hinges({"m": shapes(made(80, rng))} | people, {"model": ["m"], "MRI": list(people)})
    assert result.units == "surfaces"
    assert result.p == pytest.approx(2 / 64, abs=0.02)
    assert result.closer


@pytest.mark.slow
@pytest.mark.parametrize("surfaces", [1, 8])
def test_the_test_against_chance_has_its_level(monkeypatch, surfaces):
    """Groups from the random net itself, whose hinges are the same for all surfaces."""
    ps = []
    monkeypatch.setattr(hinge_comparison, "PERMUTATIONS", 99)
    monkeypatch.setattr(hinge_comparison, "DRAWS", 2)
    for k in range(40):
        rng = np.random.default_rng(k)
        law = {f"s{n}": shapes(made(30, rng)) for n in range(surfaces)}
        net = np.nan_to_num(rng.permutation(net_at_chance(list(law.values()), seed=1000 + k))[:30])
        (result,) = compare_hinges({"m": shapes(net), **law}, {"net": ["m"], "MRI": list(law)}, seed=k)
        ps.append(result.p)
    assert 0.35 < np.mean(ps) < 0.65
    assert np.mean(np.array(ps) < 0.1) < 0.25


def test_without_a_random_net_there_is_no_verdict(rng):
    (result,) = compare_hinges(
        {"m": shapes(made(9, rng)), "s": shapes(made(9, rng), per_area=0.9)}, {"model": ["m"], "MRI": ["s"]}
    )
    assert (result.p, result.verdict, result.closer) == (None, "", False)
    assert len(result.controls) == 2
