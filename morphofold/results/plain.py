"""An analysis on disk in our own layout: ``write_analysis`` writes the folder of measures, ``read_plain`` reads it.

The folder is a FreeSurfer-shaped subject (surf/, label/) with tables, maps, pictures and a page, so it can be opened in
other tools and compared without the files it was made from.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from morphofold.analysis.measures import Measures
from morphofold.analysis.regions import wide_table
from morphofold.errors import MissingPart
from morphofold.forecasts.cost import WRITING_STAGE
from morphofold.io import (
    atomic_folder,
    read_annotation,
    read_label,
    read_morph,
    read_surface,
    write_annotation,
    write_gifti_map,
    write_label,
    write_morph,
    write_surface,
)
from morphofold.io.json_files import file_word, read_json
from morphofold.provenance import digests
from morphofold.results.graph_file import read_graph, write_graph
from morphofold.results.gyral_stats import stats_name, write_gyral_stats
from morphofold.results.summary import (
    COLUMNS,
    REANALYSE_ADVICE,
    SCALAR_COLUMNS,
    DrawPage,
    Summary,
    checked_inputs,
    entries_of,
    measures_of,
    read_tables,
    scalar_rows,
    sized_map,
    summary_of,
    surfaces_of,
    write_summary,
)
from morphofold.surface import Cortex
from morphofold.tables import write_table

if TYPE_CHECKING:
    from morphofold.timing import Stages


def check_wide(cortices: Sequence[Cortex]) -> None:
    """Raise for a table with a column per region if the surfaces have no regions."""
    if not any(cortex.regions for cortex in cortices):
        raise MissingPart(
            f"{cortices[0].name}: regions_wide.tsv has a column per region, but no parcellation (label/?h.aparc.annot) "
            "came with the surfaces. Leave out --wide (wide=True)."
        )


def write_analysis(
    measures: Sequence[Measures],
    out: str | Path,
    *,
    failed: Mapping[str, str] | None = None,
    inputs: Iterable[str | Path] = (),
    parameters: Mapping[str, Any] | None = None,
    report: DrawPage | Literal[False] = False,
    stages: Sequence[Cortex] = (),
    mgh: bool = False,
    wide: bool = False,
    clock: Stages | None = None,
) -> Path:
    """Write an analysis, completely or not at all.

    Parameters
    ----------
    measures : sequence of Measures
        One hemisphere, or a left and a right one.
    out : str or path
        Folder to write. A folder of an earlier run is replaced; any other folder that is not empty is refused.
    failed : mapping, optional
        Hemispheres that could not be measured, and why; recorded, and shown on the page.
    inputs : iterable of path
        Files to record with their SHA-256, in addition to the files of the cortices.
    parameters : mapping, optional
        Recorded for the whole run; each surface's own ``Measures.parameters`` are recorded with it.
    report : callable or False
        Draws report.html and figures/*.png: :func:`morphofold.report.analysis_report`, or a similar function.
    stages : sequence of Cortex
        Stages of the measured body, if there is only one; the page draws it as it grows.
    mgh : bool
        Whether to write the maps also as MGH, in addition to FreeSurfer's format and GIFTI.
    wide : bool
        Whether to write also regions_wide.tsv: the region table as one row.
    clock : Stages, optional
        The clock of the measuring. With it cost.json and the page give the cost of the analysis. These are the only
        files that are not byte for byte the same the next time.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        If there is no surface, two of one hemisphere, no parcellation for a wide table, or ``out`` is, holds or lies in
        a subject from which the surfaces were read: writing would replace it or add to it.
    FileExistsError
        If ``out`` contains something that morphofold did not write.
    """
    if clock is not None:
        clock.begin(WRITING_STAGE)
    records = checked_inputs(measures, out, inputs)
    if wide:
        check_wide([m.cortex for m in measures])
    with atomic_folder(out) as folder:
        for name in ("surf", "maps"):
            (folder / name).mkdir()
        for m in measures:
            _write_hemisphere(m, folder, mgh)
        for name, columns in COLUMNS.items():
            write_table(folder / f"{name}.tsv", columns, [row for m in measures for row in getattr(m, name)])
        write_table(folder / "surfaces.tsv", SCALAR_COLUMNS, scalar_rows(measures))
        if wide:
            row = wide_table({measures[0].cortex.name: [row for m in measures for row in m.regions]})
            write_table(folder / "regions_wide.tsv", ("subject",), row)
        content = {**summary_of(measures, records, parameters, failed or {}), "written": digests(folder)}
        write_summary(
            measures,
            content,
            folder / "summary.json",
            page=folder / "report.html",
            cost=folder / "cost.json",
            report=report,
            stages=stages,
            clock=clock,
        )
    return Path(out)


def _write_hemisphere(m: Measures, folder: Path, mgh: bool) -> None:
    """Write surfaces, labels, maps, stats and gyral graph of one hemisphere."""
    cortex, hemi = m.cortex, m.cortex.hemi
    for kind, surface in surfaces_of(cortex).items():
        write_surface(folder / "surf" / f"{hemi}.{kind}", surface)
    for name, values in cortex.maps.items():
        write_morph(folder / "surf" / f"{hemi}.{file_word(name)}", values, nan=0.0)
    if cortex.regions is not None or cortex.cortex is not None:
        (folder / "label").mkdir(exist_ok=True)
    if cortex.regions is not None:
        write_annotation(folder / "label" / f"{hemi}.{file_word(cortex.regions.name)}.annot", cortex.regions)
    if cortex.cortex is not None:
        write_label(folder / "label" / f"{hemi}.cortex.label", cortex.cortex, cortex.white.verts)
    for name, values in m.maps.items():
        path = folder / "maps" / f"{hemi}.{file_word(name)}"
        write_gifti_map(Path(f"{path}.shape.gii"), values, nan=np.nan, hemi=hemi)
        for end in ("", ".mgh") if mgh else ("",):
            write_morph(Path(f"{path}{end}"), values, nan=0.0)
    if m.regions:
        (folder / "stats").mkdir(exist_ok=True)
        write_gyral_stats(folder / "stats" / stats_name(m), m)
    if m.graph is not None:
        (folder / "graph").mkdir(exist_ok=True)
        write_graph(folder / "graph" / f"{hemi}.json", m.graph)


def read_plain(folder: Path) -> list[Measures]:
    """Read what ``write_analysis`` wrote; raises as :func:`morphofold.results.read_analysis`."""
    summary = read_json(folder / "summary.json", Summary, REANALYSE_ADVICE)
    tables = read_tables(summary, {name: folder / f"{name}.tsv" for name in COLUMNS})
    return [_read_hemisphere(entry, tables, folder) for entry in entries_of(summary)]


def _read_hemisphere(entry: Mapping[str, Any], tables: Mapping[str, list[dict[str, Any]]], folder: Path) -> Measures:
    hemi = entry["hemi"]
    return measures_of(
        entry,
        tables,
        surface=lambda kind: read_surface(folder / "surf" / f"{hemi}.{kind}"),
        mask=lambda n: read_label(folder / "label" / f"{hemi}.cortex.label", n),
        regions=lambda name, n: read_annotation(folder / "label" / f"{hemi}.{file_word(name)}.annot"),
        came_with=lambda name, n: read_morph(folder / "surf" / f"{hemi}.{file_word(name)}"),
        map_of=lambda name, n: sized_map(folder / "maps" / f"{hemi}.{file_word(name)}.shape.gii", n),
        graph=lambda n: read_graph(folder / "graph" / f"{hemi}.json", n),
    )
