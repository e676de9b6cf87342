"""Unstable modes of a run: counted exactly, contact included."""

import numpy as np
import pytest
from made_bodies import sphere
from scipy.linalg import eigh
from test_contact import two_sheets

from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import REST_DISTANCE_OVER_T, Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.effects.midline import Midline
from morphofold.sim.effects.skull import HullSkull, Skull
from morphofold.sim.effects.symmetry import Symmetry
from morphofold.sim.equilibrium.statics import unstable_modes
from morphofold.sim.mesh.brick_mesh import bilayer_sphere
from morphofold.sim.rigid_shells import EllipsoidShell
from morphofold.sim.scene.scene_files import load_scene


def grown(scene, settings, g):
    scene = load_scene(scene, settings)
    effects = build_effects(scene)
    body = build_body(scene, effects)
    run = Dynamics(body, effects, steps_per_unit=scene.steps_per_unit(body.crossing))
    run.grow_to(g)
    return run


STRIP = [
    "geometry.length=12",
    "geometry.depth=8",
    "accuracy.edge=1.5",
    "accuracy.elements_through_cortex=2",
    "accuracy.precision=double",
    "effects.perturbation.amplitude=1e-9",
]


def lowest(run, count=12):
    """Lowest eigenvalues over mass [1/tick^2], from forces alone: differences of what a step adds up, dense."""
    body, h = run.body, 1e-6
    rows = np.flatnonzero(body.free)

    def forces(x):
        f, extra = body.forces(x), body.filter.forces(x)
        for effect in run.effects:
            effect.add_forces(body, x, np.zeros_like(x), extra)
        f[: body.n_surface] += extra
        return f.ravel()[rows]

    K = np.empty((len(rows), len(rows)))
    for k, row in enumerate(rows):
        kick = np.zeros(run.state.x.size)
        kick[row] = h
        ahead, behind = (forces(run.state.x + sign * kick.reshape(run.state.x.shape)) for sign in (1, -1))
        K[:, k] = (behind - ahead) / (2 * h)
    M = np.repeat(body.smooth_mass, 3)[rows]
    return eigh(0.5 * (K + K.T), np.diag(M), eigvals_only=True, subset_by_index=[0, count]) * body.crossing**2


def test_the_count_is_that_of_all_eigenvalues_of_the_differences_of_forces():
    run = grown("strip", STRIP, 1.4)  # straight still, far past wrinkling
    values = lowest(run)
    for bound in (-0.005, -0.02, 0.02):
        assert unstable_modes(run, bound) == np.count_nonzero(values < bound)
    assert unstable_modes(run) > 0


def test_a_smooth_body_before_its_first_wrinkles_has_none():
    assert unstable_modes(grown("strip", STRIP, 1.1)) == 0


def test_a_body_that_rests_on_a_saddle_leaves_it_where_its_modes_are_counted():
    """The straight strip falls into folds; with an imperfection of 1e-9 edges that takes more than a usual rest."""
    resting, leaving = (grown("strip", STRIP, 1.4) for _ in range(2))
    calm_states = []
    assert not resting.settle(lambda state: calm_states.append(resting.save()) if resting.balance.calm else None)
    resting.load(calm_states[0])  # it seems to rest, but leaves
    assert resting.balance.distance < REST_DISTANCE_OVER_T * resting.body.thickness
    assert unstable_modes(resting) > 0
    saved, counted = [], []

    def count(run):
        counted.append(run.state.step)
        return unstable_modes(run)

    leaving.settle(lambda state: saved.append(leaving.save()), lambda: count(leaving))
    assert unstable_modes(leaving) == 0
    assert leaving.state.record["strain_energy"] < 0.99 * resting.state.record["strain_energy"]
    checkpoint = next(state for state in saved if state["relaxed"] < state["earliest_rest"])
    again, (first, *later) = grown("strip", STRIP, 1.0), tuple(counted)
    again.load(checkpoint)
    counted.clear()
    again.settle(count_modes=lambda: count(again))
    assert first < checkpoint["step"]
    assert counted == later
    assert np.array_equal(again.state.x, leaving.state.x)


def pressed_by_contact():
    """Two sheets of a surface face each other within the gap."""
    contact, x, _ = two_sheets(distance=0.4)
    body = sphere(16, portion="full")
    body.update_state(body.X)
    return contact, body, x


def pressed_by_planes():
    body = Body(bilayer_sphere(50, 3, 25, "octant", 8), mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    planes = Symmetry()
    planes.prepare(body)
    return planes, body, body.X - 1.2 * body.cell * (~body.on_plane)


def pressed_by_shell():
    _, body, _ = pressed_by_planes()
    return Skull(EllipsoidShell(np.array([50.0, 50.0, 52.0]))), body, 1.03 * body.X


def pressed_by_hull():
    _, body, _ = pressed_by_planes()
    skull = HullSkull(lambda g: 1.0, 1.0)
    skull.prepare(body)
    return skull, body, 1.05 * body.X


def pressed_by_midline():
    body = Body(bilayer_sphere(50, 3, 25, "full", 8), mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")
    midline = Midline(0.5)
    midline.prepare(body)
    return midline, body, 1.05 * body.X


@pytest.mark.parametrize(
    "pressed", [pressed_by_contact, pressed_by_planes, pressed_by_shell, pressed_by_hull, pressed_by_midline]
)
def test_the_stiffness_of_what_presses_is_that_of_its_forces(pressed):
    """Along the forces themselves; that the normals turn, which is left out, is a tenth of it there."""
    effect, body, x = pressed()

    def forces(x):
        extra = np.zeros((body.n_surface, 3))
        effect.add_forces(body, x, np.zeros_like(x), extra)
        return extra

    direction, h = np.zeros_like(x), 1e-7
    now = forces(x)
    direction[: body.n_surface] = now / np.abs(now).max()
    slope = (forces(x + h * direction) - forces(x - h * direction)) / (2 * h)
    stiff = (effect.stiffness(body, x) @ direction.ravel()).reshape(x.shape)[: body.n_surface]
    assert np.linalg.norm(slope) > 0
    assert np.linalg.norm(stiff + slope) < 0.1 * np.linalg.norm(slope)


def test_the_pairs_of_a_run_taken_up_are_those_of_the_run():
    """What a checkpoint holds of contact is enough for its stiffness."""
    size = ["geometry.length=30", "geometry.depth=12", "accuracy.edge=1.0"]
    run, again = (grown("strip", [*size, "growth.final=1.7"], 1.0) for _ in range(2))
    run.grow_to(1.7)
    again.load(run.save())
    (contact,), (resumed,) = ([e for e in r.effects if e.name == "contact"] for r in (run, again))
    stiffness, resumed_stiffness = (e.stiffness(r.body, r.state.x) for e, r in ((contact, run), (resumed, again)))
    assert stiffness.nnz > 0
    assert abs(stiffness - resumed_stiffness).max() == 0
