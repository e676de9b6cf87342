import pytest

from morphofold.sim.health import BOUNDS, LEAST_J, broken_bounds

SOUND = {"growth": 1.5, "lowest_J": 0.3, "kinetic_over_strain": 1e-3, "overlap": 0.0, "volume_drift": 0.01}


def test_a_sound_stage_breaks_no_bound():
    assert broken_bounds(SOUND) == []


@pytest.mark.parametrize("name", BOUNDS)
def test_each_bound_is_told_with_its_value_and_a_cure(name):
    told = broken_bounds({**SOUND, name: 2 * BOUNDS[name][0]})
    assert len(told) == 1
    assert f"{name} {2 * BOUNDS[name][0]:.2g} at g = 1.50" in told[0]
    assert BOUNDS[name][1] in told[0]
    assert len(broken_bounds({**SOUND, name: float("nan")})) == 1


def test_a_crushed_element_is_told_even_if_it_recovered():
    assert "lowest J" in broken_bounds({**SOUND, "lowest_J": 0.5 * LEAST_J})[0]


def test_kinetic_energy_is_not_judged_before_there_is_strain_energy_to_compare():
    assert broken_bounds({**SOUND, "growth": 1.1, "kinetic_over_strain": 0.5}) == []
