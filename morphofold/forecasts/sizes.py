"""How large a run will be, by formulas: a scene, or a body already built, in; its elements and nodes, time steps and
memory [GiB] out, and the edges that its mesh can have.

It times nothing, as ``forecasting`` does. ``mesh_choice`` and ``richardson`` call it, too.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from morphofold.errors import DoesNotApply
from morphofold.forecasts.cost_record import COSTS, GiB
from morphofold.number_texts import rounded_up
from morphofold.sim.dynamics import ENTRY_TICKS, STEPS_PER_MEASUREMENT, limited_pace, next_growth, patience, soft_start
from morphofold.sim.effects import ramp as ramps
from morphofold.sim.equilibrium.wrinkle_onset import first_wrinkles, slow_growth
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, Bilayer, core_layer_fractions
from morphofold.sim.nested_meshes import COARSE_TICKS, FINE_TICKS, WINDOW_END, WINDOW_START
from morphofold.sim.scene import Patch, Scene, Strip

Layers = tuple[float, float]  # mean thickness of the cortex and mean depth of the core below it [mm]


class Sizes(NamedTuple):
    """Elements and nodes of a body, vertices of its whole surface (mirrored to a closed one), largest edge [mm]."""

    elements: int
    nodes: int
    vertices: int
    edge: float


def sizes_of(bilayer: Bilayer) -> Sizes:
    """Sizes of a built body."""
    n_mirrors, vertices = len(bilayer.mirrored), bilayer.n_surface
    if n_mirrors and bilayer.faces.shape[1] == 4:  # Euler: a closed surface of quads
        vertices = 2**n_mirrors * len(bilayer.faces) + 2
    return Sizes(bilayer.mesh.nelements, int(bilayer.mesh.nvertices), vertices, bilayer.edge)


def layers_of(bilayer: Bilayer) -> Layers:
    """Mean layers of a built body of bricks, as its builder used them."""
    X, n = bilayer.mesh.p.T, bilayer.n_surface
    white = bilayer.white @ X
    thickness, depth = (float(np.linalg.norm(offsets, axis=1).mean()) for offsets in (X[:n] - white, white - X[-n:]))
    return thickness, depth


def edge_by_rule(scene: Scene) -> float:
    """Largest surface edge [mm] of a body of bricks, at most the edge in its scene."""
    return max(length / cells for length, cells in _lengths_and_cells(scene))


def _lengths_and_cells(scene: Scene) -> list[tuple[float, int]]:
    """Lengths of a patch, or of an edge of the cube of a cubed sphere [mm], and the cells along each; a strip has one
    cell of no length across."""
    geometry = scene.geometry
    if not isinstance(geometry, Patch | Strip):
        return [(getattr(geometry, "quarter", 0.0), scene.cells)]
    lengths = geometry.size if isinstance(geometry, Patch) else (geometry.length, 0.0)
    return [(length, max(1, math.ceil(length / scene.edge - 1e-9))) for length in lengths]


def refuse_without_edge(scene: Scene, purpose: str) -> None:
    """Refuse a scene whose edge cannot be changed; ``purpose`` begins the message.

    Raises
    ------
    DoesNotApply
        For a mesh from a file, or one dimension.
    """
    shape = scene.geometry.shape
    if shape in ("mesh", "radial"):
        reason = "its mesh comes from a file" if shape == "mesh" else "it is solved in one dimension"
        raise DoesNotApply(f"{purpose}, but {scene.name} (shape {shape!r}) has none: {reason}. Leave it out.")


def sizes_by_rule(scene: Scene, layers: Layers) -> Sizes:
    """Sizes of a body of bricks: quads of its surface times its layers."""
    n_cortex_layers, edge, cell_counts = (
        scene.elements_through_cortex,
        edge_by_rule(scene),
        [n for _, n in _lengths_and_cells(scene)],
    )
    thickness, depth = layers
    if isinstance(scene.geometry, Patch | Strip):
        n_quads, n_surface = math.prod(cell_counts), math.prod(n + 1 for n in cell_counts)
        n_whole_vertices = n_surface
    else:
        n, n_cuts = cell_counts[0], len(SYMMETRY_AXES[getattr(scene.geometry, "portion", "full")])
        n_quads, n_rim = 6 * n * n // 2**n_cuts, (0, 4 * n, 4 * n, 3 * n)[n_cuts]
        n_surface = n_quads + (n_rim // 2 + 1 if n_cuts else 2)  # Euler: a disc of quads, or a closed surface
        n_whole_vertices = 6 * n * n + 2
    n_layers = n_cortex_layers + len(core_layer_fractions(thickness / n_cortex_layers, depth, edge)) - 1
    return Sizes(n_quads * n_layers, n_surface * (n_layers + 1), n_whole_vertices, edge)


def edges_between(scene: Scene, finest: float, coarsest: float) -> list[float]:
    """Largest surface edges [mm] at which the number of cells changes, from the coarsest to the finest one [mm].

    Rounded up in the fourth digit, which does not change the number of cells.
    """
    length = max(length for length, _ in _lengths_and_cells(scene))
    cell_step = 1 if isinstance(scene.geometry, Patch | Strip) else 4
    fewest_cells = max(cell_step, cell_step * math.ceil(length / coarsest / cell_step - 1e-9))
    cell_counts = range(fewest_cells, math.floor(length / finest + 1e-9) + 1, cell_step)
    return [round(rounded_up(length / n, 4), 12) for n in cell_counts]


def relative_crossing(scene: Scene, edge: float) -> float:
    """Steps in which a wave crosses the cortex, up to a factor, with surface edges of length ``edge`` [mm]."""
    crossing_costs, T, n_layers = COSTS["crossing"], scene.geometry.cortex_thickness, scene.elements_through_cortex
    mass_factor = np.interp(edge * n_layers / T, crossing_costs["flatness"], crossing_costs["mass"])
    mass_factor /= np.interp(2 * edge / T / (n_layers + 1), crossing_costs["coarseness"], crossing_costs["lightness"])
    return math.sqrt(mass_factor * (crossing_costs["through"] * n_layers**2 + (T / edge) ** 2))


class Steps(NamedTuple):
    """Steps of a run.

    Attributes
    ----------
    expected, fewest, most : int
        In total, and in the runs that took fewest and most.
    waiting : float
        Of these, those in which growth waits for balance while folds form.
    growing : float
        Share of the steps in which growth rises, or waits for balance: it does not stand still at a stage.
    touching : float
        Time that active contact adds to a step, as a share of the step, mean over all steps.
    fine : float
        Share of the steps that are on the scene's own mesh; the others are on the coarse one of two nested meshes.
    """

    expected: int
    fewest: int
    most: int
    waiting: float
    growing: float
    touching: float
    fine: float = 1.0


def steps_of(scene: Scene, crossing: float, per_unit: float) -> Steps:
    """Steps that a scene takes. Of its effects, a ramp and inertia change the pace, and contact adds time to steps.

    Parameters
    ----------
    scene : Scene
    crossing : float
        Steps in which a wave crosses the cortex: one tick of the clock that sets the pace.
    per_unit : float
        Steps for growth to rise by 1 at full pace.
    """
    wait_costs, rest_costs, contact_costs = COSTS["waiting"], COSTS["resting"], COSTS["contact"]
    touch_cost = contact_costs["per_growth"] if "contact" in scene.effects else 0.0
    touch_share = lambda growth: max(0.0, growth - contact_costs["from"]) * touch_cost
    growth, pace, n_ramp, n_rest, n_touch, n_coarse = 1.0, _pace_in_balance(scene), 0, 0.0, 0.0, 0.0
    start, end = _fine_window(scene)
    for stage_number, stage in enumerate(scene.stages):
        ramp_before = n_ramp
        while growth < stage:
            growth = next_growth(growth, stage, STEPS_PER_MEASUREMENT * pace(growth) / per_unit)
            n_ramp += STEPS_PER_MEASUREMENT
            n_touch += STEPS_PER_MEASUREMENT * touch_share(growth)
            n_coarse += 0 if start <= growth < end else STEPS_PER_MEASUREMENT
        if not scene.not_nested:
            is_fine = start <= stage < end
            n_coarse += 0.0 if is_fine else crossing * COARSE_TICKS
            carried_ticks = 0.0 if is_fine else COARSE_TICKS + ENTRY_TICKS
            n_rest += crossing * (carried_ticks + scene.output.patience * FINE_TICKS)
        elif not scene.real_time:
            rest_ticks = rest_costs["smooth"]
            if stage > first_wrinkles(scene).growth:
                most_ticks = patience((n_ramp - ramp_before) / crossing if stage_number else None)
                rest_ticks = min(max(most_ticks, rest_costs["brief"]), rest_costs["folded"]) * scene.output.patience
            n_rest += crossing * rest_ticks
            n_touch += crossing * rest_ticks * touch_share(stage)
    if scene.real_time:  # real masses: the step shrinks as bricks do
        n_wait = n_ramp * COSTS["inertia"]["per_growth"] * (scene.growth.final - 1)
    else:
        fold_fraction = (scene.growth.final - wait_costs["from"]) / (wait_costs["to"] - wait_costs["from"])
        stiffness = scene.material.mu_ratio ** wait_costs["stiffness_power"]
        n_wait = min(max(fold_fraction, 0.0), 1.0) * wait_costs["ticks"] * stiffness * scene.growth.rate * crossing
    if not scene.not_nested:  # a tick takes fewer steps there
        crossings = [relative_crossing(s, edge_by_rule(s)) for s in (scene.coarse, scene)]
        n_saved = n_coarse * (1 - crossings[0] / crossings[1])
        n_coarse, n_ramp = n_coarse - n_saved, n_ramp - round(n_saved)
    expected = round(n_ramp + n_rest + n_wait)
    fewest, most = (round(n_ramp + (n_wait * wait_costs[key] + n_rest * rest_costs[key])) for key in ("fewest", "most"))
    growing, touching_share = (n_ramp + n_wait) / max(expected, 1), n_touch / (n_ramp + n_rest) if n_ramp else 0.0
    return Steps(expected, fewest, most, n_wait, growing, touching_share, 1 - n_coarse / max(expected, 1))


def _fine_window(scene: Scene) -> tuple[float, float]:
    """Growth between which a nested run is on its fine mesh, if walls touch when others did; all without nesting."""
    if scene.not_nested:
        return 1.0, math.inf
    onset = first_wrinkles(scene).growth
    contact = max(COSTS["contact"]["first"], onset) if "contact" in scene.effects else math.inf
    return 1 + WINDOW_START * (onset - 1), 1 + WINDOW_END * (contact - 1)


def _pace_in_balance(scene: Scene) -> Callable[[float], float]:
    """The pace of a body in balance as a function of growth, as a share of the full pace."""
    ramp, slow = scene.effects.get("ramp"), slow_growth(scene)
    ramp_pace = ramps.build(ramp, scene).pace if ramp else lambda growth: 1.0
    start_pace = (lambda growth: 1.0) if scene.real_time else soft_start
    return lambda growth: limited_pace(start_pace(growth), growth, slow) * ramp_pace(growth)


def body_bytes(scene: Scene, elements: int) -> tuple[float, float]:
    """Most bytes held at once while a body is built, and those that body and dynamics hold while steps are taken."""
    costs = COSTS["memory"]
    if scene.geometry.shape == "mesh":
        return costs["building_tet"] * elements, costs["per_tet"] * elements
    double = 0 if scene.accuracy.precision == "single" else costs["double"]
    passing_bytes = min((costs["building_brick"] - costs["built_brick"]) * elements, costs["most_building"])
    return (costs["built_brick"] + double) * elements + passing_bytes, (costs["per_brick"] + double) * elements


def coarse_elements(scene: Scene, sizes: Sizes) -> int:
    """Elements of the coarser one of two nested meshes, about: bricks go with the surface, and in the core with its
    edges."""
    return round(sizes.elements * scene.coarse.bricks / scene.bricks)


def memory_of_run(scene: Scene, sizes: Sizes) -> float:
    """Most memory of a whole process that only runs a scene [GiB]."""
    costs, (building_bytes, running_bytes) = COSTS["memory"], body_bytes(scene, sizes.elements)
    if not scene.not_nested:
        coarse_bytes = body_bytes(scene.coarse, coarse_elements(scene, sizes))[1]
        building_bytes, running_bytes = building_bytes + coarse_bytes, running_bytes + coarse_bytes
    stage_bytes = costs["stage_per_vertex"] * sizes.vertices
    stage_bytes += costs["stage_per_element"] * sizes.elements if scene.output.volume else 0.0
    return max(costs["importing"] + building_bytes / GiB, costs["process"] + (running_bytes + stage_bytes) / GiB)
