"""A gyral graph on disk: node-link JSON, which ``networkx.node_link_graph(..., edges="edges")`` can read, too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import networkx as nx
import numpy as np
from pydantic import Field

from morphofold.analysis.graph.crest_net import GyralScales
from morphofold.errors import DamagedFile, Mismatch
from morphofold.io.json_files import Amount, Count, Number, Record, read_json

REANALYSE_ADVICE = "Analyze again."
ENDS = {"id", "source", "target"}  # which node it is, or which it joins: no attributes
ARRAY_TYPES = {"position": np.float64, "normal": np.float64, "polyline": np.float64, "vertices": np.int64}
Position = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Scales(Record):
    """Lengths as in :class:`morphofold.analysis.graph.crest_net.GyralScales` [mm]."""

    width: Amount
    reach: Amount
    smoothing: Amount
    persistence: Amount
    merge: Amount
    prune: Amount
    tip: Amount


class Head(Record):
    """Attributes of the graph itself."""

    scales: Scales | None
    surface: str
    edge: Number
    wavelength: Number | None


class Node(Record):
    """A node, where crests meet or end."""

    id: Count
    position: Position
    normal: Position
    vertex: Count
    degree: Count
    cut: bool
    persistence: Number | None
    confidence: Number | None


class Edge(Record):
    """A crest between two nodes."""

    source: Count
    target: Count
    polyline: Annotated[list[Position], Field(min_length=2)]
    vertices: list[Count]
    blind: bool
    number: Count
    length: Number
    altitude: Number
    lowest: Number
    strength: Number
    curvature: Number


class GraphFile(Record):
    """A whole file."""

    directed: Literal[False]
    multigraph: Literal[True]
    graph: Head
    nodes: list[Node]
    edges: list[Edge]


def write_graph(path: Path, graph: nx.MultiGraph) -> None:
    """Write a graph of :func:`morphofold.analysis.gyral_graph`; numbers with seven figures, NaN as null."""
    content, scales = _json_value(nx.node_link_data(graph, edges="edges")), graph.graph["scales"]
    content["graph"]["scales"] = None if scales is None else asdict(scales)
    path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def read_graph(path: Path, n: int) -> nx.MultiGraph:
    """Read what :func:`write_graph` wrote, for a surface of ``n`` vertices.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it contains anything else, or vertices that the surface does not have.
    """
    content = read_json(path, GraphFile, REANALYSE_ADVICE)
    ids = {node["id"] for node in content["nodes"]}
    for edge in content["edges"]:
        if not ids >= {edge["source"], edge["target"]} or len(edge["vertices"]) != len(edge["polyline"]):
            raise DamagedFile(
                f"{path}: edge {edge['number']} does not join two nodes, or lacks vertices. {REANALYSE_ADVICE}"
            )
    vertices = [node["vertex"] for node in content["nodes"]] + [v for e in content["edges"] for v in e["vertices"]]
    if (last := max(vertices, default=-1)) >= n:
        raise Mismatch(f"{path}: has vertex {last}, but the surface has 0..{n - 1}. {REANALYSE_ADVICE}")
    head, scales = content["graph"], content["graph"]["scales"]
    scales = None if scales is None else GyralScales(**{name: float(scales[name]) for name in Scales.model_fields})
    graph: nx.MultiGraph = nx.MultiGraph(**_attributes(head, Head) | {"scales": scales})
    graph.add_nodes_from((node["id"], _attributes(node, Node)) for node in content["nodes"])
    graph.add_edges_from((edge["source"], edge["target"], _attributes(edge, Edge)) for edge in content["edges"])
    return graph


def _json_value(value: Any) -> Any:
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    if isinstance(value, dict):
        return {key: _json_value(x) for key, x in value.items()}
    if isinstance(value, list):
        return [_json_value(x) for x in value]
    if isinstance(value, float):
        return float(f"{value:.7g}") if np.isfinite(value) else None
    return value


def _attributes(data: Mapping[str, Any], record: type[Record]) -> dict[str, Any]:
    """Attributes of a graph, a node or an edge: lists as arrays, null as NaN."""
    attributes = {
        name: np.nan if data[name] is None else data[name] for name in record.model_fields if name not in ENDS
    }
    return attributes | {
        name: np.array(attributes[name], kind) for name, kind in ARRAY_TYPES.items() if name in attributes
    }
