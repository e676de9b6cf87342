"""Colours and their limits: even tables, ends beyond them, limits that suit several surfaces."""

import numpy as np
import pytest

from morphofold.quantities import CATEGORICAL_COLOURS, common_limits, quantity
from morphofold.report import colours


def lightness(rgb):
    """CIE L* of sRGB bytes (n, 3)."""
    c = rgb / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.where(y > 216 / 24389, np.cbrt(y), y * 841 / 108 + 4 / 29) - 16


def test_the_sequential_table_climbs_evenly_in_lightness():
    L = lightness(colours.sequential())
    assert (np.diff(L[::8]) > 0).all()
    assert L[0] < 25
    assert L[-1] > 85
    quarters = np.diff(L[[0, 64, 128, 192, 255]])
    assert quarters.max() / quarters.min() < 1.6


def test_the_diverging_table_is_lightest_at_zero_and_as_dark_on_both_sides():
    L = lightness(colours.diverging())
    assert abs(L.argmax() - 127.5) < 2
    assert np.abs(L - L[::-1]).max() < 6
    assert (np.abs(colours.diverging()[127].astype(int) - 240) < 12).all()


def test_values_beyond_the_limits_take_the_end_colours_and_nan_takes_grey():
    got = colours.apply(np.array([-9, 0, 1, 9, np.nan]), (0, 1), signed=False)
    np.testing.assert_array_equal(got[0], got[1])
    np.testing.assert_array_equal(got[2], got[3])
    np.testing.assert_array_equal(got[4], colours.NOT_MEASURED_COLOUR)


def test_limits_are_the_quantity_own_when_they_suit_and_rounded_percentiles_when_not(rng):
    thickness = quantity("cortical_thickness")
    assert common_limits(thickness, [rng.uniform(1.2, 4.6, 999)]) == (1, 5)
    low, high = common_limits(thickness, [rng.uniform(10, 30, 999), np.array([np.nan])])
    assert low == pytest.approx(10, abs=1)
    assert high == pytest.approx(30, abs=1)
    bound = common_limits(quantity("H"), [rng.normal(0.5, 1, 999)])
    assert bound[0] == -bound[1]
    few, many = rng.uniform(6, 8, 99), rng.uniform(1.2, 4.6, 9999)
    low, high = common_limits(thickness, [few, many])  # a small surface is not drowned by a large one
    assert low <= 1.3
    assert high >= 7.9
    low, high = common_limits(thickness, [np.linspace(1, 9, 999)])  # half of it lies beyond 5
    assert low < 1.5
    assert high > 8.5
    assert common_limits(thickness, [np.linspace(1, 5.9, 999)]) == (1, 5)  # a fifth may
    assert common_limits(thickness, []) == (1, 5)
    flat = common_limits(quantity("odd_mm"), [np.full(9, 7.0)])
    assert flat[0] < 7 < flat[1]


def test_an_unknown_map_is_described_by_its_name():
    got = quantity("bending_per_mm2", [np.linspace(-1, 2, 99)])
    assert (got.label, got.unit, got.signed) == ("Bending", "1/mm²", True)


#: what is left of linear RGB to protanopes and deuteranopes: Machado, Oliveira, Fernandes 2009 (IEEE TVCG 15)
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_surfaces_stay_apart_for_every_eye(sight):
    """By distance in OKLab: 0.02 is just seen, 1 lies between black and white; amber and vermilion had 0.004."""
    rgb = np.array([colours.rgb_of(c) for c in CATEGORICAL_COLOURS]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ np.transpose(SIGHT[sight])
    cones = np.cbrt(
        np.clip(linear, 0, 1)
        @ np.transpose(
            [
                [0.4122214708, 0.5363325363, 0.0514459929],
                [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005],
            ]
        )
    )
    lab = cones @ np.transpose(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ]
    )
    apart = np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(len(lab), 1)]
    assert apart.min() > 0.09
