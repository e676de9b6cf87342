"""A gyral graph on disk: node-link JSON, which ``networkx.node_link_graph(..., edges="edges")`` can read, too."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from morphofold.analysis.graph.crest_net import GyralScales
from morphofold.errors import Mismatch
from morphofold.io.files import decoding
from morphofold.io.json_files import Record, read_json
from morphofold.results.summary import REANALYSE_ADVICE

ARRAY_TYPES = {"position": np.float64, "normal": np.float64, "polyline": np.float64, "vertices": np.int64}


def write_graph(path: Path, graph: nx.MultiGraph) -> None:
    """Write a graph of :func:`morphofold.analysis.gyral_graph`; numbers with seven figures, NaN as null."""
    scales, text = graph.graph["scales"], json.dumps(nx.node_link_data(graph, edges="edges"), default=_plain)
    content = json.loads(text, parse_float=lambda x: float(f"{float(x):.7g}"), parse_constant=lambda _: None)
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
    content = read_json(path, Record, REANALYSE_ADVICE)
    with decoding(path, "a gyral graph", REANALYSE_ADVICE):
        graph: nx.MultiGraph = nx.node_link_graph(content, edges="edges")
        scales = graph.graph["scales"]
        of_nodes, of_edges = ([data for *_, data in part(data=True)] for part in (graph.nodes, graph.edges))
        for data in (graph.graph, *of_nodes, *of_edges):
            data |= {name: np.nan if value is None else value for name, value in data.items()}
            data |= {name: np.array(data[name], kind) for name, kind in ARRAY_TYPES.items() if name in data}
        graph.graph["scales"] = None if scales is None else GyralScales(**scales)
        last = max(chain((data["vertex"] for data in of_nodes), *(data["vertices"] for data in of_edges)), default=-1)
    if last >= n:
        raise Mismatch(f"{path}: has vertex {last}, but the surface has 0..{n - 1}. {REANALYSE_ADVICE}")
    return graph


def _plain(value: Any) -> Any:
    """An array, a number of NumPy or the scales as JSON has it."""
    return asdict(value) if isinstance(value, GyralScales) else value.tolist()
