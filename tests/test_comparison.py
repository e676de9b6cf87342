"""The table, the thickness points and the theoretical line of a comparison."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_measures import made_measures

from morphofold.analysis import measure
from morphofold.comparison import ThicknessPoint, compare, fit_line, thickness_cloud, wrinkling_wavelength
from morphofold.errors import NamedTwice, NothingToDo, NotReadable, OutOfRange, UnknownName
from morphofold.shapes.folded_ball import folded_ball


def test_two_hemispheres_under_one_name_get_their_side():
    pair = [made_measures("lh"), made_measures("rh")]
    assert compare({"model": made_measures(), "MRI": pair}).names == ("model", "MRI lh", "MRI rh")
    assert compare({"MRI": pair[:1]}).names == ("MRI",)


def test_the_same_surface_compares_equal_whatever_its_origin():
    a, b = made_measures(origin="simulation"), made_measures(origin="FreeSurfer")
    result = compare({"a": a, "b": b})
    assert all(row["a"] == row["b"] for row in result.table)
    assert result.clouds[0] == result.clouds[1]


def test_gyral_over_cortical_thickness_is_in_the_table_and_none_without_either():
    result = compare({"a": made_measures()})
    assert {r["measure"]: r["a"] for r in result.table}["gyral_to_cortical_ratio"] == 10.0 / 2.5
    bare = made_measures()
    bare.scalars["median_gyral_thickness_mm"] = None
    assert {r["measure"]: r["a"] for r in compare({"a": bare}).table}["gyral_to_cortical_ratio"] is None


def test_points_are_regions_and_their_line_is_found():
    cloud = thickness_cloud(made_measures())
    assert cloud.kind == "region"
    assert [p.label for p in cloud.points] == ["front", "middle", "back"]
    assert cloud.fit is not None
    assert cloud.fit.slope == pytest.approx(3.0, abs=1e-12)
    assert cloud.fit.intercept == pytest.approx(1.0, abs=1e-12)
    assert cloud.fit.r == pytest.approx(1.0, abs=1e-12)


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


def test_crests_stand_in_for_regions():
    m = made_measures(regions=False)
    m.crests.extend(
        {"hemi": "lh", "crest": i, "cortical_thickness_mm": t, "gyral_thickness_mm": g}
        for i, (t, g) in enumerate([(2.0, 5.0), (3.0, 7.5), (4.0, 10.0), (4.5, None)])
    )
    cloud = thickness_cloud(m)
    assert (cloud.kind, len(cloud.points)) == ("crest", 3)
    assert cloud.fit.slope == pytest.approx(2.5)


def test_crests_of_a_medial_wall_are_no_points():
    m = made_measures(regions=False)  # its cortex is 2.5 mm thick
    for number, thickness in enumerate((0.1, 1.2, 1.3)):
        m.crests.append({"crest": number, "cortical_thickness_mm": thickness, "gyral_thickness_mm": 5.0})
    assert [p.cortical for p in thickness_cloud(m).points] == [1.3]


def test_mirror_images_are_remarked_on():
    assert not any("mirror" in note for note in compare({"a": made_measures()}).notes)
    assert any("a: a part was simulated" in note for note in compare({"a": made_measures(portion=0.125)}).notes)


def test_a_surface_with_regions_has_points_of_regions_whatever_the_others_have():
    model, brain = made_measures(regions=False), made_measures("rh")
    for m in (model, brain):
        m.crests.append({"crest": 0, "cortical_thickness_mm": 2.0, "gyral_thickness_mm": 5.0})
    both, alike = compare({"model": model, "MRI": brain}), compare({"one": brain, "two": made_measures()})
    assert [c.kind for c in both.clouds] == ["crest", "region"]
    assert [c.kind for c in alike.clouds] == ["region", "region"]
    assert len(both.notes) == len(alike.notes) + 1  # points of two kinds


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
        "one": brain,
        "mean": {**brain, "cortical_thickness_cap_mm": 5.0, "cortex_mask": "label"},
    }
    measured = {name: replace(made_measures(), parameters=p) for name, p in options.items()}
    scale, cap, mask = compare(measured).cautions
    assert "9.5 mm on model and 3.0 mm on one and mean" in scale
    assert "nowhere on model and one and at 5 mm on mean" in cap
    assert "'where both differ' on model and one and by 'label' on mean" in mask
    for parameters in (brain, {}):
        assert compare({"a": measured["one"], "b": replace(made_measures(), parameters=parameters)}).cautions == ()


def test_no_line_through_two_points_or_through_one_thickness():
    assert fit_line([ThicknessPoint(1, 2, ""), ThicknessPoint(2, 3, "")]) is None
    assert fit_line([ThicknessPoint(1, 2, ""), ThicknessPoint(1, 3, ""), ThicknessPoint(1, 4, "")]) is None


def test_the_theoretical_line_has_its_known_values():
    assert wrinkling_wavelength(3.0).slope == pytest.approx(2 * np.pi)
    assert wrinkling_wavelength(1.0).slope == pytest.approx(4.3566, abs=1e-4)
    assert wrinkling_wavelength(24.0).slope == pytest.approx(4 * np.pi)  # 8 times stiffer, twice as long


def test_stiffness_comes_from_the_surfaces_unless_given():
    soft, stiff = made_measures(info={"mu_ratio": 1.0}), made_measures(info={"mu_ratio": 3.0})
    assert [t.mu_ratio for t in compare({"a": stiff, "b": soft, "c": made_measures()}).theory] == [1.0, 3.0]
    assert [t.mu_ratio for t in compare({"a": stiff}, mu_ratio=2.0).theory] == [2.0]
    assert compare({"a": made_measures()}).theory == ()  # a brain has no stiffness that is known
    unknown = made_measures(info={"mu_ratio": None})
    assert [t.mu_ratio for t in compare({"a": unknown, "b": stiff}).theory] == [3.0]
    assert compare({"a": unknown}).theory == ()
    with pytest.raises(OutOfRange, match=r"\bmu_ratio\b.* 0\.0\b"):
        compare({"a": soft}, mu_ratio=0.0)


def test_two_surfaces_of_one_name_are_refused():
    with pytest.raises(NamedTwice, match="'MRI lh'"):
        compare({"MRI": [made_measures(), made_measures()]})
    with pytest.raises(NothingToDo):
        compare({})


def test_a_comparison_is_plain_json_and_says_what_is_missing():
    result = compare({"a": made_measures()})
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["names"] == ["a"]
    assert any("Hinges were not counted" in note for note in result.notes)


@pytest.fixture(scope="module")
def balls():
    """A folded ball, as a left and a right hemisphere."""
    ball = folded_ball(4000)
    return [measure(replace(ball, hemi=hemi)) for hemi in ("lh", "rh")]


def test_hinges_of_groups_are_compared_and_those_of_each_name_without_groups(balls):
    alone = compare({"a": balls, "b": balls[0]})
    assert alone.groups == {"a": ("a lh", "a rh"), "b": ("b",)}
    (found,) = alone.hinges
    assert (found.one, found.other, found.shape.n, found.shape.m) == ("a", "b", 2 * found.shape.m, found.shape.m)
    assert found.shape.p == 1.0  # two copies and one
    grouped = compare({"a": balls[0], "b": balls[0], "c": balls[1]}, groups={"model": ["a"], "MRI": ["c"]})
    assert [(h.one, h.other) for h in grouped.hinges] == [("model", "MRI")]
    assert compare({"a": balls[0]}).hinges == ()
    assert compare({"a": made_measures(), "b": balls[0]}).hinges == ()  # one has no net


def test_the_law_of_folding_is_told_of_closed_surfaces(balls):
    found = compare({"a": balls[0], "b": made_measures()})
    assert found.folding[0].exposed == pytest.approx(
        balls[0].scalars["area_pial_mm2"] / balls[0].scalars["gyrification_index"]
    )
    assert found.folding[1] is None
    json.dumps(found.to_dict())


@pytest.mark.parametrize(
    ("groups", "kind", "named"),
    [
        ({"model": ["a"], "MRI": ["d"]}, UnknownName, "'d'.* a, b"),
        ({"model": ["a"], "MRI": ["a", "b"]}, NamedTwice, "'a'"),
    ],
)
def test_groups_without_meaning_are_refused(groups, kind, named):
    with pytest.raises(kind, match=named):
        compare({"a": made_measures(), "b": made_measures()}, groups=groups)


def test_colours_are_those_of_groups_unless_asked_otherwise():
    pair, one = [made_measures("lh"), made_measures("rh")], made_measures()
    plain = compare({"S1": pair, "a": one}).colours
    assert plain["S1 lh"] == plain["S1 rh"] != plain["a"]
    grouped = {"surfaces": {"S1": pair, "a": one, "b": one}, "groups": {"model": ["a", "b"]}}
    found = compare(**grouped).colours
    assert list(found) == ["S1 lh", "S1 rh", "a", "b"]
    assert found["a"] == found["b"] != found["S1 lh"] == found["S1 rh"]
    wanted = {"b": "#00AA00", "model": "#111111", "S1": "#222222", "S1 rh": "#333333"}
    got = compare(**grouped, colours=wanted).colours
    assert got == {"S1 lh": "#222222", "S1 rh": "#333333", "a": "#111111", "b": "#00aa00"}


@pytest.mark.parametrize(
    ("colours", "kind", "named"),
    [
        ({"c": "#000000"}, UnknownName, "'c'.* a, b"),
        ({"a": "red"}, NotReadable, r"'red'.*\(a\)"),
        ({"a": '#000000"/><script>'}, NotReadable, r"<script>.*\(a\)"),
    ],
)
def test_colours_that_are_none_are_refused(colours, kind, named):
    with pytest.raises(kind, match=named):
        compare({"a": made_measures(), "b": made_measures()}, colours=colours)


@pytest.mark.slow
def test_a_page_shows_hinges_side_by_side_and_the_law_of_folding(balls, tmp_path, monkeypatch):
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


def test_growth_is_drawn_with_the_growths_at_which_a_body_is_like_a_brain(tmp_path, monkeypatch):
    stages = []
    for g, index in ((1.0, 1.0), (1.5, 2.0), (2.0, 3.0)):
        m = made_measures(info={"g": g})
        m.scalars.update(gyrification_index=index)
        stages.append(m)
    brain = made_measures()
    brain.scalars.update(gyrification_index=2.5)
    found = compare({"brain": brain}, growth={"<body>": stages})
    assert found.to_dict()["growth"]["<body>"]["as"]["brain"]["gyrification index"] == pytest.approx([1.75])
    text = found.report(tmp_path / "out").read_text(encoding="utf-8")
    assert "<td>1.75</td>" in text
    assert 'aria-label="gyrification index over growth"' in text
    assert "&lt;body&gt;, g = 1.50: 2.00" in text
    assert "<body>," not in text
