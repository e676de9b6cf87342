"""Tables written and read back: each value in its cell, and a table cut short refused."""

import numpy as np
import pytest

from morphofold.tables import read_table, write_table


def test_numbers_words_and_what_is_missing_come_back(tmp_path):
    rows = [{"name": "a", "n": np.int64(3), "x": 0.5}, {"name": "007", "x": np.nan, "later": True}]
    write_table(tmp_path / "t.tsv", ("name", "n", "x"), rows)
    assert (tmp_path / "t.tsv").read_text() == "name\tn\tx\tlater\na\t3\t0.5\tn/a\n007\tn/a\tn/a\t1\n"
    assert read_table(tmp_path / "t.tsv", {"name"}) == [
        {"name": "a", "n": 3, "x": 0.5, "later": None},
        {"name": "007", "n": None, "x": None, "later": 1},
    ]


def test_a_name_with_tabs_and_breaks_stays_in_its_cell(tmp_path):
    write_table(tmp_path / "t.tsv", ("name",), [{"name": "odd\tname\nhere"}])
    assert read_table(tmp_path / "t.tsv") == [{"name": "odd name here"}]


def test_a_table_cut_short_is_refused(tmp_path):
    table = tmp_path / "regions.tsv"
    write_table(table, ("region", "n"), [{"region": name, "n": 1} for name in ("front", "middle", "back")])
    whole = table.read_text()
    for end in range(len(whole)):
        if not whole[:end].endswith("\n"):                              # a line too few is still a table
            table.write_text(whole[:end])
            with pytest.raises(ValueError, match=r"regions\.tsv: was cut"):
                read_table(table)
    table.write_text(whole.replace("middle\t1", "middle"))
    with pytest.raises(ValueError, match=r"regions\.tsv: line 3 has another number of cells"):
        read_table(table)
    table.unlink()
    with pytest.raises(FileNotFoundError, match=r"regions\.tsv: missing from the analysis"):
        read_table(table)
