"""The study of accuracy, measuring room: its errors by other calculations, at small sizes; what it says of failures."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pytest

from morphofold.analysis import accuracy_presets, curvature, measure, vertex_areas
from morphofold.shapes.folded_ball import folded_ball
from morphofold.shapes.ridges import irregular_net
from morphofold.studies.accuracy import accuracy_measuring, measuring_folds, measuring_person
from morphofold.studies.accuracy import points as timing
from morphofold.studies.accuracy.accuracy_measuring import GAP, H, K, bumpy, relative_rms
from morphofold.studies.accuracy.accuracy_study import measuring_cases
from morphofold.studies.accuracy.peers import Peer
from morphofold.studies.shapes import bumpy_sphere, torus

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change


def by(points, **wanted):
    """Points whose fields are as wanted."""
    return [p for p in points if all(getattr(p, name) == value for name, value in wanted.items())]


@pytest.fixture(autouse=True)
def once(monkeypatch):
    """All work is long, so that it is done once."""
    for module in (timing, measuring_person):
        monkeypatch.setattr(module, "LONG", 0.0)


@pytest.fixture
def alone(monkeypatch):
    """No peers."""
    monkeypatch.setattr(accuracy_measuring, "curvature_peers", list)
    monkeypatch.setattr(accuracy_measuring, "closest_peers", list)


def test_the_error_of_a_field_is_weighed_by_area_and_counts_what_is_missing_as_zero():
    exact, areas = np.array([1.0, -2.0, 3.0]), np.array([1.0, 1.0, 2.0])
    assert relative_rms(exact, exact, areas) == 0
    assert relative_rms(-exact, exact, areas) == pytest.approx(2)
    missing = np.array([1.0, np.nan, 4.0])
    assert relative_rms(missing, exact, areas) == pytest.approx(math.sqrt((4 + 2 * 1) / (1 + 4 + 18)))


@pytest.mark.slow
def test_curvature_errors_are_those_of_another_calculation_and_fall_with_the_mesh(alone):
    points = accuracy_measuring.curvature_over_meshes("bumpy sphere", partial(bumpy, noise=0.0), (3, 4, 5))
    assert {p.axis for p in points} == {"mesh", "mesh at 3 mm"}
    for quantity in (H, K):
        errors = [p.error for p in by(points, axis="mesh", quantity=quantity)]
        orders = -np.diff(np.log2(errors))
        assert orders[-1] > 1.5  # second once bumps are resolved
        assert (orders > 0).all()
    shape = bumpy(4, 0.0)
    found, corner = curvature(shape.verts, shape.faces), shape.verts[shape.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    for quantity, field in ((H, "H"), (K, "K")):
        got, want = (getattr(x, field)[shape.faces] for x in (found, shape))  # thirds of triangles at corners
        expected = math.sqrt((area @ ((got - want) ** 2).sum(axis=1)) / (area @ (want**2).sum(axis=1)))
        (mine,) = by(points, axis="mesh", quantity=quantity, size=2562)
        assert mine.error == pytest.approx(expected, rel=1e-6)
        assert mine.fastest <= mine.seconds <= mine.slowest


@pytest.mark.slow
def test_a_wrong_sign_is_an_error_of_two(alone, monkeypatch):
    def turned(verts, faces, scale):
        found = curvature(verts, faces, scale)
        return replace(found, k1=-found.k2, k2=-found.k1)

    monkeypatch.setattr(accuracy_measuring, "curvature", turned)
    points = accuracy_measuring.curvature_over_scales("torus", lambda level: torus(80, 32), 0)
    assert [p.value for p in by(points, quantity=H)] == list(accuracy_measuring.SCALES)
    assert all(p.error == pytest.approx(2, abs=0.2) for p in by(points, quantity=H))
    assert all(p.error < 0.3 for p in by(points, quantity=K))  # of which the sign is none


def test_the_scale_of_measure_is_three_millimetres_or_two_and_a_half_edges(alone, monkeypatch):
    asked = []
    flat = lambda verts: SimpleNamespace(H=np.zeros(len(verts)), K=np.zeros(len(verts)))
    monkeypatch.setattr(accuracy_measuring, "curvature", lambda v, f, scale: asked.append(scale) or flat(v))
    accuracy_measuring.curvature_over_meshes("bumpy sphere", partial(bumpy, noise=0.0), (3, 6))
    shape = bumpy(3, 0.0)
    assert asked == [None, pytest.approx(2.5 * curvature(shape.verts, shape.faces).scale / 3), None, 3.0]


def test_a_peer_that_fails_is_a_point_that_says_so(monkeypatch):
    def fails(verts, faces):
        raise RuntimeError("too few neighbours\nand more")

    broken = Peer("broken thing", ("numpy",), fails, 2)
    monkeypatch.setattr(accuracy_measuring, "curvature_peers", lambda: [broken])
    points = accuracy_measuring.curvature_over_scales("bumpy sphere", partial(bumpy, noise=0.0), 4)
    (failed,) = by(points, method="broken thing")
    assert math.isnan(failed.error)
    assert math.isnan(failed.seconds)
    assert failed.repeats == 0
    assert failed.setting == "2 rings or edges: failed, RuntimeError: too few neighbours"


def test_our_own_failures_are_no_points(alone, monkeypatch):
    monkeypatch.setattr(accuracy_measuring, "curvature", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        accuracy_measuring.curvature_over_scales("bumpy sphere", partial(bumpy, noise=0.0), 4)


def test_the_pair_is_parallel_and_its_partners_have_slid():
    inner, outer = accuracy_measuring.parallel_pair(4)
    apart = np.linalg.norm(inner.verts - outer.verts, axis=1)
    assert np.median(apart) > GAP + 0.1
    directions = inner.verts / np.linalg.norm(inner.verts, axis=1, keepdims=True)
    many = bumpy_sphere(6)  # no point of the surface is nearer
    nearest = np.linalg.norm(many.verts[None] - inner.verts[:50, None], axis=2).min(axis=1)
    assert (nearest > GAP - 1e-9).all()
    assert nearest.max() < math.hypot(GAP + 0.03, 1.1)  # an edge of the many is 1 to 2 mm
    above = bumpy_sphere((directions, outer.faces))
    assert (np.linalg.norm(above.verts - inner.verts, axis=1) >= GAP - 1e-9).all()


@pytest.mark.slow
def test_thickness_errors_fall_with_the_mesh_and_agree_with_an_exact_peer():
    pytest.importorskip("igl")
    points = accuracy_measuring.thickness_over_meshes((3, 4))
    ours = by(points, axis="mesh", method="morphofold")
    assert ours[1].error < ours[0].error / 2.5
    exact = by(points, method="libigl point_mesh_squared_distance")
    for mine, theirs in zip(ours, exact):
        assert mine.error == pytest.approx(theirs.error, rel=0.05)
        assert by(points, axis="mesh, nearest vertex", size=mine.size)[0].error > 2 * mine.error
    assert all(p.error > 2 * mine.error for mine, p in zip(ours, by(points, method="scipy cKDTree of vertices")))


def test_a_net_found_exactly_has_no_error_and_a_hinge_too_far_off_is_none():
    net = irregular_net(6, shortest=0.2)
    crown = measuring_folds.SPHERE_RADIUS_MM + measuring_folds.RIDGE_HEIGHT_MM
    graph = nx.MultiGraph()
    for k, node in enumerate(net.nodes):
        graph.add_node(k, position=crown * node, degree=3)
    for a, b in net.arcs.tolist():
        arc = np.linspace(net.nodes[a], net.nodes[b], 9)
        graph.add_edge(a, b, polyline=crown * arc / np.linalg.norm(arc, axis=1, keepdims=True))
    assert measuring_folds.net_errors(graph, net) == pytest.approx(
        {"hinges": 0, "hinge places": 0, "crest lines": 0}, abs=1e-7
    )
    aside = np.cross(net.nodes[0], [0, 0.6, 0.8])
    graph.nodes[0]["position"] = crown * net.nodes[0] + 6 * aside / np.linalg.norm(aside)  # over half a width of 9
    n = len(net.nodes)
    assert measuring_folds.net_errors(graph, net)["hinges"] == pytest.approx(1 / n)
    assert measuring_folds.net_errors(nx.MultiGraph(), net)["hinges"] == 1


def test_two_hinges_found_at_one_are_one_hit():
    true, found = np.zeros((1, 3)), np.array([[0.1, 0, 0], [0, 0.2, 0]])
    assert measuring_folds.f1(found, true, 1.0) == pytest.approx(2 / 3)
    assert measuring_folds.f1(found, true, 0.05) == 0
    assert measuring_folds.f1(np.empty((0, 3)), true, 1.0) == 0


@pytest.mark.slow
def test_folds_are_better_known_on_finer_meshes_and_the_fine_accuracy_is_a_finer_mesh(monkeypatch):
    monkeypatch.setitem(accuracy_presets.PRESETS, "fine", accuracy_presets.Preset(0, 2001, 12.0))
    points = measuring_folds.net_over_meshes((2000, 8000))
    coarse, finer = by(points, axis="mesh", quantity="crest lines")
    assert finer.error < coarse.error / 2
    fine = by(points, axis="accuracy", quantity="crest lines", preset="fine", size=2000)[0]
    assert fine.error < 0.75 * coarse.error
    same = by(points, axis="accuracy", size=2000, quantity="crest lines", preset="standard")[0]
    assert (same.error, same.seconds) == (coarse.error, coarse.seconds)


@pytest.mark.slow
def test_widths_and_local_gyrification_of_known_shapes_are_within_their_bounds():
    sheets = measuring_folds.width_of_sheet((3.0, 2.0))
    assert all(p.error < 0.02 for p in sheets)
    draft, finer = measuring_folds.gyrification_of_sphere((6.0, 8.0))
    assert (draft.preset, finer.preset) == ("draft", "")
    assert (draft.value, draft.setting) == (2.5, "2.5 mm")
    assert 0 < draft.error < 0.05


@pytest.mark.slow
def test_errors_of_a_person_are_those_against_the_split_surface(monkeypatch):
    monkeypatch.setitem(accuracy_presets.PRESETS, "fine", accuracy_presets.Preset(0, 2501, 12.0))
    cortex = replace(folded_ball(2500), units="cm")  # has no local index
    points = measuring_person.measures_of_person((2000,), cortex)
    truth, plain = measure(measuring_person.split(cortex)), measure(cortex)
    name = "crest_length_mm"
    (mine,) = by(points, quantity="crest length", preset="standard")
    assert mine.error == pytest.approx(abs(plain.scalars[name] / truth.scalars[name] - 1))
    assert by(points, axis="mesh", quantity="hinges")[0].size == pytest.approx(2000, abs=5)
    whole = by(points, preset="standard", quantity="all measures, median error")[0]
    assert whole.seconds > mine.seconds > 0
    errors = [p.error for p in by(points, preset="standard") if p is not whole]
    assert whole.error == np.median(errors)
    fine = by(points, quantity="crest length", preset="fine")[0]
    assert fine.error < 1e-9  # the split surface is what it measures


def test_a_crushed_vertex_does_not_make_the_error_of_a_map():
    truth, areas = np.linspace(1, 3, 101), np.ones(101)
    found = truth * 1.1
    found[7] = 1e9
    assert measuring_person.median_error(found, truth, areas) == pytest.approx(0.1, rel=0.05)


def test_every_case_has_a_name_of_its_own_that_a_file_can_bear():
    names = [case.name for case in measuring_cases()]
    assert len(set(names)) == len(names) > 8
    assert all(c.isalnum() or c == "-" for name in names for c in name)


@pytest.mark.parametrize(("each", "calls"), [(0.1, 6), (1.0, 4), (6.0, 1)])
def test_quick_work_is_repeated_after_a_warm_up_and_long_work_is_not(monkeypatch, each, calls):
    monkeypatch.setattr(timing, "LONG", 5.0)
    clock = iter(np.arange(100) * each)
    monkeypatch.setattr(timing, "working_seconds", lambda: next(clock))
    done = []
    result, times = timing.timed(lambda: done.append(1) or "result")
    assert (result, len(done)) == ("result", calls)
    assert times == timing.Timing(*[pytest.approx(each)] * 3, max(1, calls - 1))


def test_splitting_a_person_keeps_the_surfaces():
    cortex = folded_ball(1000)
    twice = measuring_person.split(measuring_person.split(cortex))
    assert twice.n_vertices == 15970
    for kind in ("white", "pial"):
        areas = [vertex_areas(s.verts, s.faces).sum() for s in (getattr(cortex, kind), getattr(twice, kind))]
        assert areas[0] == pytest.approx(areas[1], rel=1e-12)
        np.testing.assert_array_equal(getattr(twice, kind).verts[:1000], getattr(cortex, kind).verts)
