"""GIFTI surfaces, per-vertex maps and regions; nibabel writes them.

GIFTI compresses its arrays, so the size of a file does not give its unpacked size. Each array is unpacked to no more
than its header gives.
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
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morphofold.errors import DamagedFile, OutOfRange, WrongFile
from morphofold.io.files import StrPath, atomic_file, decoding, existing_file, side_named, unpacked
from morphofold.io.formats import Format, from_words
from morphofold.provenance import clean_name
from morphofold.surface import Faces, PerVertex, Regions, Surface, Verts

_STRUCTURE_OF_HEMI = {"lh": "CortexLeft", "rh": "CortexRight"}
_SURFACE_METADATA = {  # names as in Connectome Workbench
    "white": {"GeometricType": "Anatomical", "AnatomicalStructureSecondary": "GrayWhite"},
    "pial": {"GeometricType": "Anatomical", "AnatomicalStructureSecondary": "Pial"},
    "inflated": {"GeometricType": "Inflated"},
    "sphere": {"GeometricType": "Spherical"},
}
MOST_UNPACKED_BYTES = 2**28  # bytes: 7 million vertices and their faces
_CONVERT_AGAIN = "Convert it again from its source, e.g. with mris_convert or wb_command."


def read_gifti_surface(path: Path) -> tuple[Verts, Faces, Mapping[str, Any] | None]:
    """Vertices (N, 3), faces (M, 3) and the volume geometry that mris_convert stores, if complete.

    The geometry is None for a surface marked as in the scanner's frame: its ``C_RAS`` would move the surface twice.
    """
    arrays = _read(path, "a GIFTI surface")[0]
    points, triangles = ([a for a in arrays if a.intent == intent] for intent in ("pointset", "triangle"))
    if len(points) != 1 or len(triangles) != 1:
        raise WrongFile(
            f"{path}: holds {len(points)} arrays of points and {len(triangles)} of triangles, not one of each. "
            f"It holds {_array_intents_text(arrays)}; pass a .surf.gii."
        )
    there = points[0].element.findtext("CoordinateSystemTransformMatrix/DataSpace", "").strip()
    geometry = None if there == "NIFTI_XFORM_SCANNER_ANAT" else _volume_geometry(points[0].element)
    return points[0].values, triangles[0].values, geometry


def read_gifti_map(path: Path) -> PerVertex:
    """Values (N,) of a GIFTI with a single per-vertex array (``.shape.gii``, ``.func.gii``)."""
    arrays = _read(path, "a GIFTI map")[0]
    if len(arrays) != 1 or np.squeeze(arrays[0].values).ndim != 1:
        raise WrongFile(f"{path}: holds {_array_intents_text(arrays)}; a map has one array with one value per vertex.")
    return np.asarray(arrays[0].values, dtype=np.float64).reshape(-1)


def read_gifti_regions(path: Path, name: str = "regions") -> Regions:
    """Regions of a GIFTI label file (``.label.gii``), in the order of their keys; key 0 means no region.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is damaged, does not hold exactly one array of keys, or its table lacks a key.
    """
    arrays, labels = _read(existing_file(path, "label file"), "a GIFTI label file")
    if len(arrays) != 1 or arrays[0].intent != "label" or arrays[0].values.ndim != 1:
        raise WrongFile(f"{path}: holds {_array_intents_text(arrays)}; regions are one array with one key per vertex.")
    with decoding(path, "a GIFTI label file", _CONVERT_AGAIN):  # keys may be too large for an integer
        table = {int(label.get("Key") or label.get("Index") or ""): label for label in labels}
        keys = np.array(sorted(table.keys() - {0}), dtype=np.int64)
        shades = [[float(table[k].get(c) or 0) for c in ("Red", "Green", "Blue")] for k in keys.tolist()]
    values = np.asarray(arrays[0].values, dtype=np.int64)
    missing = np.setdiff1d(values, [0, *keys])
    if missing.size:
        raise DamagedFile(
            f"{path}: its label table lacks {len(missing)} of the keys, the first is {missing[0]}. {_CONVERT_AGAIN}"
        )
    colours = np.array(shades, dtype=np.float64).reshape(-1, 3)
    names = tuple(clean_name((table[k].text or "").strip()) for k in keys.tolist())
    indices = np.where(values == 0, -1, np.searchsorted(keys, values))
    return Regions(indices, names, np.round(255 * colours.clip(0, 1)).astype(np.uint8), name)


class _GiftiArray(NamedTuple):
    """An array, its intent in lower case, such as ``pointset``, and its element."""

    intent: str
    values: NDArray[Any]
    element: ET.Element


def _read(path: Path, what: str) -> tuple[list[_GiftiArray], list[ET.Element]]:
    """The arrays of a file, and the labels of its table."""
    with decoding(path, what, _CONVERT_AGAIN):
        root = ET.fromstring(unpacked(path, MOST_UNPACKED_BYTES))
        arrays, left = [], MOST_UNPACKED_BYTES
        for element in root.iter("DataArray"):
            arrays.append(_read_array(element, path.parent, left))
            left -= arrays[-1].values.nbytes
        return arrays, list(root.iter("Label"))


def _read_array(element: ET.Element, folder: Path, most: int) -> _GiftiArray:
    n = int(element.get("Dimensionality", "1"))
    if not 1 <= n <= 6:
        raise DamagedFile(f"an array has {n} dimensions; GIFTI allows 1 to 6")
    dims = [int(element.get(f"Dim{i}", "1")) for i in range(n)]
    shape = " x ".join(map(str, dims))
    kind = np.dtype(element.get("DataType", "").removeprefix("NIFTI_TYPE_").lower())
    size = math.prod(dims) * kind.itemsize
    if min(dims) <= 0 or size > most:
        raise DamagedFile(f"an array of {shape} values is empty or too large")
    encoding, text = element.get("Encoding", ""), element.findtext("Data") or ""
    if encoding == "ASCII":
        data = from_words(text.split(), kind).tobytes()
    elif encoding == "ExternalFileBinary":
        data = _external(folder, element.get("ExternalFileName", ""), int(element.get("ExternalFileOffset") or 0), size)
    elif encoding in ("Base64Binary", "GZipBase64Binary"):
        data = base64.b64decode(text)
        data = zlib.decompressobj().decompress(data, size + 1) if encoding.startswith("GZip") else data
    else:
        raise DamagedFile(f"an array has the unknown encoding {encoding[:40]!r}")
    if len(data) != size:
        more = "more" if len(data) > size else len(data)
        raise DamagedFile(f"an array of {shape} values needs {size} bytes, but it unpacks to {more}")
    order: Any = "C"
    if encoding != "ASCII":  # whose numbers are those of this computer, row by row, as nibabel writes them
        kind = kind.newbyteorder(">" if element.get("Endian") == "BigEndian" else "<")
        order = "F" if element.get("ArrayIndexingOrder") == "ColumnMajorOrder" else "C"
    values = np.frombuffer(data, kind).reshape(dims, order=order)
    return _GiftiArray(element.get("Intent", "").removeprefix("NIFTI_INTENT_").lower(), values, element)


def _external(folder: Path, name: str, at: int, size: int) -> bytes:
    """Bytes of a file beside the GIFTI file, where SPM and CAT12 keep arrays; any other file is refused.

    A link is one to another file, unless git-annex made it.
    """
    beside = folder / name
    if not re.fullmatch(r"[^/\\:\0]+", name) or (
        beside.is_symlink() and "/annex/objects/" not in os.path.realpath(beside)
    ):
        raise WrongFile(f"it keeps an array in {name!r}, but only a file beside it, which is no link, is read")
    with existing_file(beside, "file of arrays").open("rb") as file:
        file.seek(at)
        return file.read(size)


def _array_intents_text(arrays: list[_GiftiArray]) -> str:
    names = [f"{a.intent} {a.values.shape}" for a in arrays]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "") if names else "no arrays"


_FOOTER_KEYS = {
    "volume": ("Width", "Height", "Depth"),
    "voxelsize": ("Xsize", "Ysize", "Zsize"),
    "xras": ("X_R", "X_A", "X_S"),
    "yras": ("Y_R", "Y_A", "Y_S"),
    "zras": ("Z_R", "Z_A", "Z_S"),
    "cras": ("C_R", "C_A", "C_S"),
}


def _volume_geometry(element: ET.Element) -> Mapping[str, Any] | None:
    """FreeSurfer's footer from the ``VolGeom...`` entries of mris_convert; None unless all exist."""
    meta = {(md.findtext("Name") or "").strip(): (md.findtext("Value") or "").strip() for md in element.iter("MD")}
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
