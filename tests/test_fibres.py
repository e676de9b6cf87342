"""Fibres in the core: their forces, what they do to blocks with known answers, and where bundles lie."""

import numpy as np
import pytest
from made_bodies import block, body_of, sphere
from scipy.optimize import brentq

from morphofold.errors import DoesNotApply, ImpossibleBody, OutOfRange
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.fibres import LARGEST_MODULUS, Fibres
from morphofold.sim.effects.inertia import Inertia
from morphofold.sim.equilibrium.tangent import Tangent
from morphofold.sim.mesh.brick_mesh import bilayer_patch
from morphofold.sim.scene.scene_files import load_scene

KINDS = ("bricks", pytest.param("tetrahedra", marks=pytest.mark.slow))


def prepared(body, *given, **options):
    fibres = Fibres(*given, **options)
    fibres.prepare(body)
    return fibres


def forces(fibres, body, x):
    """Nodal forces (N, 3) of the fibres alone."""
    body.elements.blocks.force[:] = 0.0
    fibres.add_element_forces(body, x, np.zeros_like(x))
    return body.elements.blocks.nodal_forces()


def energy(fibres, body, x):
    forces(fibres, body, x)
    return fibres.energy()


def core_volume(body):
    return body.elements.volume[body.elements.n_cortex :].sum()


# --- known answers


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("growth", [1.0, 1.5])
def test_a_homogeneous_stretch_has_the_energy_and_the_tension_of_the_formula(kind, growth, rng):
    body, a = block(kind=kind, mu_core=2.0), np.array([1.0, 2.0, 2.0]) / 3
    fibres = prepared(body, 5.0, 0.7, direction=3 * a, share=0.4)
    body.grow(growth)
    g = 1 + 0.4 * (growth - 1)
    F = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    l, modulus = np.linalg.norm(F @ a), 5.0 * 0.7 * 2.0
    x = body.X @ F.T
    assert energy(fibres, body, x) == pytest.approx(core_volume(body) * modulus * g / 2 * (l / g - 1) ** 2, rel=1e-12)
    base = np.isclose(body.X[:, 2], -12.0)
    want = modulus * (l / g - 1) * (F @ a / l) * a[2] * 16.0  # P N over the base, whose normal is -z
    np.testing.assert_allclose(forces(fibres, body, x)[base].sum(axis=0), want, atol=1e-12)
    assert fibres.record()["largest_stretch"] == pytest.approx(l)


@pytest.mark.parametrize("kind", KINDS)
def test_growing_fibres_lift_a_block_to_the_height_of_its_closed_form(kind):
    """The core has one strain, its height times l; its elastic stress and the tension of the fibres add up to 0."""
    modulus, share, grown = 8.0, 0.5, 1.4
    body = block(kind=kind)
    run = Dynamics(body, [Fibres(modulus, 1.0, share=share)], steps_per_unit=1500)
    run.grow_to(grown)
    run.relax(6000)
    g = 1 + share * (grown - 1)
    elastic = lambda l: l ** (1 / 3) - (l * l + 2) * l ** (-5 / 3) / 3 + 50.0 * (l - 1)
    exact = brentq(lambda l: elastic(l) + modulus * (l / g - 1), 1.0, g)
    white = np.isclose(body.X[:, 2], -3.0)
    assert exact > 1.02
    np.testing.assert_allclose((run.state.x[white, 2] + 12.0) / 9.0, exact, rtol=1e-5)


def test_fibres_raise_the_frequency_of_a_block_as_their_modulus_says_and_keep_its_energy():
    """Stretch along z has the modulus 50 + 4/3 + k; the block is core but for the 3 % near its free end."""
    k, depth = 25.0, 24.0
    body = block(depth=depth, thickness=0.75, edge=0.75, size=(1.5, 1.5))
    fibres = Fibres(k, 1.0)
    run = Dynamics(body, [Inertia(1.0, 500.0, 0.0), fibres], steps_per_unit=100)
    rise = np.sin(0.5 * np.pi * (body.X[:, 2] + depth) / depth)
    run.state.x[:, 2] += 0.02 * rise
    run._measure()
    time, height, total, stored = [], [], [], []
    period = 4 * depth / (50 + 4 / 3 + k) ** 0.5
    while not time or time[-1] < 0.8 * period:
        run.relax(run.state.relaxed + 12)
        record = run.state.record
        time.append(record["effects"]["inertia"]["time"])
        height.append(np.mean(run.state.x[: body.n_surface, 2]))
        stored.append(record["effects"]["fibres"]["energy"])
        total.append(record["strain_energy"] + record["kinetic_energy"] + stored[-1])
    crossings = np.flatnonzero(np.diff(np.sign(height)))
    at = [time[k] - height[k] * (time[k + 1] - time[k]) / (height[k + 1] - height[k]) for k in crossings]
    assert at == pytest.approx([period / 4, 3 * period / 4], rel=0.01)
    assert np.ptp(stored) > 0.25 * np.mean(total)
    assert np.ptp(total) < 0.05 * np.mean(total)


@pytest.mark.parametrize("kind", KINDS)
def test_the_energy_of_a_wave_along_fibres_converges_at_second_order(kind):
    """Fibres along x, x = X + a sin(pi X / L): the mean of (l - 1)^2 is (a pi / L)^2 / 2."""
    a, L, error, edges = 0.5, 8.0, [], [2.0, 1.0, 0.5]
    for edge in edges:
        body = block(size=(L, 1.0), depth=4.0, thickness=1.0, edge=edge, kind=kind)
        x = body.X + np.outer(a * np.sin(np.pi * body.X[:, 0] / L), [1.0, 0.0, 0.0])
        mean = energy(prepared(body, 1.0, direction=[1.0, 0.0, 0.0]), body, x) / core_volume(body)
        error.append(abs(mean / (0.25 * (a * np.pi / L) ** 2) - 1))
    assert np.polyfit(np.log(edges), np.log(error), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert error[-1] < 0.005


# --- laws


def moved(rng, kind, buckle=False, law="isotropic"):
    body = sphere(4, kind, law=law)
    fibres = prepared(body, 5.0, 0.5, [([0.0, 0.0, 50.0], 30.0, 2.0)], share=0.5, buckle=buckle)
    body.grow(1.2)
    return body, fibres, body.X * 1.02 + 0.5 * rng.standard_normal(body.X.shape), rng.standard_normal(body.X.shape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("buckle", [False, True])
def test_the_forces_are_the_slope_of_the_energy(kind, buckle, rng):
    """Taylor test: what is left falls as h^2."""
    body, fibres, x, d = moved(rng, kind, buckle)
    start, slope, h = energy(fibres, body, x), -np.sum(forces(fibres, body, x) * d), 2.0 ** -np.arange(8, 13)
    rest = [abs(energy(fibres, body, x + s * d) - start - s * slope) for s in h]
    assert np.polyfit(np.log(h), np.log(rest), 1)[0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("buckle", [False, True])
def test_the_stiffness_is_the_slope_of_the_forces(kind, buckle, rng):
    body, fibres, x, d = moved(rng, kind, buckle)
    K, h = fibres.stiffness(body, x), 1e-6
    want = (forces(fibres, body, x - h * d) - forces(fibres, body, x + h * d)) / (2 * h)
    assert np.abs((K @ d.ravel()).reshape(-1, 3) - want).max() < 1e-6 * np.abs(want).max()
    assert abs(K - K.T).max() < 1e-13 * abs(K).max()


@pytest.mark.parametrize("kind", KINDS)
def test_fibres_feel_no_rotation(kind, rng):
    body, fibres, x, _ = moved(rng, kind)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    unrotated = forces(fibres, body, x)
    assert energy(fibres, body, x @ Q.T + 1.0) == pytest.approx(energy(fibres, body, x), rel=1e-12)
    np.testing.assert_allclose(
        forces(fibres, body, x @ Q.T + 1.0), unrotated @ Q.T, atol=1e-11 * np.abs(unrotated).max()
    )


@pytest.mark.parametrize("kind", KINDS)
def test_fibres_are_without_force_before_growth_to_the_bit(kind):
    body = sphere(4, kind)
    run = Dynamics(body, [Fibres(20.0, 2.0)], steps_per_unit=600)
    run.relax(24)
    assert np.array_equal(run.state.x, body.X)


def test_fibres_that_buckle_pull_but_do_not_push(rng):
    """Radial fibres of a block that is squeezed bear nothing, in one that is pulled what others bear."""
    body = block()
    both, pulling = prepared(body, 5.0), prepared(body, 5.0, buckle=True)
    low, high = (body.X * [1, 1, factor] for factor in (0.9, 1.1))
    assert np.abs(forces(both, body, low)).max() > 0.1
    assert not forces(pulling, body, low).any()
    assert pulling.energy() == 0
    assert not pulling.stiffness(body, low).count_nonzero()
    assert np.array_equal(forces(pulling, body, high), forces(both, body, high))


def fastest_wave(body, fibres):
    """Stiffness over mass of the fastest wave with coarse levels, by the power method; a step is stable below 4."""
    K = Tangent(body).at(body.X) + fibres.stiffness(body, body.X)
    v = np.random.default_rng(0).standard_normal(body.X.shape)
    for _ in range(300):
        v = np.where(body.free, v, 0.0)
        pull = np.where(body.free, (K @ v.ravel()).reshape(-1, 3), 0.0)
        faster = body.levels.accelerations(pull, body.mass) * body.free
        ratio = np.sum(pull * faster) / np.sum(v * pull)
        v = faster / np.abs(faster).max()
    return ratio


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_is_stable_with_the_stiffest_fibres(kind):
    body = sphere(8, kind)
    fibres = Fibres(100.0, 2.0)
    Dynamics(body, [fibres], steps_per_unit=600)
    assert fastest_wave(body, fibres) < 3.0
    body.added_stiffness.clear()  # the mass would not be enough
    body.update_state(body.X)
    body.update_levels()
    assert fastest_wave(body, fibres) > 4.0


def test_the_clock_of_the_cortex_does_not_change_with_fibres():
    body, plain = sphere(), sphere()
    Dynamics(body, [Fibres(50.0)], steps_per_unit=600)
    Dynamics(plain, steps_per_unit=600)
    inside = body.bilayer.share > 0
    assert body.crossing == plain.crossing
    assert np.array_equal(body.mass[inside], plain.mass[inside])
    assert body.mass[~inside].min() > plain.mass[~inside].min()


# --- runs


def test_a_growing_bundle_lifts_the_surface_above_it_and_a_shrinking_one_dents_it():
    lift = {}
    for share in (0.5, 0.0, -0.25):
        body = sphere(12)
        run = Dynamics(body, [Fibres(10.0, 0.0, [([28.9, 28.9, 28.9], 12.0, 1.0)], share=share)], steps_per_unit=600)
        run.grow_to(1.1)
        run.relax(600)
        n = body.n_surface
        radius = np.linalg.norm(run.state.x[:n], axis=1)
        away = np.linalg.norm(body.X[:n] - 50 / 3**0.5, axis=1)
        lift[share] = radius[away < 6].mean() - radius[away > 20].mean()
    assert lift[0.5] > 0.25
    assert abs(lift[0.0]) < 0.05
    assert lift[-0.25] < -0.1


# --- where they are


def test_a_bundle_has_the_density_of_its_profile_and_runs_straight_in():
    body = block(size=(20.0, 20.0), depth=6.0, edge=0.5, thickness=1.0)
    fibres = prepared(body, 1.0, 0.2, [([8.0, 10.0, 0.0], 6.0, 3.0)])
    middle = body.X[body.bilayer.mesh.t[:, fibres.elements]].mean(axis=0)
    assert middle[:, 2].max() < -1.0  # none in the cortex
    volume = body.elements.volume[fibres.elements]
    bump = np.pi * 6.0**2 * (0.5 - 2 / np.pi**2)  # integral of (1 + cos(pi s / r)) / 2 over the disc
    assert fibres.density @ volume == pytest.approx(5.0 * (0.2 * 400.0 + 3.0 * bump), rel=1e-3)
    away = np.linalg.norm(middle[:, :2] - [8.0, 10.0], axis=1)
    assert np.ptp(fibres.density[away > 6.0]) == 0
    np.testing.assert_allclose(fibres.density, 0.2 + 1.5 * (1 + np.cos(np.pi * np.minimum(away / 6.0, 1))), rtol=1e-12)


def test_bundles_of_a_sphere_are_cones_of_radial_fibres_and_add_up():
    body, at = sphere(8), [28.9, 28.9, 28.9]
    fibres = prepared(body, 1.0, 0.0, [(at, 15.0, 1.0), (at, 15.0, 2.0)])
    once = prepared(body, 1.0, 0.0, [(at, 15.0, 3.0)])
    np.testing.assert_allclose(fibres.density, once.density)
    middle = body.X[body.bilayer.mesh.t[:, fibres.elements]].mean(axis=0)
    direction = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    assert np.linalg.norm(50 * direction - at, axis=1).max() < 15.5
    assert np.linalg.norm(middle, axis=1).min() < 30  # down to the hole
    np.testing.assert_allclose(fibres.slopes @ body.X, direction, atol=0.01)  # a itself, before growth


def test_a_scene_gives_its_fibres_their_keys():
    """The built-in scene, with fibres along y everywhere."""
    scene = load_scene(
        "fibres", ["effects.fibres.bundles=[]", "effects.fibres.direction=[0, 2, 0]", "effects.fibres.density=0.5"]
    )
    (fibres,) = (effect for effect in build_effects(scene) if effect.name == "fibres")
    body = sphere()
    fibres.prepare(body)
    np.testing.assert_allclose(fibres.density, 0.5)
    np.testing.assert_allclose(fibres.slopes @ body.X, np.broadcast_to([0, 1, 0], (len(fibres.density), 3)), atol=1e-12)
    body.grow(scene.growth.final)
    forces(fibres, body, body.X)
    assert fibres.record()["growth"] == pytest.approx(scene.effects["fibres"].growth)


# --- refusals


@pytest.mark.parametrize(
    ("settings", "kind", "says"),
    [
        (["effects.fibres.bundles=[]"], DoesNotApply, r"density above 0, or bundles"),
        (["effects.fibres.direction=[0, 0, 0]"], OutOfRange, r"direction"),
        (["effects.fibres.direction=[1e-200, 0, 0]"], OutOfRange, r"direction"),
        (["growth.final=1"], DoesNotApply, r"fibres\.growth needs a cortex that grows"),
        (["effects.fibres.stiffness=0"], OutOfRange, r"stiffness"),
        (["effects.fibres.bundles=[{centre=[0,0,50]}]"], ValueError, r"radius"),
        (["effects.fibres.direction=[1, 0]"], ValueError, r"direction"),
    ],
)
def test_a_scene_with_impossible_fibres_is_refused(settings, kind, says):
    with pytest.raises(kind, match=says):
        load_scene("fibres", settings)


def test_bundles_that_reach_nothing_and_fibres_that_are_too_stiff_are_refused():
    with pytest.raises(OutOfRange, match=r"nothing lies within 5 mm of \[0, 0, -50\].* 7\d.*portion"):
        prepared(sphere(), 1.0, 0.0, [([0, 0, -50], 5.0, 1.0)])
    with pytest.raises(OutOfRange, match=rf"densest, 3, their modulus is 300 .*it may be {LARGEST_MODULUS:g}"):
        prepared(sphere(), 100.0, 3.0)


def test_thickness_directions_that_cancel_out_are_refused():
    bilayer = bilayer_patch((2.0, 2.0), 6.0, 2.0, 1.0)
    bilayer.radial[np.isclose(bilayer.mesh.p[2], -6.0)] *= -1
    with pytest.raises(ImpossibleBody, match=r"cancel out; the first is \d+\. Give effects\.fibres\.direction"):
        prepared(body_of(bilayer), 1.0)
