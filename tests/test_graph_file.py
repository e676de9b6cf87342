"""The gyral graph on disk: back as it was, and files that are none refused by name."""

import json

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis import gyral_graph, hinges
from morphofold.errors import DamagedFile, Mismatch, NotReadable
from morphofold.results.hemisphere_files import read_graph, write_graph
from morphofold.shapes import icosphere
from morphofold.studies.known_shapes import regular_net
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Surface


@pytest.fixture(scope="module")
def ridged():
    surface = ridged_net(regular_net("cube"), icosphere(4), 8.0)
    return surface, gyral_graph(surface)


def same(a, b):
    return np.allclose(a, b, rtol=1e-6, atol=1e-6, equal_nan=True) if not isinstance(a, str) else a == b


def test_a_graph_comes_back_with_all_it_had(ridged, tmp_path):
    surface, graph = ridged
    write_graph(tmp_path / "lh.json", graph)
    read = read_graph(tmp_path / "lh.json", len(surface.verts))
    assert read.graph["scales"] == graph.graph["scales"]
    assert read.graph.keys() == graph.graph.keys()
    assert list(read.nodes) == list(graph.nodes)
    for node, data in graph.nodes(data=True):
        assert read.nodes[node].keys() == data.keys()
        assert all(same(read.nodes[node][key], value) for key, value in data.items())
    for (a, b, values), (c, d, expected) in zip(read.edges(data=True), graph.edges(data=True), strict=True):
        assert (a, b, values.keys()) == (c, d, expected.keys())
        assert all(same(values[key], value) for key, value in expected.items())
    assert [h.shape for h in hinges(read)] == [h.shape for h in hinges(graph)]
    plain = nx.node_link_graph(json.loads((tmp_path / "lh.json").read_text()), edges="edges")
    assert nx.is_isomorphic(plain, graph)
    with pytest.raises(Mismatch, match=r"lh\.json: "):
        read_graph(tmp_path / "lh.json", 9)  # of another surface


def test_a_graph_without_folds_comes_back(tmp_path):
    sphere = Surface(*icosphere(3, radius=50.0))
    write_graph(tmp_path / "lh.json", gyral_graph(sphere))
    read = read_graph(tmp_path / "lh.json", len(sphere.verts))
    assert len(read) == 0
    assert read.graph["scales"] is None
    assert np.isnan(read.graph["wavelength"])


@pytest.mark.parametrize("content", [{"nodes": [1, 2]}, {"edges": None}, {"graph": {"scales": "broad"}}])
def test_a_file_that_was_changed_is_refused(ridged, tmp_path, content):
    surface, graph = ridged
    path = tmp_path / "lh.json"
    write_graph(path, graph)
    path.write_text(json.dumps(json.loads(path.read_text()) | content))
    with pytest.raises(DamagedFile, match=r"lh\.json: "):
        read_graph(path, len(surface.verts))


@pytest.mark.parametrize(
    ("text", "kind"),
    [("null", NotReadable), ("", DamagedFile), ('{"nodes": [', DamagedFile), ("[" * 100_000, DamagedFile)],
)
def test_what_is_no_graph_is_refused(tmp_path, text, kind):
    path = tmp_path / "lh.json"
    path.write_text(text)
    with pytest.raises(kind, match=r"lh\.json: "):
        read_graph(path, 9)
