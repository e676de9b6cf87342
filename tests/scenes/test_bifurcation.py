"""The growth at which solid spheres and strips wrinkle, from their stiffness, against the theory."""

import numpy as np
import pytest
from made_bodies import of_tets
from test_statics import flat, wave_strip

from morphofold.sim import theory
from morphofold.sim.body import Body
from morphofold.sim.equilibrium import statics
from morphofold.sim.mesh import brick_mesh as shapes
from morphofold.sim.mesh.brick_mesh import bilayer_patch, bilayer_sphere
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies.onset import onset

LAWS = ("isotropic", "tangential")


def octant(law, mu_ratio, n):
    """T = 2 on a sphere of 50, its critical growth and what theory says of it; modes of even degree alone."""
    body = Body(bilayer_sphere(50, 2, 25, "octant", n), mu_cortex=mu_ratio, mu_core=1.0, kappa_ratio=50.0, law=law)
    exact = theory.bifurcation(0.04, mu_ratio, law, kappa_ratio=50.0)
    return statics.bifurcation_of_body(body, step=0.01, g_min=exact.g_crit), exact


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu_ratio", [1.0, 2.0, 4.0])
def test_the_sphere_wrinkles_within_one_percent_of_the_theory(law, mu_ratio):
    """Edges of one thickness and three bricks through the cortex."""
    first, exact = octant(law, mu_ratio, 40)
    assert 0 < first.g_crit / exact.g_crit - 1 < 0.01
    assert first.degree == pytest.approx(exact.mode, abs=2.5)


@pytest.mark.slow
def test_the_sphere_closes_in_on_the_theory_as_its_mesh_is_refined():
    error = [first.g_crit / exact.g_crit - 1 for first, exact in (octant("isotropic", 2.0, n) for n in (16, 24, 36))]
    assert error[2] < 0.006
    assert np.log(error[0] / error[2]) / np.log(36 / 16) > 1.6


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu_ratio", [1.0, 2.0, 4.0])
def test_a_finer_and_finer_strip_wrinkles_as_the_flat_limit_does(law, mu_ratio, monkeypatch):
    g_crit, wavelength = flat(law, mu_ratio)
    first = [
        statics.bifurcation_of_body(wave_strip(monkeypatch, law, mu_ratio, k), g_min=g_crit - 0.01) for k in (1, 2, 4)
    ]
    error = np.array([f.g_crit / g_crit - 1 for f in first])
    np.testing.assert_allclose(np.log2(error[:-1] / error[1:]), 2.0, atol=0.15)
    assert 0 < error[-1] < 5e-4
    assert first[-1].wavelength == pytest.approx(wavelength, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "mu_ratio"), [("isotropic", 1.0), ("tangential", 4.0)])
def test_a_strip_of_tetrahedra_does_too(law, mu_ratio, monkeypatch):
    g_crit, wavelength = flat(law, mu_ratio)
    monkeypatch.setattr(shapes, "CORE_LAYER_RATIO", 1.4**0.5)
    bilayer = of_tets(bilayer_patch((wavelength / 2, 0.0), 1.5 * wavelength, 1.0, wavelength / 32, 6))
    body = Body(bilayer, mu_cortex=mu_ratio, mu_core=1.0, kappa_ratio=50.0, law=law)
    assert 0 < statics.bifurcation_of_body(body, g_min=g_crit - 0.01).g_crit / g_crit - 1 < 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu_ratio", [1.0, 2.0, 4.0])
def test_the_onset_in_the_dynamics_is_within_three_percent_of_the_theory(law, mu_ratio):
    """Where folding is seen to start in an octant with edges of 1.6 thicknesses, at the pace of the scene."""
    settings = ("geometry.portion=octant", "accuracy.edge=3.3", f"growth.law={law}", f"material.mu_ratio={mu_ratio}")
    first = onset(load_scene("fig5", settings), start=1.05).g
    assert 0 < first / theory.bifurcation(0.04, mu_ratio, law, kappa_ratio=50.0).g_crit - 1 < 0.03
