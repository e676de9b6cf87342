"""Data of the interactive view: surfaces, maps and nets of a page as compact text for ``templates/viewer.js``.

In go the entries of a page (:mod:`morphofold.report.pages.page_entries`), out come their thinned meshes and the
packed data; ``cortex_pages`` calls it.

Positions have 16 bits per coordinate of the surface's bounding cube (0.003 mm on a brain). Maps have at most 16 bits
over their range, with 65535 for NaN. Every array is stored as differences to the element ``stride`` before it,
zigzag-coded, low bytes before high bytes; all are deflated, in base64. ``templates/viewer-data.js`` decodes it.
"""

import base64
import zlib
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
from morphofold.analysis.measures_result import Measures
from morphofold.geometry import in_use, morton_codes, unit
from morphofold.number_texts import number
from morphofold.quantities import MAIN_MAPS, RELIEF, Quantity, common_limits, find, quantity
from morphofold.report import colours
from morphofold.report.pages.page_entries import Display, Entries, Entry
from morphofold.surface import Cortex, PerVertex
from morphofold.threads import SIMPLIFY_LOCK

VIEWER_SCRIPTS = ("tables.js", "viewer-data.js", "viewer-layers.js", "viewer.js")
DISPLAY_VERTICES = 60_000
STAGED_VERTICES = 15_000  # of a body drawn at every stage of growth
NAN_CODE_16_BIT = 65535
VertexIds = NDArray[np.int64]
Shown = dict[str, Any]  # of the page's JSON
ShownMaps = dict[str, Quantity]  # by key, with limits for all surfaces


# what a page shows -------------------------------------------------------------------------------------------


def thinned(entry: Entry) -> Entry:
    """An entry with its surface as the viewer draws it, at all of its stages."""
    max_verts, stages = STAGED_VERTICES if entry.stages else DISPLAY_VERTICES, [m.cortex for m in entry.stages]
    return replace(entry, display=thin(entry.cortex, max_verts, stages))


def entries_with_map(entries: Entries, key: str) -> list[tuple[Entry, PerVertex]]:
    """The entries that have the map ``key`` with at least one value, each with the map."""
    maps = [(entry, find(entry.measures.maps, key)) for entry in entries]
    return [(entry, values) for entry, values in maps if values is not None and np.isfinite(values).any()]


def shown_maps(entries: Entries) -> ShownMaps:
    """The maps that a page shows, heights of folds and main maps first, with the limits that all its surfaces share."""
    other_maps = {quantity(name).key for entry in entries for name in entry.measures.maps} - {RELIEF, *MAIN_MAPS}
    maps = {}
    for key in (RELIEF, *MAIN_MAPS, *sorted(other_maps)):
        if map_arrays := [map_values for _, map_values in entries_with_map(entries, key)]:
            measure = quantity(key, map_arrays)
            maps[key] = replace(measure, limits=common_limits(measure, map_arrays))
    return maps


def viewer_data(entries: Entries, maps: ShownMaps) -> tuple[Shown, dict[str, Markup]]:
    """The JSON configuration of viewer.js, and the packed data of each surface (``"0"``) and its stages (``"0-1"``)."""
    surfaces, packed_blocks = [], dict[str, Markup]()
    # finer than the colours can show
    step_by_map = {key: np.ptp(measure.limits or 0) / 2000 for key, measure in maps.items()}
    main_steps = {key: step_by_map[key] for key in MAIN_MAPS if key in maps}
    for k, entry in enumerate(entries):
        packed, stages = pack(entry, step_by_map), [Packed(m, entry.display.ids, main_steps) for m in entry.stages]
        surfaces.append(packed.meta | {"stages": [stage.meta for stage in stages]})
        packed_blocks |= {f"{k}": packed.data} | {f"{k}-{i}": stage.data for i, stage in enumerate(stages)}
    config = {
        "surfaces": surfaces,
        "maps": [vars(measure) | {"main": key in MAIN_MAPS} for key, measure in maps.items()],
        "tables": {"sequential": colours.sequential().tolist(), "diverging": colours.diverging().tolist()},
        "missing": colours.NOT_MEASURED_COLOUR,
        "bare": colours.BARE_SURFACE_COLOUR,
    }
    return config, packed_blocks


def hinges_of(measures: Measures, vertex_tree: cKDTree) -> list[Shown]:
    """The hinges of a net: index ``at`` of the nearest in a tree of drawn vertices, ``degree``, whether it is
    ``doubtful``, and ``lines`` of label and text that a click on it shows."""
    hinges = []
    for hinge in measures.hinges:
        arms = [arm for arm in measures.arms if arm["hinge"] == hinge["hinge"]]
        angles = ", ".join(f"{number(arm['angle_deg'])}°" for arm in arms)
        lengths = ", ".join(number(arm["length_mm"]) for arm in arms)
        hinge_text = f"{hinge['hinge']}, {hinge['shape']}" + (", by a dead-end gyrus" if hinge.get("blind") else "")
        shown_lines = [("Hinge", hinge_text), ("Angles", angles), ("Arms", f"{lengths} mm")]
        is_doubtful = not counts(hinge)
        if hinge.get("confidence") is not None:
            doubt_text = ", doubtful: not counted" if is_doubtful else ""
            shown_lines.append(("Confidence", f"{number(hinge['confidence'])}{doubt_text}"))
        drawn_vertex = int(vertex_tree.query((hinge["x"], hinge["y"], hinge["z"]))[1])
        hinges.append({"at": drawn_vertex, "degree": hinge["degree"], "doubtful": is_doubtful, "lines": shown_lines})
    return hinges


# packing -----------------------------------------------------------------------------------------------------


def pack(entry: Entry, steps: Mapping[str, float]) -> "Packed":
    """Pack the surfaces of an entry and its maps in ``steps``, for the viewer.

    Its gyral net is drawn over it. If it has points on the sphere of a person, these are packed, too: a click on one
    surface also marks this point on the others of the same person.
    """
    cortex, vertex_ids, packed = entry.cortex, entry.display.ids, Packed(entry.measures, entry.display.ids, steps)
    packed.add("faces", entry.display.faces, stride=3)
    packed.add("ids", vertex_ids)
    packed.meta |= {"name": entry.name, "hemi": cortex.hemi, "sided": cortex.origin != "simulation"}
    if cortex.regions is not None:
        packed.add("regions", cortex.regions.labels[vertex_ids] + 1, dtype=np.uint16)
        packed.meta["regions"] = ["no region", *cortex.regions.names]
    if entry.person is not None and cortex.sphere is not None:
        sphere_box = packed.positions("sphere", unit(cortex.sphere.verts[vertex_ids]))
        packed.meta["sphere"] = {"person": entry.person, **sphere_box}
    if entry.measures.graph is not None:
        vertex_tree, crests = cKDTree(cortex.white.verts[vertex_ids]), []
        for _, _, crest in entry.measures.graph.edges(data=True):
            nearest = vertex_tree.query(crest["polyline"])[1]
            crests.append(nearest[np.flatnonzero(np.diff(nearest, prepend=-1))])  # drop consecutive repeats
        packed.add("crest-ids", np.concatenate([np.empty(0), *crests]))
        packed.add("crest-ends", np.cumsum([len(crest_ids) for crest_ids in crests]))
        packed.meta["net"] = {"hinges": hinges_of(entry.measures, vertex_tree)}
    return packed


class Packed:
    """What the page inlines for a surface or one of its stages: ``meta`` goes into JSON, ``data`` into a text block.

    The data are encoded arrays at the vertices ``ids``, one after the other; ``meta`` has where each begins. They begin
    with the surfaces that are drawn, and the maps that have a step: the coarsest that is allowed, for smaller data.
    With a step of 0 a map has 16 bits over its range.
    """

    def __init__(self, measures: Measures, ids: VertexIds, steps: Mapping[str, float]) -> None:
        self.meta: Shown = {"arrays": {}, "maps": {}, "g": measures.cortex.info.get("g")}
        self.arrays = b""
        surfaces = {name: getattr(measures.cortex, name) for name in ("pial", "white", "inflated")}
        self.meta["surfaces"] = {n: self.positions(n, s.verts[ids]) for n, s in surfaces.items() if s is not None}
        for key, step in steps.items():
            if (values := find(measures.maps, key)) is not None and np.isfinite(values).any():
                self.add_map(key, values[ids], step)

    @property
    def data(self) -> Markup:
        return Markup(base64.b64encode(zlib.compress(self.arrays, 6)).decode())  # base64 needs no escaping

    def add(self, name: str, array: np.ndarray, stride: int = 1, dtype: Any = np.uint32) -> None:
        codes = array.astype(dtype).ravel()
        array_entry = {"at": len(self.arrays), "n": codes.size, "bytes": codes.itemsize, "stride": stride}
        self.meta["arrays"][name] = array_entry
        self.arrays += encode(codes, stride)

    def positions(self, name: str, verts: np.ndarray) -> Shown:
        """Add positions, and return their box."""
        lower_corner = verts.min(axis=0)
        box_edge = float((verts.max(axis=0) - lower_corner).max()) or 1.0
        self.add(name, np.round((verts - lower_corner) / box_edge * 65535), stride=3, dtype=np.uint16)
        return {"low": lower_corner.round(5).tolist(), "edge": round(box_edge, 5)}

    def add_map(self, key: str, values: PerVertex, step: float) -> None:
        """Add a map; its limits are those of the codes, not of the values."""
        is_finite = np.isfinite(values)
        low, high = (float(values[is_finite].min()), float(values[is_finite].max())) if is_finite.any() else (0.0, 1.0)
        step = max(step, (high - low) / (NAN_CODE_16_BIT - 1)) or 1.0
        codes = np.where(is_finite, np.round((values - low) / step), NAN_CODE_16_BIT)
        self.add(f"map:{key}", codes, dtype=np.uint16)
        self.meta["maps"][key] = {"low": low, "high": low + step * (NAN_CODE_16_BIT - 1)}


def encode(array: np.ndarray, stride: int = 1) -> bytes:
    """Encode uint16 or uint32: wrapping differences to the element ``stride`` before, zigzag, a plane per byte."""
    differences = array.copy()
    differences[stride:] -= array[:-stride]
    zigzag = (differences << 1) ^ -(differences >> (8 * array.itemsize - 1))  # the last is all ones if it is negative
    return zigzag.view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def thin(cortex: Cortex, max_vertices: int = DISPLAY_VERTICES, stages: Sequence[Cortex] = ()) -> Display:
    """At most about ``max_vertices`` vertices and faces between them, ordered so that they compress well.

    The surface midway between white and pial is decimated by quadric errors. Each remaining vertex is moved back to a
    nearest original vertex, so that all surfaces and maps use the same index. The midway surface is used because
    decimating the pial alone leaves a white surface 20 % too large on an individual (0.1 % with the midway surface),
    and decimating the white alone damages sulcal walls. ``stages`` are other stages of the body. Then the mean of all
    stages is decimated, so that the mesh does not fold over in any of them.
    """
    vertex_ids, _, faces = in_use(cortex.pial.verts, cortex.faces)
    n_used = len(vertex_ids)
    if n_used > max_vertices:
        mid_verts = np.mean([layer.verts for body in (cortex, *stages) for layer in (body.pial, body.white)], axis=0)
        with SIMPLIFY_LOCK:
            points, faces = simplify(mid_verts, cortex.faces.astype(np.int32), 1.0 - max_vertices / cortex.n_vertices)
        _, nearest = cKDTree(mid_verts).query(points, k=12, workers=numba.get_num_threads())
        vertex_ids, thin_vertex = np.unique(distinct(nearest), return_inverse=True)
        faces = thin_vertex[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    points = cortex.pial.verts[vertex_ids] - cortex.pial.verts[vertex_ids].min(axis=0)
    order = np.argsort(morton_codes(points / (float(points.max()) or 1.0), bits=10), kind="stable")
    faces = np.argsort(order)[faces]
    lowest_corner = faces.argmin(axis=1)  # rotate each triangle so that its lowest index is first
    faces = np.take_along_axis(faces, (lowest_corner[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort((faces[:, 1], faces[:, 0]))]
    return Display(vertex_ids[order], faces, thinned=len(vertex_ids) < n_used)


def distinct(candidates: VertexIds) -> VertexIds:
    """One value of ``near`` (n, k) per row, nearest first, and no value twice if possible.

    Two points on one vertex would pinch the surface there. A row whose candidates are all taken shares its nearest.
    """
    chosen_vertex = np.full(len(candidates), -1, dtype=np.int64)
    is_taken = np.zeros(candidates.max() + 1, dtype=bool)
    for rank_column in candidates.T:
        open_rows = np.flatnonzero((chosen_vertex < 0) & ~is_taken[rank_column])
        new_vertices, first_rows = np.unique(rank_column[open_rows], return_index=True)
        chosen_vertex[open_rows[first_rows]] = new_vertices
        is_taken[new_vertices] = True
    return np.where(chosen_vertex < 0, candidates[:, 0], chosen_vertex)
