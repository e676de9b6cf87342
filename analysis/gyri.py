"""The gyral graph: one net of gyral crests over a surface, its junctions the hinges of gyri."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from morphofold.analysis import checks
from morphofold.analysis._mesh import incident_faces
from morphofold.analysis.altitude import Altimeter, persistence
from morphofold.analysis.blind import add_blind_gyri
from morphofold.analysis.net import Net, borders, smoothed
from morphofold.analysis.refine import refine, upright
from morphofold.analysis.thickness import closest_in_triangle
from morphofold.analysis.watershed import Watershed
from morphofold.analysis.ways import way_graph
from morphofold.surface import Cortex, PerVertex, Surface

if TYPE_CHECKING:
    import networkx as nx

STRONG = 0.9            # quantile over the length of the net that stands for the strength of a true crest,
WEAK = 0.2              # and the share of it below which one is none


@dataclass(frozen=True)
class GyralScales:
    """The lengths of a gyral graph [mm]; :meth:`of_width` has those that the gyral width gives.

    Attributes
    ----------
    width : float
        Of the gyri, from inflection to inflection.
    reach : float
        Of the altitude: what is several times as wide is the body's shape.
    smoothing : float
        Standard deviation, of the altitude and along the net.
    persistence : float
        Least rise of the pass between two basins above the shallower one.
    merge : float
        Crests shorter than this between two hinges are contracted to one hinge.
    prune : float
        Crests shorter than this with a free end are dropped.
    tip : float
        A crown that reaches farther from the net has a crest of its own.
    """

    width: float
    reach: float
    smoothing: float
    persistence: float
    merge: float
    prune: float
    tip: float

    @classmethod
    def of_width(cls, width: float) -> GyralScales:
        """1.5, 0.2, 0.15, 0.5, 1 and 1.5 gyral widths."""
        return cls(width, 1.5 * width, 0.2 * width, 0.15 * width, 0.5 * width, width, 1.5 * width)


def gyral_graph(
    surface: Cortex | Surface, *, width: float | None = None, scales: GyralScales | None = None,
) -> nx.MultiGraph:  # fmt: skip
    """The net of gyral crests and their hinges.

    Parameters
    ----------
    surface : Cortex or Surface
        Of a cortex the white surface is taken, whose crowns are sharp and whose sulci are open, and its mask. A closed
        surface, or one with a natural border.
    width : float, optional
        Gyral width [mm]; None: measured (:meth:`Altimeter.gyral_width`). Pass one to compare meshes of one brain.
    scales : GyralScales, optional
        All lengths, instead of ``width``.

    Returns
    -------
    networkx.MultiGraph
        Nodes, numbered from 0, have ``position`` (3,) [mm] on the surface, ``vertex`` the nearest one, ``normal`` (3,)
        of its surroundings, ``degree`` (a loop counts twice), ``persistence`` [mm] up to which the node is a hinge if
        nothing else is changed (NaN for one that owes it to a blind gyrus), ``cut`` where the mask or the border ends
        a crest. Edges have ``polyline`` (P, 3) [mm] from the smaller node to the larger, ``vertices`` (P,) nearest to
        it, ``length`` [mm], ``altitude`` the median and ``lowest`` the least altitude along it [mm], ``strength``
        [mm], ``blind``. ``graph.graph`` has ``scales`` (a ``GyralScales`` or None), ``surface`` and ``edge`` [mm].
        Empty if the surface has no folds.

    Raises
    ------
    ValueError
        If a length is not positive, or both ``width`` and ``scales`` are given.

    Notes
    -----
    1. Altitude (:meth:`Altimeter.altitude`), flooded: borders of its basins, joined if they persist less than
       ``persistence`` or 0.3 of the range of altitudes, are the net, connected by construction.
    2. Of its crests those go whose *strength*, the median of altitude less altitude smoothed over a width, is less
       than a fifth of that of the strongest tenth of the net: borders across wide floors and down in sulci.
    3. Junctions nearer than ``merge`` become one, spurs shorter than ``prune`` and loops shorter than a width go.
    4. Crowns that reach farther than ``tip`` from the net get a crest (:func:`add_blind_gyri`), and step 3 again.
    5. Crests move onto the crown, hinges to where their arms meet (:func:`refine`).

    ``sum(degree - 2)`` over nodes is twice the number of independent loops less that of components.
    """
    import networkx as nx

    if isinstance(surface, Cortex):
        inside = checks.cortex_mask(surface)
        sheet = surface.white
    else:
        sheet, inside = surface, np.ones(len(surface.verts), dtype=bool)
    meter = Altimeter(sheet.verts, sheet.faces)
    scales = _scales(meter, inside, width, scales)
    graph = nx.MultiGraph(scales=scales, surface=sheet.name, edge=meter.edge)
    if scales is None:
        return graph
    D = meter.altitude(scales.reach, scales.smoothing)
    band = D - meter.smooth(D, scales.width)
    H = meter.mean_curvature(scales.smoothing)
    tree = cKDTree(sheet.verts)
    ways = way_graph(sheet.verts, sheet.faces)
    flood = Watershed(meter.pairs, meter.lengths, D)
    net = _topology(meter, flood, D, band, H, ways, tree, inside, scales)
    refine(net, meter, D, scales.width)
    _describe(graph, net, meter, flood, D, band, tree)
    return graph


def _scales(
    meter: Altimeter, inside: NDArray[np.bool_], width: float | None, scales: GyralScales | None
) -> GyralScales | None:
    if width is not None and scales is not None:
        raise ValueError("pass width or scales, not both: scales.width is the width.")
    if scales is None:
        width = meter.gyral_width(inside) if width is None else float(width)
        if math.isnan(width):
            return None
        scales = GyralScales.of_width(width)
    for name, value in asdict(scales).items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive length in mm, got {value!r}.")
    return scales


def _topology(
    meter: Altimeter, flood: Watershed, D: PerVertex, band: PerVertex, H: PerVertex, ways: sparse.csr_array,
    tree: cKDTree, inside: NDArray[np.bool_], scales: GyralScales,
) -> Net:  # fmt: skip
    """Steps 1 to 4."""
    basin = flood.basins(persistence(D, scales.persistence))
    net = borders(meter.verts, meter.faces, meter.pairs, basin, flood.finest)
    if not inside.all():
        net.keep(lambda points: inside[tree.query(points)[1]])
    least = _drop_weak(net, band, tree)
    for arc in net.arcs.values():
        arc.points = smoothed(arc.points, scales.smoothing)
    net.tidy_up(scales.merge, scales.prune, scales.width)
    add_blind_gyri(net, meter, ways, D, (H > 0) & (band > least) & inside, scales.width, scales.tip)
    net.tidy_up(scales.merge, scales.prune, scales.width)
    refine(net, meter, D, scales.width, rounds=1)
    net.tidy_up(scales.merge, scales.prune, scales.width)
    return net


def _drop_weak(net: Net, band: PerVertex, tree: cKDTree) -> float:
    """Take weak crests out of the net; the strength that is the least."""
    strength = {name: float(np.median(band[tree.query(arc.points)[1]])) for name, arc in net.arcs.items()}
    if not strength:
        return 0.0
    order = sorted(strength, key=lambda name: strength[name])
    length = np.cumsum([net.arcs[name].length for name in order])
    least = WEAK * strength[order[int(np.searchsorted(length, STRONG * length[-1]))]]
    net.drop(*(name for name in order if strength[name] < least))
    return least


def _describe(
    graph: nx.MultiGraph, net: Net, meter: Altimeter, flood: Watershed, D: PerVertex, band: PerVertex, tree: cKDTree
) -> None:
    """Nodes and edges of the graph, in an order that depends on their places alone."""
    feet, width = _Feet(meter, tree), graph.graph["scales"].width
    number = {node: k for k, node in enumerate(sorted(net.nodes, key=lambda node: tuple(net.nodes[node].at)))}
    degrees, least = net.degrees(), persistence(D, graph.graph["scales"].persistence)
    held = flood.apart([net.nodes[node].basins for node in number], 3, least)
    for node, lasting in zip(number, held.tolist()):
        here = net.nodes[node]
        place, vertex = feet.of(here.at[None])
        graph.add_node(
            number[node], position=place[0], vertex=int(vertex[0]), degree=degrees[node], cut=here.cut,
            normal=upright(meter, tree, here.at, width),
            persistence=lasting if degrees[node] > 2 else np.nan,
        )  # fmt: skip
    arcs = [arc if number[arc.a] <= number[arc.b] else arc.turned() for arc in net.arcs.values()]
    for arc in sorted(arcs, key=lambda arc: (number[arc.a], number[arc.b], arc.length)):
        line, vertices = feet.of(arc.points)
        graph.add_edge(
            number[arc.a], number[arc.b], polyline=line, vertices=vertices, blind=arc.blind,
            length=arc.length, altitude=float(np.median(D[vertices])),
            lowest=float(D[vertices].min()), strength=float(np.median(band[vertices])),
        )  # fmt: skip


class _Feet:
    """The points of a surface nearest to points close to it."""

    def __init__(self, meter: Altimeter, tree: cKDTree):
        self._meter, self._tree = meter, tree
        self._around = incident_faces(len(meter.verts), meter.faces)

    def of(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Places (P, 3), and the nearest vertices (P,): those of the triangles there."""
        nearest = self._tree.query(points)[1]
        around, meter = self._around, self._meter
        places = _nearest_places(points, nearest, meter.verts, meter.faces, around.indptr, around.indices)
        return places, nearest


@njit(cache=True)
def _nearest_places(points, nearest, verts, faces, indptr, indices):
    places = verts[nearest]
    for i in range(len(points)):
        p, best = points[i], np.inf
        for e in range(indptr[nearest[i]], indptr[nearest[i] + 1]):
            a, b, c = faces[indices[e]]
            s, t = closest_in_triangle(p[0], p[1], p[2], verts, a, b, c)
            place = (1 - s - t) * verts[a] + s * verts[b] + t * verts[c]
            far = np.sum((place - p) ** 2)
            if far < best:
                best, places[i] = far, place
    return places
