"""Shells around bodies: exact distances of boxes, balls and ellipsoids, their volumes, and the order of the grid."""

import numpy as np
import pytest

from morphofold.sim.mesh.brick_mesh import Plane, cube_directions
from morphofold.sim.rigid_shells import EllipsoidShell, HullShell

BOX = np.array([30.0, 20.0, 12.0])
CORNERS = BOX * (np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T)
AXES = np.array([60.0, 45.0, 40.0])


def measured(shell, x, gap=0.0):
    depth, normal = np.zeros(len(x)), np.zeros((len(x), 3))
    shell.measure(x, gap, depth, normal)
    return depth, normal


def beside(axes, gap, rng, count=500):
    """Points (P, 3) at a distance from an ellipsoid, and its normals there."""
    foot = rng.standard_normal((count, 3))
    foot *= axes / np.linalg.norm(foot, axis=1, keepdims=True)
    normal = foot / axes**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return foot + gap * normal, normal


def test_the_distance_from_a_box_is_exact_over_its_faces_and_within_its_bound_elsewhere(rng):
    shell = HullShell(CORNERS, 8.0)
    x = rng.uniform(-1, 1, (5000, 3)) * (BOX + 8)
    out = np.maximum(np.abs(x) - BOX, 0)
    exact = np.linalg.norm(out, axis=1)
    depth, normal = measured(shell, x)
    over_face = (np.count_nonzero(out, axis=1) == 1) & (np.sort(np.abs(x) - BOX, axis=1)[:, 1] < -1.8 * shell.spacing)
    assert np.count_nonzero(over_face) > 500
    away = over_face & (exact > shell.spacing)
    np.testing.assert_allclose(depth[away], exact[away], atol=1e-9)
    np.testing.assert_allclose(normal[away], (np.sign(x) * (out > 0))[away], atol=1e-9)
    far = (exact > 3 * shell.spacing) & (exact < 10)
    error = depth[far] - exact[far]
    assert error.min() > -1e-9
    nearest = exact[far] - 3**0.5 * shell.spacing  # in the same cell of the grid
    assert (error <= shell.spacing**2 / 4 / nearest).all()
    assert error.max() > 0.01


@pytest.mark.parametrize("axes", [np.full(3, 50.0), pytest.param(AXES, marks=pytest.mark.slow)])
def test_the_error_of_the_distance_from_a_smooth_body_falls_with_the_square_of_the_spacing(axes, rng):
    """The hull of 13,800 points lies up to 0.014 mm inside of the body."""
    points = cube_directions(48)[0] * axes
    gap, spacing, error, turns = 6.0, [], [], []
    x, exact = beside(axes, gap, rng)
    for least in (3.0, 4.5, 8.0):
        shell = HullShell(points, gap, least_spacing=least)
        depth, normal = measured(shell, x, gap)
        spacing.append(shell.spacing)
        error.append(np.abs(depth).max())
        turns.append(np.linalg.norm(normal - exact, axis=1).max())
    radius = axes.min() ** 2 / axes.max() + gap  # the least radius of the shell
    assert (np.array(error) < np.square(spacing) / (4 * radius) + 0.014).all()
    assert np.polyfit(np.log(spacing), np.log(error), 1)[0] == pytest.approx(2, abs=0.35)
    assert (np.array(turns) < 1.5 * np.array(spacing) / radius).all()


@pytest.mark.slow
def test_a_shell_bridges_a_hollow():
    """A ball with a dent under the plane z = 40: over the dent the distance is that from the plane."""
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), np.full(200, 40.0)])
    points = np.vstack([50 * cube_directions(24)[0], rim])
    dented = points * np.where(points[:, 2] > 40, 0.7, 1.0)[:, None]
    shell = HullShell(dented, 8.0)
    depth, normal = measured(shell, np.array([[0.0, 0.0, 45.0], [3.0, -2.0, 47.0]]))
    np.testing.assert_allclose(depth, [5.0, 7.0], atol=1e-6)
    np.testing.assert_allclose(normal, [[0, 0, 1], [0, 0, 1]], atol=1e-6)
    elsewhere = 1.08 * points[points[:, 2] < 0]
    whole = HullShell(points, 8.0)
    np.testing.assert_allclose(measured(shell, elsewhere)[0], measured(whole, elsewhere)[0], atol=0.05)


def test_shells_hold_what_steiner_says():
    """A box with faces of area A and edges of length L: V + A gap + pi L gap^2 / 4 + 4/3 pi gap^3."""
    a, b, c = 2 * BOX
    shell = HullShell(CORNERS, 8.0)
    for gap in (1.0, 4.0, 8.0):
        exact = a * b * c + 2 * (a * b + b * c + c * a) * gap + np.pi * (a + b + c) * gap**2 + 4 / 3 * np.pi * gap**3
        assert shell.volume(gap) == pytest.approx(exact, rel=2e-3)
        assert shell.volume(gap, Plane(1, 0.0, -1)) == pytest.approx(exact / 2, rel=2e-3)
        beyond = b * c * gap + np.pi * (b + c) * gap**2 / 2 + 2 / 3 * np.pi * gap**3  # x > 30
        assert exact - shell.volume(gap, Plane(0, 30.0, -1)) == pytest.approx(beyond, rel=0.03, abs=2e-3 * exact)
    assert EllipsoidShell(AXES).volume(2.0) == pytest.approx(4 / 3 * np.pi * np.prod(AXES + 2.0))


def test_outside_of_its_grid_a_shell_is_as_far_as_the_grid_is_and_more(rng):
    shell = HullShell(CORNERS, 2.0)
    x = rng.uniform(-1, 1, (300, 3)) * 400
    depth, normal = measured(shell, x)
    exact = np.linalg.norm(np.maximum(np.abs(x) - BOX, 0), axis=1)
    far = exact > 20
    assert (depth[far] > 0.7 * exact[far]).all()
    assert (depth[far] < 1.6 * exact[far]).all()
    assert (np.einsum("ij,ij->i", normal, x)[far] > 0).all()


def test_the_normals_of_a_hull_are_the_slopes_of_its_depth(rng):
    """So forces are exactly those of their energy; outside of the grid too."""
    shell = HullShell(CORNERS, 2.0)
    x, direction, h = rng.uniform(-1, 1, (400, 3)) * (BOX + 12), rng.standard_normal((400, 3)), 1e-6
    slope = (measured(shell, x + h * direction)[0] - measured(shell, x - h * direction)[0]) / (2 * h)
    off = np.abs(slope - np.einsum("ij,ij->i", measured(shell, x)[1], direction))
    assert np.median(off) < 1e-8
    assert np.count_nonzero(off > 1e-6) <= 2  # between two cells of the grid
