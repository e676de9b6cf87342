"""Folded states beside the smooth one of a strip."""

import numpy as np
import pytest

from morphofold.sim.equilibrium.statics import Equilibrium
from morphofold.studies import post_onset
from morphofold.studies.post_onset import branch, strip
from morphofold.threads import using_threads

pytestmark = pytest.mark.slow  # studies are not shipped: run them when they change

HEIGHTS = (0.04, 0.08, 0.12)


@pytest.fixture(scope="module", params=[0.5, 4.0], ids=["soft", "stiff"])
def found(request):
    half_wave = {0.5: 3.6, 4.0: 4.75}[request.param]
    body = strip("isotropic", request.param, half_wave, 3)
    heights = HEIGHTS[:1] if request.param < 1 else HEIGHTS
    return request.param, body, branch(body, heights)


def test_nothing_holds_a_folded_state(found):
    """All forces at free nodes vanish, also at the crest whose height was imposed."""
    _, body, states = found
    body.grow(states.growth[-1])
    forces = body.all_forces(states.x)[body.free]
    assert np.abs(forces).max() < 1e-6 * np.abs(body.elements.blocks.force).max()
    assert np.ptp(states.x[: body.n_surface, 2]) > states.heights[-1]  # the trough goes down, too


def test_a_stiff_cortex_folds_beyond_the_critical_growth_and_a_soft_one_below(found):
    ratio, _, states = found
    beyond = states.growth - states.g_crit
    assert (np.sign(beyond) == (1 if ratio > 1 else -1)).all()


def test_growth_beyond_the_onset_goes_with_the_square_of_the_height(found):
    ratio, _, states = found
    if ratio > 1:
        np.testing.assert_allclose((states.growth - states.g_crit) / states.heights**2, states.coefficient, rtol=0.05)


def test_the_stiff_folded_state_is_stable_and_the_soft_one_is_not(found):
    ratio, body, states = found
    body.grow(states.growth[-1])
    negative = Equilibrium(body, states.x).stability().negative
    assert negative == (0 if ratio > 1 else 1)


@pytest.mark.parametrize(("ratio", "half_wave", "stays"), [(0.5, 3.6, True), (4.0, 4.75, False)])
def test_folds_of_a_soft_cortex_stay_when_growth_goes_back(ratio, half_wave, stays, monkeypatch):
    """At 0.02 below the growth at which a flat strip folds, one that has been folded is still folded, or is not."""
    monkeypatch.setattr(post_onset, "BEYOND", np.array([-0.02, 0.06]))
    g_crit = branch(strip("isotropic", ratio, half_wave, 4), ()).g_crit
    with using_threads(1):
        found = post_onset.loop("isotropic", ratio, half_wave, g_crit, 4)
    assert found.up[0] < 0.2
    assert found.up[1] > 1
    assert found.down[1] == pytest.approx(found.up[1], abs=0.01)
    assert (found.down[0] > 1) == stays
    assert found.folds_at == 0.06
    assert np.isnan(found.flat_at) if stays else found.flat_at == 0.06  # NaN: still folded at the end
