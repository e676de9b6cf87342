"""Tables written and read back: each value in its cell, and a table cut short refused."""

import csv
import re
import tempfile
from pathlib import Path
from unicodedata import category

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from morphofold.errors import DamagedFile
from morphofold.tables import read_table, write_table


def test_numbers_texts_and_what_is_missing_come_back(tmp_path):
    rows = [{"name": "a", "n": np.int64(3), "x": 0.5}, {"name": "007", "x": np.nan, "later": True}]
    write_table(tmp_path / "t.tsv", ("name", "n", "x"), rows)
    assert (tmp_path / "t.tsv").read_text() == "name\tn\tx\tlater\na\t3\t0.5\tn/a\n007\tn/a\tn/a\t1\n"
    assert read_table(tmp_path / "t.tsv", {"name"}) == [
        {"name": "a", "n": 3, "x": 0.5, "later": None},
        {"name": "007", "n": None, "x": None, "later": 1},
    ]


def test_a_table_cut_short_is_refused(tmp_path):
    table = tmp_path / "regions.tsv"
    write_table(table, ("region", "n"), [{"region": name, "n": 1} for name in ("front", "middle", "back")])
    whole = table.read_text()
    for end in range(len(whole)):
        if not whole[:end].endswith("\n"):  # a line too few is still a table
            table.write_text(whole[:end])
            with pytest.raises(DamagedFile, match=r"regions\.tsv: \D*$"):
                read_table(table)
    table.write_text(whole.replace("middle\t1", "middle"))
    with pytest.raises(DamagedFile, match=r"regions\.tsv: \D*\b3\b"):
        read_table(table)
    table.unlink()
    with pytest.raises(FileNotFoundError, match=r"regions\.tsv: "):
        read_table(table)


ODD = "n/a|'n/a|nan|1e5|007||=1+1|+x|-x|@x|'=x|''@|\"x|\"a\tb\"|a\nb|'|x'| x |True|1_000|inf|\x1c|\x85".split("|")
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(ODD)


@settings(deadline=None)
@given(st.lists(st.tuples(TEXTS, st.none() | st.floats(allow_nan=False) | st.integers(-(10**17), 10**17)), min_size=1))
def test_text_and_numbers_come_back_and_every_reader_finds_the_same_cells(rows):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.tsv"
        write_table(path, ("name", "x"), [{"name": name, "x": x} for name, x in rows])
        raw = path.read_bytes().decode()
        table = read_table(path, {"name"}, len(rows), number_columns={"x"})
        python = list(csv.reader(raw.split("\n")[:-1], delimiter="\t"))
    cells = [line.split("\t") for line in raw.split("\n")[:-1]]  # as cut and awk have them
    assert python == cells
    assert {len(line) for line in cells} == {2}
    for (name, x), (cell, _), row in zip(rows, cells[1:], table):
        assert not cell.startswith(("=", "+", "-", "@", '"'))
        assert not any(category(c) == "Cc" for c in cell)
        plain = "".join(" " if category(c) in ("Cc", "Zl", "Zp") else c for c in name)
        assert row["name"] == plain
        finite = x is not None and np.isfinite(x)
        assert row["x"] == (pytest.approx(x, rel=1e-6) if finite else None)


def test_a_column_of_numbers_holds_nothing_else(tmp_path):
    table = tmp_path / "t.tsv"
    for text in ("x", "", "nan", "inf", "1e999", "1_0", "0x1", "True", "'1", " 1", "--1", "1,5"):
        table.write_text(f"a\tb\n1\t{text}\n")
        assert read_table(table, {"b"})[0]["b"] == text
        with pytest.raises(DamagedFile, match=rf"t\.tsv: \D*\b2: b\b.*{re.escape(repr(text))}"):
            read_table(table, number_columns={"b"})
    table.write_text("a\tb\nn/a\t-1.5e-3\n")
    assert read_table(table, number_columns={"a", "b"}) == [{"a": None, "b": -1.5e-3}]


def test_heads_follow_the_rule_too_and_odd_names_stay_in_their_cells(tmp_path):
    write_table(tmp_path / "t.tsv", ("name",), [{"name": "odd\tname\nof it"}])
    assert read_table(tmp_path / "t.tsv") == [{"name": "odd name of it"}]
    write_table(tmp_path / "t.tsv", ("measure", "=a\tb"), [{"measure": "x", "=a\tb": "\udcff"}])
    assert (tmp_path / "t.tsv").read_text() == "measure\t'=a b\nx\t\\udcff\n"
    assert list(read_table(tmp_path / "t.tsv")[0]) == ["measure", "=a b"]
