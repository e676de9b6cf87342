"""Self-intersection against brute force and shapes whose crossings are known; exact signs."""

from itertools import pairwise

import numpy as np
import pytest
from made_folds import pressed_sphere, two_spheres
from reference_signs import displaced, rational_sign

from morphofold.intersections.box_tree import box_tree
from morphofold.intersections.intersection import _crossings, self_intersections
from morphofold.intersections.signs import plane_sign, side
from morphofold.io import read_cortex, sample_path
from morphofold.shapes import icosphere
from morphofold.surface import Surface


def brute_force(verts, faces):
    """Edge and face of each crossing, from all pairs in plain floating point: right where nothing is tied."""
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    volume = lambda a, b, c, d: np.sign(np.einsum("...i,...i", np.cross(b - a, c - a), d - a))
    rows = set()
    for f, (i, j, k) in enumerate(faces):
        p, q = verts[edges.T]
        crosses = volume(*verts[[i, j, k]], p) * volume(*verts[[i, j, k]], q) < 0
        crosses &= ~np.isin(edges, [i, j, k]).any(axis=1)
        turns = np.stack([volume(p, q, verts[s], verts[t]) for s, t in ((i, j), (j, k), (k, i))])
        crosses &= (turns > 0).all(axis=0) | (turns < 0).all(axis=0)
        rows |= {(int(v), int(w), f) for v, w in edges[crosses]}
    return rows


def brute_force_with_ties(verts, faces):
    """The same in rational arithmetic, of the vertices truly displaced."""
    x, rows = displaced(verts), set()
    for p, q in {tuple(sorted(map(int, pair))) for face in faces for pair in zip(face, np.roll(face, 1))}:
        for f, (i, j, k) in enumerate(faces):
            if {p, q} & {i, j, k} or rational_sign(x[i], x[j], x[k], x[p]) * rational_sign(x[i], x[j], x[k], x[q]) >= 0:
                continue
            turns = [rational_sign(x[p], x[q], x[s], x[t]) for s, t in ((i, j), (j, k), (k, i))]
            if turns in ([1, 1, 1], [-1, -1, -1]):
                rows.add((p, q, f))
    return rows


def crossings(verts, faces):
    """Every crossing with ties decided, those of depth zero included."""
    edge, face = _crossings(verts, faces, box_tree(verts, faces))
    rows = np.column_stack([edge, face]).tolist()
    assert rows == sorted(rows)
    assert len({*map(tuple, rows)}) == len(rows)
    return {(int(p), int(q), int(f)) for (p, q), f in zip(edge, face)}


def listed(result):
    return {(int(p), int(q), int(f)) for (p, q), f in zip(result.edge, result.face)}


@pytest.mark.parametrize("soup", ["apart", "long", "with common vertices"])
def test_crossings_of_a_soup_of_triangles_are_those_of_brute_force(rng, soup):
    if soup == "with common vertices":
        verts, faces = rng.standard_normal((40, 3)), np.array([rng.choice(40, 3, replace=False) for _ in range(150)])
    else:
        size = [9.0 if soup == "long" else 0.3, 0.3, 0.3]
        verts = (rng.uniform(0, 2.5, (200, 1, 3)) + rng.standard_normal((200, 3, 3)) * size).reshape(-1, 3)
        faces = np.arange(600).reshape(-1, 3)
    expected = brute_force(verts, faces)
    assert len(expected) > 100
    assert crossings(verts, faces) == expected


def test_crossings_of_a_folded_surface_are_those_of_brute_force():
    surface = pressed_sphere(3, press=1.6, irregular=True)
    expected = brute_force(surface.verts, surface.faces)
    assert len(expected) > 10
    assert listed(self_intersections(surface)) == expected


def test_ties_on_a_lattice_are_those_of_vertices_truly_displaced(rng):
    ties = 0
    for _ in range(8):
        verts = rng.integers(0, 3, (12, 3)).astype(float)  # often in one place, on one line, in one plane
        faces = np.array([rng.choice(12, 3, replace=False) for _ in range(10)])
        expected = brute_force_with_ties(verts, faces)
        assert crossings(verts, faces) == expected
        result = self_intersections(Surface(verts, faces))
        assert result.depth.min(initial=1.0) > 1e-3  # nothing between touching and a lattice's step
        ties += len(expected) - len(result)
    assert ties > 10  # of depth zero: touching


def test_a_turn_a_shift_a_scale_and_the_order_of_faces_change_only_the_depth_by_the_scale(rng):
    surface, order = pressed_sphere(4, press=1.4, irregular=True), rng.permutation(2560 * 2)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    shuffled = self_intersections(Surface(surface.verts, surface.faces[order]))
    result, moved = (
        self_intersections(surface),
        self_intersections(Surface(3 * surface.verts @ turn + 7, surface.faces)),
    )
    assert listed(result) == listed(moved) == {(p, q, int(order[f])) for p, q, f in listed(shuffled)}
    assert np.array_equal(result.vertex, shuffled.vertex)
    assert len(result) > 0
    assert len(result.vertex) > 0
    np.testing.assert_array_equal(result.vertex, moved.vertex)
    np.testing.assert_allclose(moved.depth, 3 * result.depth, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(moved.vertex_depth, 3 * result.vertex_depth, rtol=1e-9)
    np.testing.assert_allclose(moved.point, 3 * result.point @ turn + 7, atol=1e-9)
    assert moved.deepest_share == pytest.approx(result.deepest_share)


@pytest.mark.parametrize("depth", [1e-9, 0.3])
def test_a_spike_through_a_plate_has_passed_by_the_length_beyond_it(depth):
    plate = [[-9, -9, 0], [9, -9, 0], [0, 9, 0]]
    spike = [[0, 0, -depth], [1, 0, 2], [-1, 1, 2], [-1, -1, 2]]
    faces = [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 4]]
    result = self_intersections(Surface(np.array(plate + spike, float), np.array(faces)))
    assert listed(result) == {(3, 4, 0), (3, 5, 0), (3, 6, 0)}
    np.testing.assert_allclose(result.depth, depth)
    np.testing.assert_allclose(result.point[0], [depth / (2 + depth), 0, 0], atol=1e-12)
    assert result.deeper_than(0.5 * depth / result.mean_edge) == 3
    assert result.deeper_than(2 * depth / result.mean_edge) == 0


def roofs(gap):
    """A ridge along x with slopes of 45 degrees, and under the sky an upside-down one along y, ``gap`` apart."""
    lower = [[-9, 0, 0], [9, 0, 0], [0, 9, -9], [0, -9, -9]]
    upper = [[0, -9, gap], [0, 9, gap], [9, 0, 9 + gap], [-9, 0, 9 + gap]]
    faces = [[0, 1, 2], [1, 0, 3], [4, 5, 6], [5, 4, 7]]
    return Surface(np.array(lower + upper, float), np.array(faces))


@pytest.mark.parametrize("gap", [-0.2, -1e-6])
def test_two_ridges_have_passed_by_the_way_back_over_the_ridge(gap):
    result = self_intersections(roofs(gap))
    assert listed(result) == {(4, 5, 0), (4, 5, 1), (0, 1, 2), (0, 1, 3)}
    np.testing.assert_allclose(result.depth, -np.sqrt(2) * gap)  # along the slope from the ridge


def test_ridges_that_touch_do_not_cross():
    assert len(self_intersections(roofs(0.0))) == len(self_intersections(roofs(0.1))) == 0


TOUCHING = {
    "a vertex on a face": [[1, 1, 0], [1, 2, 5], [2, 1, 5]],
    "a vertex on a side": [[2, 0, 0], [2, 2, 5], [2, 1, 5]],
    "a vertex on a vertex": [[0, 0, 0], [1, 2, 5], [2, 1, 5]],
    "a side on the face": [[1, 1, 0], [1, 2, 0], [2, 1, 5]],
    "a side on a side": [[1, 0, 0], [3, 0, 0], [2, 1, 5]],
    "two in one plane": [[1, 1, 0], [9, 1, 0], [1, 9, 0]],
    "one on the other": [[0, 0, 0], [4, 0, 0], [0, 4, 0]],
}


@pytest.mark.parametrize("how", TOUCHING)
def test_touching_is_no_crossing(how):
    for other in (TOUCHING[how], TOUCHING[how][::-1]):
        verts = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], *other], float)
        assert len(self_intersections(Surface(verts, np.array([[0, 1, 2], [3, 4, 5]])))) == 0


@pytest.mark.parametrize("gap", [1e-12, 0.0])
def test_spheres_side_by_side_or_touching_have_not_passed(gap):
    result = self_intersections(two_spheres(gap))
    assert (len(result), len(result.vertex), result.deepest) == (0, 0, 0.0)


def test_the_wide_shallow_overlap_of_two_spheres_is_as_deep_as_its_lens():
    """No crossing tells it: they lie at the rim of the lens, where the walls meet at a small angle."""
    result = self_intersections(two_spheres(-0.1))
    assert result.deepest == pytest.approx(0.1, rel=1e-3)
    assert result.deepest_share == pytest.approx(0.26, abs=0.01)
    assert result.depth.max() < 0.3 * result.deepest
    apex = {0, len(icosphere(5)[0]) + 3}  # vertex 3 is opposite to vertex 0
    assert set(result.vertex[result.vertex_depth > 0.0999]) == apex


def test_vertices_that_have_passed_are_those_inside_the_other_sphere():
    """The walls cross at a right angle."""
    gap = 10 * 2**0.5 - 20
    surface = two_spheres(gap)
    result = self_intersections(surface)
    centre = np.array([np.zeros(3), (2 + gap / 10) * surface.verts[0]])
    other = np.repeat(centre[::-1], len(surface.verts) // 2, axis=0)
    inside = 10 - np.linalg.norm(surface.verts - other, axis=1)
    sag = result.mean_edge**2 / 40  # faces lie inside the sphere by less than this
    expected = np.flatnonzero((inside > sag) & (inside < result.mean_edge - sag))
    assert set(expected) <= set(result.vertex)
    assert inside[result.vertex].min() > 0
    np.testing.assert_allclose(result.vertex_depth, inside[result.vertex], atol=sag)


def test_a_wall_still_in_front_takes_nothing_from_the_depth():
    """The apex of one sphere is 0.1 deep in a second and 0.03 before a third."""
    pair = two_spheres(-0.1)
    faces = pair.faces[: len(pair.faces) // 2]
    first, second = np.split(pair.verts, 2)
    aside = np.cross(first[0], [0.0, 0, 1])
    third = first + first[0] + 10.03 / np.linalg.norm(aside) * aside
    surface = Surface(np.concatenate([first, second, third]), np.concatenate([pair.faces, faces + len(pair.verts)]))
    result = self_intersections(surface)
    assert result.vertex_depth[result.vertex == 0] == pytest.approx(0.1, rel=1e-3)


def test_a_surface_through_its_own_mirror_image_crosses_it_edge_on_edge():
    surface = pressed_sphere(5, press=1.2)
    number = {tuple(np.round(v, 9) + 0.0): i for i, v in enumerate(surface.verts)}
    image = np.array([number[tuple(np.round(v * [-1, 1, 1], 9) + 0.0)] for v in surface.verts])
    result = self_intersections(surface)
    np.testing.assert_allclose(result.point[:, 0], 0, atol=1e-12)
    edges = [tuple(map(int, edge)) for edge in result.edge]
    assert len(set(edges)) == len(edges) > 10  # once each, not once for each face at the edge
    assert {tuple(sorted(map(int, image[list(edge)]))) for edge in edges} == set(edges)
    assert result.depth.min() > 0
    assert set(image[result.vertex]) == set(result.vertex)
    x = np.abs(surface.verts[result.vertex, 0])
    assert (result.vertex_depth <= 2 * x + 1e-12).all()  # the mirrored vertex is that far away
    assert result.vertex_depth.max() > x.max()


@pytest.mark.parametrize("gap", [0.0, -1e-9, -0.1])
def test_an_edge_over_a_tip_has_passed_by_the_way_over_the_tip(gap):
    """A pyramid of eight faces under a roof: two or three of its faces lie before the tip, as many beyond it."""
    angle = np.arange(8) * np.pi / 4 + 0.1
    base = np.column_stack([np.cos(angle), np.sin(angle), -np.ones(8)]) * 3
    roof = np.array([[-9, 0, gap], [9, 0, gap], [0, 9, 9], [0, -9, 9]])
    faces = [[0, 1 + k, 1 + (k + 1) % 8] for k in range(8)] + [[10, 9, 11], [9, 10, 12]]
    result = self_intersections(Surface(np.concatenate([[[0, 0, 0]], base, roof]), np.array(faces)))
    assert result.deepest <= -1.5 * gap
    assert (len(result) > 0) == (gap < 0)


def test_a_dent_pressed_until_its_walls_all_but_touch_has_not_passed():
    result = self_intersections(pressed_sphere(5, press=0.99, irregular=True))
    assert (len(result), len(result.vertex)) == (0, 0)


def trench(half_width, *, raised=0.0, step=0.25):
    """Two plates with a trench 3 deep between them, along y, open at its ends; negative: its flat walls have passed
    through each other whole. One of the plates is ``raised``."""
    a, h = half_width, raised
    corners = np.array([[-5, 0], [-a, 0], [-a, -3], [a, -3], [a, h], [5, h]])
    line = [np.linspace(p, q, round(np.abs(q - p).max() / step), endpoint=False) for p, q in pairwise(corners)]
    x, z = np.concatenate([*line, corners[-1:]]).T
    y = np.arange(0, 4, step)
    verts = np.stack([np.repeat(x, len(y)), np.tile(y, len(x)), np.repeat(z, len(y))], axis=1)
    number = np.arange(len(verts)).reshape(len(x), -1)
    a, b, c, d = (number[u, v].ravel() for u in (slice(-1), slice(1, None)) for v in (slice(-1), slice(1, None)))
    return Surface(verts, np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)]))


def test_flat_walls_that_passed_whole_are_found_at_their_rims_unless_these_lie_in_one_plane():
    assert len(self_intersections(trench(0.4))) == len(self_intersections(trench(0.4, raised=0.3))) == 0
    assert len(self_intersections(trench(-0.4))) == 0  # plates in one plane: edges only touch them
    rims = self_intersections(trench(-0.4, raised=0.3))
    assert len(rims) > 0
    assert set(np.round(rims.point[:, 2], 9)) == {0.0}  # where the lower plate runs through a wall


def test_faces_that_cross_are_the_crossed_ones_and_those_at_their_edges():
    """An open surface, or one that is asked for no vertices, has crossings only."""
    pressed = pressed_sphere(4, press=1.2, irregular=True)
    result, whole = self_intersections(pressed, vertices=False), self_intersections(pressed)
    opened = self_intersections(Surface(pressed.verts, pressed.faces[:-1]))
    np.testing.assert_array_equal(result.edge, whole.edge)
    assert len(result) == len(opened) > 0
    assert len(result.vertex) == len(opened.vertex) == 0 < len(whole.vertex)
    pairs = {tuple(edge) for edge in result.edge.tolist()}
    sides = lambda a, b, c: {tuple(sorted(ends)) for ends in ((a, b), (b, c), (c, a))}
    at_edge = {f for f, corners in enumerate(pressed.faces.tolist()) if pairs & sides(*corners)}
    assert set(result.crossed_faces(pressed.faces)) == at_edge | set(result.face)


def test_real_pial_surfaces_of_the_samples_do_not_pass_through_themselves():
    result = self_intersections(read_cortex(sample_path("fsaverage5"), hemi="lh").pial)
    assert (len(result), len(result.vertex)) == (0, 0)  # ipctk 1.6.1 finds none either


def nearly_flat(rng, weight):
    """Points on a plane up to rounding: the fourth combines the other three, or is one of its neighbours."""
    a, b, c = rng.standard_normal((3, 3)) * 10.0 ** rng.integers(-3, 3)
    s, t = rng.uniform(-2, 2, 2)
    d = weight * a + s * (b - a) + t * (c - a)
    return a, b, c, d + rng.integers(-2, 3, 3) * np.spacing(d)


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_the_sign_of_points_on_a_plane_up_to_rounding_is_that_of_rational_arithmetic(rng, weight):
    wrong = 0
    for _ in range(1000):
        a, b, c, d = nearly_flat(rng, weight)
        exact = rational_sign(a, b, c, d, int(weight))
        assert plane_sign(a, b, c, d, weight) == exact
        wrong += np.sign(np.dot(d - weight * a, np.cross(b - a, c - a))) != exact
    assert wrong > 50  # plain floating point would not do


def test_coordinates_of_very_different_size_keep_their_sign(rng):
    for _ in range(300):
        points = rng.standard_normal((4, 3)) * 10.0 ** rng.integers(-60, 20, (4, 3))
        assert plane_sign(*points, 1.0) == rational_sign(*points)


def test_ties_are_decided_as_if_each_vertex_were_displaced_by_less_than_the_one_before(rng):
    ties = 0
    for _ in range(300):
        verts = rng.integers(0, 3, (4, 3)).astype(float)  # mostly flat, often on a line or in one place
        i, j, k, p = rng.permutation(4)
        moved = displaced(verts)
        assert side(verts, i, j, k, p) == rational_sign(moved[i], moved[j], moved[k], moved[p])
        ties += plane_sign(verts[i], verts[j], verts[k], verts[p], 1.0) == 0
    assert ties > 50
