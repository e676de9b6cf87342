"""Hinges of made graphs: degree, angles, classes and arms, their tables, and their maps."""

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis import gyral_graph
from morphofold.analysis.graph.gyral_tables import gyral_tables, landmark_maps, region_columns
from morphofold.analysis.graph.hinges import counts, hinges
from morphofold.analysis.graph.net_builder import GyralScales
from morphofold.shapes import icosphere
from morphofold.studies.folded_ball import folded_ball
from morphofold.surface import Cortex, Regions, Surface

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


HINGES = {"Y": (0, 100, 220), "T": (0, 151, 240), "V": (0, 80, 218), "X": (0, 90, 180, 270), "star": range(0, 360, 72)}


@pytest.mark.parametrize("shape", HINGES)
def test_classes_go_by_the_angles(shape):
    azimuths = HINGES[shape]
    (hinge,) = hinges(star(*azimuths))
    angles = sorted(np.diff([*azimuths, 360 + azimuths[0]]))
    assert (hinge.shape, hinge.degree) == (shape, len(azimuths))
    np.testing.assert_allclose(sorted(arm.angle for arm in hinge.arms), angles, atol=1e-6)
    assert (hinge.smallest, hinge.largest) == pytest.approx((angles[0], angles[-1]))


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


def cortex():
    """A shell, its upper half one region, its lower another, a cap at the bottom none."""
    verts, faces = icosphere(4, 50.0)
    labels = np.where(verts[:, 2] > 0, 0, 1)
    labels[verts[:, 2] < -45] = -1
    regions = Regions(labels=labels, names=("up", "down"), colours=np.zeros((2, 3), dtype=np.uint8))
    return Cortex(Surface(0.95 * verts, faces), Surface(verts, faces), hemi="lh", regions=regions)


def meridians(shell):
    """Three meridians from pole to pole, as crests between two hinges."""
    graph = nx.MultiGraph(scales=GyralScales.of_width(6.0), surface="white", edge=1.0)
    verts = shell.white.verts
    nearest = lambda points: np.array([int(np.argmin(((verts - p) ** 2).sum(axis=1))) for p in points])
    for number, z in enumerate((1.0, -1.0)):
        point = np.array([0, 0, 47.5 * z])
        vertex, normal = int(nearest([point])[0]), np.array([0, 0, z])
        graph.add_node(number, position=point, vertex=vertex, normal=normal, degree=3, persistence=2.0, cut=False)
    turn = np.linspace(0, np.pi, 200)
    for k in range(3):
        side = np.array([np.cos(2 * k), np.sin(2 * k), 0.0])
        line = 47.5 * (np.outer(np.cos(turn), [0, 0, 1.0]) + np.outer(np.sin(turn), side))
        more = {"curvature": 0.0, "altitude": 1.0, "lowest": 0.5, "strength": 2.0, "blind": False}
        graph.add_edge(0, 1, number=k, polyline=line, vertices=nearest(line), length=47.5 * np.pi, **more)
    return graph


def test_crests_have_the_thicknesses_of_their_vertices_and_their_region():
    shell = cortex()
    height = shell.white.verts[:, 2]
    maps = {
        "gyral_thickness": np.where(height > 0, 8.0, np.nan),
        "cortical_thickness": 2.5 + 0 * height,
        "H": np.full(len(height), 0.02),
    }
    tables = gyral_tables(shell, meridians(shell), maps)
    assert [row["crest"] for row in tables["crests"]] == [0, 1, 2]
    for row in tables["crests"]:
        assert (row["from_hinge"], row["to_hinge"], row["hemi"]) == (0, 1, "lh")
        assert (row["gyral_thickness_mm"], row["cortical_thickness_mm"], row["mean_H_per_mm"]) == (8.0, 2.5, 0.02)
        assert row["region"] == "up"  # the cap has none
    assert tables["n_hinges"] == tables["n_hinges_3"] == 2
    assert tables["n_hinges_4"] == 0
    assert tables["crest_length_mm"] == pytest.approx(3 * 47.5 * np.pi)
    assert [row["region"] for row in tables["hinges"]] == ["up", None]
    assert [row["crest"] for row in tables["arms"]] == [0, 1, 2, 2, 1, 0]  # mirrored below
    nothing = gyral_tables(shell, meridians(shell), {name: np.full(len(height), np.nan) for name in maps})
    assert nothing["crests"][0]["gyral_thickness_mm"] is None


def test_regions_share_hinges_and_crests():
    shell = cortex()
    columns = region_columns(shell, meridians(shell))
    assert (columns["up"][0], columns["down"][0]) == (1, 0)
    assert columns["up"][1] == pytest.approx(1.5 * 47.5 * np.pi, rel=0.03)
    assert columns["down"][1] == pytest.approx(3 * 47.5 * np.arcsin(45 / 50), rel=0.03)
    assert region_columns(Cortex(shell.white, shell.pial), meridians(shell)) == {}


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
    vertices = [int(np.argmax(unit @ direction)) for direction in places]
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


def test_a_hinge_has_the_mean_thickness_of_its_crests_within_half_a_crown_width():
    shell = cortex()
    graph, thickness = meridians(shell), np.random.default_rng(0).uniform(1, 3, shell.n_vertices)
    crest_vertices = np.unique(np.concatenate([edge["vertices"] for *_, edge in graph.edges(data=True)]))
    for row in gyral_tables(shell, graph, {"cortical_thickness": thickness})["hinges"]:
        pole = np.array([0, 0, row["z"]])
        near = [v for v in crest_vertices if np.linalg.norm(shell.white.verts[v] - pole) <= 3]  # of a width of 6 mm
        assert row["cortical_thickness_mm"] == pytest.approx(thickness[near].mean())
