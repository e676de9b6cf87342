"""The two layouts of an analysis on disk: a table of paths for each, and the tables of an analysis in either.

The plain layout is a folder shaped like a FreeSurfer subject (surf/, label/) with maps and tables beside, which other
tools open. The other is a subject of a BIDS derivatives dataset, whose names follow the Brain Imaging Data Structure
(Gorgolewski and others, Sci. Data 3, 160044, 2016; https://bids-specification.readthedocs.io):
``sub-NAME/anat/sub-NAME_hemi-L_desc-gyral_thickness.shape.gii``, each with a JSON file that describes it. Files for
which BIDS has no suffix end in ``_morph``; where fMRIPrep has similar files, their names are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from morphofold.analysis.frames import COLUMNS, TEXT_COLUMNS
from morphofold.errors import MissingPart
from morphofold.io.json_files import file_word
from morphofold.provenance import strict_json
from morphofold.quantities import column_words
from morphofold.results.summary import REANALYSE_ADVICE
from morphofold.tables import read_table, write_table

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
    "cortical_thickness": "thickness",
    "gyral_thickness": "desc-gyral_thickness",
    "area": "area",
    **{f"input_{name}": f"desc-input_{name}" for name in INPUT_MAP_UNITS},
}
MISSING_DESCRIPTION = "NaN where there is no value, as on the medial wall"
HEMISPHERE_LEVELS = {"lh": "left", "rh": "right"}


@dataclass(frozen=True)
class Layout:
    """The files of an analysis in its folder; with a ``subject`` (``sub-NAME``) as in BIDS."""

    folder: Path
    subject: str = ""

    @classmethod
    def of(cls, folder: Path) -> Layout:
        """The layout of an analysis that was written; raises ``FileNotFoundError`` if BIDS files lack their subject."""
        anat = folder / "anat"
        if (folder / PLAIN_PATHS["summary"]).is_file() or not anat.is_dir():
            return cls(folder)
        found = sorted(anat.glob(f"sub-*{PROVENANCE_ENDING}"))
        if len(found) != 1:
            raise FileNotFoundError(
                f"{anat}: holds {'more than one' if found else 'no'} sub-NAME{PROVENANCE_ENDING}. Name a folder "
                "DATASET/sub-NAME that `morphofold analyze --layout bids` wrote."
            )
        return cls(folder, found[0].name.removesuffix(PROVENANCE_ENDING))

    @property
    def bids(self) -> bool:
        return bool(self.subject)

    @property
    def paths(self) -> Mapping[str, str]:
        return BIDS_PATHS if self.bids else PLAIN_PATHS

    def path(self, kind: str, hemi: str = "", name: str = "") -> Path:
        """Path of a file; raises ``NotReadable`` for a name that cannot be part of it."""
        fields = {"hemi": hemi, "name": name and file_word(name), "subject": self.subject}
        fields |= {"side": BIDS_SIDES.get(hemi, ""), "camel": _camel_case(name), "ending": self.ending(kind, name)}
        return self.folder / self.paths[kind].format(**fields)

    def write(
        self, kind: str, write: Callable[[Path], object], hemi: str = "", name: str = "", about: Mapping[str, Any] = {}
    ) -> None:
        """Let ``write(path)`` write a file if this layout has such files; in BIDS also the JSON that describes it."""
        if kind not in self.paths:
            return
        path = self.path(kind, hemi, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path)
        if self.bids and about:
            _write_json(about, path.with_name(f"{path.name.split('.')[0]}.json"))

    def write_json(self, kind: str, content: Mapping[str, Any]) -> None:
        """Write a JSON file."""
        self.write(kind, partial(_write_json, content))

    def ending(self, kind: str, name: str) -> str:
        """End of the name of a map's file in BIDS: ``desc-sulcalDepth_morph``, or ``desc-input_sulc`` for a map that
        came with the surfaces."""
        name = f"input_{name}" if kind == "input_map" else name
        return MAP_ENDINGS.get(name, f"desc-{_camel_case(name)}_morph")

    def write_table(self, name: str, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
        """Write a table, and in BIDS the meaning of its columns."""
        about = {key: _about_column(key) for key in dict.fromkeys(chain(columns, *rows))}
        self.write("table", partial(write_table, columns=columns, rows=rows), name=name, about=about)

    def read_tables(self, row_counts: Mapping[str, int]) -> dict[str, list[dict[str, Any]]]:
        """Read the tables, by name: as many rows as the summary says; none of a table that its version did not have."""
        tables: dict[str, list[dict[str, Any]]] = {name: [] for name in COLUMNS}
        for name, columns in COLUMNS.items():
            if name not in row_counts:
                continue
            file = self.path("table", name=name)
            rows = read_table(file, TEXT_COLUMNS, row_counts[name], numbers=set(columns) - TEXT_COLUMNS)
            if rows and (missing := [column for column in columns if column not in rows[0]]):
                raise MissingPart(f"{file}: lacks the columns {', '.join(missing)}. {REANALYSE_ADVICE}")
            tables[name] = rows
        return tables


def _write_json(content: Mapping[str, Any], path: Path) -> None:
    path.write_text(strict_json(content), encoding="utf-8")


def in_bids_letters(unit: str) -> str:
    """A unit as BIDS writes it."""
    return unit.replace("²", "^2").replace("³", "^3") or "1"


def _camel_case(name: str) -> str:
    """``shape_index`` as BIDS writes it: ``shapeIndex``."""
    first, *rest = ("".join(c for c in word if c.isascii() and c.isalnum()) for word in name.split("_"))
    return first + "".join(word[:1].upper() + word[1:] for word in rest)


def _about_column(key: str) -> dict[str, Any]:
    label, unit = column_words(key)
    about: dict[str, Any] = {"Description": label, **({"Units": in_bids_letters(unit)} if unit else {})}
    return about | ({"Levels": HEMISPHERE_LEVELS} if key == "hemi" else {})
