import numpy as np
import pytest

from morphofold import analysis
from morphofold.errors import NotFinite, OutOfRange, WrongShape
from morphofold.shapes import even_directions, icosphere


def bumps(verts, centres, width):
    """A Gaussian of height 1 around each centre, on the unit sphere."""
    return np.exp((verts @ centres.T - 1) / width**2).max(axis=1)


@pytest.mark.parametrize(("level", "n"), [(4, 12), (5, 80), (6, 40)])
def test_bumps_are_counted_alike_on_every_mesh(level, n):
    verts, faces = icosphere(level)
    height = bumps(verts, even_directions(n), 0.4 / np.sqrt(n))
    assert len(analysis.prominent_peaks(faces, height, 0.5)) == n


def test_a_product_of_waves_has_the_highs_and_lows_that_it_must():
    """cos(m phi) sin^m theta on the sphere: m highs and m lows around the equator."""
    verts, faces = icosphere(5)
    phi, sine = np.arctan2(verts[:, 1], verts[:, 0]), np.hypot(verts[:, 0], verts[:, 1])
    height = np.cos(7 * phi) * sine**7
    for sign in (1, -1):
        assert len(analysis.prominent_peaks(faces, sign * height, 0.1)) == 7


def test_ripples_do_not_count(rng):
    verts, faces = icosphere(5)
    height = bumps(verts, even_directions(40), 0.06) + rng.uniform(-0.1, 0.1, len(verts))
    assert len(analysis.prominent_peaks(faces, height, 0.0)) > 500
    assert len(analysis.prominent_peaks(faces, height, 0.5)) == 40


def test_prominence_is_the_height_above_the_pass_to_higher_ground():
    """A strip of triangles with peaks 3, 2 and 5: 2 joins 3 at 1, 3 joins 5 at 0.5."""
    heights = np.repeat([0.0, 3.0, 1.0, 2.0, 0.5, 5.0, -1.0], 2)
    k = np.arange(0, len(heights) - 2, 2)
    faces = np.concatenate([np.stack([k, k + 1, k + 2], 1), np.stack([k + 1, k + 3, k + 2], 1)])
    for least, peaks in ((0, [5, 1, 3]), (1, [5, 1, 3]), (1.1, [5, 1]), (2.6, [5])):
        assert (analysis.prominent_peaks(faces, heights, least) // 2).tolist() == peaks


def test_the_highest_of_every_piece_is_a_peak_and_a_plain_has_one():
    verts, faces = icosphere(2)
    n = len(verts)
    both = np.concatenate([faces, faces + n])
    slope = verts @ [1, 0.2, 0.05]
    heights = np.concatenate([np.zeros(n), slope])
    assert analysis.prominent_peaks(both, heights, 0).tolist() == [n + slope.argmax(), 0]


def test_a_vertex_without_height_is_refused_unless_no_face_uses_it():
    _, faces = icosphere(1)
    heights = np.arange(faces.max() + 2, dtype=float)
    heights[-1] = np.nan
    assert analysis.prominent_peaks(faces, heights, 1.0)[0] == faces.max()
    heights[3] = np.nan
    with pytest.raises(NotFinite, match=r"\b1 of 42\b"):
        analysis.prominent_peaks(faces, heights, 1.0)
    with pytest.raises(WrongShape, match=r"\b41\b.*\b3\b"):
        analysis.prominent_peaks(faces, heights[:3], 1.0)
    for least in (-1, np.nan):
        with pytest.raises(OutOfRange, match=rf"\bleast\b.* {least}\.$"):
            analysis.prominent_peaks(faces, heights[:-1], least)
