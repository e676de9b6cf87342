"""False positives and power of group statistics, on made studies."""

import re
from pathlib import Path

import numpy as np
import pytest

from morphofold.studies.group_statistics import (
    UNEQUAL_DESIGNS,
    Ball,
    Bench,
    false_positives,
    people,
    power,
    share_with_interval,
    unequal_variances,
)

PAGE = Path(__file__).parent.parent.parent / "docs" / "group-statistics.md"


def test_the_interval_of_a_share_is_the_exact_one():
    assert share_with_interval(0, 20) == "0.0 % (0.0 to 16.8)"  # tables of Clopper and Pearson
    assert share_with_interval(5, 20) == "25.0 % (8.7 to 49.1)"
    assert share_with_interval(20, 20) == "100.0 % (83.2 to 100.0)"


def test_a_study_of_each_kind_gives_its_rows(monkeypatch):
    monkeypatch.setattr("morphofold.studies.group_statistics.GROUP_SIZES", (10,))
    monkeypatch.setattr("morphofold.studies.group_statistics.CORRELATIONS", (0.95,))
    monkeypatch.setattr("morphofold.studies.group_statistics.N_PERMUTATIONS", 39)
    bench = Bench()
    assert [row[:2] for row in false_positives(bench, 1)] == [
        ["age, with sex", "10"],
        ["age, with sex", "20"],
        ["mean", "10"],
        ["mean", "20"],
    ]
    (row,) = power(bench, 1)
    assert row[:2] == ["10", "0.95"]
    assert row[4] == "100 %"  # TFCE finds an effect of 90 % of the variance
    assert np.linalg.matrix_rank(people(10, np.random.default_rng(0))) == 3


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
def test_no_rate_of_the_page_differs_from_five_percent():
    """Each table is there, and 5 % lies in the interval of every rate."""
    text = PAGE.read_text(encoding="utf-8")
    rates = re.search(r"<!-- rates -->(.*)<!-- /rates -->", text, re.DOTALL)[1]
    intervals = re.findall(r"\(([\d.]+) to ([\d.]+)\)", rates)
    assert len(intervals) == 12
    assert all(float(low) <= 5 <= float(high) for low, high in intervals)
    assert re.search(r"<!-- power -->(.*)<!-- /power -->", text, re.DOTALL)[1].count("\n| ") == 11


def test_rates_of_unequal_variances_have_their_rows(monkeypatch):
    monkeypatch.setattr("morphofold.studies.group_statistics.N_PERMUTATIONS", 39)
    rows = {tuple(row[:2]): row[2:] for row in unequal_variances(Ball(), 4)}
    assert list(rows) == [(label, groups) for label in UNEQUAL_DESIGNS for groups in ("no", "yes")]
    assert rows["6 with sd 3, 24 with sd 1", "no"][0].startswith("100.0 %")
    assert rows["6 with sd 3, 24 with sd 1", "no"][3] == "100 %"


@pytest.mark.skipif(not PAGE.is_file(), reason="needs a checkout")
def test_variance_groups_keep_rates_near_five_percent():
    """On the page: none above 14 % with groups, and far more or fewer without where they are unequal."""
    text = PAGE.read_text(encoding="utf-8")
    lines = re.search(r"<!-- variances -->(.*)<!-- /variances -->", text, re.DOTALL)[1].splitlines()
    rates = {tuple(cells[:2]): [float(c.split(" %")[0]) for c in cells[2:5]] for cells in map(cells_of, lines) if cells}
    assert list(rates) == [(label, groups) for label in UNEQUAL_DESIGNS for groups in ("no", "yes")]
    assert max(max(rates[label, "yes"]) for label in UNEQUAL_DESIGNS) < 14
    assert min(rates["6 with sd 3, 24 with sd 1", "no"]) > 80
    assert max(rates["6 with sd 1, 24 with sd 3", "no"]) < 2


def cells_of(line):
    """Cells of a row of a table with a rate; none of other lines."""
    return [cell.strip() for cell in line.strip("| ").split("|")] if "%" in line else []
