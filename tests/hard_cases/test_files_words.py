"""What is said and written of odd names, odd numbers and odd streams: one line, plain cells, and the work is done."""

import json
import os
import re

import pytest
from hard_cases.cases import hard_case
from made_measures import made_measures

from morphofold import tables
from morphofold.cli import main
from morphofold.comparison import compare
from morphofold.errors import DamagedFile, NotReadable, WrongFile
from morphofold.io import cortices, read_cortex
from morphofold.results import read_analysis, write_analysis

NAMES = ("a\nb", "\x1b[2Ja", "\x7f\x01", "\u202eabc", "\udcff", "a\r\nb\u2028c")


@pytest.fixture
def analysis(here):
    return write_analysis([made_measures(level=1)], here / "analysis", report=False)


@hard_case(
    "files",
    "names of files and options with line ends, escapes that steer terminals, or bytes that are no text",
    guard="all but letters is escaped",
    without=lambda patch: patch.setattr("morphofold.cli.one_line", str),
    fails=(AssertionError, UnicodeEncodeError),
)
def test_names(holds, here, capsys):
    wrong = []
    for name in NAMES:
        for argv in (
            ["analyze", name],
            ["simulate", name],
            ["compare", name],
            ["compare", f"{name}={name}"],
            ["cohort", name],
            ["theory", "radius", "--growth", name],
            ["unfold", name],
            [name],
        ):
            code, captured = main(argv), capsys.readouterr()
            if code != 2 or captured.out or not captured.err[:-1].isprintable():
                wrong.append((argv, code, captured.err))
    holds("refusals of more than one line, or with anything to steer by", len(wrong), at_most=0)


def only_files(root, place, stem, endings=("",)):
    return next((f for e in endings if (f := root / place / f"{stem}{e}").is_file()), None)


@pytest.mark.parametrize(
    "name", ["surf/lh.thickness", "surf/lh.curv", "surf/lh.inflated", "label/lh.aparc.annot", "label/lh.cortex.label"]
)
@hard_case(
    "files",
    "an optional file of a subject that is a folder or a link to nothing",
    guard="looked at, not for",
    without=lambda patch: patch.setattr(cortices, "_file_in", only_files),
    fails=pytest.fail.Exception,
)
def test_optional(name, holds, analysis, capsys):
    path = analysis / name
    (analysis / "summary.json").unlink()  # which would name its annotation
    for make in (os.mkdir, lambda path: os.symlink("nowhere", path)):
        path.unlink(missing_ok=True)
        make(path)
        with pytest.raises((WrongFile, IsADirectoryError, FileNotFoundError)) as caught:
            read_cortex(analysis)
        holds.says("refusal", str(caught.value).replace(str(analysis), ""), path.name)
        path.rmdir() if path.is_dir() else path.unlink()


HOSTILE = [
    ("warnings", 5),
    ("g", float("nan")),
    ("reference_thickness", "x"),
    ("portion", True),
    ("portion", 1e-300),
    ("mu_ratio", 1e308),
    ("health", []),
]


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
def test_numbers(holds, analysis):
    summary = analysis / "summary.json"
    text = summary.read_text()
    for value in ('"x"', "[]", "{}", "NaN", "true", "1e308", "1e999"):
        summary.write_text(re.sub(r'("mean_cortical_thickness_mm": )[\d.]+', rf"\g<1>{value}", text))
        json_at_all = value != "NaN"
        with pytest.raises(NotReadable if json_at_all else DamagedFile) as caught:
            compare({"a": read_analysis(analysis)}).to_dict()
        message = str(caught.value).replace(str(analysis), "")
        holds.says(
            f"thickness {value}", message, "summary.json", "mean_cortical_thickness_mm" if json_at_all else "line"
        )
    summary.unlink()
    for key, wrong in HOSTILE:
        (analysis / "stage.json").write_text(json.dumps({"g": 1.8, "portion": 1.0, key: wrong}))
        json_at_all = wrong == wrong  # NaN is none
        with pytest.raises(NotReadable if json_at_all else DamagedFile) as caught:
            read_cortex(analysis)
        message = str(caught.value).replace(str(analysis), "")
        holds.says(f"{key} {wrong}", message, "stage.json", key if json_at_all else "line")


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
