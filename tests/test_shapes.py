"""The surfaces with known answers must themselves be right."""

import numpy as np
import pytest
from reference import vertex_areas as reference_areas

from morphofold import geometry
from morphofold.errors import UnknownName
from morphofold.geometry import (
    adjacency,
    components,
    cotangent_laplacian,
    edges,
    euler_characteristic,
    face_normals,
    is_closed,
    mean_edge_length,
    vertex_areas,
    vertex_normals,
)
from morphofold.studies import shapes

CLOSED = [
    pytest.param(lambda rng: shapes.sphere(4, rng=rng), 2, id="sphere"),
    pytest.param(lambda rng: shapes.ellipsoid(4, rng=rng), 2, id="ellipsoid"),
    pytest.param(lambda rng: shapes.bumpy_sphere(5, rng=rng), 2, id="bumpy sphere"),
    pytest.param(lambda rng: shapes.torus(rng=rng), 0, id="torus"),
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


def test_the_harmonic_has_unit_norm():
    verts, faces = shapes.icosphere(5)
    area = vertex_areas(verts, faces)
    Y = shapes._harmonic_6_3(verts)[0]
    assert np.sum(Y**2 * area) / area.sum() * 4 * np.pi == pytest.approx(1, abs=1e-3)
    assert np.abs(Y).max() == pytest.approx(0.65, abs=0.001)


def test_an_irregular_sphere_is_on_the_sphere_and_repeats_with_its_seed():
    verts, faces = shapes.irregular_sphere(3, 10.0, rng=7)
    again = shapes.irregular_sphere(3, 10.0, rng=7)
    assert np.allclose(np.linalg.norm(verts, axis=1), 10, rtol=1e-14)
    assert np.array_equal(verts, again[0])
    assert np.array_equal(faces, again[1])
    assert not np.array_equal(verts, shapes.irregular_sphere(3, 10.0, rng=8)[0])


def test_noise_is_normal_and_a_share_of_the_mean_edge():
    clean = shapes.sphere(5, rng=1)
    noisy = shapes.with_noise(clean, 0.01, rng=2)
    shift = np.sum((noisy.verts - clean.verts) * clean.normals, axis=1)
    assert shift.std() == pytest.approx(0.01 * mean_edge_length(clean.verts, clean.faces), rel=0.03)
    assert np.allclose(noisy.verts - clean.verts, shift[:, None] * clean.normals)
    assert noisy.k1 is clean.k1


# the mesh basics that all measures stand on ------------------------------------------------------------------


def test_vertex_areas_match_their_reference_and_sum_to_the_surface(rng):
    verts, faces = shapes.irregular_sphere(2, rng=rng)
    assert np.allclose(vertex_areas(verts, faces), reference_areas(verts, faces), rtol=1e-9)
    fine = shapes.sphere(5, 10.0)
    assert vertex_areas(fine.verts, fine.faces).sum() == pytest.approx(400 * np.pi, rel=1e-3)


@pytest.mark.parametrize("weights", ["area", "angle", "sine", "max"])
def test_vertex_normals_of_a_bumpy_sphere_converge(weights):
    error = []
    for level in (4, 5, 6):
        shape = shapes.bumpy_sphere(level)
        off = np.cross(vertex_normals(shape.verts, shape.faces, weights), shape.normals)
        error.append(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert error[0] > 3 * error[1] > 9 * error[2]
    assert error[2] < 0.002


def test_max_normals_are_exact_on_an_irregular_sphere():
    shape = shapes.sphere(3, rng=3)
    assert np.allclose(vertex_normals(shape.verts, shape.faces, "max"), shape.normals, atol=1e-12)


def test_an_unknown_weight_is_refused():
    with pytest.raises(UnknownName, match=r"'area'.*'angle'.*'sine'.*'max'.*'voronoi'"):
        vertex_normals(*shapes.icosphere(0), weights="voronoi")


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
    shape = shapes.sphere(4, 10.0, rng=rng)
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
    shape = shapes.bumpy_sphere(3, amplitude=0.8, rng=1)  # a Delaunay sphere has no negative weight itself
    free, clipped = (cotangent_laplacian(shape.verts, shape.faces, clip=c) for c in (None, (0.0, 20.0)))
    off = lambda L: L.toarray()[~np.eye(L.shape[0], dtype=bool)]
    assert off(free).max() > 0.01
    assert off(clipped).max() <= 0
    assert np.abs(clipped @ np.ones(len(shape.verts))).max() < 1e-12


def test_edges_are_kept_only_of_faces_that_cannot_change_and_as_long_as_these_live():
    faces = shapes.icosphere(1)[1]
    before = edges(faces)
    view = faces[:40]
    view.flags.writeable = False
    fewer = edges(view)
    faces[:40] = faces[40:]
    assert len(edges(faces)) < len(before)
    assert not np.array_equal(edges(view), fewer)
    fixed = shapes.sphere(1).surface
    assert edges(fixed.faces) is edges(fixed.faces)
    np.testing.assert_array_equal(edges(fixed.faces), before)
    key = (id(fixed.faces),)
    assert key in geometry.edges_and_counts.results
    del fixed
    assert key not in geometry.edges_and_counts.results


def test_adjacency_is_that_of_the_edges_and_pieces_are_told_apart():
    verts, faces = shapes.icosphere(1)
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
