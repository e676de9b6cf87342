"""Hinges of made graphs: degree, angles, classes, arms."""

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis.graph.crest_net import GyralScales
from morphofold.analysis.graph.hinges import as_rows, hinges

WIDTH = 2.0


def star(*azimuths, length=10.0, normal=(0.0, 0.0, 1.0), blind=()):
    """A hinge at the origin with straight arms at these azimuths [degrees] in the plane z = 0."""
    graph = nx.MultiGraph(scales=GyralScales.of_width(WIDTH), surface="made", edge=0.1)
    add = dict(normal=np.array(normal), cut=False)
    graph.add_node(0, position=np.zeros(3), vertex=7, degree=len(azimuths), persistence=1.5, **add)
    for k, azimuth in enumerate(azimuths, start=1):
        turn = np.radians(azimuth)
        end = length * np.array([np.cos(turn), np.sin(turn), 0.0])
        graph.add_node(k, position=end, vertex=0, degree=1, persistence=np.nan, **add)
        line, more = np.linspace([0, 0, 0], end, 50), {"curvature": 0.01 * k, "altitude": 1.0, "lowest": 0.5}
        graph.add_edge(0, k, number=k - 1, polyline=line, length=length, blind=k in blind, **more)
    return graph


@pytest.mark.parametrize(
    ("azimuths", "shape", "angles"),
    [
        ((10, 130, 250), "Y", (120, 120, 120)),
        ((0, 100, 220), "Y", (100, 120, 140)),
        ((0, 180, 270), "T", (90, 90, 180)),
        ((0, 80, 218), "V", (80, 138, 142)),
        ((0, 80, 211), "T", None),
        ((0, 90, 180, 270), "X", (90, 90, 90, 90)),
        ((0, 72, 144, 216, 288), "star", (72,) * 5),
        ((0, 151, 240), "T", None),
    ],
)
def test_classes_go_by_the_angles(azimuths, shape, angles):
    (hinge,) = hinges(star(*azimuths))
    if angles is None:
        angles = np.diff([*azimuths, 360 + azimuths[0]])
        shape = "T" if max(angles) >= 150 else "V"
    assert hinge.shape == shape
    assert hinge.degree == len(azimuths)
    np.testing.assert_allclose(sorted(arm.angle for arm in hinge.arms), sorted(angles), atol=1e-6)
    assert (hinge.smallest, hinge.largest) == pytest.approx((min(angles), max(angles)))
    assert sum(arm.angle for arm in hinge.arms) == pytest.approx(360)


def test_arms_stand_counter_clockwise_and_the_largest_angle_comes_last():
    (hinge,) = hinges(star(250, 10, 100))  # angles 90, 150, 120 from 10 on
    assert [arm.to for arm in hinge.arms] == [1, 2, 3]
    assert [round(arm.angle) for arm in hinge.arms] == [120, 90, 150]
    (mirrored,) = hinges(star(250, 10, 100, normal=(0, 0, -1)))
    assert [round(arm.angle) for arm in mirrored.arms] == [90, 120, 150]


def test_a_loop_has_two_arms_and_an_edge_stored_the_other_way_is_turned():
    graph = star(0, 120)
    turn = np.linspace(0, 2 * np.pi, 80)
    ring = np.column_stack([-2 * (1 - np.cos(turn)) * 0.5, 2 * np.sin(turn), 0 * turn])
    graph.add_edge(0, 0, number=7, polyline=ring, length=9.0, curvature=0.1, altitude=0.0, lowest=0.0, blind=False)
    graph.edges[0, 1, 0]["polyline"] = graph.edges[0, 1, 0]["polyline"][::-1]
    (hinge,) = hinges(graph)
    assert hinge.degree == 4
    assert [arm.to for arm in hinge.arms].count(0) == 2
    first = next(arm for arm in hinge.arms if arm.to == 1)
    np.testing.assert_allclose(first.direction, [1, 0, 0], atol=1e-12)


def test_directions_are_taken_beyond_the_hinge_itself():
    """What an arm does within 0.4 widths does not count."""
    graph = star(0, 120, 240)
    line = graph.edges[0, 1, 0]["polyline"].copy()
    line[1:3, 1] += 0.05  # within 0.8 mm
    graph.edges[0, 1, 0]["polyline"] = line
    (hinge,) = hinges(graph)
    assert all(arm.angle == pytest.approx(120) for arm in hinge.arms)


def test_a_hinge_that_a_blind_gyrus_makes_is_marked():
    assert not hinges(star(0, 120, 240))[0].blind
    assert hinges(star(0, 120, 240, blind=(2,)))[0].blind
    assert not hinges(star(0, 90, 180, 270, blind=(2,)))[0].blind


def test_no_folds_no_hinges_and_rows_have_the_columns_of_the_tables():
    assert hinges(nx.MultiGraph(scales=None, surface="", edge=1.0)) == []
    rows, arms = as_rows(hinges(star(0, 120, 240)))
    assert {"hinge", "x", "y", "z", "degree", "shape", "min_angle_deg", "max_angle_deg"} <= set(rows[0])
    assert {"hinge", "arm", "angle_deg", "length_mm", "curvature_per_mm", "to_hinge"} <= set(arms[0])
    assert len(arms) == 3
