"""Statistics of a group: planted differences and outliers have their size, and others are none; what is pooled."""

import numpy as np
import pandas as pd
import pytest
from made_groups import made_group
from scipy import stats

from morphofold.analysis.measures_result import PARAMETERS, PARAMETERS_OF_SCALAR, SCALARS
from morphofold.group import group_distributions
from morphofold.group.group_distributions import asymmetry, distributions, outliers
from morphofold.group.group_tables import SETTING_NAMES, Pooling, pooling
from morphofold.tables import read_table

NAN = np.nan
USUAL = {
    "morphofold": "1.0",
    "folding_scale_mm": 3.0,
    "folding_index_surface": "white",
    "graph_width_mm": 8.0,
    "cortical_thickness_cap_mm": 5.0,
    "cortex_mask": "label",
    "accuracy": "standard",
    "annotation": "aparc",
}


def sides(*pairs):
    return np.array(pairs, dtype=np.float64)


def names(n):
    return [f"s{k}" for k in range(n)]


# --- distributions


def test_the_distribution_of_five_values_is_the_one_worked_out_by_hand():
    values = sides([1, NAN], [2, NAN], [3, NAN], [4, NAN], [10, NAN], [NAN, NAN])
    five, single = distributions({"n_hinges": values, "a": sides([NAN, 7]), "b": sides([NAN, NAN])})
    assert (five.hemi, five.n, five.mean, five.median) == ("lh", 5, 4, 3)
    assert (five.least, five.lower_quartile, five.upper_quartile, five.greatest) == (1, 2, 4, 10)
    assert five.sd == pytest.approx(np.sqrt((9 + 4 + 1 + 0 + 36) / 4))
    assert (single.hemi, single.mean, single.median) == ("rh", 7, 7)
    assert np.isnan(single.sd)


# --- left and right


def test_a_planted_asymmetry_has_its_size():
    """Left 1 + a/2 and right 1 - a/2 of each subject: 2 (L - R) / (L + R) is a, whatever the subject's size."""
    rng = np.random.default_rng(1)
    size, a = rng.uniform(50, 200, 400), 0.06 + 0.02 * rng.standard_normal(400)
    pairs = np.column_stack([size * (1 + a / 2), size * (1 - a / 2)])
    (row,), (swapped,) = asymmetry({"area_pial_mm2": pairs}), asymmetry({"area_pial_mm2": pairs[:, ::-1]})
    expected = stats.ttest_1samp(a, 0)
    interval = expected.confidence_interval(0.95)
    assert row.n == 400
    assert row.asymmetry == pytest.approx(a.mean(), rel=1e-12)
    assert row.effect_size == pytest.approx(a.mean() / a.std(ddof=1), rel=1e-9)
    assert (row.low, row.high) == pytest.approx((interval.low, interval.high), rel=1e-9)
    assert row.p_holm == pytest.approx(expected.pvalue, rel=1e-6)
    assert row.sided
    assert (swapped.low, swapped.high, swapped.asymmetry) == pytest.approx((-row.high, -row.low, -row.asymmetry))
    assert swapped.p_holm == pytest.approx(row.p_holm)


def test_the_interval_holds_the_true_asymmetry_in_95_of_100_groups():
    rng, hits = np.random.default_rng(2), 0
    for _ in range(1000):
        a = 0.03 + 0.05 * rng.standard_normal(12)
        (row,) = asymmetry({"area_pial_mm2": np.column_stack([1 + a / 2, 1 - a / 2])})
        hits += row.low <= 0.03 <= row.high
    assert hits == pytest.approx(950, abs=4 * np.sqrt(1000 * 0.95 * 0.05))


def test_over_many_measures_sides_that_do_not_differ_rarely_seem_to():
    """Twenty measures without asymmetry, 200 times: the corrected test says so in 5 of 100 groups, not in 64."""
    rng, wrong = np.random.default_rng(3), 0
    for _ in range(200):
        wrong += any(row.sided for row in asymmetry({f"m{k}": 10 + rng.standard_normal((30, 2)) for k in range(20)}))
    assert 0 < wrong <= 10 + 4 * np.sqrt(200 * 0.05 * 0.95)


def test_holm_is_that_of_a_worked_example():
    """Sorted 0.01, 0.02, 0.03 by 3, 2, 1 is 0.03, 0.04, 0.03; a later one is never smaller than an earlier one."""
    corrected = group_distributions.holm(np.array([0.03, 0.01, NAN, 0.02]))
    np.testing.assert_allclose(corrected, [0.04, 0.03, NAN, 0.04])
    assert group_distributions.holm(np.array([0.9, 0.8])).max() == 1


def test_other_forms_of_a_measure_are_not_tested_again(rng):
    """They would make the corrected p of all others larger."""
    values = {name: 10 + rng.standard_normal((12, 2)) + [0.4, 0] for name in ("n_hinges", "gyrification_index")}
    few, many = asymmetry(values), asymmetry({**values, "n_hinges_low": values["n_hinges"]})
    assert [row.p_holm for row in many[:2]] == [row.p_holm for row in few]
    assert np.isnan(many[2].p_holm)
    assert not many[2].sided


def test_only_subjects_with_both_sides_count_and_only_positive_quantities():
    values = sides([3, 1], [NAN, 1], [2, NAN], [0, 0], [1, 3])
    (row,) = asymmetry(dict.fromkeys(("n_hinges", "gyral_to_cortical_slope", "euler_characteristic"), values))
    assert (row.measure, row.n, row.asymmetry) == ("n_hinges", 2, 0)


def test_equal_subjects_and_a_single_one_have_an_asymmetry_but_no_effect_size():
    """Copies of one subject that differ by the rounding of float32."""
    size = np.linspace(1, 2, 9)[:, None] * (1 + 1e-8 * np.random.default_rng(4).standard_normal((9, 2)))
    (row,), (single,) = asymmetry({"a": size * [1.1, 0.9]}), asymmetry({"a": sides([1.1, 0.9])})
    assert row.asymmetry == pytest.approx(0.2, rel=1e-6)
    assert single.asymmetry == pytest.approx(0.2)
    assert np.isnan([row.effect_size, row.p_holm, single.low, single.sd, single.effect_size, single.p_holm]).all()
    assert not row.sided


# --- outliers


def test_the_robust_z_is_the_one_worked_out_by_hand():
    z, median = group_distributions.robust_z(np.array([1.0, 2, 3, 4, 100]))  # deviations 2, 1, 0, 1, 97: MAD 1
    np.testing.assert_allclose([median, *z], [3, *0.6745 * np.array([-2, -1, 0, 1, 97])])


def test_a_planted_outlier_is_the_first_and_its_size_is_known():
    """Normals whose mean and sd are known: 0.6745 over MAD is 1 over their standard deviation."""
    values = 100 + 5 * np.random.default_rng(5).standard_normal((4000, 2))
    values[1234, 1] = 100 - 10 * 5
    result = outliers(names(4000), {"area_pial_mm2": values})
    first = result.rows[0]
    assert (first.subject, first.hemi, first.measure, first.value) == ("s1234", "rh", "area_pial_mm2", 50)
    assert (first.robust_z, first.median) == pytest.approx((-10, 100), rel=0.05)
    assert len(result.rows) - 1 <= result.by_chance + 4 * np.sqrt(result.by_chance)
    assert result.by_chance == pytest.approx(8000 * 4.65e-4, rel=0.01)


def test_subjects_come_by_their_farthest_value_with_their_rows_together(rng):
    a, b = 10 + rng.standard_normal((2, 50, 2)).clip(-2, 2)
    a[3, 0], b[3, 1], b[7, 0], a[9, 1] = 100, 40, 60, 50
    bounds = np.arange(50.0).repeat(2).reshape(50, 2) + 1e6 * (np.arange(50) == 0)[:, None]
    rows = outliers(names(50), {"a": a, "b": b, "gyral_to_cortical_slope_low": bounds}).subjects  # bounds are none
    assert [[row.subject for row in of_subject] for of_subject in rows] == [["s3", "s3"], ["s7"], ["s9"]]
    assert [row.value for row in rows[0]] == [100, 40]


def test_the_median_is_over_persons_and_each_session_is_searched():
    """Ten scans of one person do not move the median of nine others; the odd scan among them is seen."""
    values, person = np.r_[np.arange(9.0), np.full(9, 100.0), 130.0], np.r_[np.arange(9), np.full(10, 9)]
    scalars = {"a": np.column_stack([values, np.full(19, NAN)])}
    rows = outliers(names(19), scalars, person).rows
    assert {row.subject for row in rows} == {f"s{k}" for k in range(9, 19)}
    assert {row.median for row in rows} == {4.5}  # of 0 to 8 and 103
    assert not outliers(names(19), scalars).rows


def test_a_value_unlike_the_one_all_others_share_is_an_outlier_without_a_finite_z(rng):
    euler = np.full((40, 2), 2.0)
    euler[11, 0] = -4
    gi = 2.5 * (1 + 1e-8 * rng.standard_normal((40, 2)))  # round-off
    gi[4, 1] = 2.6
    result = outliers(names(40), {"euler_characteristic": euler, "gyrification_index": gi})
    rows = {(row.subject, row.hemi, row.value, row.robust_z) for row in result.rows}
    assert rows == {("s11", "lh", -4, -np.inf), ("s4", "rh", 2.6, np.inf)}
    euler[:15] = 0  # many do not share it
    result = outliers(names(40), {"euler_characteristic": euler})
    assert result.rows == ()
    assert result.with_same_values == (("euler_characteristic", "lh"), ("euler_characteristic", "rh"))


def test_one_hinge_more_than_the_others_have_is_no_outlier_and_ten_are():
    """With a MAD of half a count robust z of a difference d is 1.349 d, above 3.5 from three on."""
    counts = np.full((40, 2), 38.0)
    counts[:4, 0] = 39, 40, 41, 48
    rows = outliers(names(40), {"n_hinges": counts}).rows
    assert [(row.subject, row.value) for row in rows] == [("s3", 48), ("s2", 41)]
    assert rows[1].robust_z == pytest.approx(3 * 0.6745 / 0.5)


def test_seven_values_are_too_few_and_unknown_ones_do_not_count():
    left, right = [1, 2, 3, 4, 5, 6, 1000, NAN], [1, 2, 3, 4, 5, 6, 7, 1000]
    result = outliers(list("abcdefgh"), {"a": np.column_stack([left, right]), "b": np.full((8, 2), NAN)})
    assert result.with_few_values == (("a", "lh"),)
    assert [(row.subject, row.hemi) for row in result.rows] == [("h", "rh")]
    assert result.n_searched == 8


# --- gyral against cortical thickness


def test_the_line_through_subjects_is_the_one_they_were_put_on():
    few, many = (
        made_group(n, mean_cortical_thickness_mm=x, median_gyral_thickness_mm=4 * x + 1)
        for n, x in ((n, np.linspace([2, 3], [3, 4], n)) for n in (20, 1200))
    )
    for side in (0, 1):
        fit = group_distributions.subject_cloud(few, side).fit
        assert (fit.slope, fit.intercept, fit.n, fit.robust) == pytest.approx((4, 1, 20, 4))
    assert [p.label for p in group_distributions.subject_cloud(few, 0).points] == list(few.subjects)
    bins = group_distributions.subject_cloud(many, 0).bins
    assert [p.gyral for p in bins] == pytest.approx([4 * p.cortical + 1 for p in bins])
    assert all(p.low < p.gyral < p.high for p in bins)


def test_regions_are_points_at_their_means_with_the_deviation_of_subjects():
    group = made_group(5)
    cloud = group_distributions.region_cloud(group, 1)
    assert cloud.points[0].label == "cuneus, 5 subjects"
    assert (cloud.fit.slope, cloud.points[0].high - cloud.points[0].low) == pytest.approx((3, 1))
    group.regions["cuneus"][1, :, 0] = 0
    assert len(group_distributions.region_cloud(group, 1).points) == len(cloud.points) - 1


def test_tables_have_all_their_columns_and_no_infinity(tmp_path):
    euler = np.full((20, 2), 2.0)
    euler[0, 0] = 0
    group = made_group(20, euler_characteristic=euler)
    far = outliers(group.subjects, group.scalars).rows
    group_distributions.write_statistics(tmp_path, distributions(group.scalars), asymmetry(group.scalars), far)
    rows = read_table(tmp_path / "outliers.tsv", ("subject", "hemi", "measure"), len(far))
    columns = ("subject", "hemi", "measure", "value", "robust_z", "median")
    assert rows[0] == dict(zip(columns, ("sub-00000", "lh", "euler_characteristic", 0, None, 2)))
    text = "".join(path.read_text(encoding="utf-8") for path in tmp_path.iterdir())
    assert "inf" not in text
    assert "nan" not in text


# --- pooling


def pooled(kinds, *others, **values):
    """Of hemispheres (subjects, 2) with the usual settings (0), or those that differ as ``others`` say (1, 2, ...)."""
    kinds = np.array(kinds)
    choices = [USUAL, *(USUAL | other for other in others), dict.fromkeys(SETTING_NAMES)]
    scalars = {name: np.where(kinds >= 0, 1.0, NAN) for name in SCALARS} | values
    return pooling(pd.DataFrame([choices[n] for n in kinds.flat], dtype=object), scalars)


@pytest.mark.parametrize(
    ("parameter", "other", "dependent"),
    [
        ("folding_scale_mm", 3.9, {"folding_index", "intrinsic_curvature_index"}),
        ("folding_index_surface", "one surface", {"folding_index", "intrinsic_curvature_index"}),
        ("graph_width_mm", 10.4, {"n_hinges", "n_crests", "crest_length_mm"}),
        ("cortical_thickness_cap_mm", None, {"mean_cortical_thickness_mm", "gyral_to_cortical_slope"}),
        ("cortex_mask", "where white and pial differ", {"mean_sulcal_depth_mm", "n_hinges", "gray_volume_mm3"}),
        ("annotation", "aparc.a2009s", {"gyral_to_cortical_r"}),
        ("morphofold", "0.9", set(SCALARS)),
    ],
)
def test_a_measure_is_pooled_over_hemispheres_with_the_most_common_settings_that_it_depends_on(
    parameter, other, dependent
):
    result = pooled([[0, 0], [0, 0], [1, 0]], {parameter: other})
    assert result.value_counts == {parameter: {USUAL[parameter]: 5, other: 1}}
    assert dependent <= set(result.left_out)
    assert set(result.left_out.values()) == {(1, 6)}
    for key in dependent:
        assert np.isnan(result.pooled(key, np.ones((3, 2)))).tolist() == [[False, False], [False, False], [True, False]]
    assert ("area_pial_mm2" in result.left_out) == (parameter == "morphofold")


def test_values_without_a_majority_are_not_pooled():
    assert pooled([[0, 0], [0, -1]]) == Pooling()
    result = pooled([[0, 1], [2, 3]], *({"graph_width_mm": width} for width in (8.1, 9.2, 10.4)))
    assert result.left_out["n_hinges"] == (4, 4)
    assert "mean_cortical_thickness_mm" not in result.left_out
    assert pooled([[0, 0], [1, 1]], {"accuracy": "draft"}).left_out["wavelength_mm"] == (4, 4)  # half is none
    assert pooled([[0, 0], [0, 1], [1, -1]], {"accuracy": "draft"}).left_out["wavelength_mm"] == (2, 5)
    hinges = sides([NAN, NAN], [5.0, 6.0])  # only hemispheres with a value count
    assert "n_hinges" not in pooled([[0, 0], [1, 1]], {"graph_width_mm": 9.0}, n_hinges=hinges).left_out


def test_a_new_measure_depends_on_all_parameters():
    result = pooled([[0, 0], [0, 1]], {"folding_scale_mm": 4.0}, new_measure=np.ones((2, 2)))
    assert result.left_out["new_measure"] == (1, 4)
    assert set(PARAMETERS_OF_SCALAR) <= set(SCALARS)
    assert {key for keys in PARAMETERS_OF_SCALAR.values() for key in keys} <= set(PARAMETERS)


def test_the_options_for_equal_settings_are_the_coarsest_scale_and_the_median_width():
    others = {"graph_width_mm": 7.0}, {"folding_scale_mm": 3.912, "graph_width_mm": 8.0}, {"graph_width_mm": 9.0}
    assert "--curvature-scale 3.91 --gyral-width 8.5" in pooled([[1, 2], [3, 3]], *others).sentences[1]
