"""The surface filter: nothing of an affine map, all of a zigzag."""

import numpy as np
import pytest
from made_bodies import beam, curvature, timoshenko
from scipy.spatial.transform import Rotation

from morphofold.sim.body import Body
from morphofold.sim.build import build_body
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.statics import equilibrium
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.speed.solver_speed import cut_bricks


def body_of(bilayer):
    return Body(bilayer, mu_cortex=2.0, mu_core=1.0, kappa_ratio=50.0, law="isotropic")


def imperfect_sphere():
    scene = load_scene("demo", ["geometry.portion=full", "accuracy.edge=12", "accuracy.precision=double"])
    return build_body(scene, build_effects(scene))


BODIES = {
    "imperfect sphere": imperfect_sphere,
    "sphere": lambda: body_of(bilayer_sphere(50, 3, 25, "full", 8)),
    "sphere of tetrahedra": lambda: body_of(cut_bricks(bilayer_sphere(50, 3, 25, "full", 8))),
    "octant": lambda: body_of(bilayer_sphere(50, 3, 25, "octant", 8)),
    "patch": lambda: body_of(bilayer_patch((8, 6), 4, 1, 1)),
    "beam": beam,
    "brain of tetrahedra": lambda: build_body(load_scene("mesh")),
}


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] * name.startswith("brain")) for name in BODIES],
    ids=lambda name: name.replace(" ", "-"),
)
def body(request):
    return BODIES[request.param]()


def shaken(body, rng):
    return body.X + 0.1 * body.cell * rng.standard_normal(body.X.shape) * body.free


def test_no_affine_map_that_the_planes_admit_wakes_the_filter(body, rng):
    A, offset = rng.standard_normal((3, 3)), rng.standard_normal(3)
    for axis in range(3):
        at = [plane.at for plane in body.bilayer.planes if plane.axis == axis]
        if at:  # what a plane holds stays there, square to it
            A[axis], A[:, axis], offset[axis] = 0.0, 0.0, 0.0
            A[axis, axis] = 1.0 if any(at) else 1.7
    zigzag = np.abs(body.filter.forces(shaken(body, rng))).max()
    assert np.abs(body.filter.forces(body.X @ A.T + offset)).max() < 1e-10 * zigzag
    assert abs(body.filter.energy(body.X @ A.T + offset)) < 1e-12 * body.filter.energy(shaken(body, rng))


def test_energy_is_that_of_the_shape_however_it_is_turned(body, rng):
    if body.bilayer.planes:
        pytest.skip("planes hold it")
    x, Q = shaken(body, rng), Rotation.random(random_state=1).as_matrix()
    assert body.filter.energy(x @ Q.T + [3.0, -2.0, 5.0]) == pytest.approx(body.filter.energy(x), rel=1e-9)


def test_forces_are_the_derivative_of_the_energy_of_a_grown_body(body, rng):
    body.grow(1.4)
    x, d = shaken(body, rng), rng.standard_normal(body.X.shape) * body.free
    scaled = 1.1 * x * body.free + x * body.on_plane
    for positions, direction in ((x, d), (x, scaled - x)):  # the second changes the size of the cells
        slope = (
            body.filter.energy(positions + 1e-3 * direction) - body.filter.energy(positions - 1e-3 * direction)
        ) / 2e-3
        assert slope == pytest.approx(-np.sum(body.filter.forces(positions) * direction[: body.n_surface]), rel=1e-8)
    body.grow(1.0)


def test_growth_scales_the_filter_as_a_cell(body, rng):
    x = shaken(body, rng)
    before = body.filter.energy(x)
    body.grow(1.5)
    assert body.filter.energy(x) == pytest.approx(1.5 * before)
    body.grow(1.0)


def test_a_zigzag_costs_what_it_did_without_the_projection(monkeypatch, rng):
    """On a regular grid the twice applied umbrella has no affine part: nothing of its strength is lost."""
    projected = body_of(bilayer_patch((12, 12), 4, 1, 1))
    monkeypatch.setattr(
        "morphofold.sim.elements.surface_filter._remove_affine_part", lambda stencils, p, cell: stencils
    )
    plain = body_of(bilayer_patch((12, 12), 4, 1, 1))
    x = shaken(projected, rng)
    assert projected.filter.energy(x) == pytest.approx(plain.filter.energy(x), rel=1e-9)


def test_images_across_the_planes_of_a_strip_one_cell_wide_are_those_of_a_wide_one(rng):
    """A surface that is the same all along y has the energy of its share of width, whatever the number of cells."""
    energy = []
    for width in (0.0, 6.0):
        body = body_of(bilayer_patch((12, width), 4, 1, 1))
        x = body.X.copy()
        x[:, 2] += 0.1 * np.where(np.round(x[:, 0]) % 2, 1.0, -1.0)
        energy.append(body.filter.energy(x) / (width or 1.0))
    assert energy[0] == pytest.approx(energy[1], rel=1e-9)


def test_a_free_beam_of_two_layers_bends_as_theory_says():
    body = beam(edge=0.5)
    assert curvature(body, equilibrium(body, 1.02)) == pytest.approx(timoshenko(1.02), rel=0.03)


@pytest.mark.slow
def test_a_body_that_grows_throughout_stays_free_of_stress():
    for body in (beam(), build_body(load_scene("mesh"))):
        body.core_share = 1.0
        body.grow(1.5)
        x = 1.5 * body.X
        stiff = np.abs(body.forces(body.X)).max()  # of one that may not follow its growth
        assert np.abs(body.forces(x)).max() < 1e-9 * stiff
        assert np.abs(body.filter.forces(x)).max() < 1e-9 * stiff
