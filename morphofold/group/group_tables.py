"""The group of a cohort: tidy tables and the data of its page, from the results of its subjects on disk; and which
hemispheres may be pooled: for each measure, those measured with the same settings."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow.parquet import ParquetWriter

from morphofold.analysis.measures_result import (
    COLUMNS,
    FREESURFER_VALUES,
    PARAMETERS,
    PARAMETERS_OF_SCALAR,
    SCALARS,
    SURFACE_COLUMNS,
    verdict_columns,
)
from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array, Bools, Ints
from morphofold.group.change_per_year import CHANGE_COLUMNS, changes, scan_years
from morphofold.group.subjects import NO_COVARIATES, Covariates
from morphofold.group.task_records import read_record
from morphofold.io import atomic_folder
from morphofold.io.json_files import read_json
from morphofold.io.layouts import HEMIS
from morphofold.note_texts import WARNINGS
from morphofold.number_texts import in_one_line
from morphofold.progress_callbacks import Progress, logged, part_of
from morphofold.results.analysis_files import Summary
from morphofold.results.layouts import REANALYSE_ADVICE, Layout
from morphofold.tables import line, write_table

SETTING_NAMES = ("morphofold", *PARAMETERS)  # the version, and all parameters that a measure may depend on
LEAST_POOLED_SHARE = 0.5  # hemispheres are pooled if more than this share has the same settings
SETTING_LABELS = {
    "morphofold": "version of morphofold",
    "folding_scale_mm": "scale of the folding indices [mm]",
    "folding_index_surface": "surface of the folding indices",
    "graph_width_mm": "crown width, the scale of the net [mm]",
    "cortical_thickness_cap_mm": "bound on cortical thickness [mm]",
    "cortex_mask": "cortex marked by",
    "accuracy": "accuracy",
    "annotation": "parcellation",
}
#: options that give a group one value: the coarsest scale, which suits all meshes, and the median width
COMMON_VALUE_OPTIONS: Mapping[str, tuple[str, Any]] = {
    "folding_scale_mm": ("--curvature-scale", np.max),
    "graph_width_mm": ("--gyral-width", np.median),
}


@dataclass(frozen=True)
class Pooling:
    """What is pooled in a group.

    Attributes
    ----------
    value_counts : mapping of parameter to Counter
        Number of hemispheres by value, for each parameter that differs; empty if all were measured with the same
        settings.
    poolable : mapping of measure to (subjects, 2) bool
        Which values may be pooled; measures without an entry may be pooled completely.
    left_out : mapping of measure to (int, int)
        Number of values not pooled, and of all values; measures that are pooled completely have no entry.
    """

    value_counts: Mapping[str, Counter[Any]] = field(default_factory=dict)
    poolable: Mapping[str, Bools] = field(default_factory=dict)
    left_out: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def pooled(self, measure: str, values: Array) -> Array:
        """Values (subjects, 2) of a measure, NaN where they may not be pooled."""
        return np.where(self.poolable[measure], values, np.nan) if measure in self.poolable else values

    @property
    def sentences(self) -> list[str]:
        """Sentences: what differs, and the options to measure the whole group with the same settings."""
        if not self.value_counts:
            return []
        options = [
            f"{option_name} {statistic(values):.3g}"
            for key, (option_name, statistic) in COMMON_VALUE_OPTIONS.items()
            if (values := [value for value in self.value_counts.get(key, Counter()).elements() if value is not None])
        ]
        advice_texts = [f"To measure all in the same way, run it again with {' '.join(options)}."] if options else []
        differing_text = ", ".join(SETTING_LABELS[key] for key in self.value_counts)
        return [f"Hemispheres were not measured in the same way: they differ in {differing_text}.", *advice_texts]


def pooling(settings: pd.DataFrame, scalars: Mapping[str, Array]) -> Pooling:
    """What may be pooled of measures (subjects, 2); ``settings`` have a row for each value, empty without hemisphere.

    For each measure, only the parameters that it depends on count. Values with the most common settings are pooled, if
    they are more than half of all values; otherwise none are.
    """
    poolable, left_out = {}, {}
    columns = settings.dropna(subset="morphofold")[[*SETTING_NAMES]].items()
    value_counts = {str(key): Counter(column) for key, column in columns if column.nunique(dropna=False) > 1}
    for name, values in scalars.items():
        is_measured = np.isfinite(values)
        is_pooled = measured_alike(settings, PARAMETERS_OF_SCALAR.get(name, PARAMETERS), is_measured)
        n_values, n_pooled = int(is_measured.sum()), int(is_pooled.sum())
        if n_pooled < n_values:
            poolable[name], left_out[name] = is_pooled, (n_values - n_pooled, n_values)
    return Pooling(value_counts, poolable, left_out)


def measured_alike(settings: pd.DataFrame, parameters: Sequence[str], is_measured: Bools) -> Bools:
    """Which of the measured values (subjects, 2) are by the version and the parameters that most are by; none if
    half or fewer are."""
    kinds = settings.groupby(["morphofold", *parameters], dropna=False).ngroup().to_numpy().reshape(is_measured.shape)
    kind_counts = np.bincount(kinds[is_measured], minlength=1)
    return is_measured & (kinds == kind_counts.argmax()) & (kind_counts.max() > LEAST_POOLED_SHARE * is_measured.sum())


GROUP_FOLDER = "group"
WHOLE_HEMISPHERE = "hemisphere"  # in the column ``region``, for values of a whole hemisphere
REGION_MEASURES = tuple(name for name in COLUMNS["regions"] if name not in ("hemi", "region"))
TIDY_COLUMNS = {"subject": str, "hemi": str, "region": str, "measure": str, "value": float}
REGION_THICKNESS_SETTINGS = tuple(key for key in PARAMETERS if "scale" not in key and key != "graph_width_mm")
#: how each was measured, and FreeSurfer's values for it
HEMISPHERE_COLUMNS = ("subject", "hemi", *SETTING_NAMES, *FREESURFER_VALUES)
FAILURE_COLUMNS = ("subject", "hemi", "reason", "log")
#: names that no covariate may have
TAKEN_COLUMNS = {*HEMISPHERE_COLUMNS, *SURFACE_COLUMNS, *FAILURE_COLUMNS, *HEMIS}
THICKNESSES_OF = itemgetter("region", "cortical_thickness_mm", "gyral_thickness_mm")  # of a region, for the page
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
    result_folders : mapping of subject to path
        Folders of results.
    same_surfaces : list of lists of str
        Subjects with the same surfaces under several names.
    n_simulated : int
        Number of simulated hemispheres; these have no side and are counted on the side that their files name.
    pooling : Pooling
        Which values are of hemispheres measured in the same way, and may be pooled.
    hemisphere_rows : list of dict
        Numbers of each hemisphere, and how it was measured, for the methods paragraph.
    """

    subjects: tuple[str, ...]
    scalars: Mapping[str, Array]
    regions: Mapping[str, Array]
    failures: list[Row]
    remarks: Mapping[str, list[str]]
    result_folders: Mapping[str, Path]
    same_surfaces: list[list[str]] = field(default_factory=list)
    n_simulated: int = 0
    pooling: Pooling = field(default_factory=Pooling)
    hemisphere_rows: list[Row] = field(default_factory=list)
    persons: tuple[str, ...] = ()

    @cached_property
    def person_numbers(self) -> tuple[tuple[str, ...], Ints]:
        """Names of the persons (P,), and the number of the person of each subject (S,)."""
        person_names, subject_person = np.unique(self.persons or self.subjects, return_inverse=True)
        return tuple(person_names.tolist()), subject_person

    @property
    def persons_words(self) -> str:
        """Sentence on how persons count, if some have several sessions."""
        n_people = len(self.person_numbers[0])
        if n_people == len(self.subjects):
            return ""
        counts_text = f"{len(self.subjects)} scans of {n_people} persons: each person counts once, with the mean"
        return f"{counts_text} of the scans; change.tsv has the change per year where acq_time or age differs."

    @property
    def remarks_on_group(self) -> list[str]:
        return [*filter(None, [self.persons_words]), *self.pooling.sentences]

    @property
    def n_measured(self) -> int:
        """Number of subjects that have at least one value."""
        return int(np.any([np.isfinite(values).any(axis=1) for values in self.scalars.values()], axis=0).sum())


def read_results(folder: Path) -> list[Row]:
    """Read the numbers of a subject, without its surfaces and maps, in either layout.

    Returns
    -------
    list of dict
        For each hemisphere its measures, settings and values of FreeSurfer, ``notes``, ``regions`` (rows of their
        table) and ``surfaces``, the digests of all surfaces of the subject.

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
    region_rows = layout.read_table("regions", summary["rows"].get("regions"))
    sha_by_file = {Path(row["path"]).name: row["sha256"] for row in summary["inputs"]}
    surface_digests = " ".join(
        sorted(f"{file} {sha}" for file, sha in sha_by_file.items() if "white" in file or "pial" in file)
    )
    hemispheres = []
    for entry in summary["surfaces"]:
        row = dict.fromkeys((*HEMISPHERE_COLUMNS, *SURFACE_COLUMNS, "annotation_from"))
        row |= entry["info"] | entry["parameters"] | entry["measures"] | {"morphofold": summary["morphofold"]}
        row |= {key: entry[key] for key in ("hemi", "origin", "annotation", "notes")} | {"surfaces": surface_digests}
        row |= verdict_columns(entry["notes"])
        row |= {key: float(f"{row[key]:.6g}") for key in SETTING_NAMES if isinstance(row[key], int | float)}
        hemispheres.append(row | {"regions": [region for region in region_rows if region["hemi"] == entry["hemi"]]})
    return hemispheres


def write_measures(folder: Path, column_types: Mapping[str, type], batches: Iterable[Sequence[Sequence[Any]]]) -> None:
    """Write measures.tsv and measures.parquet, one batch of rows at a time.

    ``column_types`` are ``str``, ``int`` or ``float``, as in Parquet; text is stored once, in a dictionary.
    """
    arrow_types = {str: pa.dictionary(pa.int32(), pa.string()), int: pa.int64(), float: pa.float64()}
    schema = pa.schema([(name, arrow_types[column_type]) for name, column_type in column_types.items()])
    tsv_file = (folder / "measures.tsv").open("w", encoding="utf-8", errors="backslashreplace", newline="")
    with tsv_file, ParquetWriter(folder / "measures.parquet", schema, compression="zstd") as parquet_file:
        tsv_file.write(line(column_types))
        for batch in filter(None, batches):
            tsv_file.writelines(map(line, batch))
            column_values = {
                name: [None if value is None else column_type(value) for value in values]
                for (name, column_type), values in zip(column_types.items(), zip(*batch))
            }
            parquet_file.write_table(pa.Table.from_pydict(column_values, schema=schema))


def write_group(
    out: Path,
    result_folders: Mapping[str, Path],
    *,
    report: Callable[[Group, Path, Progress], object] | Literal[False] = False,
    progress: Progress = logged,
    covariates: Covariates = NO_COVARIATES,
) -> Group:
    """Write ``out/group`` completely or not at all: measures.tsv, measures.parquet, surfaces.tsv, hemispheres.tsv and
    failures.tsv, of persons with several scans change.tsv, and report.html if ``report`` is given.

    Parameters
    ----------
    out : Path
        Folder of the cohort, with its records.
    result_folders : mapping of subject to path
        Folder of the results of each, whether it exists or not.
    report : callable or False
        Draws the page of a group into a folder: :func:`morphofold.group_pages.cohort_page.group_report`.
    progress : callable
        Called with the share done and the current step.
    covariates : Covariates
        Columns after the subject in all tables but measures.tsv, which has many rows for each.
    """
    subjects = tuple(sorted(result_folders, key=lambda subject: (covariates.person(subject), subject)))
    hemispheres: list[Row] = []
    failures: list[Row] = []

    def batches() -> Iterator[list[Any]]:
        for first in range(0, len(subjects), SUBJECTS_PER_BATCH):
            progress(0.7 * first / len(subjects), "tables")
            tidy_rows: list[Any] = []
            for subject in subjects[first : first + SUBJECTS_PER_BATCH]:
                rows, failure_rows = _read_subject(out, subject, result_folders[subject])
                tidy_rows += _tidy_rows(rows)
                for row in rows:
                    row["regions"] = [*map(THICKNESSES_OF, row["regions"])]
                hemispheres.extend(rows)
                failures.extend(failure_rows)
            yield tidy_rows

    with atomic_folder(out / GROUP_FOLDER) as folder:
        write_measures(folder, TIDY_COLUMNS, batches())
        for name, columns, rows in (
            ("failures", FAILURE_COLUMNS, failures),
            ("hemispheres", HEMISPHERE_COLUMNS, hemispheres),
            ("surfaces", ("subject", "hemi", *SURFACE_COLUMNS), hemispheres),
        ):
            table_rows = [{**covariates.of(row["subject"]), **{key: row[key] for key in columns}} for row in rows]
            write_table(folder / f"{name}.tsv", (columns[0], *covariates.columns, *columns[1:]), table_rows)
        group = _group(dict(zip(subjects, map(covariates.person, subjects))), hemispheres, failures, result_folders)
        person_names, person = group.person_numbers
        if len(person_names) < len(subjects):
            pooled = {name: group.pooling.pooled(name, values) for name, values in group.scalars.items()}
            years = scan_years([covariates.of(subject) for subject in subjects], person)
            write_table(folder / "change.tsv", CHANGE_COLUMNS, changes(person_names, person, years, pooled))
        if report:
            report(group, folder, part_of(progress, 0.7, 0.3))
    progress(1.0, "done")
    return group


def _read_subject(out: Path, subject: str, folder: Path) -> tuple[list[Row], list[Row]]:
    """Rows of the hemispheres of a subject that have results, and of its failures."""
    record, hemispheres = read_record(out / "records" / f"{subject}.json"), list[Row]()
    failures = record.get("failures", {"": "not measured yet. Run the cohort again."})
    if record.get("results"):
        try:
            hemispheres = read_results(folder)
        except (OSError, ValueError) as error:
            failures[""] = f"{in_one_line(error)} Run the cohort again."
    reasons = sorted(failures.items())
    rows = [dict(zip(FAILURE_COLUMNS, (subject, hemi or None, why, f"logs/{subject}.log"))) for hemi, why in reasons]
    return [{**row, "subject": subject} for row in hemispheres], rows


def _tidy_rows(hemispheres: Sequence[Row]) -> list[Any]:
    """One row for each number of a subject, in the order of its tables."""
    whole = [(row["subject"], row["hemi"], WHOLE_HEMISPHERE, key, row[key]) for row in hemispheres for key in SCALARS]
    region_pairs = [(row["subject"], region) for row in hemispheres for region in row["regions"]]
    return whole + [
        (subject, row["hemi"], row["region"], key, row[key]) for subject, row in region_pairs for key in REGION_MEASURES
    ]


def _group(
    persons: Mapping[str, str], hemispheres: list[Row], failures: list[Row], result_folders: Mapping[str, Path]
) -> Group:
    key_names = ["subject", "hemi"]
    side_index = pd.MultiIndex.from_product([list(persons), HEMIS], names=key_names)
    columns = [*key_names, "surfaces", *SETTING_NAMES, *SCALARS]
    hemisphere_table = pd.DataFrame(hemispheres, columns=columns, dtype=object).set_index(key_names).reindex(side_index)
    scalars = {name: hemisphere_table[name].to_numpy(dtype=float).reshape(-1, 2) for name in SCALARS}
    region_rows = [(row["subject"], row["hemi"], *region) for row in hemispheres for region in row["regions"]]
    region_table = pd.DataFrame(region_rows, columns=[*key_names, "region", "cortical", "gyral"]).set_index(key_names)
    region_table = region_table.astype({"cortical": float, "gyral": float})
    is_comparable = measured_alike(hemisphere_table, REGION_THICKNESS_SETTINGS, side_index.isin(region_table.index))
    remarks: dict[str, list[str]] = defaultdict(list)
    surface_groups = hemisphere_table.reset_index("subject").groupby("surfaces", sort=False)["subject"].unique()
    for row in hemispheres:
        if row_warnings := [f"{row['hemi']}: {row['notes'][key]}" for key in WARNINGS if row["notes"].get(key)]:
            remarks[row["subject"]] += row_warnings
    return Group(
        tuple(persons),
        scalars,
        _region_statistics(region_table[region_table.index.isin(side_index[is_comparable])].dropna(), persons),
        failures,
        remarks,
        dict(result_folders),
        [list(subjects) for digests, subjects in surface_groups.items() if digests and len(subjects) > 1],
        sum(row["origin"] == "simulation" for row in hemispheres),
        pooling(hemisphere_table, scalars),
        hemispheres,
        tuple(persons.values()),
    )


def _region_statistics(thicknesses: pd.DataFrame, persons: Mapping[str, str]) -> dict[str, Array]:
    """Number, mean and deviation over persons of cortical and gyral thickness of regions, by their sides."""
    person_of_row = thicknesses.index.get_level_values("subject").map(persons)
    person_means = thicknesses.groupby(["region", "hemi", person_of_row]).mean()
    statistics: dict[str, Array] = {}
    for (region, hemi), means in person_means.groupby(["region", "hemi"]):
        side_numbers = statistics.setdefault(str(region), np.tile([0, np.nan, np.nan], (2, 2, 1)))
        side_numbers[HEMIS.index(hemi)] = np.column_stack([means.count(), means.mean(), means.std(ddof=0)])
    return statistics
