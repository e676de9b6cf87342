"""Designs of linear models from a table of participants and a formula."""

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
AGES = [21, 25, 31, 38, 44, 52, 57, 63, 70, 78]


def read(folder, text, name="participants.tsv"):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_participants(folder / name)


@pytest.fixture
def table(tmp_path):
    return read(tmp_path, TABLE)


# tables ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "name", "text"),
    [
        (NamedTwice, "people.tsv", TABLE + "sub-1\t1\tF\ta\t1\nsub-02\t1\tF\ta\t1\n"),
        (NamedTwice, "people.tsv", "participant_id\tage\tage\na\t1\t2\n"),
        (WrongFile, "people.tsv", TABLE.replace("\t", ",")),
        (DamagedFile, "people.tsv", ""),
        (DamagedFile, "people.tsv", TABLE + "sub-07\t1\tF\ta\t1\t1\t1\n"),
        (DamagedFile, "people.tsv", "participant_id\tage\na\t1\n\t2\n"),
        (DamagedFile, "people.tsv", TABLE.encode("utf-16")),
        (DamagedFile, "people.csv", "participant_id,age,sex\n01,20,5,M\n02,30,5,F\n"),
    ],
)
def test_damaged_tables_are_refused(tmp_path, error, name, text):
    with pytest.raises(error):
        read(tmp_path, text, name)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("b.tsv", "\n", "\t\n"), ("b.tsv", "\t", " \t "), ("b.tsv", "n/a", ""), ("b.csv", "\t", ",")],
)
def test_spaces_tabs_at_the_end_of_lines_and_commas_of_a_csv_change_nothing(table, tmp_path, name, old, new):
    pd.testing.assert_frame_equal(read(tmp_path, TABLE.replace(old, new), name), table)


# models ------------------------------------------------------------------------------------------------------


def test_rows_follow_the_subjects_with_and_without_their_prefix(table):
    model = design(NAMES, table, "age", "age")
    assert model.subjects == ("sub-01", "02", "sub-03", "sub-04", "sub-06")
    assert model.left_out == ("sub-05",)
    assert model.columns == ("Intercept", "age")
    np.testing.assert_array_equal(model.matrix[:, 1], [20, 30, 40, 50.5, 60])
    np.testing.assert_array_equal(model.contrast, [0, 1])
    np.testing.assert_array_equal(design(["06", "01"], table, "age", "age").matrix[:, 1], [60, 20])
    np.testing.assert_array_equal(design(NAMES, table, "1", "1").matrix, np.ones((6, 1)))
    with pytest.raises(MissingPart, match="07"):
        design([*NAMES, "sub-07"], table, "age", "age")


@pytest.mark.parametrize(
    ("formula", "contrast", "columns", "weights"),
    [
        ("sex", "sex", ("Intercept", "sex[T.M]"), [0, 1]),
        ("group", "group[T.b] - group[T.c]", ("Intercept", "group[T.b]", "group[T.c]"), [0, 1, -1]),
        ("C(sex)", "sex", ("Intercept", "C(sex)[T.M]"), [0, 1]),
        ("sex + group", "1", ("Intercept", "sex[T.M]", "group[T.b]", "group[T.c]"), [1, 0, 0, 0]),
        ("0 + sex", "sex[M] - sex[F]", ("sex[F]", "sex[M]"), [-1, 1]),
        ("site", "site = 0", ("Intercept", "site"), [0, 1]),
        ("site", "Intercept + 30 * site", ("Intercept", "site"), [1, 30]),
        ("sex * site", "sex", ("Intercept", "sex[T.M]", "site", "sex[T.M]:site"), [0, 1, 0, 0]),
    ],
)
def test_contrasts_are_columns_variables_or_weights(table, formula, contrast, columns, weights):
    model = design(NAMES, table, formula, contrast)
    assert model.columns == columns
    np.testing.assert_array_equal(model.contrast, weights)
    assert model.left_out == ()


def test_interactions_are_products(table):
    model = design(["01", "02", "03", "04", "06"], table, "age * sex", "age:sex[T.M]")
    columns = dict(zip(model.columns, model.matrix.T))
    np.testing.assert_array_equal(columns["age:sex[T.M]"], columns["age"] * columns["sex[T.M]"])
    with pytest.raises(UnknownName):
        design(NAMES, table, "age + sex:age", "sex")  # a variable is not its interaction


@pytest.mark.parametrize(
    ("error", "formula", "contrast"),
    [
        (NotReadable, "age +* (", "age"),
        (UnknownName, "log(sex)", "1"),
        (UnknownName, "bs(age, df=2)", "1"),
        (NotFinite, "log(age - 50)", "1"),
        (NotReadable, "age ~ sex", "sex"),
    ],
)
def test_impossible_models_are_refused(table, error, formula, contrast):
    with pytest.raises(error):
        design(NAMES, table, formula, contrast)


@pytest.mark.parametrize(
    "formula",
    [
        *("{age.to_csv('p')}", "age.to_csv(p)", "np.save(p, age)", "log(age.values)", "eval(age)", "I(age)"),
        *("__import__('os').getcwd()", "C(age, Treatment(3))", "log(`age` + `')`)", "age\n;b", "age | b", "'age'"),
    ],
)
def test_formulas_that_could_be_code_are_refused(table, formula):
    with pytest.raises(NotReadable):
        design(NAMES, table, formula, "1")


@pytest.mark.parametrize(
    "contrast",
    [
        *("age = 3", "age + 1", "1 + 30 * age", "nan * age", "inf * age", "age / 0", "age * age", "age, sex"),
        *("age == 0", "age - age", "2", "(", "[age)", "`age` {1}", "log(age)", "", "group"),
    ],
)
def test_a_contrast_is_a_sum_of_columns_against_zero(table, contrast):
    with pytest.raises(UnknownName):
        design(NAMES, table, "age + sex", contrast)


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
    contrast = "1" if formula[0] != "0" else "C(`test site`)[1]"
    assert design(names, people, formula, contrast).matrix.shape == (30, columns)


def test_names_like_code_or_functions_are_names(table, cwd):
    """Of columns and of levels; nothing of them is run."""
    code = "open('made', 'w').close()"
    people = table.rename(columns={"age": code}).assign(group=[code, "A", code, "A", "A", code])
    model = design(NAMES, people, f"`{code}` + group", f"group[T.{code}]")
    assert model.columns == ("Intercept", code, f"group[T.{code}]")
    np.testing.assert_array_equal(model.contrast, [0, 0, 1])
    with pytest.raises(UnknownName):
        design(NAMES, people, "group", code)
    assert not (cwd / "made").exists()
    logs = table.assign(log=table.age)
    np.testing.assert_array_equal(design(NAMES, logs, "log", "log").matrix[:, 1], [20, 30, 40, 50.5, 60])


# values that are wrong ---------------------------------------------------------------------------------------


def test_typos_among_numbers_and_infinite_values_are_refused(tmp_path):
    table = read(tmp_path, TABLE.replace("50.5", "5O.5"))
    with pytest.raises(DamagedFile, match=r"sub-04|04"):
        design(NAMES, table, "age", "age")
    assert design(NAMES, table, "sex", "sex").left_out == ()  # of a column that the model does not need
    others = [name for name in NAMES if "4" not in name]
    np.testing.assert_array_equal(design(others, table, "age", "age").matrix[:, 1], [20, 30, 40, 60])
    assert len(design(NAMES, table, "C(age)", "1").columns) == 5  # as names of groups
    with pytest.raises(NotFinite):
        design(NAMES, table.assign(age=[1.0, 2, 3, 4, 5, np.inf]), "age", "age")


@pytest.mark.parametrize(
    ("remarks", "series"),
    [
        (1, ([*AGES, -999], [*AGES, -9999, -9999], [*AGES, 9999], [*AGES, -1])),
        (0, (AGES, [*AGES, 99], [age - 50 for age in AGES], [age / 10 - 2.5 for age in AGES], [-1, 1] * 8)),
        (0, ([0] * 15 + [1],)),
    ],
)
def test_codes_of_unknown_numbers_are_remarked(table, remarks, series):
    for ages in series:
        names = [f"p{k}" for k in range(len(ages))]
        people = table.iloc[:0].reindex(names).assign(age=ages)
        assert len(design(names, people, "age", "age").remarks) == remarks, ages


# blocks ------------------------------------------------------------------------------------------------------


def test_blocks_are_the_values_of_a_column_or_persons_with_sessions(table):
    np.testing.assert_array_equal(design(NAMES, table, "sex", "sex", blocks="group").blocks, [0, 1, 2, 0, 1, 2])
    with pytest.raises(UnknownName):
        design(NAMES, table, "sex", "sex", blocks="family")
    names = [f"sub-{k}_ses-{s}" for k in range(4) for s in (1, 2)]
    people = table.iloc[:0].reindex([name[4:] for name in names])
    people = people.assign(age=[20.5, 20.5, 31, 31, 47, 47, 60, 60], site=[1, 2] * 4)
    for formula, contrast, whole in (("age", "age", True), ("site + age", "site", False)):
        model = design(names, people, formula, contrast)
        np.testing.assert_array_equal(model.blocks, [0, 0, 1, 1, 2, 2, 3, 3])
        assert (len(model.remarks), model.whole) == (1, whole)
    own = design(names, people, "age", "age", blocks="site")
    np.testing.assert_array_equal(own.blocks, [0, 1] * 4)


def test_a_session_without_a_row_has_that_of_its_person(table):
    model = design(["sub-01_ses-1", "sub-01_ses-2", "02", "03"], table, "age", "age")
    np.testing.assert_array_equal(model.matrix[:, 1], [20, 20, 30, 40])
    np.testing.assert_array_equal(model.blocks, [0, 0, 1, 2])
