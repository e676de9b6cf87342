"""One page of all figures of ``morphofold reproduce``: pictures, tables, comparisons with the paper, and times."""

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morphofold.report.pages.page_writer import write_page
from morphofold.report.pictures.pixel_canvas import halved, png_bytes, read_png
from morphofold.studies.paper.figure_parts import PART_MAKERS, Image, read_tables
from morphofold.studies.paper.verdicts import VERDICT_MAKERS

MOST_SECONDS = 100  # from this time on, minutes are shown


def write_paper_report(folder: Path, index: Mapping[str, Any]) -> Path:
    """Write ``folder``/report.html, one file that opens offline, from its figures and tables; ``index`` is the content
    of its summary.json."""
    figures = [_figure(folder, figure_name, entry) for figure_name, entry in sorted(index["figures"].items())]
    run_by_folder = {run["folder"]: run for entry in index["figures"].values() for run in entry.get("simulations", ())}
    growing_seconds = sum(run["seconds"] for run in run_by_folder.values())
    drawing_seconds = sum(entry.get("seconds", 0.0) for entry in index["figures"].values())
    return write_page(
        folder / "report.html",
        "paper.html",
        title="The figures of Razavi et al. 2015",
        figures=figures,
        version=index["morphofold"],
        lengths=index["lengths"],
        whole=duration(growing_seconds + drawing_seconds),
        grown=duration(growing_seconds),
        count=len(run_by_folder),
    )


def _figure(folder: Path, figure_name: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    tables = read_tables(folder, entry["files"])
    try:
        verdict, parts = VERDICT_MAKERS[figure_name](tables), PART_MAKERS[figure_name](tables)
    except KeyError as error:
        verdict, parts = f"Drawn by an earlier version, whose tables lack {error}; draw it again.", []
    return {
        "name": f"Fig. {figure_name.removeprefix('fig')}",
        "shows": entry["shows"],
        "verdict": verdict,
        "parts": [_part(folder, part) for part in parts],
        "files": [file for file in entry["files"] if file.endswith(".tsv")],
        "took": duration(entry["seconds"]) if "seconds" in entry else None,
        "simulations": [
            {**run, "name": run["folder"].rpartition("/")[2], "took": duration(run["seconds"])}
            for run in entry.get("simulations", ())
        ],
    }


def _part(folder: Path, part: Any) -> dict[str, Any]:
    if not isinstance(part, Image):
        return {"heads": part.heads, "rows": part.rows}
    png_data = png_bytes(halved(read_png(folder / f"{part.name}.png")))
    return {"words": part.description, "data": base64.b64encode(png_data).decode(), "file": f"{part.name}.png"}


def duration(seconds: float) -> str:
    """A time as text, in seconds or minutes."""
    return f"{seconds:.0f} s" if seconds < MOST_SECONDS else f"{seconds / 60:.0f} min"
