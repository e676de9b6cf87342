"""Hinges and crests as maps."""

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis import gyral_graph
from morphofold.analysis.graph.graph_rows import landmark_maps
from morphofold.analysis.graph.hinges import counts
from morphofold.shapes import icosphere
from morphofold.shapes.folded_ball import folded_ball
from morphofold.surface import Cortex, Surface

RADIUS = 50.0


@pytest.fixture(scope="module")
def ball():
    verts, faces = icosphere(5)
    return Cortex(Surface(RADIUS * verts, faces), Surface(1.05 * RADIUS * verts, faces))


@pytest.fixture(scope="module")
def folded():
    cortex = folded_ball(20_000)
    return cortex, gyral_graph(cortex)


def graph_at(cortex, places):
    """A graph with a hinge at the vertex nearest to each direction, and a crest between the first two."""
    unit = cortex.white.verts / RADIUS
    vertices = [int(np.argmax(unit @ place)) for place in places]
    graph = nx.MultiGraph()
    for k, vertex in enumerate(vertices):
        graph.add_node(k, vertex=vertex, degree=3, confidence=1.0)
    ends = np.array(vertices[:2])
    line = cortex.white.verts[ends]
    graph.add_edge(0, 1, polyline=line, vertices=ends, length=float(np.linalg.norm(line[1] - line[0])))
    return graph, vertices


def test_distances_on_a_ball_are_those_along_great_circles(ball):
    places = np.array([[0.0, 0, 1], [1, 0, 0]])
    graph, vertices = graph_at(ball, places)
    maps = landmark_maps(ball, graph)
    unit = ball.white.verts / RADIUS
    distance = RADIUS * np.arccos(np.clip(unit @ unit[vertices].T, -1, 1)).min(axis=1)
    assert (maps["hinge_distance"][vertices] == 0).all()
    np.testing.assert_allclose(maps["hinge_distance"], distance, rtol=0.08, atol=0.2)
    far = distance > 5
    assert np.mean(maps["hinge_distance"][far] / distance[far]) == pytest.approx(1.04, abs=0.03)


def test_there_is_no_distance_where_there_is_nothing(ball):
    maps = landmark_maps(ball, nx.MultiGraph())
    assert np.isnan([maps["hinge_distance"], maps["crest_distance"]]).all()
    assert not maps["hinges"].any()


def test_amounts_sum_to_the_hinges_and_the_length_of_the_crests_and_every_hinge_lies_on_a_crest(folded):
    cortex, graph = folded
    maps = landmark_maps(cortex, graph)
    hinges = sum(node["degree"] > 2 and counts(node) for _, node in graph.nodes(data=True))
    assert hinges > 50
    assert maps["hinges"].sum() == hinges
    assert maps["crest_length"].sum() == pytest.approx(sum(c["length"] for *_, c in graph.edges(data=True)))

    assert maps["crest_distance"][maps["hinges"] > 0].max() < 2.0
    assert (maps["crest_distance"] <= maps["hinge_distance"] + 2.0).all()
