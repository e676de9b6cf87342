"""Designs of linear models: subjects and their values from participants.tsv, and a formula such as ``age + sex``."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import formulaic
import numpy as np
import pandas as pd

from morphofold import errors
from morphofold.frozen_arrays import Array, Ints
from morphofold.io.files import StrPath
from morphofold.number_texts import in_one_line

LONG = ".long."  # in the name of a longitudinal run of recon-all, TIMEPOINT.long.BASE
#: PERSON_SESSION, as sub-01_ses-2, anna_tp2 and anna_v2; but HC_v02 is volunteer 2, and study_v2_007 a person
SESSION = re.compile(
    r"((?:sub-)?+.+?)[_.-]+(ses-[A-Za-z0-9]+.*|(?:session|ses|timepoint|time|tp|visit|wave)[_-]?\d+[A-Za-z]?|v[1-9])",
    re.IGNORECASE,
)
PERSON = "person"  # a column that names the person of each session
IDENTIFIER = "participant_id"  # the first column, as BIDS has it
MISSING = ("n/a", "NA", "NaN", "nan", "")
INTERCEPTS = ("1", "Intercept", "intercept")
#: that formulaic raises for formulas and contrasts without a meaning
NO_MEANING = (SyntaxError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RuntimeError)
CALLS = ("C", "log", "sqrt", "exp", "center", "scale", "poly", "bs", "cr")
#: calls that formulaic may evaluate as Python: nothing in them can run code
CALL = re.compile(rf"(?:{'|'.join(CALLS)})\((?:[\w\s,+\-*/()=]|\.\d)*\)")
CALLED, COLUMN = re.compile(r"(\w+)\s*\("), re.compile(r"\b([^\W\d]\w*)\b(?!\s*[(=])")
QUOTED = re.compile(r"`([^`'\"\\]+)`")
FAR_OUT, MOST_CODES = 30, 0.2  # median absolute deviations from the median; share of the values


@dataclass(frozen=True, eq=False)
class Design:
    """The design of a model for some subjects.

    Attributes
    ----------
    subjects : tuple of str
        Subjects with all values that the model needs, in the order of the rows.
    left_out : tuple of str
        Subjects that miss a value.
    columns : tuple of str
    matrix : (S, K) float64
    contrast : (K,) float64
    blocks : (S,) int64 or None
        Number of the block within which each subject may be exchanged; None: all with all.
    whole : bool
        Whether blocks are exchanged as wholes: persons, by the sessions in their names, if what is tested is the same
        in all of a person's.
    variance_groups : (S,) int64 or None
        Number of the group whose residual variance each subject has; None: all have the same.
    remarks : tuple of str
        Sentences about values that look wrong.
    """

    subjects: tuple[str, ...]
    left_out: tuple[str, ...]
    columns: tuple[str, ...]
    matrix: Array
    contrast: Array
    blocks: Ints | None = None
    whole: bool = False
    variance_groups: Ints | None = None
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        columns = ", ".join(self.columns)
        return f"Design({len(self.subjects)} subjects, {len(self.left_out)} left out; columns {columns})"


def read_participants(path: StrPath) -> pd.DataFrame:
    """Read participants.tsv (BIDS) or a .csv file: a row for each subject, found by ``participant_id``.

    ``n/a``, ``NA`` and empty cells are missing values; ``sub-`` in front of a subject may be left out.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a table with that column, or names a subject twice.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Give a table of the subjects, such as participants.tsv.")
    separator = "," if path.suffix.lower() == ".csv" else "\t"
    try:
        text = re.sub(r" *([\t\n]) *", r"\1", path.read_text(encoding="utf-8-sig"))
        text = re.sub(f"{separator}+$", "", text, flags=re.MULTILINE)
        with warnings.catch_warnings(action="error", category=pd.errors.ParserWarning):  # a line longer than the first
            table = pd.read_csv(
                io.StringIO(text),
                sep=separator,
                index_col=False,
                dtype={IDENTIFIER: str},
                na_values=list(MISSING),
                keep_default_na=False,
            )
    except (ValueError, pd.errors.ParserWarning) as error:  # ValueError: not UTF-8, no table
        text = f"{path}: is no table of tab-separated UTF-8 text, or compressed: {in_one_line(error)}."
        raise errors.DamagedFile(text) from None
    if IDENTIFIER not in table:
        raise errors.WrongFile(
            f"{path}: has no column {IDENTIFIER}; its columns are {', '.join(table)}. Is it separated by tabs, as "
            "BIDS asks?"
        )
    if table[IDENTIFIER].isna().any():
        raise errors.DamagedFile(f"{path}: a line has no {IDENTIFIER}. Fill it in, or remove the line.")
    table[IDENTIFIER] = table[IDENTIFIER].map(plain_name)
    for kind, names in ("columns", text.partition("\n")[0].split(separator)), ("rows of", table[IDENTIFIER]):
        repeated_names = pd.Series(names)[pd.Series(names).duplicated()].unique()
        if len(repeated_names):
            raise errors.NamedTwice(f"{path}: has two {kind} {_some(repeated_names)}. Leave one of them.")
    return table.set_index(IDENTIFIER)


def person_and_session(subject: str) -> tuple[str, str]:
    """The person that a subject is a scan of, by its name, and the session; the subject itself and "" without sessions.

    ``sub-01_ses-2`` is sub-01, ses-2. A longitudinal run of FreeSurfer is of the person of its time point if the base
    bears that name, else of its base: ``anna_ses1.long.anna_base`` is anna, ses1; ``x.long.ben`` is ben, x.
    """
    time_point, long_mark, base = subject.partition(LONG)
    match = SESSION.fullmatch(time_point)
    if long_mark and base and not (match and match[1] in base):
        return person_and_session(base)[0], time_point.removeprefix(base).lstrip("_.-") or time_point
    return (match[1], match[2]) if match else (subject, "")


def plain_name(subject: str) -> str:
    """A subject's name without ``sub-``."""
    return str(subject).removeprefix("sub-")


def person_of(subject: str) -> str:
    """The plain name of the person that a subject is a scan of, by its name: 01 of ``sub-01_ses-2``."""
    return plain_name(person_and_session(str(subject))[0])


def names_of_row(subject: str) -> list[str]:
    """Plain names of the rows that hold for a subject, the first first: its own, its time point's, its person's."""
    return [plain_name(subject), plain_name(subject.partition(LONG)[0]), person_of(subject)]


def design(
    subjects: Sequence[str],
    participants: pd.DataFrame,
    formula: str,
    contrast: str,
    blocks: str | None = None,
    variance_groups: str | None = None,
) -> Design:
    """The design of a formula for some subjects.

    Parameters
    ----------
    subjects : sequence of str
        A session without a row has that of its person.
    participants : DataFrame
        Of :func:`read_participants`.
    formula : str
        Columns of ``participants``, as in R: ``"age + sex"``, ``"group * age"``, ``"1"`` for the mean alone. What is
        not a number is a factor, whose levels are compared with the first in alphabetical order.
    contrast : str
        A column of the design (``"age"``, ``"sex[T.M]"``), a variable with one column (``"sex"``), ``"1"`` for the
        intercept, or weights of columns (``"group[T.b] - group[T.c]"``). It is tested against 0.
    blocks : str, optional
        Column whose values mark blocks; without it, sessions of one person are a block.
    variance_groups : str, optional
        Column whose values mark groups that may differ in residual variance.

    Raises
    ------
    ValueError
        If a subject has no row, the formula or the contrast cannot be read or names a column that does not exist, a
        few values of a column of numbers are not numbers, a regressor is constant or infinite, or all subjects miss a
        value.
    """
    names_of_rows = map(names_of_row, subjects)
    row_names = [next((name for name in each if name in participants.index), each[0]) for each in names_of_rows]
    if names_without_row := sorted({*row_names} - {*participants.index}):
        raise errors.MissingPart(
            f"the table of participants has no row of {_some(names_without_row)}. Add what is missing, or leave "
            "these subjects out."
        )
    table = participants.loc[row_names].reset_index(drop=True)
    parsed_formula, regressors, factors = _parsed(formula)
    needed_columns = sorted({*regressors, *filter(None, (blocks, variance_groups))})
    if unknown := [name for name in needed_columns if name not in table]:
        raise errors.UnknownName(f"{_some(unknown)}: no such column of participants; they are {', '.join(table)}.")
    rows = _with_numbers(table[needed_columns], sorted(regressors - factors), row_names)
    is_complete = rows.notna().all(axis=1).to_numpy()
    if not is_complete.any():
        raise errors.DoesNotApply(f"no subject has all values of {_some(needed_columns)}.")
    rows, table = rows[is_complete], table[is_complete]
    included, left_out = (tuple(np.array(subjects)[which].tolist()) for which in (is_complete, ~is_complete))
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused below
            model_matrix = parsed_formula.get_model_matrix(rows, context={"sqrt": np.sqrt}, na_action="ignore")
    except (formulaic.errors.FormulaicError, *NO_MEANING) as error:
        raise errors.UnknownName(f"{formula!r}: can't be read as a model: {str(error).splitlines()[0]}") from None
    columns, matrix = tuple(map(str, model_matrix)), np.asarray(model_matrix, dtype=np.float64)
    if infinite := [name for name, column in zip(columns, matrix.T) if not np.isfinite(column).all()]:
        raise errors.NotFinite(f"{_some(infinite)}: is not finite for all subjects. Put n/a where a value is unknown.")
    weights = _weights(contrast, columns, model_matrix.model_spec, formula)
    remarks = [text for name in sorted(regressors) for text in _codes(name, rows[name], included)]
    if blocks is None:
        numbers, whole, remark = _blocks_of_persons(included, table, matrix @ weights)
        remarks += [remark] * bool(remark)
    else:
        numbers, whole = _numbered(rows[blocks]), False
    groups = None if variance_groups is None else _numbered(rows[variance_groups])
    return Design(included, left_out, columns, matrix, weights, numbers, whole, groups, tuple(remarks))


def _parsed(formula: str) -> tuple[formulaic.Formula, set[str], set[str]]:
    """A formula, the columns of participants in it, and those of them in calls of ``C``."""
    columns, factors = set[str](), set[str]()
    try:
        model = formulaic.Formula(formula)
        for factor in [factor for term in model for factor in term.factors]:
            if factor.eval_method.value == "lookup":
                columns.add(factor.expr)
            elif factor.eval_method.value == "python":
                unquoted = QUOTED.sub("quoted", factor.expr)
                if not CALL.fullmatch(unquoted) or not {*CALLED.findall(unquoted)} <= {*CALLS}:
                    raise SyntaxError
                used = {*QUOTED.findall(factor.expr), *COLUMN.findall(QUOTED.sub("", factor.expr))} - {"True", "False"}
                columns |= used
                factors |= used if unquoted.startswith("C(") else set()
        return model, columns, factors
    except (formulaic.errors.FormulaicError, *NO_MEANING):
        raise errors.NotReadable(
            f"{formula!r}: can't be read as a model. Write columns (in backquotes, if a name has more than letters, "
            f"digits and _), numbers, + - : * / ^ ( ), and calls of {', '.join(CALLS)}, such as 'age + sex'."
        ) from None


def _blocks_of_persons(subjects: Sequence[str], rows: pd.DataFrame, tested: Array) -> tuple[Ints | None, bool, str]:
    """The person of each subject (S,) as blocks, if persons have several sessions; whether they are exchanged as
    wholes, as what is tested (S,) is the same in all of a person's; and a remark. A person is that of the column
    ``person``, else of the name."""
    person_column = rows.get(PERSON, [None] * len(subjects))
    persons = _numbered(person_of(s) if p is None or p != p else p for s, p in zip(subjects, person_column))
    firsts = np.unique(persons, return_index=True)[1]
    if len(firsts) == len(persons):
        return None, False, ""
    is_same_within = bool(np.allclose(tested, tested[firsts[persons]], atol=0))
    how = "persons are exchanged as wholes" if is_same_within else "sessions are exchanged within persons"
    remark = f"names show {len(subjects)} sessions of {len(firsts)} persons, so {how}. --blocks COLUMN changes this."
    return persons, is_same_within, remark


def _numbered(names: Iterable[object]) -> Ints:
    """The number (S,) of each name in the order of the names."""
    return np.unique([str(name) for name in names], return_inverse=True)[1]


def _with_numbers(rows: pd.DataFrame, names: Sequence[str], subjects: Sequence[str]) -> pd.DataFrame:
    """Rows whose columns ``names`` are numbers if all their values are; raises if only a few are not."""
    for name in names:
        numbers = pd.to_numeric(rows[name], errors="coerce")
        wrong_rows = np.flatnonzero(rows[name].notna() & numbers.isna())
        if not len(wrong_rows):
            rows = rows.assign(**{name: numbers})
        elif 2 * len(wrong_rows) < rows[name].notna().sum():
            raise errors.DamagedFile(
                f"{name}: {rows[name][wrong_rows[0]]!r} of {subjects[wrong_rows[0]]} is not a number, as most values "
                f"are. Correct it, put n/a if it is unknown, or write C({name}) if the values are names."
            )
    return rows


def _codes(name: str, values: pd.Series[Any], subjects: Sequence[str]) -> Iterator[str]:
    """A sentence if numbers look like codes of unknown ones: -999 of an age, say.

    They are far out, by the median absolute deviation, or a few whole negative ones among others.
    """
    if values.dtype.kind in "fiu":
        numbers = values.to_numpy(dtype=np.float64)
        off = np.abs(numbers - np.median(numbers))
        few = np.mean(numbers < 0) < MOST_CODES
        is_odd = (off > FAR_OUT * np.median(off)) & (np.median(off) > 0) | (numbers < 0) & (numbers % 1 == 0) & few
        if is_odd.any():
            codes = [f"{value:g} of {subject}" for value, subject in zip(numbers[is_odd], np.array(subjects)[is_odd])]
            yield f"{name}: {_some(codes)}. Put n/a, if this is a code of an unknown value."


def _weights(contrast: str, columns: tuple[str, ...], model_spec: Any, formula: str) -> Array:
    """Weights (K,) of a contrast."""
    name = contrast.strip()
    levels = [c for c in columns if c.startswith((f"{name}[", f"C({name})[")) and c.count(":") == name.count(":")]
    matching_columns = [c for c in columns if c == name or {c, name} <= {*INTERCEPTS}] or levels
    if len(matching_columns) == 1:
        return np.isin(columns, matching_columns).astype(np.float64)
    try:
        parsed = model_spec.get_linear_constraints(contrast)
        weights = np.asarray(parsed.constraint_matrix, dtype=np.float64)
        if len(weights) == 1 and np.isfinite(weights).all() and weights.any() and not parsed.constraint_values.any():
            return weights[0]
    except (formulaic.errors.FormulaicError, *NO_MEANING):
        pass
    raise errors.UnknownName(
        f"contrast {contrast!r}: must be a column of the model {formula!r} or a sum of columns times numbers, and is "
        f"tested against 0. The columns are {', '.join(columns)}."
    )


def _some(names: Sequence[str]) -> str:
    return f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}"
