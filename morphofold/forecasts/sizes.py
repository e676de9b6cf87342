"""Numbers of elements and nodes of a scene's body, counted without building it, the edges that it can have, and the
memory of its run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from morphofold.errors import DoesNotApply
from morphofold.forecasts.table import costs

if TYPE_CHECKING:
    from morphofold.sim.mesh.brick_mesh import Bilayer
    from morphofold.sim.scene import Scene

GiB = 2**30


class Layers(NamedTuple):
    """Mean thickness of the cortex and mean depth of the core below it [mm]."""

    thickness: float
    depth: float


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
    import numpy as np

    X, n = bilayer.mesh.p.T, bilayer.n_surface
    white = bilayer.white @ X
    length = lambda a: float(np.linalg.norm(a, axis=1).mean())
    return Layers(length(X[:n] - white), length(white - X[-n:]))


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
    from morphofold.sim.scene import Ellipsoid, Patch, Sphere, Strip, UnfoldedCortex

    geometry = scene.geometry
    if isinstance(geometry, Sphere | Ellipsoid | UnfoldedCortex):
        return [(geometry.quarter, scene.cells)]
    if not isinstance(geometry, Patch | Strip):
        raise DoesNotApply(f"{scene.name}: a {geometry.shape} scene is not made of bricks.")
    lengths = geometry.size if isinstance(geometry, Patch) else (geometry.length,)
    return [(length, max(1, math.ceil(length / scene.edge - 1e-9))) for length in lengths]


def sizes_by_rule(scene: Scene, layers: Layers) -> Sizes:
    """Sizes of a body of bricks: quads of its surface times its layers.

    Raises
    ------
    DoesNotApply
        For a shape that isn't made of bricks.
    """
    from morphofold.sim.mesh.brick_mesh import SYMMETRY_AXES, core_layer_fractions
    from morphofold.sim.scene import Ellipsoid, Sphere, UnfoldedCortex

    geometry, through, edge = scene.geometry, scene.elements_through_cortex, edge_by_rule(scene)
    if isinstance(geometry, Sphere | Ellipsoid | UnfoldedCortex):
        n, cuts = scene.cells, len(SYMMETRY_AXES[getattr(geometry, "portion", "full")])
        quads, rim = 6 * n * n // 2**cuts, (0, 4 * n, 4 * n, 3 * n)[cuts]
        surface = quads + (rim // 2 + 1 if cuts else 2)  # Euler: a disc of quads, or a closed surface
        whole = 6 * n * n + 2
    else:
        cells = [c for _, c in _lengths_and_cells(scene)]
        quads, surface = math.prod(cells), math.prod(c + 1 for c in cells) * (1 if len(cells) == 2 else 2)
        whole = surface
    deep = through + len(core_layer_fractions(layers.thickness / through, layers.depth, edge)) - 1
    return Sizes(quads * deep, surface * (deep + 1), whole, edge)


def edges_between(scene: Scene, finest: float, coarsest: float) -> list[float]:
    """Largest surface edges [mm] at which the number of cells changes, from the coarsest to the finest one [mm].

    Rounded up in the fourth digit, which does not change the number of cells.
    """
    from morphofold.sim.scene import Patch, Strip

    length = max(length for length, _ in _lengths_and_cells(scene))
    step, least = (1, 1) if isinstance(scene.geometry, Patch | Strip) else (4, 4)
    first = max(least, step * math.ceil(length / coarsest / step - 1e-9))
    return [_rounded_up(length / cells) for cells in range(first, math.floor(length / finest + 1e-9) + 1, step)]


def _rounded_up(length: float) -> float:
    """A length rounded up to four digits."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 3)
    return round(math.ceil(length / unit - 1e-9) * unit, 12)


def building_bytes(elements: int, *, bricks: bool, single: bool = True) -> float:
    """Most bytes held at once while a body is built."""
    memory = costs()["memory"]
    if not bricks:
        return memory["building_tet"] * elements
    passing = (memory["building_brick"] - memory["built_brick"]) * elements
    built = memory["built_brick"] + (0 if single else memory["double"])
    return built * elements + min(passing, memory["most_building"])


def running_bytes(elements: int, *, bricks: bool, single: bool = True) -> float:
    """Bytes that body and dynamics hold while steps are taken."""
    memory = costs()["memory"]
    if not bricks:
        return memory["per_tet"] * elements
    return (memory["per_brick"] + (0 if single else memory["double"])) * elements


def memory_GiB(sizes: Sizes, *, bricks: bool, single: bool, volume: bool) -> float:
    """Most memory of a whole process that only runs a scene [GiB]."""
    memory = costs()["memory"]
    stage = memory["stage_per_vertex"] * sizes.vertices
    stage += memory["stage_per_element"] * sizes.elements if volume else 0.0
    building = memory["importing"] + building_bytes(sizes.elements, bricks=bricks, single=single) / GiB
    running = memory["process"] + (running_bytes(sizes.elements, bricks=bricks, single=single) + stage) / GiB
    return max(building, running)
