"""The table of the hard cases holds them all, and a bound that nothing breaks is found out."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hard_cases.cases import GROUPS, Holds, hard_case

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "hard-cases.md"


def test_a_bound_is_kept_or_broken():
    records = []
    holds = Holds(records.append)
    holds("error", 0.01, at_most=0.01, unit="%")
    assert records[-1] == {"what": "error", "bound": "≤ 0.01 %", "measured": "0.01 %"}
    for measured in (0.02, float("nan"), float("inf")):
        with pytest.raises(AssertionError, match=rf"error\b.* {measured:g}\b"):
            holds("error", measured, at_most=0.01)
    with pytest.raises(AssertionError, match=r"share: 0\.5 .*\b0\.9"):
        holds("share", 0.5, at_least=0.9)
    with pytest.raises(AssertionError, match="limit"):
        holds("share", 0.5)
    with pytest.raises(AssertionError, match=r"bytes: b'a' .*b'b'"):
        holds.equal("bytes", b"a", b"b")
    with pytest.raises(AssertionError, match=r"refusal: .*\['line 3'\]"):
        holds.says("refusal", "x.surf: is empty", "x.surf", "line 3")


def test_a_guard_has_words_and_a_removal():
    with pytest.raises(ValueError, match=r"rotation: .*'laws'"):
        hard_case("laws", "rotation", guard="the filter")
    with pytest.raises(ValueError, match=r"rotation: .*'laws'"):
        hard_case("somewhere", "rotation")


MADE = """
from types import SimpleNamespace

from hard_cases.cases import hard_case

code = SimpleNamespace(limit=1.0)

@hard_case("laws", "made up", guard="a limit", without=lambda patch: patch.setattr(code, "limit", 9.0))
def test_it(holds):
    holds("number", min(20.0, code.limit), at_most={bound})
"""


@pytest.mark.slow
@pytest.mark.parametrize(("bound", "ends"), [(5, "2 passed"), (10, "1 failed, 1 passed")])
def test_what_passes_without_its_guard_too_is_a_failure(tmp_path, bound, ends):
    shutil.copy(HERE / "conftest.py", tmp_path)
    (tmp_path / "test_made.py").write_text(MADE.format(bound=bound))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}
    output = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False).stdout
    assert ends in output.splitlines()[-1]
    assert ("nothing broke without the guard (a limit)" in output) == (bound == 10)


def marked(file):
    """Groups and cases of the tests of a file."""
    spec = importlib.util.spec_from_file_location(f"hard_cases_{file.stem}", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for test in vars(module).values():
        for mark in getattr(test, "pytestmark", ()):
            if mark.name == "hard_case":
                yield mark.kwargs["group"], mark.kwargs["case"]


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
@pytest.mark.parametrize("group", GROUPS)
def test_the_table_of_cases_has_every_case_and_no_other_and_the_page_some(group):
    cases = {case for file in HERE.glob("test_*.py") for where, case in marked(file) if where == group}
    table = PAGE.with_name("hard-cases-guards.tsv").read_text(encoding="utf-8")
    assert {row[1] for row in (line.split("\t") for line in table.splitlines()) if row[0] == group} == cases
    part = PAGE.read_text(encoding="utf-8").split(f"<!-- {group} -->")[1].split(f"<!-- /{group} -->")[0]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in part.splitlines() if line.startswith("| ")]
    assert set(rows[2:]) < cases
