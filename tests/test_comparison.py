"""The table, the thickness points and the theoretical line of a comparison."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis import measure
from morphofold.comparison import ThicknessPoint, compare, fit_line, thickness_cloud, wrinkling_wavelength
from morphofold.comparison.side_by_side import dimensionless_numbers, growth_curve, matching_growth
from morphofold.errors import DoesNotApply, MissingPart, NamedTwice, NothingToDo, NotReadable, OutOfRange, UnknownName
from morphofold.studies.folded_ball import folded_ball


def test_two_hemispheres_under_one_name_get_their_side():
    pair = [made_measures("lh"), made_measures("rh")]
    assert compare({"model": made_measures(), "MRI": pair}).names == ("model", "MRI lh", "MRI rh")
    assert compare({"MRI": pair[:1]}).names == ("MRI",)


def test_the_same_surface_compares_equal_whatever_its_origin_with_a_ratio_of_thicknesses():
    bare = made_measures()
    bare.scalars["median_gyral_thickness_mm"] = None
    result = compare({"a": made_measures(origin="simulation"), "b": made_measures(origin="FreeSurfer"), "c": bare})
    assert all(row["a"] == row["b"] for row in result.table)
    assert result.clouds[0] == result.clouds[1]
    (ratio,) = (row for row in result.table if row["measure"] == "gyral_to_cortical_ratio")
    assert (ratio["a"], ratio["c"]) == (10.0 / 2.5, None)


def test_points_are_regions_and_their_line_is_found():
    cloud = thickness_cloud(made_measures())
    assert cloud.kind == "region"
    assert [p.label for p in cloud.points] == ["front", "middle", "back"]
    assert (cloud.fit.slope, cloud.fit.intercept, cloud.fit.r) == pytest.approx((3.0, 1.0, 1.0), abs=1e-12)


def test_a_surface_without_regions_has_one_point_and_bins_on_the_line():
    m = made_measures(regions=False, level=4)
    cloud = thickness_cloud(m)
    assert cloud.kind == "whole"
    assert [(p.cortical, p.gyral) for p in cloud.points] == [(2.5, 10.0)]
    assert cloud.fit is None
    assert len(cloud.bins) == 8
    for b in cloud.bins:
        assert b.gyral == pytest.approx(1 + 3 * b.cortical, abs=1e-9)
        assert b.low <= b.gyral <= b.high


def test_crests_stand_in_for_regions_but_those_of_a_medial_wall():
    m = made_measures(regions=False)
    m.crests.extend(
        {"hemi": "lh", "crest": i, "cortical_thickness_mm": t, "gyral_thickness_mm": g}
        for i, (t, g) in enumerate([(2.0, 5.0), (3.0, 7.5), (4.0, 10.0), (4.5, None)])
    )
    cloud = thickness_cloud(m)
    assert (cloud.kind, len(cloud.points)) == ("crest", 3)
    assert cloud.fit.slope == pytest.approx(2.5)
    m.crests[:] = [
        {"crest": number, "cortical_thickness_mm": thickness, "gyral_thickness_mm": 5.0}
        for number, thickness in enumerate((0.1, 1.2, 1.3))  # its cortex is 2.5 mm thick, so two are of the wall
    ]
    assert [p.cortical for p in thickness_cloud(m).points] == [1.3]


def test_a_surface_with_regions_has_points_of_regions_whatever_the_others_have():
    model, brain = made_measures(regions=False), made_measures("rh")
    for m in (model, brain):
        m.crests.append({"crest": 0, "cortical_thickness_mm": 2.0, "gyral_thickness_mm": 5.0})
    mixed, regions = compare({"model": model, "MRI": brain}), compare({"a": brain, "b": made_measures()})
    assert [c.kind for c in mixed.clouds] == ["crest", "region"]
    assert [c.kind for c in regions.clouds] == ["region", "region"]
    assert len(mixed.notes) == len(regions.notes) + 1  # points of two kinds


@pytest.mark.slow
def test_the_interval_of_a_slope_holds_the_truth_as_often_as_it_says(rng):
    """95 % of intervals from noisy lines contain the slope they came from: 475 of 500, standard error 5."""
    x, inside = np.linspace(2, 3, 12), 0
    for _ in range(500):
        y = 3 * x + rng.normal(0, 0.5, len(x))
        fit = fit_line([ThicknessPoint(a, b, "") for a, b in zip(x, y)])
        inside += fit.slope_low <= 3 <= fit.slope_high
    assert abs(inside - 475) < 20


def test_a_slope_is_one_only_where_its_interval_leaves_out_zero():
    y = {True: (1.0, 2.1, 2.9, 4.0), False: (1.0, 3.0, 0.5, 2.0)}
    for sloped, values in y.items():
        fit = fit_line([ThicknessPoint(x, v, "") for x, v in enumerate(values)])
        assert fit.sloped is sloped
        assert (fit.slope_low * fit.slope_high > 0) is sloped
    assert fit_line([ThicknessPoint(x, -2 * x + 0.1 * (x % 2), "") for x in range(6)]).sloped
    for points in (((1, 2), (2, 3)), ((1, 2), (1, 3), (1, 4))):  # two points, or one thickness
        assert fit_line([ThicknessPoint(x, y, "") for x, y in points]) is None


def test_a_point_on_its_own_far_away_is_one_that_changes_a_slope():
    """It draws the line to itself, so that its residual is small."""
    x, y = np.array([2.0, 2.1, 2.2, 2.3, 2.4, 9.0]), np.array([1.0, 1.1, 1.0, 1.1, 1.0, 9.0])
    fit = fit_line([ThicknessPoint(a, b, "") for a, b in zip(x, y)])
    assert fit.slope_without_few == pytest.approx(np.polyfit(x[:5], y[:5], 1)[0], abs=1e-12)
    assert fit_line([ThicknessPoint(a, b, "") for a, b in zip([2.0] * 5 + [9.0], y)]).slope_without_few is None


def test_a_few_wide_crests_do_not_make_a_slope(rng):
    """Forty crests without a trend and two very wide ones where the cortex is thickest."""
    x, y = np.append(rng.uniform(2, 3, 40), [3.2, 3.3]), np.append(rng.normal(8, 0.5, 40), [20, 22])
    fit = fit_line([ThicknessPoint(a, b, "") for a, b in zip(x, y)])
    assert fit.slope > 2.5
    assert fit.slope_low > 0
    assert fit.slope_without_few == pytest.approx(np.polyfit(x[:40], y[:40], 1)[0])
    assert abs(fit.slope_without_few) < 1
    assert abs(fit.robust) < 1
    assert not fit.sloped
    np.testing.assert_allclose(np.median(y - fit.at(x)), 0, atol=1e-12)  # the line drawn is the robust one
    np.testing.assert_allclose(np.diff(fit.at(np.array([2.0, 3.0]))), fit.robust)


def test_differing_scales_are_said_once_with_their_values():
    brain = {"curvature_scale_mm": 3.0, "cortical_thickness_cap_mm": None, "cortex_mask": "where both differ"}
    options = {
        "model": {**brain, "curvature_scale_mm": 9.51},
        "brain": brain,
        "mean": {**brain, "cortical_thickness_cap_mm": 5.0, "cortex_mask": "label"},
    }
    measured = {name: replace(made_measures(), parameters=p) for name, p in options.items()}
    scale, cap, mask = compare(measured).cautions
    assert "9.5 mm on model and 3.0 mm on brain and mean" in scale
    assert "nowhere on model and brain and at 5 mm on mean" in cap
    assert "'where both differ' on model and brain and by 'label' on mean" in mask
    for parameters in (brain, {}):
        assert compare({"a": measured["brain"], "b": replace(made_measures(), parameters=parameters)}).cautions == ()


def test_the_theoretical_line_has_its_known_values():
    assert wrinkling_wavelength(3.0).slope == pytest.approx(2 * np.pi)
    assert wrinkling_wavelength(1.0).slope == pytest.approx(4.3566, abs=1e-4)
    assert wrinkling_wavelength(24.0).slope == pytest.approx(4 * np.pi)  # 8 times stiffer, twice as long


def test_stiffness_comes_from_the_surfaces_unless_it_is_an_option():
    soft, stiff, unknown = (made_measures(info={"mu_ratio": ratio}) for ratio in (1.0, 3.0, None))
    lines = lambda measures, options: compare(dict(zip("abc", measures)), **options).theory
    ratios = lambda *measures, **options: [line.mu_ratio for line in lines(measures, options)]
    assert ratios(stiff, soft, made_measures()) == [1.0, 3.0]
    assert ratios(stiff, mu_ratio=2.0) == [2.0]
    assert ratios(unknown, stiff) == [3.0]
    assert ratios(made_measures()) == ratios(unknown) == []  # a brain has no stiffness that is known
    with pytest.raises(OutOfRange, match=r"\bmu_ratio\b.* 0\.0\b"):
        compare({"a": soft}, mu_ratio=0.0)


def test_a_comparison_is_plain_json_and_says_what_is_missing_or_mirrored():
    result = compare({"a": made_measures()})
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["names"] == ["a"]
    assert any("Hinges were not counted" in note for note in result.notes)
    assert not any("mirror" in note for note in result.notes)
    assert any("a: a part was simulated" in note for note in compare({"a": made_measures(portion=0.125)}).notes)


@pytest.fixture(scope="module")
def balls():
    """A folded ball, as a left and a right hemisphere."""
    measured = measure(folded_ball(4000))
    return [replace(measured, cortex=replace(measured.cortex, hemi=hemi)) for hemi in ("lh", "rh")]


def test_hinges_of_groups_are_compared_and_those_of_each_name_without_groups(balls):
    by_name = compare({"a": balls, "b": balls[0]})
    assert by_name.groups == {"a": ("a lh", "a rh"), "b": ("b",)}
    (pair,) = by_name.hinges
    assert (pair.one, pair.other, pair.shape.n, pair.shape.m) == ("a", "b", 2 * pair.shape.m, pair.shape.m)
    assert pair.shape.p == 1.0  # two copies and one
    grouped = compare({"a": balls[0], "b": balls[0], "c": balls[1]}, groups={"model": ["a"], "MRI": ["c"]})
    assert [(pair.one, pair.other) for pair in grouped.hinges] == [("model", "MRI")]
    assert compare({"a": balls[0]}).hinges == ()
    assert compare({"a": made_measures(), "b": balls[0]}).hinges == ()  # one has no net


def test_the_law_of_folding_is_evaluated_on_closed_surfaces(balls):
    result = compare({"a": balls[0], "b": made_measures()})
    scalars = balls[0].scalars
    assert result.folding[0].exposed == pytest.approx(scalars["area_pial_mm2"] / scalars["gyrification_index"])
    assert result.folding[1] is None
    json.dumps(result.to_dict())


def test_colours_are_those_of_groups_unless_chosen_otherwise():
    pair, single = [made_measures("lh"), made_measures("rh")], made_measures()
    plain = compare({"S1": pair, "a": single}).colours
    assert plain["S1 lh"] == plain["S1 rh"] != plain["a"]
    grouped = {"surfaces": {"S1": pair, "a": single, "b": single}, "groups": {"model": ["a", "b"]}}
    colours = compare(**grouped).colours
    assert list(colours) == ["S1 lh", "S1 rh", "a", "b"]
    assert colours["a"] == colours["b"] != colours["S1 lh"] == colours["S1 rh"]
    chosen = {"b": "#00AA00", "model": "#111111", "S1": "#222222", "S1 rh": "#333333"}
    colours = compare(**grouped, colours=chosen).colours
    assert colours == {"S1 lh": "#222222", "S1 rh": "#333333", "a": "#111111", "b": "#00aa00"}


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"surfaces": {}}, NothingToDo, None),
        ({"surfaces": {"MRI": [made_measures(), made_measures()]}}, NamedTwice, "'MRI lh'"),
        ({"groups": {"model": ["a"], "MRI": ["d"]}}, UnknownName, "'d'.* a, b"),
        ({"groups": {"model": ["a"], "MRI": ["a", "b"]}}, NamedTwice, "'a'"),
        ({"colours": {"c": "#000000"}}, UnknownName, "'c'.* a, b"),
        ({"colours": {"a": '#000000"/><script>'}}, NotReadable, r"<script>.*\(a\)"),
    ],
)
def test_groups_colours_and_names_without_meaning_are_refused(options, error, message):
    surfaces = {"a": made_measures(), "b": made_measures()}
    with pytest.raises(error, match=message):
        compare(**{"surfaces": surfaces, **options})


@pytest.mark.slow
def test_a_page_shows_hinges_side_by_side_and_the_law_of_folding(balls, tmp_path):
    page = compare({"a<b>": balls[0], "c": balls[1]}).report(tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    assert "<h2>Three-hinge patterns</h2>" in text
    assert "a&lt;b&gt; and c" in text
    assert "a<b>" not in text
    assert "<h2>The law of folding</h2>" in text
    assert (tmp_path / "out" / "figures" / "hinges-1.png").is_file()
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert content["hinges"][0]["shape"]["p"] == 1.0
    assert content["folding"]["c"]["k"] == pytest.approx(content["folding"]["a<b>"]["k"])


def test_growth_is_drawn_with_the_growths_at_which_a_body_is_like_a_brain(tmp_path):
    stages = [stage(g, index) for g, index in ((1.0, 1.0), (1.5, 2.0), (2.0, 3.0))]
    result = compare({"brain": stage(None, 2.5)}, growth={"<body>": stages})
    assert result.to_dict()["growth"]["<body>"]["as"]["brain"]["gyrification index"] == pytest.approx([1.75])
    text = result.report(tmp_path / "out").read_text(encoding="utf-8")
    assert "<td>1.75</td>" in text
    assert 'aria-label="gyrification index over growth"' in text
    assert "&lt;body&gt;, g = 1.50: 2.00" in text
    assert "<body>," not in text


# --- growth curves: numbers whose crossing is known by hand


def stage(g, index=2.0, gyral=10.0):
    m = made_measures(info={"g": g} if g else {})
    m.scalars.update(gyrification_index=index, median_gyral_thickness_mm=gyral, mean_cortical_thickness_mm=4.0)
    m.scalars.update(area_pial_mm2=9e4, wavelength_mm=30.0)
    return m


def test_a_brain_is_met_where_the_lines_between_stages_have_its_number():
    curve = growth_curve("body", [stage(2.0, index=3.0), stage(1.0, index=1.0, gyral=None), stage(1.5, index=2.0)])
    assert curve.growth.tolist() == [1.0, 1.5, 2.0]
    assert curve.numbers["gyrification index"].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(curve.numbers["gyral over cortical thickness"], [np.nan, 2.5, 2.5])
    met = matching_growth(curve, stage(None, index=2.6, gyral=8.0))
    assert met["gyrification index"] == pytest.approx([1.8])
    assert met["gyral over cortical thickness"] == []  # 2 is never reached
    assert met["hinges per gyral width²"] == []  # nobody has a net
    assert set(met) == set(dimensionless_numbers(stage(None)))


def test_a_number_that_comes_back_is_met_twice_and_a_stage_itself_once():
    curve = growth_curve("body", [stage(g, index=i) for g, i in ((1.0, 1.0), (1.4, 2.0), (1.8, 1.0))])
    assert matching_growth(curve, stage(None, index=1.5))["gyrification index"] == pytest.approx([1.2, 1.6])
    assert matching_growth(curve, stage(None, index=2.0))["gyrification index"] == [1.4]
    nothing = stage(None)
    nothing.scalars.update(gyrification_index=None)
    assert matching_growth(curve, nothing)["gyrification index"] == []


def test_a_family_that_obeys_the_law_has_one_k_at_every_growth():
    stages = []
    for g, exposed in ((1.0, 1e4), (1.5, 2e4), (2.0, 3e4)):
        m = stage(g)
        total = 0.3 * exposed**1.25 / 4.0**0.5
        m.scalars.update(area_pial_mm2=total, gyrification_index=total / exposed)
        stages.append(m)
    np.testing.assert_allclose(growth_curve("body", stages).numbers["k of the law of folding"], 0.3, rtol=1e-12)


@pytest.mark.parametrize(
    ("growths", "error", "message"),
    [
        ((1.5,), MissingPart, r"\bbody\b.*\b1\b"),
        ((1.5, None), DoesNotApply, "body"),
        ((1.5, 1.2, 1.5), NamedTwice, r"\bbody\b.*\bg = 1\.5\."),
    ],
)
def test_what_is_no_growth_is_refused(growths, error, message):
    with pytest.raises(error, match=message):
        growth_curve("body", [stage(g) for g in growths])
