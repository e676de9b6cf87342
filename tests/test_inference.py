"""Linear models at every vertex, tested by permutations over the whole surface."""

import numpy as np
import pytest
from scipy import stats

from morphofold.analysis import smooth
from morphofold.errors import DoesNotApply, OutOfRange, WrongShape
from morphofold.geometry import vertex_areas
from morphofold.group.clusters import Mesh
from morphofold.group.permutations import Model, exchanges, infer, variance_trend
from morphofold.shapes import icosphere
from morphofold.threads import using_threads

VERTS, FACES = icosphere(3, radius=50.0)
MESH = Mesh(FACES, vertex_areas(VERTS, FACES))


def study(subjects, seed, fwhm=20.0):
    """Smooth noise of standard deviation 1, age, sex, and a design with intercept, age and sex."""
    random = np.random.default_rng(seed)
    noise = smooth(VERTS, FACES, random.standard_normal((len(VERTS), subjects)), fwhm).T
    age, sex = random.uniform(20, 80, subjects), random.integers(0, 2, subjects).astype(float)
    return noise / noise.std(), age, np.column_stack([np.ones(subjects), age, sex])


def refitted(maps, design, contrast):
    """t of a contrast by least squares, written out."""
    coefficients = np.linalg.lstsq(design, maps, rcond=None)[0]
    errors = maps - design @ coefficients
    df = len(design) - design.shape[1]
    spread = contrast @ np.linalg.inv(design.T @ design) @ contrast
    return contrast @ coefficients / np.sqrt(spread * (errors**2).sum(axis=0) / df), contrast @ coefficients


CONTRASTS = [np.array([0.0, 1, 0]), np.array([0.0, 0, 1]), np.array([0.0, 1, -2]), np.array([1.0, 30, 0])]


@pytest.mark.parametrize("contrast", CONTRASTS, ids=["age", "sex", "both", "mean at 30"])
def test_t_and_effect_are_those_of_least_squares(contrast):
    maps, age, design = study(20, 1)
    maps = maps + 0.02 * age[:, None]
    found = infer(maps, design, contrast, MESH, permutations=1)
    t, effect = refitted(maps, design, contrast)
    np.testing.assert_allclose(found.t, t, atol=1e-9)
    np.testing.assert_allclose(found.effect, effect, atol=1e-11)
    np.testing.assert_allclose(found.p, 2 * stats.t.sf(np.abs(t), 17), rtol=1e-6)
    assert found.df == 17


def test_units_of_columns_change_nothing():
    """Products of volumes in mm3 beside the intercept."""
    maps, _, design = study(20, 1)
    one = infer(maps, design, CONTRASTS[2], MESH, permutations=19)
    other = infer(maps, design * [1, 1e-20, 1], CONTRASTS[2] * [1, 1e-20, 1], MESH, permutations=19)
    np.testing.assert_allclose(other.t, one.t, rtol=1e-6)
    np.testing.assert_allclose(other.null_tfce, one.null_tfce, rtol=1e-6)
    assert not other.flipped


def test_r_is_the_partial_correlation():
    """Of what is left of map and age after intercept and sex are taken out of both."""
    maps, age, design = study(12, 5)
    found = infer(maps, design, CONTRASTS[0], MESH, permutations=1)
    others = design[:, [0, 2]]
    left = [x - others @ np.linalg.lstsq(others, x, rcond=None)[0] for x in (age, maps[:, 7])]
    assert found.r[7] == pytest.approx(np.corrcoef(*left)[0, 1], rel=1e-9)


@pytest.mark.parametrize("contrast", CONTRASTS, ids=["age", "sex", "both", "mean at 30"])
@pytest.mark.parametrize("flip", [False, True])
def test_an_exchange_is_a_fit_to_exchanged_residuals(contrast, flip):
    maps, _, design = study(20, 1)
    model = Model(design, contrast)
    residuals = model.residuals(maps)
    shuffled = exchanges(20, 4, 0, flip=flip)[:2]
    for rows, signs, t in zip(*shuffled, model.t(residuals, *shuffled)):
        np.testing.assert_allclose(t, refitted(signs[:, None] * residuals[rows], design, contrast)[0], atol=1e-9)


def test_exchanges_keep_to_their_blocks():
    blocks = np.array([3, 1, 1, 3, 3, 2, 2, 1])
    for rows in exchanges(8, 50, 0, blocks=blocks)[0]:
        np.testing.assert_array_equal(blocks[rows], blocks)
        assert sorted(rows) == list(range(8))
    signs = exchanges(8, 50, 0, flip=True, blocks=blocks)[1]
    for block in (1, 2, 3):
        assert (np.ptp(signs[:, blocks == block], axis=1) == 0).all()
    assert len(np.unique(exchanges(8, 50, 0, flip=True)[1], axis=0)) > 40


def test_whole_blocks_change_places_with_blocks_of_their_size():
    blocks = np.array([0, 0, 1, 2, 2, 3, 4, 4])
    found = exchanges(8, 200, 0, blocks=blocks, whole=True)[0]
    for rows in found:
        assert sorted(rows) == list(range(8))
        pairs = [tuple(rows[blocks == b]) for b in (0, 2, 4)]
        assert set(pairs) == {(0, 1), (3, 4), (6, 7)}  # in their order
        assert {rows[2], rows[5]} == {2, 5}
    assert len({tuple(rows) for rows in found}) == 12  # 3! times 2!


@pytest.mark.parametrize(("blocks", "whole"), [(np.arange(5), False), (np.array([0, 0, 1, 1, 1]), True)])
def test_blocks_that_leave_nothing_to_exchange_are_refused(blocks, whole):
    with pytest.raises(DoesNotApply):
        exchanges(5, 10, 0, blocks=blocks, whole=whole)


def test_null_studies_are_significant_in_one_of_twenty():
    """120 studies of 12 subjects whose maps depend on sex but not on age."""
    found = []
    for seed in range(120):
        maps, _, design = study(12, seed)
        maps = maps + 0.5 * design[:, 2:]
        one = infer(maps, design, np.array([0.0, 1, 0]), MESH, permutations=59, seed=seed, forming_p=0.02)
        smallest = [np.nanmin(one.p_height), np.nanmin(one.p_tfce), min((c["p"] for c in one.clusters), default=1.0)]
        found.append(np.array(smallest) <= 0.05)
    wrong = np.sum(found, axis=0)  # 6 are expected; 1 to 13 hold 99 % of such counts
    assert (wrong >= 1).all()
    assert (wrong <= 13).all()
    uncorrected = infer(*study(12, 0)[::2], np.array([0.0, 1, 0]), MESH, permutations=1).p
    assert np.nanmin(uncorrected) < 0.05  # without correction nearly every study would be


def test_a_planted_effect_is_found_where_it_is():
    maps, age, design = study(40, 3)
    patch = VERTS[:, 2] > 35
    maps = maps + 0.07 * patch * (age[:, None] - 50)
    found = infer(maps, design, np.array([0.0, 1, 0]), MESH, permutations=199)
    inside = VERTS[:, 2] > 40
    assert (found.p_tfce[inside] <= 0.05).mean() > 0.95
    assert (found.p_height[inside] <= 0.05).mean() > 0.8
    far = VERTS[:, 2] < 15
    assert (found.p_tfce[far] <= 0.05).mean() < 0.02
    np.testing.assert_allclose(found.effect[inside].mean(), 0.07, atol=0.01)
    largest = found.clusters[0]
    assert largest["p"] == 1 / 200
    assert patch[largest["peak"]]
    assert largest["area_mm2"] == pytest.approx(MESH.areas[patch].sum(), rel=0.3)
    assert (found.cluster[inside] == 0).mean() > 0.95
    negative = infer(-maps, design, np.array([0.0, 1, 0]), MESH, permutations=199)
    np.testing.assert_array_equal(negative.p_tfce, found.p_tfce)
    np.testing.assert_allclose(negative.t, -found.t)


def test_a_mean_that_differs_from_zero_is_found_by_flipping_signs():
    maps, *_ = study(16, 4)
    patch = VERTS[:, 0] > 30
    found = infer(maps + 2.0 * patch, np.ones((16, 1)), np.ones(1), MESH, permutations=199)
    np.testing.assert_allclose(found.t, stats.ttest_1samp(maps + 2.0 * patch, 0).statistic, rtol=1e-9)
    assert (found.p_tfce[VERTS[:, 0] > 35] <= 0.05).all()
    assert (found.p_tfce[VERTS[:, 0] < 10] <= 0.05).mean() < 0.02


@pytest.mark.parametrize(
    ("contrast", "flipped"),
    [([1.0, 0, 0], True), ([0.0, 1, 0], False), ([0, 0, 1.0], False), ([1.0, 50, 0], True)],
    ids=["intercept", "age", "sex", "mean at 50"],
)
def test_means_are_tested_by_signs(contrast, flipped):
    maps, _, design = study(12, 3)
    assert infer(maps, design, np.array(contrast), MESH, permutations=5).flipped is flipped


def test_the_mean_of_one_group_is_tested_by_signs_and_the_difference_by_exchange():
    maps, _, _ = study(12, 3)
    groups = np.repeat(np.eye(2), 6, axis=0)
    assert infer(maps, groups, np.array([1.0, 0]), MESH, permutations=5).flipped
    assert not infer(maps, groups, np.array([1.0, -1]), MESH, permutations=5).flipped


def test_a_large_mean_beside_a_covariate_is_found_and_none_is_not():
    """Exchanging subjects would give p = 1 for the first."""
    random = np.random.default_rng(4)
    design = np.column_stack([np.ones(20), random.standard_normal(20)])
    design[:, 1] -= design[:, 1].mean()
    found = infer(study(20, 5)[0] + 3.0, design, np.array([1.0, 0]), MESH, permutations=199)
    assert (found.p_height <= 0.05).all()
    hits = sum(
        np.nanmin(infer(study(12, seed)[0], design[:12], np.array([1.0, 0]), MESH, permutations=99).p_height) <= 0.05
        for seed in range(60)
    )
    assert hits <= 9  # 3 expected; more than 9: once in a thousand


def test_vertices_that_a_subject_does_not_know_are_not_tested():
    maps, _, design = study(20, 1)
    maps[3, :50] = np.nan
    found = infer(maps, design, np.array([0.0, 1, 0]), MESH, permutations=19)
    for values in (found.t, found.effect, found.p, found.p_height, found.p_tfce):
        assert np.isnan(values[:50]).all()
        assert np.isfinite(values[50:]).all()


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_threads():
    maps, _, design = study(20, 1)
    found = []
    for threads in (1, None):
        with using_threads(threads):
            found.append(infer(maps, design, np.array([0.0, 1, 0]), MESH, permutations=100, seed=5))
    for name in ("t", "p_height", "p_tfce", "null_height", "null_area", "null_tfce"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_bad_designs_are_refused():
    maps, age, design = study(20, 1)
    one = np.array([0.0, 1, 0])
    for error, X, c in (
        (DoesNotApply, design, np.zeros(3)),
        (DoesNotApply, np.column_stack([design[:, :2], np.full(20, 5.0)]), one),
        (DoesNotApply, np.column_stack([design[:, :2], 2 * age]), one),
        (WrongShape, design, np.ones(2)),
        (WrongShape, design[:-1], one),
    ):
        with pytest.raises(error):
            infer(maps, X, c, MESH, permutations=1)
    with pytest.raises(DoesNotApply):
        infer(maps[:3], design[[0, 1, 2]], one, MESH, permutations=1)
    with pytest.raises(DoesNotApply):
        infer(np.full_like(maps, np.nan), design, one, MESH, permutations=1)
    for options in ({"permutations": 0}, {"forming_p": 0.0}):
        with pytest.raises(OutOfRange):
            infer(maps, design, one, MESH, **options)


# --- unequal variances


def two_groups(sizes, spreads, seed):
    """Smooth noise of two groups with their own standard deviations, and the design of intercept and group."""
    group = np.repeat([0, 1], sizes)
    maps = study(len(group), seed)[0] * np.repeat(spreads, sizes)[:, None]
    return maps, np.column_stack([np.ones(len(group)), group]), group


DIFFERENCE = np.array([0.0, 1])


def test_t_of_two_variance_groups_is_that_of_welch():
    maps, design, group = two_groups((6, 14), (3.0, 1.0), 1)
    found = infer(maps, design, DIFFERENCE, MESH, permutations=1, groups=group)
    welch = stats.ttest_ind(maps[group == 1], maps[group == 0], equal_var=False)
    np.testing.assert_allclose(found.t, welch.statistic, rtol=1e-9)
    np.testing.assert_allclose(found.degrees, welch.df, rtol=1e-9)
    np.testing.assert_allclose(found.p, welch.pvalue, rtol=1e-7)
    interval = welch.confidence_interval(0.95)
    np.testing.assert_allclose(found.effect - found.half_width, interval.low, rtol=1e-8)
    np.testing.assert_allclose(found.effect + found.half_width, interval.high, rtol=1e-8)
    assert found.flipped


def test_the_interval_of_one_variance_is_that_of_least_squares():
    maps, _, design = study(15, 3)
    found = infer(maps, design, CONTRASTS[0], MESH, permutations=1)
    t, effect = refitted(maps, design, CONTRASTS[0])
    np.testing.assert_allclose(found.half_width, np.abs(effect / t) * stats.t.ppf(0.975, 12), rtol=1e-8)


def test_changed_signs_with_variance_groups_are_a_fit_to_changed_residuals():
    """Written out: the effect by least squares, over its standard error from the residual variance of each group."""
    maps, _, design = study(18, 2)
    group, contrast = np.repeat([0, 1, 2], 6), np.array([0.0, 1, 0])
    model = Model(design, contrast, group)
    residuals, changed = model.residuals(maps), exchanges(18, 5, 1, flip=True)[:2]
    weights = design @ np.linalg.inv(design.T @ design) @ contrast  # of the subjects in the effect
    free = 1 - np.diag(design @ np.linalg.pinv(design))
    for signs, t in zip(changed[1], model.t(residuals, *changed)):
        data = signs[:, None] * residuals
        errors = data - design @ np.linalg.lstsq(design, data, rcond=None)[0]
        variance = sum(
            (errors[group == g] ** 2).sum(axis=0) / free[group == g].sum() * (weights[group == g] ** 2).sum()
            for g in range(3)
        )
        np.testing.assert_allclose(t, weights @ data / np.sqrt(variance), atol=1e-9)


def test_one_variance_group_is_no_group():
    maps, _, design = study(12, 2)
    one = infer(maps, design, CONTRASTS[0], MESH, permutations=1, groups=np.zeros(12, dtype=int))
    none = infer(maps, design, CONTRASTS[0], MESH, permutations=1)
    np.testing.assert_allclose(one.t, none.t, rtol=1e-9)
    np.testing.assert_allclose(one.p, none.p, rtol=1e-7)


def test_a_variance_group_that_leaves_no_residuals_is_refused():
    maps, design, _ = two_groups((6, 6), (1.0, 1.0), 1)
    with pytest.raises(DoesNotApply):
        infer(maps, design, DIFFERENCE, MESH, permutations=1, groups=np.array([0] * 11 + [1]))


def test_a_small_group_that_varies_more_needs_variance_groups():
    """40 studies without an effect: nearly all are significant without, 2 are expected with."""
    hits = np.zeros(2, dtype=int)
    for seed in range(40):
        maps, design, group = two_groups((6, 24), (3.0, 1.0), seed)
        for k, groups in enumerate((None, group)):
            found = infer(maps, design, DIFFERENCE, MESH, permutations=39, seed=seed, groups=groups)
            hits[k] += np.nanmin(found.p_height) <= 0.05
    assert hits[0] >= 30
    assert hits[1] <= 8  # binomial of 5 %: more than 7 once in 5,000


def test_a_trend_of_the_variance_is_found_and_none_is_not():
    alarms = {1.0: 0, 3.0: 0}
    for seed in range(100):
        for spread in alarms:
            maps, design, _ = two_groups((10, 14), (1.0, spread), seed)
            model = Model(design, DIFFERENCE)
            ratio, p = variance_trend(model.errors(model.residuals(maps)), model.freedom, model.regressor)
            alarms[spread] += p < 0.01
            assert ratio >= 1
    assert alarms[1.0] <= 6  # 1 expected; more than 6 once in 10,000
    assert alarms[3.0] == 100


def test_the_ratio_of_variances_is_that_of_the_data():
    random, age = np.random.default_rng(0), np.linspace(0, 1, 200)
    errors = random.standard_normal((200, 4000)) * np.exp(age)[:, None]
    ratio, p = variance_trend(errors, np.ones(200), age)
    assert ratio == pytest.approx(np.exp(2), rel=0.03)
    assert p < 1e-100
    assert np.isnan(variance_trend(errors, np.ones(200), np.ones(200))).all()


# --- how many exchanges there are


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({}, 40320),
        ({"flip": True}, 256),
        ({"blocks": np.array([0, 0, 0, 1, 1, 1, 2, 2])}, 72),
        ({"blocks": np.array([0, 0, 1, 2, 2, 3, 4, 4]), "whole": True}, 12),
        ({"blocks": np.array([0, 0, 1, 2, 2, 3, 4, 4]), "flip": True}, 32),
    ],
)
def test_exchanges_are_counted(options, count):
    rows, signs, possible = exchanges(8, 4000, 0, **options)
    assert possible == count
    if count < 100:
        assert len(np.unique(np.column_stack([rows, signs]), axis=0)) == count


def test_four_subjects_have_24_exchanges_and_no_smaller_p():
    maps, age, _ = study(4, 0)
    design = np.column_stack([np.ones(4), age])
    found = infer(0.01 * maps + age[:, None], design, DIFFERENCE, MESH, permutations=999)
    assert found.possible == 24
    assert found.least_p == pytest.approx(1 / 24, abs=4 * np.sqrt(1 / 24 / 999))
    assert found.p_height.min() == found.least_p
    groups = infer(maps, np.column_stack([np.ones(8), np.repeat([0, 1], 4)])[[0, 1, 6, 7]], DIFFERENCE, MESH)
    assert groups.least_p == pytest.approx(1 / 3, abs=0.06)  # 2 of 6 ways to divide four into pairs
    assert infer(study(20, 1)[0], study(20, 1)[2], CONTRASTS[0], MESH, permutations=99).least_p == 0.01
