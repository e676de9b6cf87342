import numpy as np
import pytest
from made_simulations import made_simulation

from morphofold.report import colours
from morphofold.shapes import icosphere
from morphofold.studies.folds import fold_pictures
from morphofold.studies.folds.fold_pictures import DISPLACEMENT, Panel, displaced, picture, row_limits
from morphofold.surface import Surface


def ball(radius, value):
    verts, faces = icosphere(3, radius)
    return Panel(f"r = {radius:g}", Surface(verts, faces), np.full(len(verts), float(value)))


def drawn(image, left, top, width, height):
    """Rows and columns, from there on, of what isn't white."""
    part = image[top : top + height, left : left + width]
    return np.nonzero((part < 250).any(axis=2))


def test_displacement_is_measured_from_the_stage_before_growth(tmp_path):
    stages = ["output.stages=[1.0, 2.0]"]
    growing = lambda g, verts: np.full(len(verts), 7 * (g - 1))
    panel = displaced(made_simulation(tmp_path, "fig5", stages, height=growing), 2.0)
    np.testing.assert_allclose(panel.values, 7, atol=1e-4)
    assert panel.words == "g = 2.00"
    assert np.linalg.norm(panel.surface.verts, axis=1) == pytest.approx(57, abs=1e-3)


def test_limits_go_from_zero_to_a_round_number_above_nearly_all(rng):
    verts, faces = icosphere(3)
    values = rng.uniform(0, 12.3, len(verts))
    values[0] = 40.0  # one point doesn't set the colours of all
    assert row_limits([Panel("", Surface(verts, faces), values), ball(1, 3)]) == (0, 15)


def test_all_panels_have_one_scale_and_the_ruler_is_right():
    image = picture([[ball(50, 1), ball(25, 1)]], DISPLACEMENT, [(0, 2)])
    wide = fold_pictures.WIDEST
    sizes = [np.ptp(drawn(image, 20 + k * wide, 20, wide, wide)[1]) + 1 for k in (0, 1)]
    assert sizes[0] == pytest.approx(wide - 20, abs=3)  # the widest fills its column but for the gap
    assert sizes[1] == pytest.approx(sizes[0] / 2, abs=3)
    dark = (image == 60).all(axis=2)
    runs = [np.flatnonzero(row[:wide]) for row in dark if row[:wide].sum() > 50]
    assert len(runs) == 3  # the ruler: three rows of one length
    assert len(runs[0]) / sizes[0] == pytest.approx(20 / 100, abs=0.01)


def test_a_colour_means_the_same_in_every_panel_of_a_row():
    row = [ball(50, 1), ball(50, 3)]
    image = picture([row, row], DISPLACEMENT, [(0, 4), (0, 8)])
    wide = fold_pictures.WIDEST
    middle = [20 + wide // 2, 20 + wide + 34 + 84 + wide // 2]
    shown = [[image[y, 20 + k * wide + wide // 2].astype(float) for k in (0, 1)] for y in middle]
    flat = lambda value, high: colours.apply(np.array([value]), (0, high), False)[0]
    for pair, high in zip(shown, (4, 8)):
        for colour, value in zip(pair, (1.0, 3.0)):
            hue = flat(value, high) / flat(value, high).max()
            np.testing.assert_allclose(colour / colour.max(), hue, atol=0.12)


def test_the_picture_is_the_same_bytes_again():
    once, again = (picture([[ball(50, 1)]], DISPLACEMENT, [(0, 2)], ["one"]) for _ in range(2))
    assert once.dtype == np.uint8
    np.testing.assert_array_equal(once, again)
