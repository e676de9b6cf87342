"""The subjects of a cohort: found in a folder, persons and sessions by their names, and covariates of participants."""

import pytest
from commands import refused
from made_cohort import work_here, write_subject

from morphofold.cli import main
from morphofold.errors import NamedTwice, NothingToDo, WrongFile
from morphofold.group.design import person_and_session
from morphofold.group.group_tables import TAKEN_COLUMNS
from morphofold.group.spaces import find_space
from morphofold.group.subjects import NO_COVARIATES, find_covariates, find_subjects, named_subjects
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
NOTHING = dict.fromkeys(ANNA)
BEN = {**NOTHING, "patient": "False"}
WORDS = ("subject", "hemi", "group", "patient", "participant_id", "reason", "log", "morphofold", "cortex_mask", "sex")


def read(folder, text, name="participants.tsv"):
    (folder / name).write_text(text)
    return find_covariates(folder / name)


# folders -----------------------------------------------------------------------------------------------------


def test_subjects_are_found_and_templates_left_out(tmp_path):
    write_subject(tmp_path / "anna")
    write_subject(tmp_path / "fsaverage5")
    (tmp_path / "half" / "mri").mkdir(parents=True)  # FreeSurfer stopped in it
    (tmp_path / "notes").mkdir()
    (tmp_path / "table.csv").touch()
    (tmp_path / "fsaverage").symlink_to("anna")
    (tmp_path / "lh.EC_average").symlink_to("anna")
    templates = dict.fromkeys(("fsaverage", "fsaverage5", "lh.EC_average"), "template")
    assert find_subjects(tmp_path) == ({name: tmp_path / name for name in ("anna", "half")}, templates)
    with pytest.raises(NothingToDo, match="notes"):
        find_subjects(tmp_path / "notes")
    with pytest.raises(FileNotFoundError, match="none"):
        find_subjects(tmp_path / "none")
    (tmp_path / "list.txt").write_text("\ufeffben  # the second\n\nanna/\n", encoding="utf-8")
    assert named_subjects(tmp_path / "list.txt") == ["ben", "anna"]


def test_of_longitudinal_runs_bases_and_other_runs_of_their_time_points_are_left_out(tmp_path):
    names = ["anna", "anna_1", "anna_2", "anna_1.long.anna", "ben", "ben_base", "ben_1", "ben_2", "sub-03_ses-1"]
    for name in (*names, "sub-04/ses-1", "sub-04/ses-2", "sub-05"):
        (tmp_path / name / "surf").mkdir(parents=True)
    (tmp_path / "anna" / "base-tps").write_text("anna_1\nanna_2\n")  # the longitudinal run of anna_2 is missing
    (tmp_path / "ben_base" / "base-tps").write_text("ben_1\nben_2\n")  # ben has none yet
    subjects, left_out = find_subjects(tmp_path)
    runs = ["anna_1.long.anna", "ben", "ben_1", "ben_2"]
    assert list(subjects) == [*runs, "sub-03_ses-1", "sub-04_ses-1", "sub-04_ses-2", "sub-05"]
    reasons = {"anna": "base", "anna_1": "cross-sectional", "anna_2": "cross-sectional", "ben_base": "base"}
    assert {name: reason.split()[0] for name, reason in left_out.items()} == reasons
    assert subjects["sub-04_ses-2"] == tmp_path / "sub-04" / "ses-2"
    assert subjects["sub-03_ses-1"] == tmp_path / "sub-03_ses-1"


@pytest.mark.parametrize(
    ("name", "person", "session"),
    [
        ("sub-01", "sub-01", ""),
        ("sub-01_ses-1", "sub-01", "ses-1"),
        ("01_ses-pre", "01", "ses-pre"),
        ("anna_ses1", "anna", "ses1"),
        ("anna_tp2", "anna", "tp2"),
        ("anna.visit_03", "anna", "visit_03"),
        ("anna_V2", "anna", "V2"),
        ("sub-v01_ses-2", "sub-v01", "ses-2"),
        ("anna_ses1.long.anna", "anna", "ses1"),
        ("scan7.long.anna_base", "anna_base", "scan7"),
        ("x.long.sub-01_ses-1", "sub-01", "x"),
        ("sub-01_ses-2.long.sub-01_base", "sub-01", "ses-2"),
        ("002_S_0413", "002_S_0413", ""),
        ("smith_tpatel", "smith_tpatel", ""),
        ("study_time", "study_time", ""),
        ("HC_v12", "HC_v12", ""),
        ("study_v2_007", "study_v2_007", ""),
    ],
)
def test_a_name_shows_the_person_and_the_session(name, person, session):
    assert person_and_session(name) == (person, session)


# covariates --------------------------------------------------------------------------------------------------


def test_numbers_words_and_missing_values_have_their_types(tmp_path):
    covariates = read(tmp_path, PEOPLE)
    assert covariates.columns == tuple(ANNA)
    assert covariates.of("anna") == covariates.of("sub-anna") == ANNA
    assert [type(value) for value in covariates.of("anna").values()] == [float, int, str, str]
    assert covariates.of("ben") == BEN
    assert covariates.of("nobody") == NOTHING
    other = tmp_path / "other.csv"
    other.write_text("participant_id,iq\nanna,100\n")
    assert find_covariates(other, [tmp_path]).columns == ("iq",)
    assert find_covariates(None, [tmp_path / "nowhere", tmp_path]).columns == tuple(ANNA)
    assert find_covariates(None, [tmp_path / "nowhere"]) is NO_COVARIATES


def test_sessions_have_the_covariates_of_their_time_point_or_person_and_a_column_names_the_person(tmp_path):
    covariates = read(tmp_path, "participant_id\tage\tperson\nanna_1\t30\teve\nben\t40\tn/a\nzero\t1\t0\n")
    of_sessions = covariates.of_sessions(["anna_1.long.anna"])
    assert of_sessions.columns == ("person", "session", "age")
    assert of_sessions.of("anna_1.long.anna") == {"person": "eve", "session": "1", "age": 30}
    persons = [covariates.person(name) for name in ("anna_1.long.anna", "ben_1.long.ben", "zoe", "zero")]
    assert persons == ["eve", "ben", "zoe", "0"]
    assert NO_COVARIATES.of_sessions(["anna", "ben"]) is NO_COVARIATES
    ages = read(tmp_path, "participant_id\tage\nsub-01\t30\nsub-02_ses-b\t41\nsub-02\t40\n")
    names = ("sub-01_ses-a", "sub-02_ses-a", "sub-02_ses-b", "01_2")
    assert [ages.of(name)["age"] for name in names] == [30, 40, 41, None]


@pytest.fixture
def study(cwd, monkeypatch):
    """A cohort of anna, ben, and cleo, who is in no table; cleo's right side can't be read."""
    work_here(monkeypatch)
    for name in ("anna", "ben", "cleo"):
        folder = write_subject(cwd / "all" / name)
        write_surface(folder / "surf" / "lh.sphere.reg", Surface(*icosphere(2, radius=100.0)))
    (cwd / "all" / "cleo" / "surf" / "rh.pial").write_bytes(b"")
    return ["cohort", "all", "-o", "out", "--no-report", "-q", "--curvature-scale", "8", "--gyral-width", "9"]


def test_every_table_with_few_rows_for_a_subject_has_covariates_after_its_name(study, cwd):
    (cwd / "all" / "participants.tsv").write_text(PEOPLE)
    assert main([*study, "--space", "fsaverage5"]) == 1
    group, tables = cwd / "out" / "group", {}
    for name in ("surfaces", "hemispheres", "failures"):
        tables[name] = read_table(group / f"{name}.tsv", WORDS)
        assert list(tables[name][0])[:6] == ["subject", *ANNA, "hemi"]
        for row in tables[name]:
            expected = {"anna": ANNA, "ben": BEN, "cleo": NOTHING}[row["subject"]]
            assert {key: row[key] for key in ANNA} == expected
    assert [(row["subject"], row["hemi"]) for row in tables["failures"]] == [("cleo", "rh")]
    assert "age" not in (group / "measures.tsv").read_text().splitlines()[0]
    maps = read_table(cwd / "out" / "spaces" / "fsaverage5" / "group" / "participants.tsv", WORDS)
    assert [row["age"] for row in maps] == [23.5, None, None]
    assert find_space(cwd / "out").covariates == tuple(ANNA)
    sides = [(name, hemi) for name in ("anna", "ben", "cleo") for hemi in ("lh", "rh")][:-1]
    assert [(row["subject"], row["hemi"]) for row in tables["surfaces"]] == sides
    for row in tables["surfaces"]:
        own = read_table(cwd / "out" / "subjects" / row["subject"] / "surfaces.tsv", WORDS)
        assert {**row, **next(each for each in own if each["hemi"] == row["hemi"]), "subject": row["subject"]} == row


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("participant_id\tage\nanna\t1\nsub-anna\t2\n", NamedTwice),
        ("name\tage\nanna\t1\n", WrongFile),
        ("participant_id\tgyrification_index\nanna\t2\n", NamedTwice),
    ],
)
def test_a_table_that_cannot_be_joined_is_refused_before_anything_is_measured(study, cwd, capsys, text, kind):
    (cwd / "all" / "participants.tsv").write_text(text)
    refused(capsys, study, "participants.tsv: ", f"[{kind.code}]")
    with pytest.raises(kind):
        find_covariates(cwd / "all" / "participants.tsv", [], TAKEN_COLUMNS)
    assert not (cwd / "out").exists()


def test_a_bids_dataset_has_covariates_at_its_root(cwd, monkeypatch):
    work_here(monkeypatch)
    for name in ("sub-01_ses-a", "sub-01_ses-b"):
        write_subject(cwd / "data" / "derivatives" / "freesurfer" / name, hemis=("lh",))
    (cwd / "data" / "participants.tsv").write_text("participant_id\tsex\nsub-01\tF\n")
    assert main(["bids", "data", "out", "participant", "--no-report", "-q"]) == 0
    assert main(["bids", "data", "out", "group", "-q"]) == 0
    rows = read_table(cwd / "out" / "group" / "surfaces.tsv", WORDS)
    assert [(row["subject"], row["sex"]) for row in rows] == [("sub-01_ses-a", "F"), ("sub-01_ses-b", "F")]
