"""An analysis as one subject of a BIDS derivatives dataset: ``write_dataset`` writes it, ``read_subject`` reads it.

Names follow the derivatives of the Brain Imaging Data Structure (Gorgolewski and others, Sci. Data 3, 160044, 2016;
https://bids-specification.readthedocs.io): ``sub-NAME/anat/sub-NAME_hemi-L_desc-gyral_thickness.shape.gii``, each
with a JSON file that describes it. Files for which BIDS has no suffix end in ``_morph``. Of all these BIDS defines only
the regions (``_dseg.label.gii``). All others are in ``.bidsignore``; where fMRIPrep has similar files, their names are
the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from morphofold.analysis.measures import Measures
from morphofold.errors import NotReadable
from morphofold.forecasts.cost import WRITING_STAGE
from morphofold.io import atomic_file, atomic_folder
from morphofold.io.json_files import Record, read_json
from morphofold.provenance import printable, strict_json
from morphofold.quantities import column_words
from morphofold.results.bids_hemisphere import (
    MISSING_DESCRIPTION,
    in_bids_letters,
    moved_rows,
    read_hemisphere,
    write_hemisphere,
)
from morphofold.results.summary import (
    COLUMNS,
    REANALYSE_ADVICE,
    SCALAR_COLUMNS,
    DrawPage,
    Summary,
    checked_inputs,
    entries_of,
    read_tables,
    scalar_rows,
    summary_of,
    write_summary,
)
from morphofold.surface import Cortex
from morphofold.tables import write_table

if TYPE_CHECKING:
    from morphofold.timing import Stages

PROVENANCE_ENDING = "_desc-morphofold_provenance.json"
COST_ENDING = "_desc-morphofold_cost.json"
BIDSIGNORE_LINES = """\
*.html
figures
*.surf.gii
*.shape.gii
*_area.json
*_curv.json
*_sulc.json
*_thickness.json
*_mask.*
*_morph.*
*_provenance.json
*_cost.json
"""
README_TEXT = """\
# Cortical morphometry by morphofold

Surfaces, maps and tables of folded cortices. `sub-*/report.html` shows those of one subject. The `.json` beside a map
or table describes it; `*_provenance.json` gives its sources. Files that BIDS does not define are in `.bidsignore`.
"""
NAN_MEANING = f"{MISSING_DESCRIPTION}; n/a in tables"
COLUMN_LEVELS = {"hemi": {"lh": "left", "rh": "right"}}


def write_dataset(
    measures: Sequence[Measures],
    dataset: str | Path,
    name: str,
    *,
    failed: Mapping[str, str] | None = None,
    parameters: Mapping[str, Any] | None = None,
    report: DrawPage | Literal[False] = False,
    stages: Sequence[Cortex] = (),
    clock: Stages | None = None,
) -> Path:
    """Write an analysis as a subject of a BIDS derivatives dataset, completely or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    dataset : str or path
        Folder of the dataset: new, empty, or one that this function wrote; its other subjects stay.
    name : str
        Name of the subject; only its letters and digits are kept in BIDS. Results of an earlier run with this name are
        replaced.
    failed : mapping, optional
        As for ``write_analysis``.
    parameters : mapping, optional
        Recorded for the whole run.
    report : callable or False
        Draws report.html and figures/*.png: :func:`morphofold.report.analysis_report`, or a similar function.
    stages : sequence of Cortex
    clock : Stages, optional
        As for ``write_analysis``; the cost is in ``sub-NAME_desc-morphofold_cost.json``.

    Returns
    -------
    Path
        ``dataset/sub-NAME``.

    Raises
    ------
    ValueError
        As ``write_analysis``; or if ``name`` has no letters or digits.
    FileExistsError
        If morphofold did not write ``dataset`` or ``sub-NAME`` in it, or ``sub-NAME`` is a subject with another name
        that shortens to the same.

    Notes
    -----
    Surfaces, hinges and gyral graph are in scanner coordinates if the surfaces' footer gives the transform, as other
    BIDS software expects of GIFTI; otherwise they keep their coordinates. ``inflated`` never moves. ``curv`` has
    FreeSurfer's sign; other measured curvatures are positive where convex. ``desc-input`` maps came with the surfaces
    and are unchanged.
    """
    dataset = Path(dataset)
    place = subject_place(dataset, name)
    if clock is not None:
        clock.begin(WRITING_STAGE)
    records = checked_inputs(measures, place)
    with atomic_folder(place) as folder:
        anat = folder / "anat"
        anat.mkdir()
        for m in measures:
            write_hemisphere(m, anat, place.name)
        tables = {key: [row for m in measures for row in getattr(m, key)] for key in COLUMNS}
        tables["hinges"] = [row for m in measures for row in moved_rows(m.hinges, m.cortex.transform)]
        for key, columns in COLUMNS.items():
            _write_described_table(anat / f"{place.name}_desc-{key}_morph.tsv", columns, tables[key])
        _write_described_table(anat / f"{place.name}_desc-surfaces_morph.tsv", SCALAR_COLUMNS, scalar_rows(measures))
        content = {"subject": name, **summary_of(measures, records, parameters, failed or {}), "nan": NAN_MEANING}
        write_summary(
            measures,
            content,
            anat / f"{place.name}{PROVENANCE_ENDING}",
            page=folder / "report.html",
            cost=anat / f"{place.name}{COST_ENDING}",
            report=report,
            stages=stages,
            clock=clock,
        )
    _write_dataset_description(dataset)
    return place


def begin_dataset(dataset: Path, ignoring: Sequence[str] = ()) -> None:
    """Make a folder a dataset to which subjects can be written; names ``ignoring`` are added to ``.bidsignore``.

    Raises
    ------
    FileExistsError
        If it contains something else.
    """
    refuse_other_dataset(dataset)
    dataset.mkdir(parents=True, exist_ok=True)
    _write_dataset_description(dataset, ignoring)


def read_subject(folder: str | Path) -> list[Measures]:
    """Read one subject that ``write_dataset`` wrote, ``dataset/sub-NAME``.

    Surfaces, hinges and graph have their original coordinates, even if the files are in scanner coordinates; they and
    maps have the precision of float32. Of the footer of a FreeSurfer surface only the transform is left.

    Raises
    ------
    FileNotFoundError
        If a file of it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    anat = Path(folder) / "anat"
    found = sorted(anat.glob(f"sub-*{PROVENANCE_ENDING}"))
    if len(found) != 1:
        what = "holds no" if not found else "holds more than one"
        raise FileNotFoundError(
            f"{anat}: {what} sub-NAME{PROVENANCE_ENDING}. Name a folder DATASET/sub-NAME that `morphofold analyze "
            "--layout bids` wrote."
        )
    path, stem = found[0], found[0].name.removesuffix(PROVENANCE_ENDING)
    content = read_json(path, Summary, REANALYSE_ADVICE)
    tables = read_tables(content, {name: anat / f"{stem}_desc-{name}_morph.tsv" for name in COLUMNS})
    return [read_hemisphere(entry, tables, anat, stem) for entry in entries_of(content)]


def subject_place(dataset: Path, name: str) -> Path:
    """Folder in a dataset to which a subject of this name is written; raises as ``write_dataset``."""
    label = "".join(c for c in name.removeprefix("sub-") if c.isascii() and c.isalnum())
    if not label:
        raise NotReadable(f"{name!r}: BIDS names subjects by letters and digits, but this has none. Pass another name.")
    refuse_other_dataset(dataset)
    place = dataset / f"sub-{label}"
    known = _json_or_empty(place / "anat" / f"{place.name}{PROVENANCE_ENDING}").get("subject", name)
    if known != printable(name):
        raise FileExistsError(f"{place}: holds {known!r}, and {name!r} becomes the same BIDS name. Pass another name.")
    return place


def refuse_other_dataset(dataset: Path) -> None:
    """Raise ``FileExistsError`` if a folder contains anything but a dataset that morphofold wrote."""
    if dataset.exists() and not _is_our_dataset(dataset):  # checked first, because it is quick for any number of files
        names = sorted(p.name for p in dataset.iterdir() if not p.name.startswith(".")) if dataset.is_dir() else ["it"]
        if names:
            raise FileExistsError(
                f"{dataset}: is not a BIDS dataset whose dataset_description.json names morphofold. Name such a "
                "dataset, or a new folder."
            )


def _is_our_dataset(dataset: Path) -> bool:
    content = _json_or_empty(dataset / "dataset_description.json")
    makers = content.get("GeneratedBy")
    return isinstance(makers, list) and any(map(_is_morphofold, makers)) and content.get("DatasetType") == "derivative"


def _is_morphofold(maker: Any) -> bool:
    return isinstance(maker, dict) and maker.get("Name") == "morphofold"


def _json_or_empty(path: Path) -> dict[str, Any]:
    """Content of a JSON object; empty if it can't be read."""
    try:
        return read_json(path, Record, "")
    except (OSError, ValueError):
        return {}


def _write_dataset_description(dataset: Path, ignoring: Sequence[str] = ()) -> None:
    """Write the files that make a folder a dataset; in a dataset of an older version, bring them up to date."""
    import morphofold

    me = {"Name": "morphofold", "Version": morphofold.__version__}
    path = dataset / "dataset_description.json"
    if _is_our_dataset(dataset):
        content = _json_or_empty(path)
        content["GeneratedBy"] = [*(maker for maker in content["GeneratedBy"] if not _is_morphofold(maker)), me]
    else:
        content = {
            "Name": "Cortical morphometry by morphofold",
            "BIDSVersion": "1.11.1",
            "DatasetType": "derivative",
            "GeneratedBy": [me],
        }
        with atomic_file(dataset / "README.md") as file:
            file.write_text(README_TEXT, encoding="utf-8")
    ignored = dataset / ".bidsignore"
    there = ignored.read_text(encoding="utf-8").splitlines() if ignored.is_file() else []
    with atomic_file(ignored) as file:
        file.write_text(
            "\n".join([*dict.fromkeys([*there, *BIDSIGNORE_LINES.splitlines(), *ignoring]), ""]), encoding="utf-8"
        )
    with atomic_file(path) as file:
        file.write_text(strict_json(content), encoding="utf-8")


def _write_described_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table, and beside it the meaning of its columns."""
    write_table(path, columns, rows)
    content: dict[str, Any] = {}
    for key in dict.fromkeys([*columns, *(k for row in rows for k in row)]):
        label, unit = column_words(key)
        content[key] = {"Description": label, **({"Units": in_bids_letters(unit)} if unit else {})}
        content[key] |= {"Levels": COLUMN_LEVELS[key]} if key in COLUMN_LEVELS else {}
    path.with_suffix(".json").write_text(strict_json(content), encoding="utf-8")
