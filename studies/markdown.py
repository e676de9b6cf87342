"""Generated parts of Markdown pages: tables from a folder of results, written between marks."""

import csv
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.errors import MissingPart
from morphofold.io.files import write_text

Row = dict[str, Any]
#: columns of tables that hold text
TEXT_COLUMNS = ("scene", "source", "level", "portion", "law", "layer", "note", "reason", "coarser", "finer", "number")


def between_marks(text: str, mark: str, paragraphs: Sequence[str], page: Path) -> str:
    """The text with new paragraphs between the marks ``<!-- name -->`` and ``<!-- /name -->``.

    Raises
    ------
    MissingPart
        If there is not exactly one pair of these marks; the message names the page.
    """
    begin_mark, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    if text.count(begin_mark) != 1 or text.count(end) != 1 or text.index(begin_mark) > text.index(end):
        raise MissingPart(f"{page}: has not exactly one place for {mark}; mark it with {begin_mark} and, below, {end}.")
    text_before, text_after = text.split(begin_mark)
    return "\n\n".join([text_before + begin_mark, *paragraphs, end + text_after.split(end)[1]])


def renewed(page: Path, text: str, parts: Mapping[str, Sequence[str]]) -> str:
    """The text of a page with the paragraphs of each part between its marks; raises as :func:`between_marks`."""
    for mark, paragraphs in parts.items():
        text = between_marks(text, mark, paragraphs, page)
    return text


def update_page(page: Path, parts: Mapping[str, Sequence[str]]) -> None:
    """Write the page with the paragraphs of each part between its marks; if marks are missing, it stays as it is."""
    write_text(page, renewed(page, page.read_text(encoding="utf-8"), parts))


def read_rows(path: Path, text_columns: Collection[str] = TEXT_COLUMNS) -> list[Row]:
    """Rows of a table with numbers as floats, and None for missing values."""
    with path.open(encoding="utf-8", newline="") as tsv_file:
        rows = list(csv.DictReader(tsv_file, delimiter="\t", quoting=csv.QUOTE_NONE))
    return [{k: v if k in text_columns else None if v == "n/a" else float(v) for k, v in row.items()} for row in rows]


def table(heads: str | Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; its heads are a list, or a text with `` | `` between them."""
    heads = heads.split(" | ") if isinstance(heads, str) else heads
    table_rows = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in table_rows)


def table_with_tsv(
    page: Path, name: str, heads: str | Sequence[str], rows: Sequence[Sequence[str]], shown: Callable[[list[str]], bool]
) -> str:
    """Write all rows to ``PAGE-name.tsv`` beside the page; a Markdown table of those that are shown, and a link."""
    heads = heads.split(" | ") if isinstance(heads, str) else heads
    tsv_file = page.with_name(f"{page.stem}-{name}.tsv")
    write_text(tsv_file, "".join("\t".join(cells) + "\n" for cells in (heads, *rows)))
    shown_rows = [cells for cells in rows if shown([*cells])]
    return f"{table(heads, shown_rows)}\n\nAll {len(rows)} rows: [{tsv_file.name}]({tsv_file.name})."


def number(value: float | None, number_format: str) -> str:
    """A number in the format ``number_format``; a dash if it is missing."""
    return "–" if value is None else number_format.format(value).replace("-", "−")


def cells(rows: Iterable[Row], format_of: Mapping[str, str]) -> list[list[str]]:
    """A line per row: each column by :func:`number` in its format, or, without a format, as text."""
    return [[number(row[column], fmt) if fmt else row[column] for column, fmt in format_of.items()] for row in rows]


MAX_LISTED = 12  # simulations of a figure that are listed one by one


def health(simulations: Sequence[dict[str, Any]]) -> str:
    """A line per simulation of an index, with its warnings; of many, one line and those that are not healthy."""
    if len(simulations) > MAX_LISTED:
        return _health_of_many(simulations)
    bullet_lines = []
    for entry in simulations:
        size_text = f"{entry['elements']:,} bricks, {entry['steps']:,} steps, " if entry["elements"] else ""
        state_text = "healthy" if entry["healthy"] else "**not healthy**: " + "; ".join(entry["warnings"])
        bullet_lines.append(f"- `{_name(entry)}`, {entry['level']}: {size_text}{entry['seconds']:.0f} s, {state_text}")
    return "\n".join(bullet_lines)


def _health_of_many(simulations: Sequence[dict[str, Any]]) -> str:
    n_bricks, n_steps = ([entry[count_key] for entry in simulations] for count_key in ("elements", "steps"))
    sick = [entry for entry in simulations if not entry["healthy"]]
    causes = ["; ".join(warning.partition(":")[0] for warning in entry["warnings"]) for entry in sick]
    intro = (
        f"{len(simulations)} simulations, {simulations[0]['level']}: {min(n_bricks):,} to {max(n_bricks):,} bricks, "
        f"{min(n_steps):,} to {max(n_steps):,} steps; {len(simulations) - len(sick)} are healthy."
    )
    return "\n".join([intro, *([""] if sick else []), *(f"- `{_name(e)}`: {cause}" for e, cause in zip(sick, causes))])


def _name(entry: dict[str, Any]) -> str:
    return str(entry["folder"]).rpartition("/")[2]
