"""GIFTI surfaces, per-vertex maps and regions, through nibabel.

GIFTI compresses its arrays, so the size of a file does not give its unpacked size. Each array is first unpacked with a
bound, and its size is compared with that in its header.
"""

from __future__ import annotations

import base64
import gzip
import math
import os
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, OutOfRange, WrongFile
from morphofold.io.files import StrPath, atomic_file, decoding, existing_file, side_named
from morphofold.io.formats import Format
from morphofold.surface import Faces, PerVertex, Regions, Surface, Verts

_STRUCTURE_OF_HEMI = {"lh": "CortexLeft", "rh": "CortexRight"}
_SURFACE_METADATA = {  # names as in Connectome Workbench
    "white": {"GeometricType": "Anatomical", "AnatomicalStructureSecondary": "GrayWhite"},
    "pial": {"GeometricType": "Anatomical", "AnatomicalStructureSecondary": "Pial"},
    "inflated": {"GeometricType": "Inflated"},
    "sphere": {"GeometricType": "Spherical"},
}
MOST_UNPACKED_BYTES = 2**28  # bytes: 7 million vertices and their faces; nibabel holds several copies of them
_CONVERT_AGAIN = "Convert it again from its source, e.g. with mris_convert or wb_command."


def read_gifti_surface(path: Path) -> tuple[Verts, Faces, Mapping[str, Any] | None]:
    """Vertices (N, 3), faces (M, 3) and the volume geometry that mris_convert stores, if complete.

    The geometry is None for a surface marked as in the scanner's frame: its ``C_RAS`` would move the surface twice.
    """
    from nibabel import nifti1

    image = _load_image(path, "a GIFTI surface")
    points = image.get_arrays_from_intent("NIFTI_INTENT_POINTSET")
    triangles = image.get_arrays_from_intent("NIFTI_INTENT_TRIANGLE")
    if len(points) != 1 or len(triangles) != 1:
        raise WrongFile(
            f"{path}: holds {len(points)} arrays of points and {len(triangles)} of triangles, not one of each. "
            f"It holds {_array_intents_text(image)}; pass a .surf.gii."
        )
    there = points[0].coordsys is not None and points[0].coordsys.dataspace == nifti1.xform_codes["scanner"]
    return points[0].data, triangles[0].data, None if there else _volume_geometry(points[0].meta)


def read_gifti_map(path: Path) -> PerVertex:
    """Values (N,) of a GIFTI with a single per-vertex array (``.shape.gii``, ``.func.gii``)."""
    image = _load_image(path, "a GIFTI map")
    values = [a.data for a in image.darrays if np.ndim(np.squeeze(a.data)) == 1]
    if len(image.darrays) != 1 or len(values) != 1:
        raise WrongFile(f"{path}: holds {_array_intents_text(image)}; a map has one array with one value per vertex.")
    return np.asarray(values[0], dtype=np.float64).reshape(-1)


def read_gifti_regions(path: Path, name: str = "regions") -> Regions:
    """Regions of a GIFTI label file (``.label.gii``), in the order of their keys; key 0 means no region.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is damaged, does not hold exactly one array of keys, or its table lacks a key.
    """
    image = _load_image(existing_file(path, "label file"), "a GIFTI label file")
    arrays = image.get_arrays_from_intent("NIFTI_INTENT_LABEL")
    if len(arrays) != 1 or len(image.darrays) != 1 or np.ndim(arrays[0].data) != 1:
        raise WrongFile(f"{path}: holds {_array_intents_text(image)}; regions are one array with one key per vertex.")
    table = {label.key: label for label in image.labeltable.labels if label.key != 0}
    with decoding(path, "a GIFTI label file", _CONVERT_AGAIN):  # keys may be too large for an integer
        keys, values = np.array(sorted(table), dtype=np.int64), np.asarray(arrays[0].data, dtype=np.int64)
    missing = np.setdiff1d(values, [0, *keys])
    if missing.size:
        raise DamagedFile(
            f"{path}: its label table lacks {len(missing)} of the keys, the first is {missing[0]}. {_CONVERT_AGAIN}"
        )
    shades = [[x or 0.0 for x in (table[k].red, table[k].green, table[k].blue)] for k in keys]
    colours = np.array(shades, dtype=np.float64).reshape(-1, 3)
    names = tuple(getattr(table[k], "label", None) or "" for k in keys)  # nibabel leaves it out if it is empty
    labels = np.where(values == 0, -1, np.searchsorted(keys, values))
    return Regions(labels, names, np.round(255 * colours.clip(0, 1)).astype(np.uint8), name)


def _load_image(path: Path, what: str) -> Any:
    from nibabel.gifti import GiftiImage

    with decoding(path, what, _CONVERT_AGAIN):
        raw = path.read_bytes()
        if raw[:2] == b"\x1f\x8b":
            with gzip.open(path) as file:
                raw = file.read(MOST_UNPACKED_BYTES + 1)
            if len(raw) > MOST_UNPACKED_BYTES:
                raise DamagedFile(f"it unpacks to more than {MOST_UNPACKED_BYTES / 2**20:g} MiB")
        _check_array_sizes(raw)
        # from memory: so an array in an external file, which could be any file, is refused
        return GiftiImage.from_bytes(raw)


def _check_array_sizes(raw: bytes) -> None:
    """Raise unless every compressed array unpacks to the size that its attributes give."""
    from nibabel.gifti.util import gifti_encoding_codes
    from nibabel.nifti1 import data_type_codes

    left = MOST_UNPACKED_BYTES
    for _, element in ET.iterparse(BytesIO(raw)):
        if element.tag != "DataArray":
            continue
        n = int(element.get("Dimensionality", "1"))
        if not 1 <= n <= 6:
            raise DamagedFile(f"an array has {n} dimensions; GIFTI allows 1 to 6")
        dims = [int(element.get(f"Dim{i}", "1")) for i in range(n)]
        shape = " x ".join(map(str, dims))
        size = math.prod(dims) * np.dtype(data_type_codes.dtype[element.get("DataType", "")]).itemsize  # type: ignore[call-overload]
        left -= size
        if min(dims) <= 0 or left < 0:
            raise DamagedFile(f"an array of {shape} values is empty or too large")
        if gifti_encoding_codes.label[element.get("Encoding", "")] == "B64GZ":
            packed = base64.b64decode(element.findtext("Data") or "")
            unpacked = len(zlib.decompressobj().decompress(packed, size + 1))
            if unpacked != size:
                more = "more" if unpacked > size else unpacked
                raise DamagedFile(f"an array of {shape} values needs {size} bytes, but it unpacks to {more}")
        element.clear()


def _array_intents_text(image: Any) -> str:
    from nibabel.nifti1 import intent_codes

    names = [f"{intent_codes.label[a.intent]} {np.shape(a.data)}" for a in image.darrays]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "") if names else "no arrays"


_FOOTER_KEYS = {
    "volume": ("Width", "Height", "Depth"),
    "voxelsize": ("Xsize", "Ysize", "Zsize"),
    "xras": ("X_R", "X_A", "X_S"),
    "yras": ("Y_R", "Y_A", "Y_S"),
    "zras": ("Z_R", "Z_A", "Z_S"),
    "cras": ("C_R", "C_A", "C_S"),
}


def _volume_geometry(meta: Mapping[str, str]) -> Mapping[str, Any] | None:
    """FreeSurfer's footer from the ``VolGeom...`` entries of mris_convert; None unless all exist."""
    try:
        found = {k: np.array([float(meta[f"VolGeom{n}"]) for n in names]) for k, names in _FOOTER_KEYS.items()}
    except (KeyError, ValueError):
        return None
    if not all(np.isfinite(v).all() for v in found.values()):
        return None
    head = {"head": np.array([2, 0, 20]), "valid": "1  # volume info valid"}
    return {**head, "filename": meta.get("VolGeomFname", ""), **found, "volume": found["volume"].astype(int)}


def write_gifti_surface(path: StrPath, surface: Surface, hemi: str | None = None, *, scanner: bool = False) -> None:
    """Write a GIFTI surface, float32 and int32, compressed; its footer is written as ``VolGeom...``.

    Coordinates stay unchanged. As with ``mris_convert``, coordinates in FreeSurfer's surface frame stay in that frame,
    and ``C_RAS`` of the footer gives the shift to the scanner's frame. With ``scanner`` the file is marked as in the
    scanner's frame; such a surface has no footer. The end of the file name gives the kind: white, pial, inflated or
    sphere.
    """
    from nibabel import nifti1
    from nibabel.gifti import GiftiCoordSystem, GiftiDataArray

    kind = re.split(r"[._]", Path(path).name.split(".surf.gii")[0])[-1]
    meta = _structure_metadata(path, hemi) | _SURFACE_METADATA.get(kind, {"GeometricType": "Anatomical"})
    footer = surface.geometry
    if footer and str(footer.get("valid", "")).startswith("1"):
        meta["VolGeomFname"] = str(footer["filename"])
        for key, names in _FOOTER_KEYS.items():
            meta |= {f"VolGeom{n}": repr(x.item()) for n, x in zip(names, np.asarray(footer[key]))}
    space = nifti1.xform_codes["scanner" if scanner else "unknown"]
    points = GiftiDataArray(
        surface.verts.astype(np.float32),
        "NIFTI_INTENT_POINTSET",
        "NIFTI_TYPE_FLOAT32",
        coordsys=GiftiCoordSystem(space, space),
        meta=meta,
    )
    triangles = GiftiDataArray(surface.faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32")
    _write_image(path, [points, triangles], {})


def write_gifti_map_file(path: StrPath, values: NDArray[np.float32], name: str, hemi: str | None) -> None:
    """Write checked values (N,) as a GIFTI map."""
    from nibabel.gifti import GiftiDataArray

    array = GiftiDataArray(values, "NIFTI_INTENT_SHAPE", "NIFTI_TYPE_FLOAT32", meta={"Name": name})
    _write_image(path, [array], _structure_metadata(path, hemi))


def write_gifti_regions(path: StrPath, regions: Regions, hemi: str | None = None) -> None:
    """Write regions as a GIFTI label file: region i has key i + 1; key 0, ??? as in Workbench, means no region."""
    from nibabel.gifti import GiftiDataArray, GiftiLabel, GiftiLabelTable

    labels, count = np.asarray(regions.labels), len(regions.names)
    if labels.ndim != 1 or labels.min(initial=0) < -1 or labels.max(initial=-1) >= count:
        problem = f"labels are {labels.min()}..{labels.max()}, allowed -1..{count - 1}"
        raise OutOfRange(f"{path}: {problem}. Pass a name for every label.")
    table = GiftiLabelTable()
    for key, (name, colour) in enumerate([("???", None), *zip(regions.names, regions.colours.tolist())]):
        rgba = (1.0, 1.0, 1.0, 0.0) if colour is None else (*(x / 255 for x in colour), 1.0)
        table.labels.append(GiftiLabel(key, *rgba))
        table.labels[-1].label = name
    keys, meta = (labels + 1).astype(np.int32), {"Name": regions.name}
    array = GiftiDataArray(keys, "NIFTI_INTENT_LABEL", "NIFTI_TYPE_INT32", meta=meta)
    _write_image(path, [array], _structure_metadata(path, hemi), table)


def _structure_metadata(path: StrPath, hemi: str | None) -> dict[str, str]:
    hemi = hemi or side_named(Path(path).name)
    return {"AnatomicalStructurePrimary": _STRUCTURE_OF_HEMI[hemi]} if hemi in _STRUCTURE_OF_HEMI else {}


def _write_image(path: StrPath, arrays: list[Any], meta: dict[str, str], labels: Any = None) -> None:
    from nibabel.gifti import GiftiImage, GiftiMetaData

    if not os.fspath(path).endswith((".gii", ".gii.gz")):
        raise WrongFile(f"{path}: the name of a GIFTI file must end in .gii or .gii.gz.")
    raw = GiftiImage(darrays=arrays, meta=GiftiMetaData(meta), labeltable=labels).to_bytes()
    with atomic_file(path) as temporary:
        temporary.write_bytes(gzip.compress(raw, mtime=0) if os.fspath(path).endswith(".gz") else raw)


FORMATS = (
    Format(
        "GIFTI (.gii)",
        (".gii", ".gii.gz"),
        read_gifti_surface,
        write_gifti_surface,
        re.compile(rb".*?<GIFTI", re.DOTALL),
    ),
)
