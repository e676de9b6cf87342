"""Hinges of a gyral graph: their arms, directions and shapes, and how far each is from not being a hinge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.analysis.graph.curve_net import at_arc_lengths
from morphofold.analysis.graph.depth_potential import LOW_QUANTILE
from morphofold.analysis.graph.net_refinement import ARM_START_IN_WIDTHS, ARM_STOP_IN_WIDTHS, LARGEST_ARM_SHARE
from morphofold.frozen_arrays import Array
from morphofold.geometry import arc_length
from morphofold.surface import PerVertex
from morphofold.validators import check_kind

if TYPE_CHECKING:
    import networkx as nx

LARGEST_Y_DEVIATION_DEG = 30.0  # degrees from 120 within which all three angles of a Y lie
LEAST_STRAIGHT_ANGLE_DEG = 150.0  # least value in degrees of the largest angle of a T
LEAST_ARM_SEPARATION_DEG = 30.0  # least value in degrees of its smallest angle
# confidence from which a hinge counts, and from which it counts by a stricter rule
LEAST_CONFIDENCE, LEAST_STRICT_CONFIDENCE = 0.25, 0.5


@dataclass(frozen=True)
class Arm:
    """One arm of a hinge.

    Attributes
    ----------
    hinge, number : int
        Node of the graph, and position of the arm around it, counter-clockwise seen from outside.
    to, crest : int
        Node at the other end, and number of the crest that leads there.
    angle : float
        Angle to the next arm [degrees]; the angles of a hinge add up to 360.
    length : float
        Length of the crest to that node [mm].
    curvature : float
        Mean absolute geodesic curvature of the crest [1/mm].
    altitude, lowest : float
        Median and least depth potential along the crest [mm], positive on crowns.
    blind : bool
        Whether the arm is a dead-end gyrus.
    direction : (3,) tuple of float
        Unit direction in the tangent plane.
    """

    hinge: int
    number: int
    to: int
    crest: int
    angle: float
    length: float
    curvature: float
    altitude: float
    lowest: float
    blind: bool
    direction: tuple[float, float, float]


@dataclass(frozen=True)
class Hinge:
    """A node of the gyral graph where three or more crests meet.

    Attributes
    ----------
    node : int
        Node of the graph.
    vertex : int
        Nearest vertex of the surface.
    position : (3,) tuple of float
        Position [mm].
    degree : int
        Number of arms; a loop counts twice.
    shape : str
        ``Y``: three arms, all angles within 30 of 120 degrees. ``T``: three arms, largest angle 150 or more, smallest
        30 or more. ``V``: three arms, neither of these. ``X``: four arms. ``star``: five or more.
    largest, smallest : float
        Largest and smallest angle between neighbouring arms [degrees].
    mean_arm_length : float
        Mean length of the arms [mm].
    persistence : float
        [mm], see :func:`morphofold.analysis.gyral_graph`; NaN for a hinge that exists because of a dead-end gyrus.
    blind : bool
        Whether there would be no hinge without its dead-end arms.
    confidence : float
        0 to 1, see :func:`morphofold.analysis.graph.hinges.label_hinges`; NaN in a graph of an older version.
    arms : tuple of Arm
        Counter-clockwise seen from outside; the arm before the largest angle is last.
    """

    node: int
    vertex: int
    position: tuple[float, float, float]
    degree: int
    shape: str
    largest: float
    smallest: float
    mean_arm_length: float
    persistence: float
    blind: bool
    confidence: float
    arms: tuple[Arm, ...]


def hinges(graph: nx.MultiGraph) -> list[Hinge]:
    """The hinges of a gyral graph, in the order of nodes.

    Parameters
    ----------
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph`.

    Returns
    -------
    list of Hinge
        The direction of an arm points to the mean of its crest between 0.5 and 1.5 crown widths from the hinge (at most
        60 % of its length), in the tangent plane.
    """
    import networkx as nx

    check_kind(graph, nx.MultiGraph, "hinges: graph")
    if graph.graph["scales"] is None:
        return []
    return [hinge_at(graph, node) for node, degree in graph.degree() if degree > 2]


def hinge_at(graph: nx.MultiGraph, node: int) -> Hinge:
    """The hinge at a node of a gyral graph where three crests or more meet, as :func:`hinges` gives it.

    Raises ``KeyError`` if there is no such node. At a node with fewer crests the angles have no meaning.
    """
    data, width = graph.nodes[node], graph.graph["scales"].width
    point, normal = data["position"], data["normal"]
    arm_ends = []
    for start, end, crest in graph.edges(node, data=True):
        both_ways = (crest["polyline"], crest["polyline"][::-1])
        for line in both_ways if start == end else [min(both_ways, key=lambda line: np.linalg.norm(line[0] - point))]:
            arm_ends.append((_arm_direction(line, point, normal, width), end, crest))
    u = arm_ends[0][0]
    v = np.cross(normal, u)
    azimuth = [float(np.degrees(np.arctan2(ray @ v, ray @ u))) % 360 for ray, *_ in arm_ends]
    arm_order = sorted(range(len(arm_ends)), key=lambda k: azimuth[k])
    angles = [(azimuth[after] - azimuth[arm]) % 360 for arm, after in pairwise([*arm_order, arm_order[0]])]
    first_arm = (int(np.argmax(angles)) + 1) % len(angles)
    arm_order, angles = arm_order[first_arm:] + arm_order[:first_arm], angles[first_arm:] + angles[:first_arm]
    arms = []
    for number, (k, angle) in enumerate(zip(arm_order, angles)):
        direction, end, crest = arm_ends[k]
        crest_values = {key: crest[key] for key in ("length", "curvature", "altitude", "lowest", "blind")}
        arms.append(Arm(node, number, end, crest["number"], angle, direction=tuple(direction.tolist()), **crest_values))
    position, confidence = tuple(point.tolist()), data.get("confidence", math.nan)
    mean_length, is_blind = float(np.mean([arm.length for arm in arms])), sum(not arm.blind for arm in arms) < 3
    shape_values = len(arms), _hinge_shape(angles), max(angles), min(angles), mean_length
    return Hinge(node, data["vertex"], position, *shape_values, data["persistence"], is_blind, confidence, tuple(arms))


def _arm_direction(line: Array, point: Array, normal: Array, width: float) -> Array:
    outer_distance = min(ARM_STOP_IN_WIDTHS * width, LARGEST_ARM_SHARE * arc_length(line)[-1])
    distances = np.linspace(min(ARM_START_IN_WIDTHS * width, 0.5 * outer_distance), outer_distance, 9)
    mean_offset = at_arc_lengths(line, distances).mean(axis=0) - point
    tangential = mean_offset - (mean_offset @ normal) * normal
    direction: Array = tangential / max(float(np.linalg.norm(tangential)), 1e-300)
    return direction


def _hinge_shape(angles: list[float]) -> str:
    if len(angles) > 3:
        return "X" if len(angles) == 4 else "star"
    if max(abs(angle - 120) for angle in angles) <= LARGEST_Y_DEVIATION_DEG:
        return "Y"
    return "T" if max(angles) >= LEAST_STRAIGHT_ANGLE_DEG and min(angles) >= LEAST_ARM_SEPARATION_DEG else "V"


def counts(row: Mapping[str, Any]) -> bool:
    """Whether a hinge (a row of its table or a node) is not doubtful; True if an older version gave no confidence."""
    confidence = row.get("confidence")
    return confidence is None or not confidence < LEAST_CONFIDENCE  # NaN in a graph of an older version


def table_columns(text: str) -> dict[str, str]:
    """Columns of a table, and what each holds: ``column=attribute``, or one word where both have the same name."""
    pairs = (word.partition("=") for word in text.split())
    return {column: attribute or column for column, _, attribute in pairs}


HINGE_COLUMNS = table_columns(
    "hemi hinge=node x y z degree shape min_angle_deg=smallest max_angle_deg=largest region vertex "
    "mean_arm_length_mm=mean_arm_length persistence_mm=persistence blind confidence "
    "cortical_thickness_mm=cortical_thickness"
)
ARM_COLUMNS = table_columns(
    "hemi hinge arm=number angle_deg=angle length_mm=length curvature_per_mm=curvature to_hinge=to "
    "altitude_mm=altitude lowest_altitude_mm=lowest blind crest"
)


def row_of(columns: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table: yes and no are 1 and 0, and what is not known is None."""
    row = {column: values.get(attribute) for column, attribute in columns.items()}
    for column, value in row.items():
        if isinstance(value, bool):
            row[column] = int(value)
        elif isinstance(value, float) and math.isnan(value):
            row[column] = None
    return row


def as_rows(all_hinges: list[Hinge]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Hinges and arms as rows of tables."""
    hinge_rows = [row_of(HINGE_COLUMNS, vars(hinge) | dict(zip("xyz", hinge.position))) for hinge in all_hinges]
    return hinge_rows, [row_of(ARM_COLUMNS, vars(arm)) for hinge in all_hinges for arm in hinge.arms]


def label_hinges(graph: nx.MultiGraph, D: PerVertex, persistence: float) -> None:
    """Set the ``confidence`` of each node of a gyral graph, 0 to 1; NaN for a node that is not a hinge.

    Parameters
    ----------
    graph : networkx.MultiGraph
        From :func:`morphofold.analysis.gyral_graph`, complete except for the confidence.
    D : (N,) float64
        Depth potential of the surface [mm].
    persistence : float
        Least persistence of the basins [mm].

    Notes
    -----
    The confidence is the least of these margins, each limited to 0 to 1:

    - the height of the lowest point of its arms above the bottom of the sulci (quantile 0.05 of D), divided by the
      height of the crests (the median along the net): an arm over a buried bridge, or through a sulcus, is low;
    - the distance between its two closest arms at one crown width from the hinge, divided by that width,
      ``2 sin(angle / 2)``: two gyri cannot be closer than their width;
    - its persistence divided by the least ``persistence``, less 1;
    - the length of its shortest arm with a free end divided by ``prune``, the length below which the arm would be
      removed, less 1. An arm that ends at the mask or the border of a surface is not a spur.

    A hinge therefore has 0.25 if it would vanish with a persistence or a shortest gyrus larger by a quarter, if its arm
    dips three quarters of the way to the bottom of the sulci, or if two arms are 14 degrees apart.
    """
    for _, node in graph.nodes(data=True):
        node["confidence"] = math.nan
    if graph.number_of_edges() == 0:
        return
    crest_vertices = np.concatenate([crest["vertices"] for *_, crest in graph.edges(data=True)])
    low_depth, crest_depth = float(np.quantile(D, LOW_QUANTILE)), float(np.median(D[crest_vertices]))
    for hinge in hinges(graph):
        graph.nodes[hinge.node]["confidence"] = _hinge_confidence(graph, hinge, low_depth, crest_depth, persistence)


def _hinge_confidence(graph: nx.MultiGraph, hinge: Hinge, floor_D: float, crest_D: float, persistence: float) -> float:
    prune_length = graph.graph["scales"].prune
    free_arms = [arm for arm in hinge.arms if graph.degree[arm.to] == 1 and not graph.nodes[arm.to]["cut"]]
    margins = [
        (min(arm.lowest for arm in hinge.arms) - floor_D) / (crest_D - floor_D),
        2 * math.sin(math.radians(min(hinge.smallest, 180.0) / 2)),
        *(arm.length / prune_length - 1 for arm in free_arms),
    ]
    if not math.isnan(hinge.persistence):  # else it is a hinge by its dead ends, whose lengths count
        margins.append(hinge.persistence / persistence - 1)
    return float(np.clip(min(margins), 0, 1))
