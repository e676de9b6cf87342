"""The summary of an analysis, the same in both layouts: what it holds, and what it must hold to be read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from morphofold import __version__
from morphofold.analysis.frames import COLUMNS
from morphofold.analysis.measures import Measures
from morphofold.io.cortices import SurfaceRecord
from morphofold.io.json_files import Count, FileWord, Number, Record, file_word

REANALYSE_ADVICE = "Analyze again."
NAN_RULE = "A vertex without a value is NaN in maps/*.shape.gii and 0 in the FreeSurfer and MGH maps beside them."


class SurfaceSummary(SurfaceRecord):
    """An entry of ``surfaces`` in a summary."""

    transform: list[list[Number]] | None
    measures: dict[str, Number | None]
    notes: dict[str, str]
    parameters: dict[str, Any]
    maps: list[FileWord]
    came_with: list[FileWord]
    inflated: bool
    sphere: bool = False
    cortex_label: bool
    graph: bool
    annotation: FileWord | None
    files: list[str]


class Summary(Record):
    """``summary.json`` of an analysis, or the provenance file of a subject in a BIDS dataset."""

    morphofold: str
    inputs: list[dict[str, Any]]
    parameters: dict[str, Any]
    rows: dict[str, Count]
    written: dict[str, str] = {}  # digests of surfaces, maps and tables, in the plain layout only
    surfaces: list[SurfaceSummary]


def summary_of(
    measures: Sequence[Measures], inputs: list[dict[str, Any]], parameters: Mapping[str, Any], failed: Mapping[str, str]
) -> dict[str, Any]:
    """Content of summary.json: input files, parameters, numbers of rows, an entry per surface, and what failed."""
    return {
        "morphofold": __version__,
        "inputs": inputs,
        "parameters": dict(parameters),
        "nan": NAN_RULE,
        "rows": {name: sum(len(getattr(m, name)) for m in measures) for name in COLUMNS},
        "surfaces": [_surface_entry(m) for m in measures],
        "failed": dict(failed),
    }


def _surface_entry(m: Measures) -> dict[str, Any]:
    cortex = m.cortex
    return {
        **{key: getattr(cortex, key) for key in ("hemi", "name", "origin", "units", "portion", "info", "transform")},
        "measures": m.scalars,
        "notes": m.notes,
        "parameters": m.parameters,
        "maps": sorted(m.maps),
        "came_with": sorted(cortex.maps),
        "inflated": cortex.inflated is not None,
        "sphere": cortex.sphere is not None,
        "cortex_label": cortex.cortex is not None,
        "graph": m.graph is not None,
        "annotation": None if cortex.regions is None else file_word(cortex.regions.name),
        "files": cortex.files,
    }
