"""Curvature against exact surfaces, its reference, its laws, and meshes that are not nice."""

import numpy as np
import pytest
from reference import principal_curvatures
from scipy.spatial import ConvexHull

from morphofold.analysis import curvature, vertex_areas, vertex_normals
from morphofold.errors import OutOfRange
from morphofold.geometry import adjacency, mean_edge_length
from morphofold.studies import known_shapes


def error(shape, scale, name):
    """Relative rms error of one field."""
    measured, exact = getattr(curvature(shape.verts, shape.faces, scale), name), getattr(shape, name)
    return np.sqrt(np.mean((measured - exact) ** 2) / np.mean(exact**2))


@pytest.mark.parametrize("seed", [pytest.param(None, marks=pytest.mark.slow), 1], ids=["regular", "irregular"])
def test_curvature_of_a_bumpy_sphere_converges_at_second_order(seed):
    scale, off = [], []
    for level in (4, 5, 6):
        shape = known_shapes.bumpy_sphere(level, rng=seed)
        scale.append(2.2 * mean_edge_length(shape.verts, shape.faces))
        off.append([error(shape, scale[-1], name) for name in ("H", "K", "k1", "k2")])
    order = np.polyfit(np.log(scale), np.log(off), 1)[0]
    assert np.allclose(order, 2, atol=0.15), order
    assert np.all(np.less(off[-1], (0.0045, 0.0085, 0.0030, 0.0085))), off[-1]  # 40,962 vertices


def test_curvature_of_an_irregular_torus_is_within_a_fifth_of_a_percent(rng):
    shape = known_shapes.torus(240, 96, rng=rng)
    scale = 2.2 * mean_edge_length(shape.verts, shape.faces)
    assert max(error(shape, scale, name) for name in ("H", "K", "k1", "k2")) < 0.002


@pytest.mark.parametrize("r", [3.0, pytest.param(4.0, marks=pytest.mark.slow)])
def test_a_tube_as_narrow_as_the_scale_is_no_dome(r):
    """Moving points radially alone takes the tube for a dome: 1.17 in place of 1, 0.32 in place of 0."""
    tube = known_shapes.torus(420, 2 * round(np.pi * r / 0.6), 40.0, r)
    c = curvature(tube.verts, tube.faces, 3.0)
    assert abs(whole(tube, c.K)) < 0.02
    assert whole(tube, np.maximum(c.K, 0)) == pytest.approx(1, abs=0.03)
    assert whole(tube, c.k1**2 - np.abs(c.K)) == pytest.approx(whole(tube, tube.k1**2 - np.abs(tube.K)), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("level", "clean", "noisy"), [(6, 0.004, 0.03), (7, 0.001, 0.03)])
def test_mean_curvature_of_an_irregular_bumpy_sphere_clean_and_with_one_percent_of_noise(level, clean, noisy):
    """Clean within 2.1 edges; with noise of 1 % of an edge within 4 mm, and directions then within 2 degrees."""
    shape = known_shapes.bumpy_sphere(level, rng=1)
    assert error(shape, 2.1 * mean_edge_length(shape.verts, shape.faces), "H") < clean
    rough = known_shapes.with_noise(shape, 0.01)
    assert error(rough, 4.0, "H") < noisy
    assert error(rough, 4.0, "K") < 2 * noisy
    along = np.abs(np.sum(curvature(rough.verts, rough.faces, 4.0).d1 * shape.d1, axis=1))
    clear = shape.k1 - shape.k2 > 0.2 * np.sqrt(np.mean(shape.k1**2))
    assert np.median(np.degrees(np.arccos(np.clip(along, 0, 1)))[clear]) < 2


@pytest.mark.slow
def test_with_noise_on_vertices_strewn_at_random_a_radius_of_four_edges_and_a_half_keeps_three_percent(rng):
    """The error of the noise falls with the cube of the radius, that of the fit grows with its square: 4 is too few."""
    verts = rng.standard_normal((40_962, 3))
    verts /= np.linalg.norm(verts, axis=1, keepdims=True)
    faces = ConvexHull(verts).simplices.astype(np.int64)
    corner = verts[faces]
    inward = np.sum(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * corner[:, 0], axis=1) < 0
    faces[inward] = faces[inward, ::-1]
    rough = known_shapes.with_noise(known_shapes.bumpy_sphere((verts, faces)), 0.01)
    assert error(rough, 4.0, "H") < 0.035
    assert error(rough, 4.5, "H") < 0.03


def test_principal_directions_of_a_bumpy_sphere_are_within_a_tenth_of_a_degree(rng):
    shape = known_shapes.bumpy_sphere(6, rng=rng)
    c = curvature(shape.verts, shape.faces, 2.2)
    clear = shape.k1 - shape.k2 > 0.2 * np.sqrt(np.mean(shape.k1**2))
    angle = np.degrees(np.arccos(np.clip(np.abs(np.sum(c.d1 * shape.d1, axis=1)), 0, 1)))[clear]
    assert np.median(angle) < 0.1
    triad = np.stack([c.d1, c.d2, c.normals], axis=1)
    assert np.allclose(triad @ triad.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(triad), 1)


def test_kernel_matches_reference(rng):
    shape = known_shapes.with_noise(known_shapes.bumpy_sphere(4, rng=rng), 0.05, rng=rng)
    scale = 3.5 * mean_edge_length(shape.verts, shape.faces)
    c = curvature(shape.verts, shape.faces, scale)
    normals = vertex_normals(shape.verts, shape.faces, "max")
    ring = adjacency(len(shape.verts), shape.faces)
    neighbours = np.split(ring.indices, ring.indptr[1:-1])
    for i in rng.choice(len(shape.verts), 60, replace=False):
        k1, k2, d1 = principal_curvatures(shape.verts, normals, neighbours, i, scale)
        assert (c.k1[i], c.k2[i]) == pytest.approx((k1, k2), rel=1e-6, abs=1e-9)
        assert abs(d1 @ c.d1[i]) == pytest.approx(1, abs=1e-6)


def whole(shape, values):
    """Integral of values (N,) over a shape, over 4 pi."""
    return np.sum(values * vertex_areas(shape.verts, shape.faces)) / (4 * np.pi)


def test_the_whole_curvature_of_a_closed_surface_is_half_its_euler_characteristic(rng):
    for shape, half in ((known_shapes.bumpy_sphere(6, rng=rng), 1), (known_shapes.torus(rng=rng), 0)):
        K = curvature(shape.verts, shape.faces, 4.0).K
        assert whole(shape, K) == pytest.approx(half, abs=0.01)
        assert whole(shape, np.maximum(K, 0)) > 0.99


def test_a_cylinder_is_exact_however_coarse_the_scale():
    tube = known_shapes.cylinder()
    c = curvature(tube.verts, tube.faces, 9.0)  # of radius 10
    inner = np.abs(tube.verts[:, 2] - tube.verts[:, 2].mean()) < 0.5 * np.ptp(tube.verts[:, 2]) - 9
    assert inner.any()
    assert np.allclose(c.k1[inner], 0.1, rtol=0.005)
    assert np.abs(c.k2[inner]).max() < 0.001


def test_a_needle_that_tilts_a_vertex_normal_does_not_spoil_the_curvature_there():
    """The second fit stands on the first one's normal; without that a few vertices are off by several times."""
    shape = known_shapes.bumpy_sphere(6, rng=1)
    noisy = known_shapes.with_noise(shape, 0.01, rng=0)
    tilted = np.sum(vertex_normals(noisy.verts, noisy.faces, "max") * shape.normals, axis=1) < 0.5
    assert tilted.sum() >= 2
    c = curvature(noisy.verts, noisy.faces, 4.0)
    assert np.abs(c.H - shape.H)[tilted].max() < 0.1 * np.abs(shape.H).max()


def test_curvature_turns_and_scales_with_the_surface_and_changes_sign_with_its_faces(rng):
    """And the order of the vertices does not matter."""
    shape = known_shapes.bumpy_sphere(4, rng=rng)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    order = rng.permutation(len(shape.verts))
    back = np.argsort(order)
    c = curvature(shape.verts, shape.faces, 12.0)
    moved = curvature((10 * shape.verts @ turn.T + 100)[order], back[shape.faces], 120.0)
    np.testing.assert_allclose([10 * moved.k1[back], 10 * moved.k2[back]], [c.k1, c.k2], atol=1e-8)
    reversed_ = curvature(shape.verts, shape.faces[:, ::-1], 12.0)
    np.testing.assert_allclose([-reversed_.k2, reversed_.K], [c.k1, c.K], atol=1e-9)


def test_shape_index_and_curvedness_name_the_known_forms():
    tube = known_shapes.cylinder()
    c = curvature(tube.verts, tube.faces, 3.0)
    assert np.median(c.shape_index) == pytest.approx(0.5, abs=0.01)  # ridge
    assert np.median(c.curvedness) == pytest.approx(0.1 / np.sqrt(2), rel=0.01)
    ball = known_shapes.sphere(3)
    assert np.allclose(curvature(ball.verts, ball.faces).shape_index, 1)
    assert np.allclose(curvature(ball.verts, ball.faces[:, ::-1]).shape_index, -1)
    grid = known_shapes.torus()
    saddle = np.argmin(np.linalg.norm(grid.verts[:, :2], axis=1))
    assert curvature(grid.verts, grid.faces).shape_index[saddle] == pytest.approx(
        2 / np.pi * np.arctan((1 / 16 - 1 / 24) / (1 / 16 + 1 / 24)), abs=0.01
    )


def grid(x, z):
    """A rectangle of points (x, 0, z) in two triangles a cell, facing -y."""
    points = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
    a = (np.arange(len(x) - 1)[:, None] * len(z) + np.arange(len(z) - 1)).ravel()
    b = a + len(z)
    return points, np.concatenate([np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)])


def test_a_plane_and_a_cylinder_are_exact_up_to_their_border():
    c = curvature(*grid(np.arange(12.0), np.arange(12.0)))
    assert np.array_equal(c.k1, np.zeros(144))
    assert np.isnan(c.shape_index).all()
    assert np.allclose(c.normals, [0, -1, 0])
    tube = known_shapes.cylinder()
    c = curvature(tube.verts, tube.faces, 3.0)
    assert np.abs(c.k1 - tube.k1).max() < 0.001
    assert np.abs(c.k2).max() < 0.001


def test_the_walls_of_a_closed_sulcus_do_not_mix():
    """A plate of thickness 0.2 bent round its edge: its two sides are nearer than the scale, and flat."""
    side, faces = grid(np.linspace(-10, 10, 41), np.linspace(0, 10, 21))
    rim = np.arange(41) * 21  # z = 0, where the two sides are joined
    verts = np.concatenate([side + [0, -0.1, 0], side + [0, 0.1, 0]])
    n, a, b = len(side), rim[:-1], rim[1:]
    faces = np.concatenate([faces, faces[:, ::-1] + n, np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)])
    c = curvature(verts, faces, 2.0)
    far = verts[:, 2] > 0.9
    assert np.abs(c.k1[far]).max() < 0.02
    assert np.abs(c.k2[far]).max() < 0.02


def test_hard_meshes_give_nan_where_nothing_can_be_said_and_numbers_elsewhere():
    verts, faces = known_shapes.icosphere(3, 10.0)
    n = len(verts)
    # an unused vertex, a duplicate of vertex 0 in a needle, a triangle without area, a lone triangle
    extra = np.array([[50, 0, 0], verts[0], (verts[1] + verts[2]) / 2, [60, 0, 0], [61, 0, 0], [60, 1, 0]])
    more = np.array([[0, n + 1, faces[0, 1]], [1, n + 2, 2], [n + 3, n + 4, n + 5]])
    c = curvature(np.concatenate([verts, extra]), np.concatenate([faces, more]))
    assert np.isnan(c.k1[[n, n + 3, n + 4, n + 5]]).all()
    assert np.isnan(c.d1[n]).all()
    assert np.isfinite(c.k1[:n]).all()
    assert np.median(c.k1[:n]) == pytest.approx(0.1, rel=1e-6)


def test_few_vertices_widen_the_neighbourhood_instead_of_failing():
    shape = known_shapes.sphere(2, 10.0)  # one edge is about 3
    c = curvature(shape.verts, shape.faces, 3.2)
    assert np.allclose(c.k1, 0.1, rtol=1e-6)
    tiny = curvature(*known_shapes.icosphere(0, 10.0))
    assert np.allclose(tiny.k1, 0.1, rtol=1e-6)


@pytest.mark.parametrize(
    ("scale", "expected"), [(2.0, r"\b2 .*, {:.4g}: "), (10.5, r" {:.4g}\. "), (-1.0, "scale .* -1")]
)
def test_a_scale_that_is_no_length_or_that_the_mesh_cannot_give_is_refused(scale, expected):
    shape = known_shapes.sphere(2, 10.0)
    with pytest.raises(OutOfRange, match=expected.format(mean_edge_length(shape.verts, shape.faces))):
        curvature(shape.verts, shape.faces, scale)
    assert curvature(shape.verts, shape.faces).scale == 3 * mean_edge_length(shape.verts, shape.faces)
