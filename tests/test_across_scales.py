"""A cortex across scales: a shell and a self-similar surface, whose areas are known at every scale, and refusals."""

import numba
import numpy as np
import pytest
import pyvista
import trimesh

from morphofold.analysis import across_scales, law_across_scales
from morphofold.errors import OpenSurface, OutOfRange, TooLarge
from morphofold.shapes import icosphere
from morphofold.surface import Cortex, Surface
from morphofold.threads import using_threads

SCALES = (0.0, 2.0, 3.0, 5.0, 8.0)


def shell(inner=30.0, outer=33.0, turn=None):
    verts, faces = icosphere(4)
    verts = verts if turn is None else verts @ turn
    return Cortex(Surface(inner * verts, faces), Surface(outer * verts, faces))


def test_a_shell_has_the_areas_and_the_thickness_of_the_moved_spheres():
    rows = across_scales(shell(), SCALES)
    assert [row.scale for row in rows] == list(SCALES)
    for row in rows:
        outer, inner = 33.0 + row.scale / 2, 30.0 - row.scale / 2
        assert row.terms.total == pytest.approx(4 * np.pi * outer**2, rel=6e-3)
        assert row.terms.exposed == pytest.approx(row.terms.total, rel=1e-3)
        exact = 2 / 3 * (outer**3 - inner**3) / (outer**2 + inner**2)
        assert row.terms.thickness == pytest.approx(exact, rel=8e-3)


def test_the_slope_of_a_shell_is_that_of_its_formula():
    scale = np.array(SCALES[1:])
    outer, inner = 33.0 + scale / 2, 30.0 - scale / 2
    area, thickness = 4 * np.pi * outer**2, 2 / 3 * (outer**3 - inner**3) / (outer**2 + inner**2)
    x, y = np.log(area / scale**2), np.log(area * thickness**0.5 / scale**2.5)
    law = law_across_scales(across_scales(shell(), SCALES), least_folding=0.9)
    assert law.slope == pytest.approx(np.polyfit(x, y, 1)[0], abs=3e-3)
    assert law.exponent == pytest.approx(np.polyfit(np.log(thickness), -0.25 * np.log(area), 1)[0], abs=3e-3)
    assert law.slope_low < law.slope < law.slope_high
    assert law.exponent_low < law.exponent < law.exponent_high


def snowflake(size, generations):
    """Corners (N, 2) of Koch's snowflake."""
    corners = size * np.exp(-2j * np.pi * np.arange(3) / 3)
    for _ in range(generations):
        step = (np.roll(corners, -1) - corners) / 3
        tip = corners + step + step * np.exp(1j * np.pi / 3)
        corners = np.column_stack([corners, corners + step, tip, corners + 2 * step]).ravel()
    return np.column_stack([corners.real, corners.imag])


def prism(outline, height, levels):
    """A closed prism over a polygon (N, 2), its walls in ``levels``: vertices and triangles."""
    n = len(outline)
    z = np.linspace(0.0, height, levels + 1)
    verts = np.column_stack([np.tile(outline, (levels + 1, 1)), np.repeat(z, n)])
    flat = pyvista.PolyData(np.column_stack([outline, np.zeros(n)]), [n, *range(n)]).triangulate()
    cap = flat.regular_faces
    start = np.arange(levels * n)
    after = start - start % n + (start + 1) % n
    wall = [np.column_stack([start, after, after + n]), np.column_stack([start, after + n, start + n])]
    return verts, np.concatenate([cap[:, ::-1], *wall, cap + levels * n]).astype(np.int64)


def within(verts, faces):
    """A cortex with this pial surface; the white one has half its size."""
    middle = verts.mean(axis=0)
    return Cortex(Surface(middle + 0.5 * (verts - middle), faces), Surface(verts, faces))


@pytest.mark.slow
def test_the_wall_of_a_self_similar_surface_falls_with_its_dimension():
    """Between the edges of the last generation and its size, the length of a curve at the distance a from Koch's
    snowflake goes with a^(1 - log 4 / log 3)."""
    walls, scales, flat = [], (1.5, 4.5), snowflake(60.0, 5)
    for scale in scales:
        low, high = (across_scales(within(*prism(flat, h, int(h))), [scale])[0].terms.total for h in (20.0, 32.0))
        walls.append(high - low)  # of 12 mm, without caps
    exponent = np.log(walls[1] / walls[0]) / np.log(scales[1] / scales[0])
    assert exponent == pytest.approx(1 - np.log(4) / np.log(3), abs=0.04)


def test_k_does_not_depend_on_size_nor_on_the_direction_of_the_grid():
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    row, turned = across_scales(shell(), [4.0])[0], across_scales(shell(turn=turn), [4.0])[0]
    assert row.terms.log_k == pytest.approx(turned.terms.log_k, abs=1e-3)
    twice = across_scales(shell(60.0, 66.0), [8.0])[0]
    assert twice.terms.log_k == pytest.approx(row.terms.log_k, abs=1e-6)
    assert twice.terms.size == pytest.approx(row.terms.size + 6 * np.log10(2), abs=1e-5)


def test_a_furrow_narrower_than_the_scale_is_filled():
    outline = np.array([[-20, 0], [20, 0], [20, 20], [1.5, 20], [1.5, 8], [-1.5, 8], [-1.5, 20], [-20, 20]], float)
    cortex = within(*prism(outline, 40.0, 20))
    open_, filled = (row.terms for row in across_scales(cortex, [2.0, 4.0]))
    assert open_.total - open_.exposed == pytest.approx(2 * 11.5 * 42, rel=0.1)
    assert filled.total == pytest.approx(filled.exposed, rel=0.01)


def test_scales_at_which_no_white_matter_is_left_have_no_row():
    assert [row.scale for row in across_scales(shell(5.0, 8.0), [4.0, 30.0])] == [4.0]


@pytest.mark.slow
def test_the_default_scales_are_multiples_of_the_thickness():
    scales = [row.scale for row in across_scales(shell(30.0, 36.0))]
    assert scales[0] == 0
    assert scales[1] == pytest.approx(0.2 * 6, rel=0.02)
    assert np.diff(np.log(scales[1:])) == pytest.approx(0.5 * np.log(2))


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
def test_the_number_of_threads_changes_nothing():
    with using_threads(1):
        one = across_scales(shell(), [3.0])
    with using_threads(2):
        assert across_scales(shell(), [3.0]) == one


def test_a_scale_that_is_none_or_too_small_and_an_open_surface_are_refused():
    cortex = shell()
    for scale, error in (-1.0, OutOfRange), (np.nan, OutOfRange), (0.05, TooLarge):
        with pytest.raises(error):
            across_scales(cortex, [scale])
    cut = cortex.faces[1:]
    with pytest.raises(OpenSurface):
        across_scales(Cortex(Surface(cortex.white.verts, cut), Surface(cortex.pial.verts, cut)))


def test_a_law_needs_three_scales_with_folds():
    rows = across_scales(shell(), [0.0, 2.0, 4.0, 6.0])
    for few, least in ((rows[:3], 0.9), (rows, 1.1)):
        with pytest.raises(OutOfRange):
            law_across_scales(few, least)
