"""Data of the interactive view: surfaces, maps and nets of a page as compact text for ``templates/viewer.js``.

Positions have 16 bits per coordinate of the surface's bounding cube (0.003 mm on a brain). Maps have at most 16 bits
over their range, with 65535 for NaN. Every array is stored as differences to the element ``stride`` before it,
zigzag-coded, low bytes before high bytes; all are deflated, in base64. ``templates/viewer-data.js`` decodes it.
"""

import base64
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numba
import numpy as np
from fast_simplification import simplify
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morphofold.analysis.graph.hinges import counts
from morphofold.analysis.measures import Measures
from morphofold.geometry import in_use, morton_codes, unit
from morphofold.quantities import MAIN_MAPS, RELIEF, Quantity, common_limits, find, quantity
from morphofold.report import colours
from morphofold.report.pages.entries import Display, Entry
from morphofold.surface import Cortex, Faces, PerVertex, Surface, Verts
from morphofold.threads import SIMPLIFYING
from morphofold.words import number

VIEWER_SCRIPTS = ("tables.js", "viewer-data.js", "viewer-layers.js", "viewer.js")
DISPLAY_VERTICES = 60_000
STAGED_VERTICES = 15_000  # of a body drawn at every stage of growth
NAN_CODE_16_BIT = 65535
VertexIds = NDArray[np.int64]
Maps = Mapping[str, PerVertex]
#: crests as indices (P,) in the list of drawn vertices, and hinges: ``at``, the index of the nearest drawn vertex,
#: ``degree``, whether it is ``doubtful``, and ``lines`` of label and text
Net = tuple[list[VertexIds], list[dict[str, Any]]]
ShownMaps = dict[str, tuple[Quantity, colours.Limits]]  # map key -> quantity, limits for all surfaces


# what a page shows -------------------------------------------------------------------------------------------


def thinned(e: Entry) -> Entry:
    """An entry with its surface as the viewer draws it, at all of its stages."""
    most, stages = STAGED_VERTICES if e.stages else DISPLAY_VERTICES, [m.cortex for m in e.stages]
    return replace(e, display=thin(e.cortex, most, stages))


def entries_with_map(entries: Sequence[Entry], key: str) -> list[tuple[Entry, PerVertex]]:
    """The entries that have the map ``key`` with at least one value, each with the map."""
    maps = [(e, find(e.measures.maps, key)) for e in entries]
    return [(e, a) for e, a in maps if a is not None and np.isfinite(a).any()]


def shown_maps(entries: Sequence[Entry]) -> ShownMaps:
    """The maps that a page shows, heights of folds and main maps first, with the limits that all its surfaces share."""
    others = {quantity(n).key for e in entries for n in e.measures.maps} - {RELIEF, *MAIN_MAPS}
    shown = {}
    for key in (RELIEF, *MAIN_MAPS, *sorted(others)):
        if arrays := [a for _, a in entries_with_map(entries, key)]:
            what = quantity(key, arrays)
            shown[key] = (what, common_limits(what, arrays))
    return shown


def viewer_data(entries: Sequence[Entry], shown: ShownMaps) -> tuple[dict[str, Any], dict[str, Markup]]:
    """The JSON configuration of viewer.js, and the packed data of each surface (``"0"``) and its stages (``"0-1"``)."""
    surfaces, blocks = [], {}
    steps = {key: (high - low) / 2000 for key, (_, (low, high)) in shown.items()}  # finer than the colours can show
    for k, e in enumerate(entries):
        cortex, display = e.cortex, e.display
        maps = {key: a for key in shown for _, a in entries_with_map([e], key)}
        packed = pack(cortex, maps, steps, display, net_of(e.measures, display.ids), e.person)
        stages = [Packed(display.ids, pial=m.cortex.pial, white=m.cortex.white) for m in e.stages]
        for stage, m in zip(stages, e.stages):
            named = {key: find(m.maps, key) for key in MAIN_MAPS if key in shown}
            stage.add_maps({key: a for key, a in named.items() if a is not None}, steps)
            stage.meta["g"] = float(m.cortex.info["g"])
        facts = {"name": e.name, "hemi": cortex.hemi, "sided": cortex.origin != "simulation", "g": cortex.info.get("g")}
        surfaces.append({**packed.meta, **facts, "stages": [stage.meta for stage in stages]})
        blocks[f"{k}"] = packed.data
        blocks.update({f"{k}-{i}": stage.data for i, stage in enumerate(stages)})
    maps_shown = [
        {name: getattr(what, name) for name in ("key", "label", "unit", "signed")}
        | {"main": key in MAIN_MAPS, "limits": limits}
        for key, (what, limits) in shown.items()
    ]
    config = {
        "surfaces": surfaces,
        "maps": maps_shown,
        "tables": {"sequential": colours.sequential().tolist(), "diverging": colours.diverging().tolist()},
        "missing": colours.NOT_MEASURED_COLOUR,
        "bare": colours.BARE_SURFACE_COLOUR,
    }
    return config, blocks


def net_of(measures: Measures, ids: VertexIds) -> Net | None:
    """The net of a surface, of which only the vertices ``ids`` (n,) are drawn; None if it has no graph."""
    if measures.graph is None:
        return None
    tree = cKDTree(measures.cortex.white.verts[ids])
    crests = []
    for _, _, crest in measures.graph.edges(data=True):
        near: VertexIds = tree.query(crest["polyline"])[1].astype(np.int64)
        crests.append(near[np.flatnonzero(np.diff(near, prepend=-1))])  # drop consecutive repeats
    arms = defaultdict[int, list[dict[str, Any]]](list)
    for row in measures.arms:
        arms[row["hinge"]].append(row)
    hinges = [
        {
            "at": int(tree.query((row["x"], row["y"], row["z"]))[1]),
            "degree": row["degree"],
            "doubtful": not counts(row),
            "lines": _lines_of_click_text(row, arms[row["hinge"]]),
        }
        for row in measures.hinges
    ]
    return crests, hinges


def _lines_of_click_text(row: dict[str, Any], arms: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Label and text that a click on a hinge shows."""
    angles = ", ".join(f"{number(arm['angle_deg'])}°" for arm in arms)
    lengths = ", ".join(number(arm["length_mm"]) for arm in arms)
    kind = f"{row['hinge']}, {row['shape']}" + (", by a dead-end gyrus" if row.get("blind") else "")
    lines = [("Hinge", kind), ("Angles", angles), ("Arms", f"{lengths} mm")]
    if row.get("confidence") is not None:
        doubt = "" if counts(row) else ", doubtful: not counted"
        lines.append(("Confidence", f"{number(row['confidence'])}{doubt}"))
    return lines


# packing -----------------------------------------------------------------------------------------------------


def pack(
    cortex: Cortex,
    maps: Maps,
    steps: Mapping[str, float] = {},
    shown: Display | None = None,
    net: Net | None = None,
    person: str | None = None,
) -> "Packed":
    """Pack the pial, white and (if any) inflated surface of a cortex, and maps (N,), for the viewer.

    ``steps`` gives the coarsest step allowed for a map, which makes the data smaller; without it, a map has 16 bits
    over its range. ``shown`` is the result of ``thin`` for the cortex; None: thinned here. ``net`` is drawn over it.
    With ``person``, the points on the sphere are packed, too: a click on one surface also marks this point on the
    others of the same person.
    """
    shown = shown or thin(cortex)
    packed = Packed(shown.ids, pial=cortex.pial, white=cortex.white, inflated=cortex.inflated)
    packed.add("faces", shown.faces.astype(np.uint32).ravel(), stride=3)
    packed.add("ids", shown.ids.astype(np.uint32))
    packed.add_maps(maps, steps)
    packed.meta |= {
        "vertices": len(shown.ids),
        "triangles": len(shown.faces),
        "all_vertices": cortex.n_vertices,
        "thinned": shown.thinned,
        "net": None,
        "regions": None,
    }
    if cortex.regions is not None:
        packed.add("regions", (cortex.regions.labels[shown.ids] + 1).astype(np.uint16))
        packed.meta["regions"] = ["no region", *cortex.regions.names]
    if person is not None and cortex.sphere is not None:
        box = packed.positions("sphere", unit(cortex.sphere.verts[shown.ids]))
        packed.meta["sphere"] = {"person": person, **box}
    if net is not None:
        crests, hinges = net
        packed.add("crest-ids", np.concatenate([np.empty(0), *crests]).astype(np.uint32))
        packed.add("crest-ends", np.cumsum([len(line) for line in crests]).astype(np.uint32))
        packed.meta["net"] = {"hinges": hinges}
    return packed


class Packed:
    """What the page inlines for one surface: ``meta`` goes into JSON, ``data`` into a text block.

    The data are encoded arrays at the vertices ``ids``, one after the other; ``meta`` has where each begins.
    """

    def __init__(self, ids: VertexIds, **surfaces: Surface | None) -> None:
        self.ids = ids
        self.meta: dict[str, Any] = {"arrays": {}}
        self.arrays = b""
        drawn = {name: surface.verts[ids] for name, surface in surfaces.items() if surface is not None}
        self.meta["surfaces"] = {name: self.positions(name, verts) for name, verts in drawn.items()}

    @property
    def data(self) -> Markup:
        return Markup(base64.b64encode(zlib.compress(self.arrays, 6)).decode())  # base64 needs no escaping

    def add(self, name: str, array: np.ndarray, stride: int = 1) -> None:
        at = {"at": len(self.arrays), "n": int(array.size), "bytes": array.itemsize, "stride": stride}
        self.meta["arrays"][name] = at
        self.arrays += encode(array, stride)

    def positions(self, name: str, verts: np.ndarray) -> dict[str, Any]:
        """Add positions, and return their box."""
        low = verts.min(axis=0)
        edge = float((verts.max(axis=0) - low).max()) or 1.0
        self.add(name, np.round((verts - low) / edge * 65535).astype(np.uint16).ravel(), stride=3)
        return {"low": [round(float(x), 5) for x in low], "edge": round(edge, 5)}

    def add_maps(self, maps: Maps, steps: Mapping[str, float]) -> None:
        """Add maps; their limits are those of the codes, not of the values."""
        limits = self.meta["maps"] = {}
        for key, values in ((key, a[self.ids]) for key, a in maps.items()):
            known = np.isfinite(values)
            low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 1.0)
            codes = np.full(len(values), NAN_CODE_16_BIT, dtype=np.uint16)
            step = max(steps.get(key, 0.0), (high - low) / (NAN_CODE_16_BIT - 1)) or 1.0
            codes[known] = np.round((values[known] - low) / step).astype(np.uint16)
            self.add(f"map:{key}", codes)
            limits[key] = {"low": low, "high": low + step * (NAN_CODE_16_BIT - 1)}


def encode(array: np.ndarray, stride: int = 1) -> bytes:
    """Encode uint16 or uint32: wrapping differences to the element ``stride`` before, zigzag, a plane per byte."""
    step = array.copy()
    step[stride:] -= array[:-stride]
    zigzag = (step << 1) ^ -(step >> (8 * array.itemsize - 1))  # the last is all ones if it is negative
    return zigzag.view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def thin(cortex: Cortex, max_vertices: int = DISPLAY_VERTICES, stages: Sequence[Cortex] = ()) -> Display:
    """At most about ``max_vertices`` vertices and faces between them, ordered so that they compress well.

    The surface midway between white and pial is decimated by quadric errors. Each remaining vertex is moved back to a
    nearest original vertex, so that all surfaces and maps use the same index. The midway surface is used because
    decimating the pial alone leaves a white surface 20 % too large on an individual (0.1 % with the midway surface),
    and decimating the white alone damages sulcal walls. ``stages`` are other stages of the body. Then the mean of all
    stages is decimated, so that the mesh does not fold over in any of them.
    """
    ids, _, faces = in_use(cortex.pial.verts, cortex.faces)
    used = len(ids)
    if used > max_vertices:
        middle = np.mean([surface.verts for c in (cortex, *stages) for surface in (c.pial, c.white)], axis=0)
        ids, faces = _decimated(middle, cortex.faces, max_vertices / cortex.n_vertices)
    points = cortex.pial.verts[ids] - cortex.pial.verts[ids].min(axis=0)
    order = np.argsort(morton_codes(points / (float(points.max()) or 1.0), bits=10), kind="stable")
    faces = np.argsort(order)[faces]
    first = faces.argmin(axis=1)  # rotate each triangle so that its lowest index is first
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort((faces[:, 1], faces[:, 0]))]
    return Display(ids[order], faces, thinned=len(ids) < used)


def _decimated(middle: Verts, faces: Faces, keep: float) -> tuple[VertexIds, Faces]:
    with SIMPLIFYING:
        points, triangles = simplify(middle, faces.astype(np.int32), 1.0 - keep)
    _, near = cKDTree(middle).query(points, k=12, workers=numba.get_num_threads())
    chosen = distinct(near)
    ids, place = np.unique(chosen, return_inverse=True)
    faces = place[triangles]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return ids, faces[whole]


def distinct(near: VertexIds) -> VertexIds:
    """One value of ``near`` (n, k) per row, nearest first, and no value twice if possible.

    Two points on one vertex would pinch the surface there. A row whose candidates are all taken shares its nearest.
    """
    chosen = np.full(len(near), -1, dtype=np.int64)
    taken = np.zeros(int(near.max()) + 1, dtype=bool)
    for column in near.T:
        rows = np.flatnonzero((chosen < 0) & ~taken[column])
        values, first = np.unique(column[rows], return_index=True)
        chosen[rows[first]] = values
        taken[values] = True
    return np.where(chosen < 0, near[:, 0], chosen)
