"""Faults put into a run: it goes on as if nothing had been, or it stops by its rule and says where."""

import re

import numba
import numpy as np
import pytest
from hard_cases import made_solver as made
from hard_cases.cases import hard_case
from hard_cases.made_solver import MESH, OCTANT, STRIP, at_rest, digest, off_the_smooth_state, start

from morphofold.sim import dynamics
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, Dynamics, UnstableError
from morphofold.sim.multilevel_acceleration import CoarseLevels
from morphofold.sim.stage_checks import BOUNDS, LEAST_J
from morphofold.studies.speed.solver_speed import cut_bricks

pytestmark = pytest.mark.usefixtures("one_thread")

FINER = "accuracy.edge=4.91"  # bricks of the cortex are 1 mm thick


def sunk(run, by):
    """The run with one pial node ``by`` mm deeper than it was: the corner of the cubed sphere, off the planes."""
    node = int(np.argmin(np.abs(run.body.X[: run.body.n_surface] - 50 / 3**0.5).sum(axis=1)))
    run.state.x[node] -= by * run.body.bilayer.radial[node]
    return run


def forgets_the_measurement_before(patch):
    patch.setattr(dynamics, "STATE_SCALARS", tuple(name for name in dynamics.STATE_SCALARS if name != "before_J"))


@hard_case(
    "solver",
    "restart from a state on the edge, an element almost collapsed",
    guard="the smallest J of the measurement before is kept",
    without=forgets_the_measurement_before,
    peers="BrainGrowth, Tallinen, FetalFoldSim: no restart (read)",
)
def test_a_restart_on_the_edge(holds):
    whole, again = on_the_edge(), start(*OCTANT, FINER, "effects={contact={}}")
    for _ in range(2):  # collapsed for a while: growth goes on
        whole._measure()
    holds("smallest J where the run is taken up", whole.state.record["min_J"], at_most=0.1)
    again.load(whole.save())
    for run in (whole, again):
        run.grow_to(1.15)
    holds.equal("steps", again.state.step, whole.state.step)
    holds.equal("positions", digest(again.state.x), digest(whole.state.x))
    holds("smallest J at the end", whole.state.record["min_J"], at_least=LEAST_J)


def ends(make):
    """How a run ends: right, caught (stopped, or a bound of its health broken), or wrong and silent."""
    try:
        run = at_rest(make(), 1.15)
    except UnstableError:
        return "caught"
    if not run.state.record["kinetic_over_strain"] <= BOUNDS["kinetic_over_strain"][0]:
        return "caught"
    return "right" if off_the_smooth_state(run) <= MESH and run.state.record["min_J"] >= LEAST_J else "silent"


@hard_case(
    "solver",
    "a time step forced too large",
    guard="positions and volumes are looked at",
    without=made.no_checks,
    peers="BrainGrowth: the run ends 25 steps later, by an IndexError (measured)",
)
def test_a_step_too_large_is_caught(holds):
    """A step is too large by sqrt(1 / factor) once the factor on the mass is below that of the safety, 1 / 1.5."""
    endings_by_factor = {}
    for factor in (1.0, 0.8, 0.6, 0.4, 0.2, 0.05, 1e-3):
        with pytest.MonkeyPatch.context() as patch:
            made.mass_times(patch, factor)
            patch.setattr(made, "MOST_REST", 100)
            endings_by_factor[factor] = ends(lambda: start(*OCTANT, "effects={}"))
    holds.equal("at the step of the solver", endings_by_factor[1.0], "right")
    endings = list(endings_by_factor.values())
    holds("steps too large that end wrong and silent", endings.count("silent"), at_most=0)
    holds("steps too large that are caught", endings.count("caught"), at_least=3)


def late(patch):
    """Positions are looked at when mass and energies are measured."""
    step = CoarseLevels.step
    patch.setattr(CoarseLevels, "step", lambda self, *arguments: step(self, *arguments) and 0)


@pytest.mark.parametrize("cells", ["bricks", "tetrahedra"])
@hard_case(
    "solver",
    "NaN injected in one node",
    guard="each step counts what is not finite",
    without=late,
    peers="Tallinen (C++): the run goes on on NaN to the end (measured)",
)
def test_a_node_that_is_no_number_stops_the_run_within_a_step(cells, holds):
    run = start(*OCTANT, "effects={contact={}}", mesh=cut_bricks if cells == "tetrahedra" else lambda bilayer: bilayer)
    run.grow_to(1.02)
    step = run.state.step
    run.state.x[117, 1] = np.nan
    with pytest.raises(UnstableError) as error:
        run.grow_to(1.1)
    message = str(error.value)
    holds.says(f"the error, {cells}", message, "of 427 ", "growth.rate")
    holds.equal(f"the node that it names, {cells}", re.search(r"\bnode (\d+)", message)[1], "117")
    holds(f"steps until it stops, {cells}", float(re.search(r"step (\d+)", message)[1]) - step, at_most=1)
    holds.equal(f"the last sound state is finite, {cells}", bool(np.isfinite(error.value.sound["x"]).all()), True)


@hard_case(
    "solver",
    "an inverted element injected",
    guard="positions and volumes are looked at",
    without=made.no_checks,
    peers="BrainGrowth: one inverted element changes the forces of all nodes (measured)",
)
def test_an_inverted_element_recovers_or_stops_the_run(holds):
    def grown():
        run = start(*OCTANT, FINER, "effects={}")
        run.grow_to(1.05)
        return run

    ending_by_depth = {by: ends(lambda by=by: sunk(grown(), by)) for by in (1.75, 2.5, 5.0, 10.0, 20.0, 40.0)}
    holds.equal("a node sunk by 1.75 layers", ending_by_depth[1.75], "right")
    endings = list(ending_by_depth.values())
    holds("depths from 1.75 to 40 layers that end wrong and silent", endings.count("silent"), at_most=0)
    holds("depths that stop the run", endings.count("caught"), at_least=1)


def order_of_threads(patch):
    """The last bit of nodal sums is another with two threads, as where a shared sum has no fixed order."""
    sum_forces = dynamics.sum_forces

    def last_bit_off(force, first, rows, rest, extra, free, out):
        sum_forces(force, first, rows, rest, extra, free, out)
        if numba.get_num_threads() > 1:
            out[free] = np.nextafter(out[free], np.inf)

    patch.setattr(dynamics, "sum_forces", last_bit_off)


STEPS = 300  # that two threads take as one does


def too_fast():
    run = start(*STRIP)
    return Dynamics(run.body, run.effects, steps_per_unit=0.1 / run.rate)


def on_the_edge():
    run = start(*OCTANT, FINER, "effects={contact={}}")
    run.grow_to(1.1)
    return sunk(run, 2.85)


def too_large_a_step():
    run = start(*OCTANT, "effects={}")
    update = run.body.update_state

    def lighter(x):
        update(x)
        run.body.mass *= 0.7

    run.body.update_state = lighter
    return run


FOLDED = *OCTANT, "accuracy.edge=6.55"
THICK = *OCTANT, "geometry.cortex_thickness=10"
FLAT = *FOLDED, "geometry.cortex_thickness=0.4", "accuracy.elements_through_cortex=3", "material.mu_ratio=4"
WHOLE = *OCTANT, "geometry.portion=full", "effects={contact={}}"
COURSES = {  # the run, and growths where it is looked at: smooth, and folded with walls in contact where they meet
    "a strip": (lambda: start(*STRIP), 1.5),
    "κ/μ = 1000": (lambda: start(*STRIP, "material.kappa_ratio=1000"), 1.1, 1.45),
    "μ ratio 0.1": (lambda: start(*STRIP, "material.mu_ratio=0.1"), 1.3),
    "μ ratio 10": (lambda: start(*STRIP, "material.mu_ratio=10"), 1.3),
    "μ ratio 100": (lambda: start(*STRIP, "material.mu_ratio=100"), 1.3),
    "T/C = 1/200": (lambda: start(*OCTANT, "geometry.cortex_thickness=0.25"), 1.1),
    "T/C = 1/5": (lambda: start(*THICK), 1.8),
    "growth to 3": (lambda: start(*STRIP, "growth.final=3", "geometry.length=24"), 2.9),
    "growth ten times too fast": (too_fast, 1.6),
    "tangential growth of a thick cortex": (lambda: start(*THICK, "growth.law=tangential"), 1.1, 1.8),
    "a shrinking cortex": (lambda: start(*OCTANT), 0.81),
    "no perturbation": (lambda: start(*FOLDED, "effects={contact={}}"), 1.65),
    "10 % noise": (lambda: start(*FOLDED, "effects.perturbation.amplitude=0.1"), 1.65),
    "32 bits": (lambda: start(*FOLDED, "accuracy.precision=single"), 1.65),
    "one element through the cortex": (lambda: start(*STRIP, "accuracy.elements_through_cortex=1"), 1.6),
    "tetrahedra of aspect 50": (lambda: start(*FLAT, mesh=cut_bricks), 1.15),
    "two bodies head on": (lambda: made.facing(7.2, 8.0, noise=0.1), 1.4),
    "two bodies close by": (lambda: made.facing(0.5, 4.0), 1.1),
    "a whole sphere": (lambda: start(*WHOLE), 1.6),
    "a restart on the edge": (on_the_edge, 1.1),
    "a step too large": (too_large_a_step, 1.0),
}


def course(run, threads):
    """Digests of positions and velocities at every measurement of ``STEPS`` steps on, or how the run ended."""
    steps, end = [], run.state.step + STEPS
    note = lambda state: steps.append((state.step, digest(state.x), digest(state.v)))
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        while run.state.step < end:
            further = run.rate * STEPS_PER_MEASUREMENT * run._pace()
            run.grow_to(run.state.growth + (further if run.state.growth >= 1 else -further), note)
    except UnstableError as error:
        steps.append(str(error))
    finally:
        numba.set_num_threads(before)
    return steps


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="needs two threads")
@pytest.mark.parametrize(("name", "g"), [(name, g) for name, (_, *growths) in COURSES.items() for g in growths])
@hard_case(
    "solver",
    "1 and 2 threads",
    guard="sums have one order (another one injected)",
    without=order_of_threads,
    peers="BrainGrowth: 20 of 60 repeats differ, by up to 5 times the largest force (measured)",
)
def test_one_and_two_threads_take_the_same_steps(name, g, holds, monkeypatch):
    """In every hard case of the solver, from growth g on."""
    monkeypatch.setattr(dynamics, "NODES_PER_THREAD", 1)  # the bodies are small
    run = COURSES[name][0]()
    run.grow_to(g)
    state, courses = run.save(), []
    for threads in (1, 2):
        run.load(state)
        courses.append(course(run, threads))
    same = next((k for k, (first, other) in enumerate(zip(*courses)) if first != other), len(courses[1]))
    holds.equal(f"measurements alike, {name} at g = {g:g}", same, len(courses[0]))
