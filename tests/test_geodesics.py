"""Shortest ways on surfaces."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from morphofold.analysis.geodesics import cheapest_path, path_graph, shorten, step_prices
from morphofold.shapes import icosphere


def test_ways_on_a_sphere_are_a_few_percent_long():
    verts, faces = icosphere(5, radius=10.0)
    length = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), length, np.array([0]), np.ones(len(verts), dtype=bool))
    true = 10 * np.arccos(np.clip(verts @ verts[0] / 100, -1, 1))
    far = true > 2
    assert (length[far] >= true[far] * (1 - 1e-3)).all()  # chords: a little shorter than the sphere
    assert np.mean(length[far] / true[far]) == pytest.approx(1.03, abs=0.015)


def test_ways_are_dijkstras_and_stay_within(rng):
    verts, faces = icosphere(3)
    graph = path_graph(verts, faces)
    np.testing.assert_allclose((graph - graph.T).toarray(), 0)
    length = np.full(len(verts), np.inf)
    shorten(graph, length, np.array([3, 77]), np.ones(len(verts), dtype=bool))
    np.testing.assert_allclose(length, dijkstra(graph, indices=[3, 77]).min(axis=0))
    before = length.copy()
    shorten(graph, length, np.array([200]), np.ones(len(verts), dtype=bool))
    np.testing.assert_allclose(length, np.minimum(before, dijkstra(graph, indices=200)))
    upper = verts[:, 2] > 0
    length = np.full(len(verts), np.inf)
    shorten(graph, length, np.flatnonzero(upper)[:1], upper)
    assert np.isfinite(length[upper]).all()
    assert np.isinf(length[~upper]).all()


def test_the_cheapest_path_keeps_to_the_cheap_side():
    verts, faces = icosphere(4)
    graph = path_graph(verts, faces)
    start, end = int(np.argmax(verts[:, 0])), int(np.argmin(verts[:, 0]))
    goals = np.zeros(len(verts), dtype=bool)
    goals[end] = True
    everywhere = np.ones(len(verts), dtype=bool)
    for side in (1, -1):
        prices = step_prices(graph, np.where(side * verts[:, 2] > 0.1, 1.0, 9.0))
        path = cheapest_path(prices, start, goals, everywhere)
        assert (path[0], path[-1]) == (start, end)
        assert (side * verts[path[5:-5], 2] > 0).all()
        assert (graph[path[:-1], path[1:]] > 0).all()
    assert len(cheapest_path(graph, start, goals, verts[:, 2] > 2)) == 0
