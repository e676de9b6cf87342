"""Writes the tables of docs/hard-cases.md from runs of the hard cases, and two tables beside it: every bound
(hard-cases.tsv), and every case with its guard (hard-cases-guards.tsv).

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

PAGE_COLUMNS = ("case", "kept by", "without the guard", "other programs")
GUARD_COLUMNS = ("group", "case", "kept by", "bounds", "one of them", "without the guard", "other programs")
TSV_COLUMNS = ("group", "case", "what", "bound", "measured", "guard", "without_the_guard", "other_programs")
MAX_CELL_CHARS = 110  # characters of a cell of the page; the tables beside it have them whole
#: cases of the page, by group
SHOWN = {
    "solver": (
        "NaN injected in one node",
        "a time step forced too large",
        "1 and 2 threads",
        "sulci of a hemisphere that crease within one brick",
        "two bodies of folds meeting head on",
    ),
    "laws": (
        "a scene turned and shifted",
        "mirror symmetry of a symmetric scene",
        "linear momentum without supports",
        "volume of the cortex follows det G",
        "energy balance of growth, folding and contact",
    ),
    "surfaces": (
        "a hole of one triangle",
        "coordinates in metres or micrometres",
        "300 needle or cap triangles, a millionth of an edge thin",
        "a medial wall that nothing marks, with noise of 0.1 mm on every coordinate",
        "self-intersection: walls of a sulcus that pass through each other",
    ),
    "files": (
        "surfaces cut before every tenth byte: FreeSurfer, GIFTI, PLY, STL, OFF, GLB, VTK, VTP, VTU",
        "a bit flipped at every 60th (20th) byte of every format",
        "a disk that is full after each fifth of a surface, map, annotation, or a file of an analysis",
        "a writer of a surface, map or annotation killed before each step, and within writes",
        "every seventh bit of a checkpoint flipped, one at a time",
    ),
}


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


def cases(bound_rows: list[Row]) -> list[Row]:
    """A row for every case."""
    rows_of_case: dict[tuple[str, str], list[Row]] = {}
    for row in bound_rows:
        rows_of_case.setdefault((row["group"], row["case"]), []).append(row)
    case_rows = []
    for (group, case), rows in rows_of_case.items():
        example_row = next((row for row in rows if row["bound"] not in ("equal", "")), rows[0])
        example = f"{example_row['what']}: {example_row['measured']} ({example_row['bound']})"
        firsts = {column: next((row[column] for row in rows if row[column]), "") for column in TSV_COLUMNS}
        last_cells = [firsts["without_the_guard"], firsts["other_programs"]]
        cells = [group, case, firsts["guard"], str(len(rows)), example, *last_cells]
        case_rows.append(dict(zip(GUARD_COLUMNS, cells, strict=True)))
    return case_rows


def part(case_rows: list[Row], shown: tuple[str, ...], tsv_name: str) -> list[str]:
    """The part of the page on a group: some cases, and how many there are."""
    row_of_case = {row["case"]: row for row in case_rows}
    lines = [[_short(row_of_case[case][column]) for column in PAGE_COLUMNS] for case in shown]
    n_bounds = sum(int(row["bounds"]) for row in case_rows)
    count_text = f"{len(shown)} of {len(case_rows)} cases, which have {n_bounds} bounds: [{tsv_name}]({tsv_name})."
    return [table(PAGE_COLUMNS, lines), count_text]


def _plain(text: str | None) -> str:
    return re.sub(r"/\S*/pytest-of-\w+/pytest-\d+/[^/\s]+/", "", " ".join((text or "").split()))


def _short(text: str) -> str:
    text = text.replace("|", "/")
    return text if len(text) <= MAX_CELL_CHARS else text[: MAX_CELL_CHARS - 1] + "…"


def write_page(page: Path, bound_rows: list[Row]) -> None:
    """Update the page and the tables beside it."""
    case_rows, guard_file = cases(bound_rows), page.with_name(f"{page.stem}-guards.tsv")
    of_group = {group: [row for row in case_rows if row["group"] == group] for group in SHOWN}
    update_page(page, {group: part(of_group[group], SHOWN[group], guard_file.name) for group in SHOWN})
    _write_tsv(page.with_suffix(".tsv"), TSV_COLUMNS, bound_rows)
    _write_tsv(guard_file, GUARD_COLUMNS, case_rows)


def _write_tsv(path: Path, columns: tuple[str, ...], rows: list[Row]) -> None:
    with atomic_file(path) as temp_path, temp_path.open("w", encoding="utf-8", newline="") as out:
        tsv_writer = csv.DictWriter(
            out, columns, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_NONE, quotechar=None
        )
        tsv_writer.writeheader()
        tsv_writer.writerows(rows)


def main(*files: str, page_path: str) -> None:
    test_of_id: Row = {}
    for file in files:
        test_of_id |= json.loads(Path(file).read_text(encoding="utf-8"))
    write_page(Path(page_path), rows_of(test_of_id))


if __name__ == "__main__":
    main(*sys.argv[1:-1], page_path=sys.argv[-1])
