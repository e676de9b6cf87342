"""Basins and peaks against a flood that is written out; nets of their borders: merging, pruning, cutting."""

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis.graph.curve_net import Arc, Net, Node, borders, moved, resampled, smoothed
from morphofold.analysis.graph.watershed import Watershed
from morphofold.errors import NotFinite, OutOfRange, WrongShape
from morphofold.geometry import edges
from morphofold.shapes import even_directions, icosphere
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.studies.folds.prominent_peaks import prominent_peaks
from morphofold.studies.known_shapes import cylinder


def made(*lines):
    """A net of straight lines between named points."""
    net, name = Net(), {}
    for a, b in lines:
        for end in (a, b):
            if end not in name:
                name[end] = net.add_node(Node(np.array([*end, 0.0])))
        points = np.linspace(net.nodes[name[a]].at, net.nodes[name[b]].at, 11)
        net.add_arc(Arc(name[a], name[b], points))
    return net


def counted(net):
    """Nodes by degree, loops, components."""
    graph = nx.MultiGraph((arc.a, arc.b) for arc in net.arcs.values())
    graph.add_nodes_from(net.nodes)
    parts, degrees = nx.number_connected_components(graph), list(net.degrees().values())
    assert sum(degree - 2 for degree in degrees) == 2 * (len(net.arcs) - len(net.nodes))
    return sorted(degrees), len(net.arcs) - len(net.nodes) + parts, parts


def consistent(net):
    """Every arc begins and ends where its nodes are."""
    for arc in net.arcs.values():
        np.testing.assert_allclose(arc.points[[0, -1]], [net.nodes[arc.a].at, net.nodes[arc.b].at], atol=1e-12)
        assert arc.length == pytest.approx(np.linalg.norm(np.diff(arc.points, axis=0), axis=1).sum())
    return net


def test_two_near_junctions_merge_into_one_between_them():
    net = made(((0, 0), (1, 0)), ((0, 0), (-3, 3)), ((0, 0), (-3, -3)), ((1, 0), (4, 3)), ((1, 0), (4, -3)))
    net.merge(0.9, 5.0)
    assert counted(net)[0] == [1, 1, 1, 1, 3, 3]
    net.merge(1.1, 5.0)
    assert counted(consistent(net))[0] == [1, 1, 1, 1, 4]
    middle = next(node for node, degree in net.degrees().items() if degree == 4)
    np.testing.assert_allclose(net.nodes[middle].at, [0.5, 0, 0])
    assert net.nodes[middle].merged == 2


def test_the_middle_of_three_that_merge_is_the_mean_of_all():
    a, b, c = (0, 0), (1, 0), (2.2, 0)
    net = made((a, b), (b, c), (a, (-3, 3)), (a, (-3, -3)), (b, (1, 5)), (c, (5, 3)), (c, (5, -3)))
    net.merge(2.0, 1.0)
    assert counted(consistent(net))[0] == [1] * 5 + [5]
    middle = next(node for node, degree in net.degrees().items() if degree == 5)
    np.testing.assert_allclose(net.nodes[middle].at[0], 3.2 / 3)


def test_spurs_go_and_what_they_leave_is_one_curve():
    net = made(((-5, 0), (0, 0)), ((0, 0), (5, 0)), ((0, 0), (0, 1)))
    net.prune(0.9)
    assert counted(net)[0] == [1, 1, 1, 3]
    net.prune(1.1)
    assert counted(consistent(net)) == ([1, 1], 0, 1)
    assert next(iter(net.arcs.values())).length == pytest.approx(10)
    net.prune(11)  # with its nodes
    assert counted(net) == ([], 0, 0)


def test_an_end_that_was_cut_is_no_spur():
    net = made(((-5, 0), (0, 0)), ((0, 0), (5, 0)), ((0, 0), (0, 1)))
    net.keep(lambda points: points[:, 1] < 0.5)
    net.prune(0.9)
    assert counted(consistent(net))[0] == [1, 1, 1, 3]
    assert sum(node.cut for node in net.nodes.values()) == 1


def test_what_is_cut_in_the_middle_falls_in_two():
    net = made(((-5, 0), (5, 0)))
    net.keep(lambda points: np.abs(points[:, 0]) > 1.5)
    assert counted(consistent(net)) == ([1, 1, 1, 1], 0, 2)
    net.keep(lambda points: np.zeros(len(points), dtype=bool))
    assert counted(net) == ([], 0, 0)


def test_small_loops_go_large_ones_stay():
    def with_loop(radius):
        net = made(((-9, 0), (0, 0)), ((0, 0), (0, -9)))
        node = next(node for node, degree in net.degrees().items() if degree == 2)
        turn = np.linspace(0, 2 * np.pi, 40)
        ring = radius * np.column_stack([1 - np.cos(turn), np.sin(turn), 0 * turn])
        ring[-1] = ring[0]
        net.add_arc(Arc(node, node, ring))
        return net

    net = with_loop(1.0)
    assert counted(net)[:2] == ([1, 1, 4], 1)
    net.merge(0.5, 6.0)
    assert counted(net)[:2] == ([1, 1, 4], 1)
    net.merge(0.5, 6.5)
    assert counted(consistent(net))[:2] == ([1, 1], 0)


@pytest.mark.parametrize("cells", [4, 40])
def test_borders_of_voronoi_cells_are_their_net(cells):
    """Each vertex belongs to the nearest of some points: as many cells, all junctions of degree 3."""
    truth = irregular_net(cells, seed=2)
    seeds = np.random.default_rng(2).standard_normal((cells, 3))
    for _ in range(4):
        seeds /= np.linalg.norm(seeds, axis=1, keepdims=True)
    verts, faces = icosphere(5)
    basin = np.argmax(verts @ seeds.T, axis=1).astype(np.int64)
    net = borders(verts, faces, edges(faces), basin, basin, verts[:, 2])
    degrees, loops, parts = counted(consistent(net))
    used = len(set(basin.tolist()))
    assert used == cells
    assert (parts, loops) == (1, cells - 1)
    assert degrees == [3] * (2 * cells - 4) == [3] * len(truth.nodes)
    for node in net.nodes.values():
        assert len(node.basins) == 3
        away = np.sort(seeds @ (node.at / np.linalg.norm(node.at)))[::-1]
        assert away[0] - away[2] < 0.1  # as far from all three
    assert not any(node.cut for node in net.nodes.values())


def test_a_border_without_junctions_is_a_loop_and_on_an_open_surface_ends_at_its_rim():
    verts, faces = icosphere(3)
    half = (verts[:, 2] > 0.1).astype(np.int64)
    assert counted(borders(verts, faces, edges(faces), half, half, verts[:, 2])) == ([2], 1, 1)
    open_ = cylinder(n_around=24, n_along=9)
    side = (open_.verts[:, 0] > 0.3).astype(np.int64)
    net = borders(open_.verts, open_.faces, edges(open_.faces), side, side, open_.verts[:, 2])
    assert counted(net) == ([1, 1, 1, 1], 0, 2)
    assert all(node.cut for node in net.nodes.values())


def test_curves_keep_their_ends():
    turn = np.linspace(0, 3, 50)
    line = np.column_stack([np.cos(turn), np.sin(turn), 0.1 * turn])
    for other in (resampled(line, 0.1), smoothed(line, 0.2)):
        np.testing.assert_allclose(other[[0, -1]], line[[0, -1]], atol=1e-12)
    steps = np.linalg.norm(np.diff(resampled(line, 0.1), axis=0), axis=1)
    assert steps.max() <= 0.1 + 1e-12
    assert np.ptp(steps) < 1e-4
    shifted = moved(line, line[0] + 1, line[-1] - 1)
    np.testing.assert_allclose(shifted[[0, -1]], [line[0] + 1, line[-1] - 1])
    np.testing.assert_allclose((shifted - line)[25], 0, atol=0.03)


def test_smoothing_takes_out_zigzags_and_leaves_straight_lines(rng):
    straight = np.linspace([0, 0, 0], [20, 0, 0], 101)
    np.testing.assert_allclose(smoothed(straight, 1.0)[:, 1:], 0, atol=1e-12)
    ragged = straight + np.outer(rng.standard_normal(101), [0, 0.1, 0])
    ragged[[0, -1]] = straight[[0, -1]]
    assert smoothed(ragged, 1.0)[:, 1].std() < 0.5 * ragged[:, 1].std()


def flooded(pairs, values, persistence):
    """Basins by lists: raise the water edge by edge, join where the shallower basin is not deep enough."""
    n = len(values)
    order = np.lexsort((np.arange(n), values))
    rank = np.argsort(order)
    near = [[] for _ in range(n)]
    for a, b in pairs.tolist():
        near[a].append(b)
        near[b].append(a)
    basin = {}
    for v in order.tolist():
        lower = [w for w in near[v] if rank[w] < rank[v]]
        basin[v] = v if not lower else basin[min(lower, key=lambda w: (values[w] - values[v], rank[w]))]
    pond, joined = {v: v for v in set(basin.values())}, {v: v for v in set(basin.values())}

    def root(of, v):
        while of[v] != v:
            v = of[v]
        return v

    crossing = [(max(values[a], values[b]), basin[a], basin[b]) for a, b in pairs.tolist() if basin[a] != basin[b]]
    for height, first, second in sorted(crossing):
        a, b = root(pond, first), root(pond, second)
        if a == b:
            continue
        deep, shallow = (a, b) if values[a] <= values[b] else (b, a)
        if height - values[shallow] < persistence:
            joined[root(joined, first)] = root(joined, second)
        pond[shallow] = deep
    return np.array([root(joined, basin[v]) for v in range(n)])


@pytest.mark.parametrize("persistence", [0.0, 0.05, 0.3, 1.0, np.inf])
def test_basins_are_those_of_a_flood(rng, persistence):
    verts, faces = icosphere(3)
    values = np.sin(5 * verts[:, 0]) + np.cos(4 * verts[:, 1]) + 0.2 * rng.standard_normal(len(verts))
    pairs = edges(faces)
    flood = Watershed(pairs, np.ones(len(pairs)), values, values).basins(persistence)
    truth = flooded(pairs, values, persistence)
    assert len({*zip(flood.tolist(), truth.tolist())}) == len(set(flood.tolist())) == len(set(truth.tolist()))
    assert set(flood.tolist()) == set(range(flood.max() + 1))


def test_what_keeps_groups_apart():
    """A chain of basins 0 - 1 - 2 - 3 that join at persistence 3, 1 and 2."""
    flood = Watershed.__new__(Watershed)
    flood.lowest = np.arange(4)
    flood.joins, flood.heights = np.array([[0, 1], [1, 2], [2, 3]]), np.array([3.0, 1.0, 2.0])
    persistences = flood.separation([{0, 1, 2}, {0, 1, 2, 3}, {0, 3}, {1, 2}], 2, least_height=0.0)
    assert persistences.tolist() == [3.0, 3.0, 3.0, 1.0]
    assert flood.separation([{0, 1, 2, 3}, {0, 1, 2}], 3, least_height=0.0).tolist() == [2.0, 1.0]
    assert np.isnan(flood.separation([{1, 2}], 2, least_height=1.5)).all()


def bumps(verts, centres, width):
    """A Gaussian of height 1 around each centre, on the unit sphere."""
    return np.exp((verts @ centres.T - 1) / width**2).max(axis=1)


@pytest.mark.parametrize(("level", "n"), [(4, 12), (5, 80), (6, 40)])
def test_bumps_are_counted_alike_on_every_mesh(level, n):
    verts, faces = icosphere(level)
    height = bumps(verts, even_directions(n), 0.4 / np.sqrt(n))
    assert len(prominent_peaks(faces, height, 0.5)) == n


def test_ripples_do_not_count(rng):
    verts, faces = icosphere(5)
    height = bumps(verts, even_directions(40), 0.06) + rng.uniform(-0.1, 0.1, len(verts))
    assert len(prominent_peaks(faces, height, 0.0)) > 500
    assert len(prominent_peaks(faces, height, 0.5)) == 40


def test_prominence_is_the_height_above_the_pass_to_higher_ground():
    """A strip of triangles with peaks 3, 2 and 5: 2 joins 3 at 1, 3 joins 5 at 0.5."""
    heights = np.repeat([0.0, 3.0, 1.0, 2.0, 0.5, 5.0, -1.0], 2)
    k = np.arange(0, len(heights) - 2, 2)
    faces = np.concatenate([np.stack([k, k + 1, k + 2], 1), np.stack([k + 1, k + 3, k + 2], 1)])
    for least, peaks in ((0, [5, 1, 3]), (1, [5, 1, 3]), (1.1, [5, 1]), (2.6, [5])):
        assert (prominent_peaks(faces, heights, least) // 2).tolist() == peaks


def test_the_highest_of_every_piece_is_a_peak_and_a_plain_has_one():
    verts, faces = icosphere(2)
    n = len(verts)
    both = np.concatenate([faces, faces + n])
    slope = verts @ [1, 0.2, 0.05]
    heights = np.concatenate([np.zeros(n), slope])
    assert prominent_peaks(both, heights, 0).tolist() == [n + slope.argmax(), 0]


def test_a_vertex_without_height_is_refused_unless_no_face_uses_it():
    _, faces = icosphere(1)
    heights = np.arange(faces.max() + 2, dtype=float)
    heights[-1] = np.nan
    assert prominent_peaks(faces, heights, 1.0)[0] == faces.max()
    heights[3] = np.nan
    with pytest.raises(NotFinite, match=r"\b1 of 42\b"):
        prominent_peaks(faces, heights, 1.0)
    with pytest.raises(WrongShape, match=r"\b41\b.*\b3\b"):
        prominent_peaks(faces, heights[:3], 1.0)
    for least in (-1, np.nan):
        with pytest.raises(OutOfRange, match=rf"\bleast\b.* {least}\.$"):
            prominent_peaks(faces, heights[:-1], least)
