"""Writes the tables of docs/hard-cases.md, and docs/hard-cases.tsv with every bound, from runs of the hard cases.

``python -m morphofold.studies.pages.hard_case_page FILE... docs/hard-cases.md``; FILE is what
``pytest tests/hard_cases -m "" --hard-cases FILE`` wrote. A test that is in several files counts as the last of them
has it.
"""

import csv
import json
import re
import sys
from pathlib import Path

from morphofold.digests_and_json import Row
from morphofold.io import atomic_file
from morphofold.studies.markdown import table, update_page

COLUMN_HEADS = ("case", "kept by", "bounds", "one of them", "without the guard", "other programs")
TSV_COLUMNS = ("group", "case", "what", "bound", "measured", "guard", "without_the_guard", "other_programs")
MAX_CELL_CHARS = 110  # characters of a cell of the page; the table of all bounds has them whole


def rows_of(test_of_id: Row) -> list[Row]:
    """A row for every bound, by test; the first row of a test says how the test ends without its guard."""
    unguarded_text = {
        test_id.replace("[unguarded", "[guarded"): text
        for test_id, test in test_of_id.items()
        for text in test["records"]
        if isinstance(text, str)
    }
    bound_rows = []
    for test_id, test in test_of_id.items():
        assert test["outcome"] == "passed", f"{test_id} did not pass: the page is made of a run in which all do"
        records = [row for row in test["records"] if not isinstance(row, str) and not row["unguarded"]]
        for k, row in enumerate(records):
            end_text = unguarded_text.get(test_id, "") if k == 0 else ""
            cells = [row[key] for key in ("group", "case", "what", "bound", "measured", "guard")]
            bound_rows.append(
                dict(zip(TSV_COLUMNS, map(_plain, [*cells, end_text, row["peers"] if k == 0 else ""]), strict=True))
            )
    return bound_rows


def summary(bound_rows: list[Row]) -> dict[str, list[list[str]]]:
    """Lines of the page by group: one for each case."""
    rows_of_case: dict[tuple[str, str], list[Row]] = {}
    for row in bound_rows:
        rows_of_case.setdefault((row["group"], row["case"]), []).append(row)
    lines_of_group: dict[str, list[list[str]]] = {}
    for (group, case), rows in rows_of_case.items():
        example_row = next((row for row in rows if row["bound"] not in ("equal", "")), rows[0])
        example = f"{example_row['what']}: {example_row['measured']} ({example_row['bound']})"
        firsts = {column: next((row[column] for row in rows if row[column]), "") for column in TSV_COLUMNS}
        cells = [case, firsts["guard"], str(len(rows)), example, firsts["without_the_guard"], firsts["other_programs"]]
        lines_of_group.setdefault(group, []).append([_short(text) for text in cells])
    return lines_of_group


def _plain(text: str | None) -> str:
    return re.sub(r"/\S*/pytest-of-\w+/pytest-\d+/[^/\s]+/", "", " ".join((text or "").split()))


def _short(text: str) -> str:
    text = text.replace("|", "/")
    return text if len(text) <= MAX_CELL_CHARS else text[: MAX_CELL_CHARS - 1] + "…"


def main(*files: str, page_path: str) -> None:
    test_of_id: Row = {}
    for file in files:
        test_of_id |= json.loads(Path(file).read_text(encoding="utf-8"))
    bound_rows, path = rows_of(test_of_id), Path(page_path)
    update_page(path, {group: [table(COLUMN_HEADS, lines)] for group, lines in summary(bound_rows).items()})
    with atomic_file(path.with_suffix(".tsv")) as temp_path, temp_path.open("w", encoding="utf-8", newline="") as out:
        tsv_writer = csv.DictWriter(
            out, TSV_COLUMNS, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_NONE, quotechar=None
        )
        tsv_writer.writeheader()
        tsv_writer.writerows(bound_rows)


if __name__ == "__main__":
    main(*sys.argv[1:-1], page_path=sys.argv[-1])
