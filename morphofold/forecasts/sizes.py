"""How large a run will be, by formulas: a scene, or a body already built, in; its elements and nodes, time steps and
memory [GiB] out, and the edges that its mesh can have.

It times nothing, as ``forecasting`` does. ``mesh_choice`` and ``richardson`` call it, too.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from morphofold.errors import DoesNotApply
from morphofold.forecasts.cost import COSTS, GiB
from morphofold.sim.dynamics import STEPS_PER_MEASUREMENT, limited_pace, next_growth, patience, soft_start
from morphofold.sim.effects import ramp as ramps
from morphofold.sim.equilibrium.wrinkles import first_wrinkles, slow_growth
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, Bilayer, core_layer_fractions
from morphofold.sim.scene import Patch, Scene, Strip
from morphofold.words import rounded_up

Layers = tuple[float, float]  # mean thickness of the cortex and mean depth of the core below it [mm]


class Sizes(NamedTuple):
    """Elements and nodes of a body, vertices of its whole surface (mirrored to a closed one), largest edge [mm]."""

    elements: int
    nodes: int
    vertices: int
    edge: float


def sizes_of(bilayer: Bilayer) -> Sizes:
    """Sizes of a built body."""
    axes, vertices = len(bilayer.mirrored), bilayer.n_surface
    if axes and bilayer.faces.shape[1] == 4:  # Euler: a closed surface of quads
        vertices = 2**axes * len(bilayer.faces) + 2
    return Sizes(bilayer.mesh.nelements, int(bilayer.mesh.nvertices), vertices, bilayer.edge)


def layers_of(bilayer: Bilayer) -> Layers:
    """Mean layers of a built body of bricks, as its builder used them."""
    X, n = bilayer.mesh.p.T, bilayer.n_surface
    white = bilayer.white @ X
    thickness, depth = (float(np.linalg.norm(a, axis=1).mean()) for a in (X[:n] - white, white - X[-n:]))
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
        why = "its mesh comes from a file" if shape == "mesh" else "it is solved in one dimension"
        raise DoesNotApply(f"{purpose}, but {scene.name} (shape {shape!r}) has none: {why}. Leave it out.")


def sizes_by_rule(scene: Scene, layers: Layers) -> Sizes:
    """Sizes of a body of bricks: quads of its surface times its layers."""
    through, edge, cells = scene.elements_through_cortex, edge_by_rule(scene), [n for _, n in _lengths_and_cells(scene)]
    thickness, depth = layers
    if isinstance(scene.geometry, Patch | Strip):
        quads, surface = math.prod(cells), math.prod(n + 1 for n in cells)
        whole = surface
    else:
        n, cuts = cells[0], len(SYMMETRY_AXES[getattr(scene.geometry, "portion", "full")])
        quads, rim = 6 * n * n // 2**cuts, (0, 4 * n, 4 * n, 3 * n)[cuts]
        surface = quads + (rim // 2 + 1 if cuts else 2)  # Euler: a disc of quads, or a closed surface
        whole = 6 * n * n + 2
    deep = through + len(core_layer_fractions(thickness / through, depth, edge)) - 1
    return Sizes(quads * deep, surface * (deep + 1), whole, edge)


def edges_between(scene: Scene, finest: float, coarsest: float) -> list[float]:
    """Largest surface edges [mm] at which the number of cells changes, from the coarsest to the finest one [mm].

    Rounded up in the fourth digit, which does not change the number of cells.
    """
    length = max(length for length, _ in _lengths_and_cells(scene))
    step = 1 if isinstance(scene.geometry, Patch | Strip) else 4
    first = max(step, step * math.ceil(length / coarsest / step - 1e-9))
    cells = range(first, math.floor(length / finest + 1e-9) + 1, step)
    return [round(rounded_up(length / n, 4), 12) for n in cells]


def relative_crossing(scene: Scene, edge: float) -> float:
    """Steps in which a wave crosses the cortex, up to a factor, with surface edges of length ``edge`` [mm]."""
    law, T, layers = COSTS["crossing"], scene.geometry.cortex_thickness, scene.elements_through_cortex
    mass = np.interp(edge * layers / T, law["flatness"], law["mass"])
    mass /= np.interp(2 * edge / T / (layers + 1), law["coarseness"], law["lightness"])
    return math.sqrt(mass * (law["through"] * layers**2 + (T / edge) ** 2))


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
    """

    expected: int
    fewest: int
    most: int
    waiting: float
    growing: float
    touching: float


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
    waits, resting, contact = COSTS["waiting"], COSTS["resting"], COSTS["contact"]
    per_growth = contact["per_growth"] if "contact" in scene.effects else 0.0
    touching = lambda growth: max(0.0, growth - contact["from"]) * per_growth
    growth, pace, ramp, rested, touched = 1.0, _pace_in_balance(scene), 0, 0.0, 0.0
    for k, stage in enumerate(scene.stages):
        begun = ramp
        while growth < stage:
            growth = next_growth(growth, stage, STEPS_PER_MEASUREMENT * pace(growth) / per_unit)
            ramp += STEPS_PER_MEASUREMENT
            touched += STEPS_PER_MEASUREMENT * touching(growth)
        if not scene.real_time:
            ticks = resting["smooth"]
            if stage > first_wrinkles(scene).growth:
                longest = patience((ramp - begun) / crossing if k else None)
                ticks = min(max(longest, resting["brief"]), resting["folded"])
            rested += crossing * ticks
            touched += crossing * ticks * touching(stage)
    if scene.real_time:  # real masses: the step shrinks as bricks do
        waiting = ramp * COSTS["inertia"]["per_growth"] * (scene.growth.final - 1)
    else:
        folded = (scene.growth.final - waits["from"]) / (waits["to"] - waits["from"])
        stiff = scene.material.mu_ratio ** waits["stiffness_power"]
        waiting = min(max(folded, 0.0), 1.0) * waits["ticks"] * stiff * scene.growth.rate * crossing
    expected = round(ramp + rested + waiting)
    fewest, most = (round(ramp + (waiting * waits[key] + rested * resting[key])) for key in ("fewest", "most"))
    growing, touching_share = (ramp + waiting) / max(expected, 1), touched / (ramp + rested) if ramp else 0.0
    return Steps(expected, fewest, most, waiting, growing, touching_share)


def _pace_in_balance(scene: Scene) -> Callable[[float], float]:
    """The pace of a body in balance as a function of growth, as a share of the full pace."""
    ramp, slow = scene.effects.get("ramp"), slow_growth(scene)
    shape = ramps.build(ramp, scene).pace if ramp else lambda growth: 1.0
    start = (lambda growth: 1.0) if scene.real_time else soft_start
    return lambda growth: limited_pace(start(growth), growth, slow) * shape(growth)


def body_bytes(scene: Scene, elements: int) -> tuple[float, float]:
    """Most bytes held at once while a body is built, and those that body and dynamics hold while steps are taken."""
    memory = COSTS["memory"]
    if scene.geometry.shape == "mesh":
        return memory["building_tet"] * elements, memory["per_tet"] * elements
    double = 0 if scene.accuracy.precision == "single" else memory["double"]
    passing = min((memory["building_brick"] - memory["built_brick"]) * elements, memory["most_building"])
    return (memory["built_brick"] + double) * elements + passing, (memory["per_brick"] + double) * elements


def memory_of_run(scene: Scene, sizes: Sizes) -> float:
    """Most memory of a whole process that only runs a scene [GiB]."""
    memory, (building, running) = COSTS["memory"], body_bytes(scene, sizes.elements)
    stage = memory["stage_per_vertex"] * sizes.vertices
    stage += memory["stage_per_element"] * sizes.elements if scene.output.volume else 0.0
    return max(memory["importing"] + building / GiB, memory["process"] + (running + stage) / GiB)
