"""Cortical thickness."""

from importlib.resources import files

import numpy as np
import pytest
import trimesh

from morphofold import geometry
from morphofold.analysis import cortical_thickness
from morphofold.errors import OutOfRange, UnknownName, UnlikeSurfaces
from morphofold.io import read_cortex
from morphofold.shapes import icosphere, irregular_sphere
from morphofold.surface import Surface
from morphofold.threads import using_threads


def shell(level, inner, outer, turn=0.0):
    """Concentric spheres, the inner one turned about z by an angle [rad] along the outer."""
    verts, faces = icosphere(level)
    c, s = np.cos(turn), np.sin(turn)
    return Surface(inner * verts @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), faces), Surface(outer * verts, faces)


def test_thickness_of_a_shell_converges_to_the_gap_at_second_order():
    error = [np.abs(cortical_thickness(*shell(level, 48, 50.5, turn=0.03)) - 2.5) for level in (3, 4, 5)]
    order = np.polyfit(np.arange(3), np.log2([e.mean() for e in error]), 1)[0]
    assert order == pytest.approx(-2, abs=0.3)
    assert error[-1].max() < 1.8**2 / 8 / 48  # no more than the triangles' sag


def test_thickness_does_not_depend_on_how_far_partners_have_slid():
    white, pial = shell(5, 48, 50.5, turn=0.06)  # up to 3 mm along the surface
    assert np.linalg.norm(white.verts - pial.verts, axis=1).max() > 3.8
    assert np.abs(cortical_thickness(white, pial) - 2.5).max() < 0.02
    assert cortical_thickness(white, pial, mode="freesurfer").mean() > 2.55  # vertices are never that near


def sulcus(step=0.5):
    """Two banks 0.2 apart joined by a floor; the cortex is 3 thick on the left bank and 1 on the right, open strip."""
    u = np.arange(0, 12, step) / 12
    pial = np.r_[np.c_[0 * u - 0.1, 12 - 12 * u], np.c_[0.2 * u - 0.1, 0 * u], np.c_[0 * u + 0.1, 12 * u]]
    white = np.r_[np.c_[0 * u - 3.1, 12 - 13 * u], np.c_[4.2 * u - 3.1, 0 * u - 1], np.c_[0 * u + 1.1, 13 * u - 1]]
    rows, n = np.arange(0, 12, step), len(pial)
    i, j = np.meshgrid(np.arange(len(rows) - 1), np.arange(n - 1), indexing="ij")
    a, b, c, d = (k.ravel() for k in (i * n + j, i * n + j + 1, (i + 1) * n + j, (i + 1) * n + j + 1))
    faces = np.r_[np.c_[a, b, c], np.c_[b, d, c]]
    grid = lambda p: np.c_[np.tile(p[:, 0], len(rows)), np.repeat(rows, n), np.tile(p[:, 1], len(rows))]
    return Surface(grid(white), faces), Surface(grid(pial), faces)


@pytest.mark.parametrize(("mode", "slack"), [("surface", 0.01), ("freesurfer", 0.05)])
def test_thickness_never_jumps_across_a_sulcus(mode, slack):
    white, pial = sulcus()
    normal = geometry.vertex_normals(pial.verts, pial.faces)
    thickness = cortical_thickness(white, pial, mode=mode, rings=40)
    middle = (pial.verts[:, 1] > 4) & (pial.verts[:, 1] < 8) & (pial.verts[:, 2] > 2.2) & (pial.verts[:, 2] < 9)
    left, right = middle & (pial.verts[:, 0] < -0.09), middle & (pial.verts[:, 0] > 0.09)
    assert (normal[left, 0] > 0.9).all()  # outward is into the sulcus
    assert np.abs(thickness[left] - 3).max() < slack  # the other bank's white is only 1.2 away
    assert np.abs(thickness[right] - 1).max() < slack


def test_each_direction_is_capped_before_averaging():
    white, pial = shell(4, 43, 50)
    np.testing.assert_allclose(cortical_thickness(white, pial, cap=None), 7, atol=0.05)
    np.testing.assert_array_equal(cortical_thickness(white, pial, cap=5.0), 5)
    bump = pial.verts.copy()
    bump[0] *= 60 / 50  # a spike: 17 from its partner, 5.0x from white's side
    tall = cortical_thickness(white, Surface(bump, pial.faces), cap=None)[0]
    assert cortical_thickness(white, Surface(bump, pial.faces), cap=8.0)[0] < tall - 2


def twin(white, pial, cap, search):
    """The definition, one vertex at a time; ``search(i, start, target)`` yields points (P, 3) with weights (P, N)."""
    normals = geometry.vertex_normals(pial.verts, pial.faces, "sine")
    result = []
    for i, n in enumerate(normals):
        ways = []
        for start, target, side in ((white.verts[i], pial.verts, 1), (pial.verts[i], white.verts, -1)):
            ways.append(np.linalg.norm(target[i] - start))
            for point, weights in search(i, start, target):
                if side * (point - start) @ n >= 0 and (weights @ normals) @ n >= 0:
                    ways[-1] = min(ways[-1], np.linalg.norm(point - start))
        result.append((min(ways[0], cap) + min(ways[1], cap)) / 2)
    return np.array(result)


def rough_shell(rng):
    verts, faces = irregular_sphere(2, rng=rng)
    layer = lambda radius: Surface(radius * verts + rng.normal(0, 1.0, verts.shape), faces)
    return layer(10), layer(11.5), geometry.adjacency(len(verts), faces).toarray()


def test_freesurfer_mode_matches_its_readable_twin(rng):
    white, pial, near = rough_shell(rng)
    eye = np.eye(len(near))
    for rings, cap in ((1, 5.0), (3, 2.0)):
        reach = np.linalg.matrix_power(near + eye, rings) > 0
        expected = twin(white, pial, cap, lambda i, start, target, reach=reach: zip(target[reach[i]], eye[reach[i]]))
        measured = cortical_thickness(white, pial, mode="freesurfer", rings=rings, cap=cap)
        np.testing.assert_allclose(measured, expected, rtol=1e-9)


def test_surface_mode_matches_its_readable_twin(rng):
    white, pial, near = rough_shell(rng)
    faces = pial.faces

    def search(i, start, target):
        far = np.linalg.norm(target - start, axis=1)
        within = far <= far[i] + geometry.mean_edge_length(target, faces)
        flooded = np.arange(len(near)) == i
        while (grown := within & (flooded | near[flooded].any(axis=0))).sum() > flooded.sum():
            flooded = grown
        touched = faces[flooded[faces].any(axis=1)]
        points = trimesh.triangles.closest_point(target[touched], np.tile(start, (len(touched), 1)))
        share = trimesh.triangles.points_to_barycentric(target[touched], points)
        weights = np.zeros((len(touched), len(near)))
        np.put_along_axis(weights, touched, share, axis=1)
        return zip(points, weights)

    np.testing.assert_allclose(cortical_thickness(white, pial, cap=3.0), twin(white, pial, 3.0, search), rtol=1e-6)


def test_thickness_is_zero_where_the_surfaces_meet_and_nan_where_no_face_is():
    white, pial = shell(3, 48, 50)
    inner = np.where(pial.verts[:, 2:] > 40, pial.verts, white.verts)
    lone = np.array([[0.0, 0.0, 99.0]])
    white, pial = Surface(np.r_[inner, lone], white.faces), Surface(np.r_[pial.verts, lone], pial.faces)
    thickness = cortical_thickness(white, pial)
    assert np.isnan(thickness[-1])
    assert np.isfinite(thickness[:-1]).all()
    assert (thickness[:-1][pial.verts[:-1, 2] > 40] == 0).all()


@pytest.mark.parametrize("mode", ["surface", "freesurfer"])
def test_thickness_is_the_same_to_the_bit_for_any_number_of_threads(mode, rng):
    white, pial = shell(4, 47, 50)
    white = Surface(white.verts + rng.normal(0, 0.3, white.verts.shape), white.faces)
    many = cortical_thickness(white, pial, mode=mode)
    with using_threads(1):
        np.testing.assert_array_equal(cortical_thickness(white, pial, mode=mode), many)


def test_the_average_brain_has_the_thickness_that_independent_code_found():
    cortex = read_cortex(files("morphofold.data_samples") / "fsaverage5", hemi="lh")
    fine = cortical_thickness(cortex.white, cortex.pial)
    coarse = cortical_thickness(cortex.white, cortex.pial, mode="freesurfer")
    assert fine[fine > 0].mean() == pytest.approx(2.33, abs=0.02)
    assert coarse[coarse > 0].mean() == pytest.approx(2.51, abs=0.02)
    both = (fine > 0) & (cortex.maps["thickness"] > 0)  # the file is a mean over subjects: order only
    assert np.corrcoef(fine[both], cortex.maps["thickness"][both])[0, 1] > 0.6


@pytest.mark.parametrize(
    ("change", "kind", "expected"),
    [
        ({"mode": "nearest"}, UnknownName, r"\bmode\b.*'nearest'"),
        ({"cap": 0.0}, OutOfRange, r"\bcap\b.* 0\.0\.$"),
        ({"rings": 0}, OutOfRange, r"\brings\b.* 0\.$"),
    ],
)
def test_options_without_meaning_are_refused(change, kind, expected):
    with pytest.raises(kind, match=expected):
        cortical_thickness(*shell(1, 4, 5), **change)


def test_surfaces_that_do_not_correspond_are_refused_with_their_counts():
    with pytest.raises(UnlikeSurfaces, match=r"\b42 .* 80 .*\b162, 320\b"):
        cortical_thickness(shell(1, 4, 5)[0], shell(2, 4, 5)[1])
