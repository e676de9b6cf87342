"""Basins by flooding, against a flood that is written out."""

import numpy as np
import pytest

from morphofold.analysis.graph.watershed import Watershed
from morphofold.geometry import edges
from morphofold.shapes import icosphere


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
    for height, one, two in sorted(crossing):
        a, b = root(pond, one), root(pond, two)
        if a == b:
            continue
        deep, shallow = (a, b) if values[a] <= values[b] else (b, a)
        if height - values[shallow] < persistence:
            joined[root(joined, one)] = root(joined, two)
        pond[shallow] = deep
    return np.array([root(joined, basin[v]) for v in range(n)])


@pytest.mark.parametrize("persistence", [0.0, 0.05, 0.3, 1.0, np.inf])
def test_basins_are_those_of_a_flood(rng, persistence):
    verts, faces = icosphere(3)
    values = np.sin(5 * verts[:, 0]) + np.cos(4 * verts[:, 1]) + 0.2 * rng.standard_normal(len(verts))
    pairs = edges(faces)
    found = Watershed(pairs, np.ones(len(pairs)), values, values).basins(persistence)
    truth = flooded(pairs, values, persistence)
    assert len({*zip(found.tolist(), truth.tolist())}) == len(set(found.tolist())) == len(set(truth.tolist()))
    assert set(found.tolist()) == set(range(found.max() + 1))


def test_every_basin_has_one_lowest_vertex_and_lasts_as_long_as_it_is_deep():
    """Two pits of depth 1 and 0.4 under a pass at 0."""
    verts, faces = icosphere(4)
    away = [np.linalg.norm(verts - pole, axis=1) for pole in ([0, 0, 1], [0, 0, -1])]
    values = -1.0 * np.exp(-((away[0] / 0.6) ** 2)) - 0.4 * np.exp(-((away[1] / 0.6) ** 2))
    found = Watershed(edges(faces), np.ones(len(edges(faces))), values, values)
    deep = found.heights > 0.05
    assert deep.sum() == 1
    assert found.heights[deep][0] == pytest.approx(0.4, abs=0.01)
    assert len(set(found.basins(0.39).tolist())) == 2
    assert len(set(found.basins(0.41).tolist())) == 1


def test_what_keeps_groups_apart():
    """A chain of basins 0 - 1 - 2 - 3 that join at persistence 3, 1 and 2."""
    found = Watershed.__new__(Watershed)
    found.lowest = np.arange(4)
    found.joins, found.heights = np.array([[0, 1], [1, 2], [2, 3]]), np.array([3.0, 1.0, 2.0])
    held = found.separation([{0, 1, 2}, {0, 1, 2, 3}, {0, 3}, {1, 2}], 2, above=0.0)
    assert held.tolist() == [3.0, 3.0, 3.0, 1.0]
    assert found.separation([{0, 1, 2, 3}, {0, 1, 2}], 3, above=0.0).tolist() == [2.0, 1.0]
    assert np.isnan(found.separation([{1, 2}], 2, above=1.5)).all()
