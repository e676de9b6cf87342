"""One hemisphere of a subject of a BIDS dataset: ``write_hemisphere`` and ``read_hemisphere``.

In files, surfaces and gyral graph are in scanner coordinates if the cortex has a transform to them, and ``curv`` has
FreeSurfer's sign; reading reverses both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.analysis.measures import Measures
from morphofold.errors import DamagedFile
from morphofold.io import flip_curvature_sign, read_surface, write_gifti_map
from morphofold.io.gifti import read_gifti_regions, write_gifti_regions, write_gifti_surface
from morphofold.provenance import strict_json
from morphofold.quantities import quantity
from morphofold.results.graph_file import read_graph, write_graph
from morphofold.results.summary import REANALYSE_ADVICE, check_size, measures_of, sized_map, surfaces_of
from morphofold.surface import PerVertex, Regions, Surface, Verts
from morphofold.tables import write_table

SURFACES_NOT_MOVED = ("inflated", "sphere")  # surfaces without a place in the scanner
BIDS_HEMISPHERES = {"lh": "L", "rh": "R"}
MAP_ENDINGS = {  # a map's name -> the end of its file's name
    "H": "curv",
    "cortical_thickness": "thickness",
    "gyral_thickness": "desc-gyral_thickness",
    "area": "area",
}
INPUT_MAP_UNITS = {
    "thickness": "mm",
    "curv": "1/mm",
    "sulc": "mm",
    "area": "mm^2",
}  # maps that come with surfaces, their units
CURVATURE_DESCRIPTION = "Mean curvature of the pial surface, positive in sulci (FreeSurfer's sign)"
MISSING_DESCRIPTION = "NaN where there is no value, as on the medial wall"


@dataclass(frozen=True)
class HemisphereFiles:
    """Paths of the files of a hemisphere: ``anat/sub-NAME_hemi-L_...``."""

    anat: Path
    subject: str
    hemi: str

    def file(self, end: str) -> Path:
        return self.anat / f"{self.subject}_hemi-{BIDS_HEMISPHERES[self.hemi]}_{end}"

    def say(self, end: str, **fields: Any) -> None:
        """Write the JSON file beside a map, mask or regions."""
        self.file(f"{end}.json").write_text(strict_json(fields), encoding="utf-8")


def write_hemisphere(m: Measures, anat: Path, subject: str) -> None:
    """Write surfaces, maps, regions, mask and graph; maps, regions and mask get a JSON file that describes them."""
    cortex, place = m.cortex, HemisphereFiles(anat, subject, m.cortex.hemi)
    for kind, surface in surfaces_of(cortex).items():
        to_scanner = None if kind in SURFACES_NOT_MOVED else cortex.transform
        verts = surface.verts if to_scanner is None else moved(surface.verts, to_scanner)
        footer = None if kind in SURFACES_NOT_MOVED or to_scanner is not None else surface.geometry
        there = replace(surface, verts=verts, geometry=footer)
        write_gifti_surface(place.file(f"{kind}.surf.gii"), there, cortex.hemi, scanner=to_scanner is not None)
    for name, values in m.maps.items():
        label, unit = (
            (CURVATURE_DESCRIPTION, "1/mm")
            if name == "H"
            else (quantity(name).label, in_bids_letters(quantity(name).unit))
        )
        values = flip_curvature_sign(values) if name == "H" else values
        _write_map(place, _map_ending(name), values, Description=label, Units=unit, Missing=MISSING_DESCRIPTION)
    for name, values in cortex.maps.items():
        known = {"Units": INPUT_MAP_UNITS[name]} if name in INPUT_MAP_UNITS else {}
        _write_map(place, _input_map_ending(name), values, Description=f"{name} as it came with the surfaces", **known)
    on = f"bids::{subject}/anat/{place.file('white.surf.gii').name}"
    if cortex.regions is not None:
        _write_regions(place, cortex.regions, on)
    if cortex.cortex is not None:
        mask = Regions(np.where(cortex.cortex, 0, -1), ("cortex",), np.array([[255, 255, 255]], np.uint8), "cortex")
        write_gifti_regions(place.file("desc-cortex_mask.label.gii"), mask, cortex.hemi)
        what = "1 where the vertex is cortex, else 0"
        place.say("desc-cortex_mask", Description=what, Type="ROI", SpatialReference=on)
    if m.graph is not None:
        write_graph(place.file("desc-graph_morph.json"), _moved_graph(m.graph, cortex.transform))


def read_hemisphere(
    entry: Mapping[str, Any], tables: Mapping[str, list[dict[str, Any]]], anat: Path, subject: str
) -> Measures:
    """Read what ``write_hemisphere`` wrote, with its entry in the provenance and its rows of the tables.

    Raises
    ------
    FileNotFoundError
        If a file of it is missing.
    ValueError
        If a file cannot be read; the message names it.
    """
    place = HemisphereFiles(anat, subject, entry["hemi"])
    back = None if entry["transform"] is None else _inverse_transform(entry["transform"], anat)

    def surface(kind: str) -> Surface:
        found = read_surface(place.file(f"{kind}.surf.gii"))
        verts = found.verts if back is None or kind in SURFACES_NOT_MOVED else moved(found.verts, back)
        return Surface(verts, found.faces, f"{place.hemi}.{kind}")

    found = measures_of(
        entry,
        tables,
        surface=surface,
        mask=lambda n: _read_regions(place.file("desc-cortex_mask.label.gii"), n, "cortex").labels == 0,
        regions=lambda name, n: _read_regions(place.file(f"{_regions_ending(name)}.label.gii"), n, name),
        came_with=lambda name, n: sized_map(place.file(f"{_input_map_ending(name)}.shape.gii"), n),
        map_of=lambda name, n: _read_map(place, name, n),
        graph=lambda n: _moved_graph(read_graph(place.file("desc-graph_morph.json"), n), back),
    )
    return replace(found, hinges=moved_rows(found.hinges, back))


def read_pial(anat: Path, subject: str, hemi: str, name: str) -> tuple[Surface, PerVertex | None]:
    """Read the pial surface as it was written, and the map ``name`` on it if there is one."""
    place = HemisphereFiles(anat, subject, hemi)
    pial, path = read_surface(place.file("pial.surf.gii")), place.file(f"{_map_ending(name)}.shape.gii")
    return pial, _read_map(place, name, len(pial.verts)) if path.is_file() else None


# elsewhere --------------------------------------------------------------------------------------------------


def moved(verts: Verts, transform: np.ndarray) -> Verts:
    """Points (N, 3) or (3,) transformed by an affine (4, 4)."""
    return np.asarray(verts @ transform[:3, :3].T + transform[:3, 3], dtype=np.float64)


def moved_rows(rows: list[dict[str, Any]], transform: np.ndarray | None) -> list[dict[str, Any]]:
    """Rows of hinges with transformed points."""
    if transform is None:
        return rows
    return [row | dict(zip("xyz", moved(np.array([row[k] for k in "xyz"]), transform).tolist())) for row in rows]


def _inverse_transform(transform: Any, anat: Path) -> np.ndarray:
    try:
        return np.linalg.inv(np.array(transform, dtype=np.float64))
    except np.linalg.LinAlgError as error:
        raise DamagedFile(
            f"{anat}: the transform of its provenance can't be inverted ({error}). {REANALYSE_ADVICE}"
        ) from None


def _moved_graph(graph: Any, transform: np.ndarray | None) -> Any:
    if transform is None:
        return graph
    there = graph.copy()
    for _, node in there.nodes(data=True):
        node |= {"position": moved(node["position"], transform), "normal": node["normal"] @ transform[:3, :3].T}
    for _, _, edge in there.edges(data=True):
        edge |= {"polyline": moved(edge["polyline"], transform)}
    return there


# names ------------------------------------------------------------------------------------------------------


def in_bids_letters(unit: str) -> str:
    """A unit as BIDS writes it."""
    return unit.replace("²", "^2").replace("³", "^3") or "1"


def _map_ending(name: str) -> str:
    """End of the name of a map's file: ``desc-sulcalDepth_morph``."""
    return MAP_ENDINGS.get(name, f"desc-{_camel_case(name)}_morph")


def _input_map_ending(name: str) -> str:
    """End of the name of the file of a map that came with the surfaces: ``desc-input_sulc``."""
    return f"desc-input_{name}" if name in INPUT_MAP_UNITS else f"desc-{_camel_case(f'input_{name}')}_morph"


def _regions_ending(name: str) -> str:
    return f"seg-{_camel_case(name)}_dseg"


def _camel_case(name: str) -> str:
    """``shape_index`` as BIDS writes it: ``shapeIndex``."""
    first, *rest = ("".join(c for c in word if c.isascii() and c.isalnum()) for word in name.split("_"))
    return first + "".join(word[:1].upper() + word[1:] for word in rest)


# maps and regions -------------------------------------------------------------------------------------------


def _write_map(place: HemisphereFiles, end: str, values: PerVertex, **fields: Any) -> None:
    write_gifti_map(place.file(f"{end}.shape.gii"), values, name=end, nan=np.nan, hemi=place.hemi)
    place.say(end, **fields)


def _read_map(place: HemisphereFiles, name: str, n: int) -> PerVertex:
    """A measured map, positive where convex."""
    values = sized_map(place.file(f"{_map_ending(name)}.shape.gii"), n)
    return flip_curvature_sign(values) if name == "H" else values


def _write_regions(place: HemisphereFiles, regions: Regions, on: str) -> None:
    """Write regions, and a table of their keys and names, as in BIDS."""
    end = _regions_ending(regions.name)
    write_gifti_regions(place.file(f"{end}.label.gii"), regions, place.hemi)
    named = enumerate(zip(regions.names, regions.colours.tolist()), start=1)
    rows = [{"index": key, "name": name, "color": "#{:02x}{:02x}{:02x}".format(*rgb)} for key, (name, rgb) in named]
    rows.insert(0, {"index": 0, "name": "no region", "color": None})
    write_table(place.file(f"{end}.tsv"), ("index", "name", "color"), rows)
    what = f"Regions of the parcellation {regions.name}, one key per vertex"
    place.say(end, Description=what, SpatialReference=on)


def _read_regions(path: Path, n: int, name: str) -> Regions:
    regions = read_gifti_regions(path, name)
    check_size(path, regions.labels, n)
    return regions
