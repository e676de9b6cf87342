"""The subjects of a cohort, found in a folder or listed in a file; and their covariates, such as age and sex: columns
of participants.tsv, for the tables of a group."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pandas as pd

from morphofold.digests_and_json import Row
from morphofold.errors import NamedTwice, NothingToDo, NotReadable, WrongFile
from morphofold.group.design import (
    ID_COLUMN,
    LONG_MARK,
    MISSING_TEXTS,
    PERSON_COLUMN,
    names_of_row,
    person_and_session,
    read_participants,
)
from morphofold.io.files import decoding
from morphofold.io.layouts import subjects_in

#: folders that FreeSurfer puts beside subjects
TEMPLATE_SUBJECTS = ("fsaverage", "lh.EC_average", "rh.EC_average", "cvs_avg35")
TIME_POINTS = "base-tps"  # the file of a base template of longitudinal runs, with the names of its time points


def find_subjects(folder: Path) -> tuple[dict[str, Path], dict[str, str]]:
    """Subjects in a folder by name, sorted, each with its folder as ``read_cortex`` takes it; and why others were left
    out.

    They are those of any layout in :mod:`morphofold.io.layouts`. A FreeSurfer folder without surfaces is a subject too,
    and fails later. ``sub-01/ses-2`` is the subject ``sub-01_ses-2``. Left out are templates, the base templates of
    longitudinal runs, and runs of time points that also have a longitudinal run.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        If there is no such folder.
    NamedTwice
        If two programs have one subject.
    NothingToDo
        If it has no subject.
    """
    if not folder.exists():
        raise FileNotFoundError(f"{folder}: no such folder. Give the folder that contains the subjects.")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file. Give the folder that contains the subjects.")
    place_of = {name: subject.place for name, subject in sorted(subjects_in(folder).items())}
    names = list(place_of)
    left_out = dict.fromkeys((name for name in names if name.startswith(TEMPLATE_SUBJECTS)), "template")
    for time_point, long_mark, base_name in (name.partition(LONG_MARK) for name in names):
        if long_mark:
            time_file = folder / base_name / TIME_POINTS
            time_points = time_file.read_text(encoding="utf-8", errors="replace").split() if time_file.is_file() else []
            left_out |= {base_name: "base template"} | dict.fromkeys([time_point, *time_points], "cross-sectional run")
        elif (folder / time_point / TIME_POINTS).is_file():
            left_out.setdefault(time_point, "base template")
    subjects = {name: place_of[name] for name in names if name not in left_out}
    left_out = {name: reason for name, reason in sorted(left_out.items()) if name in names}
    if not subjects:
        except_text = f" except {left_out_words(left_out)}" if left_out else ""
        raise NothingToDo(
            f"{folder}: contains no subject{except_text}. A subject has surf/lh.white and surf/lh.pial, "
            "or files of another program: see docs/tutorial-neuroimager.md."
        )
    return subjects, left_out


def left_out_words(left_out: Mapping[str, str]) -> str:
    """What was left out of a folder, for messages."""
    names_text = ", ".join(f"{entry_name} ({reason})" for entry_name, reason in left_out.items())
    return f"{names_text}; --subjects can include them"


def named_subjects(file: Path) -> list[str]:
    """Names from a text file, one per line; empty lines and text after ``#`` are ignored.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not UTF-8 text, has no name, a name twice, or a path.
    """
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file. Give a text file with one subject per line.")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise WrongFile(f"{file}: is not UTF-8 text. Give a text file with one subject per line.") from None
    names = [name for line in lines if (name := line.partition("#")[0].strip().rstrip("/"))]
    if not names:
        raise NothingToDo(f"{file}: lists no subject. Write one name per line.")
    if bad_names := [name for name in names if name in (".", "..") or Path(name).name != name]:
        raise NotReadable(f"{file}: {bad_names[0]!r} is not a folder name. Give names of subjects, not paths.")
    repeated_names = sorted(name for name, n_times in Counter(names).items() if n_times > 1)
    if repeated_names:
        raise NamedTwice(f"{file}: lists {', '.join(repeated_names[:5])} twice. List each name once.")
    return names


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
        covariate_row = next((self.rows[name] for name in names_of_row(subject) if name in self.rows), {})
        values = {PERSON_COLUMN: person, "session": session or None, **covariate_row}
        return {column: values.get(column) for column in self.columns}

    def person(self, subject: str) -> str:
        """The person of a subject: by the column ``person``, else by its name."""
        person_value = self.of(subject).get(PERSON_COLUMN)
        return str(person_and_session(subject)[0] if person_value is None else person_value)

    def of_sessions(self, subjects: Iterable[str]) -> "Covariates":
        """These, with the columns ``person`` and ``session`` if some subjects are sessions of a person."""
        if not any(person_and_session(subject)[1] for subject in subjects):
            return self
        return replace(self, columns=tuple(dict.fromkeys((PERSON_COLUMN, "session", *self.columns))))


NO_COVARIATES = Covariates()


def _with_sessions(participants: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """The table with a row for each session in BIDS's ``sub-NAME/sub-NAME_sessions.tsv`` beside it, if there is one."""
    rows = []
    for file in sorted(folder.glob("sub-*/sub-*_sessions.tsv")):
        person = file.parent.name.removeprefix("sub-")
        about_person = participants.loc[person].to_dict() if person in participants.index else {}
        with decoding(file, "a table of sessions, with the column session_id"):
            table = pd.read_csv(file, sep="\t", dtype={"session_id": str}, na_values=MISSING_TEXTS).set_index(
                "session_id"
            )
        for session, row in table.iterrows():
            name = f"{person}_ses-{str(session).removeprefix('ses-')}"
            rows.append({ID_COLUMN: name, **about_person, **row.dropna().to_dict()})
        if not table.index.is_unique:
            raise NamedTwice(f"{file}: names a session twice. Leave one row of each.")
    sessions = pd.DataFrame(rows, columns=None if rows else [ID_COLUMN]).set_index(ID_COLUMN)
    return pd.concat([participants, sessions[~sessions.index.isin(participants.index)]]) if rows else participants


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
    path = file or next(filter(Path.is_file, (folder / PARTICIPANTS_FILE for folder in folders)), None)
    if path is None:
        return NO_COVARIATES
    table = _with_sessions(read_participants(path), path.parent)
    table = table.convert_dtypes()  # whole numbers stay whole where some are missing
    if clashing_columns := sorted({*table.columns} & {*taken}):
        raise NamedTwice(
            f"{path}: the column {clashing_columns[0]} has the name of a column of the group's tables. Rename it, or "
            "give another table with --participants."
        )
    table = table.astype(dict.fromkeys(table.select_dtypes("boolean"), "string"))  # in tables they would be 1 and 0
    return Covariates(tuple(table.columns), table.astype(object).where(table.notna(), None).to_dict("index"))
