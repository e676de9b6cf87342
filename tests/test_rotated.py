"""What subjects have in common, and by chance."""

import numpy as np
import pytest

from morphofold.geometry import vertex_areas
from morphofold.group.overlap import Landmarks, common, common_by_chance
from morphofold.shapes import icosphere

VERTS, FACES = icosphere(4)
ON_SPHERE = vertex_areas(VERTS, FACES)


def landmarks(places, radius, areas=ON_SPHERE, kinds=1):
    """Of subjects with places (S, H, 3) on the unit sphere, near within an angle."""
    S = len(places)
    amounts, near = np.zeros((kinds, S, len(VERTS))), np.zeros((kinds, S, len(VERTS)), dtype=bool)
    for s, of_one in enumerate(places):
        at = np.argmax(of_one @ VERTS.T, axis=1)
        np.add.at(amounts[:, s], (slice(None), at), 1.0)
        near[:, s] = (VERTS @ VERTS[at].T >= np.cos(radius)).any(axis=1)
    return Landmarks(np.where(areas > 0, amounts, 0.0), near, VERTS, ON_SPHERE, areas)


def random_places(random, subjects, hinges):
    places = random.standard_normal((subjects, hinges, 3))
    return places / np.linalg.norm(places, axis=2, keepdims=True)


def share(sums):
    return sums[..., 1, :].sum(axis=-1) / sums[..., 2, :].sum(axis=-1)


def turned(marks, spins, seed):
    return np.concatenate(list(common_by_chance(marks, spins, seed)))


def test_subjects_with_the_same_places_share_all_and_with_opposite_ones_nothing(rng):
    places = np.repeat(random_places(rng, 1, 20), 3, axis=0)
    assert share(common(landmarks(places, 0.1))) == pytest.approx(1.0)
    north = np.array([[0.0, 0.0, 1.0]])
    assert share(common(landmarks(np.stack([north, -north]), 0.1))) == 0.0


def test_a_third_of_the_pairs_share_where_two_of_three_agree():
    north = np.array([[0.0, 0.0, 1.0]])
    assert share(common(landmarks(np.stack([north, north, -north]), 0.1))) == pytest.approx(1 / 3)


def test_chance_is_the_share_of_the_sphere_that_is_near():
    """One hinge each: another is within an angle r by chance in (1 - cos r) / 2 of all rotations."""
    north = np.array([[0.0, 0.0, 1.0]])
    marks = landmarks(np.stack([north] * 4), 0.5)
    found = share(turned(marks, 1500, 0))
    near = ON_SPHERE[marks.near[0, 0]].sum() / ON_SPHERE.sum()
    assert near == pytest.approx((1 - np.cos(0.5)) / 2, rel=0.1)
    assert found.mean() == pytest.approx(near, rel=0.1)


def test_every_subject_keeps_its_amount_in_the_cortex(rng):
    areas = np.where(VERTS[:, 2] > -0.6, ON_SPHERE, 0.0)
    marks = landmarks(random_places(rng, 5, 30), 0.1, areas)
    found = turned(marks, 50, 1)
    np.testing.assert_allclose(found[:, 0, 0].sum(axis=1), marks.amounts.sum(), rtol=1e-5)
    assert not found[..., areas == 0].any()


def test_by_chance_density_follows_the_area_of_the_cortex_not_that_of_the_sphere(rng):
    areas = ON_SPHERE * np.where(VERTS[:, 0] > 0, 3.0, 1.0)
    marks = landmarks(random_places(rng, 6, 40), 0.1, areas)
    amounts = turned(marks, 400, 2)[:, 0, 0].sum(axis=0)
    wide = VERTS[:, 0] > 0
    assert amounts[wide].sum() / amounts.sum() == pytest.approx(areas[wide].sum() / areas.sum(), abs=0.012)
    assert areas[wide].sum() / areas.sum() > 0.7


@pytest.mark.parametrize("wall", [pytest.param(-1.1, marks=pytest.mark.slow), -0.6], ids=["no wall", "a wall"])
def test_p_is_even_for_subjects_that_have_nothing_in_common(wall):
    """60 studies of 6 independent subjects: the rank of the study's share among its rotations is uniform."""
    random = np.random.default_rng(3)
    areas = np.where(VERTS[:, 2] > wall, ON_SPHERE, 0.0)
    ranks = []
    for study in range(60):
        places = random_places(random, 6, 60)
        inside = [of_one[of_one[:, 2] > wall + 0.05][:25] for of_one in places]
        marks = landmarks(inside, 0.2, areas)
        null = share(turned(marks, 99, study))[:, 0]
        ranks.append((np.sum(null >= share(common(marks))[0]) + 1) / 100)
    assert 0 <= np.sum(np.array(ranks) <= 0.1) <= 14  # 6 expected; above 14: once in a thousand
    assert 16 <= np.sum(np.array(ranks) <= 0.5) <= 44
    assert np.std(ranks) == pytest.approx(np.sqrt(1 / 12), abs=0.07)


def test_kinds_are_turned_together_and_threads_change_nothing(rng):
    from morphofold.threads import set_threads

    marks = landmarks(random_places(rng, 4, 10), 0.2, kinds=2)
    found = turned(marks, 30, 5)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    set_threads(1)
    try:
        np.testing.assert_array_equal(turned(marks, 30, 5), found)
    finally:
        set_threads(None)
