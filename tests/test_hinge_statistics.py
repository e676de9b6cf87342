"""Shapes of hinges: what does not change them, and statistics on samples whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures
from scipy import stats

from morphofold.analysis import measure
from morphofold.analysis.graph.gyral_graph import gyral_graph
from morphofold.analysis.graph.hinge_statistics import hinge_shapes, random_net, shape_distance, two_sample
from morphofold.errors import MissingPart, NoSolution, OutOfRange
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import irregular_net
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
    for by in range(3):
        for other, in_mirror in ((turned(features, by), False), (mirrored(turned(features, by)), True)):
            distance, pose = shape_distance(features, other)
            np.testing.assert_allclose(np.diag(distance), 0, atol=1e-12)
            assert (distance + np.eye(30) > 1e-4).all()
            assert {pose >= 3 for pose in np.diag(pose).tolist()} == {in_mirror}


def test_the_pose_lays_the_second_hinge_on_the_first_and_the_distance_is_what_is_left(rng):
    a, b = made(8, rng), made(9, rng)
    distance, pose = shape_distance(a, b)
    for i in range(8):
        for j in range(9):
            laid = b[j : j + 1]
            if pose[i, j] >= 3:  # the arm that comes first, then the other sense
                laid = mirrored(turned(laid, pose[i, j] - 3))
            else:
                laid = turned(laid, pose[i, j])
            assert np.sqrt(np.mean((a[i] - laid[0]) ** 2)) == pytest.approx(distance[i, j], rel=1e-12)


def test_shapes_are_those_of_the_tables():
    """Two hinges of three arms, one of them without mean curvature on two arms, and one of four."""
    m, degrees = made_measures(), ((2, 3), (4, 3), (7, 4))
    arm = {"hemi": "lh", "curvature_per_mm": 0.05, "angle_deg": 90.0, "length_mm": 16.0}
    rows = [{**arm, "hinge": h, "arm": k, "crest": k + 3 * (h == 4)} for h, n in degrees for k in range(n)]
    rows[0].update(angle_deg=180.0, length_mm=8.0 * np.e)
    bent = {0: 0.1, 1: 0.2, 2: 0.3, 3: None, 4: None, 5: 0.5}
    m = replace(
        m,
        arms=rows,
        crests=[{"crest": k, "mean_H_per_mm": h} for k, h in bent.items()],
        hinges=[{"hinge": h, "degree": n, "shape": kind} for h, n, kind in ((2, 3, "T"), (4, 3, "Y"), (7, 4, "X"))],
        parameters={"graph_width_mm": 8.0},
        maps={**m.maps, "area": np.full(m.cortex.n_vertices, 0.5)},
    )
    shapes = hinge_shapes(m)
    assert shapes.hinge.tolist() == [2, 4]
    assert shapes.kinds.tolist() == ["T", "Y"]
    np.testing.assert_allclose(
        shapes.features[0],
        [[np.pi, 1.0, 0.4, 0.8], [np.pi / 2, np.log(2), 0.4, 1.6], [np.pi / 2, np.log(2), 0.4, 2.4]],
        rtol=1e-12,
    )
    np.testing.assert_allclose(shapes.features[1, :, 3], 4.0)
    cortex = np.isfinite(m.maps["H"]).sum()
    assert 0 < cortex < m.cortex.n_vertices
    assert shapes.per_area == pytest.approx(3 * 64 / (0.5 * cortex))
    lost = replace(m, crests=[{"crest": k, "mean_H_per_mm": None if k > 2 else 0.1} for k in bent])
    assert hinge_shapes(lost).hinge.tolist() == [2]
    with pytest.raises(MissingPart):
        hinge_shapes(replace(m, arms=[{k: v for k, v in row.items() if k != "crest"} for row in rows]))


def test_equal_samples_are_told_apart_as_often_as_chance_does_and_shifted_ones_always():
    ps = []
    for seed in range(40):
        pooled = made(60, np.random.default_rng(seed))
        ps.append(two_sample(shape_distance(pooled, pooled)[0], 30, permutations=99, seed=seed).p)
    assert 0.3 < np.mean(ps) < 0.7  # uniform
    assert np.mean(np.array(ps) <= 0.05) < 0.15
    rng = np.random.default_rng(1)
    longer = made(30, rng)
    longer[:, :, 1] += 0.3
    pooled = np.concatenate([made(30, rng), longer])
    sample = two_sample(shape_distance(pooled, pooled)[0], 30)
    assert sample.p == 0.001
    assert (sample.n, sample.m) == (30, 30)


def test_the_statistic_is_the_energy_distance(rng):
    x, y = rng.normal(0, 1, 12), rng.normal(0.7, 2, 9)
    pooled = np.concatenate([x, y])
    sample = two_sample(np.abs(pooled[:, None] - pooled), 12, permutations=9)
    assert sample.statistic == pytest.approx(stats.energy_distance(x, y) ** 2, rel=1e-12)
    copies = np.concatenate([x, x])
    same = two_sample(np.abs(copies[:, None] - copies), 12)
    assert (same.statistic, same.p) == (pytest.approx(0, abs=1e-12), 1.0)


def test_a_net_at_chance_has_the_angles_of_poisson_voronoi_cells():
    """Mean 120 degrees, standard deviation 29.4, density 4/(3 pi) sin A (sin A - A cos A).

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
    assert np.trapezoid(density * a, a) == pytest.approx(2 * np.pi / 3, abs=1e-5)
    expected = np.trapezoid(density * (a - 2 * np.pi / 3) ** 2, a) ** 0.5
    assert np.degrees(expected) == pytest.approx(29.4, abs=0.05)
    assert np.std(angle) == pytest.approx(expected, rel=0.02)
    side = 1 / np.sqrt(0.1)  # of a square per hinge, in gyral widths
    assert np.exp(features[:, :, 1]).mean() == pytest.approx(side * np.sqrt(2) * 2 / 3, rel=0.02)


def test_arms_of_a_net_go_with_their_angles():
    """From the net itself, hinge by hinge: from each arm counter-clockwise to the next."""
    features, net = random_net(30, shortest=0.0, per_area=0.1, seed=2), irregular_net(17, 2, n_rounds=0)
    width = np.sqrt(0.1 * 4 * np.pi / len(net.nodes))
    for node, own in enumerate(features):
        point, arcs = net.nodes[node], np.flatnonzero((net.arcs == node).any(axis=1))
        lengths = np.exp(own[:, 1]) * width
        arcs = arcs[np.abs(net.lengths[arcs] - lengths[:, None]).argmin(axis=1)]  # of each arm
        np.testing.assert_allclose(net.lengths[arcs], lengths, rtol=1e-9)
        ends = net.nodes[net.arcs[arcs].sum(axis=1) - node]
        flat = ends - (ends @ point)[:, None] * point
        for k, (u, v) in enumerate(zip(flat, np.roll(flat, -1, axis=0))):
            turn = np.arctan2(np.cross(u, v) @ point, u @ v) % (2 * np.pi)
            assert own[k, 0] == pytest.approx(turn, abs=1e-6)


def test_a_net_without_short_arms_has_as_many_hinges_as_asked():
    """Two hinges that a short arm joins count as one, which has four arms and is not given."""
    net = irregular_net(2002, 4, n_rounds=0)
    for per_area in (0.05, 0.1):
        features = random_net(4000, shortest=0.5, per_area=per_area, seed=4)
        assert features[:, :, 1].min() >= np.log(0.5)
        whole = random_net(4000, shortest=0.0, per_area=per_area, seed=4)
        (same,) = np.flatnonzero((whole[:, :, 0] == features[0, :, 0]).all(axis=1))
        width = np.sqrt(per_area * 4 * np.pi / 4000) * np.exp(whole[same, 0, 1] - features[0, 0, 1])  # [rad]
        counted = 4000 - np.count_nonzero(net.lengths < 0.5 * width)
        assert counted * width**2 / (4 * np.pi) == pytest.approx(per_area, rel=1e-6)
        assert counted < 4000
    with pytest.raises(NoSolution, match=r"\b0\.1\b.*\b3\b"):
        random_net(100, shortest=3.0, per_area=0.1)
    with pytest.raises(OutOfRange, match=r"\b100\b.* 0\.5 and 0\.0\b"):
        random_net(100, shortest=0.5, per_area=0.0)


def test_a_surface_without_a_net_has_no_shapes():
    sphere = icosphere(3, radius=50.0)
    graph = gyral_graph(Surface(*sphere))
    assert len(graph) == 0
    shell = Cortex(Surface(sphere[0] * 0.95, sphere[1]), Surface(*sphere))
    assert hinge_shapes(measure(shell, only=["crests", "hinges", "arms", "area", "H"])) is None
