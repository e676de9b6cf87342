"""Meshes and meetings: imperfections, one layer of elements, flat tetrahedra, walls head on, a whole sphere."""

import numpy as np
import pytest
import pyvista
from hard_cases import made_solver as made
from hard_cases.cases import hard_case
from hard_cases.made_solver import MESH, OCTANT, STRIP, at_rest, healthy, off_the_smooth_state, run_to_rest, start
from scipy.spatial import cKDTree
from skfem.io.meshio import HEX_MAPPING

from morphofold.sim.dynamics import UnstableError
from morphofold.sim.stage_checks import LEAST_J
from morphofold.studies.speed.solver_speed import cut_bricks

pytestmark = pytest.mark.usefixtures("one_thread")

FINER = "accuracy.edge=6.55"


def stable(holds, run, *levels):
    every = np.ones(len(run.body.X), dtype=bool)
    holds("fastest wave, of 4", run.body.fastest_wave(every, run.body.mass, *levels), at_most=2.8)
    healthy(holds, run_to_rest(run, 1.2))


@pytest.mark.parametrize("noise", [0.0, 0.1])
@hard_case("solver", "no perturbation at all, and 10 % noise", **made.FIRST_STEP, peers=made.FIXED_STEP)
def test_an_imperfection_of_nothing_and_one_of_a_tenth(noise, holds):
    effects = f"effects={{contact={{}}{f', perturbation={{amplitude={noise}}}' if noise else ''}}}"
    healthy(holds, run_to_rest(start(*OCTANT, FINER, effects), 1.65))


@hard_case("solver", "one element through the cortex", **made.PRESSURE)
def test_one_element_through_the_cortex(holds):
    single = "accuracy.elements_through_cortex=1"
    run = at_rest(start(*OCTANT, "effects={}", single), 1.15)
    holds("pial displacement off the exact one", off_the_smooth_state(run), at_most=0.03)
    healthy(holds, run_to_rest(start(*STRIP, single), 1.6))


@hard_case(
    "solver",
    "bricks ten times as wide as thick",
    guard="the mass is that of the body's own fastest waves",
    without=made.mass_of_cubes,
    fails=UnstableError,
)
def test_flat_bricks(holds):
    run = start(*OCTANT, "effects={}", "accuracy.edge=9.9", "accuracy.elements_through_cortex=3")
    stable(holds, run)


@hard_case(
    "solver",
    "a single layer of wide bricks, smooth motions light",
    guard="coarse levels add no more than the fastest wave allows",
    without=made.levels_without_limit,
    fails=(UnstableError, AssertionError),
)
def test_coarse_levels_of_wide_bricks(holds):
    run = start(*OCTANT, "effects={}", "geometry.cortex_thickness=5", "accuracy.elements_through_cortex=1")
    stable(holds, run, run.body.levels)


@hard_case(
    "solver",
    "deep creases, smooth motions light",
    guard="coarse levels are heavier where elements are crushed",
    without=made.levels_blind_to_creases,
    fails=(UnstableError, AssertionError),
)
def test_coarse_levels_of_creases(holds):
    run = start("fig6-thick", "geometry.portion=octant", "accuracy.edge=1.8", "accuracy.elements_through_cortex=3")
    for g in (1.5, 2.0):
        healthy(holds, run_to_rest(run, g))


@hard_case("solver", "tetrahedra of aspect 50", **made.DENSITY, peers=made.LUMPED_MASS)
def test_flat_tetrahedra(holds):
    thin = FINER, "geometry.cortex_thickness=0.4", "accuracy.elements_through_cortex=3", "material.mu_ratio=4"
    run = start(*OCTANT, "effects={}", *thin, mesh=cut_bricks)
    p, t = run.body.bilayer.mesh.p, run.body.bilayer.mesh.t[:, : run.body.elements.n_cortex]
    edges = [np.linalg.norm(p[:, t[i]] - p[:, t[j]], axis=0) for i in range(4) for j in range(i)]
    holds("longest over shortest edge", float((np.max(edges, axis=0) / np.min(edges, axis=0)).max()), at_least=50)
    run = at_rest(run, 1.15)
    holds("pial displacement off the exact one", off_the_smooth_state(run, *thin), at_most=0.03)
    holds("lowest J", run.state.lowest_J, at_least=LEAST_J)


@pytest.mark.parametrize(("kind", "T", "squash", "g"), [("thin layers", 0.6, 0.0, 1.05), ("squashed", 6.0, 0.9, 1.15)])
@hard_case("solver", "tetrahedra of aspect 50 and more, from a file", **made.DENSITY, peers=made.LUMPED_MASS)
def test_slivers_of_a_file(kind, T, squash, g, holds, tmp_path):
    aspect = made.shell_file(tmp_path / "a.vtu", T, squash)
    holds(f"longest edge over least height, {kind}", aspect, at_least=50)
    settings = f"geometry.cortex_thickness={T}", "material.mu_ratio=4"
    body = f"geometry.file={(tmp_path / 'a.vtu').as_posix()}", "geometry.label=layer"
    run = at_rest(start("mesh", *body, "effects={}", *settings), g)
    holds(f"pial displacement off the exact one, {kind}", off_the_smooth_state(run, *settings), at_most=MESH)
    holds(f"lowest J, {kind}", run.state.lowest_J, at_least=LEAST_J)


def clearance(run):
    """Least height [mm] of the upper surface's nodes over the highest node of the lower one, both nearly flat."""
    z = run.state.x[: run.body.n_surface, 2]
    return float(z[len(z) // 2 :].min() - z[: len(z) // 2].max())


def nodes_within_the_other(run):
    """How many nodes of each of two facing bodies lie in a brick of the other: VTK is asked, not contact."""
    bricks, lower, x = run.body.bilayer.mesh.t.T, run.body.bilayer.radial[:, 2] > 0, run.state.x
    count = 0
    for body in (lower, ~lower):
        cells = bricks[body[bricks].all(axis=1)][:, HEX_MAPPING[:8]]
        grid = pyvista.UnstructuredGrid({pyvista.CellType.HEXAHEDRON: cells}, x)
        count += int(np.count_nonzero(grid.find_containing_cell(x[~body]) >= 0))
    return count


@hard_case(
    "solver",
    "two bodies of folds meeting head on",
    guard="contact",
    without=made.no_contact,
    peers="BrainGrowth: the search visits 3 of 27 cells, 11 to 89 % of the pairs (measured)",
)
def test_folds_that_meet_head_on(holds):
    run = made.facing(7.2, 8.0, noise=0.1)
    run.grow_to(1.44)
    holds("nodes of one body within the other", nodes_within_the_other(run), at_most=0)
    holds("nodes in contact", run.state.record["effects"]["contact"]["pairs"], at_least=20)
    push = np.zeros((run.body.n_surface, 3))
    run.effects[0].add_forces(run.body, run.state.x, run.state.v, push)
    holds("sum of the forces of contact, over the sum of their sizes", made.imbalance(push), at_most=1e-12)
    healthy(holds, run, leave=["volume_drift"])  # walls that can't give way are pressed together


@hard_case(
    "solver",
    "two walls nearer than an edge before they grow",
    guard="pairs across a gap of the reference count",
    without=made.near_is_no_contact,
    peers="BrainGrowth: contact acts at 3 % of an edge, after faces have passed (measured)",
)
def test_walls_nearer_than_an_edge(holds):
    run = run_to_rest(made.facing(0.5, 4.0), 1.1)  # edges are 0.8 mm
    holds("clearance", clearance(run), at_least=0.0, unit="mm")
    holds("lowest J", run.state.lowest_J, at_least=LEAST_J)


@hard_case(
    "solver",
    "sulci of a hemisphere that crease within one brick",
    guard="the barrier at the corners of pial bricks",
    without=made.no_corner_barrier,
)
def test_creases_within_one_brick(holds):
    settings = "material.mu_ratio=1", "effects.corner_barrier={}", "effects.perturbation.seed=0"
    run = run_to_rest(start("hemisphere", *settings), 1.8)
    holds("corners that press", run.state.record["effects"]["corner_barrier"]["corners"], at_least=100)
    healthy(holds, run)


@hard_case(
    "solver",
    "a whole sphere without planes folds as its octant",
    guard="the filter's images beyond a plane",
    without=made.no_images,
    peers="Tallinen, BrainGrowth: a penalty at the mid-plane (read)",
)
def test_a_whole_sphere_is_eight_octants(holds):
    settings = "effects={contact={}}", "accuracy.precision=double"
    part, whole = (start(*OCTANT, *settings, f"geometry.portion={portion}") for portion in ("octant", "full"))
    _, same = cKDTree(whole.body.X).query(part.body.X)
    for g, bound in ((1.1, 1e-6), (1.2, 1e-6), (1.6, 0.03)):  # before folds, and folded: 1 % of T
        for run in (part, whole):
            run.grow_to(g)
        if g == 1.1:
            holds("pial displacement of the whole off the exact one", off_the_smooth_state(whole), at_most=MESH)
            centre = whole.body.nodal_volumes() @ whole.state.x / whole.body.elements.volume.sum()
            holds("centre of the whole, off the middle by", float(np.abs(centre).max()), at_most=1e-9, unit="mm")
        distance = np.abs(whole.state.x[same] - part.state.x).max()
        holds(f"nodes apart at g = {g}", float(distance), at_most=bound, unit="mm")
    r = np.linalg.norm(part.state.x[: part.body.n_surface], axis=1)
    holds("depth of the folds", float(np.ptp(r)), at_least=0.5, unit="mm")
