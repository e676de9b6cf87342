"""Cortical and gyral thickness: known lengths, twins, invariances, and surfaces that have none."""

import sys
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from made_folds import bulged
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis import cortical_thickness, gyral_thickness
from morphofold.analysis.graph.depth_potential import SurfaceOperators
from morphofold.analysis.thickness import gyral_thickness as chords
from morphofold.analysis.thickness.gyral_thickness import RayCaster, weighted_quantile
from morphofold.errors import NoCortex, OutOfRange, UnknownName, UnlikeSurfaces, WrongShape
from morphofold.geometry import mean_edge_length
from morphofold.io import read_cortex, sample_path
from morphofold.mesh_quality.cortex_checks import cortex_mask
from morphofold.shapes import icosphere
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.studies.known_shapes import corrugated_sheet, ellipsoid, ridged_sphere, sphere, with_noise
from morphofold.surface import Cortex, Surface


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
        while (larger := within & (flooded | near[flooded].any(axis=0))).sum() > flooded.sum():
            flooded = larger
        touched = faces[flooded[faces].any(axis=1)]
        points = trimesh.triangles.closest_point(target[touched], np.tile(start, (len(touched), 1)))
        weight = trimesh.triangles.points_to_barycentric(target[touched], points)
        weights = np.zeros((len(touched), len(near)))
        np.put_along_axis(weights, touched, weight, axis=1)
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


def test_the_average_brain_has_the_thickness_that_independent_code_found():
    cortex = read_cortex(files("morphofold.data_samples") / "fsaverage5", hemi="lh")
    fine = cortical_thickness(cortex.white, cortex.pial)
    coarse = cortical_thickness(cortex.white, cortex.pial, mode="freesurfer")
    assert fine[fine > 0].mean() == pytest.approx(2.33, abs=0.02)
    assert coarse[coarse > 0].mean() == pytest.approx(2.51, abs=0.02)
    both = (fine > 0) & (cortex.maps["thickness"] > 0)  # the file is a mean over subjects: order only
    assert np.corrcoef(fine[both], cortex.maps["thickness"][both])[0, 1] > 0.6


def test_options_without_meaning_and_surfaces_that_do_not_correspond_are_refused():
    for options, error in ({"mode": "nearest"}, UnknownName), ({"cap": 0.0}, OutOfRange), ({"rings": 0}, OutOfRange):
        with pytest.raises(error, match=f"^{next(iter(options))} "):
            cortical_thickness(*shell(1, 4, 5), **options)
    with pytest.raises(UnlikeSurfaces, match=r"\b42 .* 80 .*\b162, 320\b"):
        cortical_thickness(shell(1, 4, 5)[0], shell(2, 4, 5)[1])


@pytest.fixture(scope="module")
def ridged():
    cortex, chord = ridged_sphere(5, width=6.0, ridges=10)
    return cortex, chord, gyral_thickness(cortex, scale=10.0)


RIDGES = [(5, 5.0, 12, 0.0), (5, 6.0, 10, 0.1)]
FINER = [pytest.param(6, 5.0, 12, 0.1, marks=pytest.mark.slow), pytest.param(7, 8.0, 7, 0.1, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("level", "width", "ridges", "noise"), [*RIDGES, *FINER])
def test_ridges_of_known_width_are_measured_within_two_percent(level, width, ridges, noise):
    rng = np.random.default_rng(level)
    cortex, chord = ridged_sphere(level, width=width, ridges=ridges, rng=rng)
    shift = noise * mean_edge_length(cortex.pial.verts, cortex.faces) * rng.standard_normal(cortex.pial.verts.shape)
    cortex = replace(cortex, pial=replace(cortex.pial, verts=cortex.pial.verts + shift))
    result = gyral_thickness(cortex, scale=10.0)
    assert result.median == pytest.approx(chord, rel=0.02)
    low, high = (weighted_quantile(result.width, result.weight, quantile) / chord for quantile in (0.05, 0.95))
    assert low > 0.95 - 0.5 * noise
    assert high < 1.06 + 0.6 * noise
    assert result.coverage > 0.97
    assert result.reason == ""
    assert np.median(np.linalg.norm(result.points, axis=1)) == pytest.approx(52, abs=0.1)  # half of 4 above 50


@pytest.mark.parametrize(
    ("edge", "height", "noise", "scale"), [(1.5, 6.0, 0.0, None), (1.5, 12.0, 0.1, 10.0), (0.7, 6.0, 0.1, None)]
)
def test_gyri_and_sulci_of_a_corrugated_sheet_are_half_a_wavelength_wide(edge, height, noise, scale, rng):
    sheet, width = corrugated_sheet(edge, height=height, rng=rng)
    noisy = replace(sheet, verts=sheet.verts + noise * edge * rng.standard_normal(sheet.verts.shape))
    result = gyral_thickness(noisy, scale=scale)
    assert (result.median, result.median_gap) == pytest.approx((width, width), rel=0.01)
    assert np.median(result.points[:, 2]) == pytest.approx(0, abs=0.01 * height)
    assert result.coverage > 0.85  # at two sides the sheet ends in a gyrus


def narrowest(result):
    """Second percentile of the widths, without the gyri at the ends of the sheet, whose one half has no wall."""
    inner = np.abs(result.points[:, 0] - 60) < 45
    return weighted_quantile(result.width[inner], result.weight[inner], 0.02)


def displaced(surface, by, scale, seed):
    """Along its normals by noise of a standard deviation [mm], smoothed over a scale [mm]."""
    noise = SurfaceOperators(surface.verts, surface.faces)
    field = noise.smooth(np.random.default_rng(seed).standard_normal(len(surface.verts)), scale)
    return replace(surface, verts=surface.verts + (by * field / field.std())[:, None] * noise.normals)


@pytest.mark.parametrize("by", [3.0, 3.8, 4.1], ids=["open", "through by 0.1", "through by 0.7"])
def test_walls_that_pass_through_each_other_do_not_shorten_chords(by):
    sheet, width = bulged(by)
    result = gyral_thickness(sheet, scale=10.0)
    assert result.median == pytest.approx(width, rel=0.02)
    assert narrowest(result) > 0.95 * width  # from wall to wall of one sulcus: 0.1, 0.7
    assert result.coverage > 0.85


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_noise_that_pushes_walls_through_each_other_does_not_shorten_chords(seed):
    """The sulci are 0.3 mm wide, and so is the noise of each wall: two in five samples lie in two gyri."""
    sheet, width = bulged(3.6)
    result = gyral_thickness(displaced(sheet, 0.3, 3.0, seed), scale=10.0)
    assert result.median == pytest.approx(width, rel=0.02)
    assert narrowest(result) > 0.9 * width
    assert result.coverage > 0.85


@pytest.mark.parametrize(
    "name", ["fsaverage5", *(pytest.param(name, marks=pytest.mark.slow) for name in ("simulated", "S1"))]
)
def test_white_and_pial_apart_by_smooth_noise_of_a_third_of_a_millimetre_keep_the_median(name):
    """As two scans of one person are. S1 lost 6 % where walls of closed sulci came to pass through each other."""
    cortex = read_cortex(sample_path(name), hemi="lh")
    clean, errors = gyral_thickness(cortex, scale=10.0), []
    for seed in (1, 2):
        white, pial = displaced(cortex.white, 0.3, 3.0, seed), displaced(cortex.pial, 0.3, 3.0, seed + 10)
        noisy = gyral_thickness(replace(cortex, white=white, pial=pial, cortex=cortex_mask(cortex)), scale=10.0)
        errors.append(noisy.median / clean.median - 1)
        assert noisy.coverage > clean.coverage - 0.03
    assert abs(np.mean(errors)) < 0.02, errors


def test_a_width_below_the_two_cortices_at_its_ends_is_none():
    """Such are errors and no thin gyri: chords beside them are much wider."""
    cortex = read_cortex(sample_path("fsaverage5"), hemi="lh")
    result, bare = gyral_thickness(cortex, scale=10.0), gyral_thickness(cortex.pial, scale=10.0, mask=cortex.cortex)
    thickness = cortical_thickness(cortex.white, cortex.pial, cap=None)
    good = np.isfinite(result.width)
    start = thickness[cortex.faces[result.triangle]].mean(axis=1)
    end = thickness[cKDTree(cortex.pial.verts).query(result.partner[good])[1]]
    assert (result.width[good] > start[good] + 0.7 * end).all()  # at the nearest vertex, not there
    assert (bare.width < start).any()
    assert result.width[good].min() > 2.5
    refused = np.isfinite(bare.width) & (bare.width < 2 * start) & ~good
    next_to = result.width[good][cKDTree(result.points[good]).query(result.points[refused])[1]]
    assert refused.sum() > 50
    assert np.median(next_to) > 1.5 * np.median(bare.width[refused])


@pytest.mark.parametrize("thickness", [1.5, 3.5])
def test_a_fold_lower_than_two_cortices_may_be_narrower_than_they(thickness):
    """Its mid-height lies above the white matter."""
    cortex, chord = ridged_sphere(5, width=5.0, ridges=12, thickness=thickness)
    result = gyral_thickness(cortex, scale=10.0)
    assert result.median == pytest.approx(chord, rel=0.02)
    assert result.coverage > 0.6


def test_chords_end_on_the_opposite_wall_at_their_length(ridged):
    result = ridged[-1]
    good = np.isfinite(result.width)
    assert np.isnan(result.partner[~good]).all()
    length = np.linalg.norm(result.partner - result.points, axis=1)[good]
    assert np.median(np.abs(length / result.width[good] - 1)) < 0.03  # a slanting ray is longer than the width
    assert np.abs(np.linalg.norm(result.partner[good], axis=1) - 52).max() < 1
    latitude = lambda p: np.degrees(np.arccos(p[:, 2] / np.linalg.norm(p, axis=1)))
    ridge = lambda p: np.floor(latitude(p) / 18)
    assert (ridge(result.points[good]) == ridge(result.partner[good])).all()  # through its own gyrus
    _, chord, _ = ridged
    assert np.percentile(result.per_vertex / chord, [5, 95]) == pytest.approx([1, 1], abs=0.06)
    assert result.median + result.median_gap == pytest.approx(2 * 52 * np.sin(np.pi / 20), rel=0.08)  # the period


@pytest.mark.parametrize(("size", "far"), [(10.0, 300.0), (1e-3, 100.0), (1.0, 1e5)])
def test_width_turns_moves_and_grows_with_the_surface(ridged, size, far):
    cortex, _, result = ridged
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    change = lambda s: Surface(size * s.verts @ turn.T + [far, -0.7 * far, 0.3 * far], s.faces)
    other = gyral_thickness(Cortex(change(cortex.white), change(cortex.pial)), scale=10 * size)
    for name in ("median", "lower", "upper", "median_gap", "wavelength", "amplitude"):
        assert getattr(other, name) == pytest.approx(size * getattr(result, name), rel=2e-3), name
    assert other.coverage == pytest.approx(result.coverage, abs=2e-3)


def test_the_scale_that_the_surface_chooses_is_a_third_of_its_wavelength():
    brain = lambda f: ridged_sphere(5, 8.0 * f, ridges=8, radius=50 * f, height=4 * f)[0]
    small, large = gyral_thickness(brain(1)), gyral_thickness(brain(2))
    assert small.scale == pytest.approx(small.wavelength / 3, rel=0.06)
    assert large.scale == pytest.approx(2 * small.scale, rel=1e-3)
    assert large.median == pytest.approx(2 * small.median, rel=5e-3)


def test_a_part_outside_the_mask_is_left_out(ridged):
    cortex, chord, _ = ridged
    north = cortex.pial.verts[:, 2] > 0
    result = gyral_thickness(replace(cortex, cortex=north), scale=10.0)
    assert result.points[:, 2].min() > 0
    assert np.isnan(result.per_vertex[~north]).all()
    assert result.median == pytest.approx(chord, rel=0.03)
    assert gyral_thickness(cortex, scale=10.0, mask=north).median == result.median
    assert np.isfinite(result.median_where(cortex.pial.verts[:, 2] > 20, cortex.faces))
    assert np.isnan(result.median_where(~north, cortex.faces))
    both = result.contour_where(north, cortex.faces), result.contour_where(~north, cortex.faces)
    assert both == pytest.approx((result.coverage * result.weight.sum(), 0))


def test_a_ray_may_leave_white_for_less_than_the_slack_only():
    verts, faces = icosphere(3, radius=3.0)  # two balls of white, 2 apart
    scan = RayCaster(Surface(np.r_[verts, verts + [8, 0, 0]], np.r_[faces, faces + len(verts)]))
    origins, directions = np.tile([-5.0, 0.01, 0.02], (4, 1)), np.tile([1.0, 0, 0], (4, 1))
    lengths = np.array([20.0, 20.0, 9.0, 1.0])  # through both, both, the first, none
    assert scan.stays_white(origins, directions, lengths, 1.5).tolist() == [False, False, True, True]
    assert scan.stays_white(origins, directions, lengths, 2.5).all()


def test_a_folded_band_one_row_wide_is_not_said_to_be_without_folds():
    """A strip in plane strain has folds, and no second direction to measure them in."""
    x = np.linspace(0, 100, 201)
    rows = [np.column_stack([x, np.full_like(x, y), 4 * np.sin(x / 2)]) for y in (0.0, 0.5)]
    i = np.arange(200)
    faces = np.concatenate([np.column_stack([i, i + 1, i + 202]), np.column_stack([i, i + 202, i + 201])])
    result = gyral_thickness(Surface(np.concatenate(rows), faces))
    assert len(result.width) == 0
    assert result.reason.startswith("no wavelength of a band one row of triangles wide")


@pytest.mark.parametrize("scale", [10.0, None])
@pytest.mark.parametrize(
    "shape",
    [sphere(4, rng=0), with_noise(sphere(5), 0.1), ellipsoid(5, (80, 50, 30)), ellipsoid(5, (90, 40, 40))],
    ids=["irregular", "noisy", "80-50-30", "90-40-40"],
)
def test_a_surface_without_folds_has_no_samples_no_number_and_a_reason(shape, scale):
    result = gyral_thickness(shape.surface, scale=scale)
    assert result.reason.startswith("no ")
    assert len(result.points) == len(result.width) == len(result.weight) == len(result.gap) == len(result.partner) == 0
    assert np.isnan([result.median, result.lower, result.upper, result.median_gap, result.wavelength]).all()
    assert np.isnan(result.per_vertex).all()
    assert result.coverage == 0


def reproduces(result, published, unit, tolerance=0.03):
    """Whether result is published within a ``tolerance``, a share of it, and half a ``unit`` of its last digit."""
    return abs(result - published) <= tolerance * published + unit / 2


@pytest.mark.parametrize(
    ("hemi", "median", "gap", "amplitude", "wavelength", "coverage"),
    [("lh", 10.4, 5.7, 15.3, 32.4, 0.87), ("rh", 10.6, 5.6, 14.8, 31.6, 0.88)],
)
def test_the_average_brain_has_the_widths_that_independent_code_found(
    hemi, median, gap, amplitude, wavelength, coverage, monkeypatch
):
    """That code counts widths below two cortices, too."""
    monkeypatch.setattr(chords, "cortical_thickness", lambda white, pial, cap: np.zeros(len(pial.verts)))
    result = gyral_thickness(read_cortex(files("morphofold.data_samples") / "fsaverage5", hemi=hemi), scale=10.0)
    assert reproduces(result.median, median, 0.1)
    assert reproduces(result.median_gap, gap, 0.1)
    assert reproduces(result.amplitude, amplitude, 0.1)
    assert reproduces(result.wavelength, wavelength, 0.1)
    assert reproduces(result.coverage, coverage, 0.01)


@pytest.mark.slow
def test_an_individual_has_the_widths_that_independent_code_found(monkeypatch):
    monkeypatch.setattr(chords, "cortical_thickness", lambda white, pial, cap: np.zeros(len(pial.verts)))
    result = gyral_thickness(read_cortex(sample_path("S1")), scale=10.0)
    assert reproduces(result.median, 9.50, 0.01)
    assert reproduces(result.median_gap, 1.3, 0.1)
    assert reproduces(result.amplitude, 17.0, 0.1, tolerance=0.04)  # their window reaches 4 % more
    assert reproduces(result.wavelength, 32.0, 0.1)
    assert reproduces(result.coverage, 0.90, 0.01)


def test_the_precentral_gyrus_is_wider_than_the_postcentral():
    for hemi in ("lh", "rh"):
        cortex = read_cortex(files("morphofold.data_samples") / "fsaverage5", hemi=hemi)
        result = gyral_thickness(cortex, scale=10.0)
        regions = cortex.regions
        pre, post = (regions.labels == regions.names.index(name) for name in ("precentral", "postcentral"))
        assert result.median_where(pre, cortex.faces) > 1.15 * result.median_where(post, cortex.faces)


def test_without_embree_the_answer_is_an_error_that_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ImportError, match="pip install embreex"):
        gyral_thickness(sphere(2).surface)


@pytest.mark.parametrize(
    ("mask", "kind", "expected"),
    [(np.ones(3, bool), WrongShape, r"\bmask\b.*\(3,\).*\b162\b"), (np.zeros(162, bool), NoCortex, r"\bmask\b")],
)
def test_a_mask_without_meaning_is_refused(mask, kind, expected):
    with pytest.raises(kind, match=expected):
        gyral_thickness(sphere(2).surface, mask=mask)
