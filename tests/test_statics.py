"""Equilibrium, stability and bifurcation of bodies of bricks and tetrahedra, against what is known of them."""

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from made_bodies import of_tets
from scipy.linalg import eigh
from scipy.optimize import brentq
from test_tangent import make_body

from morphofold.errors import DoesNotApply, NoSolution, OutOfRange
from morphofold.sim import theory
from morphofold.sim.body import Body
from morphofold.sim.equilibrium import statics
from morphofold.sim.equilibrium.tangent import Tangent, cauchy_stress
from morphofold.sim.mesh import brick_mesh as shapes
from morphofold.sim.mesh.brick_mesh import bilayer_ellipsoid, bilayer_patch, bilayer_sphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.accuracy.radial_finite_elements import radial_equilibrium


def all_forces(body, x):
    forces = body.forces(x)
    forces[: body.n_surface] += body.filter.forces(x)
    return np.where(body.free, forces, 0.0)


def made_body(bilayer, law="isotropic", mu_ratio=1.0, **options):
    return Body(bilayer, mu_cortex=mu_ratio, mu_core=1.0, kappa_ratio=50.0, law=law, **options)


def patch(law="isotropic", mu_ratio=2.0, size=(3.0, 2.0), kind="bricks"):
    bilayer = bilayer_patch(size, 6.0, 1.0, 0.5)
    bilayer = of_tets(bilayer) if kind == "tets" else bilayer
    return made_body(bilayer, law, mu_ratio)


@lru_cache
def flat(law, mu_ratio, kappa_ratio=50.0):
    """Critical growth and wavelength over thickness of the sphere whose radius tends to infinity."""
    near, nearer = (theory.bifurcation(T, mu_ratio, law, kappa_ratio) for T in (2e-4, 1e-4))
    return 2 * nearer.g_crit - near.g_crit, nearer.wavelength / 1e-4


def wave_strip(monkeypatch, law, mu_ratio, k):
    """Half a wave of a strip, 1 thick on a deep core; all steps fall by k, those of the core by and by too."""
    monkeypatch.setattr(shapes, "CORE_LAYER_RATIO", 1.4 ** (1 / k))
    wavelength = flat(law, mu_ratio)[1]
    bilayer = bilayer_patch((wavelength / 2, 0.0), 1.5 * wavelength, 1.0, wavelength / 16 / k, 3 * k)
    return made_body(bilayer, law, mu_ratio)


# equilibrium


@pytest.mark.parametrize(("kind", "law"), [("bricks", "isotropic"), ("tets", "tangential")])
def test_a_flat_cortex_swells_upwards_as_the_closed_form_says(kind, law):
    """Held at its sides it stretches by 1/g elastically; its thickness is the one that no normal stress is left."""
    g, body = 1.2, patch(law, size=(1.0, 1.0), kind=kind)

    def normal_stress(up):
        J = up / g**2
        return J ** (-5 / 3) * (2 / 3) * (up**2 - 1 / g**2) + 50 * (J - 1)

    up = brentq(normal_stress, 1.0, 3.0, xtol=1e-14)
    x = statics.equilibrium(body, g)
    height = (x - body.X)[: body.n_surface, 2]
    np.testing.assert_allclose(height, up * (g if law == "isotropic" else 1.0) - 1, atol=1e-9)
    assert body.growth == g


def test_forces_of_a_folded_body_at_rest_are_round_off(rng):
    """A body that is not even, so that its path is not a straight line."""
    body = made_body(bilayer_ellipsoid((9, 7, 6), 1.2, 0.5, "octant", 6), "tangential", 2.0)
    x = statics.equilibrium(body, 1.15)
    forces = all_forces(body, x)
    assert np.abs(forces).max() < 1e-10 * np.abs(body.elements.blocks.force).max()
    further = statics.equilibrium(body, 1.2, x)  # from there on, or from the start
    np.testing.assert_allclose(further, statics.equilibrium(body, 1.2), atol=1e-8)
    np.testing.assert_allclose(statics.equilibrium(body, 1.15, further), x, atol=1e-8)  # and back


@pytest.mark.parametrize("law", ["isotropic", "tangential"])
def test_radius_and_stress_before_onset_are_those_of_the_radial_state(law):
    """Radius to 0.05 %, stress to 1 % of the tangential one, in each layer of bricks."""
    g, n, layers = 1.15, 10, 3
    body = made_body(bilayer_sphere(50, 2, 25, "octant", n, layers), law, 2.0)
    x = statics.equilibrium(body, g)
    exact = radial_equilibrium(g, 0.04, 2.0, law, 50.0)
    radius = np.linalg.norm(x[: body.n_surface], axis=1)
    assert np.abs(radius / (50 * exact.at(1.0, "cortex").r[0]) - 1).max() < 5e-4
    assert radius.mean() == pytest.approx(50 * exact.at(1.0, "cortex").r[0], rel=1e-5)
    sigma, Q = cauchy_stress(body, x), len(body.bilayer.faces)
    middle = x[body.bilayer.mesh.t].mean(axis=0)
    normal = middle / np.linalg.norm(middle, axis=1)[:, None]
    radial = np.einsum("ei,eij,ej->e", normal, sigma, normal)
    tangential = (np.trace(sigma, axis1=1, axis2=2) - radial) / 2
    for k in range(layers):
        expected = exact.at(1 - 0.04 * np.linspace(k, k + 1, 9) / layers, "cortex")
        scale, layer = np.abs(expected.sigma_theta).max(), slice(k * Q, (k + 1) * Q)
        assert np.abs(radial[layer] - expected.sigma_r.mean()).max() < 0.01 * scale
        assert np.abs(tangential[layer] - expected.sigma_theta.mean()).max() < 0.01 * scale


def test_levels_of_a_sphere_that_stay_even_are_next_to_its_equilibrium():
    """What is imposed on the way to a bifurcation is off by the unevenness of the mesh, and that falls with it."""
    differences = []
    for n in (4, 8):
        body = make_body(n=n)
        even = statics.Equilibrium(body, body.X, statics.even_levels(body)).grown(1.1).x
        differences.append(np.sqrt(np.mean((even - statics.equilibrium(body, 1.1)) ** 2)))
    assert differences[1] < 0.4 * differences[0] < 0.01  # of 1.7 mm that the surface moves


@pytest.mark.parametrize(
    ("bilayer", "even"),
    [
        (bilayer_sphere(10, 1, 5, "octant", 4), True),
        (bilayer_patch((3.0, 2.0), 4.0, 1.0, 1.0), True),
        (bilayer_ellipsoid((10, 10, 9), 1, 0.5, "octant", 4), False),
        (bilayer_sphere(10, 1 + 0.01 * np.arange(19), 5, "octant", 4), False),
    ],
)
def test_levels_are_even_on_spheres_and_patches_of_even_thickness(bilayer, even):
    body = made_body(bilayer)
    levels = statics.even_levels(body)
    assert (levels is not None) == even
    if even:
        assert levels.shape[1] * body.n_surface == len(body.X)
    body.pattern = np.linspace(0, 1, body.elements.n_cortex)  # regional growth
    assert statics.even_levels(body) is None


def test_a_path_that_ends_carries_its_last_state(monkeypatch):
    body = patch()
    x = statics.equilibrium(body, 1.1)
    monkeypatch.setattr(statics, "MOST_NEWTON_ITERATIONS", 0)
    with pytest.raises(statics.ConvergenceError, match=r"\bg = 1\.1:") as caught:
        statics.equilibrium(body, 1.2, x)
    assert caught.value.growth == body.growth == 1.1
    np.testing.assert_array_equal(caught.value.x, x)


# stability


@pytest.mark.parametrize(("g", "length", "stable"), [(1.1, 4.0, True), (1.5, 4.0, False), (1.6, 12.0, False)])
def test_eigenvalue_mode_and_count_are_those_of_dense_algebra(g, length, stable):
    """Far beyond the onset there are many negative eigenvalues, and those next to zero are not the lowest."""
    body = patch(mu_ratio=1.0, size=(length, 0.5))
    x = statics.Equilibrium(body, body.X, statics.even_levels(body)).grown(g).x
    stability = statics.stability(body, x)
    rows = np.flatnonzero(body.free)
    K = Tangent(body).at(x).toarray()[np.ix_(rows, rows)]
    volume = np.repeat(body.nodal_volumes(), 3)[rows]
    values = eigh(K, np.diag(volume), eigvals_only=True)
    assert stability.negative == np.sum(values < 0)
    assert stable == (stability.negative == 0)
    assert stability.eigenvalue == pytest.approx(values[0], rel=1e-6)
    mode = stability.mode.ravel()[rows]
    assert np.linalg.norm(K @ mode - values[0] * volume * mode) < 1e-4 * np.linalg.norm(values[0] * volume * mode)
    assert np.linalg.norm(stability.mode, axis=1).max() == pytest.approx(1.0)
    assert not stability.mode[~body.free].any()


# bifurcation


@pytest.mark.slow
def test_a_strip_wrinkles_as_the_large_sphere_does_at_second_order(monkeypatch):
    """One brick deep, it has the sphere's smooth state and the rolls that the flat limit starts with.

    Other laws and ratios: tests/scenes/test_bifurcation.py, and spheres.
    """
    law, mu_ratio = "isotropic", 1.0
    g_crit, wavelength = flat(law, mu_ratio)
    bifurcations = []
    for k in (1, 2):
        body = wave_strip(monkeypatch, law, mu_ratio, k)
        bifurcations.append(statics.bifurcation_of_body(body, g_min=g_crit - 0.01))
    error = [f.g_crit / g_crit - 1 for f in bifurcations]
    assert 0 < error[1] < 2e-3
    assert np.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.15)
    assert bifurcations[1].wavelength == pytest.approx(wavelength, rel=5e-3)
    assert np.isnan(bifurcations[1].degree)


@pytest.mark.slow
def test_critical_growth_lies_between_a_stable_and_an_unstable_state(monkeypatch):
    body = wave_strip(monkeypatch, "isotropic", 1.0, 1)
    first = statics.bifurcation_of_body(body)
    g, eigenvalue = first.history.T
    low, high = g[eigenvalue > 0].max(), g[eigenvalue < 0].min()
    assert low < first.g_crit < high <= low + 1e-5
    body.grow(low)
    assert statics.stability(body, first.x).negative == 0
    up = first.mode[: body.n_surface, 2]  # a cosine from end to end
    expected = np.cos(2 * np.pi * body.X[: body.n_surface, 0] / flat("isotropic", 1.0)[1])
    assert abs(up @ expected) / np.linalg.norm(up) / np.linalg.norm(expected) > 0.999


def test_a_body_that_stays_stable_has_no_critical_growth():
    seen = []
    first = statics.bifurcation_of_body(patch(size=(1.0, 1.0)), g_max=1.1, look=lambda *state: seen.append(state))
    np.testing.assert_array_equal(seen, first.history)
    assert np.isnan(first.g_crit)
    assert not first.rounded
    assert (first.history[:, 1] > 0).all()
    assert first.history[-1, 0] == 1.1


@pytest.mark.slow
@pytest.mark.parametrize("cells", [8, 12])
def test_an_ellipsoid_that_bends_into_folds_is_said_to(cells):
    """All modes of an octant have the symmetry of its smooth state: they grow about where a sphere loses its own.

    On the coarser mesh a step beyond finds another path, which is unstable.
    """
    body = made_body(bilayer_ellipsoid((15, 13, 12), 2, 0.5, "octant", cells), mu_ratio=2.0)
    first = statics.bifurcation_of_body(body, g_min=1.1)
    assert first.rounded
    assert (first.history[first.history[:, 0] < first.g_crit, 1] > 0).all()
    assert first.g_crit == pytest.approx(theory.bifurcation(2 / 13, 2.0, kappa_ratio=50.0).g_crit, rel=0.1)


def test_growth_out_of_order_is_refused():
    for wrong in ({"g_max": 1.0}, {"g_min": 0.9}, {"g_min": 1.2, "g_max": 1.1}, {"step": 0.0}):
        with pytest.raises(OutOfRange, match=".* ".join(re.escape(str(value)) for value in wrong.values())):
            statics.bifurcation_of_body(patch(size=(1.0, 1.0)), **wrong)


def test_a_body_unstable_from_the_start_or_that_nothing_holds_is_refused():
    with pytest.raises(NoSolution, match=r"\bg_min = 1\.6\b"):
        statics.bifurcation_of_body(patch(mu_ratio=1.0, size=(4.0, 0.5)), g_min=1.6)
    floating = replace(bilayer_patch((1.0, 1.0), 6.0, 1.0, 0.5), planes=(), held=np.empty(0, dtype=np.int64))
    body = made_body(floating)
    for ask in (lambda: statics.bifurcation_of_body(body), lambda: statics.equilibrium(body, 1.1)):
        with pytest.raises(NoSolution, match=r"\bgeometry\.held\b"):
            ask()


def test_a_body_of_single_precision_is_refused_and_a_scene_is_taken_in_double():
    body = made_body(bilayer_patch((1.0, 1.0), 6.0, 1.0, 0.5), single=True)
    with pytest.raises(DoesNotApply, match=r'accuracy\.precision = "double"'):
        statics.equilibrium(body, 1.1)
    scene = load_scene("patch", ["geometry.size=[4, 4]", "accuracy.edge=2", "accuracy.precision=single"])
    double = load_scene(scene, ["accuracy.precision=double"])
    histories = [statics.bifurcation_of_scene(each, g_max=1.1).history for each in (scene, double)]
    np.testing.assert_array_equal(*histories)


def test_a_scene_is_taken_without_its_effects():
    coarse = ("geometry.length=22.0", "accuracy.edge=1.0", "accuracy.elements_through_cortex=3")
    scene = load_scene("strip", (*coarse, "material.mu_ratio=1.0"))
    assert "perturbation" in scene.effects
    first = statics.bifurcation_of_scene(scene, g_min=1.3)
    assert first.g_crit == pytest.approx(flat(scene.growth.law, scene.material.mu_ratio)[0], rel=0.02)
    with pytest.raises(DoesNotApply, match=r"\bradial\b"):
        statics.bifurcation_of_scene(load_scene("radial"))
