"""Shapes of hinges: what does not change them, and statistics on samples whose answer is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from morphofold.analysis import measure
from morphofold.analysis.gyri import gyral_graph
from morphofold.analysis.hinge_shapes import (
    OF_A_NET,
    HingeShapes,
    hinge_shapes,
    random_net,
    shape_distance,
    two_sample,
)
from morphofold.ridges import irregular_net, ridged_net
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Surface


def made(count, rng, *, even=0.25):
    """Features of hinges at chance, angles adding up to a turn."""
    angle = 2 * np.pi / 3 + even * rng.standard_normal((count, 3))
    angle *= 2 * np.pi / angle.sum(axis=1, keepdims=True)
    others = [rng.normal(mean, 0.3, (count, 3)) for mean in (0.6, 0.4, 0.8)]
    return np.stack([angle, *others], axis=2)


def turned(features, by):
    return np.roll(features, -by, axis=1)


def mirrored(features):
    """The arms the other way round; the angle after an arm is then the one that was before it."""
    other = features[:, [0, 2, 1]].copy()
    other[:, :, 0] = features[:, [2, 1, 0], 0]
    return other


def test_a_hinge_is_itself_however_turned_or_mirrored(rng):
    features = made(30, rng)
    turns = [turned(features, by) for by in range(3)]
    for k, other in enumerate([*turns, *map(mirrored, turns)]):
        distance, pose = shape_distance(features, other)
        np.testing.assert_allclose(np.diag(distance), 0, atol=1e-12)
        assert (distance + np.eye(30) > 1e-3).all()
        assert len(set(np.diag(pose).tolist())) == 1
        assert (np.diag(pose) >= 3).all() == (k >= 3)


def test_a_mirrored_net_and_a_net_of_another_size_have_the_same_shapes():
    """Through the whole measuring room: a ridged sphere, its mirror image, twice the size, turned."""
    ridged = ridged_net(irregular_net(12, 3, shortest=0.25), icosphere(5), 7.0)
    turn = Rotation.from_rotvec([0.3, -0.7, 0.4]).as_matrix()
    verts, faces = ridged.verts, ridged.faces
    others = {"mirrored": (verts * [-1, 1, 1], faces[:, ::-1], 7.0), "larger": (2 * verts @ turn.T, faces, 14.0)}
    own = shapes_of(ridged, 7.0)
    assert len(own) == 20
    for v, f, width in others.values():
        other = shapes_of(Surface(v, f), width)
        distance, _ = shape_distance(own.features, other.features)
        nearest = distance.argmin(axis=1)
        assert sorted(nearest.tolist()) == list(range(20))
        assert distance.min(axis=1).max() < 0.05
        assert other.per_area == pytest.approx(own.per_area, rel=1e-6)
        np.testing.assert_array_equal(other.kinds[nearest], own.kinds)


def shapes_of(surface, width):
    white = Surface(surface.verts, surface.faces)
    pial = Surface(surface.verts * (1 + 0.2 * width / 50 / (width / 7)), surface.faces)
    found = hinge_shapes(measure(Cortex(white, pial), gyral_width=width))
    assert isinstance(found, HingeShapes)
    return found


def test_planted_matches_are_found_among_others(rng):
    """Copies of 10 shapes, turned, mirrored and a little changed, hidden among 200 others."""
    wanted, crowd = made(10, rng), made(200, rng)
    copies = np.concatenate([mirrored(turned(wanted[k : k + 1], k % 3)) for k in range(10)])
    copies[:, :, 1:] += 0.01 * rng.standard_normal(copies[:, :, 1:].shape)
    distance, _ = shape_distance(wanted, np.concatenate([crowd, copies]))
    np.testing.assert_array_equal(distance.argmin(axis=1), 200 + np.arange(10))


def test_equal_samples_are_told_apart_as_often_as_chance_does_and_shifted_ones_always():
    ps = []
    for seed in range(60):
        pooled = made(60, np.random.default_rng(seed))
        ps.append(two_sample(shape_distance(pooled, pooled)[0], 30, permutations=99, seed=seed).p)
    assert 0.3 < np.mean(ps) < 0.7                              # uniform
    assert np.mean(np.array(ps) <= 0.05) < 0.15
    rng = np.random.default_rng(1)
    longer = made(30, rng)
    longer[:, :, 1] += 0.3
    pooled = np.concatenate([made(30, rng), longer])
    found = two_sample(shape_distance(pooled, pooled)[0], 30)
    assert found.p == 0.001
    assert found.statistic > 0
    assert (found.n, found.m) == (30, 30)


def test_a_sample_and_its_copy_have_no_distance(rng):
    one = made(20, rng)
    pooled = np.concatenate([one, turned(one, 1)])
    found = two_sample(shape_distance(pooled, pooled)[0], 20)
    assert found.statistic == pytest.approx(0, abs=1e-12)
    assert found.p == 1.0


@pytest.mark.parametrize("n", [0, 4])
def test_a_sample_without_hinges_is_refused(n):
    with pytest.raises(ValueError, match=f"two samples are needed, got {n} of 4"):
        two_sample(np.zeros((4, 4)), n)


def test_a_net_at_chance_has_the_angles_of_poisson_voronoi_cells():
    """Mean 120 degrees, density of an angle A: 4/3/pi sin A ((pi - A) cos A + sin A) of the cells' corners; sd 31.8.

    (Miles 1970, Mathematical Biosciences 6: the angles at a vertex are 180 degrees less those of a random triangle in
    a circle, weighed by its area.)
    """
    features = random_net(4000, shortest=0.0, per_area=0.1, seed=4)
    assert len(features) == 4000
    angle = features[:, :, 0]
    np.testing.assert_allclose(angle.sum(axis=1), 2 * np.pi, atol=1e-9)
    a = np.linspace(0, np.pi, 2001)
    density = 4 / (3 * np.pi) * np.sin(a) * (np.sin(a) - a * np.cos(a))
    assert np.trapezoid(density, a) == pytest.approx(1, abs=1e-5)
    expected = np.trapezoid(density * (a - 2 * np.pi / 3) ** 2, a) ** 0.5
    assert np.std(angle) == pytest.approx(expected, rel=0.02)
    width = 1 / np.sqrt(0.1)                                    # of a square per hinge, in gyral widths
    assert np.exp(features[:, :, 1]).mean() == pytest.approx(width * np.sqrt(2) * 2 / 3, rel=0.02)
    assert (random_net(400, shortest=0.5, per_area=0.1, seed=4)[:, :, 1] >= np.log(0.5)).all()
    distance, _ = shape_distance(features[:3], features[:3], of=OF_A_NET)
    assert (np.diag(distance) == 0).all()


def test_a_surface_without_a_net_has_no_shapes():
    sphere = icosphere(3, radius=50.0)
    graph = gyral_graph(Surface(*sphere))
    assert len(graph) == 0
    shell = Cortex(Surface(sphere[0] * 0.95, sphere[1]), Surface(*sphere))
    assert hinge_shapes(measure(shell)) is None
