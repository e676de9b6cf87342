"""Generated parts of Markdown pages: tables from a folder of results, written between marks."""

import csv
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphofold.errors import MissingPart
from morphofold.io.files import write_text

Row = dict[str, Any]
#: columns of tables that hold text
TEXT_COLUMNS = ("scene", "source", "level", "portion", "law", "layer", "note", "reason", "coarser", "finer", "number")


def between_marks(text: str, name: str, paragraphs: Sequence[str], page: Path) -> str:
    """The text with new paragraphs between the marks ``<!-- name -->`` and ``<!-- /name -->``.

    Raises
    ------
    MissingPart
        If there is not exactly one pair of these marks; the message names the page.
    """
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise MissingPart(f"{page}: has not exactly one place for {name}; mark it with {begin} and, below, {end}.")
    text_before, text_after = text.split(begin)
    return "\n\n".join([text_before + begin, *paragraphs, end + text_after.split(end)[1]])


def renewed(page: Path, text: str, parts: Mapping[str, Sequence[str]]) -> str:
    """The text of a page with the paragraphs of each part between its marks; raises as :func:`between_marks`."""
    for name, paragraphs in parts.items():
        text = between_marks(text, name, paragraphs, page)
    return text


def update_page(page: Path, parts: Mapping[str, Sequence[str]]) -> None:
    """Write the page with the paragraphs of each part between its marks; if marks are missing, it stays as it is."""
    write_text(page, renewed(page, page.read_text(encoding="utf-8"), parts))


def read_rows(path: Path, text_columns: Collection[str] = TEXT_COLUMNS) -> list[Row]:
    """Rows of a table with numbers as floats, and None for missing values."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
    return [{k: v if k in text_columns else None if v == "n/a" else float(v) for k, v in row.items()} for row in rows]


def table(heads: str | Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; its heads are a list, or a text with `` | `` between them."""
    heads = heads.split(" | ") if isinstance(heads, str) else heads
    table_rows = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in table_rows)


def number(value: float | None, how: str) -> str:
    """A number in the format ``how``; a dash if it is missing."""
    return "–" if value is None else how.format(value).replace("-", "−")


def cells(rows: Iterable[Row], columns: Mapping[str, str]) -> list[list[str]]:
    """A line per row: each column by :func:`number` in its format, or, without a format, as text."""
    return [[number(row[name], form) if form else row[name] for name, form in columns.items()] for row in rows]


MAX_LISTED = 12  # simulations of a figure that are listed one by one


def health(simulations: Sequence[dict[str, Any]]) -> str:
    """A line per simulation of an index, with its warnings; of many, one line and those that are not healthy."""
    if len(simulations) > MAX_LISTED:
        return _health_of_many(simulations)
    lines = []
    for entry in simulations:
        size_text = f"{entry['elements']:,} bricks, {entry['steps']:,} steps, " if entry["elements"] else ""
        state_text = "healthy" if entry["healthy"] else "**not healthy**: " + "; ".join(entry["warnings"])
        lines.append(f"- `{_name(entry)}`, {entry['level']}: {size_text}{entry['seconds']:.0f} s, {state_text}")
    return "\n".join(lines)


def _health_of_many(simulations: Sequence[dict[str, Any]]) -> str:
    bricks, steps = ([entry[name] for entry in simulations] for name in ("elements", "steps"))
    ill = [entry for entry in simulations if not entry["healthy"]]
    reasons = ["; ".join(warning.partition(":")[0] for warning in entry["warnings"]) for entry in ill]
    first_line = (
        f"{len(simulations)} simulations, {simulations[0]['level']}: {min(bricks):,} to {max(bricks):,} bricks, "
        f"{min(steps):,} to {max(steps):,} steps; {len(simulations) - len(ill)} are healthy."
    )
    return "\n".join([first_line, *([""] if ill else []), *(f"- `{_name(e)}`: {why}" for e, why in zip(ill, reasons))])


def _name(entry: dict[str, Any]) -> str:
    return str(entry["folder"]).rpartition("/")[2]
