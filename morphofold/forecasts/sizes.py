"""How many elements and nodes a scene's body has, counted without building it, and the edges that it can have."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from morphofold.sim.mesh.bilayer import Bilayer
    from morphofold.sim.scene import Scene


class Layers(NamedTuple):
    """Mean thickness of the cortex and mean depth of the core below it [mm]."""

    thickness: float
    depth: float


class Sizes(NamedTuple):
    """Elements and nodes of a body, vertices of its surface (whole: mirrored to the closed one), largest edge [mm]."""

    elements: int
    nodes: int
    vertices: int
    edge: float


def sizes_of(bilayer: Bilayer) -> Sizes:
    """Sizes of a body that is built."""
    axes = len(bilayer.mirrored)
    vertices = bilayer.n_surface
    if axes and bilayer.faces.shape[1] == 4:                            # Euler: a closed surface of quads
        vertices = 2**axes * len(bilayer.faces) + 2
    return Sizes(int(bilayer.mesh.nelements), int(bilayer.mesh.nvertices), vertices, float(bilayer.edge))


def layers_of(bilayer: Bilayer) -> Layers:
    """Mean layers of a built body of bricks, as its builder took them."""
    import numpy as np

    X, n = bilayer.mesh.p.T, bilayer.n_surface
    white = bilayer.white @ X
    length = lambda a: float(np.linalg.norm(a, axis=1).mean())
    return Layers(length(X[:n] - white), length(white - X[-n:]))


def edge_by_rule(scene: Scene) -> float:
    """Largest surface edge [mm] of a body of bricks, no longer than the one that its scene asks for.

    Raises
    ------
    ValueError
        For a shape that isn't made of bricks.
    """
    from morphofold.sim.scene import Ellipsoid, Sphere

    if isinstance(scene.geometry, Sphere | Ellipsoid):
        return 0.5 * math.pi * max(scene.geometry.semi_axes) / scene.cells
    return max(length / cells for length, cells in _rows(scene))


def _rows(scene: Scene) -> list[tuple[float, int]]:
    """Lengths of a patch or strip [mm], and the cells along each."""
    from morphofold.sim.scene import Patch, Strip

    geometry = scene.geometry
    if not isinstance(geometry, Patch | Strip):
        raise ValueError(f"{scene.name}: a {geometry.shape} scene is not made of bricks.")
    lengths = geometry.size if isinstance(geometry, Patch) else (geometry.length,)
    return [(length, max(1, math.ceil(length / scene.edge - 1e-9))) for length in lengths]


def sizes_by_rule(scene: Scene, layers: Layers) -> Sizes:
    """Sizes of a body of bricks: quads of its surface, times its layers.

    Raises
    ------
    ValueError
        For a shape that isn't made of bricks.
    """
    from morphofold.sim.mesh.bilayer import PLANES, core_shares
    from morphofold.sim.scene import Ellipsoid, Sphere

    geometry, through, edge = scene.geometry, scene.elements_through_cortex, edge_by_rule(scene)
    if isinstance(geometry, Sphere | Ellipsoid):
        n, cuts = scene.cells, len(PLANES[geometry.portion])
        quads, rim = 6 * n * n // 2**cuts, (0, 4 * n, 4 * n, 3 * n)[cuts]
        surface = quads + (rim // 2 + 1 if cuts else 2)                 # Euler: a disc of quads, or a closed surface
        whole = 6 * n * n + 2
    else:
        cells = [c for _, c in _rows(scene)]
        quads, surface = math.prod(cells), math.prod(c + 1 for c in cells) * (1 if len(cells) == 2 else 2)
        whole = surface
    deep = through + len(core_shares(layers.thickness / through, layers.depth, edge)) - 1
    return Sizes(quads * deep, surface * (deep + 1), whole, edge)


def edges_between(scene: Scene, finest: float, coarsest: float) -> list[float]:
    """Largest surface edges [mm] at which the number of cells changes, from the coarsest to the finest one [mm].

    Rounded up in the fourth digit, which changes no number of cells.
    """
    from morphofold.sim.scene import Ellipsoid, Patch, Sphere, Strip

    geometry = scene.geometry
    if isinstance(geometry, Sphere | Ellipsoid):
        length, step = 0.5 * math.pi * max(geometry.semi_axes), 2
    elif isinstance(geometry, Patch | Strip):
        length, step = max(geometry.size) if isinstance(geometry, Patch) else geometry.length, 1
    else:
        raise ValueError(f"{scene.name}: a {geometry.shape} scene has no edge to choose.")
    first = max(4 if step == 2 else 1, step * math.ceil(length / coarsest / step - 1e-9))
    return [_up(length / cells) for cells in range(first, math.floor(length / finest + 1e-9) + 1, step)]


def _up(length: float) -> float:
    """A length with four digits, no less than it is."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 3)
    return round(math.ceil(length / unit - 1e-9) * unit, 12)
