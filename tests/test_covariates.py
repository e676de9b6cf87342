"""Covariates of participants.tsv in the tables of a group."""

import pytest
from commands import refused
from made_cohort import work_here, write_subject

from morphofold.cli import main
from morphofold.errors import NamedTwice, WrongFile
from morphofold.group.covariates import NO_COVARIATES, find_covariates
from morphofold.group.group_tables import TAKEN_COLUMNS
from morphofold.group.spaces import find_space
from morphofold.io import write_surface
from morphofold.shapes import icosphere
from morphofold.surface import Surface
from morphofold.tables import read_table

PEOPLE = """\
participant_id\tage\tvisits\tgroup\tpatient
sub-anna\t23.5\t3\tpatients, old\tTrue
ben\tn/a\t\tn/a\tFalse
eve\t50\t7\tcontrols\tTrue
"""
ANNA = {"age": 23.5, "visits": 3, "group": "patients, old", "patient": "True"}
WORDS = ("subject", "hemi", "group", "patient", "participant_id", "reason", "log", "morphofold", "cortex_mask")
NOTHING = dict.fromkeys(ANNA)


@pytest.fixture
def people(tmp_path):
    path = tmp_path / "participants.tsv"
    path.write_text(PEOPLE)
    return path


@pytest.fixture
def study(cwd, monkeypatch):
    """A cohort of anna, ben, and cleo, who is in no table; cleo's right side can't be read."""
    work_here(monkeypatch)
    for name in ("anna", "ben", "cleo"):
        folder = write_subject(cwd / "all" / name)
        write_surface(folder / "surf" / "lh.sphere.reg", Surface(*icosphere(2, radius=100.0)))
    (cwd / "all" / "cleo" / "surf" / "rh.pial").write_bytes(b"")
    return ["cohort", "all", "-o", "out", "--no-report", "-q", "--curvature-scale", "8", "--gyral-width", "9"]


def test_numbers_words_and_what_is_missing_have_their_types(people):
    found = find_covariates(people)
    assert found.columns == ("age", "visits", "group", "patient")
    assert found.of("anna") == found.of("sub-anna") == ANNA
    assert [type(value) for value in found.of("anna").values()] == [float, int, str, str]
    assert found.of("ben") == {**NOTHING, "patient": "False"}
    assert found.of("nobody") == NOTHING


def test_a_longitudinal_run_has_those_of_its_time_point_and_a_column_tells_the_person(tmp_path):
    (tmp_path / "t.tsv").write_text("participant_id\tage\tperson\nanna_1\t30\teve\nben\t40\tn/a\n")
    found = find_covariates(tmp_path / "t.tsv").of_sessions(["anna_1.long.anna"])
    assert found.columns == ("person", "session", "age")
    assert found.of("anna_1.long.anna") == {"person": "eve", "session": "1", "age": 30}
    assert [found.person(name) for name in ("anna_1.long.anna", "ben_1.long.ben", "zoe")] == ["eve", "ben", "zoe"]
    assert NO_COVARIATES.of_sessions(["anna", "ben"]) is NO_COVARIATES


def test_a_person_may_have_the_number_0(tmp_path):
    (tmp_path / "t.tsv").write_text("participant_id\tperson\na\t0\nb\t0\nc\t1\n")
    found = find_covariates(tmp_path / "t.tsv")
    assert [found.person(name) for name in "abc"] == ["0", "0", "1"]


def test_a_session_has_the_covariates_of_its_person_unless_it_has_a_row(tmp_path):
    (tmp_path / "t.tsv").write_text("participant_id\tage\nsub-01\t30\nsub-02_ses-b\t41\nsub-02\t40\n")
    found = find_covariates(tmp_path / "t.tsv")
    ages = {name: found.of(name)["age"] for name in ("sub-01_ses-a", "sub-02_ses-a", "sub-02_ses-b", "01_2")}
    assert ages == {"sub-01_ses-a": 30, "sub-02_ses-a": 40, "sub-02_ses-b": 41, "01_2": None}


def test_the_table_that_is_given_comes_before_those_that_are_found(people, tmp_path):
    other = tmp_path / "other.csv"
    other.write_text("participant_id,iq\nanna,100\n")
    assert find_covariates(other, [tmp_path]).columns == ("iq",)
    assert find_covariates(None, [tmp_path / "nowhere", tmp_path]).columns == tuple(ANNA)
    assert find_covariates(None, [tmp_path / "nowhere"]) is NO_COVARIATES


def test_every_table_with_few_rows_for_a_subject_has_them_after_its_name(study, cwd):
    (cwd / "all" / "participants.tsv").write_text(PEOPLE)
    assert main([*study, "--space", "fsaverage5"]) == 1
    group = cwd / "out" / "group"
    for name in ("surfaces", "hemispheres", "failures"):
        rows = read_table(group / f"{name}.tsv", WORDS)
        assert list(rows[0])[:6] == ["subject", *ANNA, "hemi"]
        for row in rows:
            want = {"anna": ANNA, "ben": {**NOTHING, "patient": "False"}, "cleo": NOTHING}[row["subject"]]
            assert {key: row[key] for key in ANNA} == want
    assert [(row["subject"], row["hemi"]) for row in rows] == [("cleo", "rh")]
    assert "age" not in (group / "measures.tsv").read_text().splitlines()[0]
    maps = read_table(cwd / "out" / "spaces" / "fsaverage5" / "group" / "participants.tsv", WORDS)
    assert [row["age"] for row in maps] == [23.5, None, None]
    assert find_space(cwd / "out").covariates == tuple(ANNA)


def test_the_table_of_surfaces_has_the_numbers_of_every_hemisphere(study, cwd):
    assert main(study) == 1
    rows = read_table(cwd / "out" / "group" / "surfaces.tsv", WORDS)
    assert list(rows[0])[:3] == ["subject", "hemi", "n_vertices"]
    sides = [(name, hemi) for name in ("anna", "ben", "cleo") for hemi in ("lh", "rh")][:-1]
    assert [(row["subject"], row["hemi"]) for row in rows] == sides
    for row in rows:
        of_subject = read_table(cwd / "out" / "subjects" / row["subject"] / "surfaces.tsv", WORDS)
        (own,) = [one for one in of_subject if one["hemi"] == row["hemi"]]
        assert {**own, "subject": row["subject"]} == row


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("participant_id\tage\nanna\t1\nsub-anna\t2\n", NamedTwice),
        ("name\tage\nanna\t1\n", WrongFile),
        ("participant_id\themi\nanna\tlh\n", NamedTwice),
        ("participant_id\tgyrification_index\nanna\t2\n", NamedTwice),
    ],
)
def test_a_table_that_cannot_be_joined_is_refused_before_anything_is_measured(study, cwd, capsys, text, kind):
    (cwd / "all" / "participants.tsv").write_text(text)
    refused(capsys, study, "participants.tsv: ", f"[{kind.code}]")
    with pytest.raises(kind):
        find_covariates(cwd / "all" / "participants.tsv", [], TAKEN_COLUMNS)
    assert not (cwd / "out").exists()
    refused(capsys, [*study, "--participants", "nowhere.tsv"], "nowhere.tsv: ")


def test_a_bids_dataset_has_them_at_its_root(cwd, monkeypatch):
    work_here(monkeypatch)
    for name in ("sub-01_ses-a", "sub-01_ses-b"):
        write_subject(cwd / "data" / "derivatives" / "freesurfer" / name, hemis=("lh",))
    (cwd / "data" / "participants.tsv").write_text("participant_id\tsex\nsub-01\tF\n")
    assert main(["bids", "data", "out", "participant", "--no-report", "-q"]) == 0
    assert main(["bids", "data", "out", "group", "-q"]) == 0
    rows = read_table(cwd / "out" / "group" / "surfaces.tsv", (*WORDS, "sex"))
    assert [(row["subject"], row["sex"]) for row in rows] == [("sub-01_ses-a", "F"), ("sub-01_ses-b", "F")]
