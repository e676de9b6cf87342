"""Where theory expects the first wrinkles of a scene, and that growth at the default pace meets them there."""

import numpy as np
import pytest

from morphofold.sim.build import build_body
from morphofold.sim.dynamics import Dynamics
from morphofold.sim.effects import build_effects
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles, slow_growth
from morphofold.sim.scene.scene_files import load_scene
from morphofold.sim.theory import bifurcation

LENGTH, T = 100.0, 2.0


def strip(mu_ratio, seed=0):
    return load_scene(
        "strip",
        [
            f"geometry.length={LENGTH}",
            f"geometry.cortex_thickness={T}",
            "geometry.depth=40",
            f"material.mu_ratio={mu_ratio}",
            "accuracy.edge=0.67",
            "accuracy.elements_through_cortex=3",
            f"effects.perturbation.seed={seed}",
        ],
    )


def test_of_a_sphere_they_are_those_of_its_own_theory():
    scene = load_scene("fig6-thick")
    theory = bifurcation(0.06, 2.0, "isotropic", g_max=2.0)
    assert first_wrinkles(scene).growth == pytest.approx(theory.g_crit, abs=1e-6)
    assert first_wrinkles(scene).wavelength_over_T == pytest.approx(theory.wavelength / 0.06)


@pytest.mark.parametrize("mu_ratio", [10.0, 30.0, 100.0])
def test_of_a_stiff_flat_cortex_they_near_those_of_a_film(mu_ratio):
    """Allen 1969: 2 pi T (mu / 3)^1/3, at a strain of a quarter of (3 / mu)^2/3; the next term falls with it."""
    strain = 0.25 * (3 / mu_ratio) ** (2 / 3)
    wrinkles = first_wrinkles(strip(mu_ratio))
    assert wrinkles.wavelength_over_T == pytest.approx(2 * np.pi * (mu_ratio / 3) ** (1 / 3), rel=2 * strain + 0.03)


def test_a_core_that_grows_along_puts_them_off_and_a_region_that_grows_more_brings_them_on():
    plain = first_wrinkles(load_scene("fig6-thick")).growth
    along = load_scene("fig6-thick", ["effects={core_growth={final=1.2}}"])
    g = first_wrinkles(along).growth
    assert g / (1 + (g - 1) * 0.2) == pytest.approx(plain)
    spots = [{"centre": [0.0, 0.0, 50.0], "radius": 20.0, "factor": 1.5}]
    more = load_scene(
        "fig6-thick",
        [
            f"effects.regional_growth.spots={spots}".replace("'", '"')
            .replace('":', '"=')
            .replace('"centre"', "centre")
            .replace('"radius"', "radius")
            .replace('"factor"', "factor")
        ],
    )
    assert 1.5 * (first_wrinkles(more).growth - 1) == pytest.approx(plain - 1)


def test_growth_is_the_slower_there_the_stiffer_the_cortex_and_no_slower_for_a_soft_one():
    assert slow_growth(strip(30)).pace == pytest.approx(slow_growth(strip(3)).pace / 10)
    assert slow_growth(strip(0.2)) is None
    assert slow_growth(load_scene("fig5", ["effects={inertia={}}"])) is None


@pytest.mark.parametrize(
    ("mu_ratio", "seed"), [(10, 0), *(pytest.param(mu_ratio, 1, marks=pytest.mark.slow) for mu_ratio in (3, 10, 30))]
)
def test_the_first_wrinkles_of_a_strip_come_when_and_as_long_as_theory_says(mu_ratio, seed):
    """Within 0.01 of growth, and in one of the two waves next to theory's that the strip admits: halves of 100 mm."""
    scene = strip(mu_ratio, seed)
    want = first_wrinkles(scene)
    effects = build_effects(scene)
    body = build_body(scene, effects)
    run = Dynamics.of(scene, body, effects)
    line = np.flatnonzero(body.X[: body.n_surface, 1] == 0)
    along = body.X[line, 0]
    order = np.argsort(along)
    seen = []

    def record(state):
        seen.append((state.growth, float(np.std(state.x[line, 2]))))

    run.grow_to(want.growth + 0.03, record)
    growth, rms = np.array(seen).T
    assert abs(growth[np.argmax(rms > 0.1 * T)] - want.growth) < 0.01
    height = run.state.x[line, 2][order] - run.state.x[line, 2].mean()
    halves = np.arange(1, 40)
    waves = [np.trapezoid(height * np.cos(np.pi * k * along[order] / LENGTH), along[order]) for k in halves]
    wave = int(halves[np.argmax(np.abs(waves))])
    expected = 2 * LENGTH / (want.wavelength_over_T * T)
    assert abs(wave - expected) < 2
