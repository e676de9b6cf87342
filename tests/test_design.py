"""Designs of linear models from a table of participants and a formula."""

import numpy as np
import pytest

from morphofold.errors import DamagedFile, DoesNotApply, MissingPart, NamedTwice, NotFinite, UnknownName, WrongFile
from morphofold.inference.design import design, read_participants

TABLE = """participant_id\tage\tsex\tgroup\tsite
sub-01\t20\tF\ta\t1
sub-02\t30\tM\tb\t1
03\t40\tF\tc\t1
sub-04\t50.5\tM\ta\t1
sub-05\tn/a\tF\tb\t1
sub-06\t60\tM\tc\t1
"""
NAMES = ("sub-01", "02", "sub-03", "sub-04", "sub-05", "sub-06")


@pytest.fixture
def table(tmp_path):
    (tmp_path / "participants.tsv").write_text(TABLE)
    return read_participants(tmp_path / "participants.tsv")


def test_subjects_are_found_with_and_without_their_prefix(table):
    found = design(NAMES, table, "age", "age")
    assert found.subjects == ("sub-01", "02", "sub-03", "sub-04", "sub-06")
    assert found.left_out == ("sub-05",)
    assert found.columns == ("Intercept", "age")
    np.testing.assert_array_equal(found.matrix[:, 1], [20, 30, 40, 50.5, 60])
    np.testing.assert_array_equal(found.contrast, [0, 1])


def test_rows_follow_the_subjects(table):
    np.testing.assert_array_equal(design(["06", "01"], table, "age", "age").matrix[:, 1], [60, 20])


@pytest.mark.parametrize(
    ("formula", "contrast", "columns", "weights"),
    [
        ("sex", "sex", ("Intercept", "sex[T.M]"), [0, 1]),
        ("sex", "sex[T.M]", ("Intercept", "sex[T.M]"), [0, 1]),
        ("group", "group[T.b] - group[T.c]", ("Intercept", "group[T.b]", "group[T.c]"), [0, 1, -1]),
        ("C(sex)", "sex", ("Intercept", "C(sex)[T.M]"), [0, 1]),
        ("sex + group", "1", ("Intercept", "sex[T.M]", "group[T.b]", "group[T.c]"), [1, 0, 0, 0]),
        ("0 + sex", "sex[M] - sex[F]", ("sex[F]", "sex[M]"), [-1, 1]),
    ],
)
def test_contrasts_are_columns_variables_or_weights(table, formula, contrast, columns, weights):
    found = design(NAMES, table, formula, contrast)
    assert found.columns == columns
    np.testing.assert_array_equal(found.contrast, weights)
    assert found.left_out == ()


def test_interactions_are_products(table):
    found = design(["01", "02", "03", "04", "06"], table, "age * sex", "age:sex[T.M]")
    columns = dict(zip(found.columns, found.matrix.T))
    np.testing.assert_array_equal(columns["age:sex[T.M]"], columns["age"] * columns["sex[T.M]"])


def test_the_mean_alone_is_tested_by_signs(table):
    found = design(NAMES, table, "1", "1")
    np.testing.assert_array_equal(found.matrix, np.ones((6, 1)))


@pytest.mark.parametrize(
    ("error", "formula", "contrast"),
    [
        (UnknownName, "height", "height"),
        (UnknownName, "age +* (", "age"),
        (UnknownName, "age", "sex"),
        (UnknownName, "group", "group"),
        (UnknownName, "age", ""),
        (UnknownName, "age", "age - age"),
        (UnknownName, "age ~ sex", "sex"),
        (DoesNotApply, "site", "site"),
        (UnknownName, "__import__('os').getcwd()", "1"),
    ],
)
def test_what_makes_no_model_is_refused(table, error, formula, contrast):
    with pytest.raises(error):
        design(NAMES, table, formula, contrast)


def test_blocks_are_the_values_of_a_column(table):
    found = design(NAMES, table, "sex", "sex", blocks="group")
    np.testing.assert_array_equal(found.blocks, [0, 1, 2, 0, 1, 2])
    with pytest.raises(UnknownName):
        design(NAMES, table, "sex", "sex", blocks="family")


def test_a_subject_without_a_row_is_refused(table):
    with pytest.raises(MissingPart, match="07"):
        design([*NAMES, "sub-07"], table, "age", "age")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (NamedTwice, TABLE + "sub-1\t1\tF\ta\t1\nsub-02\t1\tF\ta\t1\n"),
        (WrongFile, TABLE.replace("\t", ",")),
        (WrongFile, "name\tage\na\t1\n"),
        (DamagedFile, ""),
        (DamagedFile, TABLE + "sub-07\t1\tF\ta\t1\t1\t1\n"),
    ],
)
def test_damaged_tables_are_refused(tmp_path, error, text):
    (tmp_path / "participants.tsv").write_text(text)
    with pytest.raises(error):
        read_participants(tmp_path / "participants.tsv")
    with pytest.raises(FileNotFoundError):
        read_participants(tmp_path / "nothing.tsv")


def test_commas_separate_csv(tmp_path):
    (tmp_path / "people.csv").write_text(TABLE.replace("\t", ","))
    assert list(read_participants(tmp_path / "people.csv").columns) == ["age", "sex", "group", "site"]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("participant_id\tage\tage\na\t1\t2\n", NamedTwice),
        ("participant_id\tage\na\t1\n\t2\n", DamagedFile),
        ("participant_id\tage\na\t1\na\t2\n", NamedTwice),
    ],
    ids=["two columns of a name", "a row without a name", "two rows of a name"],
)
def test_a_table_that_says_a_thing_twice_or_not_at_all_is_refused(tmp_path, text, error):
    (tmp_path / "participants.tsv").write_text(text)
    with pytest.raises(error):
        read_participants(tmp_path / "participants.tsv")


def test_infinite_values_are_refused(table):
    with pytest.raises(NotFinite):
        design(NAMES, table.assign(age=[1.0, 2, 3, 4, 5, np.inf]), "age", "age")
