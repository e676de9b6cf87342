"""The gyral graph: a net of gyral crests over a surface. Its junctions are the gyral hinges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from morphofold.analysis.graph.curve_net import Net, resampled
from morphofold.analysis.graph.depth_potential import persistence
from morphofold.analysis.graph.hinges import label_hinges
from morphofold.analysis.graph.net_builder import CrestNetBuilder, Fields, GyralScales
from morphofold.analysis.graph.net_refinement import refine, upright
from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import closest_in_triangle, corners, dot, incident_faces, less, position, weighted
from morphofold.kernels import kernel, reading
from morphofold.surface import Cortex, Surface

if TYPE_CHECKING:
    import networkx as nx


def gyral_graph(
    surface: Cortex | Surface, *, width: float | None = None, scales: GyralScales | None = None
) -> nx.MultiGraph:
    """The net of gyral crests and their hinges.

    Parameters
    ----------
    surface : Cortex or Surface
        For a cortex, the mask and the white surface are used, because white has sharp crowns and open sulci. A Surface
        must be closed, or have a natural border.
    width : float, optional
        Crown width [mm]; None: measured (:meth:`SurfaceOperators.gyral_width`). Pass a number to compare meshes of one
        brain.
    scales : GyralScales, optional
        All lengths, instead of ``width``.

    Returns
    -------
    networkx.MultiGraph
        Empty if the surface has no folds. Nodes are numbered from 0 and have:

        - ``position`` (3,) [mm] on the surface, ``vertex``, the nearest one, and ``normal`` (3,) of its surroundings;
        - ``degree`` (a loop counts twice);
        - ``persistence`` [mm] up to which the node is a hinge if nothing else is changed (NaN for a node that is a
          hinge because of a dead-end gyrus);
        - ``confidence`` of a hinge, 0 to 1 (:func:`~morphofold.analysis.graph.hinges.label_hinges`; NaN for an
          end);
        - ``cut``, True where the mask or the border ends a crest.

        Edges have:

        - ``polyline`` (P, 3) [mm] from the node with the smaller number to the other, ``vertices`` (P,) nearest to it,
          and ``length`` [mm];
        - ``altitude``, the median, and ``lowest``, the least depth potential along it [mm], and ``strength`` [mm];
        - ``curvature``, the mean absolute geodesic curvature [1/mm]: the turns of the curve within the surface in steps
          of half a crown width, divided by its length;
        - ``blind``, True for a dead-end gyrus, and ``number`` from 0.

        ``graph.graph`` has ``scales`` (a ``GyralScales`` or None), ``surface``, ``edge`` [mm] and ``wavelength`` [mm],
        that of :func:`morphofold.analysis.wavelength`, NaN without folds.

    Raises
    ------
    ValueError
        If a length is not positive, or both ``width`` and ``scales`` are given.

    Notes
    -----
    1. The depth potential (:meth:`SurfaceOperators.depth_potential`), which is high on crowns, is flooded. Basins with
       a persistence below ``persistence`` or 0.2 of its range are joined. The borders of the basins are the net, which
       is connected by construction.
    2. Weak crests are removed: borders across wide floors and down in sulci. The *strength* of a crest is the median
       along it of the potential less the potential smoothed over a width. It must be at least 0.15 of the strength of
       the strongest tenth of the net.
    3. Junctions closer than ``merge`` are merged. Spurs shorter than ``prune`` and loops shorter than a width are
       removed.
    4. Crowns that reach farther than ``tip`` from the net get a crest (:func:`add_dead_ends`). Step 3 is repeated.
    5. Crests move onto the crown, and hinges to where their arms meet (:func:`refine`).

    ``sum(degree - 2)`` over nodes is twice the number of independent loops less the number of components.
    """
    import networkx as nx

    builder = CrestNetBuilder(surface)
    operators = builder.operators
    used_scales = builder.scales(width, scales)
    graph = nx.MultiGraph(scales=used_scales, surface=builder.surface.name, edge=operators.mean_edge, wavelength=np.nan)
    if used_scales is not None:
        fields = builder.fields(used_scales)
        graph.graph["wavelength"] = operators.wavelength(fields.D)
        net = builder.net(fields, used_scales)
        refine(net, operators, fields.D, used_scales.width)
        _add_nodes_and_edges(graph, net, builder, fields)
    return graph


def _add_nodes_and_edges(graph: nx.MultiGraph, net: Net, builder: CrestNetBuilder, fields: Fields) -> None:
    """Add nodes and edges to the graph, in an order that depends on their positions alone."""
    D, local_D, scales = fields.D, fields.local_D, graph.graph["scales"]
    node_number = {node: k for k, node in enumerate(sorted(net.nodes, key=lambda node: tuple(net.nodes[node].at)))}
    degrees, least_persistence = net.degrees(), persistence(D, scales.persistence)
    persistences = fields.watershed.separation([net.nodes[node].basins for node in node_number], 3, least_persistence)
    for node, node_persistence in zip(node_number, persistences.tolist()):
        net_node = net.nodes[node]
        point, vertex = closest_points(builder.surface, builder.tree, net_node.at[None])
        graph.add_node(
            node_number[node],
            position=point[0],
            vertex=int(vertex[0]),
            degree=degrees[node],
            cut=net_node.cut,
            normal=upright(builder.operators, builder.tree, net_node.at, scales.width),
            persistence=node_persistence if degrees[node] > 2 else np.nan,
        )
    arcs = [arc if node_number[arc.a] <= node_number[arc.b] else arc.reversed() for arc in net.arcs.values()]
    for arc in sorted(arcs, key=lambda arc: (node_number[arc.a], node_number[arc.b], arc.length)):
        line, vertices = closest_points(builder.surface, builder.tree, arc.points)
        graph.add_edge(
            node_number[arc.a],
            node_number[arc.b],
            polyline=line,
            vertices=vertices,
            blind=arc.blind,
            length=arc.length,
            altitude=float(np.median(D[vertices])),
            lowest=float(D[vertices].min()),
            strength=float(np.median(local_D[vertices])),
            curvature=_mean_geodesic_curvature(arc.points, builder, 0.5 * scales.width),
        )
    for k, (*_, crest) in enumerate(graph.edges(data=True)):
        crest["number"] = k
    label_hinges(graph, D, least_persistence)


def _mean_geodesic_curvature(points: Array, builder: CrestNetBuilder, step: float) -> float:
    coarse_points = resampled(points, step)
    normal = builder.operators.normals[builder.tree.query(coarse_points[1:-1])[1]]
    last_step, next_step = np.diff(coarse_points, axis=0)[:-1], np.diff(coarse_points, axis=0)[1:]
    turns = np.arctan2(np.sum(np.cross(last_step, next_step) * normal, axis=1), np.sum(last_step * next_step, axis=1))
    length = float(np.linalg.norm(np.diff(coarse_points, axis=0), axis=1).sum())
    return float(np.abs(turns).sum()) / length if length > 0 else 0.0


def closest_points(surface: Surface, tree: cKDTree, points: Array) -> tuple[Array, Ints]:
    """Nearest places (P, 3) to points, on the triangles around their nearest vertices, and these vertices (P,).

    ``tree`` is that of the vertices; the points are close to the surface.
    """
    vertices, vertex_faces = tree.query(points)[1], incident_faces(len(surface.verts), surface.faces)
    return _closest_surface_points(*reading(points, vertices, surface.verts, surface.faces, vertex_faces)), vertices


@kernel
def _closest_surface_points(points, nearest_vertex, verts, faces, indptr, indices):
    places = np.empty((len(points), 3))
    for i in range(len(points)):
        point, least_square = position(points, i), np.inf
        for k in range(3):
            places[i, k] = verts[nearest_vertex[i], k]
        for e in range(indptr[nearest_vertex[i]], indptr[nearest_vertex[i] + 1]):
            face = indices[e]
            a, b, c = corners(verts, faces, face)
            s, t = closest_in_triangle(point, a, b, c)
            candidate = weighted(1 - s - t, a, s, b, t, c)
            offset = less(candidate, point)
            if dot(offset, offset) < least_square:
                least_square = dot(offset, offset)
                places[i, 0], places[i, 1], places[i, 2] = candidate
    return places
