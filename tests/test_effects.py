"""Each optional effect does what it says (that none runs uncalled: test_effects_alone)."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_bodies import block, body_of, sphere, standing
from skfem import Basis, ElementHex1, ElementVector, LinearForm, MeshHex

from morphofold.errors import DoesNotApply, ImpossibleBody, OutOfRange
from morphofold.intersections.intersection import self_intersections
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.bulk_viscosity import BulkViscosity
from morphofold.sim.effects.contact import NEIGHBOUR_DISTANCE_IN_EDGES, Contact
from morphofold.sim.effects.core_growth import CoreGrowth
from morphofold.sim.effects.inertia import Inertia
from morphofold.sim.effects.perturbation import SURFACE_OVER_SPACE_WAVELENGTH, Perturbation
from morphofold.sim.effects.plane_strain import PlaneStrain
from morphofold.sim.effects.ramp import RATE_BY_SHAPE, Ramp
from morphofold.sim.effects.regional_growth import RegionalGrowth
from morphofold.sim.effects.skull import PENALTY_STIFFNESS, Skull
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.elements.bricks import CORNERS_IN_KERNEL_ORDER
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.mesh.brick_mesh import bilayer_patch
from morphofold.sim.output.stage_surfaces import whole_surfaces
from morphofold.sim.rigid_shells import EllipsoidShell
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium

# --- core growth


@pytest.mark.parametrize("law", ["isotropic", pytest.param("tangential", marks=pytest.mark.slow)])
def test_a_core_that_grows_lifts_the_cortex_as_equation_10_says(law):
    g, g_core, B, C = 1.2, 1.08, 47.0, 50.0
    body = sphere(16, law=law)
    run = Dynamics(body, [CoreGrowth((g_core - 1) / (g - 1))], steps_per_unit=1500)
    run.grow_to(g)
    run.relax(600)
    radius = np.linalg.norm(run.state.x[: body.n_surface], axis=1).mean()
    grown = g ** (3 if law == "isotropic" else 2)
    exact = (25.0**3 + g_core**3 * (B**3 - 25.0**3) + grown * (C**3 - B**3)) ** (1 / 3)  # Eq. (10), incompressible
    assert radius == pytest.approx(exact, rel=5e-3)
    same = C * radial_equilibrium(g, 3 / 50, law=law, kappa_ratio=50.0, g_core=g_core).r[-1]
    assert abs(radius - same) < 0.01 * (exact - C)  # a hundredth of the displacement


# --- a map of growth


def test_each_part_of_the_cortex_takes_its_share_of_the_growth():
    body = sphere(16)
    centre = np.array([0.0, 0.0, 50.0])
    Dynamics(body, [RegionalGrowth([(centre, 40.0, 0.5)])], steps_per_unit=600)
    body.grow(1.4)
    body.elements.measure(body.X)
    stretch = body.elements.state()["volume_ratio"] ** (-1 / 3)  # undeformed: v/V = 1/g^3
    corners = body.bilayer.mesh.t[:, : body.elements.n_cortex]
    away = np.linalg.norm(body.bilayer.foot[corners].mean(axis=0) - centre, axis=1) / 40.0
    want = 1 + 0.4 * np.where(away < 1, 1 - 0.25 * (1 + np.cos(np.pi * away)), 1.0)
    np.testing.assert_allclose(stretch[: len(want)], want, rtol=1e-12)
    np.testing.assert_allclose(stretch[len(want) :], 1.0, rtol=1e-12)  # the core doesn't grow
    assert want.min() < 1.21
    assert (want == 1.4).any()


def test_a_region_that_covers_everything_is_the_same_as_less_growth(rng):
    whole, part = sphere(law="tangential"), sphere(law="tangential")
    RegionalGrowth([([0.0, 0.0, 50.0], 1e12, 0.5)]).prepare(part)
    whole.grow(1.2)
    part.grow(1.4)
    x = whole.X + 0.1 * rng.standard_normal(whole.X.shape)
    np.testing.assert_allclose(part.forces(x), whole.forces(x), atol=1e-11 * np.abs(whole.forces(x)).max())


def test_regions_multiply_where_they_overlap():
    body = sphere()
    RegionalGrowth([([0.0, 0.0, 50.0], 1e12, 0.5), ([0.0, 0.0, 50.0], 1e12, 3.0)]).prepare(body)
    np.testing.assert_allclose(body.pattern, 1.5)


def test_a_spot_of_a_scene_takes_its_factor_of_the_growth():
    everywhere = "{centre = [50.0, 0.0, 0.0], radius = 1e4, factor = 0.25}"
    scene = load_scene("regional", [f"effects.regional_growth.spots=[{everywhere}]"])
    (effect,) = (effect for effect in build_effects(scene) if effect.name == "regional_growth")
    body = sphere(4)
    effect.prepare(body)
    np.testing.assert_allclose(body.pattern, 0.25, rtol=1e-3)


# --- the imperfection


def test_the_waves_of_the_imperfection_have_its_wavelength_and_its_rms(rng):
    """Over all of space a sum of waves of number k has a slope of k times its rms."""
    field = Perturbation(0.3, 12.0, seed=4).field
    points, step = rng.uniform(-1e4, 1e4, (5_000, 3)), 1e-4
    height, steps = field(points), step * np.eye(3)
    slope = [(field(points + step_along) - field(points - step_along)) / (2 * step) for step_along in steps]
    assert height.std() == pytest.approx(0.3, rel=0.05)
    spread = (1 + 0.3**2 / 3) ** 0.5  # wave numbers lie evenly within 30 %
    rms = np.mean(np.square(slope).sum(axis=0)) ** 0.5
    assert rms / height.std() == pytest.approx(spread * 2 * np.pi / 12.0, rel=0.05)


@pytest.mark.parametrize("wavelength", [10.0, None])
def test_a_scene_gives_its_imperfection_a_wavelength_or_that_of_the_first_wrinkles(wavelength, rng):
    settings = ["geometry.cortex_thickness=3", "effects.perturbation.amplitude=0.05", "effects.perturbation.seed=7"]
    settings += [] if wavelength is None else [f"effects.perturbation.wavelength={wavelength}"]
    scene = load_scene("demo", settings)
    (effect,) = (effect for effect in build_effects(scene) if effect.name == "perturbation")
    means = wavelength or first_wrinkles(scene).wavelength_over_T * 3.0 / SURFACE_OVER_SPACE_WAVELENGTH
    at = rng.uniform(-50, 50, (10, 3))
    np.testing.assert_allclose(effect.field(at), Perturbation(0.05 * 3.0, means, 7).field(at))


# --- ramps


def growths(shape, points=(), final=1.8, steps_per_unit=2000):
    """Growth at each measurement of a run with a ramp (none: linear), the first at g = 1."""
    run = Dynamics(sphere(4), [] if shape is None else [Ramp(shape, final, points)], steps_per_unit=steps_per_unit)

    def alone(steps, growth):  # no mechanics
        run.state.step, run.state.growth = run.state.step + steps, growth

    run._run = alone
    run.waits_for_balance = False  # nor a soft start
    seen = [1.0]
    run.grow_to(final, lambda state: seen.append(state.growth))
    return np.array(seen)


#: share of the growth at a share t of the time, from the rates
COURSES = {
    "exponential": lambda t: (1.8**t - 1) / 0.8,
    "smooth": lambda t: 0.5 * (1 - np.cos(np.pi * t)),
    "slowing": lambda t: 1.1 * (1 - (0.1 / 1.1) ** t),
}


@pytest.mark.parametrize("shape", RATE_BY_SHAPE)
def test_a_ramp_follows_its_course_in_the_time_of_the_linear_one(shape):
    linear, ramp = growths(None), growths(shape)
    assert len(linear) - 1 == round(1600 / STEPS_PER_MEASUREMENT)
    assert len(ramp) == pytest.approx(len(linear), abs=0.05 * len(linear))
    assert np.all(np.diff(ramp) > 0)
    assert ramp[-1] == 1.8
    t = np.arange(len(ramp)) / (len(ramp) - 1)
    np.testing.assert_allclose((ramp - 1) / 0.8, COURSES[shape](t), atol=0.03)


def test_a_table_of_growth_is_followed_in_its_own_time():
    points = ((0, 1), (30, 1.2), (40, 1.5), (80, 1.8))
    ramp = growths("table", points)
    t, courses = np.arange(len(ramp)) / (len(ramp) - 1), np.transpose(points)
    np.testing.assert_allclose(ramp, np.interp(80 * t, *courses), atol=0.02)


@pytest.mark.parametrize("points", [[], [[0, 1]], [[0, 1], [1, 1.5]], [[0, 1], [0, 1.8]], [[0, 1], [1, 2], [2, 1.8]]])
def test_a_table_of_growth_rises_from_1_to_the_end(points):
    with pytest.raises(OutOfRange, match=r"effects\.ramp"):
        load_scene("demo", ["growth.final=1.8", f'effects.ramp={{shape = "table", points = {points}}}'])


def test_a_ramp_ends_at_its_stages_too():
    run = Dynamics(sphere(4), [Ramp("smooth", 1.3)], steps_per_unit=200)
    for g in (1.1, 1.3):
        run.grow_to(g)
        assert run.state.growth == g


# --- skull


def pushed(axes, x, v=None, mass=1.0, g=1.0):
    """Forces (S, 3) of an ellipsoidal skull on nodes, how many it presses, and its energy."""
    shell, extra = Skull(EllipsoidShell(axes)), np.zeros_like(x)
    body = SimpleNamespace(mass=np.broadcast_to(mass, len(x)), growth=g)
    shell.add_forces(body, x, np.zeros_like(x) if v is None else v, extra)
    return extra, shell.record()["pressed"], shell.energy()


def test_a_skull_pushes_back_what_is_outside_along_its_normal(rng):
    axes = np.array([60.0, 45.0, 40.0])
    direction = rng.standard_normal((200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    x = np.where(np.arange(200)[:, None] % 2, 1.01, 0.99) * direction * axes
    mass = rng.uniform(1, 2, 200)
    extra, count, energy = pushed(axes, x, mass=mass)
    assert count == 100
    assert not extra[::2].any()
    normal = (x / axes**2) / np.linalg.norm(x / axes**2, axis=1, keepdims=True)
    push = np.einsum("ij,ij->i", extra, normal)
    assert (push[1::2] < 0).all()
    np.testing.assert_allclose(extra, push[:, None] * normal, atol=1e-12)  # no friction
    depth = -push / mass / PENALTY_STIFFNESS
    assert energy == pytest.approx(0.5 * PENALTY_STIFFNESS * np.sum(mass * depth**2))
    np.testing.assert_allclose(np.abs(((x - depth[:, None] * normal) / axes)[1::2] ** 2).sum(axis=1), 1, atol=3e-4)


def test_a_skull_damps_what_moves_out_and_never_attracts():
    x = np.array([[51.0, 0.0, 0.0]])
    pushes = [pushed(np.full(3, 50.0), x, np.array([[v, 0.3, 0.0]]))[0][0, 0] for v in (0.0, 0.1, -10.0)]
    assert pushes[1] < pushes[0] < 0
    assert pushes[2] == 0


@pytest.mark.parametrize(("law", "power"), [("isotropic", 3), ("tangential", 2)])
def test_a_skull_without_room_for_the_grown_body_is_refused(law, power):
    body, shell = sphere(20, law=law), EllipsoidShell(np.full(3, 50.0))
    body.core_share = 0.1
    room = (25**3 + 1.06**3 * (47**3 - 25**3) + 1.6**power * (50**3 - 47**3)) ** (1 / 3) - 50  # Eq. (10)
    Skull(shell, lambda g: 1.02 * room, 1.6).prepare(body)
    with pytest.raises(ImpossibleBody, match=r"\bg = 1\.6\b") as refusal:
        Skull(shell, lambda g: 0.95 * room, 1.6).prepare(body)
    assert float(str(refusal.value).split(" mm, or")[0].split()[-1]) == pytest.approx(room, rel=0.02)


# --- inertia

P_WAVE = 50 + 4 / 3  # modulus of uniaxial strain, mu = rho = 1


def tall_block():
    return block(depth=24.0, thickness=1.5)


def breathing(density=1.0, damping=0.0, periods=1.05, extra=()):
    """Height (S,) of a block that swings up and down in its slowest mode, and the time, at each measurement."""
    body = tall_block()
    run = Dynamics(body, [Inertia(density, 500.0, damping), *extra], steps_per_unit=100)
    rise = np.sin(0.5 * np.pi * (body.X[:, 2] + 24) / 24)
    run.state.x[:, 2] += 0.02 * rise
    run._measure()
    time, height = [0.0], [0.02]
    while time[-1] < periods * 4 * 24 * (density / P_WAVE) ** 0.5:
        run.relax(run.state.relaxed + STEPS_PER_MEASUREMENT)
        time.append(run.state.record["effects"]["inertia"]["time"])
        height.append(np.mean(run.state.x[: body.n_surface, 2]))
    return np.array(time), np.array(height)


def test_a_block_breathes_with_the_period_of_pressure_waves():
    time, height = breathing()
    period = 4 * 24 / P_WAVE**0.5
    np.testing.assert_allclose(height, 0.02 * np.cos(2 * np.pi * time / period), atol=0.02 * 0.05)
    crossings = np.flatnonzero(np.diff(np.sign(height)))
    at = [time[k] - height[k] * (time[k + 1] - time[k]) / (height[k + 1] - height[k]) for k in crossings]
    assert at == pytest.approx([period / 4, 3 * period / 4], rel=0.01)


def test_damping_takes_its_share_of_the_velocity():
    """Time is counted in the crossings of a shear wave: where all is heavier, both it and damping are slower."""
    density = 4.0
    time, height = breathing(density, damping=0.1)
    rate = 0.05 / density**0.5
    w = (P_WAVE / density * (0.5 * np.pi / 24) ** 2 - rate**2) ** 0.5
    want = np.exp(-rate * time) * (np.cos(w * time) + rate / w * np.sin(w * time))
    np.testing.assert_allclose(height / 0.02, want, atol=0.05)
    assert np.exp(-rate * time[-1]) < 0.6


def test_velocities_stay_when_the_step_changes():
    body = sphere(4)
    run = Dynamics(body, [Inertia(1.0, 30.0, 0.05)], steps_per_unit=1.0)
    (inertia,) = run.effects
    run.state.v[:] = 0.1
    dt = inertia.record()["time_step"]
    body.mass[:] = 4 * body.mass.max()  # as if the elements had become stiffer
    inertia.refresh(run)
    np.testing.assert_allclose(run.state.v / inertia.record()["time_step"], 0.1 / dt)
    assert inertia.record()["time_step"] < dt
    assert run.rate == pytest.approx(inertia.record()["time_step"] / 30.0)


def test_growth_keeps_the_time_that_its_duration_gives():
    body = sphere(4)
    run = Dynamics(body, [Inertia(2.0, 30.0, 0.05)], steps_per_unit=1.0)
    run.grow_to(1.1)
    seen = run.state.record["effects"]["inertia"]
    assert seen["time"] == pytest.approx(0.1 * 30.0 * 2.0**0.5, rel=0.15)  # whole tens of steps
    np.testing.assert_allclose(body.mass.sum(), 2.0 * body.elements.volume.sum() / seen["time_step"] ** 2)


def test_a_run_with_inertia_goes_on_from_a_checkpoint_bitwise():
    def start():
        return Dynamics(
            sphere(6), [Inertia(1.0, 60.0, 0.05), BulkViscosity(0.06, 1.2), Ramp("smooth", 1.3)], steps_per_unit=1.0
        )

    whole, again, saved = start(), start(), []
    whole.grow_to(1.3, lambda state: saved.append(whole.save()))
    assert len(saved) > 10
    again.load(saved[len(saved) // 2])
    again.grow_to(1.3)
    assert np.array_equal(again.state.x, whole.state.x)
    assert again.state.record == whole.state.record


# --- bulk viscosity


def viscous_forces(body, x, v, linear=0.06, quadratic=1.2):
    """Nodal forces (N, 3) of the effect alone."""
    effect = BulkViscosity(linear, quadratic)
    effect.prepare(body)
    effect.refresh(standing(body, x))
    body.elements.blocks.force[:] = 0.0
    effect.add_element_forces(body, x, v)
    return body.elements.blocks.nodal_forces()


def moving(rng, size):
    body = sphere(4, mu_cortex=2.0)
    body.grow(1.3)
    body.update_state(body.X)
    return body, body.X + 0.1 * rng.standard_normal(body.X.shape), size * rng.standard_normal(body.X.shape)


def test_viscous_forces_are_those_of_scikit_fem(rng):
    linear, quadratic = 0.06, 1.2
    body, x, v = moving(rng, 0.02)
    mesh = body.bilayer.mesh
    now, before = (
        Basis(MeshHex(np.ascontiguousarray(at.T), mesh.t), ElementVector(ElementHex1()), intorder=3)
        for at in (x, x - v)
    )
    volume, last = now.dx.sum(axis=1), before.dx.sum(axis=1)
    rate = 1 - last / volume
    rho = (body.mass / body.nodal_volumes())[mesh.t].mean(axis=0)
    c = np.sqrt((body.kappa + 2 * body.mu + 4 / 3 * body.mu) / rho)  # bulk modulus kappa + 2 mu, see Bricks
    corner = x[mesh.t.T][:, CORNERS_IN_KERNEL_ORDER].reshape(-1, 2, 2, 2, 3)  # along i, j, k
    i, j, k = (
        np.take(corner, 1, axis).mean(axis=(1, 2)) - np.take(corner, 0, axis).mean(axis=(1, 2)) for axis in (1, 2, 3)
    )
    L = volume / np.max([np.linalg.norm(np.cross(a, b), axis=1) for a, b in ((i, j), (j, k), (k, i))], axis=0)
    p = linear * rho * c * L * rate - np.where(rate < 0, rho * (quadratic * L * rate) ** 2, 0.0)
    form = LinearForm(lambda w, fields: fields["p"] * (w.grad[0, 0] + w.grad[1, 1] + w.grad[2, 2]))
    expected = -form.assemble(now, p=np.repeat(p[:, None], now.dx.shape[1], axis=1))[now.nodal_dofs].T
    force = viscous_forces(body, x, v, linear, quadratic)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(force, expected, atol=1e-10 * np.abs(expected).max())


def test_viscous_forces_never_do_work_on_the_body(rng):
    body, x, v = moving(rng, 1e-4)
    force = viscous_forces(body, x, v)
    assert np.sum(force * v) < 0
    mesh, part = body.bilayer.mesh, np.zeros(body.elements.n)
    for k in range(0, body.elements.n, 7):  # each brick by itself
        alone = np.zeros_like(v)
        alone[mesh.t[:, k]] = v[mesh.t[:, k]]
        part[k] = np.sum(viscous_forces(body, x, alone) * alone)
    assert part.max() <= 0


def test_viscosity_feels_neither_rest_nor_rigid_nor_isochoric_motion(rng):
    body, x, _ = moving(rng, 0.0)
    angle = 0.02
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    shear = np.array([[1, 0.03, 0], [0, 1, 0.02], [0, 0, 1.0]])
    swelling = np.abs(viscous_forces(body, x, x - x * 0.98)).max()
    at_rest = np.abs(viscous_forces(body, x, np.zeros_like(x))).max()
    assert at_rest < 1e-12 * swelling  # round-off of two volumes, which differs between processors
    for motion in (x @ turn.T + [0.1, 0.2, 0.3], x @ shear.T):
        assert np.abs(viscous_forces(body, x, x - motion)).max() < 1e-9 * swelling


def test_viscosity_damps_a_breathing_block_as_its_linear_part_says():
    """Of a mode of frequency w, a viscosity b1 rho c L takes w^2 b1 L / (2 c) of the amplitude per time."""
    plain, viscous = (breathing(extra=extra) for extra in ((), (BulkViscosity(0.6, 0.0),)))
    body = tall_block()
    height = np.ptp(body.X[body.bilayer.mesh.t.T][:, :, 2], axis=1)
    L = np.minimum(height, 1.0)  # bricks are 1 mm wide
    middle = body.X[body.bilayer.mesh.t.T].mean(axis=1)[:, 2]
    strain = np.cos(0.5 * np.pi * (middle + 24) / 24) ** 2 * body.elements.volume
    c = P_WAVE**0.5
    decay = 0.5 * 0.6 * (0.5 * np.pi / 24) ** 2 * c * np.average(L, weights=strain)
    time, damped = viscous  # its steps are shorter: a lagging dashpot
    without = np.interp(time, *plain)
    last = (time > 0.92 * time[-1]) & (time <= plain[0][-1])
    assert last.sum() >= 3
    assert damped[last] / without[last] == pytest.approx(np.exp(-decay * time[last]), abs=0.025)
    assert np.exp(-decay * time[-1]) < 0.95


def test_as_much_viscosity_as_a_scene_can_have_leaves_a_body_at_rest_where_it_is():
    run = Dynamics(block(), [BulkViscosity(0.5, 2.0)], steps_per_unit=1.0)
    run.state.x += np.where(run.body.free, 1e-6 * np.random.default_rng(0).standard_normal(run.body.X.shape), 0.0)
    run._measure()
    before = run.state.record["strain_energy"]
    run.relax(600)
    assert run.state.record["strain_energy"] + run.state.record["kinetic_energy"] < 0.05 * before
    with pytest.raises(OutOfRange, match=r"\bbulk_viscosity\.linear: .*\b0\.51\b"):
        load_scene("dynamic", ["effects.bulk_viscosity.linear=0.51"])


def test_viscosity_is_refused_for_tetrahedra():
    body = SimpleNamespace(elements=object())
    with pytest.raises(DoesNotApply, match=r"\beffects\.bulk_viscosity\b"):
        BulkViscosity(0.06, 1.2).prepare(body)


# --- a strip


def folding_strip(edge, *effects, mu_cortex):
    bilayer = bilayer_patch((24.0, 0.0), 10.0, 2.0, edge)
    X = Perturbation(0.1, 15.0, seed=0).reshape(bilayer, bilayer.mesh.p.T)
    body = body_of(bilayer, mu_cortex=mu_cortex, X=X)
    return body, Dynamics(body, [*effects, PlaneStrain()], steps_per_unit=2000 if edge > 0.6 else 4000)


def test_both_sides_of_a_strip_stay_the_same_to_the_bit_as_it_folds():
    body, run = folding_strip(0.8, mu_cortex=2.0)
    run.grow_to(1.35)
    X, x = body.X, run.state.x
    near, far = np.flatnonzero(X[:, 1] == 0), np.flatnonzero(X[:, 1] > 0)
    assert len(near) == len(far)
    twin = {(X[i, 0], X[i, 2]): i for i in near}
    pairs = np.array([(twin[X[j, 0], X[j, 2]], j) for j in far])
    for both in (x, run.state.v):
        assert np.array_equal(both[pairs[:, 0]][:, [0, 2]], both[pairs[:, 1]][:, [0, 2]])
    assert np.array_equal(x[:, 1], X[:, 1])  # plane strain
    assert np.ptp(x[: body.n_surface, 2]) > 2.0  # folded


def test_contact_keeps_the_walls_of_a_sulcus_from_passing_through_each_other():
    deepest = []
    for effects in ((), (Contact(), Symmetry())):
        body, run = folding_strip(0.5, *effects, mu_cortex=1.0)
        depth = []  # in mean edges
        for g in (1.4, 1.55):
            run.grow_to(g)
            depth.append(self_intersections(whole_surfaces(body, run.state.x)[1]).deepest_share)
        deepest.append(max(depth))
    assert deepest[0] > 0.1
    assert deepest[1] == 0
    assert run.state.record["effects"]["contact"]["pairs"] > 0


def test_no_node_is_in_contact_with_its_own_surroundings_and_walls_in_touch_come_to_rest():
    """Both sides of a strip lie on one line seen along it: a node's own triangle, and that of its twin, are no wall."""
    contact = Contact()
    body, run = folding_strip(0.5, contact, Symmetry(), mu_cortex=1.0)
    run.grow_to(1.5)
    run.relax(4000)
    paired = np.flatnonzero(contact._partner >= 0)
    away = body.X[contact._tri[contact._partner[paired]]] - body.X[paired, None]
    assert np.linalg.norm(away, axis=2).min() >= NEIGHBOUR_DISTANCE_IN_EDGES * body.bilayer.edge
    assert run.state.record["effects"]["contact"]["pairs"] > 0
    assert run.state.record["kinetic_over_strain"] < 5e-4  # nodes that swap triangles leave 2.6e-4
