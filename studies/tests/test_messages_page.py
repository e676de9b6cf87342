"""docs/messages.md lists every code."""

from pathlib import Path

import pytest

from morphofold.errors import PYTHON_CODES, Refusal
from morphofold.sim.health import BOUNDS
from morphofold.studies.pages.message_page import HEALTH, write

PAGE = Path(__file__).resolve().parents[2] / "docs" / "messages.md"


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
def test_the_page_is_what_the_code_says(tmp_path):
    copy = tmp_path / PAGE.name
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    write(copy)
    assert copy.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_every_kind_of_refusal_has_a_code_a_cause_and_a_cure():
    kinds = Refusal.__subclasses__()
    assert len({kind.code for kind in kinds}) == len(kinds)
    assert all(str(kind.__doc__).count("\n\n") == 1 and kind.code.islower() and " " not in kind.code for kind in kinds)


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
def test_every_code_of_pythons_own_errors_is_explained():
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"| `{code}` |" in page for code in (*PYTHON_CODES.values(), "disk-full"))


def test_every_bound_of_health_is_explained():
    assert HEALTH.keys() == {*BOUNDS, "lowest_J"}
