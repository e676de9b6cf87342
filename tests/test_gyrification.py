"""Gyrification, depth and folding against shapes whose hull, envelope and curvature are known."""

import math
from functools import partial

import numpy as np
import pytest
from fast_simplification import simplify
from made_measures import made_measures
from reference import distance_to_planes
from scipy.ndimage import distance_transform_edt

from morphofold.analysis import folding_indices, gyrification_index, local_gyrification_index, sulcal_depth
from morphofold.analysis.gyrification.folding_indices import angle_defects, shape_terms, shape_terms_of
from morphofold.analysis.gyrification.hull_measures import hull
from morphofold.analysis.gyrification.local_gyrification import _squared_distances, envelope
from morphofold.errors import BadMesh, OpenSurface, OptionsClash, OutOfRange, TooLarge, UnknownName
from morphofold.geometry import face_areas, vertex_areas
from morphofold.io import read_surface, sample_path
from morphofold.io.formats import read_morph
from morphofold.shapes import icosphere
from morphofold.shapes.spherical_nets import irregular_net
from morphofold.studies import known_shapes
from morphofold.studies.known_shapes import ellipsoid, ridged_sphere, sphere
from morphofold.studies.ridged_nets import ridged_net


def box_with_a_hole(depth):
    """Unit cube whose top face (z = 1) has a square hole of side 1/2 sunk to the given depth."""
    ring = lambda r, z: [[s * r + 0.5, t * r + 0.5, z] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    verts = np.array(ring(0.5, 0) + ring(0.5, 1) + ring(0.25, 1) + ring(0.25, 1 - depth))
    quads = [[3, 2, 1, 0], [12, 13, 14, 15]]
    for low in (0, 4, 8):
        quads += [[low + k, low + (k + 1) % 4, low + 4 + (k + 1) % 4, low + 4 + k] for k in range(4)]
    quads = np.array(quads)
    return verts, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_gyrification_of_a_convex_surface_is_one(rng):
    for shape in (known_shapes.sphere(4, rng=rng), known_shapes.ellipsoid(4, rng=rng)):
        assert gyrification_index(shape.verts, shape.faces) == pytest.approx(1, abs=1e-3)


def test_gyrification_of_a_cube_with_a_hole_counts_the_walls_of_the_hole():
    for depth in (0.1, 0.5, 0.9):
        assert gyrification_index(*box_with_a_hole(depth)) == pytest.approx((6 + 4 * 0.5 * depth) / 6)


def test_gyrification_does_not_depend_on_size_place_or_unused_vertices():
    verts, faces = box_with_a_hole(0.5)
    moved = np.concatenate([7 * verts - 100, [[1e4, 0, 0]]])
    assert gyrification_index(moved, faces) == pytest.approx(gyrification_index(verts, faces), rel=1e-12)


def test_the_pial_surface_of_fsaverage5_has_a_gyrification_of_1_65():
    pial = read_surface(sample_path("fsaverage5") / "surf" / "lh.pial")
    assert gyrification_index(pial.verts, pial.faces) == pytest.approx(1.65, abs=0.01)


def test_depth_in_a_hole_is_the_way_to_the_nearest_side_of_the_hull():
    for depth, floor in ((0.1, 0.1), (0.2, 0.2), (0.9, 0.1)):  # the last is nearer to the bottom
        verts, faces = box_with_a_hole(depth)
        for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):  # the hole opens to each of the six sides
            for sign in (1, -1):
                depths = sulcal_depth(sign * verts[:, axes], faces[:, ::sign])
                assert np.allclose(depths[:12], 0, atol=1e-12)
                assert np.allclose(depths[12:], floor)


@pytest.mark.parametrize(("level", "fewest", "most"), [(0, 0, 20), (2, 17, 255), (5, 257, 10**6)])
def test_no_plane_of_the_hull_is_passed_over_in_error(level, fewest, most):
    """About as many planes as a bundle has, fewer than a bundle of bundles, and many of them, no multiple of either."""
    ridged = ridged_net(irregular_net(20, 1), icosphere(level), 9.0, height=9.0)
    verts, faces = ridged.verts, ridged.faces
    planes = hull(verts, faces).equations
    assert fewest <= len(np.unique(np.round(planes, 12), axis=0)) <= most
    np.testing.assert_allclose(sulcal_depth(verts, faces), distance_to_planes(verts, planes), atol=1e-10)


def test_depth_scales_with_length_and_is_nan_at_an_unused_vertex():
    verts, faces = box_with_a_hole(0.3)
    more = np.concatenate([3 * verts, [[500, 0, 0]]])
    depths = sulcal_depth(more, faces)
    assert np.isnan(depths[-1])
    assert np.allclose(depths[:-1], 3 * sulcal_depth(verts, faces), atol=1e-12)


def test_depth_of_fsaverage5_goes_with_its_sulc_file():
    folder = sample_path("fsaverage5") / "surf"
    pial = read_surface(folder / "lh.pial")
    depth = sulcal_depth(pial.verts, pial.faces)
    assert np.corrcoef(depth, read_morph(folder / "lh.sulc"))[0, 1] > 0.8
    assert (depth.mean(), depth.max()) == pytest.approx((9.1, 34.4), abs=0.1)


@pytest.mark.parametrize("rng", [None, 4])
def test_geodesic_depth_is_the_length_of_the_wall_from_crest_to_floor(rng):
    """Ridges 6 mm wide at half height, 4 mm high; the floor is midway between two crests."""
    cortex, _ = known_shapes.ridged_sphere(6, rng=rng)
    verts, faces = cortex.pial.verts, cortex.faces
    depth = sulcal_depth(verts, faces, "geodesic", touching=0.2)
    spacing = np.pi * 50 / 10
    s = np.linspace(0, spacing / 2, 20_001)
    profile = np.stack([(50 + 4 * np.exp2(-((s / 3) ** 2))) * f(s / 50) for f in (np.cos, np.sin)])
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(profile, axis=1), axis=0))]
    crest = s[np.searchsorted(-(50 + 4 * np.exp2(-((s / 3) ** 2))), -53.8)]  # what is less than 0.2 mm deep touches
    latitude = np.arccos(verts[:, 2] / np.linalg.norm(verts, axis=1))
    away = 50 * np.abs(latitude % (np.pi / 10) - np.pi / 20)
    floor = (np.abs(away - spacing / 2) < 0.3) & (np.abs(latitude - np.pi / 2) < 1.2)
    wall = along[-1] - np.interp(crest, s, along)
    assert 0.96 * wall < np.median(depth[floor]) < 1.06 * wall
    assert depth[away < 0.3].max() < 0.5
    assert np.all(depth > sulcal_depth(verts, faces) - 0.2 - 1e-9)


def test_geodesic_depth_is_none_on_a_piece_that_touches_nowhere():
    outer, inner = known_shapes.sphere(3, 50.0), known_shapes.sphere(3, 20.0)
    verts, faces = np.vstack([outer.verts, inner.verts]), np.vstack([outer.faces, inner.faces + len(outer.verts)])
    depth = sulcal_depth(verts, faces, "geodesic")
    assert not depth[: len(outer.verts)].any()
    assert np.isnan(depth[len(outer.verts) :]).all()


@pytest.mark.parametrize("shape", [sphere(5), ellipsoid(5, (60.0, 45.0, 35.0), rng=2)], ids=["sphere", "ellipsoid"])
def test_a_convex_surface_is_its_own_envelope(shape):
    points, triangles = envelope(shape.verts, shape.faces, 15.0, 1.25)
    assert face_areas(points, triangles).sum() == pytest.approx(face_areas(shape.verts, shape.faces).sum(), rel=0.01)
    index = local_gyrification_index(shape.verts, shape.faces)
    np.testing.assert_allclose(index, 1, atol=0.03)
    assert np.average(index, weights=vertex_areas(shape.verts, shape.faces)) == pytest.approx(1, abs=0.01)


def test_squared_distances_on_voxels_are_those_of_scipy(rng):
    for share in (0.0, 0.5, 0.999):
        is_inside = rng.random((20, 31, 9)) < share
        np.testing.assert_array_equal(_squared_distances(is_inside), np.rint(distance_transform_edt(is_inside) ** 2))


def test_even_folds_have_everywhere_what_they_have_in_all():
    """Ridges 4 mm high that a ball of 15 mm bridges: the envelope is a sphere of the radius of their crests."""
    cortex, _ = ridged_sphere(6, rng=1)
    verts, faces = cortex.pial.verts, cortex.faces
    index = local_gyrification_index(verts, faces)
    mean = np.average(index, weights=vertex_areas(verts, faces))
    points, triangles = envelope(verts, faces, 15.0, 1.25)
    total = face_areas(verts, faces).sum()
    assert mean == pytest.approx(total / face_areas(points, triangles).sum(), rel=0.01)
    assert index.std() < 0.03
    assert mean >= gyrification_index(verts, faces)  # a hull is the closing by an infinite ball


def exact(shape):
    """Folding and intrinsic curvature index of the curvatures that a shape comes with."""
    areas = vertex_areas(shape.verts, shape.faces) / (4 * np.pi)
    large, small = (take(np.abs(shape.k1), np.abs(shape.k2)) for take in (np.maximum, np.minimum))
    return np.sum(large * (large - small) * areas), np.sum(np.maximum(shape.K, 0) * areas)


def indices_of(shape, scale):
    indices = folding_indices(shape.verts, shape.faces, scale)
    return indices.folding_index, indices.intrinsic_curvature_index


@pytest.mark.parametrize("seed", [pytest.param(None, marks=pytest.mark.slow), 1], ids=["regular", "irregular"])
def test_indices_of_a_bumpy_sphere_fall_from_the_exact_ones_with_the_square_of_the_scale(seed):
    shape = known_shapes.bumpy_sphere(6, rng=seed)
    scales = (2.0, 2.8, 4.0)
    off = np.array([1 - np.divide(indices_of(shape, scale), exact(shape)) for scale in scales])
    order = np.polyfit(np.log(scales), np.log(off), 1)[0]
    assert order == pytest.approx([2, 2], abs=0.35)
    assert np.abs(off[0]).max() < 0.05


def test_indices_of_a_sphere_and_a_torus_are_the_exact_integrals():
    assert indices_of(known_shapes.sphere(5), 5.0) == pytest.approx((0, 1), abs=0.01)
    ring = known_shapes.torus(240, 96, 40.0, 16.0)
    assert indices_of(ring, 1.5) == pytest.approx(exact(ring), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_total_is_half_the_euler_characteristic_whatever_the_noise(noise, rng):
    for shape, half in ((known_shapes.bumpy_sphere(5, rng=rng), 1), (known_shapes.torus(rng=rng), 0)):
        rough = known_shapes.with_noise(shape, noise, rng=rng)
        assert angle_defects(rough.verts, rough.faces).sum() == pytest.approx(4 * np.pi * half, abs=1e-8)
        indices = folding_indices(rough.verts, rough.faces, 5.0)
        assert indices.total == pytest.approx(half, abs=2e-3)
        assert indices.total == indices.intrinsic_curvature_index + indices.negative_curvature_index


def test_noise_of_a_fiftieth_of_an_edge_moves_the_indices_by_less_than_a_percent_or_two():
    shape = known_shapes.bumpy_sphere(6, rng=1)
    rough = known_shapes.with_noise(shape, 0.02)
    assert indices_of(rough, 3.0) == pytest.approx(indices_of(shape, 3.0), rel=0.015)


def test_thinning_a_brain_to_half_its_vertices_hardly_moves_the_indices():
    """A fit within the same radius gains 10 % and more."""
    white = read_surface(sample_path("fsaverage5") / "surf" / "lh.white")
    scale = 6.0  # 1.5 edges of the thin one
    few = simplify(white.verts.astype(np.float32), white.faces.astype(np.int32), 0.5)
    whole, thinned = (folding_indices(v, f, scale) for v, f in ((white.verts, white.faces), few))
    assert thinned.intrinsic_curvature_index == pytest.approx(whole.intrinsic_curvature_index, rel=0.03)
    assert thinned.folding_index == pytest.approx(whole.folding_index, rel=0.06)
    assert (whole.total, thinned.total) == pytest.approx((1, 1), abs=0.02)


@pytest.mark.slow
def test_faces_of_32_bits_as_files_hold_them_are_those_of_64():
    """Keys of the edges of 163,842 vertices need more."""
    verts, faces = known_shapes.icosphere(7, 50.0)
    short, long = (folding_indices(verts, faces.astype(kind), 2.0) for kind in (np.int32, np.int64))
    assert short == long


def test_a_border_and_an_unused_vertex_have_no_defect():
    verts, faces = known_shapes.icosphere(3, 10.0)
    half = faces[(verts[faces, 2] >= 0).all(axis=1)]
    defect = angle_defects(np.concatenate([verts, [[50.0, 0, 0]]]), half)
    rim = np.abs(verts[:, 2]) < 1e-9
    assert (defect[:-1][rim] == 0).all()
    assert (defect[:-1][verts[:, 2] < 0] == 0).all()
    assert defect[-1] == 0
    assert np.isfinite(folding_indices(np.concatenate([verts, [[50.0, 0, 0]]]), half, 3.0).folding_index)


def test_a_family_that_obeys_the_law_has_one_k():
    for exposed in (1e3, 2e4, 5e5):
        for thickness in (1.0, 2.5):
            total = 0.3 * exposed**1.25 / math.sqrt(thickness)
            assert shape_terms(total, exposed, thickness).k == pytest.approx(0.3, rel=1e-12)


def test_terms_by_hand():
    """Areas 10^5 and 10^4 mm^2, 10 mm thick: logarithms 5, 4 and (of the square) 2."""
    law = shape_terms(1e5, 1e4, 10.0)
    assert (law.log_k, law.size, law.shape) == pytest.approx((0.5, 11.0, 6.0), abs=1e-12)
    assert law.k == pytest.approx(math.sqrt(10))


def test_measures_give_their_terms_or_none():
    m = made_measures()
    m.scalars.update(area_pial_mm2=9e4)
    law = shape_terms_of(m)
    assert (law.total, law.exposed, law.thickness) == (9e4, 9e4 / 1.25, 2.5)
    m.scalars.update(gyrification_index=None)
    assert shape_terms_of(m) is None


def test_size_changes_size_alone_and_the_three_directions_are_at_right_angles():
    terms, larger = shape_terms(9e4, 4e4, 2.5), shape_terms(9e4 * 7**2, 4e4 * 7**2, 2.5 * 7)
    assert (larger.k, larger.log_k, larger.shape) == pytest.approx((terms.k, terms.log_k, terms.shape), rel=1e-12)
    assert larger.size - terms.size == pytest.approx(6 * math.log10(7), rel=1e-12)
    points = np.array([4.8, 4.5, 0.6]) + np.vstack([np.zeros(3), np.eye(3) / 10])  # log A_total, A_exposed, T^2
    laws = [shape_terms(10 ** x[0], 10 ** x[1], 10 ** (x[2] / 2)) for x in points]
    values = np.array([(law.log_k, law.size, law.shape) for law in laws])
    directions = (values[1:] - values[0]).T
    across = directions @ directions.T
    np.testing.assert_allclose(across - np.diag(np.diag(across)), 0, atol=1e-9)


BALL = known_shapes.sphere(3)
FLAT = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("function", "arguments", "error", "message"),
    [
        (gyrification_index, FLAT, BadMesh, r"\b4\b"),
        (sulcal_depth, (BALL.verts, BALL.faces, "sulc"), UnknownName, r"\bmode\b.*'sulc'"),
        (partial(sulcal_depth, touching=1.0), (BALL.verts, BALL.faces), OptionsClash, r"\btouching\b.* 1\.0\b.*'hull'"),
        (local_gyrification_index, (BALL.verts, BALL.faces[1:]), OpenSurface, "border"),
        (partial(local_gyrification_index, closing=0.0), (BALL.verts, BALL.faces), OutOfRange, r"\bclosing\b.* 0\.0\b"),
        (local_gyrification_index, (1000 * BALL.verts, BALL.faces), TooLarge, r"\d mm .*\d mm; .*\d mm\b"),
        (folding_indices, (BALL.verts, BALL.faces, -1.0), OutOfRange, r"\bscale\b.* -1\.0\.$"),
        (shape_terms, (1, 1, math.nan), OutOfRange, "^thickness .* nan"),
    ],
)
def test_what_has_no_meaning_is_refused(function, arguments, error, message):
    with pytest.raises(error, match=message):
        function(*arguments)
