"""Data of the interactive view: surfaces, maps and nets of a page as compact text for ``templates/viewer.js``.

In go the entries of a page (:mod:`morphofold.report.pages.page_entries`), out come their thinned meshes and the
packed data; ``page`` calls it.

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
from morphofold.threads import SIMPLIFYING

VIEWER_SCRIPTS = ("tables.js", "viewer-data.js", "viewer-layers.js", "viewer.js")
DISPLAY_VERTICES = 60_000
STAGED_VERTICES = 15_000  # of a body drawn at every stage of growth
NAN_CODE_16_BIT = 65535
VertexIds = NDArray[np.int64]
Shown = dict[str, Any]  # of the page's JSON
ShownMaps = dict[str, Quantity]  # by key, with limits for all surfaces


# what a page shows -------------------------------------------------------------------------------------------


def thinned(e: Entry) -> Entry:
    """An entry with its surface as the viewer draws it, at all of its stages."""
    max_vertices, stages = STAGED_VERTICES if e.stages else DISPLAY_VERTICES, [m.cortex for m in e.stages]
    return replace(e, display=thin(e.cortex, max_vertices, stages))


def entries_with_map(entries: Entries, key: str) -> list[tuple[Entry, PerVertex]]:
    """The entries that have the map ``key`` with at least one value, each with the map."""
    maps = [(e, find(e.measures.maps, key)) for e in entries]
    return [(e, a) for e, a in maps if a is not None and np.isfinite(a).any()]


def shown_maps(entries: Entries) -> ShownMaps:
    """The maps that a page shows, heights of folds and main maps first, with the limits that all its surfaces share."""
    other_maps = {quantity(n).key for e in entries for n in e.measures.maps} - {RELIEF, *MAIN_MAPS}
    maps = {}
    for key in (RELIEF, *MAIN_MAPS, *sorted(other_maps)):
        if map_arrays := [a for _, a in entries_with_map(entries, key)]:
            measure = quantity(key, map_arrays)
            maps[key] = replace(measure, limits=common_limits(measure, map_arrays))
    return maps


def viewer_data(entries: Entries, maps: ShownMaps) -> tuple[Shown, dict[str, Markup]]:
    """The JSON configuration of viewer.js, and the packed data of each surface (``"0"``) and its stages (``"0-1"``)."""
    surfaces, blocks = [], dict[str, Markup]()
    # finer than the colours can show
    step_by_map = {key: np.ptp(measure.limits or 0) / 2000 for key, measure in maps.items()}
    main_steps = {key: step_by_map[key] for key in MAIN_MAPS if key in maps}
    for k, e in enumerate(entries):
        packed, stages = pack(e, step_by_map), [Packed(m, e.display.ids, main_steps) for m in e.stages]
        surfaces.append(packed.meta | {"stages": [stage.meta for stage in stages]})
        blocks |= {f"{k}": packed.data} | {f"{k}-{i}": stage.data for i, stage in enumerate(stages)}
    config = {
        "surfaces": surfaces,
        "maps": [vars(measure) | {"main": key in MAIN_MAPS} for key, measure in maps.items()],
        "tables": {"sequential": colours.sequential().tolist(), "diverging": colours.diverging().tolist()},
        "missing": colours.NOT_MEASURED_COLOUR,
        "bare": colours.BARE_SURFACE_COLOUR,
    }
    return config, blocks


def hinges_of(measures: Measures, tree: cKDTree) -> list[Shown]:
    """The hinges of a net: index ``at`` of the nearest in a tree of drawn vertices, ``degree``, whether it is
    ``doubtful``, and ``lines`` of label and text that a click on it shows."""
    hinges = []
    for row in measures.hinges:
        arms = [arm for arm in measures.arms if arm["hinge"] == row["hinge"]]
        angles = ", ".join(f"{number(arm['angle_deg'])}°" for arm in arms)
        lengths = ", ".join(number(arm["length_mm"]) for arm in arms)
        hinge_text = f"{row['hinge']}, {row['shape']}" + (", by a dead-end gyrus" if row.get("blind") else "")
        lines = [("Hinge", hinge_text), ("Angles", angles), ("Arms", f"{lengths} mm")]
        doubtful = not counts(row)
        if row.get("confidence") is not None:
            doubt_text = ", doubtful: not counted" if doubtful else ""
            lines.append(("Confidence", f"{number(row['confidence'])}{doubt_text}"))
        drawn_vertex = int(tree.query((row["x"], row["y"], row["z"]))[1])
        hinges.append({"at": drawn_vertex, "degree": row["degree"], "doubtful": doubtful, "lines": lines})
    return hinges


# packing -----------------------------------------------------------------------------------------------------


def pack(e: Entry, steps: Mapping[str, float]) -> "Packed":
    """Pack the surfaces of an entry and its maps in ``steps``, for the viewer.

    Its gyral net is drawn over it. If it has points on the sphere of a person, these are packed, too: a click on one
    surface also marks this point on the others of the same person.
    """
    cortex, ids, packed = e.cortex, e.display.ids, Packed(e.measures, e.display.ids, steps)
    packed.add("faces", e.display.faces, stride=3)
    packed.add("ids", ids)
    packed.meta |= {"name": e.name, "hemi": cortex.hemi, "sided": cortex.origin != "simulation"}
    if cortex.regions is not None:
        packed.add("regions", cortex.regions.labels[ids] + 1, dtype=np.uint16)
        packed.meta["regions"] = ["no region", *cortex.regions.names]
    if e.person is not None and cortex.sphere is not None:
        sphere_box = packed.positions("sphere", unit(cortex.sphere.verts[ids]))
        packed.meta["sphere"] = {"person": e.person, **sphere_box}
    if e.measures.graph is not None:
        vertex_tree, crests = cKDTree(cortex.white.verts[ids]), []
        for _, _, crest in e.measures.graph.edges(data=True):
            near = vertex_tree.query(crest["polyline"])[1]
            crests.append(near[np.flatnonzero(np.diff(near, prepend=-1))])  # drop consecutive repeats
        packed.add("crest-ids", np.concatenate([np.empty(0), *crests]))
        packed.add("crest-ends", np.cumsum([len(line) for line in crests]))
        packed.meta["net"] = {"hinges": hinges_of(e.measures, vertex_tree)}
    return packed


class Packed:
    """What the page inlines for a surface or one of its stages: ``meta`` goes into JSON, ``data`` into a text block.

    The data are encoded arrays at the vertices ``ids``, one after the other; ``meta`` has where each begins. They begin
    with the surfaces that are drawn, and the maps that have a step: the coarsest that is allowed, for smaller data.
    With a step of 0 a map has 16 bits over its range.
    """

    def __init__(self, m: Measures, ids: VertexIds, steps: Mapping[str, float]) -> None:
        self.meta: Shown = {"arrays": {}, "maps": {}, "g": m.cortex.info.get("g")}
        self.arrays = b""
        surfaces = {name: getattr(m.cortex, name) for name in ("pial", "white", "inflated")}
        self.meta["surfaces"] = {n: self.positions(n, s.verts[ids]) for n, s in surfaces.items() if s is not None}
        for key, step in steps.items():
            if (values := find(m.maps, key)) is not None and np.isfinite(values).any():
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
        finite = np.isfinite(values)
        low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 1.0)
        step = max(step, (high - low) / (NAN_CODE_16_BIT - 1)) or 1.0
        codes = np.where(finite, np.round((values - low) / step), NAN_CODE_16_BIT)
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
    ids, _, faces = in_use(cortex.pial.verts, cortex.faces)
    n_used = len(ids)
    if n_used > max_vertices:
        mid_verts = np.mean([surface.verts for c in (cortex, *stages) for surface in (c.pial, c.white)], axis=0)
        with SIMPLIFYING:
            points, faces = simplify(mid_verts, cortex.faces.astype(np.int32), 1.0 - max_vertices / cortex.n_vertices)
        _, near_vertices = cKDTree(mid_verts).query(points, k=12, workers=numba.get_num_threads())
        ids, vertex = np.unique(distinct(near_vertices), return_inverse=True)
        faces = vertex[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    points = cortex.pial.verts[ids] - cortex.pial.verts[ids].min(axis=0)
    order = np.argsort(morton_codes(points / (float(points.max()) or 1.0), bits=10), kind="stable")
    faces = np.argsort(order)[faces]
    lowest_corner = faces.argmin(axis=1)  # rotate each triangle so that its lowest index is first
    faces = np.take_along_axis(faces, (lowest_corner[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort((faces[:, 1], faces[:, 0]))]
    return Display(ids[order], faces, thinned=len(ids) < n_used)


def distinct(near: VertexIds) -> VertexIds:
    """One value of ``near`` (n, k) per row, nearest first, and no value twice if possible.

    Two points on one vertex would pinch the surface there. A row whose candidates are all taken shares its nearest.
    """
    chosen = np.full(len(near), -1, dtype=np.int64)
    is_taken = np.zeros(near.max() + 1, dtype=bool)
    for column in near.T:
        open_rows = np.flatnonzero((chosen < 0) & ~is_taken[column])
        new_vertices, first_rows = np.unique(column[open_rows], return_index=True)
        chosen[open_rows[first_rows]] = new_vertices
        is_taken[new_vertices] = True
    return np.where(chosen < 0, near[:, 0], chosen)
