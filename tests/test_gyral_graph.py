"""The gyral graph on spheres with ridges along known nets: every hinge and crest, no other, where they are."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from morphofold.analysis import notes
from morphofold.analysis.graph.gyral_graph import gyral_graph
from morphofold.analysis.graph.hinges import hinges
from morphofold.analysis.graph.net_builder import NET_LENGTHS, POTENTIAL_LENGTHS, GyralScales, hinge_sensitivity
from morphofold.errors import OptionsClash, OutOfRange, UnknownName
from morphofold.io import read_cortex, sample_path
from morphofold.note_texts import WARNINGS
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import SphericalNet, irregular_net
from morphofold.studies.folded_ball import folded_ball
from morphofold.studies.known_shapes import arm_angles, regular_net, sphere
from morphofold.studies.ridged_nets import ridged_net
from morphofold.surface import Cortex, Surface

CREST = 54.0  # radius of the crests [mm]
SOLIDS = ("tetrahedron", "cube", "icosahedron", "dodecahedron")  # and the octahedron


def matched(graph, net):
    """The hinge of each node of the net, checked: all there, no other, of the right degree, every arc there."""
    all_hinges = hinges(graph)
    points = np.array([hinge.position for hinge in all_hinges]).reshape(-1, 3)
    points *= CREST / np.linalg.norm(points, axis=1, keepdims=True)
    assert len(all_hinges) == len(net.nodes)
    away, index = cKDTree(points).query(CREST * net.nodes)
    assert away.max() < 0.5 * graph.graph["scales"].width
    assert len(set(index.tolist())) == len(all_hinges)
    assert [all_hinges[k].degree for k in index] == net.degree.tolist()
    number = {all_hinges[k].node: node for node, k in enumerate(index)}
    joined = sorted(tuple(sorted((number[a], number[b]))) for a, b in graph.edges())
    assert joined == sorted(map(tuple, net.arcs.tolist()))
    return [all_hinges[k] for k in index], away, number


def errors(graph, net):
    """Hinge position [mm] (K,), arm angles [deg] and arm lengths (relative), all of them."""
    all_hinges, away, number = matched(graph, net)
    angles, lengths = [], []
    true = {tuple(arc): CREST * angle for arc, angle in zip(net.arcs.tolist(), net.lengths)}
    for node, hinge in enumerate(all_hinges):
        angles.extend(np.sort([arm.angle for arm in hinge.arms]) - arm_angles(net, node))
        lengths.extend(arm.length / true[tuple(sorted((node, number[arm.to])))] - 1 for arm in hinge.arms)
    return away, np.array(angles), np.array(lengths)


def assert_exact(graph, net):
    """Hinges within 0.3 mm, angles within 3.5 degrees, and lengths within 2 %."""
    away, angles, lengths = errors(graph, net)
    assert np.median(away) < 0.3
    assert np.sqrt(np.mean(angles**2)) < 3.5
    assert np.sqrt(np.mean(lengths**2)) < 0.02


@pytest.mark.parametrize("solid", ["octahedron", *(pytest.param(solid, marks=pytest.mark.slow) for solid in SOLIDS)])
def test_every_hinge_and_crest_of_the_regular_solids_is_found_where_it_is(solid):
    net = regular_net(solid).rotated(Rotation.random(random_state=1).as_matrix())
    assert_exact(gyral_graph(ridged_net(net, 6, 6.0, rng=3)), net)


CASES = [("octahedron", 12.0, 0.1, 0.0), ("tetrahedron", 5.0, 0.1, 0.0), ("icosahedron", 5.0, 0.05, 0.7)]


@pytest.mark.parametrize(("solid", "width", "noise", "dip"), CASES)
def test_noise_and_dips_do_no_harm(solid, width, noise, dip):
    """The meshes of 10,000 vertices have edges of 2 mm, so that a tenth of one is 0.2 mm."""
    net = regular_net(solid).rotated(Rotation.random(random_state=2).as_matrix())
    surface = ridged_net(net, 5, width, noise=noise, dip=dip, rng=3)
    matched(gyral_graph(surface), net)


@pytest.mark.parametrize("cells", [pytest.param(12, marks=pytest.mark.slow), 20])
def test_irregular_nets_are_found_with_their_angles_and_lengths(cells):
    net = irregular_net(cells, seed=5, shortest=0.12)  # arms from 6.5 mm
    assert_exact(gyral_graph(ridged_net(net, 6, 6.0, rng=3)), net)


def test_a_mesh_of_uneven_density_changes_nothing():
    """Vertices crowd at two poles, edges from 0.5 to 2.5 mm."""
    verts, faces = icosphere(6)
    verts = verts * [1.0, 1.0, 2.5]
    verts /= np.linalg.norm(verts, axis=1, keepdims=True)
    net = regular_net("dodecahedron").rotated(Rotation.random(random_state=4).as_matrix())
    assert_exact(gyral_graph(ridged_net(net, (verts, faces), 6.0)), net)


def test_a_blind_gyrus_has_a_crest_to_its_tip_and_a_hinge_at_its_root():
    """15 mm long, from the middle of an arc into a wide floor."""
    net = regular_net("octahedron")
    root = np.array([1.0, 1.0, 0.0]) / 2**0.5
    tip = np.cos(15 / CREST) * root + np.sin(15 / CREST) * np.array([0, 0, 1.0])
    graph = gyral_graph(ridged_net(net, 6, 7.0, blind=np.array([[root, tip]]), rng=3))
    all_hinges = hinges(graph)
    assert sorted(hinge.degree for hinge in all_hinges) == [3] + 6 * [4]
    (own,) = [hinge for hinge in all_hinges if hinge.blind]
    assert np.linalg.norm(np.array(own.position) - CREST * root) < 0.5
    ends = [data["position"] for _, data in graph.nodes(data=True) if data["degree"] == 1]
    assert len(ends) == 1
    assert np.linalg.norm(ends[0] - CREST * tip) < 2.5  # a crest stops half a width before the flank
    (arm,) = [arm for arm in own.arms if arm.blind]
    assert arm.length == pytest.approx(15, abs=2.5)
    assert np.isnan(own.persistence)
    assert all(hinge.persistence > 2 for hinge in all_hinges if not hinge.blind)


def test_a_ridge_around_the_sphere_is_a_loop_without_a_hinge():
    turn = np.radians([0, 90, 180, 270])
    nodes = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    ring = SphericalNet(nodes, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    graph = gyral_graph(ridged_net(ring, 5, 8.0, rng=2))
    assert (graph.number_of_nodes(), graph.number_of_edges()) == (1, 1)
    assert hinges(graph) == []
    (crest,) = (data for *_, data in graph.edges(data=True))
    assert crest["length"] == pytest.approx(2 * np.pi * CREST, rel=0.01)
    np.testing.assert_allclose(crest["polyline"][:, 2], 0, atol=1.0)  # half an edge


def test_the_invariant_of_nets_holds_and_crests_lie_on_the_surface():
    net = irregular_net(20, seed=5, shortest=0.12)
    surface = ridged_net(net, 5, 6.0, noise=0.1, rng=3)
    graph = gyral_graph(surface)
    loops = graph.number_of_edges() - graph.number_of_nodes() + 1
    assert sum(degree - 2 for _, degree in graph.degree()) == 2 * (loops - 1)
    for a, b, crest in graph.edges(data=True):
        line = crest["polyline"]
        assert a <= b
        np.testing.assert_allclose(line[0], graph.nodes[a]["position"], atol=1e-6)
        np.testing.assert_allclose(line[-1], graph.nodes[b]["position"], atol=1e-6)
        assert np.linalg.norm(surface.verts[crest["vertices"]] - line, axis=1).max() < 3


def test_scales_are_checked():
    surface = ridged_net(regular_net("cube"), 4, 12.0)
    with pytest.raises(OutOfRange, match=r"\bwidth\b.* -1\.0\b"):
        gyral_graph(surface, width=-1.0)
    with pytest.raises(OptionsClash, match=r"\bwidth\b.*\bscales\b"):
        gyral_graph(surface, width=6.0, scales=GyralScales.of_width(6.0))


def test_a_net_of_another_size_than_the_gyri_is_remarked_on():
    """The width of a person's net is 0.7 of the gyral thickness; beyond half and twice of that it is told."""
    graph = gyral_graph(ridged_net(regular_net("cube"), 4, 12.0), width=7.0)
    notes_by_width = [notes.of_gyral_graph(graph, t).keys() for t in (4.9, 5.1, 19.9, 20.1)]
    assert ["gyral_width" in keys for keys in notes_by_width] == [True, False, False, True]
    assert "gyral_width" in WARNINGS
    assert "gyral_width" not in notes.of_gyral_graph(graph, np.nan)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.10])
@pytest.mark.parametrize("level", [5, 6, 7])
@pytest.mark.parametrize("width", [5.0, 8.0])
def test_large_irregular_nets_are_exact_at_every_resolution(width, level, noise):
    net = irregular_net(40, seed=9, shortest=6 / 54)
    graph = gyral_graph(ridged_net(net, level, width, noise=noise, rng=8))
    if level == 5:
        matched(graph, net)
        return
    assert_exact(graph, net)


def matched_share(points, others, distance):
    """Share of the points (K, 3) with a partner of their own among others within a distance."""
    away = np.linalg.norm(points[:, None] - others[None], axis=2)
    pairs = linear_sum_assignment(np.where(away < distance, away, 1e3))
    return float(np.mean(away[pairs] < distance)) * len(pairs[0]) / len(points)


@pytest.mark.slow
@pytest.mark.parametrize("vertices", [80_000, 40_000])
def test_nine_in_ten_hinges_of_a_brain_are_found_again_on_a_coarser_mesh(vertices):
    """Quadric decimation of one person's hemisphere, the gyral width held; within half of it, each once."""
    fine = read_cortex(sample_path("S1"), hemi="lh").white
    points = pyvista.PolyData.from_regular_faces(fine.verts, fine.faces).decimate(1 - vertices / len(fine.verts))
    coarse = Surface(np.asarray(points.points, dtype=np.float64), points.regular_faces.astype(np.int64))
    graph = gyral_graph(fine)
    width = graph.graph["scales"].width
    points = [np.array([hinge.position for hinge in hinges(g)]) for g in (graph, gyral_graph(coarse, width=width))]
    assert matched_share(*points, 0.5 * width) > 0.9
    assert matched_share(*points[::-1], 0.5 * width) > 0.9


def test_the_net_does_not_depend_on_the_numbers_of_vertices(rng):
    """Borders of basins run midway between vertices, so the nearest one is a matter of numbers. Lengths: conjugate
    gradients stop at 1e-4."""
    cortex = read_cortex(sample_path("fsaverage5"))
    graph = gyral_graph(cortex)
    order = rng.permutation(cortex.n_vertices)
    faces = np.argsort(order)[cortex.faces]
    white, pial = (replace(s, verts=s.verts[order], faces=faces) for s in (cortex.white, cortex.pial))
    other = gyral_graph(Cortex(white, pial, cortex=cortex.cortex[order]))
    assert (len(other), other.size()) == (len(graph), graph.size())
    assert sorted(d for _, d in other.degree()) == sorted(d for _, d in graph.degree())
    lengths = [sum(length for *_, length in g.edges(data="length")) for g in (graph, other)]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-3)


def test_hinges_of_a_clean_net_do_not_depend_on_small_changes_and_vanish_by_large_ones():
    surface = ridged_net(regular_net("cube"), 5, 8.0, rng=1)
    rows = hinge_sensitivity(surface, factors=(0.75, 1.5))
    assert [row["length"] for row in rows] == [
        "",
        *(name for name in NET_LENGTHS + POTENTIAL_LENGTHS for _ in range(2)),
    ]
    for row in rows:
        assert (row["n_hinges"], row["n_hinges_3"], row["n_ends"], row["kept"], row["old"]) == (8, 8, 0, 1.0, 1.0)
    base = rows[0]["crest_length_mm"]
    (merged,) = hinge_sensitivity(surface, lengths=("merge",), factors=(20.0,))[1:]
    assert merged["n_hinges"] < 8
    assert merged["crest_length_mm"] < base
    assert merged["kept"] < 1


def test_what_can_not_be_varied_is_refused_and_a_smooth_surface_has_no_rows():
    ball = sphere(3)
    surface = Surface(ball.verts, ball.faces)
    assert hinge_sensitivity(surface) == []
    with pytest.raises(UnknownName, match=r"persistence, merge.* 'width'"):
        hinge_sensitivity(surface, lengths=("width",))
    with pytest.raises(OutOfRange, match=r"\bfactor\b.* 0\."):
        hinge_sensitivity(surface, factors=(0,))


def test_a_coarser_mesh_of_one_shape_has_the_same_net():
    """With a quarter of the vertices: the spectral wavelength was 9 % longer where D was smoothed over an edge."""
    fine, coarse = (gyral_graph(folded_ball(n), width=7.9) for n in (40_000, 10_000))
    lengths = [sum(crest["length"] for *_, crest in graph.edges(data=True)) for graph in (fine, coarse)]
    assert lengths[1] == pytest.approx(lengths[0], rel=0.01)
    assert coarse.graph["wavelength"] == pytest.approx(fine.graph["wavelength"], rel=0.03)
    assert len(hinges(coarse)) == pytest.approx(len(hinges(fine)), abs=2)
