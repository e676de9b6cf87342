"""What maps and labels of a file of tetrahedra say: held nodes, thickness of the cortex, regions."""

import numpy as np
from numpy.typing import NDArray

from morphofold.arrays import Array, Ints
from morphofold.errors import DoesNotApply, ImpossibleBody, MissingPart, NotFinite, OutOfRange, TooLarge, UnknownName
from morphofold.sim.mesh.tetmesh import TetMesh
from morphofold.sim.scene import MeshFile
from morphofold.surface import Regions

MOST_REGIONS = 1000  # more are no parcellation
LARGEST_LABEL = 2**24 - 1  # each label has its own colour of 24 bits
COLOUR_STEP = 0x9E3779  # odd, so that all multiples below 2^24 differ


def held_nodes(geometry: MeshFile, body: TetMesh) -> Ints:
    """Nodes (H,) that never move: of inner surfaces, of labelled facets, and where a map is not zero.

    Raises
    ------
    DoesNotApply, MissingPart, UnknownName, NotFinite
        If there is no such part or map, or it holds no node.
    ImpossibleBody
        If all nodes are held.
    """
    name, parts = geometry.file, [np.empty(0, dtype=np.int64)]
    if geometry.held == "inner":
        if not len(body.inner):
            raise DoesNotApply(
                f"{name}: has no inner surface to hold (geometry.held = 'inner'); set held to 'nothing'."
            )
        parts.append(body.inner.ravel())
    if geometry.held_facets:
        key = "held_facets"
        corners = body.file.labelled_triangles(str(geometry.facets), geometry.held_facets, key)
        found = body.nodes(corners.ravel())
        if (found < 0).any():
            raise DoesNotApply(
                f"{name}: {(found < 0).reshape(-1, 3).any(axis=1).sum():,} of {len(corners):,} triangles of "
                f"geometry.{key} have corners in no tetrahedron; give labels of the body only."
            )
        parts.append(found)
    if geometry.held_map is not None:
        values = _finite(geometry, body, geometry.held_map, "held_map", body.used)
        if not values.any():
            raise DoesNotApply(
                f"{name}: point data {geometry.held_map!r} are 0 at all {len(values):,} nodes, so they hold nothing "
                "(geometry.held_map); leave it out."
            )
        parts.append(np.flatnonzero(values))
    held = np.unique(np.concatenate(parts))
    if len(held) == len(body.points):
        raise ImpossibleBody(
            f"{name}: all {len(held):,} nodes are held (geometry.held, held_facets, held_map); hold fewer."
        )
    return held


def thickness_excess(geometry: MeshFile, body: TetMesh) -> Array | None:
    """Factor on the thickness of the cortex minus 1 (N,), of the pial nodes only; None without ``thickness_map``.

    Raises
    ------
    UnknownName, NotFinite, OutOfRange
        If there is no such map, or a factor is not positive.
    """
    if geometry.thickness_map is None:
        return None
    pial = np.unique(body.pial)
    factor = _finite(geometry, body, geometry.thickness_map, "thickness_map", body.used[pial])
    if factor.min() <= 0:
        raise OutOfRange(
            f"{geometry.file}: point data {geometry.thickness_map!r} are {factor.min():g} to {factor.max():g} on the "
            f"pial surface, {(factor <= 0).sum():,} of {len(pial):,} not positive (geometry.thickness_map); they "
            "multiply the thickness of the cortex."
        )
    excess = np.zeros(len(body.points))
    excess[pial] = factor - 1
    return excess


def regions_of(geometry: MeshFile, body: TetMesh, surface: Ints) -> Regions | None:
    """Regions of the nodes ``surface`` (S,) by the data that ``regions`` names; None without it.

    Point data are the labels themselves; cell data give a node the label of most tetrahedra around it, the smallest of
    equally many. Labels of 0 and below are no region.

    Raises
    ------
    UnknownName, NotFinite, OutOfRange, TooLarge, MissingPart
        If there are no such data, or they are no labels.
    """
    key, file = geometry.regions, body.file
    if key is None:
        return None
    if key in file.point_maps():
        labels = _labels(geometry, file.point_map(key, "regions")[body.used[surface]])
    elif key in file.mesh.cell_data:
        labels = _commonest(body.tets, _labels(geometry, file.cell_values(key, "regions")), surface)
    else:
        there = ", ".join([*file.point_maps(), *file.mesh.cell_data][:8]) or "none"
        raise UnknownName(f"{file.name}: has no point or cell data {key!r} (geometry.regions); it has: {there}.")
    kinds = np.unique(labels[labels > 0])
    if not len(kinds):
        raise MissingPart(
            f"{file.name}: no pial vertex has a label above 0 by {key!r} (geometry.regions); leave it out."
        )
    if len(kinds) > MOST_REGIONS:
        raise TooLarge(
            f"{file.name}: {key!r} has {len(kinds):,} labels on the pial surface, more than {MOST_REGIONS:,} "
            "(geometry.regions); name data of regions."
        )
    colour = kinds * COLOUR_STEP % 2**24
    return Regions(
        np.where(labels > 0, np.searchsorted(kinds, labels), -1),
        tuple(f"region {kind}" for kind in kinds),
        np.stack([colour >> 16, colour >> 8 & 255, colour & 255], axis=1).astype(np.uint8),
    )


def _finite(geometry: MeshFile, body: TetMesh, name: str, key: str, points: Ints) -> Array:
    """Values of a map at points of the file, which must be finite."""
    values = body.file.point_map(name, key)[points]
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise NotFinite(
            f"{geometry.file}: point data {name!r} are not finite at {bad.size:,} of {len(values):,} nodes, the first "
            f"is point {points[bad[0]]} (geometry.{key}). Give every node a number."
        )
    return values


def _labels(geometry: MeshFile, values: NDArray[np.generic]) -> Ints:
    """Values as labels; they must be whole numbers."""
    number = np.asarray(values, dtype=np.float64)
    bad = np.flatnonzero(~((number == np.rint(number)) & (np.abs(number) <= LARGEST_LABEL)))
    if bad.size:
        raise OutOfRange(
            f"{geometry.file}: {bad.size:,} of {len(number):,} values of {geometry.regions!r} are no labels, the first "
            f"is {number[bad[0]]:g} (geometry.regions); give whole numbers of at most {LARGEST_LABEL}."
        )
    return number.astype(np.int64)


def _commonest(tets: Ints, labels: Ints, surface: Ints) -> Ints:
    """The label (S,) of most tetrahedra around each of the nodes ``surface``, the smallest of equally many."""
    place = np.full(int(tets.max()) + 1, -1)
    place[surface] = np.arange(len(surface))
    at = place[tets]
    kinds, kind = np.unique(labels, return_inverse=True)
    pair = (at * len(kinds) + kind[:, None])[at >= 0]
    pairs, count = np.unique(pair, return_counts=True)
    node, kind = np.divmod(pairs, len(kinds))
    order = np.lexsort((-kind, count, node))  # the last of each node is its commonest
    last = order[np.append(node[order][1:] != node[order][:-1], True)]
    return kinds[kind[last]]
