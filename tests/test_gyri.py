"""The gyral graph on spheres with ridges along known nets: every hinge and crest, no other, where they are."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morphofold.analysis.gyri import gyral_graph
from morphofold.analysis.hinge_table import hinges
from morphofold.ridges import regular_net, ridged_net

CREST = 54.0            # radius of the crests [mm]
SOLIDS = ("tetrahedron", "cube", "octahedron", "icosahedron", "dodecahedron")


def matched(graph, net):
    """The hinge of each node of the net, checked: all there, no other, of the right degree, every arc there."""
    found = hinges(graph)
    place = np.array([hinge.position for hinge in found]).reshape(-1, 3)
    place *= CREST / np.linalg.norm(place, axis=1, keepdims=True)
    assert len(found) == len(net.nodes)
    away, index = cKDTree(place).query(CREST * net.nodes)
    assert away.max() < 0.5 * graph.graph["scales"].width
    assert len(set(index.tolist())) == len(found)
    assert [found[k].degree for k in index] == net.degree.tolist()
    number = {found[k].node: node for node, k in enumerate(index)}
    joined = sorted(tuple(sorted((number[a], number[b]))) for a, b in graph.edges())
    assert joined == sorted(map(tuple, net.arcs.tolist()))
    return [found[k] for k in index], away, number


def errors(graph, net):
    """Hinge position [mm] (K,), arm angles [deg] and arm lengths (relative), all of them."""
    found, away, number = matched(graph, net)
    angles, lengths = [], []
    true = {tuple(arc): CREST * angle for arc, angle in zip(net.arcs.tolist(), net.lengths)}
    for node, hinge in enumerate(found):
        angles.extend(np.sort([arm.angle for arm in hinge.arms]) - net.arm_angles(node))
        lengths.extend(arm.length / true[tuple(sorted((node, number[arm.to])))] - 1 for arm in hinge.arms)
    return away, np.array(angles), np.array(lengths)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("solid", SOLIDS)
def test_every_hinge_and_crest_of_the_regular_solids_is_found_where_it_is(solid):
    net = regular_net(solid).rotated(Rotation.random(random_state=1).as_matrix())
    away, angles, lengths = errors(gyral_graph(ridged_net(net, 6, 6.0, rng=3)), net)
    assert np.median(away) < 0.3
    assert rms(angles) < 3
    assert rms(lengths) < 0.02
