"""Formulas of models: what is evaluated, and what is refused before it could be."""

import pytest

from morphofold.errors import NotReadable
from morphofold.group.formula import columns_of


@pytest.mark.parametrize(
    ("formula", "columns", "factors"),
    [
        ("1", "", ""),
        ("0 + sex", "sex", ""),
        ("age + C(site)", "age site", "site"),
        ("(age + sex)^2 - age:sex", "age sex", ""),
        ("group * center(age) / site", "group age site", ""),
        ("bs(age, df=4) + cr(log(age + 1), 3) + poly(iq, 2, raw=True)", "age iq", ""),
        ("`Age (years)` + scale(`b.c`) + sqrt(age)", "Age (years)|b.c|age", ""),
        ("C(`test site`)", "test site|", "test site|"),
    ],
)
def test_columns_are_named_as_in_r(formula, columns, factors):
    names = lambda text: {*text.strip("|").split("|" if "|" in text else None)} - {""}
    assert columns_of(formula) == (names(columns), names(factors))


@pytest.mark.parametrize(
    "formula",
    [
        "age + {age.__init__.__globals__['__builtins__']['__import__']('os').system('id')}",
        "{age.to_csv('p')}",
        "age.to_csv(p)",
        "np.save(p, age)",
        "log(age.values)",
        "log(x for x in age)",
        "log(age if age else sex)",
        "log(age)(age)",
        "eval(age)",
        "Q(age)",
        "I(age)",
        "C(age, Treatment(3))",
        "C(age, levels=sex)",
        "C(age, levels=2)",
        "log(age, where=0)",
        "exp(age, 10)",
        "scale(age, ddof=50)",
        "log(`a` + `')`)",
        "`a\\` + {b}`",
        "age # {b}",
        "age\n;b",
        "[age]",
        "age | b",
        "age %in% b",
        "age ~ b",
        "lambda: age",
        "(a := age)",
        "age == 3",
        "'age'",
        "",
        "age +* (",
        "quoted_",
    ],
)
def test_what_could_be_code_is_refused(formula):
    with pytest.raises(NotReadable):
        columns_of(formula)


@pytest.mark.parametrize(
    "formula",
    [
        "(a + b + c)^40",
        "((a + b + c)^9)^9",
        "*".join("abcdefghijklmnopqrstuvwxyz"),
        "poly(age, 100000)",
        "bs(age, df=1e9)",
        "bs(age, df=9*9*9)",
        "log(9**9**9)",
        "age^" + "9" * 900,
        "log(age * 1e400)",
        "(" * 150 + "age" + ")" * 150 + "+" + "(" * 250 + "age",
        "(" * 450 + "age" + ")" * 450,
        "-" * 5000 + "age",
        "+".join(["age"] * 5000),
    ],
)
def test_what_would_take_all_time_or_memory_is_refused(formula):
    with pytest.raises(NotReadable):
        columns_of(formula)


def test_a_model_of_too_many_levels_is_refused():
    for formula in ("C(a)*C(b)*C(c)", "bs(a, 50)*bs(b, df=50)*bs(c, 50)"):
        with pytest.raises(NotReadable):
            columns_of(formula, dict.fromkeys("abc", 50))
    columns_of("(age + sex + site)^2", {"sex": 2, "site": 100})
