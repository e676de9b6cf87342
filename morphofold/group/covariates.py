"""Covariates of subjects, such as age and sex: the columns of participants.tsv, for the tables of a group."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from morphofold.errors import NamedTwice
from morphofold.group.design import PERSON, names_of_row, person_and_session, read_participants
from morphofold.provenance import Row

PARTICIPANTS_FILE = "participants.tsv"


@dataclass(frozen=True)
class Covariates:
    """Columns of participants.tsv, and a row of values for each subject, whose name has no ``sub-``."""

    columns: tuple[str, ...] = ()
    rows: Mapping[str, Row] = field(default_factory=dict)

    def of(self, subject: str) -> Row:
        """Values of a subject, None where there is none; a session ``sub-01_ses-2`` has those of ``sub-01``, and a
        longitudinal run those of its time point."""
        person, session = person_and_session(subject)
        row = next((self.rows[name] for name in names_of_row(subject) if name in self.rows), {})
        values = {PERSON: person, "session": session or None, **row}
        return {column: values.get(column) for column in self.columns}

    def person(self, subject: str) -> str:
        """The person of a subject: by the column ``person``, else by its name."""
        named = self.of(subject).get(PERSON)
        return str(person_and_session(subject)[0] if named is None else named)

    def of_sessions(self, subjects: Iterable[str]) -> "Covariates":
        """These, with the columns ``person`` and ``session`` if some subjects are sessions of a person."""
        if not any(person_and_session(subject)[1] for subject in subjects):
            return self
        return replace(self, columns=tuple(dict.fromkeys((PERSON, "session", *self.columns))))


NO_COVARIATES = Covariates()


def find_covariates(file: Path | None, folders: Iterable[Path] = (), taken: Iterable[str] = ()) -> Covariates:
    """Covariates from a table of participants, ``file``, else from the first of ``folders`` with one, else none.

    A column is of whole numbers, of numbers or of text, as all its values are.

    Raises
    ------
    FileNotFoundError
        If ``file`` does not exist.
    ValueError
        If it is not a table of participants, names a subject twice, or a column has one of the names ``taken``.
    """
    files = (folder / PARTICIPANTS_FILE for folder in folders)
    path = file or next(filter(Path.is_file, files), None)
    if path is None:
        return NO_COVARIATES
    table = read_participants(path).convert_dtypes()  # whole numbers stay whole where some are missing
    if twice := sorted({*table.columns} & {*taken}):
        raise NamedTwice(
            f"{path}: the column {twice[0]} has the name of a column of the group's tables. Rename it, or give another "
            "table with --participants."
        )
    table = table.astype(dict.fromkeys(table.select_dtypes("boolean"), "string"))  # in tables they would be 1 and 0
    return Covariates(tuple(table.columns), table.astype(object).where(table.notna(), None).to_dict("index"))
