"""Surfaces with known answers must themselves be right, and so must the geometry of meshes under all measures."""

import numpy as np
import pytest
import reference
import trimesh
from reference import vertex_areas as reference_areas
from scipy.sparse.csgraph import dijkstra

from morphofold import geometry
from morphofold.analysis.shortest_paths import cheapest_path, path_graph, shorten, step_prices
from morphofold.errors import NoSolution, OutOfRange
from morphofold.geometry import (
    adjacency,
    closest_in_triangle,
    components,
    cotangent_laplacian,
    distance_from_triangle,
    edges,
    euler_characteristic,
    face_normals,
    is_closed,
    mean_edge_length,
    morton_codes,
    nearest_weights,
    vertex_areas,
    vertex_normals,
)
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.studies import known_shapes
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.studies.known_shapes import arm_angles, regular_net
from morphofold.studies.ridged_nets import ridged_net

CLOSED = [
    pytest.param(lambda rng: known_shapes.sphere(4, rng=rng), 2, id="sphere"),
    pytest.param(lambda rng: known_shapes.ellipsoid(4, rng=rng), 2, id="ellipsoid"),
    pytest.param(lambda rng: known_shapes.bumpy_sphere(5, rng=rng), 2, id="bumpy sphere"),
    pytest.param(lambda rng: known_shapes.torus(rng=rng), 0, id="torus"),
]


@pytest.mark.parametrize(("make", "chi"), CLOSED)
def test_closed_shapes_are_closed_oriented_and_obey_gauss_bonnet(make, chi, rng):
    shape = make(rng)
    assert is_closed(shape.faces)
    assert components(len(shape.verts), shape.faces)[0] == 1
    assert euler_characteristic(shape.faces) == chi
    assert np.min(np.sum(vertex_normals(shape.verts, shape.faces, "max") * shape.normals, axis=1)) > 0.995
    total = np.sum(shape.K * vertex_areas(shape.verts, shape.faces)) / (2 * np.pi)
    assert total == pytest.approx(chi, abs=0.01)


@pytest.mark.parametrize(("make", "chi"), CLOSED)
def test_exact_curvature_is_the_turning_of_the_exact_normal(make, chi, rng):
    """Along an edge of a fine mesh, d(normal) . d(x) = II(dx, dx); the direction d1 carries k1, its normal k2."""
    shape = make(None)
    i, j = edges(shape.faces).T
    dx, dn = shape.verts[j] - shape.verts[i], shape.normals[j] - shape.normals[i]
    d2 = np.cross(shape.normals, shape.d1)
    middle = lambda k, d: (k[i] * np.sum(d[i] * dx, axis=1) ** 2 + k[j] * np.sum(d[j] * dx, axis=1) ** 2) / 2
    form = middle(shape.k1, shape.d1) + middle(shape.k2, d2)
    turning = np.sum(dn * dx, axis=1)
    assert np.linalg.norm(turning - form) < 0.01 * np.linalg.norm(form)
    assert (shape.k1 >= shape.k2 - 1e-12).all()


def test_an_irregular_sphere_is_on_the_sphere_and_repeats_with_its_seed():
    verts, faces = irregular_sphere(3, 10.0, rng=7)
    again = irregular_sphere(3, 10.0, rng=7)
    assert np.allclose(np.linalg.norm(verts, axis=1), 10, rtol=1e-14)
    assert np.array_equal(verts, again[0])
    assert np.array_equal(faces, again[1])
    assert not np.array_equal(verts, irregular_sphere(3, 10.0, rng=8)[0])


def test_noise_is_normal_and_a_share_of_the_mean_edge():
    clean = known_shapes.sphere(5, rng=1)
    noisy = known_shapes.with_noise(clean, 0.01, rng=2)
    shift = np.sum((noisy.verts - clean.verts) * clean.normals, axis=1)
    assert shift.std() == pytest.approx(0.01 * mean_edge_length(clean.verts, clean.faces), rel=0.03)
    assert np.allclose(noisy.verts - clean.verts, shift[:, None] * clean.normals)
    assert noisy.k1 is clean.k1


# the mesh basics that all measures stand on ------------------------------------------------------------------


def test_vertex_areas_match_their_reference_and_sum_to_the_surface(rng):
    verts, faces = irregular_sphere(2, rng=rng)
    assert np.allclose(vertex_areas(verts, faces), reference_areas(verts, faces), rtol=1e-9)
    fine = known_shapes.sphere(5, 10.0)
    assert vertex_areas(fine.verts, fine.faces).sum() == pytest.approx(400 * np.pi, rel=1e-3)


@pytest.mark.parametrize("weights", ["area", "angle", "sine", "max"])
def test_vertex_normals_of_a_bumpy_sphere_converge(weights):
    error = []
    for level in (4, 5, 6):
        shape = known_shapes.bumpy_sphere(level)
        off = np.cross(vertex_normals(shape.verts, shape.faces, weights), shape.normals)
        error.append(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert error[0] > 3 * error[1] > 9 * error[2]
    assert error[2] < 0.002


def test_max_normals_are_exact_on_an_irregular_sphere():
    shape = known_shapes.sphere(3, rng=3)
    assert np.allclose(vertex_normals(shape.verts, shape.faces, "max"), shape.normals, atol=1e-12)


def test_a_triangle_without_area_and_an_unused_vertex_give_zeros_not_nan():
    verts = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [9, 9, 9.0]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    assert np.array_equal(face_normals(verts, faces), [[0, 0, 0], [0, 0, 1]])
    for weights in ("area", "angle", "sine", "max"):
        normals = vertex_normals(verts, faces, weights)
        assert np.array_equal(normals[[2, 4]], np.zeros((2, 3)))
        assert np.allclose(normals[[0, 1, 3]], [0, 0, 1])
    assert np.allclose(vertex_areas(verts, faces), [1 / 6, 1 / 6, 0, 1 / 6, 0])


def test_the_laplacian_is_symmetric_kills_constants_and_gives_twice_the_mean_curvature(rng):
    shape = known_shapes.sphere(4, 10.0, rng=rng)
    L = cotangent_laplacian(shape.verts, shape.faces)
    assert abs(L - L.T).max() == 0
    assert np.abs(L @ np.ones(len(shape.verts))).max() < 1e-12
    # The gradient of area is 2 H n dA, summed over the sphere against n: 2/r times its area.
    assert np.sum((L @ shape.verts) * shape.normals) == pytest.approx(2 / 10 * 400 * np.pi, rel=0.01)
    # Linear elements: on a plane, x' L x is the integral of the squared gradient.
    flat = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0.0]])
    stiff = cotangent_laplacian(flat, np.array([[0, 1, 2], [0, 2, 3]]))
    x = flat @ [1.0, 2.0, 0.0]
    assert x @ stiff @ x == pytest.approx(5 * 6)


def test_clipped_laplacian_has_no_negative_weight():
    shape = known_shapes.bumpy_sphere(3, amplitude=0.8, rng=1)  # a Delaunay sphere has no negative weight itself
    free, clipped = (cotangent_laplacian(shape.verts, shape.faces, clip=c) for c in (None, (0.0, 20.0)))
    off = lambda L: L.toarray()[~np.eye(L.shape[0], dtype=bool)]
    assert off(free).max() > 0.01
    assert off(clipped).max() <= 0
    assert np.abs(clipped @ np.ones(len(shape.verts))).max() < 1e-12


def test_adjacency_is_that_of_the_edges_and_pieces_are_told_apart():
    verts, faces = known_shapes.icosphere(1)
    two = np.concatenate([faces, faces + len(verts) + 1])  # one unused vertex between
    n = 2 * len(verts) + 1
    ring = adjacency(n, two)
    assert ring.nnz == 2 * len(edges(two)) == 2 * 2 * 120
    assert (np.diff(ring.indptr)[: len(verts)] >= 5).all()
    count, piece = components(n, two)
    assert count == 2
    assert piece[len(verts)] == -1
    assert piece[0] != piece[-1]
    assert euler_characteristic(two) == 4


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


def test_weights_name_the_nearest_point_of_the_triangle(rng):
    grid = np.array([(i, j, 40 - i - j) for i in range(41) for j in range(41 - i)]) / 40
    for _ in range(50):
        a, b, c = rng.standard_normal((3, 3))
        p = 2 * rng.standard_normal(3)
        w = np.array(nearest_weights(p, a, b, c))
        assert w.min() >= 0
        assert w.sum() == pytest.approx(1)
        best = np.linalg.norm(grid @ [a, b, c] - p, axis=1).min()
        assert np.linalg.norm(w @ [a, b, c] - p) <= best + 1e-12


def test_the_nearest_point_of_a_triangle_is_that_of_trimesh(rng):
    triangles = rng.normal(size=(500, 3, 3))
    triangles[:20, 2] = triangles[:20, 1]  # an edge
    triangles[20:40, 2] = triangles[20:40, :2].mean(axis=1)  # a sliver
    points = 2 * rng.normal(size=(500, 3))
    expected = np.linalg.norm(trimesh.triangles.closest_point(triangles, points) - points, axis=1)
    along = np.linspace(0, 1, 2001)[:, None]
    for k, (corner, p) in enumerate(zip(triangles, points)):
        s, t = closest_in_triangle(p, *corner)
        distance = np.linalg.norm((1 - s - t) * corner[0] + s * corner[1] + t * corner[2] - p)
        if k < 20:  # not a question for trimesh
            expected[k] = np.linalg.norm(corner[0] + along * (corner[1] - corner[0]) - p, axis=1).min()
        assert distance_from_triangle(p, *corner) == pytest.approx(distance, abs=1e-9)
        assert distance == pytest.approx(expected[k], abs=1e-3 if k < 20 else 1e-6)


def test_a_morton_curve_goes_through_the_eight_parts_of_each_cube_in_turn():
    corner = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    code = morton_codes((corner + 0.5) / 4, bits=2)
    assert sorted(code.tolist()) == list(range(64))
    for part in range(8):
        inside = corner[np.isin(code, np.arange(8 * part, 8 * part + 8))]
        assert np.ptp(inside, axis=0).tolist() == [1, 1, 1]
    assert morton_codes(np.array([[0.0, 0, 0], [1.0, 1, 1]])).tolist() == [0, 2**60 - 1]


def test_face_vectors_are_half_the_cross_products(rng):
    verts, faces = irregular_sphere(3, radius=50.0, rng=rng)
    np.testing.assert_array_equal(geometry.face_vectors(verts, faces), reference.face_vectors(verts, faces))


@pytest.mark.parametrize("shift", [+1, -1])
def test_a_face_with_a_vertex_that_is_not_there_is_refused(shift):
    verts, faces = icosphere(0)
    with pytest.raises(OutOfRange, match=r"\b0\.\.11\b"):
        geometry.vertex_areas(verts, faces + shift)


def test_ways_on_a_sphere_are_a_few_percent_long():
    verts, faces = icosphere(5, radius=10.0)
    length = np.full(len(verts), np.inf)
    shorten(path_graph(verts, faces), length, np.array([0]), np.ones(len(verts), dtype=bool))
    true = 10 * np.arccos(np.clip(verts @ verts[0] / 100, -1, 1))
    far = true > 2
    assert (length[far] >= true[far] * (1 - 1e-3)).all()  # chords: a little shorter than the sphere
    assert np.mean(length[far] / true[far]) == pytest.approx(1.03, abs=0.015)


def test_ways_are_dijkstras_and_stay_within(rng):
    verts, faces = icosphere(3)
    graph = path_graph(verts, faces)
    np.testing.assert_allclose((graph - graph.T).toarray(), 0)
    length = np.full(len(verts), np.inf)
    shorten(graph, length, np.array([3, 77]), np.ones(len(verts), dtype=bool))
    np.testing.assert_allclose(length, dijkstra(graph, indices=[3, 77]).min(axis=0))
    before = length.copy()
    shorten(graph, length, np.array([200]), np.ones(len(verts), dtype=bool))
    np.testing.assert_allclose(length, np.minimum(before, dijkstra(graph, indices=200)))
    upper = verts[:, 2] > 0
    length = np.full(len(verts), np.inf)
    shorten(graph, length, np.flatnonzero(upper)[:1], upper)
    assert np.isfinite(length[upper]).all()
    assert np.isinf(length[~upper]).all()


def test_the_cheapest_path_keeps_to_the_cheap_side():
    verts, faces = icosphere(4)
    graph = path_graph(verts, faces)
    start, end = int(np.argmax(verts[:, 0])), int(np.argmin(verts[:, 0]))
    goals = np.zeros(len(verts), dtype=bool)
    goals[end] = True
    everywhere = np.ones(len(verts), dtype=bool)
    for side in (1, -1):
        prices = step_prices(graph, np.where(side * verts[:, 2] > 0.1, 1.0, 9.0))
        path = cheapest_path(prices, start, goals, everywhere)
        assert (path[0], path[-1]) == (start, end)
        assert (side * verts[path[5:-5], 2] > 0).all()
        assert (graph[path[:-1], path[1:]] > 0).all()
    assert len(cheapest_path(graph, start, goals, verts[:, 2] > 2)) == 0
