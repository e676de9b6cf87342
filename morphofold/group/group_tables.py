"""Tables of a group: tidy text and Parquet from the results of its subjects, read one after the other."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.frames import FREESURFER_VALUES, TEXT_COLUMNS
from morphofold.analysis.measures import PARAMETERS, SCALARS
from morphofold.errors import DamagedFile, Mismatch
from morphofold.group.covariates import NO_COVARIATES, Covariates
from morphofold.group.pooling import SETTING_NAMES, MeasuringSettings, Pooling, commonest, pooling, settings_among
from morphofold.group.tasks import Outcome, read_record
from morphofold.io import files_of
from morphofold.io.json_files import read_json
from morphofold.mesh_quality.defects import WARNINGS
from morphofold.provenance import changed_since
from morphofold.results import COLUMNS
from morphofold.results.analyses import Summary
from morphofold.results.layouts import PROVENANCE_ENDING, REANALYSE_ADVICE
from morphofold.tables import line, read_table, write_table
from morphofold.words import in_one_line

HEMIS = ("lh", "rh")
WHOLE_HEMISPHERE = "hemisphere"  # in the column ``region``, for values of a whole hemisphere
REGION_MEASURES = tuple(name for name in COLUMNS["regions"] if name not in ("hemi", "region"))
TIDY_COLUMNS = ("subject", "hemi", "region", "measure", "value")
REGION_THICKNESS_SETTINGS = tuple(key for key in PARAMETERS if "scale" not in key and key != "graph_width_mm")
#: how each was measured, and FreeSurfer's values for it
HEMISPHERE_COLUMNS = ("subject", "hemi", *SETTING_NAMES, *FREESURFER_VALUES)
SURFACE_COLUMNS = ("subject", "hemi", *SCALARS, *FREESURFER_VALUES)
FAILURE_COLUMNS = ("subject", "hemi", "reason", "log")
#: names that no covariate may have
TAKEN_COLUMNS = {*HEMISPHERE_COLUMNS, *SURFACE_COLUMNS, *FAILURE_COLUMNS, *HEMIS}
SUBJECTS_PER_BATCH = 200  # subjects whose rows are in memory at once

TidyRow = tuple[str, str, str, str, float | None]


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
        How each hemisphere was measured, for the methods paragraph.
    """

    subjects: tuple[str, ...]
    scalars: Mapping[str, NDArray[np.float64]]
    regions: Mapping[str, NDArray[np.float64]]
    failures: list[dict[str, Any]]
    remarks: Mapping[str, list[str]]
    results: Mapping[str, Path]
    same: list[list[str]] = field(default_factory=list)
    simulated: int = 0
    pooling: Pooling = field(default_factory=Pooling)
    settings: list[dict[str, Any]] = field(default_factory=list)
    persons: tuple[str, ...] = ()

    @cached_property
    def person_numbers(self) -> tuple[tuple[str, ...], NDArray[np.int64]]:
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


@dataclass(frozen=True)
class SubjectResults:
    """Results of one subject: an entry for each hemisphere, how each was measured, rows of regions, digests of its
    surfaces, and the files that were read."""

    entries: list[dict[str, Any]]
    hows: list[MeasuringSettings]
    regions: list[dict[str, Any]]
    surfaces: str
    read: tuple[Path, ...]


def read_results(folder: Path) -> SubjectResults:
    """Read the numbers of a subject, without its surfaces and maps, in either layout.

    Raises
    ------
    FileNotFoundError, ValueError
        If they are missing or damaged.
    """
    path, table = folder / "summary.json", folder / "regions.tsv"
    if not path.is_file():
        path = folder / "anat" / f"{folder.name}{PROVENANCE_ENDING}"
        table = folder / "anat" / f"{folder.name}_desc-regions_morph.tsv"
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: holds no results.")
    content = read_json(path, Summary, REANALYSE_ADVICE)
    surfaces = {Path(row["path"]).name: row["sha256"] for row in content["inputs"]}
    wanted = sorted(f"{name} {sha}" for name, sha in surfaces.items() if "white" in name or "pial" in name)
    keys = ("hemi", "origin", "measures", "notes", "info", "parameters", "annotation")
    entries = [{key: entry[key] for key in keys} for entry in content["surfaces"]]
    hows = [_settings_of_hemisphere(content["morphofold"], entry) for entry in content["surfaces"]]
    regions = read_table(table, TEXT_COLUMNS, content["rows"].get("regions"), numbers=REGION_MEASURES)
    there = {entry["hemi"] for entry in entries}
    for number, row in enumerate(regions, start=2):
        named = row.get("hemi") in there and isinstance(row.get("region"), str)
        if not (named and row.keys() >= {*REGION_MEASURES}):
            raise DamagedFile(f"{table}: line {number} lacks a hemisphere, a region or a measure. {REANALYSE_ADVICE}")
    return SubjectResults(entries, hows, regions, " ".join(wanted), (path, table))


def _settings_of_hemisphere(version: str, entry: Mapping[str, Any]) -> MeasuringSettings:
    """Settings of a hemisphere, in the order of SETTING_NAMES."""
    how = (version, *({**entry["parameters"], "annotation": entry["annotation"]}.get(key) for key in PARAMETERS))
    return tuple(float(f"{x:.6g}") if isinstance(x, int | float) else x for x in how)


def refuse_changed(record: Mapping[str, Any], files: Mapping[str, Path]) -> None:
    """Raise ``Mismatch`` if files differ from those in the record of a task."""
    known = {name: digest for name, digest in record.get("files", {}).items() if name in files}
    if changed := changed_since(known, files):
        raise Mismatch(f"{', '.join(str(files[name]) for name in changed)}: changed since it was written.")


def tidy_rows(subject: str, found: SubjectResults) -> Iterator[TidyRow]:
    """One row for each number of a subject, in the order of its tables."""
    for entry in found.entries:
        for measure in SCALARS:
            yield subject, entry["hemi"], WHOLE_HEMISPHERE, measure, entry["measures"].get(measure)
    for row in found.regions:
        for measure in REGION_MEASURES:
            yield subject, row["hemi"], row["region"], measure, row[measure]


class TidyWriter:
    """Writes measures.tsv and measures.parquet, one batch of rows at a time.

    ``columns`` are ``str``, ``int`` or ``float``, as in Parquet; text is stored once, in a dictionary.
    """

    def __init__(self, folder: Path, columns: Mapping[str, type]):
        import pyarrow as pa
        from pyarrow import parquet

        kinds = {str: pa.dictionary(pa.int32(), pa.string()), int: pa.int64(), float: pa.float64()}
        self._columns = columns
        self._schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
        self._table = pa.Table
        self._parquet = parquet.ParquetWriter(folder / "measures.parquet", self._schema, compression="zstd")
        self._file: IO[str] = (folder / "measures.tsv").open(
            "w", encoding="utf-8", errors="backslashreplace", newline=""
        )
        self._file.write(line(columns))

    def write(self, rows: Sequence[Sequence[Any]]) -> None:
        if not rows:
            return
        self._file.writelines(map(line, rows))
        values = {
            name: [None if x is None else kind(x) for x in column]
            for (name, kind), column in zip(self._columns.items(), zip(*rows))
        }
        self._parquet.write_table(self._table.from_pydict(values, schema=self._schema))

    def close(self) -> None:
        self._parquet.close()
        self._file.close()


def write_tables(
    folder: Path,
    out: Path,
    results: Mapping[str, Path],
    outcomes: Mapping[str, Outcome] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    covariates: Covariates = NO_COVARIATES,
) -> Group:
    """Write measures.tsv, measures.parquet, surfaces.tsv, hemispheres.tsv and failures.tsv of a group.

    Parameters
    ----------
    folder : Path
        Folder to write into.
    out : Path
        Folder of the cohort, with its records.
    results : mapping of subject to path
        Folder of the results of each, whether it exists or not.
    outcomes : mapping of subject to Outcome
        Outcomes of subjects measured in this run; for others, the records are used.
    progress : callable
        Called with the share done.
    covariates : Covariates
        Columns after the subject in all tables but measures.tsv, which has many rows for each.
    """
    gathered = _GroupCollector(len(results))
    failures: list[dict[str, Any]] = []
    rows: list[TidyRow] = []
    subjects = sorted(results, key=lambda subject: (covariates.person(subject), subject))
    with closing(TidyWriter(folder, {**dict.fromkeys(TIDY_COLUMNS[:-1], str), TIDY_COLUMNS[-1]: float})) as writer:
        for i, subject in enumerate(subjects):
            place = results[subject]
            record = read_record(out / "records" / f"{subject}.json")
            outcome = None if outcomes is None else outcomes.get(subject)
            missing, there = what_became(record, outcome, "not measured yet. Run the cohort again.")
            if there:
                try:
                    found = read_results(place)
                    refuse_changed(record, {name: path for name, path in files_of(place).items() if path in found.read})
                except (OSError, ValueError) as error:
                    missing[""] = f"{in_one_line(error)} Run the cohort again."
                else:
                    rows += tidy_rows(subject, found)
                    gathered.add(i, subject, found, covariates.person(subject))
            failures += [
                {"subject": subject, "hemi": hemi or None, "reason": why, "log": f"logs/{subject}.log"}
                for hemi, why in sorted(missing.items())
            ]
            if i % SUBJECTS_PER_BATCH == SUBJECTS_PER_BATCH - 1:
                writer.write(rows)
                rows.clear()
                progress(i / len(results))
        writer.write(rows)
    for name, columns, lines in (
        ("failures", FAILURE_COLUMNS, failures),
        ("hemispheres", HEMISPHERE_COLUMNS, gathered.hemispheres),
        ("surfaces", SURFACE_COLUMNS, gathered.scalar_rows),
    ):
        known = [{**covariates.of(row["subject"]), **row} for row in lines]
        write_table(folder / f"{name}.tsv", (columns[0], *covariates.columns, *columns[1:]), known)
    persons = tuple(map(covariates.person, subjects))
    return gathered.group(tuple(subjects), persons, failures, results)


def what_became(record: Mapping[str, Any], outcome: Outcome | None, unknown: str) -> tuple[dict[str, str], bool]:
    """Failures of a task and whether it has results: from its outcome in this run, else from its record."""
    if outcome is not None:
        return dict(outcome.failures), outcome.state != "failed"
    return dict(record.get("failures", {"": unknown})), bool(record.get("results"))


class _GroupCollector:
    """Collects what the page needs, subject by subject."""

    def __init__(self, count: int):
        self.scalars = {name: np.full((count, 2), np.nan) for name in SCALARS}
        #: by settings of thickness, for each region and side: number, sums and sums of squares
        self.regions: dict[MeasuringSettings, dict[str, NDArray[np.float64]]] = defaultdict(
            lambda: defaultdict(_zero_sums)
        )
        #: of the present person: cortical and gyral thickness of each session, by settings, region and side
        self.pairs: dict[tuple[MeasuringSettings, str, int], list[NDArray[np.float64]]] = defaultdict(list)
        self.person = ""
        self.counts: Counter[MeasuringSettings] = Counter()  # hemispheres with regions, by the same settings
        self.remarks: dict[str, list[str]] = {}
        self.surfaces: dict[str, list[str]] = {}
        self.simulated = 0
        self.hows: dict[MeasuringSettings, int] = {}
        self.how = np.full((count, 2), -1)
        self.hemispheres: list[dict[str, Any]] = []
        self.scalar_rows: list[dict[str, Any]] = []
        self.settings: list[dict[str, Any]] = []

    def add(self, i: int, subject: str, found: SubjectResults, person: str) -> None:
        if person != self.person:
            self._add_regions()
            self.person = person
        of = {}
        for entry, how in zip(found.entries, found.hows):
            side = HEMIS.index(entry["hemi"])
            self.simulated += entry["origin"] == "simulation"
            for name, values in self.scalars.items():
                values[i, side] = _float_or_nan(entry["measures"].get(name))
            self.how[i, side] = self.hows.setdefault(how, len(self.hows))
            of[entry["hemi"]] = settings_among(how, REGION_THICKNESS_SETTINGS)
            used = {"n_vertices": entry["measures"].get("n_vertices"), **entry["parameters"]}
            used |= {"origin": entry["origin"], "annotation": entry["annotation"]}
            self.settings.append({**used, "annotation_from": entry["info"].get("annotation_from")})
            recorded = {key: entry["info"].get(key) for key in FREESURFER_VALUES}
            who = {"subject": subject, "hemi": entry["hemi"]}
            self.hemispheres.append({**who, **dict(zip(SETTING_NAMES, how)), **recorded})
            self.scalar_rows.append({**who, **{name: entry["measures"].get(name) for name in SCALARS}, **recorded})
            texts = [f"{entry['hemi']}: {entry['notes'][key]}" for key in WARNINGS if entry["notes"].get(key)]
            if texts:
                self.remarks.setdefault(subject, []).extend(texts)
        self.counts.update(of[hemi] for hemi in dict.fromkeys(row["hemi"] for row in found.regions))
        for row in found.regions:
            pair = np.array([_float_or_nan(row[f"{kind}_thickness_mm"]) for kind in ("cortical", "gyral")])
            if np.isfinite(pair).all():
                self.pairs[of[row["hemi"]], row["region"], HEMIS.index(row["hemi"])].append(pair)
        self.surfaces.setdefault(found.surfaces, []).append(subject)

    def _add_regions(self) -> None:
        """Add the means of the sessions of a person to the sums."""
        for (how, region, side), pairs in self.pairs.items():
            mean = np.mean(pairs, axis=0)
            self.regions[how][region][side] += np.column_stack([np.ones(2), mean, mean**2])
        self.pairs.clear()

    def group(
        self,
        subjects: tuple[str, ...],
        persons: tuple[str, ...],
        failures: list[dict[str, Any]],
        results: Mapping[str, Path],
    ) -> Group:
        self._add_regions()
        regions, how = {}, commonest(self.counts)
        for name, sums in sorted(self.regions[how].items() if how else ()):
            number = sums[..., 0]
            with np.errstate(invalid="ignore"):
                mean = sums[..., 1] / number
                spread = np.sqrt(np.maximum(sums[..., 2] / number - mean**2, 0))
            regions[name] = np.stack([number, mean, spread], axis=-1)
        same = [names for key, names in self.surfaces.items() if key and len(names) > 1]
        pooled = pooling(tuple(self.hows), self.how, self.scalars)
        found = (self.scalars, regions, failures, self.remarks, dict(results), same, self.simulated, pooled)
        return Group(subjects, *found, self.settings, persons)


def _zero_sums() -> NDArray[np.float64]:
    return np.zeros((2, 2, 3))


def _float_or_nan(value: Any) -> float:
    return np.nan if value is None else float(value)
