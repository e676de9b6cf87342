"""Numbers of elements and nodes of a scene's body, counted without building it, the edges that it can have, and the
memory of its run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from morphofold.errors import DoesNotApply
from morphofold.forecasts.table import GiB, costs
from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, Bilayer, core_layer_fractions
from morphofold.sim.scene import Ellipsoid, Patch, Scene, Sphere, Strip, UnfoldedCortex

CUBED_SPHERES = (Sphere, Ellipsoid, UnfoldedCortex)
Layers = tuple[float, float]  # mean thickness of the cortex and mean depth of the core below it [mm]


class Sizes(NamedTuple):
    """Elements and nodes of a body, vertices of its whole surface (mirrored to a closed one), largest edge [mm]."""

    elements: int
    nodes: int
    vertices: int
    edge: float


def sizes_of(bilayer: Bilayer) -> Sizes:
    """Sizes of a built body."""
    axes = len(bilayer.mirrored)
    vertices = bilayer.n_surface
    if axes and bilayer.faces.shape[1] == 4:  # Euler: a closed surface of quads
        vertices = 2**axes * len(bilayer.faces) + 2
    return Sizes(int(bilayer.mesh.nelements), int(bilayer.mesh.nvertices), vertices, float(bilayer.edge))


def layers_of(bilayer: Bilayer) -> Layers:
    """Mean layers of a built body of bricks, as its builder used them."""
    X, n = bilayer.mesh.p.T, bilayer.n_surface
    white = bilayer.white @ X
    thickness, depth = (float(np.linalg.norm(a, axis=1).mean()) for a in (X[:n] - white, white - X[-n:]))
    return thickness, depth


def edge_by_rule(scene: Scene) -> float:
    """Largest surface edge [mm] of a body of bricks, at most the edge in its scene.

    Raises
    ------
    DoesNotApply
        For a shape that isn't made of bricks.
    """
    return max(length / cells for length, cells in _lengths_and_cells(scene))


def _lengths_and_cells(scene: Scene) -> list[tuple[float, int]]:
    """Lengths of a patch or strip, or of an edge of the cube of a cubed sphere [mm], and the cells along each."""
    geometry = scene.geometry
    if isinstance(geometry, CUBED_SPHERES):
        return [(geometry.quarter, scene.cells)]
    if not isinstance(geometry, Patch | Strip):
        raise DoesNotApply(f"{scene.name}: a {geometry.shape} scene is not made of bricks.")
    lengths = geometry.size if isinstance(geometry, Patch) else (geometry.length,)
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
    """Sizes of a body of bricks: quads of its surface times its layers.

    Raises
    ------
    DoesNotApply
        For a shape that isn't made of bricks.
    """
    geometry, through, edge = scene.geometry, scene.elements_through_cortex, edge_by_rule(scene)
    thickness, depth = layers
    if isinstance(geometry, CUBED_SPHERES):
        n, cuts = scene.cells, len(SYMMETRY_AXES[getattr(geometry, "portion", "full")])
        quads, rim = 6 * n * n // 2**cuts, (0, 4 * n, 4 * n, 3 * n)[cuts]
        surface = quads + (rim // 2 + 1 if cuts else 2)  # Euler: a disc of quads, or a closed surface
        whole = 6 * n * n + 2
    else:
        cells = [c for _, c in _lengths_and_cells(scene)]
        quads, surface = math.prod(cells), math.prod(c + 1 for c in cells) * (1 if len(cells) == 2 else 2)
        whole = surface
    deep = through + len(core_layer_fractions(thickness / through, depth, edge)) - 1
    return Sizes(quads * deep, surface * (deep + 1), whole, edge)


def edges_between(scene: Scene, finest: float, coarsest: float) -> list[float]:
    """Largest surface edges [mm] at which the number of cells changes, from the coarsest to the finest one [mm].

    Rounded up in the fourth digit, which does not change the number of cells.
    """
    length = max(length for length, _ in _lengths_and_cells(scene))
    step, least = (1, 1) if isinstance(scene.geometry, Patch | Strip) else (4, 4)
    first = max(least, step * math.ceil(length / coarsest / step - 1e-9))
    return [_rounded_up(length / cells) for cells in range(first, math.floor(length / finest + 1e-9) + 1, step)]


def _rounded_up(length: float) -> float:
    """A length rounded up to four digits."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 3)
    return round(math.ceil(length / unit - 1e-9) * unit, 12)


def body_bytes(scene: Scene, elements: int) -> tuple[float, float]:
    """Most bytes held at once while a body is built, and those that body and dynamics hold while steps are taken."""
    memory = costs()["memory"]
    if scene.geometry.shape == "mesh":
        return memory["building_tet"] * elements, memory["per_tet"] * elements
    double = 0 if scene.accuracy.precision == "single" else memory["double"]
    passing = min((memory["building_brick"] - memory["built_brick"]) * elements, memory["most_building"])
    return (memory["built_brick"] + double) * elements + passing, (memory["per_brick"] + double) * elements


def memory_of_run(scene: Scene, sizes: Sizes) -> float:
    """Most memory of a whole process that only runs a scene [GiB]."""
    memory, (building, running) = costs()["memory"], body_bytes(scene, sizes.elements)
    stage = memory["stage_per_vertex"] * sizes.vertices
    stage += memory["stage_per_element"] * sizes.elements if scene.output.volume else 0.0
    return max(memory["importing"] + building / GiB, memory["process"] + (running + stage) / GiB)
