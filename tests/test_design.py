"""Designs of linear models from a table of participants and a formula."""

import gzip

import numpy as np
import pandas as pd
import pytest

from morphofold.errors import DamagedFile, MissingPart, NamedTwice, NotFinite, NotReadable, UnknownName, WrongFile
from morphofold.group.design import design, read_participants

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


def test_a_variable_is_not_its_interaction(table):
    np.testing.assert_array_equal(design(NAMES, table, "sex * age", "sex").contrast, [0, 1, 0, 0])
    with pytest.raises(UnknownName):
        design(NAMES, table, "age + sex:age", "sex")


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
        (NotReadable, "age +* (", "age"),
        (UnknownName, "log(sex)", "1"),
        (UnknownName, "bs(age, df=2)", "1"),
        (NotFinite, "log(age - 50)", "1"),
        (UnknownName, "age", "sex"),
        (UnknownName, "group", "group"),
        (UnknownName, "age", ""),
        (UnknownName, "age", "age - age"),
        (NotReadable, "age ~ sex", "sex"),
        (NotReadable, "__import__('os').getcwd()", "1"),
    ],
)
def test_what_makes_no_model_is_refused(table, error, formula, contrast):
    with pytest.raises(error):
        design(NAMES, table, formula, contrast)


@pytest.mark.parametrize(
    "formula",
    [
        "age + {age.__init__.__globals__['__builtins__']['__import__']('os').system('id')}",
        "{age.to_csv('p')}",
        "age.to_csv(p)",
        "np.save(p, age)",
        "log(age.values)",
        "eval(age)",
        "I(age)",
        "C(age, Treatment(3))",
        "log(`age` + `')`)",
        "age\n;b",
        "age | b",
        "'age'",
    ],
)
def test_what_could_be_code_is_refused(table, formula):
    with pytest.raises(NotReadable):
        design(NAMES, table, formula, "1")


@pytest.mark.parametrize(
    ("formula", "columns"),
    [
        ("(age + iq)^2 - age:iq", 3),
        ("group * center(age) / site", 8),
        ("bs(age, df=4) + cr(log(age + 1), 3) + poly(iq, 2, raw=True)", 10),
        ("`Age (years)` + scale(`b.c`) + sqrt(age)", 4),
        ("0 + C(`test site`)", 3),
    ],
)
def test_columns_and_known_functions_are_written_as_in_r(rng, formula, columns):
    names = [f"p{k}" for k in range(30)]
    numbers = {name: rng.uniform(1, 9, 30) for name in ("age", "iq", "Age (years)", "b.c")}
    people = pd.DataFrame({**numbers, "group": [*"ab"] * 15, "site": [*"xyz"] * 10, "test site": [1, 2, 3] * 10}, names)
    assert design(names, people, formula, "1" if formula[0] != "0" else "C(`test site`)[1]").matrix.shape == (
        30,
        columns,
    )


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


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\t\n"),
        lambda text: text.replace("\n", "\t\n").replace("\t\n", "\n", 1),
        lambda text: text.replace("\t", " \t ").replace("\n", " \n"),
        lambda text: text.replace("n/a", ""),
    ],
)
def test_spaces_and_tabs_at_the_end_of_cells_and_lines_change_nothing(table, tmp_path, change):
    (tmp_path / "b.tsv").write_text(change(TABLE))
    pd.testing.assert_frame_equal(read_participants(tmp_path / "b.tsv"), table)


def test_a_line_of_too_many_cells_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("participant_id,age,sex\n01,20,5,M\n02,30,5,F\n")
    with pytest.raises(DamagedFile):
        read_participants(tmp_path / "a.csv")


def test_infinite_values_are_refused(table):
    with pytest.raises(NotFinite):
        design(NAMES, table.assign(age=[1.0, 2, 3, 4, 5, np.inf]), "age", "age")


@pytest.mark.parametrize(
    "contrast",
    [
        *("age = 3", "age + 1", "1 + 30 * age", "nan * age", "inf * age", "age / 0", "age * age", "age, sex"),
        *("age == 0", "age - age", "2", "(", "[age)", "`age` {1}", "log(age)"),
    ],
)
def test_a_contrast_is_a_sum_of_columns_against_zero(table, contrast):
    with pytest.raises(UnknownName):
        design(NAMES, table, "age + sex", contrast)


@pytest.mark.parametrize(("contrast", "weights"), [("age = 0", [0, 1]), ("Intercept + 30 * age", [1, 30])])
def test_weights_are_numbers(table, contrast, weights):
    np.testing.assert_array_equal(design(NAMES, table, "age", contrast).contrast, weights)


def test_the_name_of_a_variable_is_its_effect_and_no_interaction(table):
    np.testing.assert_array_equal(design(NAMES, table, "sex * age", "sex").contrast, [0, 1, 0, 0])
    with pytest.raises(UnknownName):
        design(NAMES, table, "age + sex:age", "sex")


def test_names_like_code_are_names(table, tmp_path, monkeypatch):
    """Of columns and of levels; nothing of them is run."""
    monkeypatch.chdir(tmp_path)
    code = "open('made', 'w').close()"
    like = table.rename(columns={"age": code, "sex": "open(made, w)"}).assign(group=[code, "A", code, "A", "A", code])
    assert design(NAMES, like, f"`{code}`", "1").columns == ("Intercept", code)
    found = design(NAMES, like, "`open(made, w)` + group", f"group[T.{code}]")
    assert found.columns == ("Intercept", "open(made, w)[T.M]", f"group[T.{code}]")
    np.testing.assert_array_equal(found.contrast, [0, 0, 1])
    with pytest.raises(UnknownName):
        design(NAMES, like, "group", code)
    assert not (tmp_path / "made").exists()


def test_a_column_may_have_the_name_of_a_function(table):
    np.testing.assert_array_equal(
        design(NAMES, table.assign(log=table.age), "log", "log").matrix[:, 1], [20, 30, 40, 50.5, 60]
    )
    with pytest.raises(UnknownName):
        design(NAMES, table.assign(log=table.age), "log + log(age)", "log")


# --- values that are wrong


def test_a_typo_does_not_make_a_factor_of_numbers(tmp_path):
    (tmp_path / "people.tsv").write_text(TABLE.replace("50.5", "5O.5"))
    table = read_participants(tmp_path / "people.tsv")
    with pytest.raises(DamagedFile, match=r"sub-04|04"):
        design(NAMES, table, "age", "age")
    with pytest.raises(DamagedFile):
        design(NAMES, table, "sex + log(age)", "sex")
    assert design(NAMES, table, "sex", "sex").left_out == ()  # of a column that the model does not need
    others = [name for name in NAMES if "4" not in name]
    np.testing.assert_array_equal(design(others, table, "age", "age").matrix[:, 1], [20, 30, 40, 60])
    assert len(design(NAMES, table, "C(age)", "1").columns) == 5  # names, if that is meant


AGES = [21, 25, 31, 38, 44, 52, 57, 63, 70, 78]


@pytest.mark.parametrize(
    ("ages", "remarks"),
    [
        (AGES, 0),
        ([*AGES, 99], 0),
        ([*AGES, -999], 1),
        ([*AGES, -9999, -9999], 1),
        ([*AGES, 9999], 1),
        ([*AGES, 999.0], 1),
        ([*AGES, -1], 1),
        ([age - 50 for age in AGES], 0),
        ([age / 10 - 2.5 for age in AGES], 0),
        ([0, 1] * 8, 0),
        ([-1, 1] * 8, 0),
        ([0] * 15 + [1], 0),
    ],
)
def test_codes_of_unknown_numbers_are_remarked(table, ages, remarks):
    names = [f"p{k}" for k in range(len(ages))]
    people = table.iloc[:0].reindex(names).assign(age=ages)
    assert len(design(names, people, "age", "age").remarks) == remarks


@pytest.mark.parametrize("encode", [gzip.compress, lambda text: text.decode().encode("utf-16")], ids=["gzip", "utf-16"])
def test_a_table_that_is_no_utf8_text_is_refused(tmp_path, encode):
    (tmp_path / "p.tsv.gz").write_bytes(encode(TABLE.encode()))
    with pytest.raises(DamagedFile):
        read_participants(tmp_path / "p.tsv.gz")


# --- sessions


def sessions(table, **columns):
    """Four people, twice each."""
    names = [f"sub-{k}_ses-{s}" for k in range(4) for s in (1, 2)]
    return names, table.iloc[:0].reindex([name[4:] for name in names]).assign(**columns)


def test_sessions_of_a_person_are_a_block(table):
    names, people = sessions(table, age=[20.5, 20.5, 31, 31, 47, 47, 60, 60], site=[1, 2] * 4)
    between, within = design(names, people, "age", "age"), design(names, people, "site + age", "site")
    for found in (between, within):
        np.testing.assert_array_equal(found.blocks, [0, 0, 1, 1, 2, 2, 3, 3])
        assert len(found.remarks) == 1
    assert between.whole
    assert not within.whole
    own = design(names, people, "age", "age", blocks="site")
    np.testing.assert_array_equal(own.blocks, [0, 1] * 4)
    assert own.remarks == ()


def test_a_session_without_a_row_has_that_of_its_person(table):
    found = design(["sub-01_ses-1", "sub-01_ses-2", "02", "03"], table, "age", "age")
    np.testing.assert_array_equal(found.matrix[:, 1], [20, 20, 30, 40])
    np.testing.assert_array_equal(found.blocks, [0, 0, 1, 2])
