"""Coarse levels of a body: interpolation, mass of smooth motions, symmetry, and what takes them away."""

import numpy as np
import pytest

from morphofold.sim.body import FASTEST_WAVE, Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.sim.mesh.quad_coarsening import depths_kept, halve
from morphofold.sim.multilevel_acceleration import LEVEL_ACCELERATIONS, CoarseLevels
from morphofold.studies.speed.solver_speed import cut_bricks

MODULI = dict(mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")


def grid(nu, nv):
    """Vertices (n, 2) and quads of a grid of nu x nv cells."""
    u, v = np.meshgrid(np.arange(nu + 1), np.arange(nv + 1), indexing="ij")
    number = np.arange(u.size).reshape(u.shape)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    return np.column_stack([u.ravel(), v.ravel()]).astype(float), quads


def levels_of(bilayer, thickness=3.0, springs=0.0, crushed=1.0):
    """Levels on free nodes of random mass, and that mass."""
    X = np.ascontiguousarray(bilayer.mesh.p.T)
    levels = CoarseLevels(bilayer, X, np.ones(X.shape, dtype=bool), thickness)
    mass = np.random.default_rng(1).uniform(1.0, 3.0, len(X))
    levels.update(mass, np.full(len(X), crushed), np.full(bilayer.n_surface, springs))
    return levels, mass


def test_a_grid_is_halved_and_linear_functions_are_interpolated_exactly():
    points, quads = grid(8, 6)
    half = halve(quads, len(points))
    assert half.interpolation.shape == (63, 20)
    assert len(half.quads) == 12
    np.testing.assert_allclose(half.interpolation @ points[half.vertices], points, atol=1e-12)
    corners = points[half.vertices][half.quads]
    diagonal, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    area = 0.5 * (diagonal[:, 0] * second[:, 1] - diagonal[:, 1] * second[:, 0])
    np.testing.assert_allclose(area, 4.0)  # cells of twice the edge, counter-clockwise


def test_a_grid_with_odd_sides_is_halved_but_for_its_rim():
    points, quads = grid(5, 7)
    half = halve(quads, len(points))
    np.testing.assert_allclose(half.interpolation.sum(axis=1), 1.0)
    assert len(half.quads) == 2 * 3


@pytest.mark.parametrize("portion", ["octant", "quarter", "half", "full"])
def test_spheres_of_any_portion_have_all_levels_if_their_sides_divide_by_four(portion):
    levels, _ = levels_of(bilayer_sphere(50, 3.0, 25, portion, 12))
    assert levels.lightness == 1 + sum(LEVEL_ACCELERATIONS)
    if portion == "full":
        assert levels_of(bilayer_sphere(50, 3.0, 25, portion, 14))[0].lightness == 1 + LEVEL_ACCELERATIONS[0]


def test_levels_of_nodes_that_are_kept():
    assert depths_kept(np.array([0, 1, 2, 3, 4, 5.5, 7, 10, 14.0]), 3, 3.0).tolist() == [0, 3, 6, 7, 8]


@pytest.mark.parametrize("portion", ["octant", "full"])
def test_a_body_moved_as_a_whole_has_the_mass_of_its_nodes_over_the_lightness(portion):
    levels, mass = levels_of(bilayer_sphere(50, 3.0, 25, portion, 12))
    a = levels.accelerations(np.outer(mass, [1.0, -2.0, 0.5]), mass)
    np.testing.assert_allclose(a, np.outer(np.full(len(mass), levels.lightness), [1.0, -2.0, 0.5]), rtol=1e-12)


def test_accelerations_by_levels_are_symmetric_and_do_work():
    levels, mass = levels_of(bilayer_patch((8.0, 8.0), 6.0, 1.0, 1.0), thickness=1.0)
    f, g = np.random.default_rng(0).standard_normal((2, len(mass), 3))
    first, second = levels.accelerations(f, mass), levels.accelerations(g, mass)
    assert np.sum(g * first) == pytest.approx(np.sum(f * second), rel=1e-12)
    assert np.sum(f * first) > np.sum(f * f / mass[:, None])


def test_forces_that_change_from_node_to_node_get_the_nodal_mass():
    bilayer = bilayer_patch((16.0, 16.0), 6.0, 1.0, 1.0)
    levels, mass = levels_of(bilayer, thickness=1.0)
    mass[:] = 1.0
    levels.update(mass, np.ones(len(mass)), np.zeros(bilayer.n_surface))
    x, y, _ = bilayer.mesh.p
    rough = np.outer((-1.0) ** np.round(x + y), [0.0, 0.0, 1.0])
    inner = (np.abs(x - x.mean()) < 5) & (np.abs(y - y.mean()) < 5)
    np.testing.assert_allclose(levels.accelerations(rough, mass)[inner], rough[inner], atol=1e-12)


def test_an_octant_moves_as_the_whole_sphere_does():
    for n in (8, 12):
        whole = Body(bilayer_sphere(50, 3.0, 25, "full", n), **MODULI)
        octant = Body(bilayer_sphere(50, 3.0, 25, "octant", n), **MODULI)
        pulls = []
        for body in (octant, whole):
            shape = (body.X / 50) ** 2
            x = body.X * (1 + 1e-3 * (shape[:, [0]] * shape[:, [1]] + shape[:, [1]] * shape[:, [2]] ** 2))
            force = body.all_forces(x) * body.free
            pulls.append(body.levels.accelerations(force, body.mass) * body.free)
        key = {tuple(p): k for k, p in enumerate(np.round(whole.X, 6) + 0.0)}
        same = [key[tuple(p)] for p in np.round(octant.X, 6) + 0.0]
        np.testing.assert_allclose(pulls[0], pulls[1][same], atol=1e-9 * np.abs(pulls[1]).max())


def test_levels_are_heavier_where_elements_are_crushed_or_walls_press():
    bilayer = bilayer_patch((8.0, 8.0), 6.0, 1.0, 1.0)
    force = np.ones((bilayer.mesh.nvertices, 3))
    free, crushed, pressed = (
        levels.accelerations(force, mass)[: bilayer.n_surface].min()
        for levels, mass in (levels_of(bilayer, 1.0, springs, crush) for springs, crush in ((0, 1), (0, 3), (0.8, 1)))
    )
    assert crushed < 0.6 * free
    assert pressed < 0.7 * free


@pytest.mark.parametrize(("n", "layers"), [(40, 1), (16, 2), (8, 3)])
def test_no_wave_of_a_body_is_too_fast_for_the_step(n, layers):
    """Flat bricks and single layers leave little room: there the levels add less, or nothing."""
    body = Body(bilayer_sphere(50, 3.0, 25, "octant", n, layers), **MODULI)
    alone = body.fastest_wave(np.ones(len(body.X), dtype=bool), body.mass)
    assert body.fastest_wave(np.ones(len(body.X), dtype=bool), body.mass, body.levels) <= max(FASTEST_WAVE, alone)


def test_tetrahedra_have_no_levels_and_a_body_can_do_without():
    bilayer = bilayer_sphere(50, 6.0, 25, "octant", 8)
    assert Body(cut_bricks(bilayer), **MODULI).levels.lightness == 1
    body = Body(bilayer, **MODULI)
    body.levels.remove()
    assert body.levels.lightness == 1
    force = np.random.default_rng(0).standard_normal(body.X.shape)
    np.testing.assert_allclose(body.levels.accelerations(force, body.mass), force / body.mass[:, None], rtol=1e-12)


@pytest.mark.slow
def test_folds_come_to_rest_in_the_same_state_with_and_without_levels():
    """Which way a body moves is fictitious; where it rests is not. Before folds cross, there is one state."""
    ends = []
    for lightest in (True, False):
        body = Body(bilayer_sphere(50, 6.0, 25, "octant", 16), **MODULI)
        if not lightest:
            body.levels.remove()
            body.crossing *= (1 + sum(LEVEL_ACCELERATIONS)) ** 0.5
        run = Dynamics(body, [Contact(), Symmetry()], steps_per_unit=138 * body.crossing)
        run.grow_to(1.15)
        run.relax(round(150 * body.crossing))
        ends.append(run.state.x)
    assert np.abs(ends[0] - ends[1]).max() < 1e-4 * 6.0
