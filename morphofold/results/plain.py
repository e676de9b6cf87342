"""An analysis on disk in our own layout: ``write_analysis`` writes the folder of measures, ``read_plain`` reads it.

The folder is a FreeSurfer-shaped subject (surf/, label/) with tables, maps, pictures and a page beside it, so
it can be opened in other tools and compared without the files it was made from.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from morphofold.analysis.measures import Measures
from morphofold.analysis.regions import wide_table
from morphofold.forecasts.analysis_cost import WRITING, cost_of_analysis
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
from morphofold.io.json_files import file_word, read_json
from morphofold.provenance import digests, strict_json
from morphofold.results.graph_file import read_graph, write_graph
from morphofold.results.summary import (
    COLUMNS,
    CURE,
    SURFACES,
    Page,
    Summary,
    checked_inputs,
    entries_of,
    measures_of,
    read_tables,
    scalar_rows,
    summary_of,
)
from morphofold.surface import Cortex
from morphofold.tables import write_table

if TYPE_CHECKING:
    from morphofold.timing import Stages


def check_wide(cortices: Sequence[Cortex]) -> None:
    """Refuse a table with a column per region of surfaces that have no regions."""
    if not any(cortex.regions for cortex in cortices):
        raise ValueError(
            f"{cortices[0].name}: regions_wide.tsv has a column per region, and no parcellation (label/?h.aparc.annot) "
            "came with the surfaces. Leave --wide (wide=True) out."
        )


def write_analysis(
    measures: Sequence[Measures],
    out: str | Path,
    *,
    failed: Mapping[str, str] | None = None,
    inputs: Iterable[str | Path] = (),
    parameters: Mapping[str, Any] | None = None,
    report: Page | Literal[False] = False,
    stages: Sequence[Cortex] = (),
    mgh: bool = False,
    wide: bool = False,
    clock: Stages | None = None,
) -> Path:
    """Write an analysis, whole or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. One that an earlier run wrote is replaced; any other that is not empty is refused.
    failed : mapping, optional
        Hemispheres that could not be measured, and why; recorded, and said on the page.
    inputs : iterable of path
        Files to record with their SHA-256 beside those the cortices name.
    parameters : mapping, optional
        Recorded for the whole run; each surface's own ``Measures.parameters`` are recorded with it.
    report : callable or False
        Draws report.html and figures/*.png: :func:`morphofold.report.analysis_report`, or another like it.
    stages : sequence of Cortex
        Those of the one body that was measured, for the page to draw it as it grows.
    mgh : bool
        Whether to write the maps as MGH, too, beside those for FreeSurfer and in GIFTI.
    wide : bool
        Whether to write regions_wide.tsv, too: the region table as one row.
    clock : Stages, optional
        That went along with the measuring. With it cost.json and the page say what the analysis has cost: the only
        things here that are not the same bytes the next time.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        If there is no surface, two of one hemisphere, no parcellation for a wide table, or ``out`` is, holds or lies in
        a subject the surfaces were read from: writing would replace or fill it.
    FileExistsError
        If ``out`` holds something morphofold did not write.
    """
    if clock is not None:
        clock.begin(WRITING)
    records = checked_inputs(measures, out, inputs)
    if wide:
        check_wide([m.cortex for m in measures])
    with atomic_folder(out) as folder:
        for name in ("surf", "maps"):
            (folder / name).mkdir()
        for m in measures:
            _write_surface(m, folder, mgh)
        for name, columns in COLUMNS.items():
            write_table(folder / f"{name}.tsv", columns, [row for m in measures for row in getattr(m, name)])
        write_table(folder / "surfaces.tsv", SURFACES, scalar_rows(measures))
        if wide:
            row = wide_table({measures[0].cortex.name: [row for m in measures for row in m.regions]})
            write_table(folder / "regions_wide.tsv", ("subject",), row)
        said = {**summary_of(measures, records, parameters, failed or {}), "written": digests(folder)}
        (folder / "summary.json").write_text(strict_json(said), encoding="utf-8")
        if report:
            grown = [Measures(cortex, {}, {}) for cortex in stages]
            report(measures, folder / "report.html", failed=failed or {}, inputs=records, stages=grown, clock=clock)
        if clock is not None:
            cost = cost_of_analysis(measures, clock)
            (folder / "cost.json").write_text(strict_json(cost.as_dict()), encoding="utf-8")
    return Path(out)


def _write_surface(m: Measures, folder: Path, mgh: bool) -> None:
    """Surfaces, labels, maps and net of one hemisphere."""
    cortex, hemi = m.cortex, m.cortex.hemi
    write_surface(folder / "surf" / f"{hemi}.white", cortex.white)
    write_surface(folder / "surf" / f"{hemi}.pial", cortex.pial)
    if cortex.inflated is not None:
        write_surface(folder / "surf" / f"{hemi}.inflated", cortex.inflated)
    for name, values in cortex.maps.items():
        write_morph(folder / "surf" / f"{hemi}.{file_word(name)}", values, nan=0.0)
    if cortex.regions is not None or cortex.cortex is not None:
        (folder / "label").mkdir(exist_ok=True)
    if cortex.regions is not None:
        write_annotation(folder / "label" / f"{hemi}.{file_word(cortex.regions.name)}.annot", cortex.regions)
    if cortex.cortex is not None:
        _write_label(folder / "label" / f"{hemi}.cortex.label", cortex)
    for name, values in m.maps.items():
        write_morph(folder / "maps" / f"{hemi}.{file_word(name)}", values, nan=0.0)
        write_gifti_map(folder / "maps" / f"{hemi}.{file_word(name)}.shape.gii", values, nan=np.nan, hemi=hemi)
        if mgh:
            write_morph(folder / "maps" / f"{hemi}.{file_word(name)}.mgh", values, nan=0.0)
    if m.graph is not None:
        (folder / "graph").mkdir(exist_ok=True)
        write_graph(folder / "graph" / f"{hemi}.json", m.graph)


def _write_label(path: Path, cortex: Cortex) -> None:
    assert cortex.cortex is not None
    vertices = np.flatnonzero(cortex.cortex)
    lines = [f"#!ascii label cortex, written by morphofold\n{len(vertices)}\n"]
    lines += [f"{i}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for i, (x, y, z) in zip(vertices, cortex.white.verts[vertices])]
    path.write_text("".join(lines), encoding="ascii")


def read_plain(folder: Path) -> list[Measures]:
    """Read what ``write_analysis`` wrote; raises as :func:`morphofold.results.read_analysis` says."""
    summary = read_json(folder / "summary.json", Summary, CURE)
    tables = read_tables(summary, {name: folder / f"{name}.tsv" for name in COLUMNS})
    return [_read_surface(entry, tables, folder) for entry in entries_of(summary)]


def _read_surface(entry: Mapping[str, Any], tables: Mapping[str, list[dict[str, Any]]], folder: Path) -> Measures:
    hemi, surf, label = entry["hemi"], folder / "surf", folder / "label"
    white, pial = (read_surface(surf / f"{hemi}.{name}") for name in ("white", "pial"))
    n, regions = len(white.verts), None
    if entry["annotation"] is not None:
        regions = read_annotation(label / f"{hemi}.{file_word(entry['annotation'])}.annot")
    return measures_of(
        entry, tables, white, pial,
        inflated=read_surface(surf / f"{hemi}.inflated") if entry["inflated"] else None,
        cortex=read_label(label / f"{hemi}.cortex.label", n) if entry["cortex_label"] else None,
        regions=regions,
        came_with={name: read_morph(surf / f"{hemi}.{file_word(name)}") for name in entry["came_with"]},
        maps={name: sized_map(folder / "maps" / f"{hemi}.{file_word(name)}.shape.gii", n) for name in entry["maps"]},
        graph=read_graph(folder / "graph" / f"{hemi}.json", n) if entry.get("graph") else None,
    )  # fmt: skip


def sized_map(path: Path, n: int) -> np.ndarray:
    """A map that must have ``n`` values."""
    values = read_morph(path)
    if values.shape != (n,):
        raise ValueError(f"{path}: {values.shape} values for {n} vertices. The files are of two analyses.")
    return values
