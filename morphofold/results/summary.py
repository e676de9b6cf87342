"""Parts of an analysis on disk that both layouts share: names of tables, the summary, and measures from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from morphofold.analysis.frames import COLUMNS, FREESURFER_VALUES, TEXT_COLUMNS
from morphofold.analysis.measures import SCALARS, SLOPE_SCALARS, Measures
from morphofold.errors import Mismatch, MissingPart, NamedTwice, NothingToDo, OutOfRange
from morphofold.forecasts.cost import cost_of_analysis
from morphofold.io import read_morph
from morphofold.io.cortices import SurfaceRecord
from morphofold.io.folders import refuse_overlap
from morphofold.io.json_files import Amount, Count, FileWord, Number, Record, file_word
from morphofold.provenance import records_as_read, strict_json
from morphofold.surface import Cortex, PerVertex, Regions, Surface
from morphofold.tables import read_table

if TYPE_CHECKING:
    import networkx as nx
    from numpy.typing import NDArray

    from morphofold.timing import Stages

#: draws the page of an analysis: called as ``page(measures, path, failed=, inputs=, stages=, clock=)``
DrawPage = Callable[..., object]

SCALAR_COLUMNS = ("hemi", *SCALARS, *FREESURFER_VALUES)  # columns of the table of scalars
REANALYSE_ADVICE = "Analyze again."
SIGNED_SCALARS = ("euler_characteristic", *SLOPE_SCALARS)  # scalars that may be negative


_FourItems = Field(min_length=4, max_length=4)


class InputRecord(Record):
    """An input file of an analysis."""

    path: str
    sha256: str | None
    bytes: Count | None


class Parameters(Record):
    """Scales and options of a surface; others are shown as they are."""

    curvature_scale_mm: Amount = 0.0
    folding_scale_mm: Amount | None = None
    cortical_thickness_cap_mm: Amount | None = None
    cortex_mask: str = ""
    graph_width_mm: Amount = 0.0
    accuracy: str = "standard"
    accuracy_vertices: Count = 0
    local_gyrification_voxel_mm: Amount = 0.0


class SurfaceSummary(SurfaceRecord):
    """An entry of ``surfaces`` in a summary."""

    transform: Annotated[list[Annotated[list[Number], _FourItems]], _FourItems] | None
    measures: dict[str, Number | None]
    notes: dict[str, str]
    parameters: Parameters
    maps: list[FileWord]
    came_with: list[FileWord]
    inflated: bool
    sphere: bool = False
    cortex_label: bool
    graph: bool
    annotation: FileWord | None
    files: list[str]

    @field_validator("measures")
    @classmethod
    def _no_negative_amounts(cls, measures: dict[str, float | None]) -> dict[str, float | None]:
        for name, value in measures.items():
            if value is not None and value < 0 and name in SCALARS and name not in SIGNED_SCALARS:
                raise OutOfRange(f"{name} is {value:g}, and can't be negative")
        return measures


class Summary(Record):
    """``summary.json`` of an analysis, or the provenance file of a subject in a BIDS dataset."""

    morphofold: str
    inputs: list[InputRecord]
    parameters: dict[str, Any]
    rows: dict[str, Count]
    written: dict[str, str] = {}  # digests of surfaces, maps and tables, in the plain layout only
    surfaces: Annotated[list[SurfaceSummary], Field(min_length=1)]


NAN_RULE = "A vertex without a value is NaN in maps/*.shape.gii and 0 in the FreeSurfer and MGH maps beside them."


def checked_inputs(
    measures: Sequence[Measures], out: str | Path, inputs: Iterable[str | Path] = ()
) -> list[dict[str, Any]]:
    """Records of the input files of an analysis; raises ``ValueError`` as ``write_analysis``."""
    hemis = [m.cortex.hemi for m in measures]
    if not hemis or len(set(hemis)) < len(hemis):
        raise (NamedTwice if hemis else NothingToDo)(
            f"an analysis holds one left and/or one right hemisphere, got {', '.join(hemis) or 'none'}. "
            "Write each subject to a folder of its own."
        )
    records = records_as_read((m.cortex for m in measures), inputs)
    refuse_overlap(Path(out), (row["path"] for row in records))
    return records


def summary_of(
    measures: Sequence[Measures],
    records: list[dict[str, Any]],
    parameters: Mapping[str, Any] | None,
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """Content of summary.json: input files, parameters, numbers of rows, an entry per surface, and what failed."""
    import morphofold

    return {
        "morphofold": morphofold.__version__,
        "inputs": records,
        "parameters": dict(parameters or {}),
        "nan": NAN_RULE,
        "rows": {name: sum(len(getattr(m, name)) for m in measures) for name in COLUMNS},
        "surfaces": [_surface_entry(m) for m in measures],
        "failed": dict(failed),
    }


def write_summary(
    measures: Sequence[Measures],
    content: Mapping[str, Any],
    path: Path,
    *,
    page: Path,
    cost: Path,
    report: DrawPage | Literal[False],
    stages: Sequence[Cortex],
    clock: Stages | None,
) -> None:
    """Write the last files of an analysis: its summary, the page if one is drawn, the cost if there is a clock."""
    path.write_text(strict_json(content), encoding="utf-8")
    if report:
        grown = [Measures(cortex, {}, {}) for cortex in stages]
        report(measures, page, failed=content["failed"], inputs=content["inputs"], stages=grown, clock=clock)
    if clock is not None:
        cost.write_text(strict_json(cost_of_analysis(measures, clock).as_dict()), encoding="utf-8")


def scalar_rows(measures: Sequence[Measures]) -> list[dict[str, Any]]:
    """Rows of the table of scalars, one for each hemisphere."""
    return [
        {"hemi": m.cortex.hemi, **m.scalars, **{key: m.cortex.info.get(key) for key in FREESURFER_VALUES}}
        for m in measures
    ]


def _surface_entry(m: Measures) -> dict[str, Any]:
    cortex = m.cortex
    return {
        "hemi": cortex.hemi,
        "name": cortex.name,
        "origin": cortex.origin,
        "units": cortex.units,
        "portion": cortex.portion,
        "info": dict(cortex.info),
        "transform": cortex.transform,
        "measures": dict(m.scalars),
        "notes": dict(m.notes),
        "parameters": dict(m.parameters),
        "maps": sorted(m.maps),
        "came_with": sorted(cortex.maps),
        "inflated": cortex.inflated is not None,
        "sphere": cortex.sphere is not None,
        "cortex_label": cortex.cortex is not None,
        "graph": m.graph is not None,
        "annotation": None if cortex.regions is None else file_word(cortex.regions.name),
        "files": list(cortex.files),
    }


def read_tables(summary: Mapping[str, Any], files: Mapping[str, Path]) -> dict[str, list[dict[str, Any]]]:
    """Read the tables of an analysis, by name, each with the number of rows in its summary."""
    tables: dict[str, list[dict[str, Any]]] = {name: [] for name in COLUMNS if name not in summary["rows"]}
    for name, file in files.items():
        if name in tables:  # of a version without this table
            continue
        rows = tables[name] = read_table(
            file, TEXT_COLUMNS, summary["rows"].get(name), numbers=set(COLUMNS[name]) - TEXT_COLUMNS
        )
        if rows and (missing := [column for column in COLUMNS[name] if column not in rows[0]]):
            raise MissingPart(f"{file}: lacks the columns {', '.join(missing)}. {REANALYSE_ADVICE}")
    return tables


def entries_of(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of the surfaces in a summary, with the records of the files that each was read from."""
    records = {row["path"]: row for row in summary["inputs"]}
    return [
        {**entry, "inputs": [records[file] for file in entry["files"] if file in records]}
        for entry in summary["surfaces"]
    ]


def measures_of(
    entry: Mapping[str, Any],
    tables: Mapping[str, list[dict[str, Any]]],
    *,
    surface: Callable[[str], Surface],
    mask: Callable[[int], NDArray[np.bool_]],
    regions: Callable[[str, int], Regions],
    came_with: Callable[[str, int], PerVertex],
    map_of: Callable[[str, int], PerVertex],
    graph: Callable[[int], nx.MultiGraph],
) -> Measures:
    """Measures from the entry of a surface in the summary, the tables of both hemispheres, and its own files.

    The callables read files of one layout, from the name of a surface, map or annotation and the number of vertices.
    """
    white, pial = surface("white"), surface("pial")
    n = len(white.verts)
    own = {name: [row for row in rows if row["hemi"] == entry["hemi"]] for name, rows in tables.items()}
    return Measures(
        Cortex(
            white,
            pial,
            entry["hemi"],
            str(entry["name"]),
            {name: came_with(name, n) for name in entry["came_with"]},
            mask(n) if entry["cortex_label"] else None,
            None if entry["annotation"] is None else regions(entry["annotation"], n),
            surface("inflated") if entry["inflated"] else None,
            surface("sphere") if entry.get("sphere") else None,
            origin=str(entry["origin"]),
            units=str(entry["units"]),
            transform=None if entry["transform"] is None else np.array(entry["transform"], dtype=np.float64),
            portion=float(entry["portion"]),
            info=dict(entry["info"]),
            files=tuple(map(str, entry["files"])),
            inputs=tuple(entry["inputs"]),
        ),
        dict(entry["measures"]),
        {name: map_of(name, n) for name in entry["maps"]},
        own["regions"],
        own["crests"],
        own["hinges"],
        own["arms"],
        parameters=dict(entry["parameters"]),
        notes=dict(entry["notes"]),
        graph=graph(n) if entry["graph"] else None,
        shapes=own["shapes"],
    )


def sized_map(path: Path, n: int) -> PerVertex:
    """Read a map that must have ``n`` values."""
    values = read_morph(path)
    check_size(path, values, n)
    return values


def surfaces_of(cortex: Cortex) -> dict[str, Surface]:
    """Surfaces of a cortex, by the names of their files."""
    kinds = {"white": cortex.white, "pial": cortex.pial, "inflated": cortex.inflated, "sphere": cortex.sphere}
    return {kind: surface for kind, surface in kinds.items() if surface is not None}


def check_size(path: Path, values: NDArray[Any], n: int) -> None:
    """Raise ``Mismatch`` unless a file has a value for each vertex."""
    if values.shape != (n,):
        raise Mismatch(f"{path}: {values.shape} values for {n} vertices. The files belong to two analyses.")
