"""The two layouts of an analysis on disk: a table of paths for each; and the BIDS dataset, with its own files.

The plain layout is a folder shaped like a FreeSurfer subject (surf/, label/) with maps and tables beside, which other
tools open. The other is a subject of a BIDS derivatives dataset, whose names follow the Brain Imaging Data Structure
(Gorgolewski and others, Sci. Data 3, 160044, 2016; https://bids-specification.readthedocs.io):
``sub-NAME/anat/sub-NAME_hemi-L_desc-gyral_thickness.shape.gii``, each with a JSON file that describes it. Surfaces,
maps and tables have the names of its extension proposal 11 (https://github.com/bids-standard/bids-specification, pull
request 518), as fMRIPrep's have; what has no suffix there ends in ``_morph``. Of these files BIDS defines only the
regions (``_dseg.label.gii``), so that all others are in ``.bidsignore``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from morphofold import __version__
from morphofold.analysis.measures_result import COLUMNS, TEXT_COLUMNS
from morphofold.digests_and_json import Row, printable
from morphofold.errors import MissingPart, NotReadable
from morphofold.io.files import write_text
from morphofold.io.json_files import Record, file_word, read_json, write_json
from morphofold.quantities import column_words
from morphofold.tables import read_table, write_table

REANALYSE_ADVICE = "Analyze again."
PROVENANCE_ENDING = "_desc-morphofold_provenance.json"
PLAIN_PATHS = {
    "surface": "surf/{hemi}.{name}",
    "input_map": "surf/{hemi}.{name}",
    "regions": "label/{hemi}.{name}.annot",
    "mask": "label/{hemi}.cortex.label",
    "map": "maps/{hemi}.{name}.shape.gii",
    "freesurfer_map": "maps/{hemi}.{name}",
    "mgh_map": "maps/{hemi}.{name}.mgh",
    "graph": "graph/{hemi}.json",
    "stats": "stats/{name}",
    "table": "{name}.tsv",
    "summary": "summary.json",
    "cost": "cost.json",
}
BIDS_PATHS = {  # it has no MGH or FreeSurfer maps, and no stats
    "surface": "anat/{subject}_hemi-{side}_{name}.surf.gii",
    "input_map": "anat/{subject}_hemi-{side}_{ending}.shape.gii",
    "regions": "anat/{subject}_hemi-{side}_seg-{camel}_dseg.label.gii",
    "region_keys": "anat/{subject}_hemi-{side}_seg-{camel}_dseg.tsv",
    "mask": "anat/{subject}_hemi-{side}_desc-cortex_mask.label.gii",
    "map": "anat/{subject}_hemi-{side}_{ending}.shape.gii",
    "graph": "anat/{subject}_hemi-{side}_desc-graph_morph.json",
    "table": "anat/{subject}_desc-{name}_morph.tsv",
    "summary": f"anat/{{subject}}{PROVENANCE_ENDING}",
    "cost": "anat/{subject}_desc-morphofold_cost.json",
}
BIDS_SIDES = {"lh": "L", "rh": "R"}
#: maps that come with surfaces, their units
INPUT_MAP_UNITS = {"thickness": "mm", "curv": "1/mm", "sulc": "mm", "area": "mm^2"}
MAP_ENDINGS = {  # a map's name -> the end of its file's name in BIDS
    "H": "curv",
    **{name: f"desc-{name}_curv" for name in ("K", "k1", "k2", "curvedness")},
    "shape_index": "desc-shapeIndex_curv",
    "sulcal_depth": "desc-hull_sulc",
    "cortical_thickness": "thickness",
    "thickness_file": "desc-file_thickness",
    "gyral_thickness": "desc-gyral_thickness",
    "area": "area",
    **{f"input_{name}": f"desc-input_{name}" for name in INPUT_MAP_UNITS},
}
MISSING_DESCRIPTION = "NaN where there is no value, as on the medial wall"


@dataclass(frozen=True)
class Layout:
    """The files of an analysis in its folder; with a ``subject`` (``sub-NAME``) as in BIDS.

    A kind of file is a key of ``PLAIN_PATHS`` or ``BIDS_PATHS``. An ``input_map`` came with the surfaces.
    """

    folder: Path
    subject: str = ""

    @classmethod
    def of(cls, folder: Path) -> "Layout":
        """The layout of an analysis that was written; raises ``FileNotFoundError`` if BIDS files lack their subject."""
        anat = folder / "anat"
        if (folder / PLAIN_PATHS["summary"]).is_file() or not anat.is_dir():
            return cls(folder)
        summaries = sorted(anat.glob(f"sub-*{PROVENANCE_ENDING}"))
        if len(summaries) != 1:
            raise FileNotFoundError(
                f"{anat}: holds {'more than one' if summaries else 'no'} sub-NAME{PROVENANCE_ENDING}. Name a folder "
                "DATASET/sub-NAME that `morphofold analyze --layout bids` wrote."
            )
        return cls(folder, summaries[0].name.removesuffix(PROVENANCE_ENDING))

    @property
    def bids(self) -> bool:
        return bool(self.subject)

    def path(self, kind: str, hemi: str = "", name: str = "") -> Path:
        """Path of a file; raises ``NotReadable`` for a name that cannot be part of it."""
        return self.folder / (BIDS_PATHS if self.bids else PLAIN_PATHS)[kind].format(
            hemi=hemi,
            side=BIDS_SIDES.get(hemi),
            subject=self.subject,
            name=name and file_word(name),
            camel=_camel_case(name),
            ending=map_ending(kind, name),
        )

    def new(self, kind: str, hemi: str = "", name: str = "", sidecar: Row | None = None) -> Path:
        """Path of a file to write: its folder is made, and in BIDS the JSON file that describes it (``sidecar``)."""
        path = self.path(kind, hemi, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.bids and sidecar:
            write_json(path.with_name(f"{path.name.split('.')[0]}.json"), sidecar)
        return path

    def write_table(self, name: str, columns: Sequence[str], rows: Sequence[Row]) -> None:
        """Write a table, and in BIDS the meaning of its columns."""
        all_columns = dict.fromkeys([*columns, *(column for row in rows for column in row)])
        path = self.new("table", name=name, sidecar={column: _about_column(column) for column in all_columns})
        write_table(path, columns, rows)

    def read_table(self, name: str, n_rows: int) -> list[Row]:
        """Read a table that was written with this number of rows."""
        path, columns = self.path("table", name=name), COLUMNS[name]
        rows = read_table(path, TEXT_COLUMNS, n_rows, number_columns=set(columns) - TEXT_COLUMNS)
        if rows and (missing_columns := [column for column in columns if column not in rows[0]]):
            raise MissingPart(f"{path}: lacks the columns {', '.join(missing_columns)}. {REANALYSE_ADVICE}")
        return rows


def map_ending(kind: str, name: str) -> str:
    """End of the name of a map's file in BIDS: ``desc-hull_sulc``, or ``desc-input_sulc`` of an input map."""
    name = f"input_{name}" if kind == "input_map" else name
    return MAP_ENDINGS.get(name, f"desc-{_camel_case(name)}_morph")


def in_bids_letters(unit: str) -> str:
    """A unit as BIDS writes it."""
    return unit.replace("²", "^2").replace("³", "^3") or "1"


def _camel_case(name: str) -> str:
    """``shape_index`` as BIDS writes it: ``shapeIndex``."""
    first_word, *later_words = ("".join(c for c in word if c.isascii() and c.isalnum()) for word in name.split("_"))
    return first_word + "".join(word[:1].upper() + word[1:] for word in later_words)


def _about_column(column: str) -> Row:
    label, unit = column_words(column)
    sidecar: Row = {"Description": label, **({"Units": in_bids_letters(unit)} if unit else {})}
    return sidecar | ({"Levels": {"lh": "left", "rh": "right"}} if column == "hemi" else {})


# the dataset -----------------------------------------------------------------------------------------------

BIDSIGNORE_LINES = Path(__file__).with_name("bidsignore.txt").read_text("utf-8").splitlines()
README_TEXT = Path(__file__).with_name("dataset_readme.md").read_text("utf-8")
NEW_DESCRIPTION: Row = {
    "Name": "Cortical morphometry by morphofold",
    "BIDSVersion": "1.11.1",
    "DatasetType": "derivative",
    "GeneratedBy": [],
}


class _Description(Record):
    """``dataset_description.json`` of derivatives."""

    DatasetType: Literal["derivative"]
    GeneratedBy: list[Row]


def subject_place(dataset: Path, name: str) -> Path:
    """Folder in a dataset to which a subject of this name is written.

    Raises
    ------
    NotReadable
        If ``name`` has no letters or digits.
    FileExistsError
        If morphofold did not write ``dataset``, or the folder holds a subject with another name that shortens to the
        same.
    """
    label = "".join(char for char in name.removeprefix("sub-") if char.isascii() and char.isalnum())
    if not label:
        raise NotReadable(f"{name!r}: BIDS names subjects by letters and digits, but this has none. Pass another name.")
    refuse_other_dataset(dataset)
    folder = dataset / f"sub-{label}"
    owner = _json_or_empty(Layout(folder, folder.name).path("summary"), Record).get("subject", printable(name))
    if owner != printable(name):
        raise FileExistsError(f"{folder}: holds {owner!r}, and {name!r} becomes the same BIDS name. Pass another name.")
    return folder


def refuse_other_dataset(dataset: Path) -> None:
    """Raise ``FileExistsError`` if a folder contains anything but a dataset that morphofold wrote."""
    if not dataset.exists() or _our_description(dataset):  # read first, because it is quick for any number of files
        return
    if not dataset.is_dir() or any(not path.name.startswith(".") for path in dataset.iterdir()):
        raise FileExistsError(
            f"{dataset}: is not a BIDS dataset whose dataset_description.json names morphofold. Name such a dataset, "
            "or a new folder."
        )


def begin_dataset(dataset: Path, source: Path | None = None, ignored_lines: Sequence[str] = ()) -> None:
    """Write the files that make a folder a dataset, or bring those of an older version up to date.

    ``source`` is the dataset that it comes from: its licence holds, and its DOI is named. ``ignored_lines`` are further
    lines of ``.bidsignore``. :func:`refuse_other_dataset` is asked before.
    """
    dataset.mkdir(parents=True, exist_ok=True)
    description, bidsignore_file = _our_description(dataset), dataset / ".bidsignore"
    if not description:
        write_text(dataset / "README.md", README_TEXT)
    lines = bidsignore_file.read_text("utf-8").splitlines() if bidsignore_file.is_file() else []
    write_text(bidsignore_file, "\n".join([*dict.fromkeys([*lines, *BIDSIGNORE_LINES, *ignored_lines]), ""]))
    description = description or NEW_DESCRIPTION
    origin = _json_or_empty(source / "dataset_description.json", Record) if source else {}
    sources = {"SourceDatasets": [{"DOI": origin["DatasetDOI"]}]} if "DatasetDOI" in origin else {}
    description = {key: origin[key] for key in ("License",) if key in origin} | sources | description
    generators = [generator for generator in description["GeneratedBy"] if generator.get("Name") != "morphofold"]
    generators.append({"Name": "morphofold", "Version": __version__})
    write_json(dataset / "dataset_description.json", description | {"GeneratedBy": generators})


def _our_description(dataset: Path) -> Row:
    """The description of a dataset that morphofold wrote; empty for any other folder."""
    content = _json_or_empty(dataset / "dataset_description.json", _Description)
    return content if any(generator.get("Name") == "morphofold" for generator in content.get("GeneratedBy", [])) else {}


def _json_or_empty(path: Path, schema: type[Record]) -> Row:
    """Content of a JSON object; empty if it can't be read."""
    try:
        return read_json(path, schema, "")
    except (OSError, ValueError):
        return {}
