"""Effects of ``accuracy``: the mesh on which thicknesses and the gyral net are measured, and a voxel size.

White and pial are thinned (draft) or split (fine) in the same way, and the results are carried back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold import geometry
from morphofold.analysis.graph.gyral_graph import closest_points, gyral_graph
from morphofold.analysis.thickness.cortical_thickness import cortical_thickness
from morphofold.analysis.thickness.gyral_thickness import GyralThickness, gyral_thickness
from morphofold.frozen_arrays import Ints
from morphofold.mesh_quality import cortex_checks
from morphofold.surface import Cortex, Faces, PerVertex, Surface
from morphofold.threads import SIMPLIFY_LOCK
from morphofold.validators import one_of

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True)
class Preset:
    """One setting of the accuracy of the analysis.

    Attributes
    ----------
    most_vertices, least_vertices : int
        Number of vertices to which a hemisphere is thinned if it has more, and below which each triangle is split into
        four (once: twice gives no further gain); 0: never.
    radius_voxels : float
        Voxels of local gyrification per radius of its closing.
    """

    most_vertices: int
    least_vertices: int
    radius_voxels: float


#: docs/accuracy.md has their errors and times, and their place on the fronts of error against time
PRESETS = {"draft": Preset(50_000, 0, 6.0), "standard": Preset(0, 0, 12.0), "fine": Preset(0, 40_000, 20.0)}


def accuracy_of(name: str) -> Preset:
    """The preset of that name; raises ``UnknownName`` for a name that is not in ``PRESETS``."""
    one_of(name, PRESETS, "accuracy")
    return PRESETS[name]


@dataclass(frozen=True, eq=False, repr=False)
class Resampled:
    """The cortex on which thicknesses and the net are measured, and how its parts correspond to the original.

    Attributes
    ----------
    original, cortex : Cortex
        The original with N vertices, and the resampled cortex with n.
    target : (N,) int64
        Resampled vertex of each original vertex; -1 where no face used it.
    source : (n,) int64
        Original vertex of each resampled vertex.
    triangle : (m,) int64
        Original triangle next to each resampled triangle.
    """

    original: Cortex
    cortex: Cortex
    target: Ints
    source: Ints
    triangle: Ints

    @property
    def changed(self) -> bool:
        return self.cortex is not self.original

    def cortical_thickness(self, **options: Any) -> PerVertex:
        """As :func:`morphofold.analysis.cortical_thickness` (N,)."""
        return self._back(cortical_thickness(self.cortex.white, self.cortex.pial, **options))

    def gyral_thickness(self, **options: Any) -> GyralThickness:
        """As :func:`morphofold.analysis.gyral_thickness`; ``triangle``, maps and relief refer to the original."""
        if self.changed and options.get("mask") is not None:
            options["mask"] = np.asarray(options["mask"])[self.source]
        thickness = gyral_thickness(self.cortex, **options)
        if not self.changed:
            return thickness
        relief, triangle = thickness.relief, self.triangle[thickness.triangle]
        maps: dict[str, Any] = {name: self._back(getattr(relief, name)) for name in ("height", "amplitude", "phase")}
        vertical = np.column_stack([self._back(component) for component in relief.vertical.T])
        full_relief = replace(relief, vertical=vertical, **maps)
        return replace(thickness, triangle=triangle, per_vertex=self._back(thickness.per_vertex), relief=full_relief)

    def gyral_graph(self, width: float | None, *, use_midway: bool = False) -> nx.MultiGraph:
        """As :func:`morphofold.analysis.gyral_graph`, with positions and vertices on the original white surface.

        ``use_midway``: use the surface midway between white and pial instead. Where white intersects itself, its crowns
        are lost, and spikes in their place would set the width.
        """
        graph = gyral_graph(_with_midway_surface(self.cortex) if use_midway else self.cortex, width=width)
        if self.changed:
            white = (_with_midway_surface(self.original) if use_midway else self.original).white
            tree = cKDTree(white.verts)
            for _, node in graph.nodes(data=True):
                point, vertex = closest_points(white, tree, node["position"][None])
                node.update(position=point[0], vertex=int(vertex[0]))
            for *_, crest in graph.edges(data=True):
                crest["polyline"], crest["vertices"] = closest_points(white, tree, crest["polyline"])
        return graph

    def _back(self, values: PerVertex) -> PerVertex:
        return np.where(self.target < 0, np.nan, values[self.target]) if self.changed else values


def resampled(cortex: Cortex, preset: Preset) -> Resampled:
    """The cortex thinned or split according to ``preset``; unchanged if its number of vertices is within bounds."""
    n_used = np.count_nonzero(geometry.used(cortex.n_vertices, cortex.faces))
    if preset.most_vertices and n_used > preset.most_vertices:
        return _thinned_cortex(cortex, preset.most_vertices / n_used)
    return _split_triangles(as_given(cortex)) if n_used < preset.least_vertices else as_given(cortex)


def as_given(cortex: Cortex) -> Resampled:
    """The cortex as it is."""
    all_vertices = np.arange(cortex.n_vertices)
    return Resampled(cortex, cortex, all_vertices, all_vertices, np.arange(len(cortex.faces)))


def _thinned_cortex(cortex: Cortex, share: float) -> Resampled:
    """The cortex with the ``share`` of its vertices, thinned by quadric errors of the surface midway.

    The same edges are collapsed on white and pial. Collapses may pinch the surface at a few places, so it is no longer
    closed there. The measures on this surface do not need it to be closed.
    """
    from fast_simplification import replay_simplification, simplify

    faces, centre = cortex.faces.astype(np.int32), cortex.pial.verts.mean(axis=0)
    white, pial = ((surface.verts - centre).astype(np.float32) for surface in (cortex.white, cortex.pial))
    with SIMPLIFY_LOCK:
        *_, collapses = simplify((white + pial) / 2, faces, 1.0 - share, return_collapses=True, preserve_border=True)
        thin_white, thin_faces, target = replay_simplification(white, faces, collapses)
        thin_pial = replay_simplification(pial, faces, collapses)[0]
    target = target.astype(np.int64)
    used_vertices = np.flatnonzero(target >= 0)
    displacement = np.linalg.norm(((white + pial) - (thin_white + thin_pial)[target])[used_vertices], axis=1)
    sort_order = np.lexsort((displacement, target[used_vertices]))  # of each resampled vertex the nearest one first
    _, first_rows = np.unique(target[used_vertices][sort_order], return_index=True)
    source = used_vertices[sort_order][first_rows]
    vertex_faces = geometry.incident_faces(cortex.n_vertices, cortex.faces)
    triangle = vertex_faces.indices[vertex_faces.indptr[source[thin_faces[:, 0]]]].astype(np.int64)
    thin_cortex = _with_surfaces(cortex, thin_white + centre, thin_pial + centre, thin_faces, source)
    return Resampled(cortex, thin_cortex, target, source, triangle)


def _split_triangles(unsplit: Resampled) -> Resampled:
    """Every triangle split into four flat ones; the original vertices come first."""
    cortex, faces = unsplit.original, unsplit.original.faces
    source = np.concatenate([unsplit.source, geometry.edges(faces)[:, 0]])
    (white, split_faces), (pial, _) = (geometry.split(surface.verts, faces) for surface in (cortex.white, cortex.pial))
    split_cortex = _with_surfaces(cortex, white, pial, split_faces, source)
    return replace(unsplit, cortex=split_cortex, source=source, triangle=np.tile(unsplit.triangle, 4))


def _with_midway_surface(cortex: Cortex) -> Cortex:
    """The cortex with the surface midway to pial in place of white."""
    white, pial = cortex.white, cortex.pial
    name = f"the surface midway between {white.name} and {pial.name}"
    return replace(cortex, white=Surface((white.verts + pial.verts) / 2, cortex.faces, name))


def _with_surfaces(cortex: Cortex, white: NDArray[Any], pial: NDArray[Any], faces: Faces, source: Ints) -> Cortex:
    """The cortex with other surfaces and its own mask."""
    return replace(
        cortex,
        white=Surface(white, faces, cortex.white.name),
        pial=Surface(pial, faces, cortex.pial.name),
        maps={},
        cortex=cortex_checks.cortex_mask(cortex)[source],
        regions=None,
        inflated=None,
        sphere=None,
    )
