"""The tables of docs/hard-cases.md are those of all its bounds, and its sentences have their numbers."""

import csv
import shutil

import pytest

from morphofold.sim.stage_checks import BOUNDS
from morphofold.studies.page_sentences import Page
from morphofold.studies.pages.hard_case_page import SHOWN, write_page

PAGE = Page("hard-cases")


def test_the_page_and_the_table_of_cases_follow_from_the_table_of_bounds(tmp_path):
    table_of_bounds = PAGE.path.with_suffix(".tsv")
    with table_of_bounds.open(encoding="utf-8", newline="") as tsv_file:
        bound_rows = list(csv.DictReader(tsv_file, delimiter="\t", quoting=csv.QUOTE_NONE))
    shutil.copy(PAGE.path, tmp_path)
    write_page(tmp_path / PAGE.path.name, bound_rows)
    for written in (PAGE.path, table_of_bounds, PAGE.path.with_name("hard-cases-guards.tsv")):
        assert (tmp_path / written.name).read_bytes() == written.read_bytes()


def test_what_the_page_counts():
    cases = PAGE.tsv_rows("guards")
    PAGE.assert_sentence("# cases with # bounds", len(cases), sum(row["bounds"] for row in cases))
    assert all(len(shown) == 5 for shown in SHOWN.values())
    assert "five cases of each group" in PAGE.prose
    PAGE.assert_sentence("compressed by more than the # % that health allows", 100 * BOUNDS["volume_drift"][0])


def test_a_page_without_its_cases_is_not_written(tmp_path):
    shutil.copy(PAGE.path, tmp_path)
    with pytest.raises(KeyError, match=SHOWN["solver"][0]):
        write_page(tmp_path / PAGE.path.name, [])
    assert [path.name for path in tmp_path.iterdir()] == [PAGE.path.name]
