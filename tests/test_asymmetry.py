"""Left against right at every vertex, and repeated measures."""

import numpy as np
import pytest
from commands import refused
from made_spaces import VERTS, write_space

from morphofold.errors import DoesNotApply, UnknownName
from morphofold.group.spaces import find_space
from morphofold.group.study import fit_study, summary
from morphofold.tables import write_table

NORTH = VERTS[:, 2] > 20
CORTEX = VERTS[:, 2] > -40
SUBJECTS = 16


def people(study, names, **columns):
    rows = [
        {"participant_id": name} | {key: values[k] for key, values in columns.items()} for k, name in enumerate(names)
    ]
    write_table(study / "participants.tsv", ("participant_id", *columns), rows)
    return study / "participants.tsv"


@pytest.fixture
def sides(tmp_path, rng):
    """The left is 10 % thicker than the right in the north, and subjects differ by far more than that."""
    level = rng.uniform(1.5, 3.5, (SUBJECTS, 1))
    left = level * (1 + 0.05 * NORTH) + 0.02 * rng.standard_normal((SUBJECTS, len(VERTS)))
    right = level * (1 - 0.05 * NORTH) + 0.02 * rng.standard_normal((SUBJECTS, len(VERTS)))
    maps = {"lh.cortical_thickness": left, "rh.cortical_thickness": right}
    study = tmp_path / "study"
    names = write_space(study, maps, symmetric=True)
    return study, people(study, names, age=rng.uniform(20, 80, SUBJECTS).tolist())


def fitted(sides, model="cortical_thickness ~ 1", contrast="1", **options):
    return fit_study(find_space(sides[0]), sides[1], model, contrast, permutations=199, **options)


def test_the_difference_of_left_and_right_is_tested_within_subjects(sides):
    found = fitted(sides, asymmetry="difference")
    assert found.hemis == ("lh",)
    assert found.inference.flipped
    p = found.inference.p_height
    assert (p[NORTH] <= 0.05).all()
    assert (p[CORTEX & ~NORTH] <= 0.05).mean() <= 0.01
    assert np.isnan(p[~CORTEX]).all()
    assert found.inference.effect[NORTH].mean() == pytest.approx(0.1 * 2.5, rel=0.15)


def test_the_index_is_the_difference_over_the_mean(sides):
    found = fitted(sides, asymmetry="index")
    np.testing.assert_allclose(found.inference.effect[NORTH], 0.1, atol=0.02)


def test_asymmetry_needs_a_symmetric_template_and_a_known_kind(tmp_path, sides, rng):
    maps = {f"{hemi}.H": rng.standard_normal((SUBJECTS, len(VERTS))) for hemi in ("lh", "rh")}
    names = write_space(tmp_path / "plain", maps)
    table = people(tmp_path / "plain", names, age=list(range(SUBJECTS)))
    with pytest.raises(DoesNotApply):
        fit_study(find_space(tmp_path / "plain"), table, "H ~ 1", "1", asymmetry="difference")
    with pytest.raises(UnknownName):
        fitted(sides, asymmetry="ratio")


@pytest.fixture
def visits(tmp_path, rng):
    """Eight people, each measured twice; the second time the north is 0.1 mm thinner. People differ by 1 mm."""
    person = np.repeat(np.arange(8), 2)
    visit = np.tile([0, 1], 8)
    maps = rng.uniform(2, 3, (8, 1))[person] - 0.1 * np.outer(visit, NORTH)
    maps = maps + 0.01 * rng.standard_normal((16, len(VERTS)))
    names = write_space(tmp_path / "study", {"lh.cortical_thickness": maps}, hemis=["lh"])
    table = people(
        tmp_path / "study",
        names,
        person=[f"p{k}" for k in person],
        visit=visit.tolist(),
        age=(20.0 + 5 * person).tolist(),
    )
    return tmp_path / "study", table


def test_repeated_measures_are_exchanged_within_a_person(visits):
    model = "cortical_thickness ~ visit + C(person)"
    found = fitted(visits, model, "visit", blocks="person", hemis=["lh"])
    assert (found.inference.p_height[NORTH] <= 0.05).mean() > 0.95
    assert (found.inference.p_height[CORTEX & ~NORTH] <= 0.05).mean() <= 0.01
    assert found.inference.effect[NORTH].mean() == pytest.approx(-0.1, abs=0.01)


def test_what_is_the_same_in_a_block_is_tested_by_exchanging_whole_blocks(visits):
    whole = fitted(visits, "cortical_thickness ~ age", "age", blocks="person", whole=True, hemis=["lh"])
    assert len(np.unique(whole.inference.null_height)) > 100
    with pytest.raises(DoesNotApply):  # no exchange within a person changes it
        fitted(visits, "cortical_thickness ~ age", "age", blocks="person", hemis=["lh"])
    with pytest.raises(DoesNotApply):  # no exchange of persons changes what differs within them
        fitted(visits, "cortical_thickness ~ visit", "visit", blocks="person", whole=True, hemis=["lh"])
    assert summary(whole)["exchanged"] == "blocks"


def test_whole_blocks_without_a_column_are_refused(visits, capsys, tmp_path):
    argv = ["stats", str(visits[0]), "--model", "cortical_thickness ~ age", "--contrast", "age", "--whole-blocks"]
    refused(capsys, [*argv, "-o", str(tmp_path / "out")], "--blocks")
    refused(capsys, [*argv[:-1], "--asymmetry", "index", "--hemi", "rh", "-o", str(tmp_path / "out")], "--hemi")
    assert not (tmp_path / "out").exists()


def test_the_mean_asymmetry_is_tested_by_signs_whatever_the_covariates(sides):
    found = fitted(sides, "cortical_thickness ~ center(age)", "1", asymmetry="difference")
    assert found.inference.flipped
    assert (found.inference.p_height[NORTH] <= 0.05).all()
