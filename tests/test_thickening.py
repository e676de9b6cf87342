"""A cortical thickness that changes with growth: ``growth.thickness``."""

import numpy as np
import pytest
from test_stress_growth import KAPPA, KINDS, block, octant

from morphofold.errors import DoesNotApply, OutOfRange
from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.equilibrium.tangent import cauchy_stress
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles
from morphofold.sim.materials.elastic import stress
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium


def thickening(g):
    return 1 + 0.5 * (g - 1)


def only_cortex(body):
    """Nodes that belong to the cortex alone."""
    corners = body.bilayer.mesh.t
    inside = np.ones(len(body.X), dtype=bool)
    inside[corners[:, body.elements.n_cortex :]] = False
    return inside


@pytest.mark.parametrize("kind", KINDS)
def test_a_free_cortex_grows_by_g_along_the_surface_and_by_the_factor_across_it(kind):
    body = block(kind, thickness=2.0, law="tangential", thickening=thickening)
    body.grow(1.4)
    free = body.X * [1.4, 1.4, 1.2]
    body.elements.measure(free)
    np.testing.assert_allclose(body.elements.state()["energy"][: body.elements.n_cortex], 0.0, atol=1e-12)
    assert np.abs(body.forces(free)[only_cortex(body)]).max() < 1e-11
    assert np.abs(body.forces(body.X * [1.4, 1.4, 1.0])[only_cortex(body)]).max() > 0.1  # not without the factor
    assert body.grown_volumes().sum() == pytest.approx(1.4**2 * 1.2 * 9 * 2)


@pytest.mark.parametrize("kind", KINDS)
def test_a_cortex_that_is_held_has_the_stress_of_its_growth(kind):
    body = block(kind, law="tangential", thickening=lambda g: 1 / g)  # it thins
    body.grow(1.1)
    A = np.diag([1 / 1.1, 1 / 1.1, 1.1])
    want = stress(A, 1.0, KAPPA) @ A.T / np.linalg.det(A)
    sigma = cauchy_stress(body, body.X)
    cortex = body.elements.n_cortex // (1 if kind == "bricks" else 6)
    np.testing.assert_allclose(sigma[:cortex], np.broadcast_to(want, (cortex, 3, 3)), atol=1e-11)
    np.testing.assert_allclose(sigma[cortex:], 0.0, atol=1e-11)


@pytest.mark.parametrize("single", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_tangential_growth_whose_thickness_grows_by_g_is_isotropic_growth(kind, single, rng):
    thickened, isotropic = (
        octant(kind, single=single, thickening=lambda g: g),
        octant(kind, law="isotropic", single=single),
    )
    x = thickened.X + 0.2 * rng.standard_normal(thickened.X.shape)
    for body in (thickened, isotropic):
        body.grow(1.3)
    want = isotropic.forces(x)
    assert np.abs(thickened.forces(x) - want).max() < (1e-5 if single else 1e-12) * np.abs(want).max()
    assert thickened.grown_volumes().sum() == pytest.approx(isotropic.grown_volumes().sum(), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_cortex_grows_less_it_thickens_less(kind, rng):
    """With a factor of g it is isotropic growth, also where the growth g - 1 is a share of that elsewhere, or 0."""
    thickened, isotropic = octant(kind, thickening=lambda g: g), octant(kind, law="isotropic")
    x, pattern = (
        thickened.X + 0.2 * rng.standard_normal(thickened.X.shape),
        rng.uniform(0, 1, thickened.elements.n_cortex),
    )
    pattern[: len(pattern) // 4] = 0.0
    for body in (thickened, isotropic):
        body.pattern = pattern
        body.grow(1.5)
    want = isotropic.forces(x)
    assert np.abs(thickened.forces(x) - want).max() < 1e-12 * np.abs(want).max()
    np.testing.assert_allclose(thickened.grown_volumes(), isotropic.grown_volumes(), rtol=1e-12)
    unchanged = thickened.elements.volume[: len(pattern) // 4]
    np.testing.assert_allclose(thickened.grown_volumes()[: len(pattern) // 4], unchanged, rtol=1e-12)


def test_isotropic_growth_has_no_thickness_of_its_own():
    with pytest.raises(DoesNotApply):
        octant(law="isotropic", thickening=thickening)


def test_a_sphere_with_it_has_the_radius_of_isotropic_growth():
    run = Dynamics(octant(thickening=lambda g: g), steps_per_unit=1500)
    run.grow_to(1.15)
    run.relax(600)
    radius = np.linalg.norm(run.state.x[: run.body.n_surface], axis=1).mean() / 50
    want, tangential = (
        radial_equilibrium(1.15, 0.1, law=law, kappa_ratio=KAPPA).r[-1] for law in ("isotropic", "tangential")
    )
    assert radius == pytest.approx(want, abs=0.05 * (want - tangential))


SETTINGS = ["growth.law=tangential", "growth.final=2", "growth.thickness=[[1, 1], [1.5, 1.4], [2, 0.9]]"]


@pytest.mark.parametrize(("g", "factor"), [(1.0, 1.0), (1.25, 1.2), (1.5, 1.4), (1.75, 1.15), (2.0, 0.9), (3.0, 0.9)])
def test_the_factor_is_linear_between_the_points_of_a_scene(g, factor):
    scene = load_scene("strip", [*SETTINGS, "output.stages=[]"])
    assert scene.growth.thickening(g) == pytest.approx(factor)
    body = build_body(scene)
    first = body.elements.volume[: body.elements.n_cortex]
    np.testing.assert_allclose(body.grown_volumes(g), g**2 * factor * first, rtol=1e-12)


def test_what_follows_from_the_thickness_takes_it_into_account():
    settings = ["growth.law=tangential", "growth.thickness=[[1, 1], [2, 2]]"]
    assert "growth.thickness" in load_scene("demo", settings).beyond_theory
    assert load_scene("demo").beyond_theory == ""
    flat, same = (first_wrinkles(load_scene("strip", options)) for options in (settings, ["growth.law=isotropic"]))
    assert flat.wavelength_over_T == pytest.approx(same.wavelength_over_T, rel=0.02)
    assert flat.growth == pytest.approx(same.growth, rel=0.01)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        (["growth.thickness=[[1, 1], [2, 1.5]]"], DoesNotApply, "tangential"),
        (["growth.law=tangential", "growth.thickness=[[2, 1.5], [1, 1]]"], OutOfRange, "must rise"),
        (["growth.law=tangential", "growth.thickness=[[1, 1.1], [2, 1.5]]"], OutOfRange, "must be 1 before growth"),
        (["growth.law=tangential", "growth.thickness=[[1, 1], [2, 0]]"], OutOfRange, "0.25"),
    ],
)
def test_points_that_make_no_sense_are_refused(settings, error, message):
    with pytest.raises(error, match=message):
        load_scene("demo", settings)


def test_a_radial_scene_has_no_points():
    with pytest.raises(DoesNotApply, match="radial"):
        load_scene("radial", ["growth.law=tangential", "growth.thickness=[[1, 1], [2, 1.5]]"])
