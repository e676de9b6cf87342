"""An analysis on disk: ``write_analysis`` writes the folder of measures, ``read_analysis`` reads it back.

The folder is a FreeSurfer-shaped subject (surf/, label/) with tables, maps, pictures and a page beside it, so
it can be opened in other tools and compared without the files it was made from.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis.measures import Measures
from morphofold.analysis.regions import COLUMNS as REGION_COLUMNS
from morphofold.analysis.regions import wide_table
from morphofold.graph_file import read_graph, write_graph
from morphofold.io import (
    atomic_folder,
    read_annotation,
    read_label,
    read_morph,
    read_surface,
    write_annotation,
    write_gifti_map,
    write_morph,
    write_surface,
)
from morphofold.records import input_records, strict_json
from morphofold.surface import Cortex, PerVertex, Regions, Surface
from morphofold.tables import read_table, write_table

if TYPE_CHECKING:
    import networkx as nx
    from numpy.typing import NDArray

COLUMNS = {
    "regions": REGION_COLUMNS,
    "crests": (
        "hemi", "crest", "from_hinge", "to_hinge", "length_mm", "gyral_thickness_mm", "cortical_thickness_mm",
        "mean_H_per_mm", "region", "altitude_mm", "strength_mm", "blind",
    ),
    "hinges": (
        "hemi", "hinge", "x", "y", "z", "degree", "shape", "min_angle_deg", "max_angle_deg", "region", "vertex",
        "mean_arm_length_mm", "persistence_mm", "blind",
    ),
    "arms": (
        "hemi", "hinge", "arm", "angle_deg", "length_mm", "curvature_per_mm", "to_hinge", "altitude_mm",
        "lowest_altitude_mm", "blind", "crest",
    ),
}  # fmt: skip
WORDS = {"hemi", "region", "shape"}  # columns that stay text even where the text looks like a number
NAN_RULE = "A vertex without a value is NaN in maps/*.shape.gii and 0 in the FreeSurfer and MGH maps beside them."


def write_analysis(
    measures: Sequence[Measures],
    out: str | Path,
    *,
    inputs: Iterable[str | Path] = (),
    parameters: Mapping[str, Any] | None = None,
    report: bool = True,
    stages: Sequence[Cortex] = (),
    mgh: bool = False,
    wide: bool = False,
) -> Path:
    """Write an analysis, whole or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. One that an earlier run wrote is replaced; any other that is not empty is refused.
    inputs : iterable of path
        Files to record with their SHA-256 beside those the cortices name.
    parameters : mapping, optional
        Recorded for the whole run; each surface's own ``Measures.parameters`` are recorded with it.
    report : bool
        Whether to draw figures/*.png and report.html.
    stages : sequence of Cortex
        Those of the one body that was measured, for the page to draw it as it grows.
    mgh : bool
        Whether to write the maps as MGH, too, beside those for FreeSurfer and in GIFTI.
    wide : bool
        Whether to write regions_wide.tsv, too: the region table as one row.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        If there is no surface, two of one hemisphere, or ``out`` is, holds or lies in a subject the surfaces were
        read from: writing would replace or fill it.
    FileExistsError
        If ``out`` holds something morphofold did not write.
    """
    records = checked_inputs(measures, out, inputs)
    with atomic_folder(out) as folder:
        for name in ("surf", "maps"):
            (folder / name).mkdir()
        for m in measures:
            _write_surface(m, folder, mgh)
        (folder / "summary.json").write_text(strict_json(summary_of(measures, records, parameters)), encoding="utf-8")
        for name, columns in COLUMNS.items():
            write_table(folder / f"{name}.tsv", columns, [row for m in measures for row in getattr(m, name)])
        if wide:
            row = wide_table({measures[0].cortex.name: [row for m in measures for row in m.regions]})
            write_table(folder / "regions_wide.tsv", ("subject",), row)
        if report:
            from morphofold.report import analysis_report

            grown = [Measures(cortex, {}, {}) for cortex in stages]
            analysis_report(measures, folder / "report.html", inputs=records, stages=grown)
    return Path(out)


def checked_inputs(
    measures: Sequence[Measures], out: str | Path, inputs: Iterable[str | Path] = ()
) -> list[dict[str, Any]]:
    """Records of the files that an analysis is of; raises ``ValueError`` as ``write_analysis`` says."""
    hemis = [m.cortex.hemi for m in measures]
    if not hemis or len(set(hemis)) < len(hemis):
        raise ValueError(
            f"an analysis holds one left and/or one right hemisphere, got {', '.join(hemis) or 'none'}. "
            "Write each subject to a folder of its own."
        )
    files = dict.fromkeys([*map(str, inputs), *(f for m in measures for f in m.cortex.files)])
    refuse_place_of_inputs(Path(out), files)
    return input_records(files)


def refuse_place_of_inputs(out: Path, files: Iterable[str]) -> None:
    """Raise if ``out`` is or holds the folder of an input file, or lies in the subject whose surf/ holds it."""
    there = out.resolve()
    for file in map(Path, files):
        if not file.is_file():  # nothing here to lose
            continue
        folder = file.parent.resolve()
        subject = folder.parent if folder.name in ("surf", "label") else None
        place = subject or folder
        if place.is_relative_to(there) or (subject is not None and there.is_relative_to(subject)):
            how = "is" if there == place else "holds" if place.is_relative_to(there) else "lies in"
            raise ValueError(f"{out} {how} the folder of the input {file}, so the analysis must go to another folder.")


def summary_of(
    measures: Sequence[Measures], records: list[dict[str, Any]], parameters: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What summary.json holds: where the numbers come from, the scalars, and what is said of them."""
    import morphofold

    return {
        "morphofold": morphofold.__version__, "inputs": records, "parameters": dict(parameters or {}),
        "nan": NAN_RULE, "surfaces": [_entry(m) for m in measures],
    }  # fmt: skip


def _write_surface(m: Measures, folder: Path, mgh: bool) -> None:
    """Surfaces, labels, maps and net of one hemisphere."""
    cortex, hemi = m.cortex, m.cortex.hemi
    write_surface(folder / "surf" / f"{hemi}.white", cortex.white)
    write_surface(folder / "surf" / f"{hemi}.pial", cortex.pial)
    if cortex.inflated is not None:
        write_surface(folder / "surf" / f"{hemi}.inflated", cortex.inflated)
    for name, values in cortex.maps.items():
        write_morph(folder / "surf" / f"{hemi}.{_file_word(name)}", values, nan=0.0)
    if cortex.regions is not None or cortex.cortex is not None:
        (folder / "label").mkdir(exist_ok=True)
    if cortex.regions is not None:
        write_annotation(folder / "label" / f"{hemi}.{_file_word(cortex.regions.name)}.annot", cortex.regions)
    if cortex.cortex is not None:
        _write_label(folder / "label" / f"{hemi}.cortex.label", cortex)
    for name, values in m.maps.items():
        write_morph(folder / "maps" / f"{hemi}.{_file_word(name)}", values, nan=0.0)
        write_gifti_map(folder / "maps" / f"{hemi}.{_file_word(name)}.shape.gii", values, nan=np.nan, hemi=hemi)
        if mgh:
            write_morph(folder / "maps" / f"{hemi}.{_file_word(name)}.mgh", values, nan=0.0)
    if m.graph is not None:
        (folder / "graph").mkdir(exist_ok=True)
        write_graph(folder / "graph" / f"{hemi}.json", m.graph)


def _entry(m: Measures) -> dict[str, Any]:
    cortex = m.cortex
    return {
        "hemi": cortex.hemi, "name": cortex.name, "origin": cortex.origin, "units": cortex.units,
        "portion": cortex.portion, "info": dict(cortex.info), "transform": cortex.transform,
        "measures": dict(m.scalars), "notes": dict(m.notes), "parameters": dict(m.parameters),
        "maps": sorted(m.maps), "came_with": sorted(cortex.maps),
        "inflated": cortex.inflated is not None, "cortex_label": cortex.cortex is not None,
        "graph": m.graph is not None,
        "annotation": None if cortex.regions is None else _file_word(cortex.regions.name),
        "files": list(cortex.files),
    }  # fmt: skip


def _write_label(path: Path, cortex: Cortex) -> None:
    assert cortex.cortex is not None
    vertices = np.flatnonzero(cortex.cortex)
    lines = [f"#!ascii label cortex, written by morphofold\n{len(vertices)}\n"]
    lines += [f"{i}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for i, (x, y, z) in zip(vertices, cortex.white.verts[vertices])]
    path.write_text("".join(lines), encoding="ascii")


def _file_word(name: str) -> str:
    """A map's or annotation's name, refused if it cannot be part of a file name."""
    if not name or not all(c.isalnum() or c in "-_." for c in name) or name.startswith(".") or name.endswith(".gii"):
        raise ValueError(f"{name!r} cannot be part of a file name. Use letters, digits, '-', '_' and '.'.")
    return name


def read_analysis(folder: str | Path) -> list[Measures]:
    """Read what ``write_analysis`` wrote, or a subject that ``morphofold.bids.write_dataset`` wrote.

    Maps come from GIFTI, so NaN is NaN again; coordinates and maps have the precision of float32.

    Raises
    ------
    FileNotFoundError
        If ``folder`` or a file in it is missing.
    ValueError
        If a file there cannot be understood; the message names it.
    """
    folder = Path(folder)
    path = folder / "summary.json"
    if not path.is_file() and (folder / "anat").is_dir():
        from morphofold.bids import read_subject

        return read_subject(folder)
    if not path.is_file():
        what, how = "no such folder", "Name a folder that `morphofold analyze` wrote."
        if folder.is_dir():
            what = "holds no summary.json"
            if (folder / "surf").is_dir():
                how = f"It is a subject: `morphofold analyze {folder}` first, and name what that wrote."
            elif (folder / "dataset_description.json").is_file():
                names = sorted(str(place.parent) for place in folder.glob("sub-*/anat")) or ["sub-NAME"]
                how = f"It is a BIDS dataset; name a subject of it: {', '.join(names[:4])}{' ...' * (len(names) > 4)}."
        raise FileNotFoundError(f"{folder}: {what}. {how}")
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        entries = list(summary["surfaces"])
        tables = {name: read_table(folder / f"{name}.tsv", WORDS) for name in COLUMNS}
        return [_read_surface(entry, tables, folder) for entry in entries]
    except (KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"{path}: not a summary as `morphofold analyze` writes it ({type(error).__name__}: {error}). Analyze anew."
        ) from error


def read_stages(folder: str | Path) -> list[Measures]:
    """The analyses of the stages of one simulation: those in ``folder``/g1.20 and so on, in the order of their growth.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If one cannot be understood, or has two hemispheres.
    """
    folder = Path(folder)
    parts = sorted(part for part in folder.glob("g*") if (part / "summary.json").is_file())
    if not parts:
        raise FileNotFoundError(f"{folder}: holds no stages. Name a folder that `morphofold analyze --stages` wrote.")
    stages = []
    for part in parts:
        found = read_analysis(part)
        if len(found) != 1:
            raise ValueError(f"{part}: has two hemispheres, so it is no stage of a simulation.")
        stages += found
    return stages


def is_analysis_of(folder: str | Path, cortex: Cortex, parameters: Mapping[str, Any]) -> bool:
    """Whether ``folder`` holds what this version wrote of the very files of ``cortex``, with these parameters."""
    import morphofold

    try:
        summary = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
        known = {row["path"]: row["sha256"] for row in summary["inputs"]}
        made_by, with_which = summary["morphofold"], summary["parameters"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # there is none, or none to be relied on
        return False
    files = {row["path"]: row["sha256"] for row in input_records(cortex.files)}
    return (made_by, with_which, known) == (morphofold.__version__, dict(parameters), files)


def _read_surface(entry: Mapping[str, Any], tables: Mapping[str, list[dict[str, Any]]], folder: Path) -> Measures:
    hemi, surf, label = entry["hemi"], folder / "surf", folder / "label"
    if hemi not in ("lh", "rh"):  # it becomes part of file names below
        raise ValueError(f"{folder / 'summary.json'}: hemi must be 'lh' or 'rh', got {hemi!r}.")
    white, pial = (read_surface(surf / f"{hemi}.{name}") for name in ("white", "pial"))
    n, regions = len(white.verts), None
    if entry["annotation"] is not None:
        regions = read_annotation(label / f"{hemi}.{_file_word(entry['annotation'])}.annot")
    return measures_of(
        entry, tables, white, pial,
        inflated=read_surface(surf / f"{hemi}.inflated") if entry["inflated"] else None,
        cortex=read_label(label / f"{hemi}.cortex.label", n) if entry["cortex_label"] else None,
        regions=regions,
        came_with={name: read_morph(surf / f"{hemi}.{_file_word(name)}") for name in entry["came_with"]},
        maps={name: _sized(folder / "maps" / f"{hemi}.{_file_word(name)}.shape.gii", n) for name in entry["maps"]},
        graph=read_graph(folder / "graph" / f"{hemi}.json", n) if entry.get("graph") else None,
    )  # fmt: skip


def measures_of(
    entry: Mapping[str, Any],
    tables: Mapping[str, list[dict[str, Any]]],
    white: Surface,
    pial: Surface,
    *,
    inflated: Surface | None,
    cortex: NDArray[np.bool_] | None,
    regions: Regions | None,
    came_with: Mapping[str, PerVertex],
    maps: Mapping[str, PerVertex],
    graph: nx.MultiGraph | None,
) -> Measures:
    """Measures from what the summary says of a surface, the tables of both, and what was read of its own files."""
    own = {name: [row for row in rows if row["hemi"] == entry["hemi"]] for name, rows in tables.items()}
    return Measures(
        Cortex(
            white, pial, entry["hemi"], str(entry["name"]), came_with, cortex, regions, inflated,
            origin=str(entry["origin"]), units=str(entry["units"]),
            transform=None if entry["transform"] is None else np.array(entry["transform"], dtype=np.float64),
            portion=float(entry["portion"]), info=dict(entry["info"]), files=tuple(map(str, entry["files"])),
        ),
        dict(entry["measures"]), maps, own["regions"], own["crests"], own["hinges"], own["arms"],
        parameters=dict(entry["parameters"]), notes=dict(entry["notes"]), graph=graph,
    )  # fmt: skip


def _sized(path: Path, n: int) -> np.ndarray:
    values = read_morph(path)
    if values.shape != (n,):
        raise ValueError(f"{path}: {values.shape} values for {n} vertices. The files are of two analyses.")
    return values
