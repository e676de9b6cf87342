"""Which hemispheres of a group are pooled: those that were measured alike, and none where there is no majority."""

import numpy as np
import pandas as pd
import pytest

from morphofold.analysis.measures import PARAMETERS, PARAMETERS_OF_SCALAR, SCALARS
from morphofold.group.pooling import SETTING_NAMES, Pooling, pooling

USUAL = {
    "morphofold": "1.0",
    "folding_scale_mm": 3.0,
    "graph_width_mm": 8.0,
    "cortical_thickness_cap_mm": 5.0,
    "cortex_mask": "label",
    "accuracy": "standard",
    "annotation": "aparc",
}


def pooled(numbers, *others, **values):
    """Of hemispheres (subjects, 2) with the usual settings (0), or those that differ as ``others`` say (1, 2, ...)."""
    numbers = np.array(numbers)
    ways = [USUAL, *(USUAL | other for other in others), dict.fromkeys(SETTING_NAMES)]
    settings = [ways[n] for n in numbers.flat]
    scalars = {name: np.where(numbers >= 0, 1.0, np.nan) for name in SCALARS} | values
    return pooling(pd.DataFrame(settings, dtype=object), scalars)


def test_hemispheres_measured_alike_are_pooled_whole():
    assert pooled([[0, 0], [0, -1]]) == Pooling()


@pytest.mark.parametrize(
    ("parameter", "other", "alone"),
    [
        ("folding_scale_mm", 3.9, {"folding_index", "intrinsic_curvature_index"}),
        ("graph_width_mm", 10.4, {"n_hinges", "n_crests", "crest_length_mm"}),
        ("cortical_thickness_cap_mm", None, {"mean_cortical_thickness_mm", "gyral_to_cortical_slope"}),
        (
            "cortex_mask",
            "where white and pial differ",
            {"mean_sulcal_depth_mm", "n_hinges", "wavelength_mm", "gray_volume_mm3"},
        ),
        ("annotation", "aparc.a2009s", {"gyral_to_cortical_r"}),
        ("morphofold", "0.9", set(SCALARS)),
    ],
)
def test_a_measure_is_pooled_of_the_commonest_of_the_ways_it_follows_from(parameter, other, alone):
    found = pooled([[0, 0], [0, 0], [1, 0]], {parameter: other})
    assert found.counts == {parameter: {USUAL[parameter]: 5, other: 1}}
    assert alone <= set(found.left_out)
    assert set(found.left_out.values()) == {(1, 6)}
    for name in alone:
        assert np.isnan(found.of(name, np.ones((3, 2)))).tolist() == [[False, False], [False, False], [True, False]]
    if parameter != "morphofold":
        assert "area_pial_mm2" not in found.left_out
        assert np.isfinite(found.of("area_pial_mm2", np.ones((3, 2)))).all()


def test_nothing_is_pooled_where_every_hemisphere_has_a_way_of_its_own():
    found = pooled([[0, 1], [2, 3]], *({"graph_width_mm": width} for width in (8.1, 9.2, 10.4)))
    assert found.left_out["n_hinges"] == (4, 4)
    assert np.isnan(found.of("n_hinges", np.ones((2, 2)))).all()
    assert "mean_cortical_thickness_mm" not in found.left_out


def test_half_is_no_majority():
    assert pooled([[0, 0], [1, 1]], {"accuracy": "draft"}).left_out["wavelength_mm"] == (4, 4)
    assert pooled([[0, 0], [0, 1], [1, -1]], {"accuracy": "draft"}).left_out["wavelength_mm"] == (2, 5)


def test_only_hemispheres_with_a_value_are_counted():
    """Two of three have no hinges, so that those of the third are pooled."""
    hinges = np.array([[np.nan, np.nan], [5.0, 6.0]])
    found = pooled([[0, 0], [1, 1]], {"graph_width_mm": 9.0}, n_hinges=hinges)
    assert "n_hinges" not in found.left_out


def test_a_scalar_that_nobody_registered_follows_from_everything():
    found = pooled([[0, 0], [0, 1]], {"folding_scale_mm": 4.0}, new_measure=np.ones((2, 2)))
    assert found.left_out["new_measure"] == (1, 4)


def test_what_measures_follow_from_is_known():
    assert set(PARAMETERS_OF_SCALAR) <= set(SCALARS)
    assert {key for keys in PARAMETERS_OF_SCALAR.values() for key in keys} <= set(PARAMETERS)


def test_the_options_that_would_measure_all_alike_are_said():
    """The coarsest curvature scale, which all can have, and the median width."""
    found = pooled(
        [[1, 2], [3, 3]],
        {"graph_width_mm": 7.0},
        {"folding_scale_mm": 3.912, "graph_width_mm": 8.0},
        {"graph_width_mm": 9.0},
    )
    assert "--curvature-scale 3.91 --gyral-width 8.5" in found.sentences[1]
