"""Linear models at every vertex, tested by permutations over the whole surface; clusters, and their enhancement."""

import numpy as np
import pytest
from scipy import stats

from morphofold.analysis import smooth
from morphofold.errors import DoesNotApply, WrongShape
from morphofold.geometry import vertex_areas
from morphofold.group import permuted_model
from morphofold.group.clusters import Mesh, clusters, tfce
from morphofold.group.permuted_model import Model, exchanges, infer, variance_trend
from morphofold.shapes import icosphere
from morphofold.studies.irregular_spheres import irregular_sphere
from morphofold.threads import using_threads

VERTS, FACES = icosphere(3, radius=50.0)
MESH = Mesh(FACES, vertex_areas(VERTS, FACES))
AGE, DIFFERENCE = np.array([0.0, 1, 0]), np.array([0.0, 1])


def study(subjects, seed):
    """Smooth noise of standard deviation 1, age, sex, and a design with intercept, age and sex."""
    random = np.random.default_rng(seed)
    noise = smooth(VERTS, FACES, random.standard_normal((len(VERTS), subjects)), 20.0).T
    age, sex = random.uniform(20, 80, subjects), random.integers(0, 2, subjects).astype(float)
    return noise / noise.std(), age, np.column_stack([np.ones(subjects), age, sex])


def refitted(maps, design, contrast):
    """t and effect of a contrast by least squares, written out."""
    coefficients = np.linalg.lstsq(design, maps, rcond=None)[0]
    errors = maps - design @ coefficients
    df = len(design) - design.shape[1]
    spread = contrast @ np.linalg.inv(design.T @ design) @ contrast
    return contrast @ coefficients / np.sqrt(spread * (errors**2).sum(axis=0) / df), contrast @ coefficients


CONTRASTS = [AGE, np.array([0.0, 0, 1]), np.array([0.0, 1, -2]), np.array([1.0, 30, 0])]
each_contrast = pytest.mark.parametrize("contrast", CONTRASTS, ids=["age", "sex", "both", "mean at 30"])


@each_contrast
def test_t_effect_and_interval_are_those_of_least_squares(contrast):
    maps, age, design = study(20, 1)
    maps = maps + 0.02 * age[:, None]
    result = infer(maps, design, contrast, MESH, permutations=1)
    t, effect = refitted(maps, design, contrast)
    np.testing.assert_allclose(result.t, t, atol=1e-9)
    np.testing.assert_allclose(result.effect, effect, atol=1e-11)
    np.testing.assert_allclose(result.p, 2 * stats.t.sf(np.abs(t), 17), rtol=1e-6)
    np.testing.assert_allclose(result.half_width, np.abs(effect / t) * stats.t.ppf(0.975, 17), rtol=1e-6)
    assert result.df == 17


def test_units_of_columns_change_nothing():
    """Products of volumes in mm3 beside the intercept."""
    maps, _, design = study(20, 1)
    scale = np.array([1, 1e-20, 1])
    usual, tiny = (infer(maps, design * s, CONTRASTS[2] * s, MESH, permutations=19) for s in (np.ones(3), scale))
    np.testing.assert_allclose(tiny.t, usual.t, rtol=1e-6)
    np.testing.assert_allclose(tiny.null_tfce, usual.null_tfce, rtol=1e-6)
    assert not tiny.by_signs


def test_r_is_the_partial_correlation():
    """Of what is left of map and age after intercept and sex are taken out of both."""
    maps, age, design = study(12, 5)
    others = design[:, [0, 2]]
    left = [x - others @ np.linalg.lstsq(others, x, rcond=None)[0] for x in (age, maps[:, 7])]
    r = infer(maps, design, AGE, MESH, permutations=1).r[7]
    assert r == pytest.approx(np.corrcoef(*left)[0, 1], rel=1e-9)


@each_contrast
@pytest.mark.parametrize("flip", [False, True])
def test_an_exchange_is_a_fit_to_exchanged_residuals(contrast, flip):
    maps, _, design = study(20, 1)
    model = Model(design, contrast)
    residuals = model.residuals(maps)
    shuffled = exchanges(20, 4, 0, flip=flip)[:2]
    for rows, signs, t in zip(*shuffled, model.t(residuals, *shuffled)):
        np.testing.assert_allclose(t, refitted(signs[:, None] * residuals[rows], design, contrast)[0], atol=1e-9)


# --- exchanges


def test_exchanges_keep_to_their_blocks():
    blocks = np.array([3, 1, 1, 3, 3, 2, 2, 1])
    for rows in exchanges(8, 50, 0, blocks=blocks)[0]:
        np.testing.assert_array_equal(blocks[rows], blocks)
        assert sorted(rows) == list(range(8))
    signs = exchanges(8, 50, 0, flip=True, blocks=blocks)[1]
    for block in (1, 2, 3):
        assert (np.ptp(signs[:, blocks == block], axis=1) == 0).all()


def test_whole_blocks_change_places_with_blocks_of_their_size():
    blocks = np.array([0, 0, 1, 2, 2, 3, 4, 4])
    for rows in exchanges(8, 200, 0, blocks=blocks, whole=True)[0]:
        assert sorted(rows) == list(range(8))
        assert {tuple(rows[blocks == b]) for b in (0, 2, 4)} == {(0, 1), (3, 4), (6, 7)}  # in their order
        assert {rows[2], rows[5]} == {2, 5}


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


@pytest.mark.parametrize(("blocks", "whole"), [(np.arange(5), False), (np.array([0, 0, 1, 1, 1]), True)])
def test_blocks_that_leave_nothing_to_exchange_are_refused(blocks, whole):
    with pytest.raises(DoesNotApply):
        exchanges(5, 10, 0, blocks=blocks, whole=whole)


def test_four_subjects_have_24_exchanges_and_no_smaller_p():
    maps, age, _ = study(4, 0)
    design = np.column_stack([np.ones(4), age])
    result = infer(0.01 * maps + age[:, None], design, DIFFERENCE, MESH, permutations=999)
    assert result.n_possible == 24
    assert result.least_p == pytest.approx(1 / 24, abs=4 * np.sqrt(1 / 24 / 999))
    assert result.p_height.min() == result.least_p
    pairs = infer(maps, np.column_stack([np.ones(4), [0, 0, 1, 1]]), DIFFERENCE, MESH)
    assert pairs.least_p == pytest.approx(1 / 3, abs=0.06)  # 2 of 6 ways to divide four into pairs
    assert infer(study(20, 1)[0], study(20, 1)[2], AGE, MESH, permutations=99).least_p == 0.01


# --- what is significant


@pytest.mark.slow
def test_null_studies_are_significant_in_one_of_twenty(monkeypatch):
    """120 studies of 12 subjects whose maps depend on sex but not on age."""
    monkeypatch.setattr(permuted_model, "FORMING_P", 0.02)
    hits = np.zeros(3, dtype=int)
    for seed in range(120):
        maps, _, design = study(12, seed)
        result = infer(maps + 0.5 * design[:, 2:], design, AGE, MESH, permutations=59, seed=seed)
        cluster = min((row["p"] for row in result.clusters), default=1.0)
        hits += np.array([np.nanmin(result.p_height), np.nanmin(result.p_tfce), cluster]) <= 0.05
    assert (hits >= 1).all()  # 6 are expected; 1 to 13 hold 99 % of such counts
    assert (hits <= 13).all()
    uncorrected = infer(*study(12, 0)[::2], AGE, MESH, permutations=1).p
    assert np.nanmin(uncorrected) < 0.05  # without correction nearly every study would be


def test_a_planted_effect_is_significant_where_it_is():
    maps, age, design = study(40, 3)
    patch, inside, far = VERTS[:, 2] > 35, VERTS[:, 2] > 40, VERTS[:, 2] < 15
    maps = maps + 0.07 * patch * (age[:, None] - 50)
    result = infer(maps, design, AGE, MESH, permutations=199)
    assert (result.p_tfce[inside] <= 0.05).mean() > 0.95
    assert (result.p_height[inside] <= 0.05).mean() > 0.8
    assert (result.p_tfce[far] <= 0.05).mean() < 0.02
    np.testing.assert_allclose(result.effect[inside].mean(), 0.07, atol=0.01)
    largest = result.clusters[0]
    assert largest["p"] == 1 / 200
    assert patch[largest["peak"]]
    assert largest["area_mm2"] == pytest.approx(MESH.areas[patch].sum(), rel=0.3)
    assert (result.cluster_of[inside] == 0).mean() > 0.95
    negative = infer(-maps, design, AGE, MESH, permutations=199)
    np.testing.assert_array_equal(negative.p_tfce, result.p_tfce)
    np.testing.assert_allclose(negative.t, -result.t)


def test_a_mean_that_differs_from_zero_is_tested_by_changing_signs():
    maps = study(16, 4)[0] + 2.0 * (VERTS[:, 0] > 30)
    result = infer(maps, np.ones((16, 1)), np.ones(1), MESH, permutations=199)
    np.testing.assert_allclose(result.t, stats.ttest_1samp(maps, 0).statistic, rtol=1e-9)
    assert (result.p_tfce[VERTS[:, 0] > 35] <= 0.05).all()
    assert (result.p_tfce[VERTS[:, 0] < 10] <= 0.05).mean() < 0.02


@pytest.mark.parametrize(
    ("contrast", "flipped"),
    [([1.0, 0, 0], True), ([0.0, 1, 0], False), ([0, 0, 1.0], False), ([1.0, 50, 0], True)],
    ids=["intercept", "age", "sex", "mean at 50"],
)
def test_means_are_tested_by_signs(contrast, flipped):
    maps, _, design = study(12, 0)
    assert infer(maps, design, np.array(contrast), MESH, permutations=1).by_signs == flipped


def test_a_mean_beside_covariates_is_significant_and_none_in_one_of_twenty():
    covariate = np.random.default_rng(1).standard_normal(20)
    design = np.column_stack([np.ones(20), covariate - covariate.mean()])
    assert (infer(study(20, 5)[0] + 3.0, design, 1 - DIFFERENCE, MESH, permutations=199).p_height <= 0.05).all()
    maps = [study(12, seed)[0] for seed in range(60)]
    hits = sum(infer(m, design[:12], 1 - DIFFERENCE, MESH, permutations=99).p_height.min() <= 0.05 for m in maps)
    assert hits <= 9  # 3 expected; more than 9: once in a thousand


def test_vertices_without_a_value_in_a_subject_are_not_tested():
    maps, _, design = study(20, 1)
    maps[3, :50] = np.nan
    result = infer(maps, design, AGE, MESH, permutations=19)
    for values in (result.t, result.effect, result.p, result.p_height, result.p_tfce):
        assert np.isnan(values[:50]).all()
        assert np.isfinite(values[50:]).all()


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_threads():
    maps, _, design = study(20, 1)
    results = []
    for threads in (1, None):
        with using_threads(threads):
            results.append(infer(maps, design, AGE, MESH, permutations=100, seed=5))
    for name in ("t", "p_height", "p_tfce", "null_height", "null_area", "null_tfce"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name))


def test_bad_designs_are_refused():
    maps, age, design = study(20, 1)
    for error, Y, X, c in (
        (DoesNotApply, maps, design, np.zeros(3)),
        (DoesNotApply, maps, np.column_stack([design[:, :2], np.full(20, 5.0)]), AGE),
        (DoesNotApply, maps, np.column_stack([design[:, :2], 2 * age]), AGE),
        (WrongShape, maps, design, np.ones(2)),
        (WrongShape, maps, design[:-1], AGE),
        (DoesNotApply, maps[:3], design[:3], AGE),
        (DoesNotApply, np.full_like(maps, np.nan), design, AGE),
    ):
        with pytest.raises(error):
            infer(Y, X, c, MESH, permutations=1)
    for options in ({"permutations": 0}, {"seed": -1}):
        with pytest.raises(ValueError):
            infer(maps, design, AGE, MESH, **options)


# --- unequal variances


@pytest.mark.slow
def test_unequal_variances_of_two_groups_are_seen_and_equal_ones_are_not():
    alarms = {1.0: 0, 3.0: 0}
    group = np.repeat([0, 1], [10, 14])
    for seed in range(100):
        for spread in alarms:
            model = Model(np.column_stack([np.ones(24), group]), DIFFERENCE)
            maps = study(24, seed)[0] * np.where(group, spread, 1.0)[:, None]
            ratio, p = variance_trend(model.errors(model.residuals(maps)), model.subject_df, model.regressor)
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


def test_t_of_two_variance_groups_is_that_of_welch_by_changed_signs():
    maps, group = study(20, 1)[0], np.repeat([0, 1], (6, 14))
    maps[:6] *= 3
    design = np.column_stack([np.ones(20), group])
    fit = infer(maps, design, DIFFERENCE, MESH, permutations=1, groups=group)
    welch = stats.ttest_ind(maps[group == 1], maps[group == 0], equal_var=False)
    interval = welch.confidence_interval(0.95)
    for value, expected in (
        (fit.t, welch.statistic),
        (fit.df_map, welch.df),
        (fit.p, welch.pvalue),
        (fit.effect - fit.half_width, interval.low),
        (fit.effect + fit.half_width, interval.high),
    ):
        np.testing.assert_allclose(value, expected, rtol=1e-7)
    assert fit.by_signs
    with pytest.raises(DoesNotApply):  # no residual of the second group
        infer(maps, design, DIFFERENCE, MESH, permutations=1, groups=np.array([0] * 19 + [1]))


def test_changed_signs_with_variance_groups_are_a_fit_to_changed_residuals():
    """Written out: the effect by least squares, over its standard error from the residual variance of each group."""
    maps, _, design = study(18, 2)
    group = np.repeat([0, 1, 2], 6)
    model = Model(design, AGE, group)
    residuals, (rows, signs, _) = model.residuals(maps), exchanges(18, 5, 1, flip=True)
    weights = design @ np.linalg.inv(design.T @ design) @ AGE  # of the subjects in the effect
    free = 1 - np.diag(design @ np.linalg.pinv(design))
    for sign, t in zip(signs, model.t(residuals, rows, signs)):
        data = sign[:, None] * residuals
        errors = data - design @ np.linalg.lstsq(design, data, rcond=None)[0]
        sides = [group == g for g in range(3)]
        variance = sum((errors[s] ** 2).sum(axis=0) / free[s].sum() * (weights[s] ** 2).sum() for s in sides)
        np.testing.assert_allclose(t, weights @ data / np.sqrt(variance), atol=1e-9)


def test_a_small_group_that_varies_more_needs_variance_groups():
    """40 studies without an effect: nearly all are significant without, 2 are expected with."""
    hits, group = np.zeros(2, dtype=int), np.repeat([0, 1], (6, 24))
    for seed in range(40):
        maps, design = study(30, seed)[0], np.column_stack([np.ones(30), group])
        maps[:6] *= 3
        fits = [infer(maps, design, DIFFERENCE, MESH, permutations=39, seed=seed, groups=g) for g in (None, group)]
        hits += [np.nanmin(fit.p_height) <= 0.05 for fit in fits]
    assert hits[0] >= 30
    assert hits[1] <= 8  # binomial of 5 %: more than 7 once in 5,000


# --- clusters and threshold-free cluster enhancement


@pytest.fixture(scope="module")
def uneven():
    verts, faces = irregular_sphere(4, radius=50.0, rng=1)
    values = smooth(verts, faces, np.random.default_rng(2).standard_normal(len(verts)), 15.0)
    return Mesh(faces, vertex_areas(verts, faces)), values / values.std()


def by_steps(values, mesh, steps):
    """The integral as a sum over thresholds, in the middle of each step."""
    top, total = values.max(), np.zeros(len(values))
    for h in (np.arange(steps) + 0.5) * top / steps:
        cluster, areas = clusters(values, h, mesh)
        inside = cluster >= 0
        total[inside] += areas[cluster[inside]] * h**2 * top / steps
    return total


def test_enhancement_is_the_limit_of_sums_over_thresholds(uneven):
    mesh, values = uneven
    exact = np.maximum(tfce(values, mesh), 0)
    errors = [np.abs(by_steps(values, mesh, steps) - exact).max() / exact.max() for steps in (50, 100, 200)]
    assert errors[2] < 0.01
    assert errors[2] < 0.7 * errors[1] < 0.5 * errors[0]


def test_two_peaks_share_what_is_below_their_pass():
    z = VERTS[:, 2]
    high, low = z > 30, (z <= 0) & (z > -20)
    total = MESH.areas[z > -20].sum() / 3
    enhanced = tfce(np.select([high, z > 0, low], [3.0, 1.0, 2.0]), MESH)
    np.testing.assert_allclose(enhanced[high], total + MESH.areas[high].sum() * (27 - 1) / 3, rtol=1e-12)
    np.testing.assert_allclose(enhanced[(z <= 30) & (z > 0)], total, rtol=1e-12)
    np.testing.assert_allclose(enhanced[low], total + MESH.areas[low].sum() * (8 - 1) / 3, rtol=1e-12)


def test_enhancement_of_signs_multiples_and_unknown_values(uneven, rng):
    mesh, values = uneven
    enhanced = tfce(values, mesh)
    np.testing.assert_allclose(tfce(-values, mesh), -enhanced, atol=1e-12 * enhanced.max())
    np.testing.assert_array_equal(enhanced > 0, values > 0)
    gaps = rng.random(len(values)) < 0.1
    np.testing.assert_array_equal(tfce(np.where(gaps, np.nan, values), mesh), tfce(np.where(gaps, 0.0, values), mesh))
    np.testing.assert_allclose(tfce(3 * values, mesh), 27 * enhanced, atol=1e-11 * enhanced.max())
    with pytest.raises(WrongShape):
        tfce(np.zeros(5), mesh)


def test_enhancement_depends_little_on_the_mesh():
    tops = []
    for verts, faces in (icosphere(4, radius=50.0), icosphere(5, radius=50.0), irregular_sphere(5, radius=50.0, rng=3)):
        peak = np.exp(-((verts[:, 2] - 50.0) ** 2) / 200.0)
        tops.append(tfce(peak, Mesh(faces, vertex_areas(verts, faces))).max())
    np.testing.assert_allclose(tops, tops[1], rtol=0.03)


def test_clusters_are_connected_and_have_their_areas():
    verts, faces = icosphere(4, radius=50.0)
    mesh = Mesh(faces, vertex_areas(verts, faces))
    values = np.abs(verts[:, 2]) / 50.0  # two caps
    cluster, areas = clusters(values, 0.5, mesh)
    assert len(areas) == 2
    np.testing.assert_allclose(areas, 2 * np.pi * 50.0**2 * 0.5, rtol=0.05)
    assert (cluster[values <= 0.5] == -1).all()
    assert len(set(cluster[verts[:, 2] > 26])) == 1
    values[verts[:, 2] > 0] = np.nan
    assert len(clusters(values, 0.5, mesh)[1]) == 1
    assert len(clusters(values, 2.0, mesh)[1]) == 0
