"""The onset of folding in the dynamics, against the bifurcation of the very same mesh."""

import numpy as np
import pytest

from morphofold.errors import NoSolution, OutOfRange
from morphofold.sim import theory
from morphofold.sim.equilibrium import statics
from morphofold.sim.scene.scene_files import load_scene
from morphofold.studies import onset
from morphofold.studies.onset import _late, _least

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
    found = [onset.onset(strip(*FINE), seed=seed) for seed in (0, 1)]
    assert found[0].g == pytest.approx(found[1].g, abs=1e-3)
    assert not np.array_equal(found[0].difference, found[1].difference)


@pytest.mark.slow
def test_the_onset_of_a_coarse_octant_is_near_its_bifurcation_and_the_theory():
    """Four edges a wave, so that the bifurcation itself is 2 % off; finer ones: tests/scenes/test_bifurcation.py."""
    scene = load_scene("demo", ("geometry.portion=octant", "accuracy.edge=6.0", "material.mu_ratio=2.0"))
    found = onset.onset(scene).g
    assert found == pytest.approx(statics.bifurcation_of_scene(scene, g_min=1.15).g_crit, rel=0.01)
    assert found == pytest.approx(theory.bifurcation(3 / 50, 2.0, "isotropic", 50.0).g_crit, rel=0.03)


@pytest.mark.slow
def test_the_difference_falls_to_the_onset_and_rises_after_it():
    scene = strip(*COARSE, "effects.inertia={}", 'effects.ramp={shape = "smooth"}')  # both are left out
    found = onset.onset(scene, rate=0.5)
    at = int(found.difference.argmin())
    assert (np.diff(found.difference[:at]) < 0).all()
    assert (np.diff(found.difference[at:]) > 0).all()
    assert abs(found.growth[at] - found.g) < 3 * np.diff(found.growth).max()
    assert found.difference[-1] > onset.RISE * found.difference[at] >= found.difference[-2]
    assert found.difference[0] < onset.KICK * scene.geometry.cortex_thickness  # it was kicked by as much
    assert np.array_equal(found.growth, onset.onset(strip(*COARSE), rate=0.5).growth)


def test_the_least_of_a_difference_is_found_between_the_growths_that_were_looked_at():
    growth = np.linspace(1.1, 1.3, 60)
    parabola = np.exp(900 * (growth - 1.2034) ** 2 - 7)
    assert _least(growth, parabola) == pytest.approx(1.2034, abs=1e-12)
    far = np.where(abs(growth - 1.2034) > 0.05, 1.0, parabola)  # what is far doesn't count
    assert _least(growth, far) == pytest.approx(1.2034, abs=1e-12)
    cosh = np.cosh(60 * (growth - 1.2034))
    assert _least(growth, cosh) == pytest.approx(1.2034, abs=2e-4)


def test_the_least_of_a_difference_is_one_looked_at_where_there_are_too_few():
    growth = np.linspace(1.1, 1.3, 11)
    assert _least(growth, np.exp(900 * (growth - 1.203) ** 2)) == growth[5] == pytest.approx(1.2)


def test_a_second_kick_comes_when_little_of_the_first_is_left_to_die():
    growth, difference = np.arange(1.1, 1.8, 0.1), np.array([1e3, 1e2, 40, 20, 1, 50, 90])
    assert _late(growth, difference, 30.0, 1.05) == pytest.approx(1.3)
    assert _late(growth, difference / np.array([1e3, 1e2, 1e2, 1, 1, 1, 1]), 30.0, 1.05) == 1.05


def test_a_body_that_does_not_start_to_fold_before_its_growth_is_final_has_no_onset():
    with pytest.raises(NoSolution, match=r"strip: .* g = 1\.10\d+ .* 1\.18;"):
        onset.onset(strip(*COARSE, "growth.final=1.18"))


def test_a_start_past_the_onset_is_refused():
    with pytest.raises(NoSolution, match=r" g = 1\.3\d+; .* 1\.3\.$"):
        onset.onset(strip(*COARSE), start=1.3)


@pytest.mark.parametrize("wrong", [{"start": 1.6}, {"start": 0.9}, {"rate": 0.0}, {"rate": np.inf}, {"start": np.nan}])
def test_a_start_or_a_rate_out_of_range_is_refused(wrong):
    with pytest.raises(OutOfRange, match=r" 1 <= start < growth\.final = 1\.6 "):
        onset.onset(strip(*COARSE), **wrong)
