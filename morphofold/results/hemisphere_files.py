"""The files of one hemisphere of an analysis, in either layout: ``write_hemisphere`` and ``read_hemisphere``.

In BIDS, surfaces, hinges and gyral graph are in scanner coordinates if the cortex has a transform to them, and ``curv``
has FreeSurfer's sign; reading reverses both.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from nibabel.affines import apply_affine

from morphofold import io
from morphofold.analysis.graph.net_builder import GyralScales
from morphofold.analysis.measures_result import Measures
from morphofold.digests_and_json import Row, json_value
from morphofold.errors import Mismatch
from morphofold.io.files import decoding
from morphofold.io.json_files import Record, read_json
from morphofold.quantities import quantity
from morphofold.results.freesurfer_results import stats_name, write_gyral_stats
from morphofold.results.layouts import (
    INPUT_MAP_UNITS,
    MISSING_DESCRIPTION,
    REANALYSE_ADVICE,
    Layout,
    in_bids_letters,
    map_ending,
)
from morphofold.surface import SURFACES, Cortex, PerVertex, Regions
from morphofold.tables import write_table
from morphofold.validators import same_length

SCANNER_SURFACES = ("white", "pial")  # the others have no place in the scanner
ARRAY_TYPES = {"position": np.float64, "normal": np.float64, "polyline": np.float64, "vertices": np.int64}
CURVATURE_DESCRIPTION = "Mean curvature of the pial surface, positive in sulci (FreeSurfer's sign)"
_check_size = partial(same_length, advice="The files belong to two analyses.", error=Mismatch)


def write_hemisphere(measures: Measures, layout: Layout, *, mgh: bool = False) -> None:
    """Write surfaces, maps, regions, mask, gyral graph and stats as FreeSurfer's, as far as measures and layout have
    any; with ``mgh`` measured maps also as MGH. For BIDS the measures are in scanner coordinates."""
    cortex, hemi, regions = measures.cortex, measures.cortex.hemi, measures.cortex.regions
    uses_scanner = layout.bids and cortex.transform is not None
    for name in SURFACES:
        if (surface := getattr(cortex, name)) is not None:
            surface = replace(surface, geometry=None) if uses_scanner else surface
            path, in_scanner_frame = layout.new("surface", hemi, name), name in SCANNER_SURFACES
            io.write_surface(path, surface, scanner=uses_scanner and in_scanner_frame)
    for kind in ("input_map", "map", "freesurfer_map", "mgh_map")[: 2 if layout.bids else 3 + mgh]:
        for name, values in (cortex if kind == "input_map" else measures).maps.items():
            path, map_title = layout.new(kind, hemi, name, _about_map(kind, name)), map_ending(kind, name)
            values = _with_file_sign(layout, kind, name, values)
            nan_value = np.nan if path.suffix == ".gii" else 0.0
            io.write_morph(path, values, name=map_title if layout.bids else "", hemi=hemi, nan=nan_value)
    uri = f"bids::{layout.subject}/anat/{layout.path('surface', hemi, 'white').name}"
    if regions is not None:
        description = f"Regions of the parcellation {regions.name}, one key per vertex"
        path = layout.new("regions", hemi, regions.name, {"Description": description, "SpatialReference": uri})
        io.write_annotation(path, regions)
        if layout.bids:
            colours = (f"#{bytes(rgb).hex()}" for rgb in regions.colours.tolist())
            rows = enumerate([("no region", None), *zip(regions.names, colours)])
            key_rows = [{"index": key, "name": name, "color": colour} for key, (name, colour) in rows]
            write_table(layout.new("region_keys", hemi, regions.name), (), key_rows)
    if cortex.cortex is not None:
        description = "1 where the vertex is cortex, else 0"
        path = layout.new("mask", hemi, sidecar={"Description": description, "Type": "ROI", "SpatialReference": uri})
        io.write_label(path, cortex.cortex, cortex.white.verts)
    if measures.graph is not None:
        write_graph(layout.new("graph", hemi), measures.graph)
    if measures.regions and not layout.bids:
        write_gyral_stats(layout.new("stats", name=stats_name(measures)), measures)


def _with_file_sign(layout: Layout, kind: str, name: str, values: PerVertex) -> PerVertex:
    """Values of a map as in its file, or back: in BIDS, curv has FreeSurfer's sign."""
    return io.flip_curvature_sign(values) if layout.bids and (kind, name) == ("map", "H") else values


def _about_map(kind: str, name: str) -> dict[str, str]:
    if kind == "input_map":
        units = {"Units": INPUT_MAP_UNITS[name]} if name in INPUT_MAP_UNITS else {}
        return {"Description": f"{name} as it came with the surfaces", **units}
    map_quantity = quantity(name)
    label = CURVATURE_DESCRIPTION if name == "H" else map_quantity.label
    return {"Description": label, "Units": in_bids_letters(map_quantity.unit), "Missing": MISSING_DESCRIPTION}


# reading ----------------------------------------------------------------------------------------------------


def read_hemisphere(entry: Row, tables: Mapping[str, list[Row]], layout: Layout) -> Measures:
    """Measures from the entry of a surface in the summary, the tables of both hemispheres, and its own files.

    Raises
    ------
    FileNotFoundError
        If a file of it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    hemi, path_of = entry["hemi"], partial(layout.path, hemi=entry["hemi"])
    transform = np.array(entry["transform"]) if entry["transform"] else None
    surface_names = [kind for kind in SURFACES if kind in SCANNER_SURFACES or entry.get(kind)]
    fields: Row = {k: replace(io.read_surface(path_of("surface", name=k)), name=f"{hemi}.{k}") for k in surface_names}
    n_vertices, annotation = len(fields["white"].verts), entry["annotation"]
    fields |= {key: entry[key] for key in ("hemi", "name", "origin", "units", "info", "portion")}
    fields |= {key: tuple(entry[key]) for key in ("files", "inputs")}
    cortex = Cortex(
        **fields,
        maps={name: read_map(layout, hemi, name, n_vertices, "input_map") for name in entry["came_with"]},
        cortex=io.read_label(path_of("mask"), n_vertices) if entry["cortex_label"] else None,
        regions=_read_regions(path_of("regions", name=annotation), annotation, n_vertices) if annotation else None,
        transform=transform,
    )
    hemi_rows: Row = {name: [row for row in rows if row["hemi"] == hemi] for name, rows in tables.items()}
    graph = read_graph(path_of("graph"), n_vertices) if entry["graph"] else None
    maps = {name: read_map(layout, hemi, name, n_vertices) for name in entry["maps"]}
    measures = Measures(
        cortex, entry["measures"], maps, graph=graph, parameters=entry["parameters"], notes=entry["notes"], **hemi_rows
    )
    return in_scanner(measures, inverse=True) if layout.bids else measures


def read_map(layout: Layout, hemi: str, name: str, n_vertices: int, kind: str = "map") -> PerVertex:
    """A map (N,) of a surface with ``n_vertices``: a measured one, positive where convex, or an ``"input_map"``."""
    path = layout.path(kind, hemi, name)
    values = io.read_morph(path)
    _check_size(values, n_vertices, f"{path}:")
    return _with_file_sign(layout, kind, name, values)


def _read_regions(path: Path, name: str, n_vertices: int) -> Regions:
    regions = replace(io.read_annotation(path), name=name)
    _check_size(regions.labels, n_vertices, f"{path}:")
    return regions


# to the scanner's coordinates, and back ---------------------------------------------------------------------


def in_scanner(measures: Measures, *, inverse: bool = False) -> Measures:
    """Measures with surfaces, hinges and gyral graph in scanner coordinates, if the cortex has a transform to them; or
    with ``inverse`` from there."""
    if measures.cortex.transform is None:
        return measures
    affine: Any = np.linalg.inv(measures.cortex.transform) if inverse else measures.cortex.transform
    to_scanner = partial(apply_affine, affine)
    surfaces: Row = {k: replace(s := measures.cortex.surface(k), verts=to_scanner(s.verts)) for k in SCANNER_SURFACES}
    hinges = [row | dict(zip("xyz", to_scanner([row[k] for k in "xyz"]).tolist())) for row in measures.hinges]
    if (graph := measures.graph) is not None:
        graph = graph.copy()
        for _, node in graph.nodes(data=True):
            node |= {"position": to_scanner(node["position"]), "normal": node["normal"] @ affine[:3, :3].T}
        for _, _, edge in graph.edges(data=True):
            edge |= {"polyline": to_scanner(edge["polyline"])}
    return replace(measures, cortex=replace(measures.cortex, **surfaces), hinges=hinges, graph=graph)


# the gyral graph, as node-link JSON, which networkx can read, too --------------------------------------------


def write_graph(path: Path, graph: nx.MultiGraph) -> None:
    """Write a graph of :func:`morphofold.analysis.gyral_graph`; numbers with seven figures, NaN as null."""
    text = json.dumps(nx.node_link_data(graph, edges="edges"), default=json_value)
    content = json.loads(text, parse_float=lambda token: float(f"{float(token):.7g}"), parse_constant=lambda _: None)
    content["graph"]["scales"] = json_value(graph.graph["scales"])  # in full
    path.write_text(json.dumps(content, allow_nan=False) + "\n", "utf-8")


def read_graph(path: Path, n_vertices: int) -> nx.MultiGraph:
    """Read what :func:`write_graph` wrote, for a surface with ``n_vertices``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it contains anything else, or vertices that the surface does not have.
    """
    content = read_json(path, Record, REANALYSE_ADVICE)
    with decoding(path, "a gyral graph", REANALYSE_ADVICE):
        graph_data, nodes, edges = content["graph"], content["nodes"], content["edges"]
        scales = graph_data["scales"]
        for row in (graph_data, *nodes, *edges):
            row |= {name: np.nan if value is None else value for name, value in row.items()}
            row |= {name: np.array(row[name], dtype) for name, dtype in ARRAY_TYPES.items() if name in row}
        graph_data["scales"] = None if scales is None else GyralScales(**scales)
        graph: nx.MultiGraph = nx.node_link_graph(content, edges="edges")
        last_vertex = max([-1, *(node["vertex"] for node in nodes), *(v for edge in edges for v in edge["vertices"])])
    if last_vertex >= n_vertices:
        raise Mismatch(f"{path}: has vertex {last_vertex}, but the surface has 0..{n_vertices - 1}. {REANALYSE_ADVICE}")
    return graph
