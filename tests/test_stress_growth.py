"""Growth of the core by its stress: how stress relaxes, what it does to energy, and that runs can be repeated."""

from types import SimpleNamespace

import made_bodies
import numba
import numpy as np
import pytest
from made_bodies import sphere
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.sim.dynamics import STEPS_PER_INCREMENT, STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.stress_growth import MOST_RELAXED, StressGrowth
from morphofold.sim.equilibrium.statics import Equilibrium
from morphofold.sim.materials.elastic import stress
from morphofold.sim.materials.mooney_rivlin import MooneyRivlin
from morphofold.sim.materials.neo_hookean import NEO_HOOKEAN
from morphofold.sim.run import simulate
from morphofold.sim.scene.scene_files import load_scene
from morphofold.threads import using_threads

KAPPA = 50.0
KINDS = ("bricks", pytest.param("tetrahedra", marks=pytest.mark.slow))
STRETCH = np.array([[1.2, 0.15, 0.0], [0.0, 0.95, -0.1], [0.05, 0.0, 0.9]])  # an affine deformation, det about 1.03


def block(kind="bricks", depth=4.0, thickness=1.0, **options):
    return made_bodies.block((3.0, 3.0), depth, thickness, kind=kind, **options)


def octant(kind="bricks", **options):
    return sphere(6, kind, 5, **{"law": "tangential", **options})


def unit_tensors(body):
    return np.tile(np.eye(3), (len(body.elements.core_volumes), 1, 1))


def held(effect, body, x, growths):
    """Let the effect see a body that is held at ``x`` while the cortex reaches these growths as in a run."""
    effect.prepare(body)
    for g in growths:
        effect.refresh(SimpleNamespace(body=body, rate=1e-9, waits_for_balance=True))
        first = body.growth
        for k in range(STEPS_PER_MEASUREMENT):
            if k % STEPS_PER_INCREMENT == 0:
                body.growth = first + (k + STEPS_PER_INCREMENT) / STEPS_PER_MEASUREMENT * (g - first)
            effect.add_element_forces(body, x, np.zeros_like(x))


def mandel(F, G, material):
    """M of a homogeneous part, in units of mu."""
    A = F @ np.linalg.inv(G)
    return A.T @ stress(A, 1.0, KAPPA, material)


def grown_in_theory(F, rate, passed, volume, material=NEO_HOOKEAN):
    """G of a part that is held at F, by an integration of its ordinary differential equation."""

    def slope(_, G):
        G = G.reshape(3, 3)
        M = mandel(F, G, material)
        return (rate * (M - (0 if volume else np.trace(M) / 3 * np.eye(3))) @ G).ravel()

    return solve_ivp(slope, (0, passed), np.eye(3).ravel(), rtol=1e-11, atol=1e-13).y[:, -1].reshape(3, 3)


def energy(body, x):
    body.elements.measure(x)
    return body.elements.state()["energy"].sum()


# --- relaxation


@pytest.mark.parametrize("material", [NEO_HOOKEAN, pytest.param(MooneyRivlin(0.4), marks=pytest.mark.slow)], ids=str)
@pytest.mark.parametrize("volume", [True, False])
@pytest.mark.parametrize("kind", ["bricks", "tetrahedra"])
def test_a_stretched_core_that_is_held_relaxes_as_its_differential_equation_says(kind, volume, material):
    body, passed = block(kind, material=material), 0.02 if volume else 0.8
    x = body.X @ STRETCH.T
    want, error, steps = grown_in_theory(STRETCH, 1.0, passed, volume, material), [], np.array([16, 32, 64])
    for n in steps:
        G = unit_tensors(body)
        body.elements.grow_by_stress(body.X, body.X, G, 0.0)
        for _ in range(n):
            body.elements.grow_by_stress(x, body.X, G, passed / n, volume)
        error.append(np.abs(G - want).max())
    assert np.polyfit(np.log(passed / steps), np.log(error), 1)[0] == pytest.approx(1.0, abs=0.15)
    assert error[-1] < 0.02 * np.abs(want - np.eye(3)).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_small_stress_relaxes_exponentially_pressure_faster_than_shear(kind):
    rate, passed, small = 2.0, 0.004, 1e-5
    shear, swollen = np.array([[1, small, 0], [small, 1, 0], [0, 0, 1.0]]), (1 + small) * np.eye(3)
    for F, decay in ((shear, 2 * rate), (swollen, 3 * rate * KAPPA)):
        body, effect = block(kind), StressGrowth(rate)
        held(effect, body, body.X @ F.T, 1 + passed * np.arange(1, 101) / 100)
        left = np.abs(mandel(F, effect.G[0], NEO_HOOKEAN)).max() / np.abs(mandel(F, np.eye(3), NEO_HOOKEAN)).max()
        assert left == pytest.approx(np.exp(-decay * passed), rel=0.02)
        np.testing.assert_allclose(effect.G, np.broadcast_to(effect.G[0], effect.G.shape), atol=1e-9 * small**0.5)


def test_growth_at_one_go_is_taken_in_steps_that_keep_it_stable():
    body, effect = block(), StressGrowth(1.0)
    held(effect, body, body.X @ STRETCH.T, [1.5])  # pressure relaxes by a factor of exp(75) meanwhile
    want = grown_in_theory(STRETCH, 1.0, 0.5, True)
    np.testing.assert_allclose(effect.G[3], want, atol=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_that_is_far_too_long_still_gives_a_tensor_of_growth(kind):
    body, G = block(kind), unit_tensors(block(kind))
    x = 0.8 * body.X
    for rate in (0.1, 0.3):  # 1 + L has a negative determinant
        assert np.linalg.det(np.eye(3) + rate * mandel(0.8 * np.eye(3), np.eye(3), NEO_HOOKEAN)) < 0
        body.elements.grow_by_stress(body.X, body.X, unit_tensors(body), 0.0)
        G[:] = np.eye(3)
        body.elements.grow_by_stress(x, body.X, G, rate)
        assert np.linalg.det(G).min() > 0


def test_the_tensor_does_not_depend_on_how_the_body_is_turned(rng):
    body = octant()
    x = body.X + 0.3 * rng.standard_normal(body.X.shape)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    tensors = []
    for positions in (x, x @ turn.T):
        G = unit_tensors(body)
        body.elements.grow_by_stress(body.X, body.X, G, 0.0)
        body.elements.grow_by_stress(positions, body.X, G, 1e-3)
        tensors.append(G)
    np.testing.assert_allclose(*tensors, atol=1e-12)
    assert np.abs(tensors[0] - np.eye(3)).max() > 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_a_tensor_that_is_isotropic_makes_the_core_that_core_growth_makes(kind, rng):
    by_tensor, by_core_growth = octant(kind), octant(kind)
    x = by_tensor.X + 0.2 * rng.standard_normal(by_tensor.X.shape)
    by_tensor.grow(1.2)
    by_tensor.elements.grow_by_stress(x, by_tensor.X, 1.1 * unit_tensors(by_tensor), 0.0)
    by_core_growth.elements.grow(np.full(by_core_growth.elements.n_cortex, 1.2), 1.1)
    want = by_core_growth.forces(x)
    assert np.abs(by_tensor.forces(x) - want).max() < 1e-11 * np.abs(want).max()
    by_tensor.grow(1.3)  # the cortex grows on, the core keeps its own
    by_core_growth.elements.grow(np.full(by_core_growth.elements.n_cortex, 1.3), 1.1)
    want = by_core_growth.forces(x)
    assert np.abs(by_tensor.forces(x) - want).max() < 1e-11 * np.abs(want).max()


# --- what stays as it is


def test_a_core_without_stress_does_not_grow():
    body, effect = octant(), StressGrowth(1.0)
    held(effect, body, body.X, [1.01, 1.1])
    assert np.abs(effect.G - np.eye(3)).max() < 1e-12
    assert abs(effect.released) < 1e-12


@pytest.mark.parametrize("volume", [True, False])
def test_a_body_that_does_not_grow_moves_bitwise_as_without_the_effect(volume):
    ends = []
    for effects in ([], [StressGrowth(5.0, volume)]):
        run = Dynamics(octant(), effects, steps_per_unit=500)
        run.state.x += 0.01 * np.sin(run.state.x) * run.body.free
        run.relax(60)
        ends.append(run.state.x)
    np.testing.assert_array_equal(*ends)
    assert (effects[0].G == np.eye(3)).all()


def test_shape_alone_grows_at_constant_volume():
    body, effect = block(), StressGrowth(3.0, volume=False)
    held(effect, body, body.X @ (1.1 * STRETCH).T, np.linspace(1, 1.5, 20))
    np.testing.assert_allclose(np.linalg.det(effect.G), 1.0, atol=1e-12)
    assert effect.record()["core_volume_ratio"] == pytest.approx(1.0, abs=1e-12)
    assert effect.record()["largest_growth_strain"] > 0.1


# --- energy


@pytest.mark.parametrize("volume", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_growth_releases_the_work_of_the_stress_on_it(kind, volume):
    """In a short step: L : M less the energy of the volume that is added, per grown volume."""
    body, effect, step = block(kind), StressGrowth(1.0, volume), 1e-7
    x, core = body.X @ STRETCH.T, body.elements.core_volumes.sum()
    density = energy(body, x) / body.elements.volume.sum()
    M = mandel(STRETCH, np.eye(3), NEO_HOOKEAN)
    L = M if volume else M - np.trace(M) / 3 * np.eye(3)
    held(effect, body, x, [1 + step])
    assert effect.released == pytest.approx(step * core * (np.sum(L * M) - density * np.trace(L)), rel=1e-3)
    assert effect.record()["released_energy"] == effect.released > 0


@pytest.mark.parametrize("kind", KINDS)
def test_stored_kinetic_dissipated_and_released_energy_add_up(kind):
    """A bar whose ends are held apart relaxes; its cortex does not grow, so nothing does work on it."""
    body = block(kind, depth=6.0, thickness=2.0)
    body.pattern = 0.0
    body.free[: body.n_surface, 2] = False
    run = Dynamics(body, [StressGrowth(0.2)], steps_per_unit=20_000)
    run.state.x[: body.n_surface, 2] += 0.3
    run._measure()
    run.relax(1200)
    first, before = energy(body, run.state.x), run.state.dissipated
    run.grow_to(1.03)
    run.relax(120)
    (effect,) = run.effects
    last = energy(body, run.state.x)
    assert first - last > 0.3 * first
    assert last + effect.released + run.state.dissipated - before == pytest.approx(first, rel=0.01)
    assert run.state.dissipated - before < 0.02 * first


# --- runs


@pytest.mark.parametrize(
    "options", [{}, pytest.param({"single": True}, marks=pytest.mark.slow)], ids=["double", "single"]
)
@pytest.mark.parametrize("kind", KINDS)
def test_a_resumed_run_is_bitwise_the_same(kind, options):
    def run_of():
        return Dynamics(octant(kind, **options), [StressGrowth(0.5)], steps_per_unit=400)

    whole = run_of()
    whole.grow_to(1.03)
    arrays = whole.save()
    whole.grow_to(1.06)
    whole.relax(24)
    other = run_of()
    other.load(arrays)
    other.grow_to(1.06)
    other.relax(24)
    np.testing.assert_array_equal(other.state.x, whole.state.x)
    np.testing.assert_array_equal(other.effects[0].G, whole.effects[0].G)
    assert other.state.record == whole.state.record
    assert np.abs(whole.effects[0].G - np.eye(3)).max() > 1e-3


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
@pytest.mark.parametrize("kind", KINDS)
def test_the_growth_of_the_core_is_bitwise_the_same_on_any_number_of_threads(kind, rng):
    body, results = octant(kind), []
    x = body.X + 0.2 * rng.standard_normal(body.X.shape)
    for threads in (1, 2):
        with using_threads(threads):
            G = unit_tensors(body)
            body.elements.grow_by_stress(body.X, body.X, G, 0.0)
            body.elements.grow_by_stress(x, body.X, G, 1e-3)
            results.append((G, body.forces(x)))
    for first, second in zip(*results):
        np.testing.assert_array_equal(first, second)


def test_growth_slows_down_so_that_little_stress_relaxes_between_measurements():
    effect, seen = StressGrowth(2.0), []
    run = Dynamics(octant(), [effect], steps_per_unit=500)
    run.grow_to(1.02, lambda state: seen.append(state.growth))
    most = 3 * 2.0 * KAPPA * np.diff([1.0, *seen]).max()
    assert most <= 1.5 * MOST_RELAXED  # the last increment may be longer by half
    assert effect.pace(1.0) == pytest.approx(MOST_RELAXED / (3 * 2.0 * KAPPA * STEPS_PER_MEASUREMENT / 500))
    fast = StressGrowth(2.0, volume=False)
    Dynamics(octant(), [fast], steps_per_unit=500)
    assert fast.pace(1.0) == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_pressure_of_a_held_core_relaxes_in_a_run_at_the_pace_of_scenes_as_in_closed_form(kind):
    """ln(v) approaches ln(det F) as 1 - exp(-3 rate kappa/mu (g - 1)), for a small increase of volume."""
    rate, small = 0.2, 1e-3
    for growths in ([1.01], [1.02], [1.01, 1.04]):
        body, effect = block(kind), StressGrowth(rate)
        body.pattern, body.free[:] = np.zeros_like(body.pattern), False
        run = Dynamics(body, [effect], steps_per_unit=105 * body.crossing)
        run.state.x = (1 + small) * body.X
        for g in growths:
            run.grow_to(g)
        swelling = np.log(effect.record()["core_volume_ratio"])
        want = 3 * np.log(1 + small) * -np.expm1(-3 * rate * KAPPA * (growths[-1] - 1))
        assert swelling == pytest.approx(want, rel=0.005)


def core_in_balance(rate, growths, step):
    """Volume of the octant's core over that before, at these growths, from equilibria a ``step`` of growth apart.

    The midpoint rule in growth: the core grows by the stress of the equilibrium at half of the step. So the body is in
    balance at all times, and nothing of the dynamics is used.
    """
    body, ratios, tiny = octant(), [], 1e-7
    G, X = unit_tensors(body), body.X
    state = Equilibrium(body, X.copy())
    while state.growth < growths[-1] - step / 2:
        state = state.grown(state.growth + step / 2)
        before = G.copy()
        for fraction in (0.5, 1.0):
            start = G.copy()
            body.elements.grow_by_stress(state.x, X, G, tiny)
            M = (G @ np.linalg.inv(start) - np.eye(3)) / tiny
            G[:] = expm(fraction * rate * step * M) @ before
            body.elements.grow_by_stress(state.x, X, G, 0.0)
            state.x = state.relaxed()
        state = state.grown(state.growth + step / 2)
        if np.abs(state.growth - growths).min() < step / 4:
            ratios.append(np.average(np.linalg.det(G), weights=body.elements.core_volumes))
    return np.array(ratios)


def test_a_run_grows_the_core_as_equilibria_do_and_closer_the_slower_it_is():
    """Uniform tension of the core of a smooth sphere is driven by the cortex, and relaxes as it grows."""
    growths, rate = np.array([1.1, 1.2]), 0.2
    coarse, want = (core_in_balance(rate, growths, step) - 1 for step in (0.05, 0.025))
    np.testing.assert_allclose(coarse, want, rtol=0.01)
    off = []
    for ticks in (105, 440):  # scenes have 110
        body, effect, swelling = octant(), StressGrowth(rate), []
        run = Dynamics(body, [effect], steps_per_unit=ticks * body.crossing)
        for g in growths:
            run.grow_to(g)
            swelling.append(effect.record()["core_volume_ratio"] - 1)
        off.append(np.abs(swelling / want - 1).max())
    assert off[1] < off[0] < 0.01


# --- refusals


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        (["effects.stress_growth.rate=0"], OutOfRange, "greater than 0"),
        (["effects.stress_growth.rate=2000"], OutOfRange, "1000"),
        (["effects.stress_growth.rate=20"], OutOfRange, r"rate = 20 .*3000 times.*volume = false"),
        (["effects.stress_growth={}", "growth.final=1", "output.stages=[]"], DoesNotApply, "growth.final is 1"),
        (["effects.stress_growth={}", "effects.core_growth={}"], DoesNotApply, "core_growth"),
    ],
)
def test_options_that_make_no_sense_are_refused(settings, error, message):
    with pytest.raises(error, match=message):
        load_scene("demo", settings)


def test_a_scene_sets_rate_and_volume():
    scene = load_scene("strip", ["effects.stress_growth={rate=20, volume=false}"])
    (effect,) = (effect for effect in build_effects(scene) if effect.name == "stress_growth")
    body, same = block(), block()
    x = body.X @ STRETCH.T
    held(effect, body, x, [1.01])
    held(StressGrowth(20.0, volume=False), same, x, [1.01])
    np.testing.assert_array_equal(body.forces(x), same.forces(x))
    assert scene.beyond_theory
    assert not effect.record()["core_volume_ratio"] > 1 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("which", ["first", "second"])
def test_a_run_does_not_begin_at_the_state_of_another_one(which, tmp_path):
    tiny = ["geometry.portion=octant", "accuracy.edge=9.82", "growth.final=1.05", "output.stages=[]", "growth.rate=4"]
    with_effect = [*tiny, "effects.stress_growth={}"]
    settings = [with_effect, tiny] if which == "first" else [tiny, with_effect]
    simulate("demo", tmp_path / "first", settings=settings[0])
    with pytest.raises(DoesNotApply, match="stress_growth"):
        simulate(
            "demo", tmp_path / "second", settings=[*settings[1], "growth.final=1.1"], restart_from=tmp_path / "first"
        )
    assert not (tmp_path / "second").exists()
