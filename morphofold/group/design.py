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

LONG_MARK = ".long."  # in the name of a longitudinal run of recon-all, TIMEPOINT.long.BASE
#: PERSON_SESSION, as sub-01_ses-2, anna_tp2 and anna_v2; but HC_v02 is volunteer 2, and study_v2_007 a person
SESSION_RE = re.compile(
    r"((?:sub-)?+.+?)[_.-]+(ses-[A-Za-z0-9]+.*|(?:session|ses|timepoint|time|tp|visit|wave)[_-]?\d+[A-Za-z]?|v[1-9])",
    re.IGNORECASE,
)
PERSON_COLUMN = "person"  # a column that names the person of each session
ID_COLUMN = "participant_id"  # the first column, as BIDS has it
MISSING_TEXTS = ("n/a", "NA", "NaN", "nan", "")
INTERCEPT_NAMES = ("1", "Intercept", "intercept")
#: that formulaic raises for formulas and contrasts without a meaning
FORMULA_ERRORS = (SyntaxError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RuntimeError)
ALLOWED_CALLS = ("C", "log", "sqrt", "exp", "center", "scale", "poly", "bs", "cr")
#: calls that formulaic may evaluate as Python: nothing in them can run code
SAFE_CALL_RE = re.compile(rf"(?:{'|'.join(ALLOWED_CALLS)})\((?:[\w\s,+\-*/()=]|\.\d)*\)")
CALLED_RE, COL_RE = re.compile(r"(\w+)\s*\("), re.compile(r"\b([^\W\d]\w*)\b(?!\s*[(=])")
QUOTED = re.compile(r"`([^`'\"\\]+)`")
FAR_OUT, MOST_CODES_SHARE = 30, 0.2  # median absolute deviations from the median; share of the values


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
    blocks: Ints | None
    whole: bool
    variance_groups: Ints | None
    remarks: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"Design({len(self.subjects)} subjects, {len(self.left_out)} left out; columns {', '.join(self.columns)})"
        )


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
        table_text = re.sub(r" *([\t\n]) *", r"\1", path.read_text(encoding="utf-8-sig"))
        table_text = re.sub(f"{separator}+$", "", table_text, flags=re.MULTILINE)
        with warnings.catch_warnings(action="error", category=pd.errors.ParserWarning):  # a line longer than the first
            table = pd.read_csv(
                io.StringIO(table_text),
                sep=separator,
                index_col=False,
                dtype={ID_COLUMN: str},
                na_values=MISSING_TEXTS,
                keep_default_na=False,
            )
    except (ValueError, pd.errors.ParserWarning) as error:  # ValueError: not UTF-8, no table
        raise errors.DamagedFile(
            f"{path}: is no table of tab-separated UTF-8 text, or compressed: {in_one_line(error)}."
        ) from None
    if ID_COLUMN not in table:
        raise errors.WrongFile(
            f"{path}: has no column {ID_COLUMN}; its columns are {', '.join(table)}. Is it separated by tabs, as "
            "BIDS asks?"
        )
    if table[ID_COLUMN].isna().any():
        raise errors.DamagedFile(f"{path}: a line has no {ID_COLUMN}. Fill it in, or remove the line.")
    table[ID_COLUMN] = table[ID_COLUMN].map(plain_name)
    for noun, names in ("columns", table_text.partition("\n")[0].split(separator)), ("rows of", table[ID_COLUMN]):
        repeated_names = pd.Series(names)[pd.Series(names).duplicated()].unique()
        if len(repeated_names):
            raise errors.NamedTwice(
                f"{path}: has two {noun} {_some(repeated_names)}. Remove one, or name sessions: 01_ses-1."
            )
    return table.set_index(ID_COLUMN)


def person_and_session(subject: str) -> tuple[str, str]:
    """The person that a subject is a scan of, by its name, and the session; the subject itself and "" without sessions.

    ``sub-01_ses-2`` is sub-01, ses-2. A longitudinal run of FreeSurfer is of the person of its time point if the base
    bears that name, else of its base: ``anna_ses1.long.anna_base`` is anna, ses1; ``x.long.ben`` is ben, x.
    """
    time_point, mark, base_name = subject.partition(LONG_MARK)
    session_match = SESSION_RE.fullmatch(time_point)
    if mark and base_name and not (session_match and session_match[1] in base_name):
        return person_and_session(base_name)[0], time_point.removeprefix(base_name).lstrip("_.-") or time_point
    return (session_match[1], session_match[2]) if session_match else (subject, "")


def plain_name(subject: str) -> str:
    """A subject's name without ``sub-``."""
    return str(subject).removeprefix("sub-")


def person_of(subject: str) -> str:
    """The plain name of the person that a subject is a scan of, by its name: 01 of ``sub-01_ses-2``."""
    return plain_name(person_and_session(str(subject))[0])


def names_of_row(subject: str) -> list[str]:
    """Plain names of the rows that hold for a subject, the first first: its own, its time point's, its person's."""
    return [plain_name(subject), plain_name(subject.partition(LONG_MARK)[0]), person_of(subject)]


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
    candidates = map(names_of_row, subjects)
    row_names = [next((name for name in names if name in participants.index), names[0]) for names in candidates]
    if names_without_row := sorted({*row_names} - {*participants.index}):
        raise errors.MissingPart(
            f"the table of participants has no row of {_some(names_without_row)}. Add what is missing, or leave "
            "these subjects out."
        )
    table = participants.loc[row_names].reset_index(drop=True)
    parsed_formula, regressors, factor_columns = _parsed(formula)
    needed_columns = sorted({*regressors, *filter(None, (blocks, variance_groups))})
    if bad_columns := [name for name in needed_columns if name not in table]:
        raise errors.UnknownName(f"{_some(bad_columns)}: no such column of participants; they are {', '.join(table)}.")
    needed_rows = _with_numbers(table[needed_columns], sorted(regressors - factor_columns), row_names)
    is_complete = needed_rows.notna().all(axis=1).to_numpy()
    if not is_complete.any():
        raise errors.DoesNotApply(f"no subject has all values of {_some(needed_columns)}.")
    needed_rows, table = needed_rows[is_complete], table[is_complete]
    included, left_out = (tuple(np.array(subjects)[is_chosen].tolist()) for is_chosen in (is_complete, ~is_complete))
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused below
            model_matrix = parsed_formula.get_model_matrix(needed_rows, context={"sqrt": np.sqrt}, na_action="ignore")
    except (formulaic.errors.FormulaicError, *FORMULA_ERRORS) as error:
        raise errors.UnknownName(f"{formula!r}: can't be read as a model: {str(error).splitlines()[0]}") from None
    column_names, matrix = tuple(map(str, model_matrix)), np.asarray(model_matrix, dtype=np.float64)
    if bad_names := [name for name, column in zip(column_names, matrix.T) if not np.isfinite(column).all()]:
        raise errors.NotFinite(f"{_some(bad_names)}: is not finite for all subjects. Put n/a where a value is unknown.")
    weights = _weights(contrast, column_names, model_matrix.model_spec, formula)
    remarks = [sentence for name in sorted(regressors) for sentence in _codes(name, needed_rows[name], included)]
    if blocks is None:
        block_ids, whole_blocks, remark = _blocks_of_persons(included, table, matrix @ weights)
        remarks += [remark] * bool(remark)
    else:
        block_ids, whole_blocks = _numbered(needed_rows[blocks]), False
    group_ids = None if variance_groups is None else _numbered(needed_rows[variance_groups])
    return Design(included, left_out, column_names, matrix, weights, block_ids, whole_blocks, group_ids, tuple(remarks))


def _parsed(formula: str) -> tuple[formulaic.Formula, set[str], set[str]]:
    """A formula, the columns of participants in it, and those of them in calls of ``C``."""
    columns, factors = set[str](), set[str]()
    try:
        parsed_formula = formulaic.Formula(formula)
        for factor in [factor for term in parsed_formula for factor in term.factors]:
            if factor.eval_method.value == "lookup":
                columns.add(factor.expr)
            elif factor.eval_method.value == "python":
                unquoted = QUOTED.sub("quoted", factor.expr)
                if not SAFE_CALL_RE.fullmatch(unquoted) or not {*CALLED_RE.findall(unquoted)} <= {*ALLOWED_CALLS}:
                    raise SyntaxError
                names = {*QUOTED.findall(factor.expr), *COL_RE.findall(QUOTED.sub("", factor.expr))} - {"True", "False"}
                columns |= names
                factors |= names if unquoted.startswith("C(") else set()
        return parsed_formula, columns, factors
    except (formulaic.errors.FormulaicError, *FORMULA_ERRORS):
        raise errors.NotReadable(
            f"{formula!r}: can't be read as a model. Write columns (in backquotes, if a name has more than letters, "
            f"digits and _), numbers, + - : * / ^ ( ), and calls of {', '.join(ALLOWED_CALLS)}, such as 'age + sex'."
        ) from None


def _blocks_of_persons(subjects: Sequence[str], rows: pd.DataFrame, regressor: Array) -> tuple[Ints | None, bool, str]:
    """The person of each subject (S,) as blocks, if persons have several sessions; whether they are exchanged as
    wholes, as what is tested (S,) is the same in all of a person's; and a remark. A person is that of the column
    ``person``, else of the name."""
    person_column = rows.get(PERSON_COLUMN, [None] * len(subjects))
    person_ids = _numbered(
        person_of(subject) if person is None or person != person else person
        for subject, person in zip(subjects, person_column)
    )
    first_at = np.unique(person_ids, return_index=True)[1]
    if len(first_at) == len(person_ids):
        return None, False, ""
    is_same_within = bool(np.allclose(regressor, regressor[first_at[person_ids]], atol=0))
    rule = "persons are exchanged as wholes" if is_same_within else "sessions are exchanged within persons"
    remark = f"names show {len(subjects)} sessions of {len(first_at)} persons, so {rule}. --blocks COLUMN changes this."
    return person_ids, is_same_within, remark


def _numbered(names: Iterable[object]) -> Ints:
    """The number (S,) of each name in the order of the names."""
    return np.unique(list(map(str, names)), return_inverse=True)[1]


def _with_numbers(rows: pd.DataFrame, columns: Sequence[str], subjects: Sequence[str]) -> pd.DataFrame:
    """Rows whose columns ``names`` are numbers if all their values are; raises if only a few are not."""
    for name in columns:
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


def _codes(column: str, values: pd.Series[Any], subjects: Sequence[str]) -> Iterator[str]:
    """A sentence if numbers look like codes of unknown ones: -999 of an age, say.

    They are far out, by the median absolute deviation, or a few whole negative ones among others.
    """
    if values.dtype.kind in "fiu":
        numbers = values.to_numpy(dtype=np.float64)
        offsets = np.abs(numbers - np.median(numbers))
        few_negative = np.mean(numbers < 0) < MOST_CODES_SHARE
        is_code = (offsets > FAR_OUT * np.median(offsets)) & (np.median(offsets) > 0) | (numbers < 0) & (
            numbers % 1 == 0
        ) & few_negative
        if is_code.any():
            texts = [f"{value:g} of {subject}" for value, subject in zip(numbers[is_code], np.array(subjects)[is_code])]
            yield f"{column}: {_some(texts)}. Put n/a, if this is a code of an unknown value."


def _weights(contrast: str, columns: tuple[str, ...], model_spec: Any, formula: str) -> Array:
    """Weights (K,) of a contrast."""
    term = contrast.strip()
    level_names = [c for c in columns if c.startswith((f"{term}[", f"C({term})[")) and c.count(":") == term.count(":")]
    matching_columns = [c for c in columns if c == term or {c, term} <= {*INTERCEPT_NAMES}] or level_names
    if len(matching_columns) == 1:
        return np.isin(columns, matching_columns).astype(np.float64)
    try:
        condition = model_spec.get_linear_constraints(contrast)
        weights = np.asarray(condition.constraint_matrix, dtype=np.float64)
        if len(weights) == 1 and np.isfinite(weights).all() and weights.any() and not condition.constraint_values.any():
            return weights[0]
    except (formulaic.errors.FormulaicError, *FORMULA_ERRORS):
        pass
    raise errors.UnknownName(
        f"contrast {contrast!r}: must be a column of the model {formula!r} or a sum of columns times numbers, and is "
        f"tested against 0. The columns are {', '.join(columns)}."
    )


def _some(texts: Sequence[str]) -> str:
    return f"{', '.join(texts[:4])}{f' and {len(texts) - 4} more' if len(texts) > 4 else ''}"
