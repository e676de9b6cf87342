"""Spherical nets, and spheres with ridges along them."""

import numpy as np
import pytest

from morphofold.errors import NoSolution
from morphofold.shapes.ridges import irregular_net, ridged_net
from morphofold.studies.shapes import arm_angles, regular_net

#: of each solid the degree of its corners and the number of its faces
SOLIDS = {"tetrahedron": (3, 4), "cube": (3, 6), "octahedron": (4, 8), "icosahedron": (5, 20), "dodecahedron": (3, 12)}


@pytest.mark.parametrize("solid", SOLIDS)
def test_regular_nets_obey_euler_and_have_equal_arms(solid):
    net, (degree, faces) = regular_net(solid), SOLIDS[solid]
    assert set(net.degree.tolist()) == {degree}
    assert len(net.nodes) - len(net.arcs) + faces == 2
    np.testing.assert_allclose(net.lengths, net.lengths[0])
    for node in range(len(net.nodes)):
        np.testing.assert_allclose(arm_angles(net, node), 360 / degree)


@pytest.mark.parametrize("cells", [6, 60])
def test_irregular_nets_are_of_degree_three_and_their_angles_add_up(cells):
    net = irregular_net(cells, seed=3, shortest=0.03)
    assert (len(net.nodes), len(net.arcs)) == (2 * cells - 4, 3 * cells - 6)
    assert (net.degree == 3).all()
    assert net.lengths.min() >= 0.03
    assert all(arm_angles(net, node).sum() == pytest.approx(360) for node in range(len(net.nodes)))
    np.testing.assert_array_equal(net.nodes, irregular_net(cells, seed=3, shortest=0.03).nodes)


def test_an_irregular_net_without_short_arcs_can_be_too_much_to_ask():
    with pytest.raises(NoSolution, match=r"\b200\b.*\b20\b.*\b1 rad\b"):
        irregular_net(20, shortest=1.0)


def test_ridges_have_their_height_width_and_dip():
    net = regular_net("octahedron")
    surface = ridged_net(net, 6, 6.0, dip=0.7)
    radius = np.linalg.norm(surface.verts, axis=1)
    directions = surface.verts / radius[:, None]
    assert radius.max() == pytest.approx(54, abs=1e-3)
    assert radius.min() == pytest.approx(50, abs=1e-6)
    middle = np.array([1, 1, 0]) / 2**0.5  # of an arc
    assert radius[np.argmax(directions @ middle)] == pytest.approx(50 + 0.3 * 4, abs=0.02)
    aside = np.sin(3 / 50) * np.array([0, 0, 1]) + np.cos(3 / 50) * middle
    assert radius[np.argmax(directions @ aside)] == pytest.approx(50 + 0.5 * 0.3 * 4, abs=0.1)


def test_noise_is_a_share_of_the_mean_edge():
    net = regular_net("cube")
    clean, noisy = (ridged_net(net, 5, 6.0, noise=noise, rng=4) for noise in (0.0, 0.1))
    pairs = np.concatenate([clean.faces[:, [0, 1]], clean.faces[:, [1, 2]], clean.faces[:, [2, 0]]])
    edge = np.linalg.norm(clean.verts[pairs[:, 0]] - clean.verts[pairs[:, 1]], axis=1).mean()
    assert (noisy.verts - clean.verts).std() == pytest.approx(0.1 * edge, rel=0.02)


def test_a_blind_ridge_ends_where_it_is_told():
    net = regular_net("octahedron")
    a, b = np.array([1, 1, 0]) / 2**0.5, np.array([1, 1, 0.6]) / np.linalg.norm([1, 1, 0.6])
    surface = ridged_net(net, 6, 6.0, blind=np.array([[a, b]]))
    radius = np.linalg.norm(surface.verts, axis=1)
    directions = surface.verts / radius[:, None]
    beyond = np.array([1, 1, 0.9]) / np.linalg.norm([1, 1, 0.9])
    assert radius[np.argmax(directions @ b)] == pytest.approx(54, abs=0.1)
    assert radius[np.argmax(directions @ beyond)] < 50.2
