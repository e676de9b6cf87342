"""What ``accuracy`` changes: the mesh on which thicknesses and the gyral net are measured, and a voxel.

A copy of a cortex is thinned (draft) or split (fine), white and pial alike, and what is measured on it is carried back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis.graph.gyral_graph import ClosestPoints, gyral_graph
from morphofold.analysis.mesh_quality import checks
from morphofold.analysis.thickness.cortical import cortical_thickness
from morphofold.analysis.thickness.gyral import GyralThickness, gyral_thickness
from morphofold.arrays import Ints
from morphofold.errors import UnknownName
from morphofold.surface import Cortex, Faces, PerVertex, Surface

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True)
class Preset:
    """One setting of the measuring room.

    Attributes
    ----------
    most, least : int
        Vertices of a hemisphere to which its copy is thinned if it has more, and below which triangles are cut in four
        (once: twice brings nothing more); 0: never.
    voxels : float
        Of local gyrification, in the radius of its closing.
    """

    most: int
    least: int
    voxels: float


#: docs/accuracy.md has their errors and times, and where they are on the fronts of both
PRESETS = {"draft": Preset(50_000, 0, 6.0), "standard": Preset(0, 0, 12.0), "fine": Preset(0, 40_000, 20.0)}


def accuracy_of(name: str) -> Preset:
    """Raises ``UnknownName`` for a name that is none of ``PRESETS``."""
    if name not in PRESETS:
        raise UnknownName(f"accuracy must be one of {', '.join(PRESETS)}, got {name!r}.")
    return PRESETS[name]


@dataclass(frozen=True, eq=False)
class Resampled:
    """The cortex that thicknesses and the net are measured on, and where its parts lie in the original.

    Attributes
    ----------
    of, cortex : Cortex
        The original, of N vertices, and the copy, of n.
    place : (N,) int64
        Vertex of the copy that each of the original became; -1 where no face used it.
    source : (n,) int64
        Vertex of the original that each of the copy stands for.
    triangle : (m,) int64
        Triangle of the original beside each of the copy.
    """

    of: Cortex
    cortex: Cortex
    place: Ints = field(repr=False)
    source: Ints = field(repr=False)
    triangle: Ints = field(repr=False)

    @property
    def changed(self) -> bool:
        return self.cortex is not self.of

    def cortical_thickness(self, **options: Any) -> PerVertex:
        """As :func:`morphofold.analysis.cortical_thickness` (N,)."""
        return self._back(cortical_thickness(self.cortex.white, self.cortex.pial, **options))

    def gyral_thickness(self, **options: Any) -> GyralThickness:
        """As :func:`morphofold.analysis.gyral_thickness`; ``triangle``, maps and relief are of the original."""
        if self.changed and options.get("mask") is not None:
            options["mask"] = np.asarray(options["mask"])[self.source]
        found = gyral_thickness(self.cortex, **options)
        if not self.changed:
            return found
        relief, back = found.relief, self._back
        there = replace(
            relief,
            height=back(relief.height),
            amplitude=back(relief.amplitude),
            phase=back(relief.phase),
            vertical=np.column_stack([back(part) for part in relief.vertical.T]),
        )
        return replace(found, triangle=self.triangle[found.triangle], per_vertex=back(found.per_vertex), relief=there)

    def gyral_graph(self, width: float | None, *, midway: bool = False) -> nx.MultiGraph:
        """As :func:`morphofold.analysis.gyral_graph`, its places and vertices on the original's white surface.

        ``midway``: of the surface half way between white and pial, and there. Where white crosses itself, its crowns
        are gone, and spikes in their place set the width.
        """
        graph = gyral_graph(_midway(self.cortex) if midway else self.cortex, width=width)
        if self.changed:
            white = (_midway(self.of) if midway else self.of).white
            closest = ClosestPoints(white.verts, white.faces, cKDTree(white.verts))
            for _, node in graph.nodes(data=True):
                place, vertex = closest.of(node["position"][None])
                node.update(position=place[0], vertex=int(vertex[0]))
            for *_, crest in graph.edges(data=True):
                crest["polyline"], crest["vertices"] = closest.of(crest["polyline"])
        return graph

    def _back(self, values: PerVertex) -> PerVertex:
        return np.where(self.place < 0, np.nan, values[self.place]) if self.changed else values


def resampled(cortex: Cortex, accuracy: Preset) -> Resampled:
    """The cortex thinned or split as ``accuracy`` says; itself where it has vertices enough and not too many."""
    n = len(np.unique(cortex.faces))
    if accuracy.most and n > accuracy.most:
        return _thinned(cortex, accuracy.most / n)
    every = np.arange(cortex.n_vertices)
    same = Resampled(cortex, cortex, every, every, np.arange(len(cortex.faces)))
    return _split(same) if n < accuracy.least else same


def parameters(name: str, copy: Resampled) -> dict[str, Any]:
    """What to record of an accuracy by its name, and of the copy that it led to."""
    from morphofold.analysis.gyrification.local_gyrification import CLOSING

    return {
        "accuracy": name,
        "accuracy_vertices": copy.cortex.n_vertices,
        "local_gyrification_voxel_mm": CLOSING / accuracy_of(name).voxels,
    }


def _thinned(cortex: Cortex, keep: float) -> Resampled:
    """A share of the vertices, by quadric errors of the surface midway, the same edges collapsed on white and pial.

    Collapses may pinch the surface at a few places, so that it is no longer closed there: what is measured on the copy
    does not ask for that.
    """
    from fast_simplification import replay_simplification, simplify

    faces, middle = cortex.faces.astype(np.int32), cortex.pial.verts.mean(axis=0)
    white, pial = ((s.verts - middle).astype(np.float32) for s in (cortex.white, cortex.pial))
    *_, collapses = simplify((white + pial) / 2, faces, 1.0 - keep, return_collapses=True, preserve_border=True)
    (inner, fewer, place), (outer, *_) = (replay_simplification(verts, faces, collapses) for verts in (white, pial))
    place = place.astype(np.int64)
    used = np.flatnonzero(place >= 0)
    away = np.linalg.norm(((white + pial) - (inner + outer)[place])[used], axis=1)
    order = np.lexsort((away, place[used]))  # of each resampled vertex the nearest one first
    _, first = np.unique(place[used][order], return_index=True)
    source = used[order][first]
    ring = geometry.incident_faces(cortex.n_vertices, cortex.faces)
    triangle = ring.indices[ring.indptr[source[fewer[:, 0]]]].astype(np.int64)
    return Resampled(cortex, _on(cortex, inner + middle, outer + middle, fewer, source), place, source, triangle)


def _split(same: Resampled) -> Resampled:
    """Every triangle cut in four, in the surface as it is; the original's vertices come first."""
    cortex, faces = same.of, same.of.faces
    source = np.concatenate([same.source, geometry.edges(faces)[:, 0]])
    (white, finer), (pial, _) = (geometry.split(surface.verts, faces) for surface in (cortex.white, cortex.pial))
    copy = _on(cortex, white, pial, finer, source)
    return replace(same, cortex=copy, source=source, triangle=np.tile(same.triangle, 4))


def _midway(cortex: Cortex) -> Cortex:
    """The cortex with the surface half way to pial in place of white."""
    white, pial = cortex.white, cortex.pial
    name = f"half way from {white.name} to {pial.name}"
    return replace(cortex, white=Surface((white.verts + pial.verts) / 2, cortex.faces, name))


def _on(cortex: Cortex, white: NDArray[Any], pial: NDArray[Any], faces: Faces, source: Ints) -> Cortex:
    """The cortex with other surfaces and the mask of its own."""
    return replace(
        cortex,
        white=Surface(white, faces, cortex.white.name),
        pial=Surface(pial, faces, cortex.pial.name),
        maps={},
        cortex=checks.cortex_mask(cortex)[source],
        regions=None,
        inflated=None,
    )
