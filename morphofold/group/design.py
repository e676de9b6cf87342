"""Designs of linear models: subjects and their values from participants.tsv, and a formula such as ``age + sex``."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.errors import DamagedFile, DoesNotApply, MissingPart, NamedTwice, NotFinite, UnknownName, WrongFile
from morphofold.group.formula import columns_of
from morphofold.group.sessions import LONG, person_and_session

if TYPE_CHECKING:
    import pandas as pd

PERSON = "person"  # a column that names the person of each session
IDENTIFIER = "participant_id"  # the first column, as BIDS has it
MISSING = ("n/a", "NA", "NaN", "nan", "")
INTERCEPTS = ("1", "Intercept", "intercept")
#: that formulaic raises for formulas and contrasts without a meaning
NO_MEANING = (SyntaxError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RuntimeError)
LARGEST_WEIGHT = 1e9  # of a contrast; the smallest is its inverse
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
        Whether the blocks are persons whose names show sessions, and what is tested is the same in all of a person's.
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


def read_participants(path: str | Path) -> pd.DataFrame:
    """Read participants.tsv (BIDS) or a .csv file: a row for each subject, found by ``participant_id``.

    ``n/a``, ``NA`` and empty cells are missing values; ``sub-`` in front of a subject may be left out.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a table with that column, or names a subject twice.
    """
    import pandas as pd

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Give a table of the subjects, such as participants.tsv.")
    separator = "," if path.suffix.lower() == ".csv" else "\t"
    try:
        text = re.sub(r" *([\t\n]) *", r"\1", path.read_text(encoding="utf-8-sig"))
        text = re.sub(f"{separator}+$", "", text, flags=re.MULTILINE)
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # of a line with more cells than the first
            table = pd.read_csv(
                io.StringIO(text),
                sep=separator,
                index_col=False,
                dtype={IDENTIFIER: str},
                na_values=list(MISSING),
                keep_default_na=False,
            )
    except (ValueError, pd.errors.ParserWarning) as error:  # ValueError: not UTF-8, no table
        words = " ".join(str(error).split())
        raise DamagedFile(f"{path}: is no table of tab-separated UTF-8 text, or compressed: {words}.") from None
    if IDENTIFIER not in table:
        raise WrongFile(
            f"{path}: has no column {IDENTIFIER}; its columns are {', '.join(map(str, table.columns))}. Is it "
            "separated by tabs, as BIDS asks?"
        )
    heads = text.partition("\n")[0].split(separator)
    if again := sorted({name for name in heads if heads.count(name) > 1}):
        raise NamedTwice(f"{path}: has two columns {_some(again)}. Rename one, or leave it out.")
    if table[IDENTIFIER].isna().any():
        row = int(np.flatnonzero(table[IDENTIFIER].isna())[0]) + 2
        raise DamagedFile(f"{path}: line {row} has no {IDENTIFIER}. Fill it in, or remove the line.")
    table[IDENTIFIER] = table[IDENTIFIER].map(plain_name)
    twice = sorted(table[IDENTIFIER][table[IDENTIFIER].duplicated()].unique())
    if twice:
        raise NamedTwice(f"{path}: has two rows of {_some(twice)}. Leave one row for each subject.")
    return table.set_index(IDENTIFIER)


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
    import formulaic

    rows_of = [names_of_row(one) for one in subjects]
    names = [next((name for name in each if name in participants.index), each[0]) for each in rows_of]
    if missing := sorted(set(names) - set(participants.index)):
        raise MissingPart(
            f"the table of participants has no row of {_some(missing)}. Add what is missing, or leave these subjects "
            "out."
        )
    everybody = participants.loc[names].reset_index(drop=True)
    named, factors = columns_of(formula)
    needed = sorted({*named, *filter(None, (blocks, variance_groups))})
    if unknown := [name for name in needed if name not in everybody]:
        raise UnknownName(f"{_some(unknown)}: no such column of participants; they are {', '.join(everybody.columns)}.")
    rows = _with_numbers(everybody[needed], sorted(named - factors), names)
    complete = rows.notna().all(axis=1).to_numpy()
    if not complete.any():
        raise DoesNotApply(f"no subject has all values of {_some(needed)}.")
    factors |= {name for name in named if rows[name].dtype.kind not in "biuf"}
    columns_of(formula, {name: rows[name].nunique() for name in factors})
    rows, kept = rows[complete], tuple(one for one, there in zip(subjects, complete) if there)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused below
            matrix = formulaic.Formula(formula).get_model_matrix(rows, context={"sqrt": np.sqrt}, na_action="ignore")
    except (formulaic.errors.FormulaicError, *NO_MEANING) as error:
        raise UnknownName(f"{formula!r}: can't be read as a model: {_first_line(error)}") from None
    columns = tuple(map(str, matrix.columns))
    values = np.asarray(matrix, dtype=np.float64)
    if wild := [name for name, column in zip(columns, values.T) if not np.isfinite(column).all()]:
        raise NotFinite(f"{_some(wild)}: is not finite for all subjects. Put n/a where a value is unknown.")
    weights = _weights(contrast, columns, matrix.model_spec, formula)
    block, whole = None if blocks is None else _numbered(rows[blocks]), False
    remarks = [text for name in sorted(named) for text in _codes(name, rows[name], kept)]
    persons = _numbered(_persons(kept, everybody[complete]))
    first, times = np.unique(persons, return_index=True, return_counts=True)[1:]
    if blocks is None and times.max() > 1:
        block, whole = persons, bool(np.allclose(values @ weights, (values @ weights)[first[persons]], atol=0))
        how = "persons are exchanged as wholes" if whole else "sessions are exchanged within persons"
        remarks.append(
            f"names show {len(kept)} sessions of {len(first)} persons, so {how}. --blocks COLUMN changes this."
        )
    elif blocks is None and (repeats := _repeats(values)) > 1:
        remarks.append(
            f"every value of a regressor is there {repeats} times or more. If these are sessions of one person, name a "
            "column of persons with --blocks."
        )
    return Design(
        subjects=kept,
        left_out=tuple(one for one, there in zip(subjects, complete) if not there),
        columns=columns,
        matrix=values,
        contrast=weights,
        blocks=block,
        whole=whole,
        variance_groups=None if variance_groups is None else _numbered(rows[variance_groups]),
        remarks=tuple(remarks),
    )


def _persons(subjects: Sequence[str], rows: pd.DataFrame) -> list[str]:
    """The person of each subject: by the column ``person``, else by the name."""
    known = rows.get(PERSON, [None] * len(subjects))
    return [
        person_of(name) if person is None or person != person else str(person) for name, person in zip(subjects, known)
    ]


def _numbered(names: Iterable[object]) -> Ints:
    """The number (S,) of each name in the order of the names."""
    return np.unique([str(name) for name in names], return_inverse=True)[1]


def _with_numbers(rows: pd.DataFrame, names: Sequence[str], subjects: Sequence[str]) -> pd.DataFrame:
    """Rows whose columns ``names`` are numbers if all their values are; raises if only a few are not."""
    import pandas as pd

    for name in names:
        numbers = pd.to_numeric(rows[name], errors="coerce")
        wrong = np.flatnonzero(rows[name].notna() & numbers.isna())
        if not len(wrong):
            rows = rows.assign(**{name: numbers})
        elif 2 * len(wrong) < rows[name].notna().sum():
            raise DamagedFile(
                f"{name}: {rows[name][wrong[0]]!r} of {subjects[wrong[0]]} is not a number, as most values are. "
                f"Correct it, put n/a if it is unknown, or write C({name}) if the values are names."
            )
    return rows


def _codes(name: str, values: pd.Series[Any], subjects: Sequence[str]) -> Iterator[str]:
    """A sentence if numbers look like codes of unknown ones: -999 of an age, say.

    They are far out, by the median absolute deviation, or a few whole negative ones among others.
    """
    if values.dtype.kind in "fiu":
        known = values.to_numpy(dtype=np.float64)
        away = np.abs(known - np.median(known))
        few = np.mean(known < 0) < MOST_CODES
        odd = (away > FAR_OUT * np.median(away)) & (np.median(away) > 0) | (known < 0) & (known % 1 == 0) & few
        if odd.any():
            found = [f"{value:g} of {subject}" for value, subject in zip(known[odd], np.array(subjects)[odd])]
            yield f"{name}: {_some(found)}. Put n/a, if this is a code of an unknown value."


def _repeats(values: Array) -> int:
    """How many times, at least, each value of a regressor with fractions is there, or each row if all are as often.

    Regressors with fewer than five values do not count.
    """
    rows = np.unique(values, axis=0, return_counts=True)[1]
    alike = int(rows[0]) if rows.min() == rows.max() else 0
    counted = (np.unique(column, return_counts=True) for column in values.T)
    return max((int(n.min()) if (x % 1).any() else alike for x, n in counted if len(x) >= 5), default=0)


def _weights(contrast: str, columns: tuple[str, ...], spec: Any, formula: str) -> Array:
    """Weights (K,) of a contrast."""
    import formulaic

    wanted = contrast.strip()
    wanted = next((name for name in columns if name in INTERCEPTS), wanted) if wanted in INTERCEPTS else wanted
    order, heads = wanted.count(":"), (f"{wanted}[", f"C({wanted})[")
    of_variable = [name for name in columns if name.startswith(heads) and name.count(":") == order]
    if wanted not in columns and len(of_variable) == 1:
        wanted = of_variable[0]
    if wanted in columns:
        return np.array([float(name == wanted) for name in columns])
    try:
        found = spec.get_linear_constraints(contrast)
        weights, size = np.asarray(found.constraint_matrix, np.float64), np.abs(found.constraint_matrix)
        usual = ((size == 0) | (size > 1 / LARGEST_WEIGHT) & (size < LARGEST_WEIGHT)).all()
        if weights.shape == (1, len(columns)) and usual and weights.any() and not found.constraint_values.any():
            return weights[0]
    except (formulaic.errors.FormulaicError, *NO_MEANING):
        pass
    raise UnknownName(
        f"contrast {contrast!r}: must be a column of the model {formula!r} or a sum of columns times numbers, and is "
        f"tested against 0. The columns are {', '.join(columns)}."
    )


def _some(names: Sequence[str]) -> str:
    return f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}"


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") + "."
