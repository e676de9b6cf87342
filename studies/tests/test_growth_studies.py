"""First folds: their onset in the dynamics, folded states beyond it, their spacing, a core that grows by its stress."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from morphofold.errors import NoSolution, OutOfRange
from morphofold.sim import theory
from morphofold.sim.equilibrium import statics
from morphofold.sim.equilibrium.statics import Equilibrium
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import onset, post_onset, spacing, stress_growth_study
from morphofold.studies.onset import _least
from morphofold.studies.post_onset import branch
from morphofold.studies.stress_growth_study import AMPLIFICATION, START_HEIGHT, heights, layer, reached, spectra
from morphofold.threads import using_threads

# onset in the dynamics ----------------------------------------------------------------------------------------

COARSE = ("geometry.length=22.0", "accuracy.edge=1.25", "accuracy.elements_through_cortex=2")
FINE = ("geometry.length=22.0", "accuracy.edge=0.8", "accuracy.elements_through_cortex=3")


def strip(*settings):
    return load_scene("strip", ("output.stages=[]", *settings))


@pytest.mark.slow
def test_the_onset_lies_past_the_bifurcation_of_the_mesh_and_closes_in_as_growth_slows_down():
    scene = strip(*FINE)
    g_crit = statics.bifurcation_of_scene(scene, g_min=1.15).g_crit
    late = np.array([onset.onset(scene, rate=rate).g / g_crit - 1 for rate in (2.0, 1.0)])
    assert 0 < late[1] < 0.7 * late[0] < 0.004


@pytest.mark.slow
def test_the_onset_does_not_depend_on_the_noise():
    first, second = (onset.onset(strip(*FINE), seed=seed) for seed in (0, 1))
    assert first.g == pytest.approx(second.g, abs=1e-3)
    assert not np.array_equal(first.difference, second.difference)


@pytest.mark.slow
def test_the_onset_of_a_coarse_octant_is_near_its_bifurcation_and_the_theory():
    """Four edges a wave, so that the bifurcation itself is 2 % off; finer ones: tests/scenes/test_bifurcation.py."""
    scene = load_scene("demo", ("geometry.portion=octant", "accuracy.edge=6.0", "material.mu_ratio=2.0"))
    g = onset.onset(scene).g
    assert g == pytest.approx(statics.bifurcation_of_scene(scene, g_min=1.15).g_crit, rel=0.01)
    assert g == pytest.approx(theory.bifurcation(3 / 50, 2.0, "isotropic", 50.0).g_crit, rel=0.03)


@pytest.mark.slow
def test_the_difference_falls_to_the_onset_and_rises_after_it():
    scene = strip(*COARSE, "effects.inertia={}", 'effects.ramp={shape = "smooth"}')  # both are left out
    result = onset.onset(scene, rate=0.5)
    least = int(result.difference.argmin())
    assert (np.diff(result.difference[:least]) < 0).all()
    assert (np.diff(result.difference[least:]) > 0).all()
    assert abs(result.growth[least] - result.g) < 3 * np.diff(result.growth).max()
    assert result.difference[-1] > onset.MIN_RISE * result.difference[least] >= result.difference[-2]
    assert result.difference[0] < onset.KICK * scene.geometry.cortex_thickness  # it was kicked by as much
    assert np.array_equal(result.growth, onset.onset(strip(*COARSE), rate=0.5).growth)


def test_the_least_of_a_difference_is_interpolated_between_growths():
    growth = np.linspace(1.1, 1.3, 60)
    parabola = np.exp(900 * (growth - 1.2034) ** 2 - 7)
    assert _least(growth, parabola) == pytest.approx(1.2034, abs=1e-12)
    far = np.where(abs(growth - 1.2034) > 0.05, 1.0, parabola)  # what is far doesn't count
    assert _least(growth, far) == pytest.approx(1.2034, abs=1e-12)
    assert _least(growth, np.cosh(60 * (growth - 1.2034))) == pytest.approx(1.2034, abs=2e-4)
    growth = np.linspace(1.1, 1.3, 11)  # too few
    assert _least(growth, np.exp(900 * (growth - 1.203) ** 2)) == growth[5] == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("settings", "options", "kind", "message"),
    [
        (["growth.final=1.18"], {}, NoSolution, r"strip: .* g = 1\.10\d+ .* 1\.18;"),
        ([], {"start": 1.3}, NoSolution, r" g = 1\.3\d+; .* 1\.3\.$"),
        ([], {"start": 1.6}, OutOfRange, r" 1 <= start < growth\.final = 1\.6 "),
        ([], {"rate": 0.0}, OutOfRange, r" 1 <= start < growth\.final = 1\.6 "),
    ],
)
def test_a_growth_in_which_folds_cannot_begin_has_no_onset(settings, options, kind, message):
    with pytest.raises(kind, match=message):
        onset.onset(strip(*COARSE, *settings), **options)


# folded states beyond it --------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[0.5, 4.0], ids=["soft", "stiff"])
def folded(request):
    """Ratio of moduli, body, and the folded states of a strip."""
    half_wave, heights = {0.5: (3.6, (0.04,)), 4.0: (4.75, (0.04, 0.08, 0.12))}[request.param]
    body = post_onset.strip("isotropic", request.param, half_wave, 3)
    return request.param, body, branch(body, heights)


def test_folds_of_a_stiff_cortex_are_stable_and_beyond_the_critical_growth_of_a_soft_one_below(folded):
    """At balance: all forces at free nodes vanish, also at the crest whose height was imposed. Growth beyond the onset
    goes with the square of the height."""
    ratio, body, states = folded
    body.grow(states.growth[-1])
    forces = body.all_forces(states.last_x)[body.free]
    assert np.abs(forces).max() < 1e-6 * np.abs(body.elements.blocks.force).max()
    assert np.ptp(states.last_x[: body.n_surface, 2]) > states.heights[-1]  # the trough goes down, too
    assert (np.sign(states.growth - states.g_crit) == (1 if ratio > 1 else -1)).all()
    assert Equilibrium(body, states.last_x).stability().negative == (0 if ratio > 1 else 1)
    if ratio > 1:
        np.testing.assert_allclose((states.growth - states.g_crit) / states.heights**2, states.coefficient, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "half_wave", "stays"), [(0.5, 3.6, True), (4.0, 4.75, False)])
def test_folds_of_a_soft_cortex_stay_when_growth_goes_back(ratio, half_wave, stays, monkeypatch):
    """At 0.02 below the growth at which a flat strip folds, one that has been folded is still folded, or is not."""
    monkeypatch.setattr(post_onset, "PAST_ONSET", np.array([-0.02, 0.06]))
    g_crit = branch(post_onset.strip("isotropic", ratio, half_wave, 4), ()).g_crit
    with using_threads(1):
        loop = post_onset.loop("isotropic", ratio, half_wave, g_crit, 4)
    assert loop.heights_up[0] < 0.2
    assert loop.heights_up[1] > 1
    assert loop.heights_down[1] == pytest.approx(loop.heights_up[1], abs=0.01)
    assert (loop.heights_down[0] > 1) == stays
    assert loop.folds_at == 0.06
    assert np.isnan(loop.flat_at) if stays else loop.flat_at == 0.06  # NaN: still folded at the end


# spacing ------------------------------------------------------------------------------------------------------


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(spacing, "N_LAYERS", 4)
    monkeypatch.setattr(spacing, "DEPTH", 6.0)
    with using_threads(1):
        yield


def flat_energy(g, ratio):
    """Energy for each area of a flat layer under tangential growth, and its thickness.

    It is held at its sides, so one stretch l is free, along its thickness: A = diag(1/g, 1/g, l).
    """

    def energy(l):  # of the grown volume g^2
        J = l / g**2
        return g**2 * ratio * (0.5 * (J ** (-2 / 3) * (2 / g**2 + l**2) - 3) + 25.0 * (J - 1) ** 2)

    least = minimize_scalar(energy, bounds=(1.0, 5.0), method="bounded", options={"xatol": 1e-10})
    return least.fun, least.x


def test_before_folds_the_energy_is_that_of_a_flat_layer(coarse, monkeypatch):
    monkeypatch.setattr(spacing, "GROWTHS", (1.1,))
    monkeypatch.setattr(spacing, "COSINE_HEIGHT", 0.0)
    state = spacing.grow("tangential", 2.0, 3.0)[1.1]
    energy, thickness = flat_energy(1.1, 2.0)
    assert state.energy == pytest.approx(energy, rel=1e-3)
    assert state.fold_height == pytest.approx(0.0, abs=1e-6)
    assert (state.crown_T, state.fundus_T) == pytest.approx((thickness, thickness), rel=1e-4)


def test_a_fold_has_less_energy_than_the_flat_strip_and_a_thicker_crown(coarse, monkeypatch):
    monkeypatch.setattr(spacing, "GROWTHS", (1.5,))
    state = spacing.grow("tangential", 2.0, 3.0)[1.5]
    assert state.fold_height > 2
    assert state.energy < 0.9 * flat_energy(1.5, 2.0)[0]
    assert state.wall_T >= state.crown_T > 1.1 * state.fundus_T


def test_the_best_wave_is_the_bottom_of_the_parabola_unless_it_is_at_an_end():
    energies = 3 + (spacing.HALF_WAVES - 4.2) ** 2
    k, half = spacing.best_wave(energies)
    assert (spacing.HALF_WAVES[k], half) == (4.0, pytest.approx(4.2))
    assert np.isnan(spacing.best_wave(spacing.HALF_WAVES)[1])
    assert np.isnan(spacing.best_wave(np.where(spacing.HALF_WAVES == 3.5, np.nan, energies))[1])


# a core that grows by its stress ------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [1.02, 1.4])
def test_a_layer_that_is_fixed_responds_as_an_elastic_body(g):
    """Its stiffness is symmetric, and a long wave lifts it as a whole, without force."""
    force, by_noise, lift, lift_by_noise = layer(g, np.array([0.01, 1.0, 4.0]))
    np.testing.assert_allclose(force[:, 0, 1], force[:, 1, 0], rtol=1e-6)
    np.testing.assert_allclose(lift[0], [0.0, 1.0], atol=0.03)
    assert np.abs(force[0, 1, 1]) < 1e-2 * np.abs(force[1]).max()
    np.testing.assert_allclose(by_noise[0], [-0.01 * (g**4 - g**-2) * g**2, 0.0], rtol=0.03, atol=2e-3)
    assert lift_by_noise[0] == pytest.approx(g**2, rel=0.01)  # noise is stretched along the thickness


@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_an_elastic_core_loses_its_stability_where_the_theory_of_spheres_says(ratio):
    k = 2 * np.pi / np.geomspace(5, 11, 200)
    exact = theory.bifurcation(1e-3, ratio, "tangential")

    def least(g):
        return np.linalg.eigvalsh(layer(g, k)[0] + 2 * k[:, None, None] / ratio * np.eye(2))[:, 0]

    assert least(exact.g_crit * 0.998).min() > 0 > least(exact.g_crit * 1.002).min()
    assert 2 * np.pi / k[least(exact.g_crit).argmin()] == pytest.approx(exact.wavelength / 1e-3, rel=0.03)


def test_first_folds_of_a_stiff_layer_follow_the_power_laws_of_its_rate():
    folds = []
    for rate, last in ((1e4, 0.04), (1e5, 0.016)):
        growth, wavelengths = np.linspace(1 + last / 2000, 1 + last, 2000), np.geomspace(10, 100, 150)
        height = np.abs(heights(4.0, rate, 2 * np.pi / wavelengths, growth))
        reached_at = np.array([reached(growth, column, AMPLIFICATION) for column in height.T])
        folds.append((np.nanmin(reached_at) - 1, wavelengths[np.nanargmin(reached_at)]))
    growth, wavelength = np.log10(np.divide(*folds[::-1]))
    assert growth == pytest.approx(-2 / 5, abs=0.01)
    assert wavelength == pytest.approx(1 / 5, abs=0.01)


def test_half_a_wave_of_bricks_folds_as_theory_says(monkeypatch):
    monkeypatch.setattr(stress_growth_study, "DEPTH", 9.0)
    half, goal = 3.7, AMPLIFICATION * START_HEIGHT
    growth, height = spectra(1.0, 30.0, half, np.array([START_HEIGHT]), 3, half / 10, goal)
    g = np.arange(1.001, 1.25, 5e-4)
    exact, elastic = (
        reached(g, np.abs(heights(1.0, rate, np.array([np.pi / half]), g)[:, 0]), AMPLIFICATION) for rate in (30.0, 0.0)
    )
    assert reached(growth, np.abs(height[:, 0]), goal) == pytest.approx(exact, rel=0.015)
    assert np.isnan(elastic)  # an elastic core has no folds so soon
