"""The files of one hemisphere of an analysis, in either layout: ``write_hemisphere`` and ``read_hemisphere``.

In BIDS, surfaces, hinges and gyral graph are in scanner coordinates if the cortex has a transform to them, and ``curv``
has FreeSurfer's sign; reading reverses both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold import io
from morphofold.analysis.measures import Measures
from morphofold.errors import Mismatch
from morphofold.quantities import quantity
from morphofold.results.graph_file import read_graph, write_graph
from morphofold.results.layouts import INPUT_MAP_UNITS, MISSING_DESCRIPTION, Layout, in_bids_letters
from morphofold.results.subject_files import stats_name, write_gyral_stats
from morphofold.surface import Cortex, PerVertex, Regions, Verts
from morphofold.tables import write_table
from morphofold.validators import same_length

SURFACES_IN_SCANNER = ("white", "pial")
SURFACES = (*SURFACES_IN_SCANNER, "inflated", "sphere")  # the others have no place in the scanner
CURVATURE_DESCRIPTION = "Mean curvature of the pial surface, positive in sulci (FreeSurfer's sign)"


def write_hemisphere(m: Measures, layout: Layout, *, mgh: bool = False) -> None:
    """Write surfaces, maps, regions, mask, gyral graph and stats as FreeSurfer's, as far as measures and layout have
    any; with ``mgh`` measured maps also as MGH. For BIDS the measures are in scanner coordinates."""
    cortex, hemi = m.cortex, m.cortex.hemi
    for kind in SURFACES:
        if (surface := getattr(cortex, kind)) is not None:
            movable = kind in SURFACES_IN_SCANNER
            scanner = layout.bids and movable and cortex.transform is not None
            surface = surface if movable or not layout.bids else replace(surface, geometry=None)
            layout.write("surface", partial(io.write_surface, surface=surface, scanner=scanner), hemi, kind)
    for name, values in cortex.maps.items():
        _write_map(layout, hemi, "input_map", name, values)
    for name, values in m.maps.items():
        _write_map(layout, hemi, "map", name, values, ("freesurfer_map", "mgh_map") if mgh else ("freesurfer_map",))
    _write_regions_and_mask(layout, cortex)
    if m.graph is not None:
        layout.write("graph", partial(write_graph, graph=m.graph), hemi)
    if m.regions:
        layout.write("stats", partial(write_gyral_stats, m=m), name=stats_name(m))


def _write_map(layout: Layout, hemi: str, kind: str, name: str, values: PerVertex, copies: Sequence[str] = ()) -> None:
    """Write a map, and its copies in other formats if the layout has them; NaN is 0 in FreeSurfer's."""
    values, title = _with_file_sign(layout, kind, name, values), layout.ending(kind, name) if layout.bids else ""

    def write(path: Path) -> None:
        io.write_morph(path, values, name=title, hemi=hemi, nan=np.nan if path.suffix == ".gii" else 0.0)

    for each in (kind, *copies):
        layout.write(each, write, hemi, name, _about_map(kind, name))


def _with_file_sign(layout: Layout, kind: str, name: str, values: PerVertex) -> PerVertex:
    """Values of a map with the sign of its file, from ours or back: in BIDS, curv has FreeSurfer's."""
    return io.flip_curvature_sign(values) if layout.bids and (kind, name) == ("map", "H") else values


def _about_map(kind: str, name: str) -> dict[str, str]:
    if kind == "input_map":
        units = {"Units": INPUT_MAP_UNITS[name]} if name in INPUT_MAP_UNITS else {}
        return {"Description": f"{name} as it came with the surfaces", **units}
    label, unit = (CURVATURE_DESCRIPTION, "1/mm") if name == "H" else (quantity(name).label, quantity(name).unit)
    return {"Description": label, "Units": in_bids_letters(unit), "Missing": MISSING_DESCRIPTION}


def _write_regions_and_mask(layout: Layout, cortex: Cortex) -> None:
    """Write the regions and the mask of a cortex, as far as it has any."""
    hemi, regions, mask = cortex.hemi, cortex.regions, cortex.cortex
    surface = {"SpatialReference": f"bids::{layout.subject}/anat/{layout.path('surface', hemi, 'white').name}"}
    if regions is not None:
        text = f"Regions of the parcellation {regions.name}, one key per vertex"
        write, keys = partial(io.write_annotation, regions=regions), partial(_write_region_keys, regions)
        layout.write("regions", write, hemi, regions.name, {"Description": text, **surface})
        layout.write("region_keys", keys, hemi, regions.name)
    if mask is not None:
        about = {"Description": "1 where the vertex is cortex, else 0", "Type": "ROI", **surface}
        layout.write("mask", partial(io.write_label, mask=mask, verts=cortex.white.verts), hemi, about=about)


def _write_region_keys(regions: Regions, path: Path) -> None:
    """Write the table of keys, names and colours that BIDS wants beside regions."""
    named = enumerate(zip(regions.names, regions.colours.tolist()), start=1)
    rows = [{"index": key, "name": name, "color": "#{:02x}{:02x}{:02x}".format(*rgb)} for key, (name, rgb) in named]
    none: dict[str, Any] = {"index": 0, "name": "no region", "color": None}
    write_table(path, ("index", "name", "color"), [none, *rows])


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
    back = np.linalg.inv(transform) if layout.bids and transform is not None else None
    kinds = [kind for kind in SURFACES if kind in SURFACES_IN_SCANNER or entry.get(kind)]
    fields: dict[str, Any] = {k: replace(io.read_surface(path("surface", name=k)), name=f"{hemi}.{k}") for k in kinds}
    fields |= {key: entry[key] for key in ("hemi", "name", "origin", "units", "info")}
    n, annotation = len(fields["white"].verts), entry["annotation"]
    mask, regions = path("mask"), path("regions", name=annotation or "")
    cortex = Cortex(
        **fields,
        maps={name: read_map(layout, hemi, name, n, "input_map") for name in entry["came_with"]},
        cortex=io.read_label(mask, n) if entry["cortex_label"] else None,
        regions=_regions(regions, n, annotation) if annotation else None,
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
    return _with_file_sign(layout, kind, name, _of_size(io.read_morph(path), n, path))


def _regions(path: Path, n: int, name: str) -> Regions:
    regions = replace(io.read_annotation(path), name=name)
    _of_size(regions.labels, n, path)
    return regions


def _of_size(values: NDArray[Any], n: int, path: Path) -> NDArray[Any]:
    """The values of a file; raises ``Mismatch`` unless there is one for each vertex."""
    same_length(values, n, f"{path}:", "The files belong to two analyses.", Mismatch)
    return values


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
    if (graph := m.graph) is not None:
        graph = graph.copy()
        for _, node in graph.nodes(data=True):
            node |= {"position": at(node["position"]), "normal": node["normal"] @ linear}
        for _, _, edge in graph.edges(data=True):
            edge |= {"polyline": at(edge["polyline"])}
    return replace(m, cortex=replace(m.cortex, white=white, pial=pial), hinges=hinges, graph=graph)
