"""Designs of linear models: subjects and their values from participants.tsv, and a formula such as ``age + sex``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morphofold.arrays import Array, Ints
from morphofold.errors import DamagedFile, DoesNotApply, MissingPart, NamedTwice, NotFinite, UnknownName, WrongFile

if TYPE_CHECKING:
    import pandas as pd

IDENTIFIER = "participant_id"  # the first column, as BIDS has it
MISSING = ("n/a", "NA", "NaN", "nan", "")
INTERCEPTS = ("1", "Intercept", "intercept")


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
    """

    subjects: tuple[str, ...]
    left_out: tuple[str, ...]
    columns: tuple[str, ...]
    matrix: Array
    contrast: Array
    blocks: Ints | None = None

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
    try:
        table = pd.read_csv(
            path,
            sep="," if path.suffix == ".csv" else "\t",
            dtype={IDENTIFIER: str},
            na_values=list(MISSING),
            keep_default_na=False,
            encoding="utf-8-sig",
        )
    except (UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise DamagedFile(f"{path}: is no table of tab-separated text: {' '.join(str(error).split())}.") from None
    if IDENTIFIER not in table:
        raise WrongFile(
            f"{path}: has no column {IDENTIFIER}; its columns are {', '.join(map(str, table.columns))}. Is it "
            "separated by tabs, as BIDS asks?"
        )
    with path.open(encoding="utf-8-sig") as file:
        heads = file.readline().rstrip("\r\n").split("," if path.suffix == ".csv" else "\t")
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


def design(
    subjects: Sequence[str], participants: pd.DataFrame, formula: str, contrast: str, blocks: str | None = None
) -> Design:
    """The design of a formula for some subjects.

    Parameters
    ----------
    subjects : sequence of str
    participants : DataFrame
        Of :func:`read_participants`.
    formula : str
        Columns of ``participants``, as in R: ``"age + sex"``, ``"group * age"``, ``"1"`` for the mean alone. What is
        not a number is a factor, whose levels are compared with the first in alphabetical order.
    contrast : str
        A column of the design (``"age"``, ``"sex[T.M]"``), a variable with one column (``"sex"``), ``"1"`` for the
        intercept, or weights of columns (``"group[T.b] - group[T.c]"``).
    blocks : str, optional
        Column whose values mark blocks.

    Raises
    ------
    ValueError
        If a subject has no row, the formula or the contrast cannot be read or names a column that does not exist, a
        regressor is constant or infinite, or all subjects miss a value.
    """
    import formulaic

    names = [plain_name(subject) for subject in subjects]
    if missing := sorted(set(names) - set(participants.index)):
        raise MissingPart(
            f"the table of participants has no row of {_some(missing)}. Add what is missing, or leave these subjects "
            "out."
        )
    rows = participants.loc[names]
    try:
        model = formulaic.Formula(formula)
        if not isinstance(model, formulaic.SimpleFormula):
            raise UnknownName(f"{formula!r}: the model has two sides. Give the regressors alone, such as 'age + sex'.")
        needed = sorted({*map(str, model.required_variables), *([blocks] if blocks else [])})
        if unknown := [name for name in needed if name not in rows]:
            raise UnknownName(f"{_some(unknown)}: no such column of participants; they are {', '.join(rows.columns)}.")
        complete = rows[needed].notna().all(axis=1).to_numpy() if needed else np.ones(len(rows), dtype=bool)
        if not complete.any():
            raise DoesNotApply(f"no subject has all values of {_some(needed)}.")
        matrix = model.get_model_matrix(rows[complete], context={})
    except (formulaic.errors.FormulaicError, SyntaxError) as error:
        raise UnknownName(f"{formula!r}: can't be read as a model: {_first_line(error)}") from None
    columns = tuple(map(str, matrix.columns))
    values = np.asarray(matrix, dtype=np.float64)
    _refuse_constant(values, columns)
    if wild := [name for name, column in zip(columns, values.T) if not np.isfinite(column).all()]:
        raise NotFinite(f"{_some(wild)}: has infinite values. Put n/a where a value is unknown.")
    block = None
    if blocks is not None:
        block = np.unique(rows[blocks][complete].astype(str).to_numpy(), return_inverse=True)[1]
    return Design(
        subjects=tuple(one for one, there in zip(subjects, complete) if there),
        left_out=tuple(one for one, there in zip(subjects, complete) if not there),
        columns=columns,
        matrix=values,
        contrast=_weights(contrast, columns, matrix.model_spec, formula),
        blocks=block,
    )


def _refuse_constant(values: Array, columns: tuple[str, ...]) -> None:
    for name, column in zip(columns, values.T):
        if name not in INTERCEPTS and np.ptp(column) == 0:
            raise DoesNotApply(f"{name} is {column[0]:g} for all {len(values)} subjects, so it explains nothing.")


def _weights(contrast: str, columns: tuple[str, ...], spec: object, formula: str) -> Array:
    """Weights (K,) of a contrast."""
    import formulaic

    wanted = contrast.strip()
    wanted = next((name for name in columns if name in INTERCEPTS), wanted) if wanted in INTERCEPTS else wanted
    of_variable = [name for name in columns if name.startswith((f"{wanted}[", f"C({wanted})["))]
    if wanted not in columns and len(of_variable) == 1:
        wanted = of_variable[0]
    if wanted in columns:
        return np.array([float(name == wanted) for name in columns])
    try:
        found = np.asarray(spec.get_linear_constraints(contrast).constraint_matrix, dtype=np.float64)  # type: ignore[attr-defined]
    except Exception as error:
        if not isinstance(error, formulaic.errors.FormulaicError | ValueError | KeyError):
            raise
        found = np.empty((0, len(columns)))
    if found.shape != (1, len(columns)) or not found.any():
        raise UnknownName(
            f"contrast {contrast!r} is none of the model {formula!r}; its columns are {', '.join(columns)}."
        )
    return found[0]


def _some(names: Sequence[str]) -> str:
    return f"{', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}"


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") + "."
