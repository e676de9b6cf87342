"""A split bulk modulus: at rest the body is the same, and pressures that follow never feed a motion."""

import numpy as np
import pytest
from made_bodies import block

from morphofold.sim.build import build_body
from morphofold.sim.dynamics import FOLLOW_OVER_BOUND, PATIENCE_TICKS, Dynamics, follow_share
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.equilibrium.statics import equilibrium
from morphofold.sim.scene import in_double
from morphofold.sim.scene.scene_files import load_scene


@pytest.fixture
def bodies():
    return [block(split_bulk=split) for split in (False, True)]


def test_followed_pressures_give_the_forces_and_energy_of_the_whole_modulus(bodies, rng):
    whole, split = bodies
    x = whole.X + 0.05 * rng.standard_normal(whole.X.shape)
    split.elements.compute_forces(x, 1.0)
    split.elements.measure(x)
    np.testing.assert_allclose(split.forces(x), whole.forces(x), rtol=1e-10, atol=1e-10)
    whole.elements.measure(x)
    np.testing.assert_allclose(split.elements.state()["energy"], whole.elements.state()["energy"], rtol=1e-12)
    for split_again in (False, True):
        assert split.split_bulk(split_again)
        assert split.is_split is split_again
        np.testing.assert_allclose(split.forces(x), whole.forces(x), rtol=1e-10, atol=1e-10)
    assert not split.split_bulk(True)
    assert not whole.split_bulk(True)


def test_without_them_the_body_is_softer_against_volume_alone_so_steps_are_longer(bodies):
    whole, split = bodies
    assert split.crossing < whole.crossing / 1.2
    for stretch, is_softer in (
        (np.diag([1.01, 1.01, 1.01]), True),
        (np.eye(3) + [[0, 0.01, 0], [0] * 3, [0] * 3], False),
    ):
        energy = [-np.sum(body.forces(body.X @ stretch.T) * (body.X @ stretch.T - body.X)) for body in bodies]
        assert bool(abs(energy[1]) < 0.8 * abs(energy[0])) is is_softer


def growth_of_motion(w2, share, damping, follow):
    """Factor per step by which the slowest decaying motion of one mode and its pressure changes; as the run steps."""
    ratio = Bricks.MODULUS_RATIO - 1
    #: v' = (1 - c) v - w2 (x + share p), x' = x + v', p' = p + follow (ratio x - p), with x before the step
    step = np.array(
        [[1 - w2, 1 - damping, -w2 * share], [-w2, 1 - damping, -w2 * share], [follow * ratio, 0, 1 - follow]]
    )
    return np.abs(np.linalg.eigvals(step)).max()


def test_no_motion_of_any_stiffness_is_fed_and_a_little_beyond_the_bound_some_are():
    stiffness = np.geomspace(1e-5, 3.0, 60)
    factors = lambda damping, follow: [
        growth_of_motion(w2, a, damping, follow) for w2 in stiffness for a in (0.3, 0.7, 1)
    ]
    for damping in (0.002, 0.01, 0.02, 0.05, 0.1, 0.5):
        assert max(factors(damping, follow_share(damping))) < 1
    for damping in (0.002, 0.01, 0.05):
        assert max(factors(damping, 1.2 * follow_share(damping) / FOLLOW_OVER_BOUND)) > 1


def test_a_grown_sphere_rests_where_the_whole_modulus_has_its_equilibrium():
    scene = load_scene("fig6-thick", ["geometry.portion=octant", "accuracy.edge=4.5", "effects={}"])
    assert scene.splits_bulk
    run = Dynamics.of(scene, build_body(scene))
    run.grow_to(1.1)
    assert run.settle()
    run.hold(200)
    exact = equilibrium(build_body(in_double(scene)), 1.1)
    assert np.abs(run.state.x - exact).max() < 1e-5 * run.body.thickness


def test_a_stage_held_for_long_has_the_whole_modulus_and_growth_splits_it_again():
    run, resumed = (Dynamics(block(split_bulk=True), steps_per_unit=2000) for _ in range(2))
    run.grow_to(1.1)
    run.hold(PATIENCE_TICKS)
    pressures, mass = run.body.elements.pressures.copy(), run.body.mass
    assert run.body.is_split
    assert np.abs(pressures).max() > 0
    run.hold(PATIENCE_TICKS + 1)
    assert not run.body.is_split
    assert not run.body.elements.pressures.any()
    assert run.body.mass.mean() > 1.4 * mass.mean()
    resumed.load(run.save())
    for continued in (run, resumed):
        continued.relax(continued.state.relaxed + 24)
    np.testing.assert_array_equal(resumed.state.x, run.state.x)
    run.grow_to(1.11)
    assert run.body.is_split
    np.testing.assert_allclose(run.body.elements.pressures, pressures, atol=0.1 * np.abs(pressures).max())


def test_growth_beyond_a_bound_has_the_whole_modulus(monkeypatch):
    monkeypatch.setattr("morphofold.sim.dynamics.MOST_SPLIT_GROWTH", 1.05)
    run, splits = Dynamics(block(split_bulk=True), steps_per_unit=2000), {}
    run.grow_to(1.1, lambda state: splits.update({state.growth: run.body.is_split}))
    assert max(growth for growth, is_split in splits.items() if is_split) == pytest.approx(1.05, abs=12 / 2000)
    assert not run.body.is_split
    run.hold(12)
    assert not run.body.is_split


@pytest.mark.parametrize(
    "settings", [["accuracy.precision=double"], ["effects.inertia={}"], ["effects.stress_growth={}"]]
)
def test_where_forces_must_be_those_of_positions_the_modulus_is_whole(settings):
    assert not load_scene("demo", settings).splits_bulk


@pytest.mark.parametrize(
    ("moduli", "is_split"),
    [
        ({"kappa_ratio": 25.0}, True),
        ({"kappa_ratio": 24.0}, False),
        ({"mu_cortex": 0.9}, False),
        ({"mu_cortex": 6.0}, False),
    ],
)
def test_only_bodies_in_which_volume_waves_are_the_fastest_by_far_are_split(moduli, is_split):
    assert block(split_bulk=True, **moduli).is_split is is_split
