"""Surfaces and maps as compact text for the viewer: quantised, delta-coded, deflated, base64.

Positions have 16 bits per coordinate of the surface's bounding cube (0.003 mm on a brain). Maps have at most 16 bits
over their range, with 65535 for NaN. Every array is stored as differences to the element ``stride`` before it,
zigzag-coded, low bytes before high bytes. ``templates/viewer-data.js`` decodes it.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from morphofold.geometry import morton_codes, unit
from morphofold.report.pages.layers import Net
from morphofold.surface import Cortex, Faces, PerVertex, Verts
from morphofold.threads import SIMPLIFYING

DISPLAY_VERTICES = 60_000
STAGED_VERTICES = 15_000  # of a body drawn at every stage of growth
NAN_CODE_16_BIT = 65535


@dataclass(frozen=True, eq=False)
class Packed:
    """What the page inlines for one surface: ``meta`` goes into JSON, ``data`` into a text block."""

    meta: dict[str, Any]
    data: str


@dataclass(frozen=True, eq=False)
class Display:
    """A cortex thinned for drawing: ``ids`` (n,) are vertices of the full surface, ``faces`` index ``ids``."""

    ids: NDArray[np.int64]
    faces: Faces
    thinned: bool


def pack(
    cortex: Cortex,
    maps: Mapping[str, PerVertex],
    steps: Mapping[str, float] | None = None,
    shown: Display | None = None,
    net: Net | None = None,
    person: str | None = None,
) -> Packed:
    """Pack the pial, white and (if any) inflated surface of a cortex, and maps (N,), for the viewer.

    ``steps`` gives the coarsest step allowed for a map, which makes the data smaller; without it, a map has 16 bits
    over its range. ``shown`` is the result of ``thin`` for the cortex; None: thinned here. ``net`` is drawn over it.
    With ``person``, the points on the sphere are packed, too: a click on one surface also marks this point on the
    others of the same person.
    """
    steps = steps or {}
    shown = shown or thin(cortex)
    writer = _ArrayPacker()
    surfaces = {"pial": cortex.pial, "white": cortex.white, "inflated": cortex.inflated}
    boxes = {}
    for name, surface in surfaces.items():
        if surface is not None:
            boxes[name] = writer.positions(name, surface.verts[shown.ids])
    writer.add("faces", shown.faces.astype(np.uint32).ravel(), stride=3)
    writer.add("ids", shown.ids.astype(np.uint32))
    ranges = {key: writer.values(f"map:{key}", values[shown.ids], steps.get(key, 0.0)) for key, values in maps.items()}
    if cortex.regions is not None:
        writer.add("regions", (cortex.regions.labels[shown.ids] + 1).astype(np.uint16))
    sphere = None
    if person is not None and cortex.sphere is not None:
        points = unit(cortex.sphere.verts[shown.ids])
        sphere = {"person": person, **writer.positions("sphere", points)}
    if net is not None:
        writer.add("crest-ids", np.concatenate([np.empty(0, np.uint32), *net.crests]).astype(np.uint32))
        writer.add("crest-ends", np.cumsum([len(line) for line in net.crests]).astype(np.uint32))
    meta = {
        "vertices": len(shown.ids),
        "triangles": len(shown.faces),
        "all_vertices": cortex.n_vertices,
        "thinned": shown.thinned,
        "surfaces": boxes,
        "maps": ranges,
        "arrays": writer.arrays,
        **({} if sphere is None else {"sphere": sphere}),
        "net": None if net is None else {"hinges": net.hinges},
        "regions": ["no region", *cortex.regions.names] if cortex.regions is not None else None,
    }
    return Packed(meta, writer.text())


def pack_stage(
    cortex: Cortex, maps: Mapping[str, PerVertex], steps: Mapping[str, float], ids: NDArray[np.int64]
) -> Packed:
    """Pack white and pial surface and maps (N,) of a stage of growth, at the vertices ``ids`` of the last stage."""
    writer = _ArrayPacker()
    boxes = {n: writer.positions(n, s.verts[ids]) for n, s in (("pial", cortex.pial), ("white", cortex.white))}
    ranges = {key: writer.values(f"map:{key}", values[ids], steps.get(key, 0.0)) for key, values in maps.items()}
    meta = {"g": float(cortex.info["g"]), "surfaces": boxes, "maps": ranges, "arrays": writer.arrays}
    return Packed(meta, writer.text())


class _ArrayPacker:
    """Collects encoded arrays one after the other and keeps where each begins."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self.arrays: dict[str, dict[str, Any]] = {}
        self.size = 0

    def text(self) -> str:
        return base64.b64encode(zlib.compress(b"".join(self.chunks), 6)).decode("ascii")

    def add(self, name: str, array: np.ndarray, stride: int = 1) -> None:
        data = encode(array, stride)
        self.arrays[name] = {"at": self.size, "n": int(array.size), "bytes": array.itemsize, "stride": stride}
        self.chunks.append(data)
        self.size += len(data)

    def positions(self, name: str, verts: np.ndarray) -> dict[str, Any]:
        low = verts.min(axis=0)
        edge = float((verts.max(axis=0) - low).max()) or 1.0
        self.add(name, np.round((verts - low) / edge * 65535).astype(np.uint16).ravel(), stride=3)
        return {"low": [round(float(x), 5) for x in low], "edge": round(edge, 5)}

    def values(self, name: str, values: np.ndarray, step: float) -> dict[str, float]:
        known = np.isfinite(values)
        low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 1.0)
        codes = np.full(len(values), NAN_CODE_16_BIT, dtype=np.uint16)
        step = max(step, (high - low) / (NAN_CODE_16_BIT - 1)) or 1.0
        codes[known] = np.round((values[known] - low) / step).astype(np.uint16)
        self.add(name, codes)
        return {"low": low, "high": low + step * (NAN_CODE_16_BIT - 1)}  # limits of the codes, not of the values


def encode(array: np.ndarray, stride: int = 1) -> bytes:
    """Encode uint16 or uint32: wrapping differences to the element ``stride`` before, zigzag, a plane per byte."""
    if array.dtype not in (np.uint16, np.uint32):
        raise TypeError(f"encode takes uint16 or uint32, got {array.dtype}.")
    array = np.ascontiguousarray(array)
    step = array.copy()
    step[stride:] -= array[:-stride]
    bits = 8 * array.itemsize
    sign = step >> (bits - 1)  # 1 where the difference is negative
    zigzag = (step << 1) ^ (np.zeros_like(step) - sign)
    little = zigzag.astype(zigzag.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def thin(cortex: Cortex, max_vertices: int = DISPLAY_VERTICES, stages: Sequence[Cortex] = ()) -> Display:
    """At most about ``max_vertices`` vertices and faces between them, ordered so that they compress well.

    The surface midway between white and pial is decimated by quadric errors. Each remaining vertex is moved back to a
    nearest original vertex, so that all surfaces and maps use the same index. The midway surface is used because
    decimating the pial alone leaves a white surface 20 % too large on an individual (0.1 % with the midway surface),
    and decimating the white alone damages sulcal walls. ``stages`` are other stages of the body. Then the mean of all
    stages is decimated, so that the mesh does not fold over in any of them.
    """
    n = cortex.n_vertices
    used = np.unique(cortex.faces)
    if len(used) <= max_vertices:
        ids, faces = used, np.searchsorted(used, cortex.faces)
    else:
        middle = np.mean([surface.verts for c in (cortex, *stages) for surface in (c.pial, c.white)], axis=0)
        ids, faces = _decimated(middle, cortex.faces, max_vertices / n)
    points = cortex.pial.verts[ids]
    low = points.min(axis=0)
    order = np.argsort(morton_codes((points - low) / (float((points - low).max()) or 1.0), bits=10), kind="stable")
    place = np.empty(len(ids), dtype=np.int64)
    place[order] = np.arange(len(ids))
    faces = place[faces]
    first = faces.argmin(axis=1)  # rotate each triangle so that its lowest index is first
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort((faces[:, 1], faces[:, 0]))]
    return Display(ids[order], faces, thinned=len(ids) < len(used))


def _decimated(middle: Verts, faces: Faces, keep: float) -> tuple[NDArray[np.int64], Faces]:
    from fast_simplification import simplify
    from scipy.spatial import cKDTree

    with SIMPLIFYING:
        points, triangles = simplify(middle, faces.astype(np.int32), 1.0 - keep)
    _, near = cKDTree(middle).query(points, k=12, workers=numba.get_num_threads())
    chosen = distinct(near)
    ids, place = np.unique(chosen, return_inverse=True)
    faces = place[triangles]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return ids, faces[whole]


def distinct(near: NDArray[np.int64]) -> NDArray[np.int64]:
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
