"""Writes the tables of docs/hard-cases.md: ``python tests/hard_cases/page.py FILE... docs/hard-cases.md``.

FILE is what ``pytest tests/hard_cases -m "" --hard-cases FILE`` wrote.
"""

import json
import re
import sys
from pathlib import Path

from morphofold.io import atomic_file
from morphofold.studies.markdown import between_marks, table

HEADS = ("case", "what", "bound", "measured", "without the guard", "peers")
LONGEST = 160  # characters of a message in a cell


def rows_of(tests):
    """Cells of the table by group, tests in the order of their names, each with its broken bound beside."""
    broken = {
        node.replace("[unguarded", "[guarded"): text
        for node, test in tests.items()
        for text in test["told"]
        if isinstance(text, str)
    }
    found = {}
    for node, test in tests.items():
        assert test["outcome"] == "passed", f"{node} did not pass: the page is made of a run in which all do"
        told = [row for row in test["told"] if not isinstance(row, str)]
        for k, row in enumerate(row for row in told if not row["unguarded"]):
            without = f"{broken[node]} ({row['guard']})" if k == 0 and node in broken else ""
            cells = [row["case"], row["what"], row["bound"], row["measured"], without, row["peers"] if k == 0 else ""]
            found.setdefault(row["group"], []).append([_cell(text) for text in cells])
    return found


def _cell(text):
    text = re.sub(r"/\S*/pytest-of-\w+/pytest-\d+/[^/\s]+/", "", " ".join(text.split())).replace("|", "/")
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def main(*files, page):
    tests = {}
    for file in files:  # a later run of a test counts
        tests |= json.loads(Path(file).read_text(encoding="utf-8"))
    groups = rows_of(tests)
    page = Path(page)
    text = page.read_text(encoding="utf-8")
    for group, rows in groups.items():
        text = between_marks(text, group, [table(HEADS, rows)], page)
    with atomic_file(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:-1], page=sys.argv[-1])
