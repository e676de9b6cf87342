"""Strips of small pictures: one scale for all, nothing cut off, and a refusal of what has no extent."""

import numpy as np
import pytest

from morphofold.errors import OutOfRange
from morphofold.quantities import quantity
from morphofold.report.pictures.strip import FOOT_PX, HEAD_PX, SEVERAL_TILES_PX, TILE_PX, Tile, strip
from morphofold.report.pictures.surfaces import Row
from morphofold.shapes import icosphere
from morphofold.surface import Surface


def ball(radius, stretch=(1.0, 1.0, 1.0)):
    verts, faces = icosphere(3, radius=radius)
    row = Row("", Surface(verts * stretch, faces), np.zeros(len(verts)))
    return Tile(row, "lateral", "")


def inked(image):
    """Rows and columns of the box around everything that is not white."""
    rows, columns = np.nonzero((image < 250).any(axis=2))
    return np.ptp(rows) + 1, np.ptp(columns) + 1


def test_surfaces_are_drawn_at_one_scale():
    image = strip([ball(40.0), ball(20.0)], None)
    sizes = [inked(half) for half in np.split(image, 2, axis=1)]
    assert sizes[0][0] == pytest.approx(2 * sizes[1][0], abs=3)
    assert sizes[0][1] == pytest.approx(2 * sizes[1][1], abs=3)


@pytest.mark.parametrize("stretch", [(1, 1, 1), (1, 8, 1), (1, 1, 8), (1, 1e-9, 1e-9)])
@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e5])
def test_a_surface_of_any_shape_and_size_fits_its_tile(radius, stretch):
    image = strip([ball(radius, stretch)], None)
    assert image.shape == (HEAD_PX + TILE_PX[1], TILE_PX[0], 3)
    border = np.concatenate([image[[HEAD_PX, -1]].ravel(), image[:, [0, -1]].ravel()])
    assert (border == 255).all()
    assert inked(image)[0 if stretch[2] > 1 else 1] >= 1


def test_a_colour_bar_and_further_tiles_change_the_size():
    tiles = [ball(1.0)] * 4
    image = strip(tiles, quantity("H"), (-1.0, 1.0))
    assert image.shape == (HEAD_PX + SEVERAL_TILES_PX[1] + FOOT_PX, 4 * SEVERAL_TILES_PX[0], 3)
    assert inked(image[-FOOT_PX:])[1] > 200


def test_a_point_is_refused():
    with pytest.raises(OutOfRange, match=r"\b0 mm"):
        strip([ball(0.0)], None)
