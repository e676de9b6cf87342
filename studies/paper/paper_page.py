"""The generated parts of docs/figures.md: tables and pictures from the results of ``morphofold reproduce``.

``python -m morphofold.studies.paper.paper_page OUT PAGE`` writes those of the folder OUT between marks such as
``<!-- fig5 -->`` and ``<!-- /fig5 -->`` of the Markdown page PAGE, and the pictures, at half the size, beside it. The
page shows a picture and a few rows of each figure; whole tables, and the simulations, are in ``.tsv`` files beside it.
Text outside of the marks is written by hand.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from morphofold.io import atomic_file
from morphofold.io.files import write_text
from morphofold.io.json_files import read_json
from morphofold.report.pictures.pixel_canvas import halved, png_bytes, read_png
from morphofold.studies import markdown
from morphofold.studies.index_schemas import CURE_TEXT, FigureIndex
from morphofold.studies.markdown import health, renewed
from morphofold.studies.paper.figure_parts import PART_MAKERS, Image, Table, read_tables
from morphofold.studies.paper.paper_folds import FIG6, FIG7


class Shown(NamedTuple):
    """Heads of the columns of a table that stand in the page, and which of its rows."""

    heads: str
    is_shown: Callable[[Sequence[str]], bool] = lambda row_cells: True


FIRST_PICTURES = [[column.title, f"{column.growths[0]:.2f}"] for column in FIG7]
#: table -> what of it stands in the page; other tables that have a name are only linked
SHOWN = {
    "fig3": Shown(
        "quantity | by | g | κ/μ | largest difference from theory",
        lambda row_cells: not row_cells[0].startswith("stress") or row_cells[0] == "stress, T = 2 mm",
    ),
    "fig5": Shown(
        "g | GI | rms, mm | skewness | sulci | wavelength, mm | gyral thickness, mm",
        lambda row_cells: row_cells[0] in ("1.25", "1.35", "1.60", "2.00"),
    ),
    "fig6": Shown(
        "body | g | GI | rms, mm | sulci | wavelength, mm | gyral thickness, mm",
        lambda row_cells: row_cells[1] == f"{FIG6[0].growths[-1]:.2f}",
    ),
    "fig7": Shown(
        "body | g | GI | rms, mm | skewness | sulci | wavelength, mm",
        lambda row_cells: [*row_cells[:2]] in FIRST_PICTURES,
    ),
    "fig8": Shown(
        "surface | points | n | robust slope | from | to | W / t | at crests",
        lambda row_cells: row_cells[1] in ("crests", "bodies"),
    ),
    "fig9-surfaces": Shown("surface | hinges | with three arms | per width² | median largest angle, degrees"),
}
LINKED_PICTURES = ("fig8a", "fig9b")  # second pictures of a figure
RUN_HEADS = ("simulation", "level", "bricks", "steps", "seconds", "health")


def write_page(out: Path, page: Path) -> list[str]:
    """Update every marked part of ``page`` whose figure is in ``out``; returns the names of these figures.

    Raises
    ------
    FileNotFoundError
        If ``out`` has no index, or the page does not exist.
    MissingPart
        If the page lacks one pair of marks for a figure of the index (except Fig. 4, which is only theory). The page is
        then unchanged.
    """
    figures = read_json(out / "summary.json", FigureIndex, CURE_TEXT)["figures"]
    text = page.read_text(encoding="utf-8")
    figure_names = [figure_name for figure_name in figures if figure_name in PART_MAKERS and figure_name != "fig4"]
    for figure_name in figure_names:
        parts = PART_MAKERS[figure_name](read_tables(out, figures[figure_name]["files"]))
        paragraphs = paragraphs_of(page, figure_name, parts, figures[figure_name]["simulations"])
        text = renewed(page, text, {figure_name: paragraphs})
        for file in figures[figure_name]["files"]:
            if file.endswith(".png"):
                with atomic_file(page.parent / file) as temporary_path:
                    temporary_path.write_bytes(png_bytes(halved(read_png(out / file))))
    write_text(page, text)
    return figure_names


def paragraphs_of(
    page: Path, figure_name: str, parts: Sequence[Image | Table], simulations: Sequence[dict[str, Any]]
) -> list[str]:
    """The part of a figure; its tables that have a name are written beside the page."""
    tables = [part for part in parts if isinstance(part, Table) and part.name]
    if not tables:
        return [*map(_markdown, parts), health(simulations)]
    paragraphs = [_markdown(part) for part in parts if isinstance(part, Image) and part.name not in LINKED_PICTURES]
    paragraphs += [shown_rows(table) for table in tables if table.name in SHOWN]
    for table in tables:
        markdown.table_with_tsv(page, table.name, table.heads, table.rows, lambda row_cells: False)
    runs_name, n_healthy = f"{figure_name}-runs", sum(run["healthy"] for run in simulations)
    markdown.table_with_tsv(page, runs_name, RUN_HEADS, [*map(_run_cells, simulations)], lambda row_cells: False)
    links = [_link(f"{page.stem}-{table.name}.tsv") for table in tables]
    links += [_link(f"{part.name}.png") for part in parts if isinstance(part, Image) and part.name in LINKED_PICTURES]
    runs_text = f"Simulations, {n_healthy} of {len(simulations)} healthy: {_link(f'{page.stem}-{runs_name}.tsv')}."
    return [*paragraphs, f"More: {', '.join(links)}. {runs_text}"]


def shown_rows(table: Table) -> str:
    """What of a table in ``SHOWN`` stands in the page."""
    shown = SHOWN[table.name]
    heads = shown.heads.split(" | ")
    columns = [[*table.heads].index(head) for head in heads]  # the first of those with the same head
    rows = [[row_cells[column] for column in columns] for row_cells in table.rows if shown.is_shown(row_cells)]
    return markdown.table(heads, rows)


def _run_cells(run: dict[str, Any]) -> list[str]:
    size_texts = [f"{run[key]}" if run["elements"] else "–" for key in ("elements", "steps")]
    health_text = "healthy" if run["healthy"] else "; ".join(run["warnings"])
    return [run["folder"].rpartition("/")[2], run["level"], *size_texts, f"{run['seconds']:.0f}", health_text]


def _link(file_name: str) -> str:
    return f"[{file_name}]({file_name})"


def _markdown(part: Image | Table) -> str:
    return (
        f"![{part.description}]({part.name}.png)" if isinstance(part, Image) else markdown.table(part.heads, part.rows)
    )


if __name__ == "__main__":
    print(*write_page(Path(sys.argv[1]), Path(sys.argv[2])))
