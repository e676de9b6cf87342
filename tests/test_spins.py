"""The spin test: correlations of maps against rotations."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import spearmanr

from morphofold.analysis import smooth, spin_test
from morphofold.errors import BadMesh, DoesNotApply, OutOfRange, UnknownName, WrongShape
from morphofold.io import read_surface, sample_path
from morphofold.shapes import icosphere
from morphofold.spheres.spins import rotations
from morphofold.surface import Surface


@pytest.fixture(scope="module")
def sphere():
    return Surface(*icosphere(4, radius=100.0))


def smooth_maps(sphere, count, seed, fwhm=40.0):
    noise = np.random.default_rng(seed).standard_normal((len(sphere.verts), count))
    return smooth(sphere.verts, sphere.faces, noise, fwhm).T


def by_search(x, y, points, turns):
    """The usual way: a search for the nearest vertex of every turned point, and a correlation of what is known."""
    tree, found = cKDTree(points), []
    for turn in turns:
        came = x[tree.query(points @ turn)[1]]
        known = np.isfinite(came) & np.isfinite(y)
        found.append(np.corrcoef(came[known], y[known])[0, 1])
    return np.array(found)


@pytest.mark.parametrize("wall", [False, True])
def test_it_is_the_usual_test(sphere, wall):
    x, y = smooth_maps(sphere, 2, 1)
    if wall:
        x, y = (np.where(sphere.verts[:, 0] > -80, values, np.nan) for values in (x, y))
    found = spin_test(x, y, sphere, spins=50, seed=3)
    points = sphere.verts / 100.0
    np.testing.assert_allclose(found.null, by_search(x, y, points, rotations(50, 3)), atol=1e-10)
    known = np.isfinite(x)
    assert found.value == pytest.approx(np.corrcoef(x[known], y[known])[0, 1], abs=1e-12)
    stronger = np.count_nonzero(np.abs(found.null) >= abs(found.value))
    assert found.p == (1 + stronger) / 51
    assert found.p_greater == (1 + np.count_nonzero(found.null >= found.value)) / 51


def test_it_is_the_usual_test_on_the_sphere_of_a_template():
    template = read_surface(sample_path("fsaverage5/surf/lh.sphere"))
    points = template.verts / np.linalg.norm(template.verts, axis=1, keepdims=True)
    x, y = smooth_maps(template, 2, 1)
    found = spin_test(x, y, template, spins=10)
    np.testing.assert_allclose(found.null, by_search(x, y, points, rotations(10, 0)), atol=1e-10)


def test_a_map_is_like_itself_and_unlike_its_negative(sphere):
    (x,) = smooth_maps(sphere, 1, 2)
    alike, unlike = spin_test(x, x, sphere, spins=199), spin_test(x, -x, sphere, spins=199)
    assert (alike.value, unlike.value) == pytest.approx((1.0, -1.0))
    assert alike.p == alike.p_greater == 1 / 200
    assert (unlike.p, unlike.p_greater) == (1 / 200, 1.0)


@pytest.mark.slow
def test_independent_smooth_maps_are_alike_in_one_of_twenty(sphere):
    maps = smooth_maps(sphere, 200, 5)
    p = np.array([spin_test(x, y, sphere, spins=99, seed=k).p for k, (x, y) in enumerate(zip(maps[::2], maps[1::2]))])
    assert np.count_nonzero(p <= 0.05) <= 11  # 5 of 100 are expected; more than 11 in 0.4 % of cases
    assert 0.4 < p.mean() < 0.6


def test_without_spins_the_same_maps_would_often_be_called_alike(sphere):
    """Why the test is needed: 2,562 vertices are not 2,562 independent values."""
    maps = smooth_maps(sphere, 200, 5)
    r = np.array([np.corrcoef(x, y)[0, 1] for x, y in zip(maps[::2], maps[1::2])])
    assert np.mean(np.abs(r) > 1.96 / np.sqrt(len(sphere.verts))) > 0.5


def test_ranks_do_not_feel_one_wild_value(sphere):
    x, y = smooth_maps(sphere, 2, 1)
    found = spin_test(x, y, sphere, spins=20, method="spearman")
    assert found.value == pytest.approx(spearmanr(x, y).statistic, abs=1e-12)
    x[17] = 1e9
    assert spin_test(x, y, sphere, spins=20, method="spearman").value == pytest.approx(found.value, abs=0.01)


def test_seeds_and_threads(sphere):
    x, y = smooth_maps(sphere, 2, 1)
    one = spin_test(x, y, sphere, spins=30, seed=1)
    np.testing.assert_array_equal(spin_test(x, y, sphere, spins=30, seed=1).null, one.null)
    assert not np.array_equal(spin_test(x, y, sphere, spins=30, seed=2).null, one.null)


def test_bad_input_is_refused(sphere):
    x, y = smooth_maps(sphere, 2, 1)
    for error, arguments, options in (
        (WrongShape, (x[:-1], y, sphere), {}),
        (OutOfRange, (x, y, sphere), {"spins": 0}),
        (UnknownName, (x, y, sphere), {"method": "kendall"}),
        (DoesNotApply, (np.ones_like(x), y, sphere), {}),
        (DoesNotApply, (x, np.where(np.arange(len(y)) < 5, y, np.nan), sphere), {}),
        (BadMesh, (x, y, Surface(sphere.verts + [150.0, 0, 0], sphere.faces)), {}),
    ):
        with pytest.raises(error):
            spin_test(*arguments, **options)
