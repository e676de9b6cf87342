"""Odd names and numbers in what users hand over: one line that names the place, and plain cells in tables."""

import json
import re

import pytest
from hard_cases.cases import hard_case
from made_measures import made_measures

from morphofold import tables
from morphofold.cli import main
from morphofold.comparison import compare
from morphofold.errors import DamagedFile, NotReadable
from morphofold.io import read_cortex
from morphofold.results import read_analysis, write_analysis

NAMES = ("a\nb", "\x1b[2Ja", "\u202eabc", "\udcff")


@hard_case(
    "files",
    "names of files and options with line ends, escapes that steer terminals, or bytes that are no text",
    guard="all but letters is escaped",
    without=lambda patch: patch.setattr("morphofold.cli.one_line", str),
    fails=(AssertionError, UnicodeEncodeError),
)
def test_names(holds, cwd, capsys):
    wrong = []
    for name in NAMES:
        for argv in (["analyze", name], ["simulate", name], ["compare", f"{name}={name}"], ["cohort", name], [name]):
            code, captured = main(argv), capsys.readouterr()
            if code != 2 or captured.out or not captured.err[:-1].isprintable():
                wrong.append((argv, code, captured.err))
    holds("refusals of more than one line, or with anything to steer by", len(wrong), at_most=0)


def unchecked(patch):
    for reader in ("io.cortices", "results.analyses"):
        patch.setattr(f"morphofold.{reader}.read_json", lambda path, *more, **options: json.loads(path.read_text()))


@hard_case(
    "files",
    "a stage record or a summary whose numbers are texts, lists, NaN, true or beyond all measure",
    peers="a JSON is taken as it comes (read)",
    guard="a schema of each file",
    without=unchecked,
    fails=(AssertionError, TypeError, ValueError, OverflowError, pytest.fail.Exception),
)
def test_numbers(holds, cwd):
    analysis = write_analysis([made_measures(level=1)], cwd / "analysis", report=False)
    summary, record = analysis / "summary.json", analysis / "stage.json"

    def refused(path, text, key, value, read):
        path.write_text(text)
        kind, word = (DamagedFile, "line") if value == "NaN" else (NotReadable, key)
        with pytest.raises(kind) as caught:
            read()
        holds.says(f"{key} {value}", str(caught.value).replace(str(analysis), ""), path.name, word)

    whole, key = summary.read_text(), "mean_cortical_thickness_mm"
    for value in ('"x"', "[]", "NaN", "true", "1e999"):
        text = re.sub(rf'("{key}": )[\d.]+', rf"\g<1>{value}", whole)
        refused(summary, text, key, value, lambda: compare({"a": read_analysis(analysis)}).to_dict())
    summary.unlink()
    for key, value in {"warnings": "5", "g": "NaN", "portion": "1e-300", "mu_ratio": "1e308", "health": "[]"}.items():
        text = f'{{"g": 1.8, "portion": 1.0, "{key}": {value}}}'
        refused(record, text, key, value, lambda: read_cortex(analysis))


@hard_case(
    "files",
    "regions and subjects named as formulas, with tabs or line ends, n/a, or in quotation marks",
    guard="one rule for cells",
    without=lambda patch: patch.setattr(tables, "cell", lambda value: "n/a" if value is None else str(value)),
    fails=(AssertionError, ValueError),
)
def test_cells(holds, tmp_path):
    names = ["=1+1", "+a", "-a", "@a", '"a', "n/a", "'=a", "a\tb", "a\nb", "a\rb", "1e5", "nan", "007", None]
    path = tmp_path / "t.tsv"
    tables.write_table(path, ("name", "x"), [{"name": name, "x": -1.5} for name in names])
    cells = [line.split("\t")[0] for line in path.read_text().split("\n")[1:-1]]
    holds("formulas and quotations", sum(cell[:1] in tuple('=+-@"') for cell in cells), at_most=0)
    back = [row["name"] for row in tables.read_table(path, {"name"}, len(names))]
    holds.equal("names read back", back, [name and re.sub(r"[\t\n\r]", " ", name) for name in names])
