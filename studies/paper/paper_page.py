"""The generated parts of docs/figures.md: tables and pictures from the results of ``morphofold reproduce``.

``python -m morphofold.studies.paper.paper_page OUT PAGE`` writes those of the folder OUT between marks such as
``<!-- fig5 -->`` and ``<!-- /fig5 -->`` of the Markdown page PAGE, and the pictures, at half the size, beside it. Text
outside of the marks is written by hand.
"""

import sys
from pathlib import Path

from morphofold.io import atomic_file
from morphofold.io.files import write_text
from morphofold.io.json_files import read_json
from morphofold.report.pictures.pixel_canvas import halved, png_bytes, read_png
from morphofold.studies import markdown
from morphofold.studies.index_schemas import CURE_TEXT, FigureIndex
from morphofold.studies.markdown import health, renewed
from morphofold.studies.paper.figure_parts import PART_MAKERS, Image, Table, read_tables


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
        part_texts = map(_markdown, PART_MAKERS[figure_name](read_tables(out, figures[figure_name]["files"])))
        text = renewed(page, text, {figure_name: [*part_texts, health(figures[figure_name]["simulations"])]})
        for file in figures[figure_name]["files"]:
            if file.endswith(".png"):
                with atomic_file(page.parent / file) as temporary_path:
                    temporary_path.write_bytes(png_bytes(halved(read_png(out / file))))
    write_text(page, text)
    return figure_names


def _markdown(part: Image | Table) -> str:
    return (
        f"![{part.description}]({part.name}.png)" if isinstance(part, Image) else markdown.table(part.heads, part.rows)
    )


if __name__ == "__main__":
    print(*write_page(Path(sys.argv[1]), Path(sys.argv[2])))
