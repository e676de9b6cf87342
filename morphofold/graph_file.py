"""A gyral graph on disk: node-link JSON, as ``networkx.node_link_graph(..., edges="edges")`` reads it too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from morphofold.analysis.gyral_net import GyralScales

#: what a file that is no graph makes of the reading
BROKEN = (
    AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError, nx.NetworkXException,
)  # fmt: skip


def write_graph(path: Path, graph: nx.MultiGraph) -> None:
    """Write what :func:`morphofold.analysis.gyral_graph` found; numbers with seven figures, NaN as null."""
    scales = graph.graph["scales"]
    plain: nx.MultiGraph = nx.MultiGraph(
        **{**_plain(graph.graph), "scales": None if scales is None else asdict(scales)}
    )
    plain.add_nodes_from((node, _plain(data)) for node, data in graph.nodes(data=True))
    plain.add_edges_from((a, b, _plain(data)) for a, b, data in graph.edges(data=True))
    path.write_text(json.dumps(nx.node_link_data(plain, edges="edges"), allow_nan=False) + "\n", encoding="utf-8")


def read_graph(path: Path, n: int) -> nx.MultiGraph:
    """What :func:`write_graph` wrote, for a surface of ``n`` vertices.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it holds anything else, or names vertices that the surface lacks.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing from the analysis. Analyze anew.")
    try:
        found = nx.node_link_graph(json.loads(path.read_text(encoding="utf-8")), edges="edges")
        if not found.is_multigraph() or found.is_directed():
            raise ValueError("it is no undirected multigraph")
        return _checked(found, n)
    except BROKEN as error:
        raise ValueError(
            f"{path}: not a gyral graph as `morphofold analyze` writes it ({type(error).__name__}: {error}). "
            "Analyze anew."
        ) from None


def _plain(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _short(value) for key, value in data.items()}


def _short(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_short(x) for x in value.tolist()]
    if isinstance(value, list):
        return [_short(x) for x in value]
    if isinstance(value, np.generic):
        return _short(value.item())
    if isinstance(value, float):
        return float(f"{value:.7g}") if np.isfinite(value) else None
    return value


def _checked(found: nx.MultiGraph, n: int) -> nx.MultiGraph:
    head = found.graph
    scales = None if head["scales"] is None else {k: _finite(v) for k, v in head["scales"].items()}
    graph: nx.MultiGraph = nx.MultiGraph(
        scales=None if scales is None else GyralScales(**scales), surface=str(head["surface"]),
        edge=_finite(head["edge"]), wavelength=_number(head["wavelength"]),
    )  # fmt: skip
    for node, data in found.nodes(data=True):
        graph.add_node(
            int(node), position=_array(data["position"], (3,)), vertex=int(_vertices([data["vertex"]], n)[0]),
            degree=int(data["degree"]), cut=bool(data["cut"]), normal=_array(data["normal"], (3,)),
            persistence=_number(data["persistence"]),
            confidence=_number(data.get("confidence")),         # older graphs have none
        )  # fmt: skip
    for a, b, data in found.edges(data=True):
        line = np.array(data["polyline"], dtype=np.float64)
        graph.add_edge(
            int(a), int(b), polyline=_array(data["polyline"], (max(len(line), 2), 3)),
            vertices=_vertices(data["vertices"], n, len(line)), blind=bool(data["blind"]), number=int(data["number"]),
            **{key: _finite(data[key]) for key in ("length", "altitude", "lowest", "strength", "curvature")},
        )  # fmt: skip
    return graph


def _array(values: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"numbers are missing where {shape} finite ones belong")
    return array


def _vertices(values: Any, n: int, count: int = 1) -> NDArray[Any]:
    array = np.array(values, dtype=np.int64)
    if array.shape != (count,) or array.min() < 0 or array.max() >= n:
        raise ValueError(f"there must be {count} vertices of the {n} of the surface")
    return array


def _finite(value: Any) -> float:
    if not np.isfinite(value):
        raise ValueError(f"{value} is no number")
    return float(value)


def _number(value: float | None) -> float:
    return np.nan if value is None else _finite(value)
