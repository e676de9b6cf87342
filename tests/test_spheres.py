"""Spheres: maps resampled between surfaces registered on them, spin tests of two maps, and spheres made for closed
surfaces that have none."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from morphofold import shapes
from morphofold.analysis import smooth, spin_test
from morphofold.errors import BadMesh, DoesNotApply, OpenSurface, OutOfRange, UnknownName, WrongShape
from morphofold.geometry import face_areas, face_vectors, vertex_areas
from morphofold.io import read_surface, sample_path
from morphofold.spheres.resampling import Resampling
from morphofold.spheres.spins import rotations
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.surface import Surface
from morphofold.unfolding import spheres
from morphofold.unfolding.spheres import _round, sphere_of
from morphofold.unfolding.unfold import unfold


def sphere(level, radius=100.0, **options):
    make = irregular_sphere if options else shapes.icosphere
    return Surface(*make(level, radius=radius, **options))


def areas(surface):
    return vertex_areas(surface.verts, surface.faces)


@pytest.fixture(scope="module")
def template():
    return read_surface(sample_path("fsaverage5/surf/lh.sphere"))


# resampling --------------------------------------------------------------------------------------------------


def harmonic(surface):
    """A harmonic of degree 4 (its azimuthal order is 2)."""
    x, y, z = surface.verts.T / np.linalg.norm(surface.verts, axis=1)
    return (x**2 - y**2) * (7 * z**2 - 1)


def rms(values, surface):
    weights = areas(surface)
    return float(np.sqrt(weights @ values**2 / weights.sum()))


def error_of(how, source, target):
    resampling, values = Resampling(source, target), harmonic(source)
    values = resampling.values(values) if how == "values" else resampling.means(values, areas(source))
    return rms(values - harmonic(target), target) / rms(harmonic(target), target)


def test_a_template_onto_itself_is_exact_whatever_its_radius(template, rng):
    same, n = Resampling(template, Surface(template.verts / 100, template.faces)), len(template.verts)
    values, labels = rng.standard_normal(n), rng.integers(-1, 30, n)
    np.testing.assert_allclose(same.values(values), values, atol=1e-9)
    np.testing.assert_allclose(same.means(values, areas(template)), values, atol=1e-9)
    np.testing.assert_allclose(same.sums(values), values, atol=1e-9)
    np.testing.assert_array_equal(same.labels(labels, areas(template)), labels)


def test_values_come_over_with_second_order_in_the_edge_of_the_source():
    target = sphere(3, rng=1)
    errors = np.array([error_of("values", sphere(level, rng=2), target) for level in (3, 4, 5)])
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2, atol=0.2)
    assert errors[-1] < 0.004


@pytest.mark.parametrize(("even", "order", "least"), [({}, 1.9, 0.01), ({"rng": 1}, 1.0, 0.06)], ids=["even", "uneven"])
def test_means_on_a_coarse_target_are_of_second_order_in_its_edge_if_it_is_even(even, order, least):
    source = sphere(6)
    errors = np.array([error_of("means", source, sphere(level, **even)) for level in (2, 3, 4)])
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), order, atol=0.3)
    assert errors[-1] < least


def test_means_of_noise_use_all_vertices_and_values_only_some(rng):
    source, target = sphere(6), sphere(3)
    noise, resampling = rng.standard_normal(len(source.verts)), Resampling(source, target)
    assert resampling.values(noise).std() > 0.5
    mean = resampling.means(noise, areas(source)).std()
    assert mean < 2 * np.sqrt(len(target.verts) / len(source.verts))  # 64 vertices around each of the target's


@pytest.mark.parametrize(("fine", "coarse"), [(5, 3), (3, 5), (4, 4)])
def test_sums_are_kept_to_round_off_and_areas_are_areas(fine, coarse, rng):
    source, target = sphere(fine, rng=1), sphere(coarse, rng=2)
    counts = rng.integers(0, 5, len(source.verts)).astype(float)
    sums = Resampling(source, target).sums(counts)
    assert sums.sum() == pytest.approx(counts.sum(), rel=1e-13)
    assert (sums >= 0).all()
    np.testing.assert_allclose(
        Resampling(sphere(5, rng=1), sphere(3)).sums(areas(sphere(5, rng=1))), areas(sphere(3)), rtol=0.1
    )


def test_labels_have_the_majority_and_cover_the_same_area(rng):
    source, target = sphere(5), sphere(3)
    north = (source.verts[:, 2] > 0).astype(np.int64)
    labels = Resampling(source, target).labels(np.where(rng.random(len(north)) < 0.05, 7, north), areas(source))
    far = np.abs(target.verts[:, 2]) > 20
    np.testing.assert_array_equal(labels[far], target.verts[far, 2] > 0)
    finer, cap = sphere(4, rng=3), (source.verts[:, 2] > 50).astype(np.int64)
    covered = areas(finer)[Resampling(source, finer).labels(cap, areas(source)) == 1].sum()
    assert covered == pytest.approx(face_areas(source.verts, source.faces).sum() / 4, rel=0.02)


def test_a_mean_is_missing_where_most_of_it_is():
    source, target = sphere(5), sphere(3)
    values, z = np.where(source.verts[:, 2] > 0, 2.0, np.nan), target.verts[:, 2]
    means = Resampling(source, target).means(values, areas(source))
    assert np.isnan(means[z < -20]).all()
    np.testing.assert_allclose(means[z > 20], 2.0)
    assert Resampling(source, target).sums(values).sum() == pytest.approx(2.0 * np.isfinite(values).sum())


def test_surfaces_that_are_no_spheres_and_maps_of_others_are_refused():
    white = read_surface(sample_path("fsaverage5/surf/lh.white"))
    with pytest.raises(BadMesh):
        Resampling(white, sphere(3))
    with pytest.raises(WrongShape):
        Resampling(sphere(3), sphere(2)).values(np.zeros(10))


# spin tests --------------------------------------------------------------------------------------------------


def smooth_maps(ball, count, seed, fwhm=40.0):
    noise = np.random.default_rng(seed).standard_normal((len(ball.verts), count))
    return smooth(ball.verts, ball.faces, noise, fwhm).T


def by_search(x, y, points, turns):
    """The usual way: a search for the nearest vertex of every rotated point, and a correlation of known values."""
    tree, correlations = cKDTree(points), []
    for turn in turns:
        rotated = x[tree.query(points @ turn)[1]]
        both = np.isfinite(rotated) & np.isfinite(y)
        correlations.append(np.corrcoef(rotated[both], y[both])[0, 1])
    return np.array(correlations)


@pytest.mark.parametrize("wall", [False, True])
def test_a_spin_test_is_the_usual_one(wall):
    ball = sphere(4)
    x, y = smooth_maps(ball, 2, 1)
    if wall:
        x, y = (np.where(ball.verts[:, 0] > -80, values, np.nan) for values in (x, y))
    result, both = spin_test(x, y, ball, spins=50, seed=3), np.isfinite(x)
    np.testing.assert_allclose(result.null, by_search(x, y, ball.verts / 100.0, rotations(50, 3)), atol=1e-10)
    assert result.value == pytest.approx(np.corrcoef(x[both], y[both])[0, 1], abs=1e-12)
    assert result.p == (1 + np.count_nonzero(np.abs(result.null) >= abs(result.value))) / 51
    assert result.p_greater == (1 + np.count_nonzero(result.null >= result.value)) / 51
    assert not np.array_equal(spin_test(x, y, ball, spins=50, seed=2).null, result.null)


def test_a_spin_test_is_the_usual_one_on_the_sphere_of_a_template(template):
    points = template.verts / np.linalg.norm(template.verts, axis=1, keepdims=True)
    x, y = smooth_maps(template, 2, 1)
    null = spin_test(x, y, template, spins=10).null
    np.testing.assert_allclose(null, by_search(x, y, points, rotations(10, 0)), atol=1e-10)


def test_a_map_is_like_itself_and_unlike_its_negative():
    (x,) = smooth_maps(sphere(4), 1, 2)
    same, negative = (spin_test(x, y, sphere(4), spins=199) for y in (x, -x))
    assert (same.value, negative.value) == pytest.approx((1.0, -1.0))
    assert same.p == same.p_greater == 1 / 200
    assert (negative.p, negative.p_greater) == (1 / 200, 1.0)


@pytest.mark.slow
def test_independent_smooth_maps_seem_related_in_one_of_twenty_and_without_spins_in_most():
    ball, pairs = sphere(4), smooth_maps(sphere(4), 200, 5).reshape(100, 2, -1)
    p = np.array([spin_test(x, y, ball, spins=99, seed=k).p for k, (x, y) in enumerate(pairs)])
    assert np.count_nonzero(p <= 0.05) <= 11  # 5 of 100 are expected; more than 11 in 0.4 % of cases
    assert 0.4 < p.mean() < 0.6
    r = np.array([np.corrcoef(x, y)[0, 1] for x, y in pairs])  # 2,562 vertices are not 2,562 independent values
    assert np.mean(np.abs(r) > 1.96 / np.sqrt(len(ball.verts))) > 0.5


def test_ranks_do_not_feel_one_wild_value():
    ball = sphere(4)
    x, y = smooth_maps(ball, 2, 1)
    value = spin_test(x, y, ball, spins=20, method="spearman").value
    assert value == pytest.approx(spearmanr(x, y).statistic, abs=1e-12)
    x[17] = 1e9
    assert spin_test(x, y, ball, spins=20, method="spearman").value == pytest.approx(value, abs=0.01)


def test_bad_input_of_a_spin_test_is_refused():
    ball = sphere(4)
    x, y = smooth_maps(ball, 2, 1)
    for error, arguments, options in (
        (WrongShape, (x[:-1], y, ball), {}),
        (OutOfRange, (x, y, ball), {"spins": 0}),
        (UnknownName, (x, y, ball), {"method": "kendall"}),
        (DoesNotApply, (np.ones_like(x), y, ball), {}),
        (DoesNotApply, (x, np.where(np.arange(len(y)) < 5, y, np.nan), ball), {}),
        (BadMesh, (x, y, Surface(ball.verts + [150.0, 0, 0], ball.faces)), {}),
    ):
        with pytest.raises(error):
            spin_test(*arguments, **options)


# spheres for closed surfaces ---------------------------------------------------------------------------------


def dumbbell():
    verts, faces = shapes.icosphere(4)
    return Surface(verts * (1 + 0.8 * verts[:, :1] ** 2) * [2.0, 1.0, 1.0], faces, name="dumbbell")


def covers_once(ball):
    """Whether no face is inside out and the area is that of the sphere."""
    facing = np.einsum("fi,fi->f", face_vectors(ball.verts, ball.faces), ball.verts[ball.faces[:, 0]])
    return bool((facing > 0).all()) and face_areas(ball.verts, ball.faces).sum() == pytest.approx(4 * np.pi, rel=0.01)


def angles(verts, faces):
    a, b, c = (verts[np.roll(faces, k, axis=1)] for k in range(3))
    u, v = b - a, c - a
    cosine = np.sum(u * v, axis=2) / np.linalg.norm(u, axis=2) / np.linalg.norm(v, axis=2)
    return np.degrees(np.arccos(cosine))


def test_the_limit_of_the_flow_is_conformal(monkeypatch):
    """Angles of triangles on the sphere are those of the ellipsoid, the nearer the finer its mesh is."""
    monkeypatch.setattr(spheres, "ROUND_SPREAD", 1e-5)
    monkeypatch.setattr(spheres, "STANDSTILL", 1.0)
    monkeypatch.setattr(spheres, "COTANGENT_LIMITS", (-20.0, 20.0))  # positive ones, for safety, change angles a little
    errors = []
    for level in (3, 4, 5):
        verts, faces = shapes.icosphere(level)
        surface = Surface(verts * [1.6, 1.0, 0.8], faces, name="ellipsoid")
        before, after = (angles(x, faces) for x in (surface.verts, _round(surface, lambda *_: None)))
        errors.append(np.abs(after - before).mean())
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 1  # degree


def test_a_sphere_stays_one_and_a_dumbbell_gets_one_with_even_areas():
    verts, faces = shapes.icosphere(4)
    again = sphere_of(Surface(3 * verts + [1.0, 2.0, 3.0], faces, name="shifted"))
    np.testing.assert_allclose(again.verts @ again.verts[0], verts @ verts[0], atol=0.02)  # up to a rotation
    surface = dumbbell()
    ball, flow = sphere_of(surface), Surface(_round(surface, lambda *_: None), surface.faces)
    assert covers_once(ball)
    assert np.std(np.log(areas(surface) / areas(ball))) < 0.15
    assert np.std(np.log(areas(surface) / areas(flow))) > 0.3
    with pytest.raises(OpenSurface):
        sphere_of(Surface(surface.verts, surface.faces[1:], name="torn"))


@pytest.mark.slow
def test_a_cortex_unfolds_without_its_sphere_nearly_as_with_it(template):
    white = read_surface(sample_path("fsaverage5/surf/lh.white"))
    ball = sphere_of(white)
    assert covers_once(ball)
    with_own, without = (unfold(white, s, 0.05, radius=50.0).smooth().verts for s in (template, ball))
    assert np.median(np.linalg.norm(with_own - without, axis=1)) < 10
