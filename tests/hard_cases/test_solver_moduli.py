"""Moduli, thickness and growth laws at their ends: the smooth state is known, the folded one has to be healthy."""

import numpy as np
import pytest
from hard_cases import made_solver as made
from hard_cases.cases import hard_case
from hard_cases.made_solver import MESH, OCTANT, STRIP, at_rest, healthy, off_the_smooth_state, run_to_rest, start

from morphofold.errors import OutOfRange
from morphofold.sim.dynamics import Dynamics, UnstableError

pytestmark = pytest.mark.usefixtures("one_thread")

EITHER = (AssertionError, UnstableError)

NO_LAYER = "BrainGrowth, FetalFoldSim: a sigmoid of depth, no sharp layer (read)"


def smooth(holds, g, *settings, label="pial displacement off the exact one"):
    """An octant without imperfection at growth g before it folds, against the radial equilibrium."""
    run = at_rest(start(*OCTANT, "effects={}", *settings), g)
    holds(label, off_the_smooth_state(run, *settings), at_most=MESH)


def refused(holds, label, call, *phrases):
    with pytest.raises(OutOfRange) as error:
        call()
    holds.says(label, str(error.value), *phrases)


@hard_case("solver", "κ/μ = 1000", **made.PRESSURE, peers="Tallinen: κ = 5 μ (read)")
def test_a_nearly_incompressible_body_grows_as_its_theory_says(holds):
    smooth(holds, 1.15, "material.kappa_ratio=1000")


@hard_case("solver", "κ/μ = 1000, folded", **made.PRESSURE)
def test_a_nearly_incompressible_body_folds(holds):
    healthy(holds, run_to_rest(start(*STRIP, "material.kappa_ratio=1000"), 1.45))


@hard_case("solver", "μ ratio 0.1", **made.PRESSURE, peers=NO_LAYER)
def test_a_cortex_softer_than_its_core(holds):
    smooth(holds, 1.15, "material.mu_ratio=0.1")
    run = run_to_rest(start(*STRIP, "material.mu_ratio=0.1"), 1.3)
    healthy(holds, run, leave=["volume_drift"])  # κ = 5 μ of the core: see the laws


@pytest.mark.parametrize("mu_ratio", [10, 100])
@hard_case(
    "solver",
    "μ ratio 10 and 100",
    guard="each element's own modulus in its mass",
    without=made.mass_of_the_core,
    fails=UnstableError,
    peers=NO_LAYER,
)
def test_a_cortex_far_stiffer_than_its_core(mu_ratio, holds):
    smooth(holds, 1.04, f"material.mu_ratio={mu_ratio}", label=f"displacement off the exact one, {mu_ratio}")
    healthy(holds, run_to_rest(start(*STRIP, f"material.mu_ratio={mu_ratio}"), 1.3))


@hard_case("solver", "T/C = 1/200, before it folds", **made.DENSITY, peers=made.LUMPED_MASS)
def test_a_very_thin_cortex(holds):
    smooth(holds, 1.1, "geometry.cortex_thickness=0.25", "material.mu_ratio=4")


@hard_case("solver", "T/C = 1/200, folded", **made.DENSITY)
def test_a_very_thin_cortex_folds(holds):
    T = 0.25  # mm, on a core of 50
    thin = f"geometry.cortex_thickness={T}", "accuracy.edge=0.1", "accuracy.elements_through_cortex=2"
    run = run_to_rest(start("strip", "geometry.depth=50", "geometry.length=4", *thin, "material.mu_ratio=4"), 1.3)
    height = float(np.ptp(run.state.x[: run.body.n_surface, 2]))
    holds("crowns over fundi, in thicknesses of the cortex", height / T, at_least=1)
    healthy(holds, run)


@hard_case("solver", "T/C = 1/5", **made.FIRST_STEP, peers=made.FIXED_STEP)
def test_a_very_thick_cortex(holds):
    smooth(holds, 1.15, "geometry.cortex_thickness=10")
    healthy(holds, run_to_rest(start(*OCTANT, "geometry.cortex_thickness=10"), 1.8))


@hard_case(
    "solver",
    "tangential growth of a thick cortex",
    guard="the law reaches the kernel",
    without=made.isotropic_kernel,
    peers="BrainGrowth: isotropic growth is dead code (read)",
)
def test_a_thick_cortex_that_grows_tangentially(holds):
    smooth(holds, 1.2, "geometry.cortex_thickness=10", "growth.law=tangential")
    healthy(holds, run_to_rest(start(*OCTANT, "geometry.cortex_thickness=10", "growth.law=tangential"), 1.8))


@hard_case("solver", "a cortex that shrinks, g = 0.8", guard="growth falls as it rises", without=made.only_upwards)
def test_a_cortex_that_shrinks(holds):
    smooth(holds, 0.8, label="displacement off the exact one, isotropic")
    smooth(holds, 0.8, "growth.law=tangential", label="displacement off the exact one, tangential")
    refused(holds, "growth to nothing", lambda: start(*STRIP).grow_to(0.0), " 0.")
    refused(holds, "a scene", lambda: start(*STRIP, "growth.final=0.8"), "growth.final: ", " 1 ", "0.8")


def three_times(holds):
    """A cortex three times as long."""
    run = start(*STRIP, "growth.final=3", "geometry.length=24")
    for g in (2.0, 2.5, 3.0):
        run_to_rest(run, g)
    healthy(holds, run, leave=["volume_drift"])  # 27 times the volume presses: see the laws


@hard_case("solver", "growth to g = 3", **{**made.FIRST_STEP, "fails": EITHER}, peers=made.FIXED_STEP)
def test_growth_to_three(holds):
    three_times(holds)


@hard_case("solver", "growth to g = 3, walls pressed together", guard="contact", without=made.no_contact)
def test_growth_to_three_keeps_walls_apart(holds):
    three_times(holds)


@hard_case("solver", "growth to g = 3, no saw-teeth", guard="the filter", without=made.no_filter, fails=EITHER)
def test_growth_to_three_keeps_the_surface_smooth(holds):
    three_times(holds)


@hard_case(
    "solver", "growth ten times too fast", guard="growth waits for balance", without=made.no_waiting, fails=EITHER
)
def test_growth_ten_times_too_fast(holds):
    refused(holds, "a scene", lambda: start(*STRIP, "growth.rate=10"), "growth.rate", "4", "10")
    run = start(*STRIP)
    healthy(holds, run_to_rest(Dynamics(run.body, run.effects, steps_per_unit=0.1 / run.rate), 1.6))
