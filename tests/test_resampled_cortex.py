"""Preset of the measuring room: copies of a cortex, thinned and split, and what is carried back from them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis import measure, resampled_cortex
from morphofold.analysis.resampled_cortex import Preset, resampled
from morphofold.errors import UnknownName
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.studies.folded_ball import CORTICAL_THICKNESS_MM, RIDGE_HEIGHT_MM, SPHERE_RADIUS_MM, folded_ball
from morphofold.studies.known_shapes import ridged_sphere
from morphofold.surface import Cortex, Regions, Surface

THIN, SPLIT = Preset(4000, 0, 6.0), Preset(0, 2600, 12.0)


@pytest.fixture(scope="module")
def ball():
    return folded_ball(12_000)


@pytest.fixture(scope="module")
def thinned(ball):
    return resampled(ball, THIN)


def shell(level=4, gap=3.0, **more):
    verts, faces = icosphere(level, 50.0)
    return Cortex(Surface((1 - gap / 50) * verts, faces), Surface(verts, faces), **more)


def test_splitting_keeps_the_surface_its_vertices_and_which_triangle_came_from_which(rough):
    verts, faces = geometry.split(rough.verts, rough.faces)
    n, m = len(rough.verts), len(rough.faces)
    assert (len(verts), len(faces)) == (n + len(geometry.edges(rough.faces)), 4 * m)
    np.testing.assert_array_equal(verts[:n], rough.verts)
    parents = geometry.face_areas(rough.verts, rough.faces)
    np.testing.assert_allclose(geometry.face_areas(verts, faces).reshape(4, m), np.tile(parents / 4, (4, 1)))
    normals = geometry.face_normals(rough.verts, rough.faces)
    of_parts = geometry.face_normals(verts, faces).reshape(4, m, 3)
    np.testing.assert_allclose(of_parts, np.tile(normals, (4, 1, 1)), atol=1e-9)
    assert geometry.is_closed(faces)
    assert geometry.euler_characteristic(faces) == 2


def test_a_thinned_copy_has_about_as_many_vertices_as_asked_and_lies_where_the_original_does(ball, thinned):
    copy, n = thinned.cortex, thinned.cortex.n_vertices
    assert n == pytest.approx(4000, abs=10)
    np.testing.assert_array_equal(thinned.target[thinned.source], np.arange(n))
    edge = geometry.mean_edge_length(ball.pial.verts, ball.faces)
    for thin, whole in ((copy.white, ball.white), (copy.pial, ball.pial)):
        assert np.quantile(np.linalg.norm(thin.verts - whole.verts[thinned.source], axis=1), 0.99) < edge
        areas = [geometry.face_areas(s.verts, s.faces).sum() for s in (thin, whole)]
        assert areas[0] == pytest.approx(areas[1], rel=0.01)
    shift = ball.pial.verts[ball.faces[thinned.triangle]].mean(axis=1) - copy.pial.verts[copy.faces].mean(axis=1)
    assert np.quantile(np.linalg.norm(shift, axis=1), 0.99) < 4 * edge


def test_a_mesh_that_is_fine_enough_and_not_too_fine_is_no_copy_at_all():
    cortex = shell()
    assert resampled(cortex, Preset(2562, 2562, 12.0)).cortex is cortex
    assert resampled(cortex, Preset(2561, 0, 12.0)).changed
    assert resampled(cortex, Preset(0, 2563, 12.0)).cortex.n_vertices == 10242


@pytest.mark.parametrize("accuracy", [THIN, SPLIT])
def test_thickness_of_a_shell_comes_back_from_its_copy(accuracy):
    cortex = shell(5) if accuracy is THIN else shell(4)
    copy = resampled(cortex, accuracy)
    assert copy.changed
    thickness = copy.cortical_thickness(cap=None)
    edge = max(geometry.mean_edge_length(c.pial.verts, c.faces) for c in (cortex, copy.cortex))
    assert thickness.shape == (cortex.n_vertices,)
    assert np.abs(thickness - 3).max() < 3 * edge**2 / 8 / 47  # thrice the sag of an even triangle


@pytest.mark.parametrize(("level", "accuracy"), [pytest.param(5, THIN, marks=pytest.mark.slow), (4, SPLIT)])
def test_gyral_width_of_ridges_comes_back_from_their_copy(level, accuracy):
    cortex, chord = ridged_sphere(level, 8.0, ridges=8, rng=0)
    widths = resampled(cortex, accuracy).gyral_thickness()
    assert widths.median == pytest.approx(chord, rel=0.03)  # 0.02 is that of the measure itself
    assert widths.per_vertex.shape == widths.relief.height.shape == (cortex.n_vertices,)
    assert np.nanmedian(widths.per_vertex) == pytest.approx(chord, rel=0.05)
    middle = cortex.pial.verts[cortex.faces[widths.triangle]].mean(axis=1)
    edge = geometry.mean_edge_length(cortex.pial.verts, cortex.faces)
    assert np.quantile(np.linalg.norm(middle - widths.points, axis=1), 0.99) < 4 * edge
    north = cortex.pial.verts[:, 2] > 0  # half of them by symmetry
    assert widths.contour_where(north, cortex.faces) == pytest.approx(np.nansum(widths.weight) / 2, rel=0.1)
    masked = resampled(cortex, accuracy).gyral_thickness(mask=north)
    assert (masked.points[:, 2] > -edge).all()


def test_hinges_of_a_copy_are_those_of_the_net_and_lie_on_the_surface_itself(ball):
    graph = resampled(ball, Preset(6000, 0, 6.0)).gyral_graph(None)
    nodes = [node for _, node in graph.nodes(data=True) if node["degree"] > 2]
    points = np.array([node["position"] for node in nodes])
    true = irregular_net(60).nodes * (SPHERE_RADIUS_MM + RIDGE_HEIGHT_MM - CORTICAL_THICKNESS_MM)
    assert (cKDTree(true).query(points)[0] < 4.5).all()  # half the width of a ridge
    assert (cKDTree(points).query(true)[0] < 4.5).all()
    places = np.concatenate([points, *(line for *_, line in graph.edges(data="polyline"))])
    vertices = np.concatenate([[node["vertex"] for node in nodes], *(v for *_, v in graph.edges(data="vertices"))])
    mesh = trimesh.Trimesh(ball.white.verts, ball.faces, process=False)
    planes = mesh.face_normals[mesh.vertex_faces[vertices]]  # of the triangles at the nearest vertex
    off = np.abs(np.einsum("pfk,pk->pf", planes, places - ball.white.verts[vertices]))
    assert off.min(axis=1).max() < 1e-9
    np.testing.assert_array_equal(vertices[: len(points)], cKDTree(ball.white.verts).query(points)[1])


def test_a_vertex_that_no_face_uses_has_no_value_on_a_thinned_copy():
    cortex = shell(5)
    white, pial = (np.concatenate([[[0.0, 0, 0]], s.verts]) for s in (cortex.white, cortex.pial))
    lone = Cortex(Surface(white, cortex.faces + 1), Surface(pial, cortex.faces + 1))
    thickness = resampled(lone, THIN).cortical_thickness(cap=None)
    assert np.isnan(thickness[0])
    np.testing.assert_array_equal(thickness[1:], resampled(cortex, THIN).cortical_thickness(cap=None))


@pytest.mark.slow
def test_measure_says_its_accuracy_and_keeps_mask_regions_and_meshes_own_numbers(ball, monkeypatch):
    monkeypatch.setitem(resampled_cortex.PRESETS, "draft", THIN)
    x = ball.pial.verts[:, 0]
    regions = Regions((x > 0).astype(np.int64), ("left", "right"), np.zeros((2, 3), np.uint8))
    cortex = replace(ball, cortex=ball.pial.verts[:, 2] > -40, regions=regions)
    draft, standard = measure(cortex, accuracy="draft"), measure(cortex)
    for name, values in standard.maps.items():
        differ = np.isfinite(draft.maps[name]) != np.isfinite(values)  # a way to a sample may leave the mask
        assert differ.mean() <= (0.02 if name == "gyral_thickness" else 0), name
    same = {"H", "K", "k1", "k2", "sulcal_depth", "area", "shape_index", "curvedness"}
    assert all(np.array_equal(draft.maps[name], standard.maps[name], equal_nan=True) for name in same)
    whole = ("n_vertices", "euler_characteristic", "area_pial_mm2", "gyrification_index", "folding_index")
    assert all(draft.scalars[name] == standard.scalars[name] for name in whole)
    for name in ("median_gyral_thickness_mm", "crest_length_mm"):
        assert draft.scalars[name] == pytest.approx(standard.scalars[name], rel=0.03)
    for row, expected in zip(draft.regions, standard.regions):
        assert row["gyral_thickness_mm"] == pytest.approx(expected["gyral_thickness_mm"], rel=0.05)
    assert draft.parameters["accuracy"] == "draft"
    assert draft.parameters["accuracy_vertices"] == pytest.approx(4000, abs=10)
    assert draft.parameters["local_gyrification_voxel_mm"] == 2.5
    assert "in place of 12,000" in draft.notes["accuracy"]
    assert "accuracy" not in standard.notes


def test_an_accuracy_of_another_name_is_refused():
    with pytest.raises(UnknownName, match=r"\baccuracy\b.* draft, standard, fine\b.*'best'"):
        measure(shell(3), accuracy="best")
