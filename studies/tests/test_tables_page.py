"""docs/tables.md lists every column of every table."""

from pathlib import Path

import pytest

from morphofold.analysis.measures import FRAMES
from morphofold.quantities import COLUMN_WORDS, SCALAR_WORDS
from morphofold.studies.pages.table_page import write

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tables.md"


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
def test_the_page_is_what_the_code_says(tmp_path):
    copy = tmp_path / PAGE.name
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    write(copy)
    assert copy.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_every_column_has_a_meaning_in_words():
    assert {column for columns in FRAMES.values() for column in columns} <= {*COLUMN_WORDS, *SCALAR_WORDS}
