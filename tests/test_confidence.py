"""Confidence of hinges: what is known to be there has it, what is put there to deceive has not."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_hinges import WIDTH, star

from morphofold.analysis.graph.gyral_graph import gyral_graph
from morphofold.analysis.graph.hinge_statistics import hinge_shapes
from morphofold.analysis.graph.hinges import LEAST_CONFIDENCE, LEAST_STRICT_CONFIDENCE, counts, hinges, label_hinges
from morphofold.analysis.graph.net_builder import CrestNetBuilder
from morphofold.analysis.measures_result import Measures
from morphofold.io import read_cortex, sample_path
from morphofold.shapes.spherical_nets import SphericalNet, irregular_net
from morphofold.studies.known_shapes import REGULAR_SOLIDS, regular_net
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface

CREST = 54.0


def labelled(graph, lowest=(1.0, 1.0, 1.0), persistence=np.nan, free=False):
    """Confidence of the hinge of a made star: bottom of sulci at 0, crests at 1 [mm], persistence asked for 1 mm."""
    for (*_, crest), low in zip(graph.edges(data=True), lowest, strict=True):
        crest.update(vertices=np.array([99]), lowest=low)
    graph.nodes[0]["persistence"] = persistence
    for node in list(graph)[1:]:
        graph.nodes[node]["cut"] = not free
    label_hinges(graph, np.r_[np.zeros(50), np.ones(50)], 1.0)
    assert all(np.isnan(graph.nodes[node]["confidence"]) for node in list(graph)[1:])
    return graph.nodes[0]["confidence"]


def test_each_margin_is_the_one_stated_and_the_least_counts():
    even = lambda **more: star(0, 120, 240, **more)
    assert labelled(even()) == 1
    assert labelled(even(), lowest=(1.0, 0.4, 0.7)) == pytest.approx(0.4)
    assert labelled(even(), lowest=(1.0, -0.4, 0.7)) == 0
    assert labelled(even(), persistence=1.3) == pytest.approx(0.3)
    assert labelled(even(), persistence=1.3, lowest=(0.2, 1, 1)) == pytest.approx(0.2)
    assert labelled(star(0, 10, 180)) == pytest.approx(2 * np.sin(np.radians(5)))
    assert labelled(star(0, 60, 180)) == pytest.approx(1)
    assert labelled(even(length=1.1 * WIDTH), free=True) == pytest.approx(0.1)
    assert labelled(even(length=1.1 * WIDTH)) == 1  # ended by the mask, not by the gyrus


def test_arms_ten_degrees_apart_are_no_t_and_are_doubtful():
    graph = star(0, 10, 180)
    assert labelled(graph) < LEAST_CONFIDENCE
    (hinge,) = hinges(graph)
    assert hinge.shape == "V"
    assert hinges(star(0, 90, 180))[0].shape == "T"


@pytest.mark.parametrize(
    "solid", ["cube", *(pytest.param(s, marks=pytest.mark.slow) for s in REGULAR_SOLIDS if s != "cube")]
)
def test_hinges_of_known_nets_are_sure(solid):
    net = regular_net(solid).rotated(Rotation.random(random_state=1).as_matrix())
    for noise in (0.0, 0.1):
        hinge_list = hinges(gyral_graph(ridged_net(net, 5, 6.0, noise=noise, rng=3)))
        assert len(hinge_list) == len(net.nodes)
        assert all(hinge.confidence >= LEAST_STRICT_CONFIDENCE for hinge in hinge_list)


def test_most_hinges_made_by_noise_are_doubtful_and_no_true_one():
    """Noise of 20 % of an edge, 0.4 mm, three times."""
    net, n_found, true_sure, false_sure = irregular_net(20, seed=5, shortest=0.12), 0, [], []
    for seed in (3, 4, 5):
        graph = gyral_graph(ridged_net(net, 5, 6.0, noise=0.2, rng=seed))
        positions = np.array([hinge.position for hinge in hinges(graph)])
        away = CREST * np.linalg.norm(
            positions[:, None] / np.linalg.norm(positions, axis=1)[:, None, None] - net.nodes, axis=2
        )
        true = np.zeros(len(positions), dtype=bool)
        true[away.argmin(axis=0)] = True
        sure = np.array([counts(node) for _, node in graph.nodes(data=True) if node["degree"] > 2])
        n_found += len(positions)
        true_sure += sure[true].tolist()
        false_sure += sure[~true].tolist()
    assert n_found > 1.2 * 3 * len(net.nodes)
    assert abs(sum(true_sure) + sum(false_sure) - 3 * len(net.nodes)) <= 0.15 * 3 * len(net.nodes)
    assert np.mean(true_sure) > 0.95
    assert np.mean(false_sure) <= 0.5


def bridged(dip):
    """A cube's net, and from edge to edge across a face a ridge that dips by a share of its height half way."""
    ends = np.array([[1.0, 0, 1.0], [-1.0, 0, 1.0]]) / 2**0.5
    cube, bridge = (
        ridged_net(net, 5, 8.0, dip=lower, rng=3)
        for net, lower in ((regular_net("cube"), 0.0), (SphericalNet(ends, np.array([[0, 1]])), dip))
    )
    height = np.linalg.norm(cube.verts, axis=1)
    grown = np.maximum(height, np.linalg.norm(bridge.verts, axis=1)) / height
    hinge_list = hinges(gyral_graph(Surface(cube.verts * grown[:, None], cube.faces)))
    positions = np.array([hinge.position for hinge in hinge_list])
    root = np.linalg.norm(CREST * ends[:, None] - positions[None], axis=2) < 5
    sure = np.array([hinge.confidence for hinge in hinge_list])
    return sure[root.any(axis=0)], sure[~root.any(axis=0)]


def test_the_deeper_a_bridge_is_buried_the_less_sure_are_its_hinges_and_they_alone():
    roots = []
    for dip in (0.5, 0.75, 0.9):
        own, others = bridged(dip)
        assert (len(own), len(others)) == (2, 8)
        assert others.min() > 0.8
        roots.append(own.max())
    assert roots[0] >= LEAST_STRICT_CONFIDENCE
    assert LEAST_STRICT_CONFIDENCE > roots[1] >= LEAST_CONFIDENCE > roots[2] - 0.05
    assert np.all(np.diff(roots) < -0.1)


@pytest.mark.slow
def test_a_short_spur_is_doubtful_and_a_gyrus_is_not():
    root = np.array([1.0, 1.0, 0.0]) / 2**0.5
    sure = {}
    for length in (11, 16):
        tip = np.cos(length / CREST) * root + np.sin(length / CREST) * np.array([0, 0, 1.0])
        surface = ridged_net(regular_net("octahedron"), 6, 7.0, blind=np.array([[root, tip]]), rng=3)
        hinge_list = hinges(gyral_graph(surface))
        (sure[length],) = [hinge.confidence for hinge in hinge_list if hinge.blind]
    assert sure[11] < LEAST_CONFIDENCE
    assert sure[16] > LEAST_STRICT_CONFIDENCE


def turned(surface, rotation, shift, order):
    """The same surface elsewhere, its vertices and triangles in another order."""
    back = np.argsort(order)
    return Surface((surface.verts @ rotation.T + shift)[order], back[surface.faces][::-1])


def test_where_a_surface_lies_and_how_it_is_numbered_changes_no_hinge(rng):
    """A law, up to the tolerance to which the depth potential is solved for."""
    surface = ridged_net(irregular_net(20, seed=5, shortest=0.12), 5, 6.0, noise=0.1, rng=3)
    rotation, shift = Rotation.random(random_state=2).as_matrix(), np.array([90.0, -30.0, 20.0])
    before = hinges(gyral_graph(surface))
    other = hinges(gyral_graph(turned(surface, rotation, shift, rng.permutation(len(surface.verts)))))
    places = np.array([hinge.position for hinge in before]) @ rotation.T + shift
    away, partner = cKDTree([hinge.position for hinge in other]).query(places)
    assert len(before) == len(other)
    assert away.max() < 0.02
    np.testing.assert_allclose([h.confidence for h in before], [other[k].confidence for k in partner], atol=0.02)


def test_doubtful_hinges_are_in_no_group_of_shapes_and_tables_without_confidence_count_all():
    verts = ridged_net(regular_net("cube"), 3, 12.0).verts
    faces = ridged_net(regular_net("cube"), 3, 12.0).faces
    cortex = Cortex(Surface(verts, faces), Surface(1.1 * verts, faces))
    arm = {"angle_deg": 120.0, "length_mm": 9.0, "curvature_per_mm": 0.01, "crest": 0}
    rows = [{"hinge": k, "degree": 3, "shape": "Y", "confidence": c} for k, c in enumerate((0.9, 0.3, 0.1))]
    ones = np.ones(len(verts))

    def shapes(hinge_rows):
        return hinge_shapes(
            Measures(
                cortex,
                {},
                {"area": ones, "H": ones},
                [],
                [{"crest": 0, "mean_H_per_mm": 0.1}],
                hinge_rows,
                [{**arm, "hinge": k, "arm": j} for k in range(3) for j in range(3)],
                {"graph_width_mm": 6.0},
            )
        )

    assert shapes(rows).hinge.tolist() == [0, 1]
    old = [{key: value for key, value in row.items() if key != "confidence"} for row in rows]
    assert shapes(old).hinge.tolist() == [0, 1, 2]
    assert shapes(rows).per_area == pytest.approx(2 / 3 * shapes(old).per_area)


@pytest.mark.slow
def test_confidence_says_which_hinges_of_a_brain_are_found_again(rng):
    """One person, 0.1 mm of noise, other lengths: what counts is found again, the doubtful less often."""
    white = read_cortex(sample_path("S1"), hemi="lh").white
    graph = gyral_graph(white)
    scales, hinge_list = graph.graph["scales"], hinges(graph)
    noisy = Surface(white.verts + 0.1 * rng.standard_normal(white.verts.shape), white.faces)
    nets = [np.array([hinge.position for hinge in hinges(gyral_graph(noisy, width=scales.width))])]
    builder = CrestNetBuilder(white)
    fields = builder.fields(scales)
    for name in ("persistence", "prune", "tip"):
        net = builder.net(fields, type(scales)(**{**vars(scales), name: 1.2 * getattr(scales, name)}))
        nets.append(np.array([net.nodes[node].at for node, degree in net.degrees().items() if degree > 2]))
    again = [cKDTree(net).query([h.position for h in hinge_list])[0] < 0.5 * scales.width for net in nets]
    found_again = np.mean(again, axis=0)
    doubtful = np.array([hinge.confidence < LEAST_CONFIDENCE for hinge in hinge_list])
    assert 0.05 < doubtful.mean() < 0.25
    assert found_again[~doubtful].mean() > 0.97
    assert found_again[doubtful].mean() < 0.9
