"""Fractal dimension of surfaces that have a known one."""

import numpy as np
import pytest

from morphofold.analysis import fractal_dimension
from morphofold.errors import OutOfRange
from morphofold.geometry import mean_edge_length
from morphofold.studies.shapes import bumpy_sphere, sphere, torus


def koch_curve(level):
    """Points of the curve from (0, 0) to (1, 0), of dimension log 4 / log 3."""
    points = np.array([0, 1], dtype=complex)
    for _ in range(level):
        step = np.diff(points)
        bumps = [points[:-1] + step * share for share in (0, 1 / 3, 0.5 + 1j / (2 * 3**0.5), 2 / 3)]
        points = np.append(np.stack(bumps, axis=1).ravel(), points[-1])
    return np.stack([points.real, points.imag], axis=1)


def curtain(curve, height, steps):
    """A curve drawn out along the third axis."""
    n = len(curve)
    verts = np.concatenate([np.column_stack([curve, np.full(n, z)]) for z in np.linspace(0, height, steps)])
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n - 1), np.arange(steps - 1)))
    a = j * n + i
    return verts, np.concatenate([np.stack([a, a + 1, a + n], axis=1), np.stack([a + 1, a + n + 1, a + n], axis=1)])


@pytest.mark.parametrize("shape", [sphere(6, rng=2), torus()], ids=lambda shape: shape.name)
def test_a_smooth_surface_has_two(shape):
    assert fractal_dimension(shape.verts, shape.faces) == pytest.approx(2, abs=0.06)


@pytest.mark.slow
def test_a_curtain_along_a_koch_curve_has_one_more_than_the_curve():
    verts, faces = curtain(100 * koch_curve(5), 400.0, 500)
    found = fractal_dimension(verts, faces, finest=2.0, coarsest=16.0)
    assert found == pytest.approx(1 + np.log(4) / np.log(3), abs=0.05)


@pytest.mark.slow
def test_rotation_and_unit_change_little_and_the_seed_says_the_rest(rng):
    shape = bumpy_sphere(6)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    one = fractal_dimension(shape.verts, shape.faces)
    assert fractal_dimension(shape.verts, shape.faces) == one
    assert fractal_dimension(0.001 * shape.verts, shape.faces) == pytest.approx(one, abs=1e-9)
    assert fractal_dimension(shape.verts @ turn.T, shape.faces) == pytest.approx(one, abs=0.02)


def test_sizes_that_the_mesh_can_not_bear_are_refused():
    shape = sphere(4)
    least = 2 * mean_edge_length(shape.verts, shape.faces)
    for finest, coarsest, expected in ((0.1, None, r"0\.1 to \d"), (20.0, 10.0, r"20 to 10\.")):
        with pytest.raises(OutOfRange, match=rf" {least:.3g} .*{expected}"):
            fractal_dimension(shape.verts, shape.faces, finest=finest, coarsest=coarsest)
