"""PNG files and lettering."""

import io

import numpy as np
import pytest
from PIL import Image

from morphofold.errors import WrongShape
from morphofold.report.pictures.png import lettering, png_bytes


def test_a_png_holds_the_picture_exactly(rng):
    picture = rng.integers(0, 256, (7, 11, 3), dtype=np.uint8)
    decoded = Image.open(io.BytesIO(png_bytes(picture)))
    assert (decoded.format, decoded.mode) == ("PNG", "RGB")
    np.testing.assert_array_equal(np.asarray(decoded), picture)
    with pytest.raises(WrongShape, match=r"\(2, 2, 3\) float64"):
        png_bytes(np.zeros((2, 2, 3)))


def test_lettering_shares_a_baseline_and_reads_no_tex():
    low, tall = lettering("axe", 20), lettering("AXE", 20)
    foot = lambda ink: ink.shape[0] - np.flatnonzero(ink.any(axis=1))[-1]
    assert abs(foot(low) - foot(tall)) <= 1
    assert lettering("$x$", 20).shape[1] > lettering("x", 20).shape[1] + 8


def test_no_character_of_a_name_vanishes():
    """A box stands for the last two."""
    for text in ("Ж", "α", "₁", "脑", "日本"):
        assert lettering(text, 20).sum() > 10 * len(text)
    assert lettering("日本", 20).shape[1] > 1.8 * lettering("日", 20).shape[1] > 10
    assert lettering("S1 脑", 20).shape[1] > lettering("S1 ", 20).shape[1] + 10
    for bold in (False, True):
        latin, mixed = lettering("EgÅ", 20, bold), lettering("EgÅ脑", 20, bold)
        assert latin.shape[0] == mixed.shape[0]
        feet = [np.flatnonzero(ink[:, :14].any(axis=1))[-1] for ink in (latin, mixed)]
        assert abs(feet[0] - feet[1]) <= 1  # the baseline, under the E
