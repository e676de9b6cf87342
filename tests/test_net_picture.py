"""The gyral net painted on its surface."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from morphofold.analysis import Measures, gyral_graph, sulcal_depth
from morphofold.report.pictures import gyral_net
from morphofold.studies.known_shapes import regular_net
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface


def bytes_of(colour):
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


@pytest.fixture(scope="module")
def measures():
    white = ridged_net(regular_net("octahedron"), 5, 6.0, rng=3)
    cortex = Cortex(white, Surface(1.05 * white.verts, white.faces), name="octahedron")
    depth = sulcal_depth(white.verts, white.faces)
    return Measures(cortex, {}, {"sulcal_depth": depth}, graph=gyral_graph(white))


def test_hinges_have_the_colour_of_their_arms_and_crests_are_dark(measures):
    row = gyral_net.net_row(measures, "octahedron")
    verts = measures.cortex.white.verts
    tree = cKDTree(verts)
    net = regular_net("octahedron")
    assert (row.rgb[tree.query(54 * net.nodes)[1]] == bytes_of(gyral_net.COLOUR_BY_ARMS[4])).all()
    middle = net.nodes[net.arcs].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    assert (
        row.rgb[tree.query(54 * middle)[1]] == bytes_of(gyral_net.CREST_COLOUR)
    ).mean() > 0.7  # a line one edge wide
    faces = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / 3**0.5
    bare = row.rgb[tree.query(50 * faces)[1]].astype(int)
    assert (bare.max(axis=1) - bare.min(axis=1) < 30).all()  # a shade of the bare surface
    assert not (bare == bytes_of(gyral_net.CREST_COLOUR)).all(axis=1).any()


def test_a_doubtful_hinge_is_grey_whatever_its_arms(measures):
    graph = measures.graph.copy()
    hinge = next(node for node, data in graph.nodes(data=True) if data["degree"] > 2)
    graph.nodes[hinge]["confidence"] = 0.2
    rgb = gyral_net.net_row(replace(measures, graph=graph), "octahedron").rgb
    vertices = [data["vertex"] for _, data in graph.nodes(data=True)]
    assert [(rgb[v] == bytes_of(gyral_net.DOUBTFUL_COLOUR)).all() for v in vertices] == [
        node == hinge for node in graph
    ]


def test_a_hinge_off_the_vertices_of_a_net_without_width_is_drawn(measures):
    graph = measures.graph.copy()
    graph.graph["scales"] = None
    for _, node in graph.nodes(data=True):
        node["position"] = node["position"] + 0.1 * graph.graph["edge"]
    hinges = [data for _, data in graph.nodes(data=True) if data["degree"] > 2]
    rgb = gyral_net.net_row(replace(measures, graph=graph), "octahedron").rgb
    assert all((rgb[hinge["vertex"]] == bytes_of(gyral_net.COLOUR_BY_ARMS[hinge["degree"]])).all() for hinge in hinges)
