"""False positives and power of group statistics, on made studies."""

import inspect

import numpy as np
import pytest

from morphofold.group.map_statistics import FEWEST_OF_VARIANCE_GROUP
from morphofold.studies.group_statistics import (
    ALPHA,
    CORRELATIONS,
    FWHMS_MM,
    GROUP_SIZES,
    N_PERMUTATIONS,
    N_SUBJECTS,
    PATCH_RADIUS_MM,
    SHOWN_POWERS,
    SHOWN_VARIANCES,
    TEST_KINDS,
    UNEQUAL_DESIGNS,
    Ball,
    Bench,
    false_positives,
    main,
    people,
    power,
    share_with_interval,
    tables_with_tsv,
    unequal_variances,
)
from morphofold.studies.page_sentences import DOCS, Page, spread

in_a_checkout = pytest.mark.skipif(not (DOCS / "group-statistics.md").is_file(), reason="needs a checkout")


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


@in_a_checkout
def test_no_rate_of_the_page_differs_from_five_percent():
    """5 % lies in the interval of every rate."""
    (rows,) = Page("group-statistics").tables("rates")
    intervals = [low_and_high(row[kind]) for row in rows for kind in TEST_KINDS]
    assert len(intervals) == 12
    assert all(low <= 5 <= high for low, high in intervals)


def low_and_high(cell):
    """The interval of a cell such as ``4.5 % (2.7 to 7.0)``."""
    return [float(end) for end in cell.split("(")[1].rstrip(")").split(" to ")]


def per_cent(cell):
    """The number of a cell such as ``4.5 % (2.7 to 7.0)``."""
    return float(cell.split(" %")[0])


def test_rates_of_unequal_variances_have_their_rows(monkeypatch):
    monkeypatch.setattr("morphofold.studies.group_statistics.N_PERMUTATIONS", 39)
    rows = {tuple(row[:2]): row[2:] for row in unequal_variances(Ball(), 4)}
    assert list(rows) == [(label, groups) for label in UNEQUAL_DESIGNS for groups in ("no", "yes")]
    assert rows["6 with sd 3, 24 with sd 1", "no"][0].startswith("100.0 %")
    assert rows["6 with sd 3, 24 with sd 1", "no"][3] == "100 %"


@in_a_checkout
def test_variance_groups_keep_rates_near_five_percent():
    """On the page: none above 14 % with groups, and far more or fewer without where they are unequal."""
    rows = Page("group-statistics").tsv_rows("variances")
    rates = {(row["subjects"], row["variance groups"]): [per_cent(row[kind]) for kind in TEST_KINDS] for row in rows}
    assert list(rates) == [(label, groups) for label in UNEQUAL_DESIGNS for groups in ("no", "yes")]
    assert max(max(rates[label, "yes"]) for label in UNEQUAL_DESIGNS) < 14
    assert min(rates["6 with sd 3, 24 with sd 1", "no"]) > 80
    assert max(rates["6 with sd 1, 24 with sd 3", "no"]) < 2


@in_a_checkout
def test_the_page_shows_some_rows_of_the_tables_beside_it(tmp_path):
    page, lines = Page("group-statistics"), {}
    for name in ("variances", "power"):
        lines[name] = page.path.with_name(f"group-statistics-{name}.tsv").read_text("utf-8").splitlines()[1:]
    made_tables = tables_with_tsv(tmp_path / page.path.name, *([l.split("\t") for l in lines[n]] for n in lines))
    for name, made_table in zip(lines, made_tables):
        assert f"<!-- {name} -->\n\n{made_table}\n\n<!-- /{name} -->" in page.path.read_text("utf-8")
        assert (tmp_path / f"group-statistics-{name}.tsv").read_text("utf-8").splitlines()[1:] == lines[name]
    (shown_variances,), (shown_powers,) = page.tables("variances"), page.tables("power")
    assert len(shown_variances) == 2 * len(SHOWN_VARIANCES)
    assert len(shown_powers) == len(SHOWN_POWERS)


@in_a_checkout
def test_sentences_have_the_numbers_of_the_tables_and_of_the_code():
    page = Page("group-statistics")
    variances, powers = page.tsv_rows("variances"), page.tsv_rows("power")
    rates = [per_cent(row[kind]) for row in variances if row["variance groups"] == "yes" for kind in TEST_KINDS]
    page.assert_sentence("With `--variance-groups` rates are # to # %", *spread(rates), tolerance=0.5)
    page.assert_sentence("in about # % of studies, as it should at a corrected p of #", 100 * ALPHA, ALPHA)
    page.assert_sentence("a group of fewer than # that varies more", FEWEST_OF_VARIANCE_GROUP)
    page.assert_sentence("left hemisphere; # permutations", N_PERMUTATIONS)
    number_of_kind = {name: option.default for name, option in inspect.signature(main).parameters.items()}
    page.assert_sentence("Twenty subjects in each of # studies", number_of_kind["studies"])
    page.assert_sentence("differs: share of # studies", number_of_kind["variance_studies"])
    page.assert_sentence("Shares of # studies that find anything", number_of_kind["power_studies"])
    page.assert_sentence("on a ball of # vertices", len(Ball().white.verts))
    page.assert_sentence("vertices with a smoothness of # mm", FWHMS_MM[1])
    page.assert_sentence("with a radius of # mm; maps have a smoothness of # mm", PATCH_RADIUS_MM, FWHMS_MM[0])
    found = {(row["subjects"], row["correlation"]): row for row in powers}
    assert list(found) == [(n, r) for n in GROUP_SIZES for r in CORRELATIONS]
    assert N_SUBJECTS == 20
    assert "An effect that explains a quarter of the variance at a vertex is found with twenty subjects" in page.prose
    assert per_cent(found[20, 0.5]["TFCE"]) == 100
    assert "one that explains a tenth needs forty to be seen and eighty for its extent" in page.prose
    assert per_cent(found[20, 0.3]["TFCE"]) < 90 < per_cent(found[40, 0.3]["TFCE"])
    assert per_cent(found[40, 0.3]["of the patch"]) < 60 < 90 < per_cent(found[80, 0.3]["of the patch"])
