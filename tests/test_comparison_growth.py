"""Growth curves: numbers whose crossing is known by hand."""

import numpy as np
import pytest
from made_measures import made_measures

from morphofold.comparison.side_by_side import dimensionless_numbers, growth_curve, matching_growth
from morphofold.errors import DoesNotApply, MissingPart, NamedTwice


def stage(g, index=2.0, gyral=10.0, cortical=4.0, **more):
    m = made_measures(info={"g": g} if g else {})
    m.scalars.update(
        gyrification_index=index,
        median_gyral_thickness_mm=gyral,
        mean_cortical_thickness_mm=cortical,
        area_pial_mm2=9e4,
        wavelength_mm=30.0,
        **more,
    )
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
    ("growths", "kind", "expected"),
    [
        ((1.5,), MissingPart, r"\bbody\b.*\b1\b"),
        ((1.5, None), DoesNotApply, "body"),
        ((1.5, 1.2, 1.5), NamedTwice, r"\bbody\b.*\bg = 1\.5\."),
    ],
)
def test_what_is_no_growth_is_refused(growths, kind, expected):
    with pytest.raises(kind, match=expected):
        growth_curve("body", [stage(g) for g in growths])
