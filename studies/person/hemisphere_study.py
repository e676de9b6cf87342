"""``python3 run.py bench hemisphere``: what accuracy costs on a hemisphere, and a ferret beside its published stages.

``python -m morphofold.studies.person.hemisphere_study OUT PAGE`` writes the tables and the picture of the folder OUT
between the marks ``<!-- meshes -->`` and ``<!-- ferret -->`` of the Markdown page PAGE, and all meshes beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morphofold.io import atomic_file
from morphofold.report.pictures.pixel_canvas import halved, png_bytes, read_png
from morphofold.report.plots.figure_style import BLACK, legend_below, line_style, new_figure, save
from morphofold.studies import markdown
from morphofold.studies.markdown import cells, read_rows, update_page
from morphofold.studies.person import ferret, meshes
from morphofold.studies.runs import Runs
from morphofold.tables import write_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GROWTH, THICKNESSES = 1.7, (2.5, 3.0, 4.0)
FERRET_SEEDS = (0, 1, 2)
SHOWN_THICKNESS = 3.0  # of the meshes in the page; all are in the table beside it [mm]
TEXT_COLUMNS = (*markdown.TEXT_COLUMNS, "kind", "level")
MESH_COLUMNS = {
    "T, mm (radius 50)": ("thickness_mm", "{:g}"),
    "level": ("level", ""),
    "bricks": ("bricks", "{:,.0f}"),
    "steps": ("steps", "{:,.0f}"),
    "seconds": ("seconds", "{:.0f}"),
    "threads": ("threads", "{:.0f}"),
    "GI": ("gyrification_index", "{:.3f}"),
    "gyral thickness, mm": ("gyral_width_mm", "{:.2f}"),
    "distance, T": ("distance_over_T", "{:.2f}"),
    "correlation of heights": ("height_correlation", "{:.2f}"),
    "healthy": ("healthy", "{:.0f}"),
}


def run_study(
    levels: Sequence[str], thicknesses: Sequence[float], surface_files: Sequence[Path], folder: Path, runs: Runs
) -> list[str]:
    """Grow what is asked for and write meshes.tsv and, with published surfaces of a ferret, ferret.tsv and ferret.png
    into ``folder``; returns the names of these files."""
    file_names = []
    if levels and thicknesses:
        rows = meshes.rows(levels, thicknesses, GROWTH, runs)
        write_table(folder / "meshes.tsv", tuple(rows[0]), rows)
        file_names.append("meshes.tsv")
    if surface_files:
        rows = [*ferret.published_rows(surface_files), *ferret.grown_rows(surface_files[0], FERRET_SEEDS, runs)]
        write_table(folder / "ferret.tsv", tuple(rows[0]), rows)
        save(ferret_figure(rows), folder / "ferret.png")
        file_names += ["ferret.tsv", "ferret.png"]
    return file_names


def ferret_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Gyrification against area: published stages, and ours by level, a line per seed."""
    with new_figure(6.4, 5.0, 1, 1) as (figure, panels):
        ax = panels[0][0]
        for k, level in enumerate(ferret.LEVELS):
            seeds = list(dict.fromkeys(row["seed"] for row in rows if row["level"] == level))
            for j, seed in enumerate(seeds):
                seed_rows = [row for row in rows if (row["level"], row["seed"]) == (level, seed)]
                x, y = ([row[key] for row in seed_rows] for key in ("area_over_first_hull", "gyrification_index"))
                ax.plot(x, y, **line_style(k), marker=".", alpha=0.8, label=f"ours, {level}" if j == 0 else None)
        seed_rows = [row for row in rows if row["kind"] == "published"]
        x, y = ([row[key] for row in seed_rows] for key in ("area_over_first_hull", "gyrification_index"))
        ax.plot(x, y, color=BLACK, marker="s", label="Choi and others (2025)")
        ax.set(xlabel="area over that of the first hull", ylabel="gyrification: area over that of its own hull")
        legend_below(ax)
    return figure


def write_page(folder: Path, page: Path) -> None:
    """Write the parts of ``page`` that are in ``folder``; raises ``MissingPart`` if it lacks their marks."""
    parts = {}
    if (folder / "meshes.tsv").is_file():
        rows = cells(read_rows(folder / "meshes.tsv", TEXT_COLUMNS), dict(MESH_COLUMNS.values()))
        is_shown = lambda row: float(row[0]) == SHOWN_THICKNESS
        parts["meshes"] = [markdown.table_with_tsv(page, "meshes", list(MESH_COLUMNS), rows, is_shown)]
    if (folder / "ferret.tsv").is_file():
        with atomic_file(page.parent / "ferret.png") as temporary_file:
            temporary_file.write_bytes(png_bytes(halved(read_png(folder / "ferret.png"))))
        parts["ferret"] = ["![gyrification of a ferret's brain against its area](ferret.png)", _ferret_table(folder)]
    update_page(page, parts)


def _ferret_table(folder: Path) -> str:
    """Gyrification of ours where the area is that of a published stage: mean and range over meshes and seeds."""
    rows = read_rows(folder / "ferret.tsv", TEXT_COLUMNS)
    lines = []
    for stage in (row for row in rows if row["kind"] == "published"):
        gyrifications = ferret.at_area(rows, stage["area_over_first_hull"])
        bounds = f"{min(gyrifications):.3f} to {max(gyrifications):.3f}" if gyrifications else "–"
        mean_text = f"{sum(gyrifications) / len(gyrifications):.3f}" if gyrifications else "–"
        lines.append([f"{stage['area_over_first_hull']:.3f}", f"{stage['gyrification_index']:.3f}", mean_text, bounds])
    return markdown.table(["area over the first hull", "published", "ours, mean", "over meshes and seeds"], lines)


if __name__ == "__main__":
    write_page(Path(sys.argv[1]), Path(sys.argv[2]))
