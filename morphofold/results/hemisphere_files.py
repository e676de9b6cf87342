"""The files of one hemisphere of an analysis, in either layout: ``write_hemisphere`` and ``read_hemisphere``.

In BIDS, surfaces, hinges and gyral graph are in scanner coordinates if the cortex has a transform to them, and ``curv``
has FreeSurfer's sign; reading reverses both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from morphofold import io
from morphofold.analysis.measures import Measures
from morphofold.errors import DamagedFile, Mismatch
from morphofold.io import gifti
from morphofold.quantities import quantity
from morphofold.results.graph_file import read_graph, write_graph
from morphofold.results.layouts import INPUT_MAP_UNITS, MISSING_DESCRIPTION, Layout, in_bids_letters
from morphofold.results.subject_files import stats_name, write_gyral_stats
from morphofold.results.summary import REANALYSE_ADVICE
from morphofold.surface import Cortex, PerVertex, Regions, Surface, Verts
from morphofold.tables import write_table

SURFACES_IN_SCANNER = ("white", "pial")
SURFACES = (*SURFACES_IN_SCANNER, "inflated", "sphere")  # the others have no place in the scanner
CURVATURE_DESCRIPTION = "Mean curvature of the pial surface, positive in sulci (FreeSurfer's sign)"


def write_hemisphere(m: Measures, layout: Layout, *, mgh: bool = False) -> None:
    """Write surfaces, maps, regions, mask and gyral graph; in the plain layout also stats as FreeSurfer's, and with
    ``mgh`` measured maps as MGH. For BIDS the measures are in scanner coordinates."""
    cortex, hemi = m.cortex, m.cortex.hemi
    for kind in SURFACES:
        if (surface := getattr(cortex, kind)) is not None:
            _write_surface(layout, cortex, kind, surface)
    for kind, maps in (("input_map", cortex.maps), ("map", m.maps)):
        for name, values in maps.items():
            _write_map(layout, hemi, kind, name, values, mgh and kind == "map")
    _write_regions_and_mask(layout, cortex)
    if m.graph is not None:
        write_graph(layout.new_path("graph", hemi), m.graph)
    if m.regions and not layout.bids:
        write_gyral_stats(layout.new_path("stats", name=stats_name(m)), m)


def _write_surface(layout: Layout, cortex: Cortex, kind: str, surface: Surface) -> None:
    path, movable = layout.new_path("surface", cortex.hemi, kind), kind in SURFACES_IN_SCANNER
    if layout.bids:
        surface = surface if movable else replace(surface, geometry=None)
        scanner = movable and cortex.transform is not None
        gifti.write_surface(path, surface, cortex.hemi, scanner=scanner)
    else:
        io.write_surface(path, surface)


def _write_map(layout: Layout, hemi: str, kind: str, name: str, values: PerVertex, mgh: bool) -> None:
    """Write a map as GIFTI; in the plain layout also in FreeSurfer's format, which suffices for an input map."""
    path = layout.new_path(kind, hemi, name)
    if layout.bids:
        values = _with_file_sign(layout, kind, name, values)
        io.write_gifti_map(path, values, name=layout.ending(kind, name), nan=np.nan, hemi=hemi)
        layout.describe(path, **_about_map(kind, name))
        return
    if path.suffix == ".gii":
        io.write_gifti_map(path, values, nan=np.nan, hemi=hemi)
    for end in ("", ".mgh") if mgh else ("",):
        io.write_morph(path.with_name(path.name.removesuffix(".shape.gii") + end), values, nan=0.0)


def _with_file_sign(layout: Layout, kind: str, name: str, values: PerVertex) -> PerVertex:
    """Values of a map with the sign of its file, or from there."""
    return io.flip_curvature_sign(values) if layout.bids and (kind, name) == ("map", "H") else values


def _about_map(kind: str, name: str) -> dict[str, str]:
    if kind == "input_map":
        units = {"Units": INPUT_MAP_UNITS[name]} if name in INPUT_MAP_UNITS else {}
        return {"Description": f"{name} as it came with the surfaces", **units}
    label, unit = (CURVATURE_DESCRIPTION, "1/mm") if name == "H" else (quantity(name).label, quantity(name).unit)
    return {"Description": label, "Units": in_bids_letters(unit), "Missing": MISSING_DESCRIPTION}


# regions and mask -------------------------------------------------------------------------------------------


def _write_regions_and_mask(layout: Layout, cortex: Cortex) -> None:
    """Write the regions and the mask of a cortex, as far as it has any."""
    hemi, regions, mask = cortex.hemi, cortex.regions, cortex.cortex
    surface = {"SpatialReference": f"bids::{layout.subject}/anat/{layout.path('surface', hemi, 'white').name}"}
    if regions is not None:
        path = layout.new_path("regions", hemi, regions.name)
        if layout.bids:
            gifti.write_regions(path, regions, hemi)
            write_table(path.with_name(path.name.replace(".label.gii", ".tsv")), *_region_keys(regions))
        else:
            io.write_annotation(path, regions)
        text = f"Regions of the parcellation {regions.name}, one key per vertex"
        layout.describe(path, Description=text, **surface)
    if mask is not None:
        path = layout.new_path("mask", hemi)
        if layout.bids:
            white = np.array([[255, 255, 255]], np.uint8)
            gifti.write_regions(path, Regions(np.where(mask, 0, -1), ("cortex",), white, "cortex"), hemi)
        else:
            io.write_label(path, mask, cortex.white.verts)
        layout.describe(path, Description="1 where the vertex is cortex, else 0", Type="ROI", **surface)


def _region_keys(regions: Regions) -> tuple[tuple[str, ...], list[dict[str, Any]]]:
    """Columns and rows of the table of keys, names and colours that BIDS wants beside regions."""
    named = enumerate(zip(regions.names, regions.colours.tolist()), start=1)
    rows = [{"index": key, "name": name, "color": "#{:02x}{:02x}{:02x}".format(*rgb)} for key, (name, rgb) in named]
    return ("index", "name", "color"), [{"index": 0, "name": "no region", "color": None}, *rows]


def _read_regions(path: Path, n: int, name: str, layout: Layout) -> Regions:
    if not layout.bids:
        return io.read_annotation(path)
    regions = gifti.read_gifti_regions(path, name)
    _check_size(path, regions.labels, n)
    return regions


# reading ----------------------------------------------------------------------------------------------------


def read_hemisphere(entry: Mapping[str, Any], tables: Mapping[str, list[dict[str, Any]]], layout: Layout) -> Measures:
    """Measures from the entry of a surface in the summary, the tables of both hemispheres, and its own files.

    Raises
    ------
    FileNotFoundError
        If a file of it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    hemi, path = entry["hemi"], partial(layout.path, hemi=entry["hemi"])
    transform = None if entry["transform"] is None else np.array(entry["transform"], dtype=np.float64)
    back = _inverse(transform, layout) if layout.bids and transform is not None else None
    kinds = [kind for kind in SURFACES if kind in SURFACES_IN_SCANNER or entry.get(kind)]
    fields: dict[str, Any] = {k: replace(io.read_surface(path("surface", name=k)), name=f"{hemi}.{k}") for k in kinds}
    fields |= {key: entry[key] for key in ("hemi", "name", "origin", "units", "info")}
    n, annotation = len(fields["white"].verts), entry["annotation"]
    cortex = Cortex(
        **fields,
        maps={name: read_map(layout, hemi, name, n, "input_map") for name in entry["came_with"]},
        cortex=_read_mask(path("mask"), n, layout) if entry["cortex_label"] else None,
        regions=_read_regions(path("regions", name=annotation), n, annotation, layout) if annotation else None,
        transform=transform,
        portion=float(entry["portion"]),
        files=tuple(entry["files"]),
        inputs=tuple(entry["inputs"]),
    )
    own: dict[str, Any] = {name: [row for row in rows if row["hemi"] == hemi] for name, rows in tables.items()}
    maps = {name: read_map(layout, hemi, name, n) for name in entry["maps"]}
    graph = read_graph(path("graph"), n) if entry["graph"] else None
    own |= {key: entry[key] for key in ("parameters", "notes")}
    return transformed(Measures(cortex, entry["measures"], maps, **own, graph=graph), back)


def read_map(layout: Layout, hemi: str, name: str, n: int, kind: str = "map") -> PerVertex:
    """A map (N,) of a surface with ``n`` vertices: a measured one, positive where convex, or an ``"input_map"``."""
    path = layout.path(kind, hemi, name)
    values = io.read_morph(path)
    if path.suffix == ".gii":  # the cortex checks the size of others
        _check_size(path, values, n)
    return _with_file_sign(layout, kind, name, values)


def _read_mask(path: Path, n: int, layout: Layout) -> NDArray[np.bool_]:
    return _read_regions(path, n, "cortex", layout).labels == 0 if layout.bids else io.read_label(path, n)


def _check_size(path: Path, values: NDArray[Any], n: int) -> None:
    """Raise ``Mismatch`` unless a file has a value for each vertex."""
    if values.shape != (n,):
        raise Mismatch(f"{path}: {values.shape} values for {n} vertices. The files belong to two analyses.")


# to the scanner's coordinates, and back ---------------------------------------------------------------------


def transformed(m: Measures, transform: np.ndarray | None) -> Measures:
    """Measures with surfaces, hinges and gyral graph transformed by an affine (4, 4); the same without one."""
    if transform is None:
        return m
    linear, offset = transform[:3, :3].T, transform[:3, 3]

    def at(points: Verts) -> Verts:
        return np.asarray(points @ linear + offset, dtype=np.float64)

    white, pial = (replace(s, verts=at(s.verts), geometry=None) for s in (m.cortex.white, m.cortex.pial))
    hinges = [row | dict(zip("xyz", at(np.array([row[k] for k in "xyz"])).tolist())) for row in m.hinges]
    graph = nx.MultiGraph() if m.graph is None else m.graph.copy()
    for _, node in graph.nodes(data=True):
        node |= {"position": at(node["position"]), "normal": node["normal"] @ linear}
    for _, _, edge in graph.edges(data=True):
        edge |= {"polyline": at(edge["polyline"])}
    cortex = replace(m.cortex, white=white, pial=pial)
    return replace(m, cortex=cortex, hinges=hinges, graph=None if m.graph is None else graph)


def _inverse(transform: np.ndarray, layout: Layout) -> np.ndarray:
    try:
        return np.linalg.inv(transform)
    except np.linalg.LinAlgError as error:
        raise DamagedFile(
            f"{layout.folder / 'anat'}: the transform of its provenance can't be inverted ({error}). {REANALYSE_ADVICE}"
        ) from None
