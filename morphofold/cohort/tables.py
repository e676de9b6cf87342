"""Tables of a group: from the results of its subjects, one after the other, to tidy text and Parquet."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.faults import WARNINGS
from morphofold.analysis.measures import SCALARS
from morphofold.cohort.tasks import Outcome, read_record
from morphofold.io import files_of
from morphofold.records import NOT_OURS, changed_since
from morphofold.results import COLUMNS
from morphofold.results.summary import WORDS
from morphofold.tables import cell, read_table, write_table

HEMIS = ("lh", "rh")
WHOLE = "hemisphere"    # in the column ``region``, of what is of a whole one
REGION_MEASURES = tuple(name for name in COLUMNS["regions"] if name not in ("hemi", "region"))
TIDY = ("subject", "hemi", "region", "measure", "value")
OPTIONS = ("accuracy", "curvature_scale_mm", "gyral_width_mm")          # that change numbers
FAILURES = ("subject", "hemi", "reason", "log")
BATCH = 200             # subjects whose rows are held at once

Row = tuple[str, str, str, str, float | None]


@dataclass(frozen=True, eq=False)
class Group:
    """What the page of a group is made from; memory grows with subjects, not with their regions or vertices.

    Attributes
    ----------
    subjects : tuple of str
        All that were asked for, those that failed too.
    scalars : mapping of measure to (subjects, 2) float64
        Left and right, NaN where there is none.
    regions : mapping of region to (2, 2, 3) float64
        For left and right, cortical and gyral thickness: number of subjects that have both, and the mean and standard
        deviation of these [mm].
    failures : list of dict
        Rows of failures.tsv.
    remarks : mapping of subject to sentences
        What its measures warn of.
    results : mapping of subject to path
        Folders of results.
    same : list of lists of str
        Subjects whose surfaces are the same, under several names.
    simulated : int
        Hemispheres that are simulated; these have no side, and stand where their files put them.
    ways : mapping of words to int
        How subjects were measured, version and options, and how many so: one entry if all are comparable.
    """

    subjects: tuple[str, ...]
    scalars: Mapping[str, NDArray[np.float64]]
    regions: Mapping[str, NDArray[np.float64]]
    failures: list[dict[str, Any]]
    remarks: Mapping[str, list[str]]
    results: Mapping[str, Path]
    same: list[list[str]] = field(default_factory=list)
    simulated: int = 0
    ways: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """What the results of one subject say: an entry of each hemisphere, rows of regions, digests of its surfaces,
    version and options by which it was measured, and the files that say so."""

    entries: list[dict[str, Any]]
    regions: list[dict[str, Any]]
    surfaces: str
    way: str
    read: tuple[Path, ...]


def read_results(folder: Path) -> Found:
    """The numbers of a subject, without its surfaces and maps, in either layout.

    Raises
    ------
    FileNotFoundError, ValueError
        If they are not there, or not as they were written.
    """
    path, table = folder / "summary.json", folder / "regions.tsv"
    if not path.is_file():
        path = folder / "anat" / f"{folder.name}_desc-morphofold_provenance.json"
        table = folder / "anat" / f"{folder.name}_desc-regions_morph.tsv"
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: holds no results.")
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        surfaces = {Path(row["path"]).name: row["sha256"] for row in said["inputs"]}
        wanted = sorted(f"{name} {sha}" for name, sha in surfaces.items() if "white" in name or "pial" in name)
        entries = [{key: entry[key] for key in ("hemi", "origin", "measures", "notes")} for entry in said["surfaces"]]
        regions = read_table(table, WORDS, said["rows"]["regions"])
        if not all(isinstance(entry[key], dict) for entry in entries for key in ("measures", "notes")):
            raise TypeError("measures and notes are not by name")
        if not all(one["hemi"] in HEMIS for one in (*entries, *regions)):
            raise TypeError("a hemisphere is neither lh nor rh")
        numbers = [entry["measures"].get(name) for entry in entries for name in SCALARS]
        numbers += [row[name] for row in regions for name in REGION_MEASURES]
        if not all(x is None or (isinstance(x, int | float) and np.isfinite(float(x))) for x in numbers):
            raise TypeError("a measure is no number")
        if not all(isinstance(row["region"], str) for row in regions):
            raise TypeError("a region has no name")
        options = [f"{key} {x}" for key, x in sorted(said["parameters"].items()) if key in OPTIONS and x is not None]
        way = ", ".join([f"morphofold {said['morphofold']}", *options])
        return Found(entries, regions, " ".join(wanted), way, (path, table))
    except NOT_OURS as error:
        raise ValueError(f"{path}: not as morphofold writes it ({type(error).__name__}: {error}).") from error


def refuse_changed(record: Mapping[str, Any], files: Mapping[str, Path]) -> None:
    """Raise ``ValueError`` if files are not those that the record of a task speaks of."""
    known = {name: digest for name, digest in record.get("files", {}).items() if name in files}
    if changed := changed_since(known, files):
        raise ValueError(f"{', '.join(str(files[name]) for name in changed)}: changed since it was written.")


def tidy_rows(subject: str, found: Found) -> Iterator[Row]:
    """One row for each number of a subject, in the order of its tables."""
    for entry in found.entries:
        for measure in SCALARS:
            yield subject, entry["hemi"], WHOLE, measure, entry["measures"].get(measure)
    for row in found.regions:
        for measure in REGION_MEASURES:
            yield subject, row["hemi"], row["region"], measure, row[measure]


class TidyWriter:
    """measures.tsv and measures.parquet, written a batch of rows at a time."""

    def __init__(self, folder: Path):
        import pyarrow as pa
        from pyarrow import parquet

        words = pa.dictionary(pa.int32(), pa.string())
        self._schema = pa.schema([(name, words) for name in TIDY[:-1]] + [(TIDY[-1], pa.float64())])
        self._table = pa.Table
        self._parquet = parquet.ParquetWriter(folder / "measures.parquet", self._schema, compression="zstd")
        self._file: IO[str] = (folder / "measures.tsv").open("w", encoding="utf-8", newline="")
        self._lines = csv.writer(self._file, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
        self._lines.writerow(TIDY)
        self.rows = 0

    def write(self, rows: Sequence[Row]) -> None:
        if not rows:
            return
        self._lines.writerows([*row[:-1], cell(row[-1])] for row in rows)
        columns = dict(zip(TIDY, zip(*rows)))
        columns["value"] = tuple(None if x is None else float(x) for x in columns["value"])
        self._parquet.write_table(self._table.from_pydict(columns, schema=self._schema))
        self.rows += len(rows)

    def close(self) -> None:
        self._parquet.close()
        self._file.close()


def write_tables(
    folder: Path, out: Path, results: Mapping[str, Path], outcomes: Mapping[str, Outcome] | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> Group:  # fmt: skip
    """Write measures.tsv, measures.parquet and failures.tsv of a group.

    Parameters
    ----------
    folder : Path
        To write them into.
    out : Path
        Of the cohort, with its records.
    results : mapping of subject to path
        Where the results of each are, or would be.
    outcomes : mapping of subject to Outcome
        What became of those that were measured just now; of others the records tell.
    tell : callable
        Told the share done.
    """
    gathered = _Gathered(len(results))
    failures: list[dict[str, Any]] = []
    writer = TidyWriter(folder)
    rows: list[Row] = []
    try:
        for i, (subject, place) in enumerate(sorted(results.items())):
            record = read_record(out / "records" / f"{subject}.json")
            outcome = None if outcomes is None else outcomes.get(subject)
            missing, there = what_became(record, outcome, "not measured yet. Run the cohort again.")
            if there:
                try:
                    found = read_results(place)
                    refuse_changed(record, {name: path for name, path in files_of(place).items() if path in found.read})
                except (OSError, ValueError) as error:
                    missing[""] = f"{' '.join(str(error).split())} Run the cohort again."
                else:
                    rows += tidy_rows(subject, found)
                    gathered.add(i, subject, found)
            failures += [
                {"subject": subject, "hemi": hemi or None, "reason": why, "log": f"logs/{subject}.log"}
                for hemi, why in sorted(missing.items())
            ]
            if i % BATCH == BATCH - 1:
                writer.write(rows)
                rows.clear()
                tell(i / len(results))
        writer.write(rows)
    finally:
        writer.close()
    write_table(folder / "failures.tsv", FAILURES, failures)
    return gathered.group(tuple(sorted(results)), failures, results)


def what_became(record: Mapping[str, Any], outcome: Outcome | None, unknown: str) -> tuple[dict[str, str], bool]:
    """Failures of a task and whether it has results: as it came out just now, else by its record."""
    if outcome is not None:
        return dict(outcome.failures), outcome.state != "failed"
    return dict(record.get("failures", {"": unknown})), bool(record.get("results"))


class _Gathered:
    """What the page needs of all subjects, added up one by one."""

    def __init__(self, count: int):
        self.scalars = {name: np.full((count, 2), np.nan) for name in SCALARS}
        self.regions: dict[str, NDArray[np.float64]] = {}               # per side: number, sums and sums of squares
        self.remarks: dict[str, list[str]] = {}
        self.surfaces: dict[str, list[str]] = {}
        self.simulated = 0
        self.ways: Counter[str] = Counter()

    def add(self, i: int, subject: str, found: Found) -> None:
        for entry in found.entries:
            side = HEMIS.index(entry["hemi"])
            self.simulated += entry["origin"] == "simulation"
            for name, values in self.scalars.items():
                values[i, side] = _number(entry["measures"].get(name))
            told = [f"{entry['hemi']}: {entry['notes'][key]}" for key in WARNINGS if entry["notes"].get(key)]
            if told:
                self.remarks.setdefault(subject, []).extend(told)
        for row in found.regions:
            pair = np.array([_number(row[f"{kind}_thickness_mm"]) for kind in ("cortical", "gyral")])
            if np.isfinite(pair).all():
                sums = self.regions.setdefault(row["region"], np.zeros((2, 2, 3)))
                sums[HEMIS.index(row["hemi"])] += np.column_stack([np.ones(2), pair, pair**2])
        self.surfaces.setdefault(found.surfaces, []).append(subject)
        self.ways[found.way] += 1

    def group(self, subjects: tuple[str, ...], failures: list[dict[str, Any]], results: Mapping[str, Path]) -> Group:
        regions = {}
        for name, sums in sorted(self.regions.items()):
            number = sums[..., 0]
            with np.errstate(invalid="ignore"):
                mean = sums[..., 1] / number
                spread = np.sqrt(np.maximum(sums[..., 2] / number - mean**2, 0))
            regions[name] = np.stack([number, mean, spread], axis=-1)
        same = [names for key, names in self.surfaces.items() if key and len(names) > 1]
        ways = dict(sorted(self.ways.items()))
        return Group(subjects, self.scalars, regions, failures, self.remarks, dict(results), same, self.simulated, ways)


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)
