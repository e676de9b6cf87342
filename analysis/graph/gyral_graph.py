"""The gyral graph: one net of gyral crests over a surface, its junctions the hinges of gyri."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.analysis.graph.confidence import label_hinges
from morphofold.analysis.graph.crest_net import CrestNetBuilder, Fields, GyralScales
from morphofold.analysis.graph.depth_potential import persistence
from morphofold.analysis.graph.net import Net, resampled
from morphofold.analysis.graph.refine import refine, upright
from morphofold.geometry import incident_faces
from morphofold.geometry.kernels import closest_in_triangle
from morphofold.surface import Cortex, Faces, Surface, Verts

if TYPE_CHECKING:
    import networkx as nx


def gyral_graph(
    surface: Cortex | Surface, *, width: float | None = None, scales: GyralScales | None = None
) -> nx.MultiGraph:
    """The net of gyral crests and their hinges.

    Parameters
    ----------
    surface : Cortex or Surface
        Of a cortex the white surface is taken, whose crowns are sharp and whose sulci are open, and its mask. A closed
        surface, or one with a natural border.
    width : float, optional
        Gyral width [mm]; None: measured (:meth:`SurfaceOperators.gyral_width`). Pass one to compare meshes of one
        brain.
    scales : GyralScales, optional
        All lengths, instead of ``width``.

    Returns
    -------
    networkx.MultiGraph
        Nodes, numbered from 0, have ``position`` (3,) [mm] on the surface, ``vertex`` the nearest one, ``normal`` (3,)
        of its surroundings, ``degree`` (a loop counts twice), ``persistence`` [mm] up to which the node is a hinge if
        nothing else is changed (NaN for one that owes it to a dead-end gyrus), ``confidence`` 0 to 1 of a hinge
        (:func:`~morphofold.analysis.graph.confidence.label_hinges`; NaN for an end), ``cut`` where the mask or the
        border ends a crest. Edges have ``polyline`` (P, 3) [mm] from the smaller node to the larger, ``vertices`` (P,)
        nearest to it, ``length`` [mm], ``altitude`` the median and ``lowest`` the least depth potential along it [mm],
        ``strength`` [mm], ``curvature`` the mean of the geodesic curvature without sign [1/mm], the turns of the curve
        within the surface in steps of half a gyral width over its length, ``blind``, and their ``number`` from 0.
        ``graph.graph`` has ``scales`` (a ``GyralScales`` or None), ``surface``, ``edge`` [mm] and ``wavelength`` [mm],
        as that of :func:`morphofold.analysis.wavelength`, NaN without folds. Empty if the surface has no folds.

    Raises
    ------
    ValueError
        If a length is not positive, or both ``width`` and ``scales`` are given.

    Notes
    -----
    1. Depth potential (:meth:`SurfaceOperators.depth_potential`), high on crowns, flooded:
       borders of its basins, joined if they persist less than ``persistence`` or 0.2 of its range, are the net,
       connected by construction.
    2. Of its crests those go whose *strength*, the median of the potential less itself smoothed over a width, is less
       than 0.15 of that of the strongest tenth of the net: borders across wide floors and down in sulci.
    3. Junctions nearer than ``merge`` become one, spurs shorter than ``prune`` and loops shorter than a width go.
    4. Crowns that reach farther than ``tip`` from the net get a crest (:func:`add_dead_ends`), and step 3 again.
    5. Crests move onto the crown, hinges to where their arms meet (:func:`refine`).

    ``sum(degree - 2)`` over nodes is twice the number of independent loops less that of components.
    """
    import networkx as nx

    builder = CrestNetBuilder(surface)
    operators = builder.operators
    chosen = builder.scales(width, scales)
    graph = nx.MultiGraph(scales=chosen, surface=builder.sheet.name, edge=operators.edge, wavelength=np.nan)
    if chosen is not None:
        fields = builder.fields(chosen)
        graph.graph["wavelength"] = operators.wavelength(fields.D)
        net = builder.net(fields, chosen)
        refine(net, operators, fields.D, chosen.width)
        _describe(graph, net, builder, fields)
    return graph


def _describe(graph: nx.MultiGraph, net: Net, builder: CrestNetBuilder, fields: Fields) -> None:
    """Nodes and edges of the graph, in an order that depends on their places alone."""
    D, band, scales = fields.D, fields.band, graph.graph["scales"]
    closest = ClosestPoints(builder.operators.verts, builder.operators.faces, builder.tree)
    number = {node: k for k, node in enumerate(sorted(net.nodes, key=lambda node: tuple(net.nodes[node].at)))}
    degrees, least = net.degrees(), persistence(D, scales.persistence)
    held = fields.flood.apart([net.nodes[node].basins for node in number], 3, least)
    for node, lasting in zip(number, held.tolist()):
        here = net.nodes[node]
        place, vertex = closest.of(here.at[None])
        graph.add_node(
            number[node],
            position=place[0],
            vertex=int(vertex[0]),
            degree=degrees[node],
            cut=here.cut,
            normal=upright(builder.operators, builder.tree, here.at, scales.width),
            persistence=lasting if degrees[node] > 2 else np.nan,
        )
    arcs = [arc if number[arc.a] <= number[arc.b] else arc.turned() for arc in net.arcs.values()]
    for arc in sorted(arcs, key=lambda arc: (number[arc.a], number[arc.b], arc.length)):
        line, vertices = closest.of(arc.points)
        graph.add_edge(
            number[arc.a],
            number[arc.b],
            polyline=line,
            vertices=vertices,
            blind=arc.blind,
            length=arc.length,
            altitude=float(np.median(D[vertices])),
            lowest=float(D[vertices].min()),
            strength=float(np.median(band[vertices])),
            curvature=_turning(arc.points, builder, 0.5 * scales.width),
        )
    for k, (*_, crest) in enumerate(graph.edges(data=True)):
        crest["number"] = k
    label_hinges(graph, D, least)


def _turning(points: NDArray[np.float64], builder: CrestNetBuilder, step: float) -> float:
    coarse = resampled(points, step)
    normal = builder.operators.normals[builder.tree.query(coarse[1:-1])[1]]
    before, after = np.diff(coarse, axis=0)[:-1], np.diff(coarse, axis=0)[1:]
    turn = np.arctan2(np.sum(np.cross(before, after) * normal, axis=1), np.sum(before * after, axis=1))
    length = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).sum())
    return float(np.abs(turn).sum()) / length if length > 0 else 0.0


class ClosestPoints:
    """The points of a surface nearest to points close to it; ``tree`` is of its vertices."""

    def __init__(self, verts: Verts, faces: Faces, tree: cKDTree):
        self._verts, self._faces, self._tree = verts, faces, tree
        self._around = incident_faces(len(verts), faces)

    def of(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Places (P, 3), and the nearest vertices (P,): those of the triangles there."""
        nearest = self._tree.query(points)[1]
        places = _nearest_places(points, nearest, self._verts, self._faces, self._around.indptr, self._around.indices)
        return places, nearest


@njit(cache=True)
def _nearest_places(points, nearest, verts, faces, indptr, indices):
    places = verts[nearest]
    for i in range(len(points)):
        p, best = points[i], np.inf
        for e in range(indptr[nearest[i]], indptr[nearest[i] + 1]):
            a, b, c = faces[indices[e]]
            s, t = closest_in_triangle(p, verts[a], verts[b], verts[c])
            place = (1 - s - t) * verts[a] + s * verts[b] + t * verts[c]
            far = np.sum((place - p) ** 2)
            if far < best:
                best, places[i] = far, place
    return places
