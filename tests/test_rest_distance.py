"""How far from rest a run is told to be, and that it gets there."""

import dataclasses

import numpy as np
import pytest
from made_bodies import beam, curvature, timoshenko
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh, spsolve

from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import (
    LEAST_PATIENCE_TICKS,
    MOST_PATIENCE_FACTOR,
    PATIENCE_PER_GROWTH_TICK,
    PATIENCE_TICKS,
    REST_DISTANCE_OVER_T,
    REST_TICKS,
    STEPS_PER_MEASUREMENT,
    Dynamics,
)
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.rest_distance import MOST_SLOWNESS, SOFT_MODE_W2, Balance, softest
from morphofold.sim.equilibrium.statics import Equilibrium, equilibrium
from morphofold.sim.equilibrium.tangent import Tangent, cauchy_stress
from morphofold.sim.mesh.brick_mesh import bilayer_patch
from morphofold.sim.scene.scene_files import load_scene

TICK = 20.0  # steps


def swinging(w2, damping, left, steps, more=0.0, near=1e9):
    """The gauge after ``steps`` of nodes in springs, w2 per tick^2 and damping per tick, let go ``left`` from rest;
    ``more`` is how far they shake, three times in a tick."""
    mass, stiff = np.linspace(1.0, 2.0, 50), w2 / TICK**2
    direction = np.random.default_rng(3).standard_normal((50, 3))
    direction /= np.sqrt(np.mean(np.sum(direction**2, axis=1)))
    shake = more * np.roll(direction, 1, axis=0)
    balance, x, v = Balance(TICK, np.full((50, 3), 1e3), limit=near), left, 0.0
    for step in range(1, steps + 1):
        a, was = -stiff * x, x
        v = (1 - damping / TICK) * v + a
        x += v
        if step % STEPS_PER_MEASUREMENT == 0:
            fast = np.sin(6 * np.pi * step / TICK)
            balance.update(
                step,
                was * direction + fast * shake,
                a * direction - (6 * np.pi / TICK) ** 2 * fast * shake,
                mass,
                damping / TICK,
            )
    return balance, was


@pytest.mark.parametrize("w2", [0.0005, 0.002, 0.004])
def test_of_a_body_that_creeps_in_a_soft_mode_the_distance_is_that_from_rest(w2):
    balance, left = swinging(w2, damping=0.5, left=7.0, steps=round(80 * TICK))
    assert balance.w2 * TICK**2 == pytest.approx(w2, rel=0.01)
    assert balance.distance == pytest.approx(abs(left), rel=0.05)
    assert balance.distance <= balance.left < 1.5 * balance.distance


def test_of_a_drift_that_falls_more_slowly_than_the_softest_mode_would_the_distance_is_as_much_larger():
    """Forces are too small to tell its softness; it creeps at half of the rate of SOFT_MODE_W2."""
    damping, mass, rng = 0.1, np.ones(50), np.random.default_rng(1)
    rate = SOFT_MODE_W2**0.5 / 2  # that mode swings
    direction, balance = rng.standard_normal((50, 3)), Balance(TICK, np.zeros((50, 3)), limit=0.0)
    balance.forget()
    for step in range(12, round(40 * TICK), 12):
        x = direction * np.exp(-rate * step / TICK)
        balance.update(step, x, np.zeros_like(x), mass, damping / TICK)
    exact = np.sqrt(np.mean(np.sum(x**2, axis=1)))
    assert balance.distance < 0.6 * exact
    assert balance.left == pytest.approx(2 * balance.distance, rel=0.1)
    assert balance.left == pytest.approx(exact, rel=0.15)


def test_of_a_stiffer_mode_it_is_more_and_of_one_that_shakes_besides_no_less():
    """Softer modes may hide in the drift that is seen: it is never taken for stiffer than those of folds."""
    balance, left = swinging(8 * SOFT_MODE_W2, damping=0.5, left=7.0, steps=round(8 * TICK))
    assert abs(left) < balance.distance < 20 * abs(left)
    balance, left = swinging(SOFT_MODE_W2, damping=0.5, left=7.0, steps=round(12 * TICK), more=1.0)
    assert abs(left) < balance.distance < 10 * abs(left)


def test_what_leaves_a_saddle_is_told_by_its_sign_and_not_calm():
    balance, _ = swinging(-0.02, damping=0.15, left=1e-3, steps=round(30 * TICK), near=0.01)
    assert balance.w2 * TICK**2 == pytest.approx(-0.02, rel=0.01)
    assert balance.distance > 0.01
    assert balance.calm == 0
    assert balance.left == MOST_SLOWNESS * balance.distance  # it rises


def strip(*settings):
    size = ["geometry.length=24", "geometry.depth=16", "accuracy.edge=1.0", "accuracy.elements_through_cortex=3"]
    scene = load_scene("strip", [*size, "accuracy.precision=double", *settings])
    effects = build_effects(scene)
    body = build_body(scene, effects)
    return Dynamics(body, effects, steps_per_unit=scene.steps_per_unit(body.crossing))


def exact_distance(run):
    """K^-1 f by the stiffness of the elements and the filter, rms over the nodes [mm]."""
    body, x = run.body, run.state.x
    forces = body.forces(x)
    forces[: body.n_surface] += body.filter.forces(x)
    free = body.free.copy()
    free[:, 1] = False  # plane strain
    rows = np.flatnonzero(free)
    K = Tangent(body).at(x)[rows][:, rows]
    left = spsolve(K.tocsc(), forces.ravel()[rows])
    return float(np.sqrt(np.sum(left**2) / len(x)))


@pytest.mark.parametrize("growth", [1.15, 1.2])
def test_crests_of_a_strip_at_rest_are_as_high_as_newtons_equilibrium_says(growth):
    """A cortex five times as stiff as its core, beyond first wrinkles at 1.117, before walls touch."""
    size = ["geometry.length=24", "geometry.depth=16", "accuracy.edge=0.8", "accuracy.elements_through_cortex=3"]
    more = ["material.mu_ratio=5", f"growth.final={growth}", "output.stages=[]", "output.patience=10"]
    scene = load_scene("strip", [*size, *more])
    effects = build_effects(scene)
    run = Dynamics.of(scene, build_body(scene, effects), effects)
    run.grow_to(growth)
    assert run.settle()
    exact_scene = load_scene(scene, ["accuracy.precision=double"])  # with forces that are a function of positions
    body = build_body(exact_scene, build_effects(exact_scene))
    body.grow(growth)
    heights = [np.ptp(x[: body.n_surface, 2]) for x in (run.state.x, Equilibrium(body, run.state.x.copy()).relaxed())]
    assert heights[0] == pytest.approx(heights[1], rel=0.02)
    assert heights[1] > body.thickness


def test_of_a_strip_in_folds_the_distance_is_not_less_than_newtons_step_and_falls_with_it():
    """Nothing touches. The softest mode of these folds is stiffer than SOFT_MODE_W2: the distance is too large.

    Before they first swing through their rest, Newton's step has no meaning.
    """
    run = strip("growth.final=1.27")
    run.grow_to(1.27)
    run.relax(int(15 * run.body.crossing))
    estimated, exact = [], []
    for _ in range(5):
        run.relax(run.state.relaxed + int(15 * run.body.crossing))
        estimated.append(run.balance.distance)
        exact.append(exact_distance(run))
    ratio = np.array(estimated) / exact
    assert ((ratio > 1) & (ratio < 60)).all()
    assert exact[-1] < 0.05 * exact[0]
    assert estimated[-1] < 0.03 * estimated[0]


def test_a_beam_rests_at_every_stage_of_a_row_however_little_it_grew_in_between():
    """What it shakes after a stop is stiff, and over before its bow moves: the body knows its softest mode.

    Its bow is that of Timoshenko 1925, within 4 % on this mesh.
    """
    body = beam(edge=1.0)
    run = Dynamics(body, steps_per_unit=180 * body.crossing)
    for g in (1.02, 1.022, 1.03):
        run.grow_to(g)
        assert run.settle()
        bow = curvature(body, run.state.x)
        assert bow == pytest.approx(curvature(body, equilibrium(beam(edge=1.0), g)), rel=0.02)
        assert bow == pytest.approx(timoshenko(g), rel=0.05)


def test_the_softest_mode_of_a_beam_is_found_from_above_and_a_sphere_has_none_as_soft():
    body = beam(edge=1.0)
    rows = np.flatnonzero(body.free)
    K, mass = Tangent(body).at(body.X)[rows][:, rows], sparse.diags(np.repeat(body.smooth_mass, 3)[rows])
    exact = eigsh(K, 1, mass, sigma=0.0, which="LM", return_eigenvectors=False)[0] * body.crossing**2
    assert exact <= softest(body) < SOFT_MODE_W2 / 3
    body.grow(1.3)
    assert softest(body) == pytest.approx(softest(beam(edge=1.0)), rel=1e-6)
    assert body.growth == 1.3
    for settings in (["geometry.portion=octant"], ["material.mu_ratio=10"]):
        assert softest(build_body(load_scene("fig6-thick", ["accuracy.edge=3.6", *settings]))) > 10 * SOFT_MODE_W2
    # forces to one side alone are no symmetric stiffness, and would shift this one on its hole
    assert softest(build_body(load_scene("fig6-thin", ["accuracy.edge=2.5"]))) > 100 * SOFT_MODE_W2


@pytest.mark.slow
def test_a_body_that_floats_has_motions_without_stiffness_that_are_not_its_softest_mode():
    block = bilayer_patch((20.0, 4.0), 4.0, 1.0, 1.0)
    free = dataclasses.replace(block, planes=(), held=np.array([], dtype=np.int64))
    floating = Body(free, mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    K, mass = Tangent(floating).at(floating.X), np.repeat(floating.smooth_mass, 3)
    values = eigh(K.toarray(), np.diag(mass), eigvals_only=True, subset_by_index=[0, 8]) * floating.crossing**2
    assert np.abs(values[:6]).max() < 1e-9
    assert values[6] <= softest(floating) < 3 * values[6]


def test_a_body_that_seems_to_rest_but_leaves_a_saddle_is_not_at_rest():
    """An octant just beyond its first wrinkles: the estimate is within the bound of rest, and the body then folds."""
    settings = ["geometry.portion=octant", "accuracy.edge=3.6", "growth.final=1.24", "output.stages=[]"]
    scene = load_scene("fig6-thick", [*settings, "accuracy.precision=double", "effects={perturbation={}}"])
    effects = build_effects(scene)
    body = build_body(scene, effects)
    run, before, estimates = Dynamics.of(scene, body, effects), [], []

    def note(state):
        before.append(state.x.copy())
        estimates.append(run.balance.distance / body.thickness)

    run.grow_to(1.24)
    assert not run.settle(note)
    assert estimates[-1] < REST_DISTANCE_OVER_T
    moved = np.sqrt(np.mean(np.sum((run.state.x - before[-1]) ** 2, axis=1))) / body.thickness
    assert moved > REST_DISTANCE_OVER_T
    record = run.state.record
    assert (record["at_rest"], record["leaving_saddle"]) == (False, True)
    assert record["distance_over_T"] >= moved


def test_where_time_is_real_nothing_rests_and_no_distance_is_told():
    run = strip("effects={inertia={}}")
    run.grow_to(1.05)
    assert not run.settle()
    assert run.state.relaxed == 0
    assert run.state.record["distance_over_T"] is None


def test_a_smooth_body_at_rest_has_the_stress_of_one_that_rests_far_longer():
    """It rings when growth stops: displacements of 0.005 T are 2.5 % of the stress."""
    scene = load_scene("fig6-thick", ["geometry.portion=octant", "accuracy.edge=3.6", "effects={}"])
    body = build_body(scene)
    run = Dynamics.of(scene, body)
    run.grow_to(1.15)
    assert run.settle()
    soon = cauchy_stress(body, run.state.x)
    run.relax(run.state.relaxed + int(100 * body.crossing))
    later = cauchy_stress(body, run.state.x)
    assert np.linalg.norm(soon - later) < 2e-3 * np.linalg.norm(later)


@pytest.mark.parametrize(("distance", "longest"), [(0.2, PATIENCE_TICKS), (0.3, PATIENCE_TICKS * MOST_PATIENCE_FACTOR)])
def test_a_body_on_its_way_to_other_folds_has_more_patience_than_one_that_is_nearly_there(distance, longest):
    """What the gauge tells is made up here; how long growth then stands still is not."""
    body = Body(
        bilayer_patch((2.0, 2.0), 12.0, 1.0, 1.0), mu_cortex=1.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic"
    )
    run = Dynamics(body, steps_per_unit=1000)
    run.balance.update = lambda *state: None
    run.balance.distance = distance * body.thickness
    run.state.step = round(PATIENCE_TICKS * body.crossing)  # as if it had grown for so long
    assert not run.settle()
    assert run.state.record["at_rest"] is False
    assert 0 <= run.state.relaxed - longest * body.crossing < STEPS_PER_MEASUREMENT


def octant_run(*settings):
    scene = load_scene("fig6-thick", ["geometry.portion=octant", "accuracy.edge=6", "output.stages=[]", *settings])
    effects = build_effects(scene)
    return Dynamics.of(scene, build_body(scene, effects), effects)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_smooth_stages_rest_however_close_they_are_and_so_does_a_body_that_has_not_grown(precision):
    run = octant_run(f"accuracy.precision={precision}")
    for growth in (1.0, 1.05, 1.1, 1.12):
        run.grow_to(growth)
        assert run.settle()
        assert run.state.relaxed < PATIENCE_TICKS * run.body.crossing
        assert not run.state.record["leaving_saddle"]


def test_time_on_hold_is_that_asked_for_whatever_the_patience_of_stages():
    run = octant_run("output.patience=10")
    run.hold(3)
    assert 0 <= run.state.relaxed - 3 * run.body.crossing < STEPS_PER_MEASUREMENT


def test_after_little_growth_a_body_that_does_not_rest_goes_on_sooner():
    """At most 4/3 of the time that growth took since the last rest, and that is counted in ticks: so of any pace."""
    run = strip()
    full = run.damping
    run.grow_to(1.1)
    assert run.settle()
    assert run.state.relaxed >= REST_TICKS * run.body.crossing
    assert run.balance.distance < REST_DISTANCE_OVER_T * run.body.thickness
    assert run.damping == full
    run.balance.update = lambda *state: None
    run.balance.distance = 0.2 * run.body.thickness
    tick, before = run.body.crossing, run.state.step
    run.grow_to(1.2)
    ticks = run.state.step - before
    assert LEAST_PATIENCE_TICKS < PATIENCE_PER_GROWTH_TICK * ticks / tick < PATIENCE_TICKS
    assert not run.settle()
    assert 0 <= run.state.relaxed - PATIENCE_PER_GROWTH_TICK * ticks < STEPS_PER_MEASUREMENT
    run.grow_to(1.201)
    assert not run.settle()
    assert 0 <= run.state.relaxed - LEAST_PATIENCE_TICKS * tick < STEPS_PER_MEASUREMENT
