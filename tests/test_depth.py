"""Distance to the convex hull."""

import numpy as np
import pytest
from reference import distance_to_convex_hull, distance_to_planes
from test_gyrification import box_with_a_hole

from morphofold.analysis import sulcal_depth
from morphofold.analysis.gyrification.convex_hull import hull
from morphofold.errors import OptionsClash, UnknownName
from morphofold.io import read_surface, sample_path
from morphofold.io.formats import read_morph
from morphofold.shapes import icosphere
from morphofold.shapes.ridges import irregular_net, ridged_net
from morphofold.studies import shapes


def test_depth_is_zero_on_a_convex_surface(rng):
    shape = shapes.ellipsoid(4, rng=rng)
    assert np.abs(sulcal_depth(shape.verts, shape.faces)).max() < 1e-9


def test_depth_in_a_hole_is_the_way_to_the_nearest_side_of_the_hull():
    for depth, floor in ((0.1, 0.1), (0.2, 0.2), (0.9, 0.1)):  # the last is nearer to the bottom
        verts, faces = box_with_a_hole(depth)
        for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):  # the hole opens to each of the six sides
            for sign in (1, -1):
                depths = sulcal_depth(sign * verts[:, axes], faces[:, ::sign])
                assert np.allclose(depths[:12], 0, atol=1e-12)
                assert np.allclose(depths[12:], floor)


def test_depth_is_the_distance_to_the_nearest_point_of_the_hull(rng):
    shape = shapes.bumpy_sphere(2, amplitude=0.6)
    some = rng.choice(len(shape.verts), 5, replace=False)
    expected = distance_to_convex_hull(shape.verts, shape.verts[some])
    assert expected.max() > 1
    assert np.allclose(sulcal_depth(shape.verts, shape.faces)[some], expected, atol=1e-4)


@pytest.mark.parametrize("surface", ["box", "few", "many"])
def test_no_plane_of_the_hull_is_passed_over_in_error(surface):
    """Fewer planes than a bundle has, fewer than a bundle of bundles, and many of them, no multiple of either."""
    if surface == "box":
        verts, faces = box_with_a_hole(0.4)
    else:
        ridged = ridged_net(irregular_net(20, 1), icosphere(2 if surface == "few" else 5), 9.0, height=9.0)
        verts, faces = ridged.verts, ridged.faces
    planes = hull(verts, faces).equations
    few, most = {"box": (0, 16), "few": (17, 255), "many": (257, 10**6)}[surface]
    assert few <= len(np.unique(np.round(planes, 12), axis=0)) <= most
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
    cortex, _ = shapes.ridged_sphere(6, rng=rng)
    verts, faces = cortex.pial.verts, cortex.faces
    depth = sulcal_depth(verts, faces, "geodesic", touching=0.2)
    spacing = np.pi * 50 / 10
    s = np.linspace(0, spacing / 2, 20_001)
    profile = np.stack([(50 + 4 * np.exp2(-((s / 3) ** 2))) * f(s / 50) for f in (np.cos, np.sin)])
    way = np.r_[0, np.cumsum(np.linalg.norm(np.diff(profile, axis=1), axis=0))]
    crest = s[np.searchsorted(-(50 + 4 * np.exp2(-((s / 3) ** 2))), -53.8)]  # what is less than 0.2 mm deep touches
    latitude = np.arccos(verts[:, 2] / np.linalg.norm(verts, axis=1))
    away = 50 * np.abs(latitude % (np.pi / 10) - np.pi / 20)
    floor = (np.abs(away - spacing / 2) < 0.3) & (np.abs(latitude - np.pi / 2) < 1.2)
    wall = way[-1] - np.interp(crest, s, way)
    assert 0.96 * wall < np.median(depth[floor]) < 1.06 * wall
    assert depth[away < 0.3].max() < 0.5
    assert np.all(depth > sulcal_depth(verts, faces) - 0.2 - 1e-9)


def test_geodesic_depth_is_none_on_a_piece_that_touches_nowhere():
    outer, inner = shapes.sphere(3, 50.0), shapes.sphere(3, 20.0)
    verts, faces = np.vstack([outer.verts, inner.verts]), np.vstack([outer.faces, inner.faces + len(outer.verts)])
    depth = sulcal_depth(verts, faces, "geodesic")
    assert not depth[: len(outer.verts)].any()
    assert np.isnan(depth[len(outer.verts) :]).all()


def test_options_of_depth_are_checked():
    shape = shapes.sphere(2)
    with pytest.raises(UnknownName, match=r"\bmode\b.*'sulc'"):
        sulcal_depth(shape.verts, shape.faces, "sulc")
    with pytest.raises(OptionsClash, match=r"\btouching\b.* 1\.0\b.*'hull'"):
        sulcal_depth(shape.verts, shape.faces, touching=1.0)
