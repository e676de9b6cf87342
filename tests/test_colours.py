"""Colours and their limits: even tables, ends beyond them, limits that suit several surfaces."""

import numpy as np
import pytest

from morphofold.quantities import CATEGORICAL_COLOURS, common_limits, quantity
from morphofold.report import colours


def linear(rgb):
    """Linear intensities of sRGB bytes (n, 3)."""
    c = np.array(rgb) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def luminance(rgb):
    return linear(rgb) @ [0.2126, 0.7152, 0.0722]


def lightness(rgb):
    """CIE L* of sRGB bytes (n, 3)."""
    y = luminance(rgb)
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
    rgb = colours.apply(np.array([-9, 0, 1, 9, np.nan]), (0, 1), signed=False)
    np.testing.assert_array_equal(rgb[[0, 2, 4]], [rgb[1], rgb[3], colours.NOT_MEASURED_COLOUR])


def test_limits_are_the_quantity_own_when_they_suit_and_rounded_percentiles_when_not(rng):
    thickness = quantity("cortical_thickness")
    assert common_limits(thickness, [rng.uniform(1.2, 4.6, 999)]) == (1, 5)
    unknown = [rng.uniform(10, 30, 999), np.array([np.nan])]
    assert common_limits(thickness, unknown) == pytest.approx((10, 30), abs=1)
    low, high = common_limits(quantity("H"), [rng.normal(0.5, 1, 999)])
    assert low == -high
    few, many = rng.uniform(6, 8, 99), rng.uniform(1.2, 4.6, 9999)
    low, high = common_limits(thickness, [few, many])  # a small surface is not drowned by a large one
    assert (low <= 1.3, high >= 7.9) == (True, True)
    low, high = common_limits(thickness, [np.linspace(1, 9, 999)])  # half of it lies beyond 5
    assert (low < 1.5, high > 8.5) == (True, True)
    assert common_limits(thickness, [np.linspace(1, 5.9, 999)]) == (1, 5)  # a fifth may
    assert common_limits(thickness, []) == (1, 5)
    low, high = common_limits(quantity("odd_mm"), [np.full(9, 7.0)])
    assert low < 7 < high
    bending = quantity("bending_per_mm2", [np.linspace(-1, 2, 99)])  # an unknown map is described by its name
    assert (bending.label, bending.unit, bending.signed) == ("Bending", "1/mm²", True)


def test_letters_stand_out_from_every_colour():
    """By the contrast of WCAG 2."""
    inks = {"white": 1.0, "black": 0.0}
    for rgb in (*colours.sequential(), *colours.diverging()):
        high, low = sorted([luminance(rgb), inks[colours.ink(rgb)]], reverse=True)
        assert (high + 0.05) / (low + 0.05) >= 4.5


#: what is left of linear RGB to protanopes and deuteranopes: Machado, Oliveira, Fernandes 2009 (IEEE TVCG 15)
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_surfaces_differ_for_every_eye(sight):
    """By distance in OKLab: 0.02 is just seen, 1 lies between black and white; amber and vermilion had 0.004."""
    to_cones = [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
    to_lab = [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
    seen = linear([colours.rgb_of(c) for c in CATEGORICAL_COLOURS]) @ np.transpose(SIGHT[sight])
    lab = np.cbrt(np.clip(seen, 0, 1) @ np.transpose(to_cones)) @ np.transpose(to_lab)
    distances = np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(len(lab), 1)]
    assert distances.min() > 0.09
