"""The group of a cohort: tidy tables and the data of its page, from the results of its subjects on disk."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow.parquet import ParquetWriter

from morphofold.analysis.measures import COLUMNS, FREESURFER_VALUES, PARAMETERS, SCALARS
from morphofold.arrays import Array, Ints
from morphofold.errors import Mismatch
from morphofold.group.covariates import NO_COVARIATES, Covariates
from morphofold.group.pooling import SETTING_NAMES, Pooling, measured_alike, pooling
from morphofold.group.tasks import Outcome, read_record
from morphofold.io import atomic_folder
from morphofold.io.json_files import read_json
from morphofold.note_texts import WARNINGS
from morphofold.progress import Progress, part_of, silent
from morphofold.provenance import Row, changed_since
from morphofold.results.analyses import Summary
from morphofold.results.layouts import REANALYSE_ADVICE, Layout
from morphofold.tables import line, write_table
from morphofold.words import in_one_line

GROUP_FOLDER = "group"
HEMIS = ("lh", "rh")
WHOLE_HEMISPHERE = "hemisphere"  # in the column ``region``, for values of a whole hemisphere
REGION_MEASURES = tuple(name for name in COLUMNS["regions"] if name not in ("hemi", "region"))
TIDY_COLUMNS = {"subject": str, "hemi": str, "region": str, "measure": str, "value": float}
REGION_COLUMNS = ("hemi", "region", "cortical_thickness_mm", "gyral_thickness_mm")
REGION_THICKNESS_SETTINGS = tuple(key for key in PARAMETERS if "scale" not in key and key != "graph_width_mm")
#: how each was measured, and FreeSurfer's values for it
HEMISPHERE_COLUMNS = ("subject", "hemi", *SETTING_NAMES, *FREESURFER_VALUES)
SURFACE_COLUMNS = ("subject", "hemi", *SCALARS, *FREESURFER_VALUES)
FAILURE_COLUMNS = ("subject", "hemi", "reason", "log")
#: names that no covariate may have
TAKEN_COLUMNS = {*HEMISPHERE_COLUMNS, *SURFACE_COLUMNS, *FAILURE_COLUMNS, *HEMIS}
SUBJECTS_PER_BATCH = 200  # subjects whose rows are in memory at once


@dataclass(frozen=True, eq=False)
class Group:
    """Data for the page of a group; memory grows with the number of subjects, not with their regions or vertices.

    Attributes
    ----------
    subjects : tuple of str
        All requested subjects, including failed ones.
    persons : tuple of str
        The person of each subject; of one with several sessions, several subjects.
    scalars : mapping of measure to (subjects, 2) float64
        Left and right, NaN where there is none.
    regions : mapping of region to (2, 2, 3) float64
        For left and right, cortical and gyral thickness: number of subjects that have both, and mean and standard
        deviation over these [mm]; a person with several sessions counts once.
    failures : list of dict
        Rows of failures.tsv.
    remarks : mapping of subject to sentences
        Warnings of its measures.
    results : mapping of subject to path
        Folders of results.
    same : list of lists of str
        Subjects with the same surfaces under several names.
    simulated : int
        Number of simulated hemispheres; these have no side and are counted on the side that their files name.
    pooling : Pooling
        Which values are of hemispheres measured in the same way, and may be pooled.
    settings : list of dict
        Numbers of each hemisphere, and how it was measured, for the methods paragraph.
    """

    subjects: tuple[str, ...]
    scalars: Mapping[str, Array]
    regions: Mapping[str, Array]
    failures: list[Row]
    remarks: Mapping[str, list[str]]
    results: Mapping[str, Path]
    same: list[list[str]] = field(default_factory=list)
    simulated: int = 0
    pooling: Pooling = field(default_factory=Pooling)
    settings: list[Row] = field(default_factory=list)
    persons: tuple[str, ...] = ()

    @cached_property
    def person_numbers(self) -> tuple[tuple[str, ...], Ints]:
        """Names of the persons (P,), and the number of the person of each subject (S,)."""
        names, numbers = np.unique(self.persons or self.subjects, return_inverse=True)
        return tuple(names.tolist()), numbers

    @property
    def persons_words(self) -> str:
        """Sentence on how persons count, if some have several sessions."""
        n = len(self.person_numbers[0])
        if n == len(self.subjects):
            return ""
        return f"{len(self.subjects)} scans of {n} persons: each person counts once, with the mean of the scans."

    @property
    def remarks_on_group(self) -> list[str]:
        return [*filter(None, [self.persons_words]), *self.pooling.sentences]

    @property
    def n_measured(self) -> int:
        """Number of subjects that have at least one value."""
        return int(np.any([np.isfinite(values).any(axis=1) for values in self.scalars.values()], axis=0).sum())


DrawReport = Callable[[Group, Path, Progress], object]


class SubjectResults(NamedTuple):
    """The summary of one subject, its rows of regions, and the files that were read."""

    summary: Row
    regions: list[Row]
    files: tuple[Path, ...]


def read_results(folder: Path) -> SubjectResults:
    """Read the numbers of a subject, without its surfaces and maps, in either layout.

    Raises
    ------
    FileNotFoundError, ValueError
        If they are missing or damaged.
    """
    layout = Layout.of(folder)
    path = layout.path("summary")
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: holds no results.")
    summary = read_json(path, Summary, REANALYSE_ADVICE)
    regions = layout.read_table("regions", summary["rows"].get("regions"))
    return SubjectResults(summary, regions, (path, layout.path("table", name="regions")))


def refuse_changed(record: Row, folder: Path, files: Iterable[Path]) -> None:
    """Raise ``Mismatch`` if files differ from those in the record of a task, whose results are in ``folder``."""
    named = {file.relative_to(folder).as_posix(): file for file in files}
    known = {name: digest for name, digest in record.get("files", {}).items() if name in named}
    if changed := changed_since(known, named):
        raise Mismatch(f"{', '.join(str(named[name]) for name in changed)}: changed since it was written.")


def what_became(record: Row, outcome: Outcome | None, unknown: str) -> tuple[dict[str, str], bool]:
    """Failures of a task and whether it has results: from its outcome in this run, else from its record."""
    if outcome is not None:
        return dict(outcome.failures), outcome.state != "failed"
    return dict(record.get("failures", {"": unknown})), bool(record.get("results"))


def write_measures(folder: Path, columns: Mapping[str, type], batches: Iterable[Sequence[Sequence[Any]]]) -> None:
    """Write measures.tsv and measures.parquet, one batch of rows at a time.

    ``columns`` are ``str``, ``int`` or ``float``, as in Parquet; text is stored once, in a dictionary.
    """
    kinds = {str: pa.dictionary(pa.int32(), pa.string()), int: pa.int64(), float: pa.float64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
    text = (folder / "measures.tsv").open("w", encoding="utf-8", errors="backslashreplace", newline="")
    with text, ParquetWriter(folder / "measures.parquet", schema, compression="zstd") as parquet:
        text.write(line(columns))
        for rows in filter(None, batches):
            text.writelines(map(line, rows))
            values = {
                name: [None if x is None else kind(x) for x in column]
                for (name, kind), column in zip(columns.items(), zip(*rows))
            }
            parquet.write_table(pa.Table.from_pydict(values, schema=schema))


def write_group(
    out: Path,
    results: Mapping[str, Path],
    outcomes: Sequence[Outcome] = (),
    *,
    report: DrawReport | Literal[False] = False,
    progress: Progress = silent,
    covariates: Covariates = NO_COVARIATES,
) -> Group:
    """Write ``out/group`` completely or not at all: measures.tsv, measures.parquet, surfaces.tsv, hemispheres.tsv and
    failures.tsv, and report.html if there is a ``report``.

    Parameters
    ----------
    out : Path
        Folder of the cohort, with its records.
    results : mapping of subject to path
        Folder of the results of each, whether it exists or not.
    outcomes : sequence of Outcome
        Outcomes of subjects measured in this run; for others, the records are used.
    report : callable or False
        Draws the page of a group into a folder: :func:`morphofold.report.pages.group_page.group_report`.
    progress : callable
        Called with the share done and the current step.
    covariates : Covariates
        Columns after the subject in all tables but measures.tsv, which has many rows for each.
    """
    subjects = tuple(sorted(results, key=lambda subject: (covariates.person(subject), subject)))
    reader = _Reader(out, results, {outcome.name: outcome for outcome in outcomes})
    with atomic_folder(out / GROUP_FOLDER) as folder:
        write_measures(folder, TIDY_COLUMNS, reader.batches(subjects, part_of(progress, 0.0, 0.7)))
        for name, columns, rows in (
            ("failures", FAILURE_COLUMNS, reader.failures),
            ("hemispheres", HEMISPHERE_COLUMNS, reader.hemispheres),
            ("surfaces", SURFACE_COLUMNS, reader.hemispheres),
        ):
            cells = [{**covariates.of(row["subject"]), **{key: row[key] for key in columns}} for row in rows]
            write_table(folder / f"{name}.tsv", (columns[0], *covariates.columns, *columns[1:]), cells)
        group = _group(reader, subjects, tuple(map(covariates.person, subjects)))
        if report:
            report(group, folder, part_of(progress, 0.7, 0.3))
    progress(1.0, "done")
    return group


class _Reader:
    """Reads the results of subjects, one after the other, and collects what the small tables and the page need."""

    def __init__(self, out: Path, results: Mapping[str, Path], outcomes: Mapping[str, Outcome]):
        self.out, self.results, self.outcomes = out, results, outcomes
        self.failures: list[Row] = []
        self.hemispheres: list[Row] = []
        self.regions: list[tuple[Any, ...]] = []  # subject, and REGION_COLUMNS
        self.remarks: dict[str, list[str]] = {}
        self.surfaces: dict[str, list[str]] = defaultdict(list)  # subjects by the digests of their surfaces

    def batches(self, subjects: Sequence[str], progress: Progress) -> Iterator[list[tuple[Any, ...]]]:
        """Rows of measures.tsv."""
        for start in range(0, len(subjects), SUBJECTS_PER_BATCH):
            progress(start / len(subjects), "tables")
            batch = subjects[start : start + SUBJECTS_PER_BATCH]
            yield [row for subject in batch for row in self.rows(subject)]

    def rows(self, subject: str) -> list[tuple[Any, ...]]:
        """Rows of a subject in measures.tsv; none if it has no results."""
        place, record = self.results[subject], read_record(self.out / "records" / f"{subject}.json")
        unknown = "not measured yet. Run the cohort again."
        failures, has_results = what_became(record, self.outcomes.get(subject), unknown)
        rows = []
        if has_results:
            try:
                results = read_results(place)
                refuse_changed(record, place, results.files)
                rows = self.collect(subject, results)
            except (OSError, ValueError) as error:
                failures[""] = f"{in_one_line(error)} Run the cohort again."
        self.failures += [
            {"subject": subject, "hemi": hemi or None, "reason": reason, "log": f"logs/{subject}.log"}
            for hemi, reason in sorted(failures.items())
        ]
        return rows

    def collect(self, subject: str, results: SubjectResults) -> list[tuple[Any, ...]]:
        """One row for each number of a subject, in the order of its tables."""
        entries = results.summary["surfaces"]
        self.hemispheres += [_hemisphere_row(subject, results.summary["morphofold"], entry) for entry in entries]
        self.regions += [(subject, *(row[key] for key in REGION_COLUMNS)) for row in results.regions]
        notes = [(entry["hemi"], entry["notes"].get(key)) for entry in entries for key in WARNINGS]
        if warnings := [f"{hemi}: {note}" for hemi, note in notes if note]:
            self.remarks[subject] = warnings
        digests = {Path(row["path"]).name: row["sha256"] for row in results.summary["inputs"]}
        surfaces = sorted(f"{name} {sha}" for name, sha in digests.items() if "white" in name or "pial" in name)
        self.surfaces[" ".join(surfaces)].append(subject)
        cells = [(e["hemi"], WHOLE_HEMISPHERE, key, e["measures"].get(key)) for e in entries for key in SCALARS]
        cells += [(row["hemi"], row["region"], key, row[key]) for row in results.regions for key in REGION_MEASURES]
        return [(subject, *cell) for cell in cells]


def _group(reader: _Reader, subjects: tuple[str, ...], persons: tuple[str, ...]) -> Group:
    names = ["subject", "hemi"]
    both = pd.MultiIndex.from_product([subjects, HEMIS], names=names)
    table = pd.DataFrame(reader.hemispheres, columns=[*names, *SETTING_NAMES, *SCALARS], dtype=object)
    table = table.set_index(names).reindex(both)
    scalars = {name: table[name].to_numpy(dtype=float).reshape(-1, 2) for name in SCALARS}
    regions = pd.DataFrame(reader.regions, columns=("subject", *REGION_COLUMNS)).set_index(names)
    regions = regions.astype(dict.fromkeys(REGION_COLUMNS[2:], float))
    alike = measured_alike(table, REGION_THICKNESS_SETTINGS, both.isin(regions.index))
    return Group(
        subjects,
        scalars,
        _region_statistics(regions[regions.index.isin(both[alike])].dropna(), dict(zip(subjects, persons))),
        reader.failures,
        reader.remarks,
        dict(reader.results),
        [names for digests, names in reader.surfaces.items() if digests and len(names) > 1],
        sum(row["origin"] == "simulation" for row in reader.hemispheres),
        pooling(table, scalars),
        reader.hemispheres,
        persons,
    )


def _region_statistics(thicknesses: pd.DataFrame, persons: Mapping[str, str]) -> dict[str, Array]:
    """Number, mean and deviation over persons of cortical and gyral thickness of regions, by their sides."""
    person = thicknesses.index.get_level_values("subject").map(persons).to_numpy()
    means = thicknesses.groupby(["region", "hemi", person]).mean()
    statistics: dict[str, Array] = {}
    for (region, hemi), values in means.groupby(["region", "hemi"]):
        sides = statistics.setdefault(str(region), np.tile([0, np.nan, np.nan], (2, 2, 1)))
        sides[HEMIS.index(hemi)] = np.column_stack([values.count(), values.mean(), values.std(ddof=0)])
    return statistics


def _hemisphere_row(subject: str, version: str, entry: Row) -> Row:
    """Numbers and settings of a hemisphere in one row, with all columns of the tables of hemispheres."""
    columns = (*HEMISPHERE_COLUMNS, *SURFACE_COLUMNS, "annotation_from")
    row = dict.fromkeys(columns) | entry["info"] | entry["parameters"] | entry["measures"]
    row |= {"subject": subject, "morphofold": version, **{key: entry[key] for key in ("hemi", "origin", "annotation")}}
    return row | {key: float(f"{row[key]:.6g}") for key in SETTING_NAMES if isinstance(row[key], int | float)}
