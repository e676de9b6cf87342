"""A made population."""

import csv

import numpy as np
import pytest

from morphofold.errors import OutOfRange
from morphofold.io import read_surface, sample_path
from morphofold.shapes import icosphere
from morphofold.shapes.population import AGES, Population, random_field, write_population

SAME = Population(size=0.0, bend=0.0, thickness=0.0, registration=0.0)


def thicknesses(folder, hemi="lh"):
    """Ages (S,), and distance from white to pial (S, N)."""
    with (folder / "participants.tsv").open(newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    both = [
        [read_surface(folder / row["participant_id"] / "surf" / f"{hemi}.{kind}").verts for kind in ("white", "pial")]
        for row in rows
    ]
    ages = np.array([float(row["age"]) for row in rows])
    return ages, np.array([np.linalg.norm(pial - white, axis=1) for white, pial in both])


def test_a_field_has_the_covariance_it_says_and_is_the_same_on_a_finer_mesh():
    points = icosphere(2)[0]
    fields = np.concatenate([random_field(points, 0.4, np.random.default_rng(k)) for k in range(1500)], axis=1)
    distance = np.linalg.norm(points - points[0], axis=1)
    covariance = fields @ fields[0] / 1500
    np.testing.assert_allclose(covariance, np.exp(-(distance**2) / 2 / 0.4**2), atol=0.13)
    fine = random_field(icosphere(3)[0], 0.4, np.random.default_rng(0))[: len(points)]
    np.testing.assert_allclose(fine, random_field(points, 0.4, np.random.default_rng(0)), atol=1e-12)


def test_without_differences_only_age_thins_the_cortex_as_planted(tmp_path):
    folder = write_population(tmp_path / "made", 4, like=SAME)
    sphere = read_surface(sample_path("fsaverage5") / "surf" / "lh.sphere").verts
    points = sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    for hemi in ("lh", "rh"):
        ages, thick = thicknesses(folder, hemi)
        slope = (thick - thick.mean(axis=0)).T @ (ages - ages.mean()) / np.sum((ages - ages.mean()) ** 2)
        expected = SAME.effect(points, hemi) if hemi == "lh" else np.zeros(len(points))
        cortex = thick.min(axis=0) > 0  # white and pial meet on the medial wall
        np.testing.assert_allclose(slope[cortex], expected[cortex], atol=2e-5)
    assert -SAME.effect(points, "lh").min() == pytest.approx(SAME.thinning, rel=0.01)


@pytest.mark.slow
def test_subjects_differ_as_they_should(tmp_path):
    folder = write_population(tmp_path / "made", 8, like=Population(thinning=0.0, size=0.0, bend=0.0), seed=3)
    ages, thick = thicknesses(folder)
    assert AGES[0] <= ages.min() < ages.max() <= AGES[1]
    cortex = thick.min(axis=0) > 1.0
    ratio = thick[:, cortex] / thick[:, cortex].mean(axis=0)
    assert ratio.std(axis=0, ddof=1).mean() == pytest.approx(0.05, rel=0.2)
    template = read_surface(sample_path("fsaverage5") / "surf" / "lh.sphere").verts
    off = [
        read_surface(subject / "surf" / "lh.sphere.reg").verts - template for subject in sorted(folder.glob("sub-*"))
    ]
    assert np.degrees(np.std(off) / 100) == pytest.approx(0.6 * np.sqrt(2 / 3), rel=0.2)  # only along the sphere


def test_the_same_seed_gives_the_same_bytes_whatever_the_number(tmp_path):
    few, more = write_population(tmp_path / "few", 1), write_population(tmp_path / "more", 2)
    other = write_population(tmp_path / "other", 1, seed=1)
    name = "sub-01/surf/lh.pial"
    assert (few / name).read_bytes() == (more / name).read_bytes() != (other / name).read_bytes()


@pytest.mark.parametrize(("subjects", "seed"), [(0, 0), (-1, 0), (10_001, 0), (1, -1)])
def test_no_subjects_too_many_or_a_negative_seed_are_refused(tmp_path, subjects, seed):
    with pytest.raises(OutOfRange):
        write_population(tmp_path / "made", subjects, seed=seed)
    assert not (tmp_path / "made").exists()
