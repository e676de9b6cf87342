"""The barrier of corner_barrier: its energy, forces and stiffness; it acts on collapsed corners alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from morphofold.errors import DoesNotApply, ImpossibleBody
from morphofold.sim.body import Body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects.contact import Contact
from morphofold.sim.effects.corner_barrier import LEAST_J, STRENGTH, CornerBarrier
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.studies.speed.solver_speed import cut_bricks

MU = 2.0


def body_of(bilayer, X=None):
    return Body(bilayer, mu_cortex=MU, mu_core=1.0, kappa_ratio=50.0, law="tangential", X=X)


def unit_bricks():
    """Bricks of 1 mm; the first is at the origin, the pial surface at z = 0."""
    return body_of(bilayer_patch((4.0, 4.0), 12.0, 3.0, 1.0))


def barrier_of(body, x):
    effect = CornerBarrier()
    effect.prepare(body)
    effect.refresh(SimpleNamespace(body=body, state=SimpleNamespace(x=x)))
    return effect


def forces(effect, body, x):
    rows = body.elements.blocks
    rows.force[:] = 0
    effect.add_element_forces(body, x, np.zeros_like(x))
    return rows.nodal_forces()


def node_at(body, *point):
    return int(np.argmin(np.linalg.norm(body.X - point, axis=1)))


@pytest.fixture
def crumpled(rng):
    """An octant at g = 1.5, its nodes scattered so far that corners turn inside out."""
    body = body_of(bilayer_sphere(50, 3, 25, "octant", 6))  # 27 quads: lanes are left over
    body.grow(1.5)
    x = body.X + 2.0 * rng.standard_normal(body.X.shape)
    return body, x, barrier_of(body, x)


def test_a_column_pressed_flat_has_the_energy_and_the_force_of_its_four_corners():
    body, J, g = unit_bricks(), 0.1, 1.2
    body.grow(g)
    top, x = node_at(body, 2, 2, 0), body.X.copy()
    x[top, 2] = -1 + J * g**2  # the corners beside it keep their volume: their edges are sheared
    effect = barrier_of(body, x)
    pushed = forces(effect, body, x)
    modulus = STRENGTH * MU * g**2 / 8  # of the volume of a corner, an eighth of the grown brick
    assert effect.record() == {"corners": 4, "lowest_J": pytest.approx(J)}
    assert effect.energy() == pytest.approx(4 * 0.5 * modulus * (LEAST_J - J) ** 2)
    up = [0.0, 0.0, 4 * modulus * (LEAST_J - J) / g**2]
    np.testing.assert_allclose(pushed[[top, node_at(body, 2, 2, -1)]], [up, np.negative(up)], atol=1e-12)


def test_forces_are_the_slope_of_the_energy_and_the_stiffness_that_of_the_forces(crumpled, rng):
    body, x, effect = crumpled
    assert effect.record()["corners"] > 20
    direction, step = rng.standard_normal(x.shape), 1e-5
    sides = []
    for side in (-1, 1):
        pushed = forces(effect, body, x + side * step * direction)
        sides.append((effect.energy(), pushed))
    slope, change = ((after - before) / (2 * step) for before, after in zip(*sides))
    assert np.sum(forces(effect, body, x) * direction) == pytest.approx(-slope, rel=1e-7)
    stiffness = effect.stiffness(body, x)
    np.testing.assert_allclose(stiffness @ direction.ravel(), -change.ravel(), atol=1e-7 * np.abs(change).max())


def test_no_net_force_no_net_torque_and_forces_that_turn_with_the_body(crumpled):
    body, x, effect = crumpled
    pushed, energy = forces(effect, body, x), effect.energy()
    size = np.abs(pushed).sum()
    assert np.abs(pushed.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(x, pushed).sum(axis=0)).max() < 1e-12 * size * np.abs(x).max()
    turn = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    rotated = forces(effect, body, x @ turn.T + 3.0)
    np.testing.assert_allclose(rotated, pushed @ turn.T, atol=1e-11 * np.abs(pushed).max())
    assert effect.energy() == pytest.approx(energy, rel=1e-11)


def test_springs_bound_the_stiffness_of_the_surface_over_its_mass(crumpled, rng):
    """Less the part that only turns the force: that of a linear determinant."""
    body, x, effect = crumpled
    p = effect._pressed(x)
    slopes = np.zeros((len(p.nodes), x.size))
    for row, nodes, gradient in zip(slopes, p.nodes, p.gradient):
        row.reshape(-1, 3)[nodes] = gradient
    linear = (slopes.T * p.modulus) @ slopes / np.sqrt(np.outer(np.repeat(body.mass, 3), np.repeat(body.mass, 3)))
    n = 3 * body.n_surface
    fastest = np.linalg.eigvalsh(linear[:n, :n])[-1]
    assert fastest > 0.1
    assert fastest <= effect.springs(body, x).max() <= 4 * fastest
    assert np.all(effect.springs(body, body.X) == 0)


def test_a_body_whose_corners_are_sound_does_not_feel_it():
    runs = [
        Dynamics(body_of(bilayer_sphere(50, 3, 25, "octant", 8)), effects, steps_per_unit=600)
        for effects in ([], [CornerBarrier()])
    ]
    for run in runs:
        run.grow_to(1.3)
    plain, guarded = runs
    record = guarded.state.record["effects"]["corner_barrier"]
    assert record["corners"] == 0
    assert record["lowest_J"] > LEAST_J
    assert np.array_equal(plain.state.x, guarded.state.x)


def test_sides_of_a_quad_that_have_passed_each_other_are_pushed_back():
    """Where contact sees no pair."""
    body = unit_bricks()
    side = [node_at(body, 2, y, 0) for y in (1, 2)]
    x = body.X.copy()
    x[side, 0] = 0.8  # the side x = 1 is now in front of them
    run = SimpleNamespace(body=body, state=SimpleNamespace(x=x))
    contact, extra = Contact(), np.zeros((body.n_surface, 3))
    contact.prepare(body)
    contact.refresh(run)
    contact.add_forces(body, x, np.zeros_like(x), extra)
    assert not extra.any()
    effect = barrier_of(body, x)
    assert effect.record()["lowest_J"] == pytest.approx(-0.2)
    pushed = forces(effect, body, x)
    assert np.all(pushed[side, 0] > 0)
    assert np.all(pushed[[node_at(body, 1, y, 0) for y in (1, 2)], 0] < 0)


def test_tetrahedra_and_corners_inside_out_are_refused():
    with pytest.raises(DoesNotApply):
        CornerBarrier().prepare(body_of(cut_bricks(bilayer_sphere(50, 3, 25, "octant", 6))))
    bilayer = bilayer_patch((4.0, 4.0), 12.0, 3.0, 1.0)
    X = bilayer.mesh.p.T.copy()
    X[np.argmin(np.linalg.norm(X - [2, 2, 0], axis=1))] += [0.6, 0.6, 0.0]  # beyond a diagonal of its quad
    with pytest.raises(ImpossibleBody) as refusal:
        CornerBarrier().prepare(body_of(bilayer, X))
    assert "node" in str(refusal.value)
