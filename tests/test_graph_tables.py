"""Tables of a made gyral graph on a made cortex."""

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis.graph.crest_net import GyralScales
from morphofold.analysis.graph.graph_rows import gyral_tables, region_columns
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Regions, Surface


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
