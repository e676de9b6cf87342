"""Maps resampled between surfaces that are registered on a sphere."""

import numpy as np
import pytest

from morphofold.errors import BadMesh, WrongShape
from morphofold.geometry import face_areas, vertex_areas
from morphofold.io import read_surface, sample_path
from morphofold.shapes import icosphere, irregular_sphere
from morphofold.spheres.resampling import Resampling
from morphofold.surface import Surface


def sphere(level, radius=100.0, **options):
    make = irregular_sphere if options else icosphere
    return Surface(*make(level, radius=radius, **options))


def areas(surface):
    return vertex_areas(surface.verts, surface.faces)


def harmonic(surface):
    """A harmonic of degree 4 (its azimuthal order is 2)."""
    x, y, z = surface.verts.T / np.linalg.norm(surface.verts, axis=1)
    return (x**2 - y**2) * (7 * z**2 - 1)


def rms(values, surface):
    weights = areas(surface)
    return float(np.sqrt(weights @ values**2 / weights.sum()))


def test_a_template_onto_itself_is_exact(rng):
    template = read_surface(sample_path("fsaverage5/surf/lh.sphere"))
    same, n = Resampling(template, template), len(template.verts)
    values, labels = rng.standard_normal(n), rng.integers(-1, 30, n)
    np.testing.assert_allclose(same.values(values), values, atol=1e-9)
    np.testing.assert_allclose(same.means(values, areas(template)), values, atol=1e-9)
    np.testing.assert_allclose(same.sums(values), values, atol=1e-9)
    np.testing.assert_array_equal(same.labels(labels, areas(template)), labels)


def test_the_radius_of_a_sphere_does_not_matter(rng):
    a, b, values = sphere(3), sphere(3, radius=1.0), rng.standard_normal(642)
    np.testing.assert_allclose(Resampling(a, b).values(values), values, atol=1e-12)


def error_of(how, source, target):
    resampling = Resampling(source, target)
    found = (
        resampling.values(harmonic(source)) if how == "values" else resampling.means(harmonic(source), areas(source))
    )
    return rms(found - harmonic(target), target) / rms(harmonic(target), target)


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
    noise, resampling = rng.standard_normal(len(source.verts)), Resampling(sphere(6), sphere(3))
    alone, mean = resampling.values(noise).std(), resampling.means(noise, areas(source)).std()
    assert alone > 0.5
    assert mean < 2 * np.sqrt(len(target.verts) / len(source.verts))  # 64 vertices around each of the target's


@pytest.mark.parametrize(("fine", "coarse"), [(5, 3), (3, 5), (4, 4)])
def test_sums_are_kept_to_round_off(fine, coarse, rng):
    source, target = sphere(fine, rng=1), sphere(coarse, rng=2)
    counts = rng.integers(0, 5, len(source.verts)).astype(float)
    found = Resampling(source, target).sums(counts)
    assert found.sum() == pytest.approx(counts.sum(), rel=1e-13)
    assert (found >= 0).all()


def test_areas_come_over_as_areas():
    source, target = sphere(5, rng=1), sphere(3)
    found = Resampling(source, target).sums(areas(source))
    np.testing.assert_allclose(found, areas(target), rtol=0.1)


def test_labels_have_the_majority(rng):
    source, target = sphere(5), sphere(3)
    north = (source.verts[:, 2] > 0).astype(np.int64)
    wrong = rng.random(len(north)) < 0.05
    found = Resampling(source, target).labels(np.where(wrong, 7, north), areas(source))
    far = np.abs(target.verts[:, 2]) > 20
    np.testing.assert_array_equal(found[far], target.verts[far, 2] > 0)


def test_a_label_covers_what_it_covered(rng):
    source, target = sphere(5), sphere(4, rng=3)
    cap = (source.verts[:, 2] > 50).astype(np.int64)
    found = Resampling(source, target).labels(cap, areas(source))
    assert areas(target)[found == 1].sum() == pytest.approx(face_areas(source.verts, source.faces).sum() / 4, rel=0.02)


def test_a_mean_is_missing_where_most_of_it_is():
    source, target = sphere(5), sphere(3)
    values = np.where(source.verts[:, 2] > 0, 2.0, np.nan)
    found = Resampling(source, target).means(values, areas(source))
    z = target.verts[:, 2]
    assert np.isnan(found[z < -20]).all()
    np.testing.assert_allclose(found[z > 20], 2.0)
    assert Resampling(source, target).sums(values).sum() == pytest.approx(2.0 * np.isfinite(values).sum())


def test_there_and_back_is_nearly_the_same():
    a, b = sphere(4, rng=1), sphere(5, rng=2)
    back = Resampling(b, a).values(Resampling(a, b).values(harmonic(a)))
    assert rms(back - harmonic(a), a) < 0.02 * rms(harmonic(a), a)


def test_what_is_no_sphere_is_refused():
    white = read_surface(sample_path("fsaverage5/surf/lh.white"))
    with pytest.raises(BadMesh):
        Resampling(white, sphere(3))
    with pytest.raises(WrongShape):
        Resampling(sphere(3), sphere(2)).values(np.zeros(10))
