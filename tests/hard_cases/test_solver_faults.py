"""Faults put into a run: it goes on as if nothing had been, or it stops by its rule and says where."""

import re

import numba
import numpy as np
import pytest
from hard_cases import made_solver as made
from hard_cases.cases import hard_case
from hard_cases.made_solver import MESH, OCTANT, STRIP, at_rest, digest, off_the_smooth_state, start

from morphofold.sim import dynamics
from morphofold.sim.body import Body
from morphofold.sim.dynamics import UnstableError
from morphofold.sim.elements import kernels
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.health import BOUNDS, LEAST_J
from morphofold.sim.speed import cut_bricks

pytestmark = pytest.mark.usefixtures("one_thread")

FINER = "accuracy.edge=4.91"                                            # bricks of the cortex are 1 mm thick


def inner_node(run):
    """The pial node at the corner of the cubed sphere, off the planes."""
    return int(np.argmin(np.abs(run.body.X[: run.body.n_surface] - 50 / 3**0.5).sum(axis=1)))


def sunk(run, by):
    """The run with one pial node ``by`` mm deeper than it was."""
    node = inner_node(run)
    run.state.x[node] -= by * run.body.bilayer.radial[node]
    return run


def forgets_the_measurement_before(patch):
    patch.setattr(dynamics, "SCALARS", tuple(name for name in dynamics.SCALARS if name != "before_J"))


@hard_case("solver", "restart from a state on the edge, an element almost collapsed",
           guard="the smallest J of the measurement before is kept", without=forgets_the_measurement_before,
           peers="BrainGrowth, Tallinen, FetalFoldSim: no restart (read)")  # fmt: skip
def test_a_restart_on_the_edge(holds):
    whole, again = (start(*OCTANT, FINER, "effects={contact={}}") for _ in range(2))
    whole.grow_to(1.1)
    sunk(whole, 2.85)
    for _ in range(2):                                                  # collapsed for a while: growth goes on
        whole._measure()
    holds("smallest J where the run is taken up", whole.state.record["min_J"], at_most=0.1)
    again.load(whole.save())
    for run in (whole, again):
        run.grow_to(1.15)
    holds.equal("steps", again.state.step, whole.state.step)
    holds.equal("positions", digest(again.state.x), digest(whole.state.x))
    holds("smallest J at the end", whole.state.record["min_J"], at_least=LEAST_J)


def ends(make):
    """How a run ends: right, told (stopped, or a bound of its health broken), or wrong and silent."""
    try:
        run = at_rest(make(), 1.15)
    except UnstableError:
        return "told"
    if not run.state.record["kinetic_over_strain"] <= BOUNDS["kinetic_over_strain"][0]:
        return "told"
    return "right" if off_the_smooth_state(run) <= MESH and run.state.record["min_J"] >= LEAST_J else "silent"


@hard_case("solver", "a time step forced too large", guard="positions and volumes are looked at",
           without=made.no_checks,
           peers="BrainGrowth: the run ends 25 steps later, by an IndexError (measured)")  # fmt: skip
def test_a_step_too_large_is_caught(holds):
    """A step is too large by sqrt(1 / factor) once the factor on the mass is below that of the safety, 1 / 1.5."""
    update, found = Body.update_state, {}
    for factor in (1.0, 0.8, 0.6, 0.4, 0.2, 0.05, 1e-3):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Body, "update_state", update)
            made.mass_times(patch, factor)
            patch.setattr(made, "MOST_REST", 100)
            found[factor] = ends(lambda: start(*OCTANT, "effects={}"))
    holds.equal("at the step of the solver", found[1.0], "right")
    endings = list(found.values())
    holds("steps too large that end wrong and silent", endings.count("silent"), at_most=0)
    holds("steps too large that are caught", endings.count("told"), at_least=3)


def late(patch):
    """Positions are looked at when mass and energies are measured."""
    advance = kernels.advance
    patch.setattr(kernels, "advance", lambda *arguments: advance(*arguments) and 0)


@pytest.mark.parametrize("cells", ["bricks", "tetrahedra"])
@hard_case("solver", "NaN injected in one node", guard="each step counts what is not finite", without=late,
           peers="Tallinen (C++): the run goes on on NaN to the end (measured)")  # fmt: skip
def test_a_node_that_is_no_number_stops_the_run_within_a_step(cells, holds):
    run = start(*OCTANT, "effects={contact={}}", mesh=cut_bricks if cells == "tetrahedra" else lambda bilayer: bilayer)
    run.grow_to(1.02)
    step = run.state.step
    run.state.x[117, 1] = np.nan
    with pytest.raises(UnstableError) as error:
        run.grow_to(1.1)
    told = str(error.value)
    holds.says(f"the error, {cells}", told, "not finite", "growth.rate")
    holds.equal(f"the node that it names, {cells}", re.search(r"first is node (\d+)", told)[1], "117")
    holds(f"steps until it stops, {cells}", float(re.search(r"step (\d+)", told)[1]) - step, at_most=1)
    holds.equal(f"the last sound state is finite, {cells}", bool(np.isfinite(error.value.sound["x"]).all()), True)


@hard_case("solver", "an inverted element injected", guard="positions and volumes are looked at",
           without=made.no_checks,
           peers="BrainGrowth: one inverted element changes the forces of all nodes (measured)")  # fmt: skip
def test_an_inverted_element_recovers_or_stops_the_run(holds):
    found = {}
    for by in (1.75, 2.5, 5.0, 10.0, 20.0, 40.0):
        def make(by=by):
            run = start(*OCTANT, FINER, "effects={}")
            run.grow_to(1.05)
            return sunk(run, by)

        found[by] = ends(make)
    holds.equal("a node sunk by 1.75 layers", found[1.75], "right")
    endings = list(found.values())
    holds("depths from 1.75 to 40 layers that end wrong and silent", endings.count("silent"), at_most=0)
    holds("depths that stop the run", endings.count("told"), at_least=1)


def order_of_threads(patch):
    """Each node adds up its rows in an order that depends on the number of threads, as with a shared sum."""
    compute = Bricks.compute_forces

    def turned(self, x):
        compute(self, x)
        b = self.blocks
        if (numba.get_num_threads() > 1) != vars(b).setdefault("turned", False):
            for one, two in zip(b.first[:-1], b.first[1:]):
                b.rows[one:two] = b.rows[one:two][::-1].copy()
            b.turned = not b.turned

    patch.setattr(Bricks, "compute_forces", turned)


SCENES = {
    "a strip": (STRIP, 1.5), "κ/μ = 1000": ((*STRIP, "material.kappa_ratio=1000"), 1.2),
    "μ ratio 100": ((*STRIP, "material.mu_ratio=100"), 1.3), "μ ratio 0.1": ((*STRIP, "material.mu_ratio=0.1"), 1.3),
    "one layer": ((*STRIP, "accuracy.elements_through_cortex=1"), 1.6),
    "T/C = 1/200": ((*OCTANT, "geometry.cortex_thickness=0.25"), 1.1),
    "T/C = 1/5, tangential": ((*OCTANT, "geometry.cortex_thickness=10", "growth.law=tangential"), 1.8),
    "10 % noise": ((*OCTANT, "accuracy.edge=6.55", "effects.perturbation.amplitude=0.1"), 1.65),
    "32 bits": ((*OCTANT, "accuracy.edge=6.55", "accuracy.precision=single"), 1.65),
    "a shrinking cortex": (OCTANT, 0.8),
}  # fmt: skip


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
@hard_case("solver", "1 and 2 threads", guard="sums have one order", without=order_of_threads,
           peers="BrainGrowth: 20 of 60 repeats differ, by up to 5 times the largest force (measured)")  # fmt: skip
def test_one_and_two_threads_end_with_the_same_bytes(holds):
    """From where one thread has brought each scene, on for a thousandth of growth."""
    for name, (scene, g) in SCENES.items():
        run = start(*scene)
        run.grow_to(g)
        state, ends = run.save(), []
        for threads in (1, 2):
            numba.set_num_threads(threads)
            run.load(state)
            run.grow_to(g + 1e-3)
            ends.append(digest(run.state.x))
        numba.set_num_threads(1)
        holds.equal(f"positions, {name}", *ends)
