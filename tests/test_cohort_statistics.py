"""Statistics of a group: planted differences and outliers are found with their size, and others are not."""

import numpy as np
import pytest
from made_groups import made_group
from scipy import stats

from morphofold.group import statistics
from morphofold.group.statistics import asymmetry, distributions, outliers
from morphofold.tables import read_table

NAN = np.nan


def sides(*pairs):
    return np.array(pairs, dtype=np.float64)


# --- distributions


def test_the_distribution_of_five_values_is_the_one_worked_out_by_hand():
    values = sides([1, NAN], [2, NAN], [3, NAN], [4, NAN], [10, NAN], [NAN, NAN])
    (one,) = distributions({"n_hinges": values})
    assert (one.hemi, one.n, one.mean, one.median) == ("lh", 5, 4, 3)
    assert (one.least, one.lower_quartile, one.upper_quartile, one.greatest) == (1, 2, 4, 10)
    assert one.sd == pytest.approx(np.sqrt((9 + 4 + 1 + 0 + 36) / 4))


def test_one_value_has_no_standard_deviation_and_none_no_distribution():
    one, *none = distributions({"a": sides([7, NAN]), "b": sides([NAN, NAN])})
    assert one.mean == one.median == 7
    assert np.isnan(one.sd)
    assert none == []


def test_the_median_is_over_persons_and_each_session_is_searched():
    """Ten scans of one person do not move the median of nine others; the odd scan among them is found."""
    values, number = np.r_[np.arange(9.0), np.full(9, 100.0), 130.0], np.r_[np.arange(9), np.full(10, 9)]
    names = [f"s{k}" for k in range(19)]
    found = outliers(names, {"a": np.column_stack([values, np.full(19, NAN)])}, number)
    assert {row.subject for row in found.found} == {f"s{k}" for k in range(9, 19)}
    assert {row.median for row in found.found} == {4.5}  # of 0 to 8 and 103
    assert not outliers(names, {"a": np.column_stack([values, np.full(19, NAN)])}).found


# --- left and right


def test_a_planted_asymmetry_is_found_with_its_size():
    """Left 1 + a/2 and right 1 - a/2 of each subject: 2 (L - R) / (L + R) is a, whatever the subject's size."""
    rng = np.random.default_rng(1)
    size, a = rng.uniform(50, 200, 400), 0.06 + 0.02 * rng.standard_normal(400)
    (found,) = asymmetry({"area_pial_mm2": np.column_stack([size * (1 + a / 2), size * (1 - a / 2)])})
    assert found.n == 400
    assert found.asymmetry == pytest.approx(a.mean(), rel=1e-12)
    assert found.effect_size == pytest.approx(a.mean() / a.std(ddof=1), rel=1e-9)
    interval = stats.ttest_1samp(a, 0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high), rel=1e-9)
    assert found.p_holm == pytest.approx(stats.ttest_1samp(a, 0).pvalue, rel=1e-6)
    assert found.sided


def test_the_interval_holds_the_true_asymmetry_in_95_of_100_groups():
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(1000):
        a = 0.03 + 0.05 * rng.standard_normal(12)
        (found,) = asymmetry({"area_pial_mm2": np.column_stack([1 + a / 2, 1 - a / 2])})
        held += found.low <= 0.03 <= found.high
    assert held == pytest.approx(950, abs=4 * np.sqrt(1000 * 0.95 * 0.05))


def test_swapping_the_sides_turns_the_sign_and_nothing_else(rng):
    values = rng.uniform(1, 2, (20, 2))
    (one,), (other,) = asymmetry({"a": values}), asymmetry({"a": values[:, ::-1]})
    assert other.asymmetry == pytest.approx(-one.asymmetry)
    assert (other.low, other.high) == pytest.approx((-one.high, -one.low))
    assert other.p_holm == pytest.approx(one.p_holm)


def test_sides_that_do_not_differ_are_rarely_said_to_over_many_measures():
    """Twenty measures without asymmetry, 200 times: the corrected test finds one in 5 of 100 groups, not in 64."""
    rng = np.random.default_rng(3)
    wrong = 0
    for _ in range(200):
        group = {f"m{k}": 10 + rng.standard_normal((30, 2)) for k in range(20)}
        wrong += any(row.sided for row in asymmetry(group))
    assert 0 < wrong <= 10 + 4 * np.sqrt(200 * 0.05 * 0.95)


def test_holm_is_that_of_a_worked_example():
    """Sorted 0.01, 0.02, 0.03 by 3, 2, 1 is 0.03, 0.04, 0.03; a later one is never smaller than an earlier one."""
    corrected = statistics.holm(np.array([0.03, 0.01, NAN, 0.02]))
    np.testing.assert_allclose(corrected, [0.04, 0.03, NAN, 0.04])
    assert statistics.holm(np.array([0.9, 0.8])).max() == 1


def test_other_forms_of_a_measure_are_not_tested_again(rng):
    """They would make the corrected p of all others larger."""
    values = {name: 10 + rng.standard_normal((12, 2)) + [0.4, 0] for name in ("n_hinges", "gyrification_index")}
    again = {name: values["n_hinges"] for name in ("n_hinges_low", "n_hinges_high", "n_hinges_3", "n_hinges_4")}
    few, many = asymmetry(values), asymmetry({**values, **again})
    assert [row.p_holm for row in many[:2]] == [row.p_holm for row in few]
    assert np.isnan([row.p_holm for row in many[2:]]).all()
    assert all(row.asymmetry == many[0].asymmetry and not row.sided for row in many[2:])


def test_only_subjects_with_both_sides_count_and_only_positive_quantities():
    values = sides([3, 1], [NAN, 1], [2, NAN], [0, 0], [1, 3])
    measures = ("n_hinges", "gyral_to_cortical_slope", "euler_characteristic")
    (found,) = asymmetry(dict.fromkeys(measures, values))
    assert (found.measure, found.n, found.asymmetry) == ("n_hinges", 2, 0)


def test_subjects_all_alike_have_an_asymmetry_but_no_effect_size():
    """Copies of one subject that differ by the rounding of float32."""
    size = np.linspace(1, 2, 9)[:, None] * (1 + 1e-8 * np.random.default_rng(4).standard_normal((9, 2)))
    (found,) = asymmetry({"a": size * [1.1, 0.9]})
    assert found.asymmetry == pytest.approx(0.2, rel=1e-6)
    assert np.isnan(found.effect_size)
    assert np.isnan(found.p_holm)
    assert not found.sided
    (single,) = asymmetry({"a": sides([1.1, 0.9])})
    assert single.asymmetry == pytest.approx(0.2)
    assert np.isnan([single.low, single.high, single.sd, single.effect_size, single.p_holm]).all()


# --- outliers


def test_the_robust_z_is_the_one_worked_out_by_hand():
    """Median 3, deviations 2, 1, 0, 1, 97: MAD 1."""
    z, median = statistics.robust_z(np.array([1.0, 2, 3, 4, 100]))
    assert median == 3
    np.testing.assert_allclose(z, 0.6745 * np.array([-2, -1, 0, 1, 97]))


def test_a_planted_outlier_is_the_first_and_its_size_is_known():
    """Normals whose mean and sd are known: 0.6745 over MAD is 1 over their standard deviation."""
    rng = np.random.default_rng(5)
    values = 100 + 5 * rng.standard_normal((4000, 2))
    values[1234, 1] = 100 - 10 * 5
    found = outliers([f"s{k}" for k in range(4000)], {"area_pial_mm2": values})
    first = found.found[0]
    assert (first.subject, first.hemi, first.measure, first.value) == ("s1234", "rh", "area_pial_mm2", 50)
    assert first.robust_z == pytest.approx(-10, rel=0.05)
    assert first.median == pytest.approx(100, abs=0.5)
    assert len(found.found) - 1 <= found.by_chance + 4 * np.sqrt(found.by_chance)
    assert found.by_chance == pytest.approx(8000 * 4.65e-4, rel=0.01)


def test_subjects_come_by_their_farthest_value_with_their_rows_together(rng):
    a, b = 10 + rng.standard_normal((2, 50, 2)).clip(-2, 2)
    a[3, 0], b[3, 1], b[7, 0], a[9, 1] = 100, 40, 60, 50
    found = outliers([f"s{k}" for k in range(50)], {"a": a, "b": b})
    assert [[row.subject for row in rows] for rows in found.subjects] == [["s3", "s3"], ["s7"], ["s9"]]
    assert [row.value for row in found.subjects[0]] == [100, 40]


def test_what_differs_from_a_number_all_others_share_is_an_outlier_without_a_finite_z():
    euler = np.full((40, 2), 2.0)
    euler[11, 0] = -4
    found = outliers([f"s{k}" for k in range(40)], {"euler_characteristic": euler})
    (one,) = found.found
    assert (one.subject, one.hemi, one.value, one.median) == ("s11", "lh", -4, 2)
    assert one.robust_z == -np.inf
    assert found.looked_at == 0


def test_a_number_that_half_share_and_many_do_not_has_no_outliers():
    euler = np.full((40, 2), 2.0)
    euler[:15] = 0
    found = outliers([f"s{k}" for k in range(40)], {"euler_characteristic": euler})
    assert found.found == ()
    assert found.divided == (("euler_characteristic", "lh"), ("euler_characteristic", "rh"))


def test_one_hinge_more_than_the_others_have_is_no_outlier_and_ten_are():
    """With a MAD of half a count robust z of a difference d is 1.349 d, above 3.5 from three on."""
    counts = np.full((40, 2), 38.0)
    counts[:4, 0] = 39, 40, 41, 48
    found = outliers([f"s{k}" for k in range(40)], {"n_hinges": counts})
    assert [(row.subject, row.value) for row in found.found] == [("s3", 48), ("s2", 41)]
    assert found.found[1].robust_z == pytest.approx(3 * 0.6745 / 0.5)


def test_differences_of_round_off_are_none(rng):
    values = 2.5 * (1 + 1e-8 * rng.standard_normal((30, 2)))
    values[4, 1] = 2.6
    found = outliers([f"s{k}" for k in range(30)], {"gyrification_index": values})
    assert [(row.subject, row.hemi) for row in found.found] == [("s4", "rh")]


def test_seven_values_are_too_few_and_unknown_ones_do_not_count():
    left = [1, 2, 3, 4, 5, 6, 1000, NAN]
    right = [1, 2, 3, 4, 5, 6, 7, 1000]
    found = outliers(list("abcdefgh"), {"a": np.column_stack([left, right]), "b": np.full((8, 2), NAN)})
    assert found.too_few == (("a", "lh"),)
    assert [(row.subject, row.hemi) for row in found.found] == [("h", "rh")]
    assert found.looked_at == 8


def test_bounds_of_another_measure_are_no_outliers():
    values = np.arange(20.0).repeat(2).reshape(20, 2)
    values[0] = 1e6
    assert outliers([str(k) for k in range(20)], {"gyral_to_cortical_slope_low": values}).found == ()


# --- gyral against cortical thickness


@pytest.mark.parametrize("n", [20, 1200])
def test_the_line_through_subjects_is_the_one_they_were_put_on(n):
    x = np.linspace(2, 3, n)
    both = lambda v: np.column_stack([v, v + 1])
    group = made_group(n, mean_cortical_thickness_mm=both(x), median_gyral_thickness_mm=both(4 * x + 1))
    cloud = statistics.subject_cloud(group, 0)
    assert cloud.fit.slope == pytest.approx(4)
    assert cloud.fit.intercept == pytest.approx(1)
    assert cloud.fit.n == n
    assert statistics.subject_cloud(group, 1).fit.intercept == pytest.approx(-2)
    if n == 20:
        assert cloud.fit.robust == pytest.approx(4)
        assert [p.label for p in cloud.points] == list(group.subjects)
        assert cloud.bins == ()
    else:
        assert np.isnan(cloud.fit.robust)
        assert [p.gyral for p in cloud.bins] == pytest.approx([4 * p.cortical + 1 for p in cloud.bins])
        assert all(p.low < p.gyral < p.high for p in cloud.bins)


def test_regions_are_points_at_their_means_with_what_subjects_differ_by():
    group = made_group(5)
    cloud = statistics.region_cloud(group, 1)
    assert cloud.points[0].label == "cuneus, 5 subjects"
    assert cloud.fit.slope == pytest.approx(3)
    assert cloud.points[0].high - cloud.points[0].low == pytest.approx(1.0)
    group.regions["cuneus"][1, :, 0] = 0
    assert len(statistics.region_cloud(group, 1).points) == len(cloud.points) - 1


# --- tables


def test_tables_are_written_with_all_their_columns_and_no_infinity(tmp_path):
    euler = np.full((20, 2), 2.0)
    euler[0, 0] = 0
    group = made_group(20, euler_characteristic=euler)
    far = outliers(group.subjects, group.scalars).found
    statistics.write_statistics(tmp_path, distributions(group.scalars), asymmetry(group.scalars), far)
    rows = read_table(tmp_path / "outliers.tsv", ("subject", "hemi", "measure"), len(far))
    assert rows[0] == {
        "subject": "sub-00000",
        "hemi": "lh",
        "measure": "euler_characteristic",
        "value": 0,
        "robust_z": None,
        "median": 2,
    }
    assert len(read_table(tmp_path / "distributions.tsv", ("measure", "hemi"))) == 14
    assert len(read_table(tmp_path / "asymmetry.tsv", ("measure",))) == 6
    text = "".join(path.read_text(encoding="utf-8") for path in tmp_path.iterdir())
    assert "inf" not in text
    assert "nan" not in text
